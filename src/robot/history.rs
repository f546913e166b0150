//! How the snake got to where it is: what effects with a history need to know of its path.

use super::PerBackbone;
use nalgebra::Vector2;

/// How the snake came to a reading: from where, in what time, in which directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// The direction in which each q_i last moved: −1 or 1, 0 where it never moved.
    pub direction: PerBackbone,
    /// Where it stood at the reading before.
    pub before: Before,
    /// Time since the reading before, s; 0 at the first one.
    pub step_s: f64,
    /// Time since the first reading, s.
    pub elapsed_s: f64,
    /// By how much the reading, less the encoders' own errors, is ahead of the lines, mm: what the drive holds back.
    pub ahead_mm: PerBackbone,
}

/// What a motion has come to at a bend: what effects with a history depend on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrival {
    /// Where q and the bend stand in whatever they have to cross at a reversal.
    pub hysteresis: Hysteresis,
    /// q̇, mm/s: the difference from the reading before by the time since; 0 at the first reading.
    pub speed_mm_per_s: PerBackbone,
    /// The load that a creeping line has followed so far, N: τ once the creep has ended.
    pub crept_load_n: PerBackbone,
}

/// Where q and the bend stand in the hystereses that they have to cross at a reversal; 0 is the middle of each.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hysteresis {
    /// Where q stands in each [play](PlayOf), mm.
    pub play_mm: [PerBackbone; PLAYS],
    /// Where the bend stands in each [play](BendPlayOf), rad.
    pub bend_play: [Vector2<f64>; BEND_PLAYS],
    /// How much of a Bouc–Wen friction holds each backbone, between −1 and 1.
    pub bouc_wen: PerBackbone,
    /// How much of one holds the bend, and in which direction: a vector of length 1 at most.
    pub bend_bouc_wen: Vector2<f64>,
}

impl Hysteresis {
    /// Of a snake of so many backbones, in the middle of all.
    pub fn at_rest(backbones: usize) -> Self {
        let zero = PerBackbone::repeat(backbones, 0.0);
        Self {
            play_mm: [zero; PLAYS],
            bend_play: [Vector2::zeros(); BEND_PLAYS],
            bouc_wen: zero,
            bend_bouc_wen: Vector2::zeros(),
        }
    }
}

/// Where the snake stood at the reading before: everything that effects with a history follow within the step from there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Before {
    /// q, mm.
    pub q_mm: PerBackbone,
    /// The bend from rest, rad.
    pub bend: Vector2<f64>,
    /// Where q and the bend stood in their hystereses.
    pub hysteresis: Hysteresis,
    /// The load that a creeping line had followed, N; `None` if its creep has ended under whatever load it bears.
    pub crept_load_n: Option<PerBackbone>,
}

impl Before {
    /// A snake of so many backbones at rest, without a load.
    pub fn at_rest(backbones: usize) -> Self {
        let zero = PerBackbone::repeat(backbones, 0.0);
        let hysteresis = Hysteresis::at_rest(backbones);
        Self { q_mm: zero, bend: Vector2::zeros(), hysteresis, crept_load_n: Some(zero) }
    }
}

impl Motion {
    /// Of a snake of so many backbones that never moved and bore no load.
    pub fn none(backbones: usize) -> Self {
        let zero = PerBackbone::repeat(backbones, 0.0);
        Self { direction: zero, before: Before::at_rest(backbones), step_s: 0.0, elapsed_s: 0.0, ahead_mm: zero }
    }

    /// Going on for so long.
    pub(super) fn go_on(&mut self, step_s: f64) {
        self.step_s = step_s.max(0.0);
        self.elapsed_s += step_s;
    }
}

/// What a model's effects need to know of the path, beside the bend and the time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct History {
    /// The time constant T of a creep that follows the load, s.
    pub creep_time_constant_s: Option<f64>,
    /// Whether the creep had ended under the first reading's load; else it begins there.
    pub creep_ended_before: bool,
    /// The plays that each q has to cross at a reversal, by [`PlayOf`].
    pub plays: [Option<Play>; PLAYS],
    /// Half the widths of the plays that the bend has to cross, by [`BendPlayOf`], mm of travel at the backbones' circle.
    pub half_bend_plays_mm: [Option<f64>; BEND_PLAYS],
    /// The travel over which a Bouc–Wen friction of each backbone turns round, mm.
    pub bouc_wen_travel_mm: Option<f64>,
    /// The same of the bend, mm of travel at the backbones' circle.
    pub bend_bouc_wen_travel_mm: Option<f64>,
    /// Whether the speed matters.
    pub speed: bool,
    /// Whether the direction of the motion matters.
    pub direction: bool,
    /// Whether the [drive](super::drive) has a memory.
    pub drive: bool,
}

