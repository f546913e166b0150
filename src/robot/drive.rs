//! The drive: what lies between the reading of the encoders and the travel of the lines, on the side of the motors.
//!
//! A play there is a true backlash. While a motor turns round, nothing behind the play moves: y ← clamp(y, u − w, u + w) for a command u and a
//! half width w. (A play on the side of the snake lets it follow at half speed.) Commands and lines are compared as bends, u = Q⁺ x, with Q
//! of the nominal geometry, so that widths given in mm of travel become w / r there. A play of each backbone by itself comes first, then what acts
//! on the bend, then the gain of the command.
//!
//! The drive is a memory that the readings alone drive, exactly and in one pass. From a path of lines back to the readings,
//! the furthest command that leads there is taken, since a motor that moves has taken up its play.

use super::PerBackbone;
use super::history::{Motion, bouc_wen_after};
use super::mechanics::{Mechanics, Past};
use nalgebra::Vector2;

/// Plays that stand for a spread of widths.
///
/// Derived: chords of as many plays meet the parabola of an even spread to within 1/(4 · 5²) = 1 % of it.
pub const DRIVE_PLAYS: usize = 5;

/// Steps by which a command is found that leads to a line's travel.
///
/// Convention: an iteration cap; a play whose width is known takes one.
const MOST_STEPS: usize = 1000;

/// A step of the command below this ends the search, rad.
///
/// Convention: numerical.
const LEAST_STEP_RAD: f64 = 1e-13;

/// Step of differences by the bend, rad, and by q̃, mm.
///
/// Convention: numerical.
const DIFFERENCE: f64 = 1e-6;

/// A line that moves by less stands still, mm.
///
/// Convention: numerical; a thousandth of what any encoder resolves.
const STILL_MM: f64 = 1e-9;

/// The constants of a drive; none of it does anything at zero.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Drive {
    /// The share by which the bends of the lines are larger than those of the readings.
    pub gain: f64,
    /// Half the width of a backlash at each backbone, mm.
    pub backbone_half_mm: f64,
    /// Half the width of a backlash of the bend, mm at the backbones' circle; the mean of the widths where they are spread.
    pub bend_half_mm: f64,
    /// By which share that width grows for each radian of the bend behind it.
    pub growth_per_rad: f64,
    /// By which share widths differ from their mean at most: they are spread evenly.
    pub spread: f64,
    /// Where in that backlash a straight snake stands at rest, from its middle, in half widths.
    pub at_rest: Vector2<f64>,
    /// Half the gap of a friction that turns round gradually, mm at the backbones' circle.
    pub friction_half_mm: f64,
    /// The travel over which it does, mm.
    pub friction_travel_mm: f64,
}

/// Where a drive stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct DriveState {
    /// What the backbones' plays were given last, mm.
    reading_mm: PerBackbone,
    /// By how much that is ahead of what they pass on, mm.
    ahead_mm: PerBackbone,
    /// The bend that was commanded last, rad.
    commanded: Vector2<f64>,
    /// By how much that is ahead of what each play passes on, rad.
    plays: [Vector2<f64>; DRIVE_PLAYS],
    /// How much of the friction holds, and in which direction: a vector of length 1 at most.
    friction: Vector2<f64>,
}

impl Drive {
    /// Whether it passes readings on as they are.
    pub fn is_rigid(&self) -> bool {
        *self == Self { friction_travel_mm: self.friction_travel_mm, ..Self::default() }
    }

    /// Where the plays and the friction stand after a command u (rad) on a circle of this radius (mm), and what they hold back of it, rad.
    fn held(&self, state: &DriveState, u: Vector2<f64>, radius_mm: f64) -> (DriveState, Vector2<f64>) {
        let moved = u - state.commanded;
        let behind = state.commanded - self.of_plays(state, radius_mm);
        let half = self.bend_half_mm / radius_mm * (1.0 + self.growth_per_rad * behind.norm());
        let mut next = DriveState { commanded: u, ..*state };
        for (j, play) in next.plays.iter_mut().enumerate() {
            // In the middle of as many equal parts of the spread, −1 to 1.
            let place = (2 * j + 1) as f64 / DRIVE_PLAYS as f64 - 1.0;
            *play = super::Play::crossed_by_vector(*play, moved, half * (1.0 + self.spread * place));
        }
        if self.friction_half_mm > 0.0 {
            next.friction = bouc_wen_after(state.friction, moved, self.friction_travel_mm / radius_mm);
        }
        (next, self.holds_back(&next, radius_mm))
    }

