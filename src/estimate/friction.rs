//! What the errors of the friction constants do to η and λ.

use crate::robot::Model;
use nalgebra::Matrix2;

/// Covariance of (η, λ) that comes from the friction constants' own.
///
/// The measurements pin ηκ(μ) and λ + K_c⁻¹e^{2μφ}f_s; an error of μ or f_s moves η and λ so that these stay.
pub(super) fn friction_covariance(model: &Model, eta: f64) -> Matrix2<f64> {
    let by_friction = parameters_by_friction(model, eta);
    by_friction * model.friction.covariance() * by_friction.transpose()
}

/// ∂(η, λ)/∂(μ, f_s) along which the measurements stay as they are.
pub(super) fn parameters_by_friction(model: &Model, eta: f64) -> Matrix2<f64> {
    let phi = model.robot.line.cone_bend_angle();
    let capstan = model.friction.capstan_factor(phi) * model.robot.cone_compliance_mm_per_n();
    let static_mm = model.static_friction_mm();
    Matrix2::new(-eta * 2.0 * phi * capstan / model.line_compliance_mm_per_n(), 0.0, -2.0 * phi * static_mm, -capstan)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Configuration;
    use crate::robot::Friction;

    #[test]
    fn along_these_directions_commands_stay_as_they_are() {
        let with = |by_mu: f64, by_static: f64, eta: f64, lambda_mm: f64| {
            let friction = Friction::default();
            let friction =
                Friction { mu: friction.mu + by_mu, static_force_n: friction.static_force_n + by_static, ..friction };
            Model { friction, eta, lambda_mm, samples: Some(0), ..Model::default() }
        };
        let slope = parameters_by_friction(&with(0.0, 0.0, 1.221, 0.1765), 1.221);
        let step = 1e-5;
        for (axis, [mu, force]) in [[step, 0.0], [0.0, step]].into_iter().enumerate() {
            let moved = slope.column(axis) * step;
            for (theta_deg, delta_deg) in [(20.0, 0.0), (70.0, 100.0)] {
                let psi = Configuration::from_degrees(theta_deg, delta_deg);
                let command = |sign: f64| {
                    with(sign * mu, sign * force, 1.221 + sign * moved.x, 0.1765 + sign * moved.y).command(psi)
                };
                let left = (command(1.0) - command(-1.0)).norm() / (2.0 * step);
                assert!(left < 1e-6, "{left} mm per unit");
            }
        }
    }
}
