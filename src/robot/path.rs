//! The forward problem along a path of readings, on which what came before matters.
//!
//! A path is a fold over its readings: each [step](Mechanics::step) takes the point before and a reading, and gives the next point. What an
//! effect remembers is part of the point. It advances within the step, with the bend that is being solved for, so that nothing is
//! repeated and nothing that comes later is needed.

use super::PerBackbone;
use super::directions::Previous;
use super::drive::DriveState;
use super::forward::{ForwardSolution, LineJacobian};
use super::history::Motion;
use super::mechanics::Mechanics;
use nalgebra::Vector2;

/// A point of a path: where a reading led and how the snake came there. The next reading depends on nothing else.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPoint {
    /// How the snake came there.
    pub motion: Motion,
    /// Where the reading led.
    pub solution: ForwardSolution,
    /// Time of the reading, s.
    time_s: f64,
    /// What the encoders read, less their own errors, mm.
    reading_mm: PerBackbone,
    /// Where the drive stands.
    drive: DriveState,
    /// The furthest q that each backbone came to in its direction, mm; kept only where directions matter.
    extreme_mm: PerBackbone,
}

impl Mechanics<'_> {
    /// The path that readings q̃ at these times lead along. `guess` is a path near it; without one, each bend is looked for near the one
    /// before. `first` is the bend that an eye measured at the first reading, where there is one: it tells which way the backbones
    /// had moved before.
    pub fn solve_path(
        &self,
        times_s: &[f64],
        q_tilde: &[PerBackbone],
        guess: Option<&[Vector2<f64>]>,
        first: Option<Vector2<f64>>,
    ) -> Vec<PathPoint> {
        let mut path: Vec<PathPoint> = Vec::with_capacity(q_tilde.len());
        for (k, q) in q_tilde.iter().enumerate() {
            path.push(self.step(path.last(), times_s[k], q, guess.map(|guess| guess[k]), first));
        }
        path
    }

    /// Where a reading leads after the point before it; `None` for the first reading. The bend is looked for near `near`, else near the
    /// one before. `first` is used at the first reading only.
    pub fn step(
        &self,
        before: Option<&PathPoint>,
        time_s: f64,
        q_tilde: &PerBackbone,
        near: Option<Vector2<f64>>,
        first: Option<Vector2<f64>>,
    ) -> PathPoint {
        let near = near.or(before.map(|before| before.solution.bend));
        let near = near.unwrap_or_else(|| self.solve(q_tilde, None, Vector2::zeros()).bend);
        let mut point = self.approach(before.copied(), time_s, q_tilde);
        let motion = point.motion;
        if !self.history.direction {
            point.solution = self.solve(q_tilde, Some(&motion), near);
            return point;
        }
        let solve_with =
            |direction: PerBackbone| (self.solve(q_tilde, Some(&Motion { direction, ..motion }), near), direction);
        let (solution, direction) = match before {
            None => self.first_direction(solve_with, self.away_from_straight(&self.statics.q_mm(near)), first),
            Some(before) => {
                self.next_direction(solve_with, &(point.reading_mm - before.reading_mm), &before.as_previous())
            }
        };
        point.solution = solution;
        point.motion.direction = direction;
        let q_mm = self.statics.q_mm(solution.bend);
        point.extreme_mm = Previous::extremes(before.map(PathPoint::as_previous).as_ref(), &q_mm, &direction);
        point
    }

    /// How the snake comes to a reading, as far as what came before and the reading itself tell; its bend is still the one before.
    fn approach(&self, before: Option<PathPoint>, time_s: f64, q_tilde: &PerBackbone) -> PathPoint {
        let mut point = match before {
            Some(before) => self.gone_on_to(before, time_s),
            None => self.at_rest(time_s),
        };
        point.reading_mm = *q_tilde - self.encoder_errors(q_tilde);
        if self.drive.is_some() {
            point.motion.ahead_mm = point.reading_mm - self.driven(&mut point.drive, &point.reading_mm);
        }
        point
    }

    /// A straight snake at rest when the first reading comes.
    fn at_rest(&self, time_s: f64) -> PathPoint {
        let zero = self.alike(0.0);
        PathPoint {
            motion: self.first_motion(),
            solution: ForwardSolution { bend: Vector2::zeros(), residual_mm: zero, converged: false },
            time_s,
            reading_mm: zero,
            drive: self.drive_at_rest(),
            extreme_mm: zero,
        }
    }

    /// A point led on to the time of the next reading.
    fn gone_on_to(&self, mut point: PathPoint, time_s: f64) -> PathPoint {
        if self.history.is_of_snake() {
            point.motion.before = self.behind(&point.motion, point.solution.bend);
        }
        point.motion.go_on(time_s - point.time_s);
        point.time_s = time_s;
        point
    }

    /// How a change of the model near a path changes what it predicts, to first order. `path` is the path of the unchanged model, and
    /// `jacobians` its derivatives there.
    pub fn perturbed_path(
        changed: &Mechanics,
        (times_s, q_tilde): (&[f64], &[PerBackbone]),
        (path, jacobians): (&[PathPoint], &[LineJacobian]),
    ) -> Vec<ForwardSolution> {
        let mut before = None;
        let follow = |(k, near): (usize, (&PathPoint, &LineJacobian))| {
            let point = changed.step_near(before.take(), times_s[k], &q_tilde[k], near);
            before = Some(point);
            point.solution
        };
        path.iter().zip(jacobians).enumerate().map(follow).collect()
    }

    /// Where a reading leads by this model if it leads to `near`, with its derivative there, by one that is hardly another.
    ///
    /// Nothing is solved anew: at the bend of the other model this one leaves a misfit, and the derivative says which step of the bend
    /// takes it up. `before` is this model's own point, so that what it remembers follows its own path.
    pub(super) fn step_near(
        &self,
        before: Option<PathPoint>,
        time_s: f64,
        q_tilde: &PerBackbone,
        (near, jacobian): (&PathPoint, &LineJacobian),
    ) -> PathPoint {
        let mut point = self.approach(before, time_s, q_tilde);
        point.motion.direction = near.motion.direction;
        point.solution = self.one_step(q_tilde, &point.motion, &near.solution, jacobian);
        point
    }

    /// One Newton step from a solution, with a derivative that is nearly this model's.
    fn one_step(
        &self,
        q_tilde: &PerBackbone,
        motion: &Motion,
        near: &ForwardSolution,
        jacobian: &LineJacobian,
    ) -> ForwardSolution {
        let misfit = self.misfit_mm(q_tilde, near.bend, motion);
        let step = jacobian.bend_by_line.tr_mul(&misfit);
        let residual = (misfit - jacobian.line_by_bend * step).component_div(&self.travel_by_reading(q_tilde));
        ForwardSolution {
            bend: near.bend + step,
            residual_mm: self.internal_part(&residual),
            converged: near.converged,
        }
    }
}

