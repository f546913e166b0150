//! How the snake got to where it is: what effects with a history need to know of its path.

use super::PerBackbone;
use nalgebra::Vector2;

/// How the snake got to where it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// The direction in which each q_i last moved: −1 or 1, 0 where it never moved.
    pub direction: PerBackbone,
    /// q̇, mm/s, at the instant.
    pub speed_mm_per_s: PerBackbone,
    /// q̇, mm/s, from the sample before.
    pub speed_before_mm_per_s: PerBackbone,
    /// Where q stands in each [play](PlayOf) that it has to cross, mm from the play's middle.
    pub play_mm: [PerBackbone; PLAYS],
    /// Where the bend stands in a play that it has to cross, rad from the play's middle.
    pub bend_play: Vector2<f64>,
    /// From where the plays are crossed.
    pub before: Before,
    /// The load that a creeping line has followed so far, N: τ once the creep has ended.
    pub crept_load_n: PerBackbone,
    /// Time since the first reading, s.
    pub elapsed_s: f64,
}

/// Where the snake stood at the reading before, as plays need it: a play follows the bend within the step from there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Before {
    /// q, mm.
    pub q_mm: PerBackbone,
    /// The bend from rest, rad.
    pub bend: Vector2<f64>,
    /// Where q stood in each play, mm.
    pub play_mm: [PerBackbone; PLAYS],
    /// Where the bend stood in its play, rad.
    pub bend_play: Vector2<f64>,
}

impl Before {
    /// A snake of so many backbones at rest, in the middle of its plays.
    pub fn at_rest(backbones: usize) -> Self {
        let zero = PerBackbone::repeat(backbones, 0.0);
        Self { q_mm: zero, bend: Vector2::zeros(), play_mm: [zero; PLAYS], bend_play: Vector2::zeros() }
    }
}

impl Motion {
    /// Of a snake of so many backbones that never moved and bore no load.
    pub fn none(backbones: usize) -> Self {
        let zero = PerBackbone::repeat(backbones, 0.0);
        Self {
            direction: zero,
            speed_mm_per_s: zero,
            speed_before_mm_per_s: zero,
            play_mm: [zero; PLAYS],
            bend_play: Vector2::zeros(),
            before: Before::at_rest(backbones),
            crept_load_n: zero,
            elapsed_s: 0.0,
        }
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
    /// Half the width of a play that the bend has to cross, mm of travel at the backbones' circle.
    pub half_bend_play_mm: Option<f64>,
    /// Whether the speed matters: then a path feeds back on itself.
    pub speed: bool,
    /// Whether the direction of the motion matters.
    pub direction: bool,
}

/// Plays of one model: that in the actuators, that in the sheaths, and those of up to [`FORMULA_PLAYS`] formulas.
///
/// Derived: two, and what formulas may have.
pub const PLAYS: usize = PlayOf::COUNT + FORMULA_PLAYS;

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
}

impl PlayOf {
    /// The number of places with a name.
    ///
    /// Derived: from the list above.
    pub(super) const COUNT: usize = 2;
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
}

impl History {
    /// Whether more of the path matters than the direction of the motion and the reading before.
    pub fn is_long(&self) -> bool {
        self.creep_time_constant_s.is_some() || self.speed
    }

    /// Gives the play of one formula more its place, if there is one left.
    pub(super) fn add_formula_play(&mut self, half_mm: f64) {
        if let Some(place) = self.plays[PlayOf::COUNT..].iter_mut().find(|place| place.is_none()) {
            *place = Some(Play { half_mm, half_mm_per_n: 0.0 });
        }
    }

    /// Whether a play has to be crossed.
    pub fn has_play(&self) -> bool {
        self.plays.iter().any(Option::is_some) || self.half_bend_play_mm.is_some()
    }
}
