//! Compensation: ε of Eq. 16–18, what to command (Eq. 23), the updated Jacobian (Eq. 24–26) and the forward problem of a model.
//!
//! # ε and its derivatives
//!
//! Without effects ε is linear in x = (η, λ), and a sum of terms:
//!
//! ```text
//! ε(ψ) = ε_0 + H(ψ) x,     H = [ κ τ(ψ)   1 ],     ε_0 = K_c⁻¹ e^{2μφ} f_s 1,     κ = K_d⁻¹ + e^{2μφ} K_c⁻¹
//! ```
//!
//! (The paper's Eq. 20 prints K_d τ and K_c τ where Eq. 18 needs the inverses.) Effects add to it or change its constants; all that
//! is here obeys them as they act on a single pose (see [`mechanics`](super::mechanics)).
//!
//! The α(ψ) that the paper leaves open follows from [statics](super::statics): with τ = Q (QᵗQ)⁻¹ ∇_b E,
//!
//! ```text
//! ∂ε/∂b = η κ Q (QᵗQ)⁻¹ H_E(b),      α = ∂ε/∂ψ = ∂ε/∂b · ∂b/∂ψ
//! ```
//!
//! with H_E the Hessian of the elastic energy. Eq. 26 in b is (I + Q⁺ ∂ε/∂b)⁻¹ Q⁺, and for ψ it is that, turned by
//! (∂b/∂ψ)⁻¹: the two inverses of Eq. 26 combine into one 2×2 that is regular at θ = 0.
//!
//! The model answers up to θ = 120° ([`MAX_THETA`]). The paper's experiments end below 90°; the margin lets a command or a
//! noisy reading near that end have an answer, and beyond it nothing was ever checked.

use super::PerBackbone;
use super::kinematics::{MAX_THETA, bend_by_configuration, configuration_by_bend};
use super::line::Line;
use super::mechanics::Mechanics;
use super::model::Model;
use crate::error::{NoSolution, Result};
use crate::geometry::Configuration;
use nalgebra::{Matrix2, Vector2};

/// What a bent snake does for a given q̃.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Response {
    /// θ and δ.
    pub configuration: Configuration,
    /// c, the part of q̃ that bends nothing and that the model does not explain, mm.
    pub residual_mm: PerBackbone,
    /// The mean of c: the part of q̃ common to all backbones that the model does not explain, mm.
    pub common_mm: f64,
    /// The internal force that goes with it in each backbone, N; positive compresses.
    pub internal_force_n: f64,
}

impl Model {
    /// The actuation line, without effects.
    pub fn line(&self) -> Line {
        Line::new(&self.robot, &self.friction, self.parameters())
    }

    /// κ = K_d⁻¹ + e^{2μφ} K_c⁻¹, mm/N: how much of q̃ the line takes up per newton of τ (Eq. 16, 17).
    pub fn line_compliance_mm_per_n(&self) -> f64 {
        self.line().compliance_mm_per_n
    }

    /// K_c⁻¹ e^{2μφ} f_s, mm: what static friction adds to every backbone.
    pub fn static_friction_mm(&self) -> f64 {
        self.line().static_friction_mm
    }

    /// ε_0, mm: the terms of Eq. 18 that x = (η, λ) does not multiply.
    pub fn epsilon_fixed(&self) -> PerBackbone {
        PerBackbone::repeat(self.robot.backbone_count(), self.static_friction_mm())
    }

    /// H = ∂ε/∂(η, λ) at a bend vector, mm: a row block of Eq. 20.
    pub fn epsilon_by_parameters(&self, bend: Vector2<f64>) -> PerBackbone<Vector2<f64>> {
        Mechanics::new(self).epsilon_by_parameters(bend)
    }

    /// ∂ε/∂b at a bend vector, mm per rad.
    pub fn epsilon_by_bend(&self, bend: Vector2<f64>) -> PerBackbone<Vector2<f64>> {
        let mechanics = Mechanics::new(self);
        mechanics.reading_by_bend(bend) - self.robot.displacement_by_bend()
    }

    /// Eq. 18: ε = q̃ − q at a bend vector, mm.
    pub fn epsilon_at(&self, bend: Vector2<f64>) -> PerBackbone {
        Mechanics::new(self).command(bend, None) - self.robot.displacement_by_bend() * bend
    }

    /// Eq. 18: ε(ψ), mm.
    pub fn epsilon(&self, psi: Configuration) -> PerBackbone {
        self.epsilon_at(psi.bend_vector())
    }

    /// Eq. 25: α(ψ) = ∂ε/∂(θ, δ), mm per rad.
    pub fn alpha(&self, psi: Configuration) -> PerBackbone<Vector2<f64>> {
        self.epsilon_by_bend(psi.bend_vector()) * bend_by_configuration(psi)
    }

    /// Eq. 23: q̃ = q + ε, mm, what to command so that the snake takes a configuration.
    pub fn command(&self, psi: Configuration) -> PerBackbone {
        Mechanics::new(self).command(psi.bend_vector(), None)
    }