    /// By how much a command is ahead of what the plays pass on, rad: nothing at rest, wherever in its play the snake then stands.
    fn of_plays(&self, state: &DriveState, radius_mm: f64) -> Vector2<f64> {
        mean(&state.plays) - self.at_rest * (self.bend_half_mm / radius_mm)
    }

    /// By how much it is ahead of what is passed on in all, rad.
    fn holds_back(&self, state: &DriveState, radius_mm: f64) -> Vector2<f64> {
        self.of_plays(state, radius_mm) + state.friction * (self.friction_half_mm / radius_mm)
    }

    /// The furthest command (rad) in the direction of the motion of which this (rad) is passed on.
    fn command(&self, state: &DriveState, passed: Vector2<f64>, radius_mm: f64) -> Vector2<f64> {
        let step = passed - (state.commanded - self.holds_back(state, radius_mm));
        let length = step.norm();
        if length * radius_mm < STILL_MM {
            return state.commanded;
        }
        let behind = (state.commanded - self.of_plays(state, radius_mm)).norm();
        let widest_mm =
            self.bend_half_mm * ((1.0 + self.growth_per_rad * behind) * (1.0 + self.spread) + self.at_rest.norm());
        let mut u = passed + step * ((widest_mm + self.friction_half_mm) / (radius_mm * length));
        for _ in 0..MOST_STEPS {
            let next = passed + self.held(state, u, radius_mm).1;
            let moved = (next - u).norm();
            u = next;
            if moved < LEAST_STEP_RAD {
                break;
            }
        }
        u
    }
}

fn mean(plays: &[Vector2<f64>; DRIVE_PLAYS]) -> Vector2<f64> {
    plays.iter().sum::<Vector2<f64>>() / DRIVE_PLAYS as f64
}

