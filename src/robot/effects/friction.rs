//! Play and friction: what depends on the load's direction or the motion's.

use super::{Acts, ParameterSpec, Physics, smooth_sign};
use nalgebra::Vector3;

/// Play that the load takes up: each backbone's line sits at the end of its play that its force presses it to.
pub(super) static LOAD_DIRECTED_BACKLASH: Physics = Physics {
    name: "load_directed_backlash",
    equation: "ε_i += a tanh(τ_i / 0.3 N)",
    reading: "play in the actuators that is taken up in the direction of each backbone's load",
    parameters: &[ParameterSpec { name: "play_mm", unit: "mm", range: (-1.0, 1.0), typical: 0.05 }],
    starts: &[&[0.0]],
    acts: Acts::Line(|at, p| at.tau_n.map(|tau| p[0] * smooth_sign(tau))),
};

/// Play that the motion takes up. s_i is the direction in which q_i last moved.
pub(super) static MOTION_DIRECTED_BACKLASH: Physics = Physics {
    name: "motion_directed_backlash",
    equation: "ε_i += a s_i, s_i = ±1 the direction in which q_i last moved",
    reading: "play in the actuators that is crossed whenever a backbone reverses; half the gap at a reversal",
    parameters: &[ParameterSpec { name: "half_gap_mm", unit: "mm", range: (-1.0, 1.0), typical: 0.05 }],
    starts: &[&[0.0]],
    acts: Acts::Line(|at, p| at.motion.direction * p[0]),
};

/// Friction in the disks' holes: a share of the backbone's own force, against the motion.
pub(super) static DISC_FRICTION: Physics = Physics {
    name: "disc_friction",
    equation: "ε_i += κ c |τ_i| s_i",
    reading: "friction between backbones and disks: a share of each backbone's force, always against its motion",
    parameters: &[ParameterSpec { name: "coefficient", unit: "1", range: (-2.0, 2.0), typical: 0.05 }],
    starts: &[&[0.0]],
    acts: Acts::Line(|at, p| {
        at.tau_n.abs().component_mul(&at.motion.direction) * (p[0] * at.snake.line_compliance_mm_per_n)
    }),
};

/// Friction in the cone turns round with the motion: where τ_i and the motion agree the actuator pushes harder than the
/// backbone by the capstan factor, where they differ it pushes less; f_s acts against the motion.
pub(super) static CONE_FRICTION_REVERSAL: Physics = Physics {
    name: "cone_friction_reversal",
    equation: "ε_i += w K_c⁻¹ [(η τ_i + s_i f_s) e^{2μφ s_i sign τ_i} − (η τ_i + f_s) e^{2μφ}]",
    reading: "friction in the snake cone that turns round with the motion instead of always adding (w = 1: all of it)",
    parameters: &[ParameterSpec { name: "share", unit: "1", range: (-3.0, 5.0), typical: 0.5 }],
    starts: &[&[0.0]],
    acts: Acts::Line(|at, p| {
        let snake = at.snake;
        Vector3::from_fn(|i, _| {
            let (force, along) = (snake.eta * at.tau_n[i], at.motion.direction[i]);
            let following = (force + along * snake.static_force_n)
                * (snake.capstan_exponent * along * smooth_sign(at.tau_n[i])).exp();
            let paper = (force + snake.static_force_n) * snake.capstan_exponent.exp();
            p[0] * snake.cone_compliance_mm_per_n * (following - paper)
        })
    }),
};
