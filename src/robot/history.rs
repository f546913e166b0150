//! How the snake got to where it is: what effects with a history need to know of its path.

use super::PerBackbone;

/// How the snake got to where it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// The direction in which each q_i last moved: −1 or 1, 0 where it never moved.
    pub direction: PerBackbone,
    /// q̇, mm/s, at the instant.
    pub speed_mm_per_s: PerBackbone,
    /// q̇, mm/s, from the sample before.
    pub speed_before_mm_per_s: PerBackbone,
    /// Where q stands in a play that it has to cross, mm from the play's middle.
    pub play_mm: PerBackbone,
    /// The load that a creeping line has followed so far, N: τ once the creep has ended.
    pub crept_load_n: PerBackbone,
    /// Time since the first reading, s.
    pub elapsed_s: f64,
}

impl Motion {
    /// Of a snake of so many backbones that never moved and bore no load.
    pub fn none(backbones: usize) -> Self {
        let zero = PerBackbone::repeat(backbones, 0.0);
        Self {
            direction: zero,
            speed_mm_per_s: zero,
            speed_before_mm_per_s: zero,
            play_mm: zero,
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
    /// Half the width of a play that q has to cross at a reversal, mm.
    pub half_play_mm: Option<f64>,
    /// Whether the speed matters: then a path feeds back on itself.
    pub speed: bool,
    /// Whether the direction of the motion matters.
    pub direction: bool,
}

impl History {
    /// Whether more of the path matters than the direction of the motion.
    pub fn is_long(&self) -> bool {
        self.creep_time_constant_s.is_some() || self.half_play_mm.is_some() || self.speed
    }
}
