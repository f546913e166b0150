//! A snake that is not bent to a circular arc.
//!
//! With u = s/L the centreline's bend vector is
//!
//! ```text
//! ϑ(u) = b u + Σ_k a_k φ_k(u),      φ_1 = 4 u (1 − u),  φ_2 = sin 2πu,  φ_3 = sin 3πu
//! ```
//!
//! and its section at u is turned from {b} as the end of an arc of that bend is, R(u) = exp [ϑ(u)]×. All φ_k are zero at both
//! ends, so that b is the tip's bend vector whatever the shape: Eq. 1 holds with the tip's angles for any planar curve, since
//! q_i = −r ∫ κ cos δ_i ds = −r θ cos δ_i. a_1 is a curvature that varies linearly along the snake, as friction and weight make it
//! to first order; a_2 is an S; a_3 is what is left of the next order. A part of a_k across b leaves the bending plane.

use super::Robot;
use super::kinematics::{arc_functions, rotation_vector};
use crate::geometry::{Configuration, Pose, sinc};
use nalgebra::{Matrix3, Matrix3x2, SMatrix, Translation3, UnitQuaternion, Vector2, Vector3};
use std::f64::consts::PI;
use std::sync::LazyLock;

/// How many functions φ_k there are.
/// Derived: two make any linear change of curvature and any S; the third makes sin πu to a hundredth of its height.
pub const MODES: usize = 3;
/// How many numbers a [`BendProfile`] has: two of the tip's bend vector and two of each mode.
///
/// Convention: a count.
pub const PROFILE: usize = 2 + 2 * MODES;
/// Pieces between which the centreline is known exactly.
/// Derived: Simpson's rule over pieces of a millimetre errs by less than 0.03 µm in all, with modes of some degrees (h⁴/2880 · L · the
/// tangent's fourth derivative, (3π/L)⁴ a_3 at most).
const PIECES: usize = 26;

/// The bend vector along the snake (see the module).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BendProfile {
    /// b: the tip's bend vector, rad.
    pub tip: Vector2<f64>,
    /// a_k along x_b and y_b, rad.
    pub modes: [Vector2<f64>; MODES],
}

impl From<Configuration> for BendProfile {
    /// The circular arc of a configuration.
    fn from(psi: Configuration) -> Self {
        Self::arc(psi.bend_vector())
    }
}

impl BendProfile {
    /// A circular arc.
    pub fn arc(tip: Vector2<f64>) -> Self {
        Self { tip, modes: [Vector2::zeros(); MODES] }
    }

    /// Whether it is a circular arc.
    pub fn is_arc(&self) -> bool {
        self.modes.iter().all(|mode| *mode == Vector2::zeros())
    }

    /// ϑ(u), rad.
    pub fn at(&self, u: f64) -> Vector2<f64> {
        self.weighted(&weights(u))
    }

    /// ϑ where its numbers have these [`weights`], rad.
    fn weighted(&self, weights: &[f64; 1 + MODES]) -> Vector2<f64> {
        self.modes.iter().zip(&weights[1..]).fold(self.tip * weights[0], |sum, (mode, weight)| sum + mode * *weight)
    }

    /// Its numbers, in the order of [`Curve::section_jacobian`].
    pub fn to_array(&self) -> [f64; PROFILE] {
        let mut all = [0.0; PROFILE];
        for (pair, vector) in all.chunks_exact_mut(2).zip(std::iter::once(&self.tip).chain(&self.modes)) {
            pair.copy_from_slice(vector.as_slice());
        }
        all
    }

    /// The profile after a step of its numbers, in the order of [`Curve::section_jacobian`].
    pub fn stepped(&self, by: &[f64]) -> Self {
        let pair = |k: usize| Vector2::new(by[2 * k], by[2 * k + 1]);
        Self { tip: self.tip + pair(0), modes: std::array::from_fn(|k| self.modes[k] + pair(k + 1)) }
    }
}

