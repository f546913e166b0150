//! A snake that is not bent to a circular arc.
//!
//! The circle has the bend rate b/L all along, b being the bend vector. The simplest departure from it varies linearly along
//! the snake, (b + e (2s/L − 1))/L: its part of e along b is a curvature that grows towards the tip, its part across b a
//! snake that leaves its plane. The bend from base to tip stays b. The frames are turned by bending alone, without twist, as
//! on the circle.

use super::Robot;
use super::kinematics::arc;
use crate::geometry::Pose;
use nalgebra::{Translation3, Vector2};

/// The centreline of a snake with a departure from the circle, as a chain of arcs.
#[derive(Debug, Clone)]
pub struct Curve {
    /// Each arc's first frame in {b} and its bend vector (rad).
    arcs: Vec<(Pose, Vector2<f64>)>,
    arc_length_mm: f64,
    tip: Pose,
}

/// So many arcs are within L |e| / (6 · 26²) of the curve, a tenth of a micrometre for every degree of departure: within one the
/// true angle is off by a parabola whose integral is a sixth of its share.
const ARCS: usize = 26;

impl Curve {
    /// From the bend vector b and the departure e, rad.
    pub fn new(robot: &Robot, bend: Vector2<f64>, departure: Vector2<f64>) -> Self {
        let arc_length_mm = robot.length_mm / ARCS as f64;
        let mut tip = Pose::identity();
        let mut arcs = Vec::with_capacity(ARCS);
        for k in 0..ARCS {
            let along = (2.0 * k as f64 + 1.0) / ARCS as f64 - 1.0;
            let share = (bend + departure * along) / ARCS as f64;
            arcs.push((tip, share));
            tip *= arc(share, arc_length_mm);
        }
        Self { arcs, arc_length_mm, tip }
    }

    /// The frame at arc length `s_mm`, as [`Robot::frame_at`] gives it for the circle; straight on beyond both ends.
    pub fn frame_at(&self, s_mm: f64) -> Pose {
        if s_mm <= 0.0 {
            return Pose::translation(0.0, 0.0, s_mm);
        }
        let k = (s_mm / self.arc_length_mm) as usize;
        match self.arcs.get(k) {
            Some((start, bend)) => {
                let within_mm = s_mm - k as f64 * self.arc_length_mm;
                start * arc(bend * (within_mm / self.arc_length_mm), within_mm)
            }
            None => self.tip * Translation3::new(0.0, 0.0, s_mm - self.arcs.len() as f64 * self.arc_length_mm),
        }
    }

    /// The arcs from the base to the tip: each one's first frame in {b}, its bend vector (rad) and its length, mm.
    pub fn arcs(&self) -> impl Iterator<Item = (Pose, Vector2<f64>, f64)> {
        self.arcs.iter().map(|(start, bend)| (*start, *bend, self.arc_length_mm))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Configuration;
    use nalgebra::{Point3, UnitQuaternion, Vector3};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn without_a_departure_it_is_the_circle(theta in 0.0..2.0f64, delta in -3.1..3.1f64, s in -5.0..30.0f64) {
            let (robot, psi) = (Robot::default(), Configuration::new(theta, delta));
            let (curve, circle) = (Curve::new(&robot, psi.bend_vector(), Vector2::zeros()), robot.frame_at(psi, s));
            let here = curve.frame_at(s);
            prop_assert!((here.translation.vector - circle.translation.vector).norm() < 1e-9);
            prop_assert!(here.rotation.angle_to(&circle.rotation) < 1e-7);
        }

        /// Against the differential equations R' = R [ω]×, x' = R z by many small steps.
        #[test]
        fn it_solves_the_equations_of_the_curve(
            bend in proptest::array::uniform2(-1.2..1.2f64), departure in proptest::array::uniform2(-0.3..0.3f64),
        ) {
            let (robot, steps) = (Robot::default(), 4000);
            let (b, e) = (Vector2::from(bend), Vector2::from(departure));
            let curve = Curve::new(&robot, b, e);
            let (mut x, mut r) = (Point3::origin(), UnitQuaternion::identity());
            let ds = robot.length_mm / f64::from(steps);
            for k in 0..steps {
                let rate = (b + e * (2.0 * (f64::from(k) + 0.5) / f64::from(steps) - 1.0)) / robot.length_mm;
                let turn = UnitQuaternion::from_scaled_axis(Vector3::new(-rate.y, rate.x, 0.0) * ds);
                x += r * turn.powf(0.5) * Vector3::z() * ds;
                r *= turn;
            }
            let tip = curve.frame_at(robot.length_mm);
            let bound_mm = robot.length_mm * e.norm() / (6.0 * (ARCS * ARCS) as f64);
            prop_assert!((tip.translation.vector - x.coords).norm() < bound_mm + 1e-4);
            prop_assert!(tip.rotation.angle_to(&r) < 2e-4);
        }
    }
}