impl PathPoint {
    /// What is known of the directions when the next reading comes.
    fn as_previous(&self) -> Previous {
        Previous {
            direction: self.motion.direction,
            extreme_mm: self.extreme_mm,
            residual_mm: self.solution.residual_mm,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Configuration;
    use crate::robot::Model;
    use crate::robot::effects::LIBRARY;
    use crate::robot::model::fixtures::with_example;

    /// Up and down between 5° and 75° in a slowly turning plane, at uneven times.
    fn sweep() -> (Vec<f64>, Vec<Vector2<f64>>) {
        (0..60)
            .map(|k| {
                let phase = f64::from(k);
                let theta = 5.0 + 70.0 * (phase / 15.0 * std::f64::consts::PI).sin().powi(2);
                let bend = Configuration::from_degrees(theta, 40.0 + 0.3 * phase).bend_vector();
                (0.3 * phase + 0.1 * (phase * 0.7).sin(), bend)
            })
            .unzip()
    }

    /// How far the path that the commands of a sweep lead along is from the sweep, at the worst, rad.
    fn furthest_from_the_path(model: &Model) -> f64 {
        let (times, bends) = sweep();
        let mechanics = Mechanics::new(model);
        let motions = mechanics.motions(&times, &bends);
        let q: Vec<_> = bends.iter().zip(&motions).map(|(b, m)| mechanics.command(*b, Some(m))).collect();
        let path = mechanics.solve_path(&times, &q, None, None);
        path.iter().zip(&bends).map(|(point, b)| (point.solution.bend - b).norm()).fold(0.0, f64::max)
    }

    #[test]
    fn the_path_that_a_command_leads_along_is_the_one_it_was_made_for() {
        let more_backbones = LIBRARY.iter().filter(|physics| physics.form.is_empty()).map(|physics| (4, physics));
        for (backbones, physics) in LIBRARY.iter().map(|physics| (3, physics)).chain(more_backbones) {
            let model = with_example(physics, backbones, 1.0);
            let worst = furthest_from_the_path(&model);
            assert!(worst < 1e-8, "{} {} on {backbones}: {worst} rad", physics.name, physics.form);
        }
    }

    #[test]
    fn a_small_change_of_a_parameter_changes_the_path_as_solving_anew_does() {
        let (times, bends) = sweep();
        for physics in LIBRARY {
            let model = with_example(physics, 3, 1.0);
            let mechanics = Mechanics::new(&model);
            let motions = mechanics.motions(&times, &bends);
            let q: Vec<_> = bends.iter().zip(&motions).map(|(b, m)| mechanics.command(*b, Some(m))).collect();
            let path = mechanics.solve_path(&times, &q, Some(&bends), Some(bends[0]));
            let jacobians: Vec<_> =
                path.iter().map(|point| mechanics.line_jacobian(point.solution.bend, &point.motion)).collect();
            let mut changed = model.clone();
            changed.effects[0].values[0] *= 1.001;
            let changed = Mechanics::new(&changed);
            let first_order = Mechanics::perturbed_path(&changed, (&times, &q), (&path, &jacobians));
            let anew = changed.solve_path(&times, &q, Some(&bends), Some(bends[0]));
            for (first_order, anew) in first_order.iter().zip(&anew) {
                let off = (first_order.bend - anew.solution.bend).norm();
                assert!(off < 2e-5, "{} {}: {off} rad", physics.name, physics.form);
            }
        }
    }

    #[test]
    fn play_is_crossed_at_a_reversal_and_nowhere_else() {
        let model = with_example(crate::robot::effects::physics("motion_directed_backlash").unwrap(), 3, 1.0);
        let mechanics = Mechanics::new(&model);
        let plain = model.plain();
        let thetas = [10.0, 20.0, 30.0, 20.0, 10.0];
        let bends: Vec<_> = thetas.iter().map(|&t| Configuration::from_degrees(t, 0.0).bend_vector()).collect();
        let motions = mechanics.motions(&[0.0, 1.0, 2.0, 3.0, 4.0], &bends);
        for (k, sign) in [-1.0, -1.0, -1.0, 1.0, 1.0].into_iter().enumerate() {
            let added = mechanics.command(bends[k], Some(&motions[k]))
                - plain.command(Configuration::from_bend_vector(bends[k]));
            let expected = PerBackbone::from([sign, -sign, -sign]) * 0.05;
            assert!((added - expected).norm() < 1e-9, "{k}: {added:?}");
        }
    }
}
