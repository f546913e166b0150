//! Statics: the elastic energy of the bent backbones and the forces that hold them, Eq. 9–11.
//!
//! Between base and end disk the backbones bend alike, through θ, each over its own length:
//!
//! ```text
//! E = E_p I_p θ² / (2 L) + Σ_i E_s I_s θ² / (2 L_i),      L_i = L + q_i = L + k_i·b,   k_i = row i of Q
//! ```
//!
//! All of it is a smooth function of the bend vector b, and so are ∇E and the Hessian H below:
//!
//! ```text
//! ∇E = (E_p I_p/L + Σ E_s I_s/L_i) b − Σ E_s I_s θ²/(2 L_i²) k_i
//! H  = (E_p I_p/L + Σ E_s I_s/L_i) I − Σ E_s I_s/L_i² (b k_iᵗ + k_i bᵗ) + Σ E_s I_s θ²/L_i³ k_i k_iᵗ
//! ```
//!
//! Eq. 9 with w_e the wrench applied on the snake by its environment: when ψ changes by dψ, the actuators' work τᵗdq and
//! the environment's w_eᵗdx together raise the elastic energy, so J_qψᵗ τ = ∇E − J_xψᵗ w_e. (The paper prints a plus,
//! which is right for the wrench that the snake applies.) In b the constraint is Qᵗτ = ∇_b E − J_xbᵗ w_e with a constant
//! Q, and Eq. 11's minimum-norm solution is τ = Q (QᵗQ)⁻¹ (…) = 2/(n r²) Q (…), which equals the paper's form wherever
//! that one is defined, since a change of coordinates changes neither the constraint nor the norm.

use super::{PerBackbone, Robot};
use nalgebra::{Matrix2, Vector2, Vector6};

impl Robot {
    /// E, N·mm: the bending energy of all backbones at a bend vector (rad).
    pub fn elastic_energy(&self, bend: Vector2<f64>) -> f64 {
        let lengths = self.backbone_lengths(bend);
        let compliance: f64 = lengths.iter().map(|length| self.secondary.bending_stiffness_n_mm2() / length).sum();
        0.5 * bend.norm_squared() * (self.primary.bending_stiffness_n_mm2() / self.length_mm + compliance)
    }

    /// ∇E by the bend vector, N·mm per rad.
    pub fn elastic_gradient(&self, bend: Vector2<f64>) -> Vector2<f64> {
        let mut gradient = bend * (self.primary.bending_stiffness_n_mm2() / self.length_mm);
        for row in &self.displacement_by_bend() {
            let length = self.length_mm + row.dot(&bend);
            let stiffness = self.secondary.bending_stiffness_n_mm2() / length;
            gradient += bend * stiffness - row * (0.5 * stiffness * bend.norm_squared() / length);
        }
        gradient
    }

    /// The Hessian of E by the bend vector, N·mm per rad².
    pub fn elastic_hessian(&self, bend: Vector2<f64>) -> Matrix2<f64> {
        let mut hessian = Matrix2::identity() * (self.primary.bending_stiffness_n_mm2() / self.length_mm);
        for row in &self.displacement_by_bend() {
            let length = self.length_mm + row.dot(&bend);
            let stiffness = self.secondary.bending_stiffness_n_mm2() / length;
            let mixed = bend * row.transpose();
            hessian += Matrix2::identity() * stiffness - (mixed + mixed.transpose()) * (stiffness / length)
                + row * row.transpose() * (stiffness * bend.norm_squared() / length.powi(2));
        }
        hessian
    }

    /// Eq. 9–11: the forces τ (N, positive towards +q_i) of least norm that hold the snake at a bend vector.
    ///
    /// `wrench` is what the environment applies on the end disk: force (N) at the centre of its far face, then moment
    /// (N·mm), both in {b}.
    pub fn actuation_forces(&self, bend: Vector2<f64>, wrench: Option<&Vector6<f64>>) -> PerBackbone {
        let mut generalised = self.elastic_gradient(bend);
        if let Some(wrench) = wrench {
            generalised -= self.tip_jacobian_bend(bend).transpose() * wrench;
        }
        self.forces_by_generalised() * generalised
    }

