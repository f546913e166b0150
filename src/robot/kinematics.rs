//! Kinematics: Eq. 1–3, 5 and 7, and the constant-curvature arc.
//!
//! # One formula for the paper's two conventions
//!
//! Write Θ = θ_L − θ_0 for the paper's signed bend. Eq. 1 is q_i = r Θ cos δ_i with δ_i = δ + (i−1)β, so
//!
//! ```text
//! ∂(q1, q2)/∂(Θ, δ) = r [ cos δ_1  −Θ sin δ_1 ]      det = −r² Θ sin β      (δ_1 − δ_2 = −β)
//!                       [ cos δ_2  −Θ sin δ_2 ]
//!
//! its inverse       = 1/(r sin β) [ sin δ_2      −sin δ_1   ]
//!                                 [ cos δ_2 / Θ  −cos δ_1/Θ ]
//! ```
//!
//! which is Eq. 7 once cos δ_i = q_i / (r Θ) is put in and its θ_L is read as Θ; Eq. 5 is the same matrix with
//! q2 sin δ_1 − q1 sin δ_2 = −r Θ sin β left unsimplified, and so 0/0 wherever cos δ_1 = 0. The paper prints both for
//! θ_0 = 0. Eq. 3 gives δ itself only for Θ < 0, which is θ_0 = 90°, θ_L = 90° − θ, where bending lowers the tangent
//! towards the base plane; for Θ > 0 it gives δ + 180°. Here θ = −Θ ≥ 0 throughout, q_i = −r θ cos δ_i, and a derivative
//! by θ is minus the one by Θ.
//!
//! # Without singularities
//!
//! In the bend vector b = θ (cos δ, sin δ) displacement is linear: q = Q b, with row i of Q being −r (cos a_i, sin a_i)
//! for the backbone's azimuth a_i = −(i−1)β. Over n evenly spaced backbones the columns of Q are orthogonal with QᵗQ = n r²/2·I and
//! sum to zero, so that a part common to all q_i bends nothing: with three backbones that is all of q that bends nothing, with n
//! there are n − 2 such [internal parts](Robot::internal_parts). What must be smooth at θ = 0 is written in b; only the
//! δ-rows of the inverse Jacobians grow as 1/θ there, because δ itself loses its meaning.

use super::{PerBackbone, Robot};
use crate::geometry::{Configuration, Pose, sinc};
use nalgebra::{Matrix2, Matrix3, Matrix6x2, Translation3, UnitQuaternion, Vector2, Vector3, Vector6};
use std::f64::consts::TAU;

/// The largest bend that the model answers for, rad (120°).
///
/// Convention: the paper's experiments end below 90°; the margin lets a command or a noisy reading near that end have an answer, and
/// beyond it nothing was ever checked.
pub const MAX_THETA: f64 = TAU / 3.0;

/// ∂b/∂ψ, the bend vector's derivative by (θ, δ). Its determinant is θ.
pub fn bend_by_configuration(psi: Configuration) -> Matrix2<f64> {
    let (sin, cos) = psi.delta.sin_cos();
    Matrix2::new(cos, -psi.theta * sin, sin, psi.theta * cos)
}

/// ∂ψ/∂b, the derivative of (θ, δ) by the bend vector; `None` at θ = 0, where δ is not defined.
pub fn configuration_by_bend(psi: Configuration) -> Option<Matrix2<f64>> {
    let (sin, cos) = psi.delta.sin_cos();
    (psi.theta > 0.0).then(|| Matrix2::new(cos, sin, -sin / psi.theta, cos / psi.theta))
}

impl Robot {
    /// Q: q = Q b, mm per rad; row i is −r (cos a_i, sin a_i).
    pub fn displacement_by_bend(&self) -> PerBackbone<Vector2<f64>> {
        self.backbone_directions() * -self.backbone_circle_radius_mm
    }

    /// Q⁺ = 2/(n r²)·Qᵗ, by columns: the least-squares bend vector (rad) of any displacements (mm).
    pub fn bend_by_displacement(&self) -> PerBackbone<Vector2<f64>> {
        let n = self.backbone_count() as f64;
        self.displacement_by_bend() * (2.0 / (n * self.backbone_circle_radius_mm.powi(2)))
    }