/// Plays of one model: that in the actuators, that in the sheaths, those of a distributed friction, and those of up to
/// [`FORMULA_PLAYS`] formulas.
///
/// Derived: those with a place, and what formulas may have.
pub const PLAYS: usize = PlayOf::COUNT + FORMULA_PLAYS;

/// Plays that stand for a distributed friction.
///
/// Derived: the parabola that a reversal follows is met by chords to within 1/(4 · 4²) = 2 % of the friction.
pub const DISTRIBUTED_PLAYS: usize = 4;

/// Plays of the bend: one, and those of a distributed friction.
///
/// Derived: as it says.
pub const BEND_PLAYS: usize = BendPlayOf::Distributed as usize + DISTRIBUTED_PLAYS;

/// Formulas of one model that may have a play.
///
/// Convention: a resource limit: one of a user's own, one of a proposed law.
pub const FORMULA_PLAYS: usize = 2;

/// Where plays are: each has its own place in a history; those of formulas come after.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlayOf {
    /// In the actuators.
    Actuator,
    /// In the sheaths, where it grows with the load.
    Sheath,
    /// The first of those of a distributed friction.
    Distributed,
}

impl PlayOf {
    /// The number of places that are not of formulas.
    ///
    /// Derived: from the list above.
    pub(super) const COUNT: usize = Self::Distributed as usize + DISTRIBUTED_PLAYS;
}

/// Where plays of the bend are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BendPlayOf {
    /// Between the lines and the bend.
    Bend,
    /// The first of those of a distributed friction.
    Distributed,
}

/// Half the width of a play, which may grow with the load on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Play {
    /// Without a load, mm.
    pub half_mm: f64,
    /// What each newton of |τ| adds, mm/N.
    pub half_mm_per_n: f64,
}

impl Play {
    /// Where each q stands in its play after a motion, mm from the middle: it follows as far as the play is wide.
    pub fn crossed(stood_mm: PerBackbone, moved_mm: PerBackbone, half_mm: &PerBackbone) -> PerBackbone {
        (stood_mm + moved_mm).zip_map(half_mm, |x, half| x.clamp(-half, half))
    }

    /// The same of a vector, within a disk.
    pub fn crossed_by_vector(stood: Vector2<f64>, moved: Vector2<f64>, half: f64) -> Vector2<f64> {
        let followed = stood + moved;
        let size = followed.norm();
        if size > half { followed * (half / size) } else { followed }
    }
}

/// Half the widths of the plays of a distributed friction that is spread evenly up to the width `widest_mm`: in the middle of as many equal
/// parts of it, mm.
pub fn distributed_half_widths_mm(widest_mm: f64) -> [f64; DISTRIBUTED_PLAYS] {
    std::array::from_fn(|j| widest_mm * (j as f64 + 0.5) / DISTRIBUTED_PLAYS as f64)
}

/// A Bouc–Wen friction after a straight move, before which `held` of it held: dz/dx = (s − z) / travel, s being the move's direction.
///
/// Source: Wen 1976, Method for random vibration of hysteretic systems, J. Eng. Mech. Div. 102:249, with exponent 1 and β = γ, solved along
/// the move; for a vector its two-dimensional form.
pub fn bouc_wen_after(held: Vector2<f64>, moved: Vector2<f64>, travel: f64) -> Vector2<f64> {
    let length = moved.norm();
    if length == 0.0 {
        return held;
    }
    let direction = moved / length;
    direction + (held - direction) * (-length / travel).exp()
}

impl History {
    /// Whether what time does to the snake on its way matters: how fast it moves, how long it bears a load.
    pub fn goes_by_time(&self) -> bool {
        self.creep_time_constant_s.is_some() || self.speed
    }

    /// Whether a reading's bend depends on where the snake stood at the readings before it; what the drive remembers, the readings alone tell.
    pub fn is_of_snake(&self) -> bool {
        self.direction || self.goes_by_time() || self.has_hysteresis()
    }

    /// Gives the play of one formula more its place, if there is one left.
    pub(super) fn add_formula_play(&mut self, half_mm: f64) {
        if let Some(place) = self.plays[PlayOf::COUNT..].iter_mut().find(|place| place.is_none()) {
            *place = Some(Play { half_mm, half_mm_per_n: 0.0 });
        }
    }

    /// Whether there is any hysteresis that has to be crossed.
    pub fn has_hysteresis(&self) -> bool {
        self.plays.iter().any(Option::is_some)
            || self.half_bend_plays_mm.iter().any(Option::is_some)
            || self.bouc_wen_travel_mm.is_some()
            || self.bend_bouc_wen_travel_mm.is_some()
    }
}
