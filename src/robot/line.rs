//! The actuation line between the actuators and the snake: what it takes up of the actuators' travel, Eq. 12, 13, 16 and 17.
//!
//! A backbone that pushes the snake with η τ_i is pushed with τ̃_i = (η τ_i + f_s) e^{2μφ} behind the cone (Eq. 13). It is compressed by
//! η τ_i / K_d in the holder and by τ̃_i / K_c in the cone (Eq. 16), so that
//!
//! ```text
//! ε_i = κ η τ_i + K_c⁻¹ e^{2μφ} f_s + λ,      κ = K_d⁻¹ + e^{2μφ} K_c⁻¹
//! ```
//!
//! which is Eq. 18 backbone by backbone.

use super::{Friction, Robot};
use nalgebra::Vector2;

/// The line's constants, and η and λ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// η, which scales the snake's actuation forces.
    pub eta: f64,
    /// λ, mm.
    pub lambda_mm: f64,
    /// κ = K_d⁻¹ + e^{2μφ} K_c⁻¹, mm/N: how much of q̃ the line takes up per newton of τ.
    pub compliance_mm_per_n: f64,
    /// K_c⁻¹, mm/N.
    pub cone_compliance_mm_per_n: f64,
    /// f_s, N.
    pub static_force_n: f64,
    /// 2μφ.
    pub capstan_exponent: f64,
    /// K_c⁻¹ e^{2μφ} f_s, mm: what static friction adds to every backbone.
    pub static_friction_mm: f64,
}

impl Line {
    /// The line of a robot with a cone of this friction; `x` is (η, λ in mm).
    pub fn new(robot: &Robot, friction: &Friction, x: Vector2<f64>) -> Self {
        let phi = robot.line.cone_bend_angle();
        let cone_compliance_mm_per_n = robot.cone_compliance_mm_per_n();
        let behind_cone_mm_per_n = friction.capstan_factor(phi) * cone_compliance_mm_per_n;
        Self {
            eta: x.x,
            lambda_mm: x.y,
            compliance_mm_per_n: robot.holder_compliance_mm_per_n() + behind_cone_mm_per_n,
            cone_compliance_mm_per_n,
            static_force_n: friction.static_force_n,
            capstan_exponent: 2.0 * friction.mu * phi,
            static_friction_mm: behind_cone_mm_per_n * friction.static_force_n,
        }
    }
}