    /// An orthonormal basis of all q that bend nothing (Qᵗq = 0): the common part first, then what alternates along the circle
    /// twice, three times and so on, n − 2 in all.
    pub fn internal_parts(&self) -> impl Iterator<Item = PerBackbone> + use<> {
        let n = self.backbone_count();
        let wave = move |times: usize, phase: f64| {
            let wave = PerBackbone::from_fn(n, |i| (TAU * (times * i) as f64 / n as f64 - phase).cos());
            wave / wave.norm()
        };
        let higher = (2..=n / 2).flat_map(move |times| {
            // Half as often as there are backbones it has no sine.
            let sine = (2 * times < n).then(|| wave(times, TAU / 4.0));
            [wave(times, 0.0)].into_iter().chain(sine)
        });
        [wave(0, 0.0)].into_iter().chain(higher)
    }

    /// The coordinates of displacements along the two columns of Q and along (1, …, 1), each of unit length: bend and common part.
    /// Lengths and angles stay. With three backbones these are all coordinates; with more the other internal parts are left out.
    pub fn bend_and_common(&self, q_mm: &PerBackbone) -> Vector3<f64> {
        let n = self.backbone_count() as f64;
        let bend = self.backbone_directions().tr_mul(q_mm) * -(2.0 / n).sqrt();
        Vector3::new(bend.x, bend.y, q_mm.sum() / n.sqrt())
    }

    /// The displacements with these [coordinates](Self::bend_and_common), without other internal parts.
    pub fn from_bend_and_common(&self, coordinates: &Vector3<f64>) -> PerBackbone {
        let n = self.backbone_count() as f64;
        (self.backbone_directions() * (coordinates.xy() * -(2.0 / n).sqrt())).add_scalar(coordinates.z / n.sqrt())
    }

    /// Eq. 1: the joint displacements q (mm) of a configuration.
    pub fn joint_displacements(&self, psi: Configuration) -> PerBackbone {
        self.displacement_by_bend() * psi.bend_vector()
    }

    /// Eq. 2 and 3 over all backbones: the configuration whose q is nearest, in the least-squares sense, to
    /// `q_mm`. Exact for a consistent q; internal parts are ignored.
    pub fn configuration(&self, q_mm: &PerBackbone) -> Configuration {
        Configuration::from_bend_vector(self.bend_by_displacement().tr_mul(q_mm))
    }

    /// L_i = L + q_i, mm, at a bend vector.
    pub fn backbone_lengths(&self, bend: Vector2<f64>) -> PerBackbone {
        (self.displacement_by_bend() * bend).add_scalar(self.length_mm)
    }

    /// J_qψ = ∂q/∂(θ, δ), mm per rad.
    pub fn jacobian_q_psi(&self, psi: Configuration) -> PerBackbone<Vector2<f64>> {
        self.displacement_by_bend() * bend_by_configuration(psi)
    }

    /// The pseudo-inverse of [`jacobian_q_psi`](Self::jacobian_q_psi), by columns, rad per mm: ψ̇ from all
    /// q̇.
    ///
    /// `None` at θ = 0, where δ is not defined.
    pub fn jacobian_psi_q(&self, psi: Configuration) -> Option<PerBackbone<Vector2<f64>>> {
        let by_bend = configuration_by_bend(psi)?;
        Some(self.bend_by_displacement().map(|column| by_bend * column))
    }

    /// Eq. 5 and 7, J_ψq for (q1, q2) alone, with rows (θ, δ); free of Eq. 5's 0/0 at cos δ_1 = 0.
    ///
    /// `None` at θ = 0, where δ is not defined.
    pub fn jacobian_psi_q12(&self, psi: Configuration) -> Option<Matrix2<f64>> {
        let (sin1, cos1) = psi.delta.sin_cos();
        let (sin2, cos2) = (psi.delta + self.beta()).sin_cos();
        let scale = 1.0 / (self.backbone_circle_radius_mm * self.beta().sin());
        (psi.theta > 0.0).then(|| Matrix2::new(-sin2, sin1, -cos2 / psi.theta, cos1 / psi.theta) * scale)
    }

    /// The frame of the centreline at arc length `s_mm` from the base disk's top face: origin on the centreline, z along
    /// it, turned from {b} by bending alone, R = Rz(δ) Ry(θ s/L) Rz(−δ), without twist.
    ///
    /// Beyond [0, L] the line goes straight on: down the holder, or outwards from the end disk.
    pub fn frame_at(&self, psi: Configuration, s_mm: f64) -> Pose {
        let on_arc = s_mm.clamp(0.0, self.length_mm);
        let bend = psi.bend_vector() * (on_arc / self.length_mm);
        arc(bend, on_arc) * Translation3::new(0.0, 0.0, s_mm - on_arc)
    }