    /// Eq. 26 for the bend vector: ∂b/∂q̃, by columns, rad per mm. Smooth at θ = 0.
    ///
    /// # Errors
    /// [`NoSolution::Singular`] where the model's derivative is singular, which no η > 0 makes it.
    pub fn updated_jacobian_bend(&self, bend: Vector2<f64>) -> Result<PerBackbone<Vector2<f64>>> {
        let mechanics = Mechanics::new(self);
        let by_line = mechanics
            .bend_by_line(&mechanics.line_by_bend(bend, mechanics.pose(bend)))
            .ok_or_else(|| NoSolution::Singular { theta_deg: bend.norm().to_degrees(), eta: self.parameters().x })?;
        let by_reading = mechanics.travel_by_reading(&mechanics.command(bend, None));
        let by_line = mechanics.behind_the_drive(bend, &by_line);
        Ok(by_line.zip_map(&by_reading, |column, by_reading| column * by_reading))
    }

    /// Eq. 26: J̃_ψq = (I + J_ψq α)⁻¹ J_ψq = ∂(θ, δ)/∂q̃, by columns, rad per mm.
    ///
    /// # Errors
    /// [`NoSolution::Straight`] at θ = 0, where δ is not defined; use [`updated_jacobian_bend`](Self::updated_jacobian_bend) there.
    pub fn updated_jacobian(&self, psi: Configuration) -> Result<PerBackbone<Vector2<f64>>> {
        let turn = polar(psi)?;
        Ok(self.updated_jacobian_bend(psi.bend_vector())?.map(|column| turn * column))
    }

    /// The configuration that a q̃ (mm) leads to, and what the redundancy takes up.
    ///
    /// # Errors
    /// [`NoSolution::BeyondWorkspace`] for a q̃ that is not finite, or that would bend the snake beyond [`MAX_THETA`].
    pub fn forward(&self, q_tilde_mm: &PerBackbone) -> Result<Response> {
        // Several bends may answer to effects, such as a steep screw's: the one near the paper's model's is meant.
        let start = match self.effects.is_empty() {
            true => Vector2::zeros(),
            false => self.plain().forward_bend(q_tilde_mm)?,
        };
        let (bend, residual_mm) = self.forward_from(q_tilde_mm, start)?;
        Ok(Response {
            configuration: Configuration::from_bend_vector(bend),
            residual_mm,
            common_mm: residual_mm.mean(),
            internal_force_n: residual_mm.mean() / self.line_compliance_mm_per_n(),
        })
    }

    /// The bend vector (rad) that a q̃ (mm) leads to.
    ///
    /// # Errors
    /// As [`forward`](Self::forward).
    pub fn forward_bend(&self, q_tilde_mm: &PerBackbone) -> Result<Vector2<f64>> {
        Ok(self.forward_from(q_tilde_mm, Vector2::zeros())?.0)
    }

    fn forward_from(&self, q_tilde_mm: &PerBackbone, start: Vector2<f64>) -> Result<(Vector2<f64>, PerBackbone)> {
        let outside = || {
            NoSolution::BeyondWorkspace { q_mm: q_tilde_mm.iter().copied().collect(), most_deg: MAX_THETA.to_degrees() }
                .into()
        };
        // Also where a square of them overflows: against a tolerance without end anything would do.
        if !q_tilde_mm.norm().is_finite() {
            return Err(outside());
        }
        let found = Mechanics::new(self).solve(q_tilde_mm, None, start);
        // Effects with a direction jump where a q_i passes zero, and there the nearest bend is the answer.
        let answered = found.converged || !self.effects.is_empty();
        if answered && found.bend.norm() <= MAX_THETA { Ok((found.bend, found.residual_mm)) } else { Err(outside()) }
    }
}

