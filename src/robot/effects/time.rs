//! What depends on time and speed.

use super::{Acts, ParameterSpec, Physics};
use nalgebra::Vector3;

/// Everything warms up: a common drift.
pub(super) static THERMAL_DRIFT: Physics = Physics {
    name: "thermal_drift",
    equation: "ε_i += d t, the same for all i, t from the first reading",
    reading: "a slow drift that all backbones share, as of a machine that warms up",
    parameters: &[ParameterSpec { name: "rate_mm_per_s", unit: "mm/s", range: (-0.1, 0.1), typical: 0.0005 }],
    starts: &[&[0.0]],
    acts: Acts::Line(|at, p| Vector3::repeat(p[0] * at.motion.elapsed_s)),
};

/// The lines go on stretching for a while under load: a first-order lag beside the spring.
pub(super) static CREEP: Physics = Physics {
    name: "creep",
    equation: "ε_i += κ c x_i, T ẋ_i = τ_i − x_i, x = 0 at the first reading",
    reading: "lines that go on stretching for a while under load",
    parameters: &[
        ParameterSpec { name: "share", unit: "1", range: (-2.0, 2.0), typical: 0.05 },
        ParameterSpec { name: "time_constant_s", unit: "s", range: (0.05, 1000.0), typical: 0.5 },
    ],
    starts: &[&[0.02, 0.5], &[0.02, 2.0], &[0.02, 8.0], &[0.02, 30.0], &[0.02, 120.0]],
    acts: Acts::Line(|at, p| at.motion.relaxed_n * (p[0] * at.snake.line_compliance_mm_per_n)),
};

/// A drag on the backbones proportional to their speed.
pub(super) static VISCOUS_DRAG: Physics = Physics {
    name: "viscous_drag",
    equation: "ε_i += κ c q̇_i",
    reading: "a drag on the backbones that grows with their speed",
    parameters: &[ParameterSpec { name: "drag_n_s_per_mm", unit: "N·s/mm", range: (-20.0, 20.0), typical: 0.5 }],
    starts: &[&[0.0]],
    acts: Acts::Line(|at, p| at.motion.speed_mm_per_s * (p[0] * at.snake.line_compliance_mm_per_n)),
};