    /// The twist of the section at arc length `s_mm` (velocity of the centreline's point in mm, then angular velocity, both
    /// in {b}) per rad of each component of the bend vector. Smooth at θ = 0; zero on the holder, which does not bend.
    pub fn section_jacobian_bend(&self, bend: Vector2<f64>, s_mm: f64) -> Matrix6x2<f64> {
        // The line up to s is an arc of its own, bent by its share.
        let on_arc = s_mm.clamp(0.0, self.length_mm);
        let share = on_arc / self.length_mm;
        let bend = bend * share;
        let [versine, versine_slope, sinc_slope, turn, _] = arc_functions(bend.norm());
        let lateral = Matrix2::identity() * versine + bend * bend.transpose() * versine_slope;
        let rotation = rotation_vector(bend).cross_matrix();
        // The left Jacobian of SO(3): from the rate of the rotation vector to the angular velocity in {b}.
        let angular = Matrix3::identity() + rotation * versine + rotation * rotation * turn;
        Matrix6x2::from_columns(&[0, 1].map(|axis| {
            let direction = Vector2::ith(axis, 1.0);
            let side = lateral.column(axis) * on_arc;
            let turning = angular * rotation_vector(direction);
            share * Vector6::new(side.x, side.y, sinc_slope * bend[axis] * on_arc, turning.x, turning.y, turning.z)
        }))
    }

    /// J_xb: the tip's twist, [`section_jacobian_bend`](Self::section_jacobian_bend) of the end disk's far face.
    pub fn tip_jacobian_bend(&self, bend: Vector2<f64>) -> Matrix6x2<f64> {
        self.section_jacobian_bend(bend, self.length_mm)
    }

    /// J_xψ = ∂x/∂(θ, δ): the tip's twist as in [`tip_jacobian_bend`](Self::tip_jacobian_bend) per rad of θ and of δ.
    pub fn tip_jacobian(&self, psi: Configuration) -> Matrix6x2<f64> {
        self.tip_jacobian_bend(psi.bend_vector()) * bend_by_configuration(psi)
    }
}

/// The frame at the end of an arc of this bend and length, mm, from the one at its start.
pub(super) fn arc(bend: Vector2<f64>, length_mm: f64) -> Pose {
    Pose::from_parts(
        Translation3::from(arc_point(bend) * length_mm),
        UnitQuaternion::from_scaled_axis(rotation_vector(bend)),
    )
}

/// The rotation vector of a bend: the axis across the bend plane, times θ.
pub(super) fn rotation_vector(bend: Vector2<f64>) -> Vector3<f64> {
    Vector3::new(-bend.y, bend.x, 0.0)
}

/// Where an arc of unit length and this bend ends: ((1 − cos θ)/θ² · b, sin θ/θ).
fn arc_point(bend: Vector2<f64>) -> Vector3<f64> {
    let theta = bend.norm();
    // 2 sin²(θ/2)/θ² loses no digits for small θ, unlike 1 − cos θ.
    let half = sinc(theta / 2.0);
    let side = bend * (0.5 * half * half);
    Vector3::new(side.x, side.y, sinc(theta))
}