    /// ∂τ/∂b of the unloaded snake, N per rad.
    pub fn actuation_forces_by_bend(&self, bend: Vector2<f64>) -> PerBackbone<Vector2<f64>> {
        self.forces_by_generalised() * self.elastic_hessian(bend)
    }

    /// Q (QᵗQ)⁻¹, 1/mm: from the generalised force on b to τ of least norm.
    fn forces_by_generalised(&self) -> PerBackbone<Vector2<f64>> {
        self.bend_by_displacement()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Configuration;
    use approx::assert_relative_eq;
    use nalgebra::Vector3;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    fn any_bend() -> impl Strategy<Value = Vector2<f64>> {
        (prop_oneof![Just(0.0), 0.0..1e-3f64, 0.0..2.1f64], -PI..PI)
            .prop_map(|(theta, delta)| Configuration::new(theta, delta).bend_vector())
    }

    proptest! {
        #[test]
        fn gradient_and_hessian_are_the_derivatives_of_the_energy(bend in any_bend(), backbones in 3..9u8) {
            let robot = Robot { backbones, ..Robot::default() };
            let h = 1e-4;
            for axis in 0..2 {
                let step = Vector2::ith(axis, h);
                let slope = (robot.elastic_energy(bend + step) - robot.elastic_energy(bend - step)) / (2.0 * h);
                prop_assert!((slope - robot.elastic_gradient(bend)[axis]).abs() < 1e-5);
                let bow = (robot.elastic_gradient(bend + step) - robot.elastic_gradient(bend - step)) / (2.0 * h);
                prop_assert!((bow - robot.elastic_hessian(bend).column(axis)).norm() < 1e-5);
            }
        }

        #[test]
        fn the_forces_balance_the_work_and_none_smaller_do(
            bend in any_bend(), load in proptest::array::uniform6(-2.0..2.0f64), common in -5.0..5.0f64, backbones in 3..9u8
        ) {
            let robot = Robot { backbones, ..Robot::default() };
            let wrench = Vector6::from(load);
            let tau = robot.actuation_forces(bend, Some(&wrench));
            let work = robot.displacement_by_bend().tr_mul(&tau);
            let needed = robot.elastic_gradient(bend) - robot.tip_jacobian_bend(bend).transpose() * wrench;
            prop_assert!((work - needed).norm() < 1e-9);
            // The only freedom left is in forces that do no work; any of them makes τ longer.
            for part in robot.internal_parts() {
                prop_assert!((tau + part * common).norm() + 1e-12 >= tau.norm());
            }
        }

        #[test]
        fn equation_11_in_theta_and_delta_gives_the_same_forces(bend in any_bend()) {
            prop_assume!(bend.norm() > 1e-2);
            let robot = Robot::default();
            let psi = Configuration::from_bend_vector(bend);
            let jacobian = robot.jacobian_q_psi(psi);
            let gradient = crate::robot::kinematics::bend_by_configuration(psi).transpose() * robot.elastic_gradient(bend);
            let printed = jacobian * (jacobian.cross_gram(&jacobian).try_inverse().unwrap() * gradient);
            prop_assert!((printed - robot.actuation_forces(bend, None)).norm() < 1e-8);
        }
    }

    #[test]
    fn bending_in_a_plane_of_symmetry_needs_the_textbook_moment() {
        // To first order in θ all four tubes are beams of length L: the moment is 4 E I θ / L, and τ = −M/(1.5 r)(1, −½, −½).
        let robot = Robot::default();
        let theta = 1e-6;
        let moment = 4.0 * 54_000.0 * PI / 64.0 * (0.66f64.powi(4) - 0.5f64.powi(4)) * theta / 26.0;
        let tau = robot.actuation_forces(Vector2::new(theta, 0.0), None);
        let expected = PerBackbone::from([-1.0, 0.5, 0.5]) * (moment / 2.25);
        assert!((tau - expected).norm() < 1e-6 * expected.norm());
    }

    #[test]
    fn the_moment_and_the_forces_of_four_five_and_six_backbones_are_the_textbooks() {
        // n + 1 beams of length L: M = (n + 1) E I θ/L, held by τ_i = −2 M/(n r) cos(δ − a_i) with Σ τ_i q_i its work through θ.
        for n in [4u8, 5, 6] {
            let robot = Robot { backbones: n, ..Robot::default() };
            let (theta, delta, count) = (1e-6, 0.7, f64::from(n));
            let bend = Configuration::new(theta, delta).bend_vector();
            let stiffness = 54_000.0 * PI / 64.0 * (0.66f64.powi(4) - 0.5f64.powi(4));
            let moment = (count + 1.0) * stiffness * theta / 26.0;
            let tau = robot.actuation_forces(bend, None);
            let azimuth = |i: usize| -2.0 * PI * i as f64 / count;
            let expected =
                PerBackbone::from_fn(usize::from(n), |i| -2.0 * moment / (count * 1.5) * (delta - azimuth(i)).cos());
            assert!((tau - expected).norm() < 1e-6 * expected.norm(), "{n}: {tau:?} {expected:?}");
            let q = robot.displacement_by_bend() * bend;
            assert_relative_eq!(tau.dot(&q), moment * theta, max_relative = 1e-6);
            assert!(q.sum().abs() < 1e-20);
            assert_relative_eq!(q.norm_squared(), count / 2.0 * (1.5 * theta).powi(2), max_relative = 1e-9);
        }
    }

    #[test]
    fn a_wrench_that_pushes_the_tip_along_the_bend_relieves_the_actuators() {
        let robot = Robot::default();
        let bend = Vector2::new(0.5, 0.0);
        let push = Vector6::new(0.2, 0.0, 0.0, 0.0, 0.0, 0.0);
        assert!(robot.actuation_forces(bend, Some(&push)).norm() < robot.actuation_forces(bend, None).norm());
    }

    #[test]
    fn the_loaded_snake_rests_where_energy_is_least() {
        // With the actuators' forces held, total energy E − τᵗq − f·x has its minimum at the bend they were computed for.
        let robot = Robot::default();
        let bend = Vector2::new(0.4, 0.3);
        let force = Vector3::new(0.1, -0.2, 0.3);
        let tau = robot.actuation_forces(bend, Some(&Vector6::new(force.x, force.y, force.z, 0.0, 0.0, 0.0)));
        let total = |b: Vector2<f64>| {
            let tip = robot.frame_at(Configuration::from_bend_vector(b), robot.length_mm).translation.vector;
            robot.elastic_energy(b) - tau.dot(&(robot.displacement_by_bend() * b)) - force.dot(&tip)
        };
        let h = 1e-4;
        for axis in 0..2 {
            let step = Vector2::ith(axis, h);
            assert!((total(bend + step) - total(bend - step)).abs() / (2.0 * h) < 1e-5);
            assert!(total(bend + step * 100.0) > total(bend));
        }
    }

    #[test]
    fn what_bends_nothing_is_spanned_by_the_internal_parts() {
        for backbones in 3..=8 {
            let robot = Robot { backbones, ..Robot::default() };
            let parts: Vec<_> = robot.internal_parts().collect();
            assert_eq!(parts.len(), usize::from(backbones) - 2);
            for (a, part) in parts.iter().enumerate() {
                assert!(robot.bend_by_displacement().tr_mul(part).norm() < 1e-12);
                for (b, other) in parts.iter().enumerate() {
                    assert_relative_eq!(part.dot(other), if a == b { 1.0 } else { 0.0 }, epsilon = 1e-12);
                }
            }
            assert!((parts[0] - parts[0].map(|_| parts[0].mean())).norm() < 1e-12, "the first is the common part");
            let any = PerBackbone::from_fn(parts[0].len(), |i| (1.7 * i as f64).sin());
            let sum = parts.iter().fold(any * 0.0, |sum, part| sum + *part * part.dot(&any));
            assert!((sum - robot.internal_part(&any)).norm() < 1e-12);
            assert!((robot.internal_part(&sum) - sum).norm() < 1e-12);
        }
    }
}