impl Mechanics<'_> {
    /// The drive of a straight snake at rest.
    pub(super) fn drive_at_rest(&self) -> DriveState {
        let nothing = self.alike(0.0);
        let stands =
            self.drive.map_or_else(Vector2::zeros, |drive| drive.at_rest * drive.bend_half_mm) / self.radius_mm();
        DriveState {
            reading_mm: self.travel(Vector2::zeros(), Past::Pose(nothing)),
            ahead_mm: nothing,
            commanded: Vector2::zeros(),
            plays: [stands; DRIVE_PLAYS],
            friction: Vector2::zeros(),
        }
    }

    /// The lines' travel that a reading (mm, less the encoders' own errors) leads to.
    pub(super) fn driven(&self, state: &mut DriveState, reading_mm: &PerBackbone) -> PerBackbone {
        let Some(drive) = &self.drive else { return *reading_mm };
        let half = drive.backbone_half_mm;
        let ahead = state.ahead_mm + (*reading_mm - state.reading_mm);
        (state.ahead_mm, state.reading_mm) = (ahead.map(|ahead| ahead.clamp(-half, half)), *reading_mm);
        let passed_mm = *reading_mm - state.ahead_mm;
        let u = self.bend_by_q.tr_mul(&passed_mm);
        let (next, held) = drive.held(state, u, self.radius_mm());
        *state = next;
        passed_mm + self.statics.robot().displacement_by_bend() * ((u - held) * (1.0 + drive.gain) - u)
    }

    /// The reading (mm, less the encoders' own errors) that leads to a travel of the lines.
    pub(super) fn driving(&self, state: &mut DriveState, line_mm: &PerBackbone) -> PerBackbone {
        let Some(drive) = &self.drive else { return *line_mm };
        let bend = self.bend_by_q.tr_mul(line_mm);
        let u = drive.command(state, bend / (1.0 + drive.gain), self.radius_mm());
        let passed_mm = *line_mm + self.statics.robot().displacement_by_bend() * (u - bend);
        let moved = passed_mm - (state.reading_mm - state.ahead_mm);
        let ahead_mm = moved.zip_map(&state.ahead_mm, |moved, ahead| {
            if moved.abs() > STILL_MM { drive.backbone_half_mm * moved.signum() } else { ahead }
        });
        let reading_mm = passed_mm + ahead_mm;
        self.driven(state, &reading_mm);
        reading_mm
    }

    /// By how much each reading of a path is ahead of the lines, mm; nothing where the drive is rigid.
    pub(super) fn ahead_along(&self, q_tilde: &[PerBackbone]) -> Option<Vec<PerBackbone>> {
        self.drive?;
        let mut state = self.drive_at_rest();
        let ahead = |q: &PerBackbone| {
            let reading_mm = *q - self.encoder_errors(q);
            reading_mm - self.driven(&mut state, &reading_mm)
        };
        Some(q_tilde.iter().map(ahead).collect())
    }

    /// The lines' travel at a reading, mm: along a path, or of a snake that came from rest.
    pub(super) fn line_of(&self, q_tilde: &PerBackbone, past: Past) -> PerBackbone {
        let reading_mm = *q_tilde - self.encoder_errors(q_tilde);
        match past {
            _ if self.drive.is_none() => reading_mm,
            Past::Path(motion) => reading_mm - motion.ahead_mm,
            Past::Pose(_) => self.driven(&mut self.drive_at_rest(), &reading_mm),
        }
    }

    /// The reading of a travel of the lines, mm, less the encoders' own errors.
    pub(super) fn reading_of(&self, line_mm: &PerBackbone, motion: Option<&Motion>) -> PerBackbone {
        match motion {
            _ if self.drive.is_none() => *line_mm,
            Some(motion) => *line_mm + motion.ahead_mm,
            None => self.driving(&mut self.drive_at_rest(), line_mm),
        }
    }

    /// ∂(q̃ less the encoders' own errors)/∂b of a single pose, mm per rad; by differences where there is a drive.
    pub(super) fn reading_by_bend(&self, bend: Vector2<f64>) -> PerBackbone<Vector2<f64>> {
        if self.drive.is_none() {
            return self.line_by_bend(bend, self.pose(bend));
        }
        let reading = |bend: Vector2<f64>| self.reading_of(&self.travel(bend, self.pose(bend)), None);
        let slope = |axis| {
            let step = Vector2::ith(axis, DIFFERENCE);
            (reading(bend + step) - reading(bend - step)) / (2.0 * DIFFERENCE)
        };
        PerBackbone::from_columns([0, 1].map(slope))
    }

    /// The derivative of something by the reading at a single pose, by columns, from that by the lines' travel.
    pub(super) fn behind_the_drive(
        &self,
        bend: Vector2<f64>,
        by_line: &PerBackbone<Vector2<f64>>,
    ) -> PerBackbone<Vector2<f64>> {
        if self.drive.is_none() {
            return *by_line;
        }
        let reading_mm = self.reading_of(&self.travel(bend, self.pose(bend)), None);
        let line = |reading_mm: PerBackbone| self.driven(&mut self.drive_at_rest(), &reading_mm);
        PerBackbone::from_fn(reading_mm.len(), |i| {
            let step = PerBackbone::ith(reading_mm.len(), i) * DIFFERENCE;
            by_line.tr_mul(&((line(reading_mm + step) - line(reading_mm - step)) / (2.0 * DIFFERENCE)))
        })
    }

    /// The radius of the backbones' circle, mm.
    fn radius_mm(&self) -> f64 {
        self.statics.robot().backbone_circle_radius_mm
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::effects::physics;
    use crate::robot::{Effect, Model};

    /// A model of these effects.
    fn model(effects: &[(&str, &str, &[f64])]) -> Model {
        let effect = |(name, form, values): &(&str, &str, &[f64])| {
            let physics = crate::robot::effects::forms(name).find(|physics| physics.form == *form).unwrap();
            Effect::of(physics, values.to_vec())
        };
        Model { effects: effects.iter().map(effect).collect(), ..Model::default() }
    }

    /// To and fro in one plane with amplitudes that differ, and the same around.
    fn commands() -> Vec<Vector2<f64>> {
        let phase = |k: usize| 0.05 * k as f64;
        (0..400)
            .map(|k| Vector2::new(phase(k).sin() * (0.6 + 0.001 * k as f64), 0.3 * (0.7 * phase(k)).sin()))
            .collect()
    }

    #[test]
    fn a_backlash_of_the_bend_in_one_plane_is_the_clamp_of_its_equation() {
        let model = model(&[("backlash", "", &[0.3])]);
        let mechanics = Mechanics::new(&model);
        let (q, half) = (model.robot.displacement_by_bend(), 0.3 / model.robot.backbone_circle_radius_mm);
        let (mut state, mut y) = (mechanics.drive_at_rest(), 0.0f64);
        for u in commands().into_iter().map(|u| u.x) {
            y = y.clamp(u - half, u + half);
            let line = mechanics.driven(&mut state, &(q * Vector2::new(u, 0.0)).add_scalar(0.2));
            assert!((line - (q * Vector2::new(y, 0.0)).add_scalar(0.2)).amax() < 1e-12);
        }
    }

    #[test]
    fn a_backlash_that_is_wider_to_one_side_holds_on_longer_there() {
        let model = model(&[("backlash", "wider to one side", &[0.3, 0.4, 0.0])]);
        let mechanics = Mechanics::new(&model);
        let (q, half) = (model.robot.displacement_by_bend(), 0.3 / model.robot.backbone_circle_radius_mm);
        let (mut state, mut y) = (mechanics.drive_at_rest(), 0.0f64);
        for u in commands().into_iter().map(|u| u.x) {
            y = y.clamp(u - 0.6 * half, u + 1.4 * half);
            assert!(
                (mechanics.driven(&mut state, &(q * Vector2::new(u, 0.0))) - q * Vector2::new(y, 0.0)).amax() < 1e-12
            );
        }
    }

    #[test]
    fn a_gain_multiplies_the_bend_and_leaves_the_common_part() {
        let model = model(&[("command_gain", "", &[1.5])]);
        let q = model.robot.displacement_by_bend();
        let line =
            Mechanics::new(&model).line_of(&(q * Vector2::new(0.2, -0.1)).add_scalar(0.3), Past::Pose(q.column(0)));
        assert!((line - (q * Vector2::new(0.5, -0.25)).add_scalar(0.3)).amax() < 1e-12);
    }

    #[test]
    fn readings_that_a_path_of_lines_asks_for_lead_along_it() {
        let cases: [&[(&str, &str, &[f64])]; 7] = [
            &[("backlash", "", &[0.3])],
            &[("backlash", "per backbone", &[0.2])],
            &[("backlash", "grows with the bend", &[0.2, 1.0])],
            &[("backlash", "spread widths", &[0.3, 0.8])],
            &[("backlash", "wider to one side", &[0.3, 0.4, -0.2])],
            &[("bouc_wen", "of the command", &[0.4, 0.3])],
            &[("backlash", "spread widths", &[0.3, 0.5]), ("command_gain", "", &[0.8])],
        ];
        for case in cases {
            let model = model(case);
            let mechanics = Mechanics::new(&model);
            let (mut there, mut back) = (mechanics.drive_at_rest(), mechanics.drive_at_rest());
            let rest = mechanics.travel(Vector2::zeros(), Past::Pose(mechanics.alike(0.0)));
            for (k, bend) in commands().into_iter().enumerate() {
                let line = rest + model.robot.displacement_by_bend() * bend;
                let reading = mechanics.driving(&mut back, &line);
                let off = (mechanics.driven(&mut there, &reading) - line).amax();
                // Where the path hardly goes on, one of several plays gives way slowly: a thirtieth of what an encoder's noise hides.
                assert!(off < 5e-5, "{case:?} {k}: {off}");
            }
        }
    }

    #[test]
    fn a_rigid_drive_is_told() {
        assert!(Drive::default().is_rigid() && !Drive { gain: 0.1, ..Drive::default() }.is_rigid());
        assert!(physics("backlash").is_some_and(|physics| physics.is_hysteresis() && !physics.is_static()));
        assert!(physics("command_gain").is_some_and(|physics| !physics.is_hysteresis() && physics.is_static()));
    }
}