/// With g = (1 − cos θ)/θ², h = sin θ/θ and f = (θ − sin θ)/θ³: [g, g′/θ, h′/θ, f, f′/θ], by series where the closed forms cancel.
pub(super) fn arc_functions(theta: f64) -> [f64; 5] {
    let half = sinc(theta / 2.0);
    let versine = 0.5 * half * half;
    let t2 = theta * theta;
    if theta < 0.1 {
        // The first term left out is below 1e-14.
        [
            versine,
            -1.0 / 12.0 + t2 * (1.0 / 180.0 - t2 * (1.0 / 6720.0 - t2 / 453_600.0)),
            -1.0 / 3.0 + t2 * (1.0 / 30.0 - t2 * (1.0 / 840.0 - t2 / 45_360.0)),
            1.0 / 6.0 - t2 * (1.0 / 120.0 - t2 * (1.0 / 5040.0 - t2 / 362_880.0)),
            -1.0 / 60.0 + t2 * (1.0 / 1260.0 - t2 * (1.0 / 60_480.0 - t2 / 4_989_600.0)),
        ]
    } else {
        let (sin, cos) = theta.sin_cos();
        let turn = (1.0 - sin / theta) / t2;
        let (versine_slope, sinc_slope) = ((sin / theta - 2.0 * versine) / t2, (cos - sin / theta) / t2);
        [versine, versine_slope, sinc_slope, turn, (versine - 3.0 * turn) / t2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::wrap_angle;
    use approx::assert_relative_eq;
    use nalgebra::Point3;
    use proptest::prelude::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    fn first_two(rows: &PerBackbone<Vector2<f64>>) -> Matrix2<f64> {
        Matrix2::from_rows(&[rows[0].transpose(), rows[1].transpose()])
    }

    fn any_bend() -> impl Strategy<Value = Configuration> {
        (0.0..2.1f64, -PI..PI).prop_map(|(theta, delta)| Configuration::new(theta, delta))
    }

    #[test]
    fn the_inner_backbone_shortens_and_the_three_sum_to_zero() {
        let robot = Robot::default();
        let q = robot.joint_displacements(Configuration::from_degrees(90.0, 0.0));
        let inner = -1.5 * FRAC_PI_2;
        assert!((q - PerBackbone::from([inner, -inner / 2.0, -inner / 2.0])).amax() < 1e-12);
        // Leaning towards backbone 2, at azimuth −120°, shortens backbone 2.
        let q = robot.joint_displacements(Configuration::from_degrees(90.0, -120.0));
        assert_relative_eq!(q[1], inner, epsilon = 1e-12);
    }

    proptest! {
        #[test]
        fn equation_3_holds_for_the_convention_with_theta_0_at_90_degrees(psi in any_bend()) {
            prop_assume!(psi.theta > 1e-6);
            let robot = Robot::default();
            let (theta_0, theta_l) = (FRAC_PI_2, FRAC_PI_2 - psi.theta);
            let q: Vec<f64> = (0..3)
                .map(|i| 1.5 * (psi.delta + i as f64 * robot.beta()).cos() * (theta_l - theta_0))
                .collect();
            let printed = (q[1] - q[0] * robot.beta().cos()).atan2(-q[0] * robot.beta().sin());
            prop_assert!(wrap_angle(printed - psi.delta).abs() < 1e-9);
            prop_assert!((robot.joint_displacements(psi) - PerBackbone::of(&q).unwrap()).norm() < 1e-12);
        }

        #[test]
        fn equations_5_and_7_are_the_same_with_theta_l_read_as_the_signed_bend(psi in any_bend()) {
            prop_assume!(psi.theta > 1e-3 && psi.delta.cos().abs() > 1e-3);
            let q = Robot::default().joint_displacements(psi);
            let ours = Robot::default().jacobian_psi_q12(psi).unwrap();
            let (r, beta, big_theta) = (1.5, Robot::default().beta(), -psi.theta);
            let ((s1, c1), (s2, c2)) = (psi.delta.sin_cos(), (psi.delta + beta).sin_cos());
            let seven = Matrix2::new(s2, -s1, q[1] / (r * big_theta * big_theta), -q[0] / (r * big_theta * big_theta))
                / (r * beta.sin());
            let common = q[1] * s1 - q[0] * s2;
            let five = Matrix2::new(
                (q[1] * c1 * s1 - q[0] * (psi.delta + psi.delta + beta).sin()) / (r * c1 * c1 * common),
                q[0] * c1 * s1 / (r * c1 * c1 * common),
                -c2 / common,
                c1 / common,
            );
            // The paper's first row is a derivative of Θ = −θ.
            let theta_from_signed = Matrix2::new(-1.0, 0.0, 0.0, 1.0);
            prop_assert!((theta_from_signed * seven - ours).norm() < 1e-9 * ours.norm());
            prop_assert!((theta_from_signed * five - ours).norm() < 1e-9 * ours.norm());
        }

        #[test]
        fn configuration_inverts_joint_displacements_whatever_the_internal_parts(
            psi in any_bend(), common in -1.0..1.0f64, backbones in 3..9u8
        ) {
            let robot = Robot { backbones, ..Robot::default() };
            for part in robot.internal_parts() {
                let q_mm = robot.joint_displacements(psi) + part * common;
                prop_assert!((robot.configuration(&q_mm).bend_vector() - psi.bend_vector()).norm() < 1e-12);
            }
            // The coordinates keep lengths, and bend and common part are all of such a q.
            let q_mm = robot.joint_displacements(psi).add_scalar(common);
            let coordinates = robot.bend_and_common(&q_mm);
            prop_assert!((coordinates.norm() - q_mm.norm()).abs() < 1e-12);
            prop_assert!((robot.from_bend_and_common(&coordinates) - q_mm).norm() < 1e-12);
        }

        #[test]
        fn jacobians_are_the_derivatives_and_each_others_inverse(psi in any_bend(), backbones in 3..9u8) {
            prop_assume!(psi.theta > 1e-3);
            let robot = Robot { backbones, ..Robot::default() };
            let h = 1e-6;
            let q = |theta, delta| robot.joint_displacements(Configuration { theta, delta });
            let numeric = PerBackbone::from_columns([
                (q(psi.theta + h, psi.delta) - q(psi.theta - h, psi.delta)) / (2.0 * h),
                (q(psi.theta, psi.delta + h) - q(psi.theta, psi.delta - h)) / (2.0 * h),
            ]);
            let jacobian = robot.jacobian_q_psi(psi);
            prop_assert!((numeric - jacobian).norm() < 1e-8);
            prop_assert!((robot.jacobian_psi_q(psi).unwrap().cross_gram(&jacobian) - Matrix2::identity()).norm() < 1e-9);
            let two = robot.jacobian_psi_q12(psi).unwrap() * first_two(&jacobian);
            prop_assert!((two - Matrix2::identity()).norm() < 1e-9);
        }

        #[test]
        fn frame_at_is_the_arc_turned_into_its_plane(psi in any_bend(), share in 0.0..1.0f64) {
            let robot = Robot::default();
            let s = share * robot.length_mm;
            let phi = psi.theta * share;
            let axis = |v: Vector3<f64>, angle| UnitQuaternion::from_scaled_axis(v * angle);
            let turn = axis(Vector3::z(), psi.delta) * axis(Vector3::y(), phi) * axis(Vector3::z(), -psi.delta);
            let frame = robot.frame_at(psi, s);
            prop_assert!(frame.rotation.angle_to(&turn) < 1e-9);
            prop_assume!(psi.theta > 1e-3);
            let rho = robot.length_mm / psi.theta;
            let (sin, cos) = psi.delta.sin_cos();
            let expected = Vector3::new(rho * (1.0 - phi.cos()) * cos, rho * (1.0 - phi.cos()) * sin, rho * phi.sin());
            prop_assert!((frame.translation.vector - expected).norm() < 1e-9);
        }

        #[test]
        fn the_section_jacobian_is_the_sections_twist(
            theta in prop_oneof![0.0..2e-3f64, 0.09..0.11f64, 0.0..2.1f64],
            delta in -PI..PI,
            share in prop_oneof![Just(1.0), -0.1..1.0f64],
        ) {
            let robot = Robot::default();
            let bend = Configuration::new(theta, delta).bend_vector();
            let h = 1e-5;
            let s_mm = share * robot.length_mm;
            let section = |b| robot.frame_at(Configuration::from_bend_vector(b), s_mm);
            let jacobian = robot.section_jacobian_bend(bend, s_mm);
            for axis in 0..2 {
                let step = Vector2::ith(axis, h);
                let (after, before) = (section(bend + step), section(bend - step));
                let linear = (after.translation.vector - before.translation.vector) / (2.0 * h);
                let angular = (after.rotation * before.rotation.inverse()).scaled_axis() / (2.0 * h);
                prop_assert!((linear - jacobian.fixed_view::<3, 1>(0, axis)).norm() < 1e-7);
                prop_assert!((angular - jacobian.fixed_view::<3, 1>(3, axis)).norm() < 1e-7);
            }
        }
    }

    #[test]
    fn the_line_goes_straight_on_beyond_both_ends() {
        let robot = Robot::default();
        let psi = Configuration::from_degrees(90.0, 0.0);
        let below = robot.frame_at(psi, -5.0) * Point3::origin();
        assert_relative_eq!(below, Point3::new(0.0, 0.0, -5.0), epsilon = 1e-12);
        let step = robot.frame_at(psi, 29.0).translation.vector - robot.frame_at(psi, 26.0).translation.vector;
        assert_relative_eq!(step, Vector3::new(3.0, 0.0, 0.0), epsilon = 1e-9);
    }

    #[test]
    fn the_inverse_jacobian_has_no_singularity_where_equation_5_divides_by_zero() {
        let psi = Configuration::from_degrees(40.0, 90.0);
        let robot = Robot::default();
        let product = robot.jacobian_psi_q12(psi).unwrap() * first_two(&robot.jacobian_q_psi(psi));
        assert_relative_eq!(product, Matrix2::identity(), epsilon = 1e-9);
    }

    #[test]
    fn delta_is_not_defined_on_the_straight_snake() {
        let straight = Configuration::new(0.0, 1.0);
        assert!(Robot::default().jacobian_psi_q(straight).is_none());
        assert!(Robot::default().jacobian_psi_q12(straight).is_none());
    }
}