/// (∂b/∂ψ)⁻¹, an error at θ = 0.
pub(super) fn polar(psi: Configuration) -> Result<Matrix2<f64>> {
    Ok(configuration_by_bend(psi).ok_or(NoSolution::Straight)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{Estimate, Friction};
    use proptest::prelude::*;
    use std::f64::consts::PI;

    fn paper() -> Model {
        let estimate =
            Estimate { eta: 1.221, lambda_mm: 0.1765, covariance: Matrix2::new(1e-4, 2e-6, 2e-6, 1e-6), samples: 10 };
        Model { friction: Friction::paper_printed(), ..Model::default() }.with_estimate(estimate)
    }

    fn any_configuration() -> impl Strategy<Value = Configuration> {
        (prop_oneof![Just(0.0), 0.0..1e-6f64, 0.0..1e-2f64, 0.0..MAX_THETA], -PI..PI)
            .prop_map(|(theta, delta)| Configuration { theta, delta })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(512))]

        #[test]
        fn alpha_is_the_derivative_of_epsilon(psi in any_configuration(), eta in 0.5..2.0f64) {
            let mut model = paper();
            model.eta = eta;
            let h = 1e-5;
            // θ − h may be negative: ε(b) with b = θ (cos δ, sin δ) continues smoothly through the straight snake.
            let epsilon = |theta: f64, delta: f64| model.epsilon_at(theta * Vector2::new(delta.cos(), delta.sin()));
            let numeric = PerBackbone::from_columns([
                (epsilon(psi.theta + h, psi.delta) - epsilon(psi.theta - h, psi.delta)) / (2.0 * h),
                (epsilon(psi.theta, psi.delta + h) - epsilon(psi.theta, psi.delta - h)) / (2.0 * h),
            ]);
            let alpha = model.alpha(psi);
            prop_assert!((numeric - alpha).norm() < 1e-8, "{numeric:?} {alpha:?}");
        }

        #[test]
        fn the_updated_jacobian_is_equation_26_and_inverts_the_command(psi in any_configuration()) {
            let model = paper();
            let h = 1e-5;
            let bend = psi.bend_vector();
            let q_tilde = |b: Vector2<f64>| model.robot.displacement_by_bend() * b + model.epsilon_at(b);
            let by_bend = PerBackbone::from_columns([0, 1].map(|axis| {
                let step = Vector2::ith(axis, h);
                (q_tilde(bend + step) - q_tilde(bend - step)) / (2.0 * h)
            }));
            let product = model.updated_jacobian_bend(bend).unwrap().cross_gram(&by_bend);
            prop_assert!((product - Matrix2::identity()).norm() < 1e-7);
            prop_assume!(psi.theta > 1e-4);
            let j = model.robot.jacobian_psi_q(psi).unwrap();
            let inverse = (Matrix2::identity() + j.cross_gram(&model.alpha(psi))).try_inverse().unwrap();
            let printed = j.map(|column| inverse * column);
            let ours = model.updated_jacobian(psi).unwrap();
            prop_assert!((printed - ours).norm() < 1e-9 * ours.norm());
        }

        #[test]
        fn forward_undoes_the_command_and_finds_the_common_part(
            psi in any_configuration(), common in -0.5..0.5f64, backbones in 3..9u8
        ) {
            prop_assume!(psi.theta < MAX_THETA - 1e-9);
            let mut model = paper();
            model.robot.backbones = backbones;
            let response = model.forward(&model.command(psi).add_scalar(common)).unwrap();
            prop_assert!((response.configuration.bend_vector() - psi.bend_vector()).norm() < 1e-11);
            prop_assert!((response.common_mm - common).abs() < 1e-11);
        }

        #[test]
        fn forward_answers_any_encoders_without_panic(q in proptest::array::uniform3(-1e3..1e3f64), eta in -3.0..5.0f64) {
            let mut model = paper();
            model.eta = eta;
            if let Ok(response) = model.forward(&PerBackbone::from(q)) {
                prop_assert!(response.configuration.theta <= MAX_THETA);
                let met = model.command(response.configuration).add_scalar(response.common_mm);
                let along = model.robot.bend_by_displacement().tr_mul(&(met - PerBackbone::from(q)));
                prop_assert!(along.norm() < 1e-6);
            }
        }
    }

    #[test]
    fn the_naive_model_is_section_iv() {
        // ε = K_d⁻¹ τ + K_c⁻¹ τ̃ with τ̃ = (τ + f_s) e^{2μφ}, backbone by backbone.
        let model = Model::default();
        let psi = Configuration::from_degrees(60.0, 25.0);
        let area = PI / 4.0 * (0.66f64.powi(2) - 0.5f64.powi(2));
        let phi = 41f64.to_radians();
        let tau = model.robot.actuation_forces(psi.bend_vector(), None);
        let expected = tau.map(|tau| {
            tau * 480.0 / (54_000.0 * area)
                + model.friction.actuation_force_n(tau, phi) * 40.0 * phi / (54_000.0 * area)
        });
        assert!((model.epsilon(psi) - expected).amax() < 1e-12);
    }

    #[test]
    fn epsilon_of_the_elastic_part_has_the_sign_of_q() {
        let model = Model::default();
        let psi = Configuration::from_degrees(60.0, 25.0);
        let q = model.robot.joint_displacements(psi);
        let elastic = model.epsilon(psi) - model.epsilon_fixed();
        assert!(q.component_mul(&elastic).iter().all(|&product| product > 0.0));
    }

    #[test]
    fn beyond_the_workspace_and_not_finite_are_errors() {
        let model = paper();
        let far = model.command(Configuration::from_degrees(125.0, 40.0));
        assert!(model.forward(&far).unwrap_err().to_string().contains("120°"));
        assert!(model.forward(&PerBackbone::from([f64::NAN, 0.0, 0.0])).is_err());
        assert!(model.forward(&PerBackbone::from([f64::INFINITY, 0.0, 0.0])).is_err());
        assert!(model.updated_jacobian(Configuration::new(0.0, 0.0)).is_err());
    }
}
