//! Angles, poses and the frames they connect.
//!
//! | frame | origin | axes |
//! | --- | --- | --- |
//! | `pixel` | centre of the top-left pixel | u right, v down |
//! | `camera` | centre of projection | OpenCV's: x right, y down, z forward |
//! | `base` {b} | centre of the base disk's top face | z along the straight snake, x parallel to the grid plane and towards the image's right when z points up, y = z × x, from the camera towards the grid |
//! | `grid` | a crossing of two grid lines | x, y along the lines, z away from the camera |
//!
//! A pose is named so that it chains by eye: `camera_from_base * point_in_base` is a point in the camera's frame.

use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector2, Vector3, Vector6};
use std::f64::consts::{PI, TAU};

/// A rigid transform between two frames, named `a_from_b`.
pub type Pose = Isometry3<f64>;

/// The pose `a_from_b` after a small motion `by`: the first three numbers turn it (a rotation vector, rad) about the origin of `b`, the
/// last three shift it (mm), both along the axes of `a`. Covariances of poses are in these terms.
///
/// Source: T. D. Barfoot, *State Estimation for Robotics*, Cambridge University Press 2017, section 7.1 (a perturbation on the left), with rotation and
/// translation kept apart.
pub fn perturbed(pose: &Pose, by: &Vector6<f64>) -> Pose {
    let turn = UnitQuaternion::from_scaled_axis(by.fixed_rows::<3>(0).into_owned());
    let shift = by.fixed_rows::<3>(3).into_owned();
    Pose::from_parts(Translation3::from(pose.translation.vector + shift), turn * pose.rotation)
}

/// How the turn exp(v + dv) exp(v)⁻¹ follows dv: the left Jacobian of SO(3),
///
/// ```text
/// 1 + (1 − cos a)/a² [v]ₓ + (a − sin a)/a³ [v]ₓ²,     a = |v|
/// ```
///
/// Source: T. D. Barfoot, *State Estimation for Robotics*, Cambridge University Press 2017, section 7.1.5.
pub fn turn_jacobian(turn: &Vector3<f64>) -> Matrix3<f64> {
    let angle = turn.norm();
    let half = 0.5 * sinc(0.5 * angle).powi(2);
    // Where the quotient would lose its digits, the term left out of its series is below them.
    let sixth = if angle < 1e-3 { 1.0 / 6.0 - angle * angle / 120.0 } else { (1.0 - sinc(angle)) / (angle * angle) };
    let cross = turn.cross_matrix();
    Matrix3::identity() + cross * half + cross * cross * sixth
}

/// An angle in radians, brought into (−π, π].
pub fn wrap_angle(angle: f64) -> f64 {
    let wrapped = angle.rem_euclid(TAU);
    if wrapped > PI { wrapped - TAU } else { wrapped }
}

/// An angle in degrees, brought into (−180, 180].
pub fn wrap_degrees(angle_deg: f64) -> f64 {
    let wrapped = angle_deg.rem_euclid(360.0);
    if wrapped > 180.0 { wrapped - 360.0 } else { wrapped }
}

/// sin x / x, 1 at 0.
pub fn sinc(x: f64) -> f64 {
    // Where the series is cut, the term left out is below the last digit.
    if x.abs() < 1e-4 { 1.0 - x * x / 6.0 } else { x.sin() / x }
}

/// The snake's configuration ψ = (θ, δ), radians.
///
/// θ is the bend from straight, θ_0 − θ_L in the paper's terms, never negative. δ is the azimuth in the base frame that
/// the tip leans towards. At θ = 0 δ has no meaning; computations that must be smooth there use
/// [`bend_vector`](Self::bend_vector).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Configuration {
    /// Bend from straight, rad, ≥ 0.
    pub theta: f64,
    /// Azimuth of the bend plane in {b}, rad, in (−π, π].
    pub delta: f64,
}

impl Configuration {
    /// From θ and δ in radians; δ is wrapped, a negative θ becomes the same bend the other way.
    pub fn new(theta: f64, delta: f64) -> Self {
        if theta < 0.0 {
            Self { theta: -theta, delta: wrap_angle(delta + PI) }
        } else {
            Self { theta, delta: wrap_angle(delta) }
        }
    }

    /// From θ and δ in degrees.
    pub fn from_degrees(theta_deg: f64, delta_deg: f64) -> Self {
        Self::new(theta_deg.to_radians(), delta_deg.to_radians())
    }

    /// The configuration whose bend vector this is; a zero vector is straight with δ = 0.
    pub fn from_bend_vector(bend: Vector2<f64>) -> Self {
        let delta = match bend.y.atan2(bend.x) {
            _ if bend == Vector2::zeros() => 0.0,
            // Of a bend along −x whose y is −0.
            delta if delta == -PI => PI,
            delta => delta,
        };
        Self { theta: bend.norm(), delta }
    }

    /// θ (cos δ, sin δ), rad: the same configuration without the polar singularity at θ = 0.
    pub fn bend_vector(&self) -> Vector2<f64> {
        self.theta * Vector2::new(self.delta.cos(), self.delta.sin())
    }

    /// θ in degrees.
    pub fn theta_deg(&self) -> f64 {
        self.theta.to_degrees()
    }

    /// δ in degrees, in (−180, 180].
    pub fn delta_deg(&self) -> f64 {
        wrap_degrees(self.delta.to_degrees())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_turn_jacobian_is_that_of_differences() {
        for turn in [Vector3::new(0.4, -0.7, 1.1), Vector3::new(3e-4, 2e-4, -5e-4), Vector3::zeros()] {
            let turned = |by: Vector3<f64>| UnitQuaternion::from_scaled_axis(turn + by);
            let step = 1e-5;
            for axis in 0..3 {
                let by = Vector3::ith(axis, step);
                let column = (turned(by) * turned(-by).inverse()).scaled_axis() / (2.0 * step);
                assert!((column - turn_jacobian(&turn).column(axis)).norm() < 1e-8);
            }
        }
    }
}
