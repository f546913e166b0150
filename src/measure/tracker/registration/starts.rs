//! Where a registration begins: the directions of the base's axis that fit the positions best.

use super::Registration;
use crate::geometry::{Configuration, Pose};
use crate::observation::TrackerPose;
use crate::robot::Robot;
use nalgebra::{Point3, SMatrix, Translation3, UnitQuaternion, Vector3};
use std::f64::consts::{PI, TAU};

/// The noise that the first fit begins with, mm and rad.
///
/// Convention: what common trackers are good to; learned from then on.
const FIRST_SIGMAS: (f64, f64) = (0.5, 0.02);
/// Poses by which directions of the axis are compared, and how many directions.
///
/// Convention: directions 13° apart; a fit from the best of them converges.
const COMPARED: (usize, usize) = (100, 300);
/// From how many directions a fit is started, and how far they are apart at least, as a cosine.
///
/// Convention: 40°. The surface that a tip reaches is nearly a sphere, on which a base on the other side is a side minimum.
const STARTS: (usize, f64) = (4, 0.766);
/// What a compared pose costs at most, mm².
///
/// Convention: (3 mm)², so that jumps do not decide.
const MOST_COST_MM2: f64 = 9.0;

impl Registration {
    /// The directions of the axis whose arcs the positions fit best, each with the base straight below the straight tip.
    pub(super) fn starts(poses: &[&TrackerPose], straight: &TrackerPose, robot: &Robot) -> Option<Vec<Self>> {
        let tip = straight.position_mm?;
        let compared: Vec<_> = poses.iter().step_by(poses.len().div_ceil(COMPARED.0)).collect();
        let mut directions: Vec<(f64, Self)> = sphere(COMPARED.1)
            .map(|axis| {
                let start = Self::start(straight, robot, tip - axis * robot.length_mm, &axis);
                (compared.iter().map(|pose| start.cost_mm2(pose)).sum(), start)
            })
            .collect();
        directions.sort_by(|(one, _), (other, _)| one.total_cmp(other));
        let mut starts: Vec<Self> = Vec::new();
        for (_, start) in directions {
            let is_new = starts.iter().all(|other| other.axis().dot(&start.axis()) < STARTS.1);
            if is_new && starts.len() < STARTS.0 {
                starts.push(start);
            }
        }
        Some(starts)
    }

    /// With the base where it is stated, and its axis towards the straight tip.
    pub(super) fn stated(straight: &TrackerPose, robot: &Robot, base_mm: Point3<f64>) -> Option<Self> {
        let snake_mm = straight.position_mm? - base_mm;
        let mut start = Self::start(straight, robot, base_mm, &snake_mm.try_normalize(0.0)?);
        start.stated_base_mm = Some(base_mm);
        start.sensor_mm.z = snake_mm.norm() - robot.length_mm;
        Some(start)
    }

    /// A base in this place with this axis, and a sensor in the middle of the tip.
    fn start(straight: &TrackerPose, robot: &Robot, base_mm: Point3<f64>, axis: &Vector3<f64>) -> Self {
        let rotation = UnitQuaternion::rotation_between(&Vector3::z(), axis)
            .unwrap_or(UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI));
        Self {
            robot: robot.clone(),
            tracker_from_base: Pose::from_parts(Translation3::from(base_mm), rotation),
            sensor_mm: Vector3::zeros(),
            turn: straight.orientation.map_or(UnitQuaternion::identity(), |seen| rotation.inverse() * seen),
            shortening: 0.0,
            sigma_mm: FIRST_SIGMAS.0,
            sigma_rad: FIRST_SIGMAS.1,
            design_effects: (1.0, 1.0),
            has_orientations: straight.orientation.is_some(),
            stated_base_mm: None,
            covariance: SMatrix::zeros(),
        }
    }

    /// The direction of the base's axis in the tracker's frame.
    fn axis(&self) -> Vector3<f64> {
        self.tracker_from_base.rotation * Vector3::z()
    }

    /// How far a position lies from the arc that leads nearest to it, squared; no more than an outlier's.
    fn cost_mm2(&self, pose: &TrackerPose) -> f64 {
        let Some(position) = pose.position_mm else { return 0.0 };
        let bend = self.first_bend(pose);
        let tip = self.robot.frame_at(Configuration::from_bend_vector(bend), self.robot.length_mm);
        let off = self.tracker_from_base.inverse_transform_point(&position).coords - tip.translation.vector;
        off.norm_squared().min(MOST_COST_MM2)
    }
}

/// Directions spread evenly over the sphere.
///
/// Source: the Fibonacci lattice; Á. González, Mathematical Geosciences 42, 2010.
fn sphere(count: usize) -> impl Iterator<Item = Vector3<f64>> {
    let golden = (1.0 + 5f64.sqrt()) / 2.0;
    (0..count).map(move |k| {
        let z = 1.0 - (2.0 * k as f64 + 1.0) / count as f64;
        let (sin, cos) = (TAU * k as f64 / golden).sin_cos();
        let side = (1.0 - z * z).sqrt();
        Vector3::new(side * cos, side * sin, z)
    })
}