/// [`weights`] at the ends and the middles of all pieces.
static PIECE_WEIGHTS: LazyLock<[[f64; 1 + MODES]; 2 * PIECES + 1]> =
    LazyLock::new(|| std::array::from_fn(|half| weights(0.5 * half as f64 / PIECES as f64)));

/// ∂ϑ(u)/∂(b, a_1, a_2, …): u and the φ_k.
fn weights(u: f64) -> [f64; 1 + MODES] {
    // sin 2πu and sin 3πu by one evaluation.
    let (sin, cos) = (PI * u).sin_cos();
    [u, 4.0 * u * (1.0 - u), 2.0 * sin * cos, sin * (3.0 - 4.0 * sin * sin)]
}

/// The centreline of a snake with a given [`BendProfile`].
#[derive(Debug, Clone)]
pub struct Curve {
    profile: BendProfile,
    length_mm: f64,
    nodes: Vec<Node>,
}

/// The centreline at one end of a piece.
#[derive(Debug, Clone, Copy)]
struct Node {
    /// Place in {b}, mm.
    place: Vector3<f64>,
    /// What a rad of each number of the profile moves it by, mm.
    moved: SMatrix<f64, 3, PROFILE>,
    at: Section,
    weights: [f64; 1 + MODES],
}

/// The direction of the centreline at one place and how it follows the bend vector there.
#[derive(Debug, Clone, Copy)]
struct Section {
    tangent: Vector3<f64>,
    /// Angular velocity in {b} per rad of each component of ϑ.
    turn: Matrix3x2<f64>,
    /// The tangent's velocity per rad of each component of ϑ.
    tangent_by_bend: Matrix3x2<f64>,
}

impl Section {
    fn new(bend: Vector2<f64>) -> Self {
        let theta = bend.norm();
        let [versine, _, _, turn, _] = arc_functions(theta);
        let rotation = rotation_vector(bend).cross_matrix();
        // The left Jacobian of SO(3): from the rate of the rotation vector to the angular velocity in {b}.
        let angular = Matrix3::identity() + rotation * versine + rotation * rotation * turn;
        let turn = Matrix3x2::from_columns(&[Vector2::x(), Vector2::y()].map(|axis| angular * rotation_vector(axis)));
        let side = bend * sinc(theta);
        let tangent = Vector3::new(side.x, side.y, theta.cos());
        let moved = [0, 1].map(|axis| turn.column(axis).cross(&tangent));
        Self { tangent, turn, tangent_by_bend: Matrix3x2::from_columns(&moved) }
    }

    /// What a rad of each number of the profile turns the section by.
    fn turned(&self, weights: &[f64; 1 + MODES]) -> SMatrix<f64, 3, PROFILE> {
        spread(&self.turn, weights)
    }

    /// What it adds to the tangent.
    fn tangent_moved(&self, weights: &[f64; 1 + MODES]) -> SMatrix<f64, 3, PROFILE> {
        spread(&self.tangent_by_bend, weights)
    }
}

/// A slope by ϑ(u) as one by the profile's numbers.
fn spread(by_bend: &Matrix3x2<f64>, weights: &[f64; 1 + MODES]) -> SMatrix<f64, 3, PROFILE> {
    SMatrix::from_fn(|row, column| by_bend[(row, column % 2)] * weights[column / 2])
}

impl Curve {
    /// The centreline of a robot's snake with this profile.
    pub fn new(robot: &Robot, profile: &BendProfile) -> Self {
        let piece_mm = robot.length_mm / PIECES as f64;
        // Half pieces are counted.
        let at = |half: usize| (Section::new(profile.weighted(&PIECE_WEIGHTS[half])), PIECE_WEIGHTS[half]);
        let (first, zero) = at(0);
        let mut nodes = Vec::with_capacity(PIECES + 1);
        nodes.push(Node { place: Vector3::zeros(), moved: SMatrix::zeros(), at: first, weights: zero });
        for k in 0..PIECES {
            let before = nodes[k];
            let (middle, half) = at(2 * k + 1);
            let (after, whole) = at(2 * k + 2);
            // Simpson's rule over the piece.
            let place = before.at.tangent + middle.tangent * 4.0 + after.tangent;
            let moved = before.at.tangent_moved(&before.weights)
                + middle.tangent_moved(&half) * 4.0
                + after.tangent_moved(&whole);
            nodes.push(Node {
                place: before.place + place * (piece_mm / 6.0),
                moved: before.moved + moved * (piece_mm / 6.0),
                at: after,
                weights: whole,
            });
        }
        Self { profile: *profile, length_mm: robot.length_mm, nodes }
    }

    /// The profile that it was made with.
    pub fn profile(&self) -> &BendProfile {
        &self.profile
    }

    /// The frame at arc length `s_mm`, as [`Robot::frame_at`] gives it for an arc; straight on beyond both ends.
    pub fn frame_at(&self, s_mm: f64) -> Pose {
        let on_curve_mm = s_mm.clamp(0.0, self.length_mm);
        let bend = self.profile.at(on_curve_mm / self.length_mm);
        let rotation = UnitQuaternion::from_scaled_axis(rotation_vector(bend));
        let place = self.interpolated(on_curve_mm, |node| (node.place, node.at.tangent));
        Pose::from_parts(Translation3::from(place), rotation) * Translation3::new(0.0, 0.0, s_mm - on_curve_mm)
    }

    /// The twist of the section at arc length `s_mm` (velocity of the centreline's point in mm, then angular velocity, both in {b})
    /// per rad of each of the profile's numbers: the tip's bend vector, then every mode's two. Zero on the holder.
    pub fn section_jacobian(&self, s_mm: f64) -> SMatrix<f64, 6, PROFILE> {
        let on_curve_mm = s_mm.clamp(0.0, self.length_mm);
        let u = on_curve_mm / self.length_mm;
        let (section, weights) = (Section::new(self.profile.at(u)), weights(u));
        let moved = self.interpolated(on_curve_mm, |node| (node.moved, node.at.tangent_moved(&node.weights)))
            + section.tangent_moved(&weights) * (s_mm - on_curve_mm).max(0.0);
        let mut jacobian = SMatrix::<f64, 6, PROFILE>::zeros();
        jacobian.fixed_rows_mut::<3>(0).copy_from(&moved);
        jacobian.fixed_rows_mut::<3>(3).copy_from(&section.turned(&weights));
        jacobian
    }

    /// Hermite's cubic between the nodes about an arc length, mm, of what has this value and slope by s at a node.
    fn interpolated<const C: usize>(
        &self,
        s_mm: f64,
        of: impl Fn(&Node) -> (SMatrix<f64, 3, C>, SMatrix<f64, 3, C>),
    ) -> SMatrix<f64, 3, C> {
        let piece_mm = self.length_mm / PIECES as f64;
        let k = ((s_mm / piece_mm) as usize).min(PIECES - 1);
        let ((before, slope_before), (after, slope_after)) = (of(&self.nodes[k]), of(&self.nodes[k + 1]));
        let t = s_mm / piece_mm - k as f64;
        let rise = t * t * (3.0 - 2.0 * t);
        before * (1.0 - rise) + after * rise + (slope_before * (1.0 - t) - slope_after * t) * (piece_mm * t * (1.0 - t))
    }

    /// The pieces from base to tip as arcs: each one's first frame in {b}, its bend vector (rad) and its length, mm.
    pub fn arcs(&self) -> impl Iterator<Item = (Pose, Vector2<f64>, f64)> {
        let piece_mm = self.length_mm / PIECES as f64;
        (0..PIECES).map(move |k| {
            let (start, end) = (self.frame_at(k as f64 * piece_mm), self.frame_at((k as f64 + 1.0) * piece_mm));
            let turn = start.rotation.rotation_to(&end.rotation).scaled_axis();
            let turn = start.rotation.inverse() * turn;
            (start, Vector2::new(turn.y, -turn.x), piece_mm)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use proptest::prelude::*;

    fn any_profile() -> impl Strategy<Value = BendProfile> {
        let pair = |most: f64| proptest::array::uniform2(-most..most);
        (pair(1.4), pair(0.3), pair(0.1), pair(0.05))
            .prop_map(|(tip, a, b, c)| BendProfile { tip: tip.into(), modes: [a.into(), b.into(), c.into()] })
    }

    proptest! {
        #[test]
        fn without_modes_it_is_the_arc(theta in 0.0..2.0f64, delta in -3.1..3.1f64, s in -5.0..30.0f64) {
            let (robot, psi) = (Robot::default(), Configuration::new(theta, delta));
            let curve = Curve::new(&robot, &BendProfile::arc(psi.bend_vector()));
            let (here, arc) = (curve.frame_at(s), robot.frame_at(psi, s));
            prop_assert!((here.translation.vector - arc.translation.vector).norm() < 1e-5);
            prop_assert!(here.rotation.angle_to(&arc.rotation) < 1e-7);
            let closed = robot.section_jacobian_bend(psi.bend_vector(), s.min(26.0));
            let own = curve.section_jacobian(s.min(26.0));
            prop_assert!((own.fixed_columns::<2>(0) - closed).amax() < 1e-5);
        }

        #[test]
        fn the_tip_has_the_tips_bend_whatever_the_shape(profile in any_profile()) {
            let robot = Robot::default();
            let tip = Curve::new(&robot, &profile).frame_at(robot.length_mm);
            let arc = robot.frame_at(Configuration::from_bend_vector(profile.tip), robot.length_mm);
            prop_assert!(tip.rotation.angle_to(&arc.rotation) < 1e-7);
        }

        /// x' = R z, R = exp [ϑ]×, by many small steps.
        #[test]
        fn it_is_the_integral_of_its_tangent(profile in any_profile(), s in 0.0..26.0f64) {
            let (robot, steps) = (Robot::default(), 2000);
            let ds = s / f64::from(steps);
            let place: Vector3<f64> = (0..steps)
                .map(|k| {
                    let bend = profile.at((f64::from(k) + 0.5) * ds / robot.length_mm);
                    UnitQuaternion::from_scaled_axis(rotation_vector(bend)) * Vector3::z() * ds
                })
                .sum();
            let curve = Curve::new(&robot, &profile);
            prop_assert!((curve.frame_at(s).translation.vector - place).norm() < 3e-5);
        }

        #[test]
        fn the_jacobian_is_the_slope_of_the_frame(profile in any_profile(), s in -3.0..29.0f64, number in 0..PROFILE) {
            let (robot, h) = (Robot::default(), 1e-5);
            let mut step = [0.0; PROFILE];
            step[number] = h;
            let ahead = Curve::new(&robot, &profile.stepped(&step)).frame_at(s);
            step[number] = -h;
            let behind = Curve::new(&robot, &profile.stepped(&step)).frame_at(s);
            let moved = (ahead.translation.vector - behind.translation.vector) / (2.0 * h);
            let turned = (ahead.rotation * behind.rotation.inverse()).scaled_axis() / (2.0 * h);
            let jacobian = Curve::new(&robot, &profile).section_jacobian(s);
            let column = jacobian.column(number);
            prop_assert!((column.fixed_rows::<3>(0) - moved).norm() < 1e-4, "{column} {moved}");
            prop_assert!((column.fixed_rows::<3>(3) - turned).norm() < 1e-6, "{column} {turned}");
        }

        #[test]
        fn the_pieces_are_arcs_that_follow_each_other(profile in any_profile()) {
            let robot = Robot::default();
            let curve = Curve::new(&robot, &profile);
            let pieces: Vec<_> = curve.arcs().collect();
            for pair in pieces.windows(2) {
                let (start, bend, length_mm) = pair[0];
                let end = start * super::super::kinematics::arc(bend, length_mm) * Point3::origin();
                prop_assert!((end - Point3::from(pair[1].0.translation.vector)).norm() < 2e-3);
            }
        }
    }
}
