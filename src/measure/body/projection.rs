//! The body seen by a camera.

use super::parts::{BodyPoint, HOLDER_MM};
use crate::camera::Lens;
use crate::geometry::Pose;
use crate::measure::image::plane::Region;
use crate::robot::{BendProfile, Curve, Robot};
use nalgebra::{Point2, Point3, Vector2, Vector3};

/// Distance between the points of the snake's axis from which its region of the picture is drawn, mm.
///
/// Convention: a small part of the diameter; the region's margin is far wider.
const AXIS_STEP_MM: f64 = 1.0;
/// Distance between outline points in the coarse stages, as a share of the snake's diameter in the picture.
///
/// Derived: π/0.1 = 31 points around a disk's two rims and sides, more than the two numbers of the bend need many times over.
const COARSE_SPACING: f64 = 0.1;
/// The least such distance, px.
///
/// Convention: a limit on the work; the fine stage, which gives the answer, takes every second pixel.
const LEAST_COARSE_SPACING_PX: f64 = 6.0;

/// What is needed to project the body: where the camera is and what it looks at.
#[derive(Debug, Clone)]
pub struct Projection<'a> {
    /// Intrinsics.
    pub lens: &'a Lens,
    /// The view's camera pose.
    pub camera_from_base: Pose,
    /// The robot.
    pub robot: &'a Robot,
}

impl<'a> Projection<'a> {
    /// The centreline of the robot's snake with this bend.
    pub fn curve(&self, profile: impl Into<BendProfile>) -> Curve {
        Curve::new(self.robot, &profile.into())
    }

    /// How long the straight snake is in the picture, px.
    pub fn straight_length_px(&self) -> f64 {
        let straight = self.curve(BendProfile::arc(Vector2::zeros()));
        let on_axis = |s_mm| self.pixel(&straight, &BodyPoint { s_mm, local: Vector3::zeros() });
        (on_axis(self.robot.length_mm) - on_axis(0.0)).norm()
    }

    /// The pixel of a body point.
    pub fn pixel(&self, curve: &Curve, point: &BodyPoint) -> Point2<f64> {
        self.lens.project(&(self.camera_from_base * point.in_base(curve)))
    }

    /// The pixel of a point of the holder, which does not bend.
    pub(crate) fn holder_pixel(&self, point: &BodyPoint) -> Point2<f64> {
        self.lens.project(&(self.camera_from_base * Point3::from(point.local + Vector3::new(0.0, 0.0, point.s_mm))))
    }

    /// Where the middle of the modelled holder's lower end is seen, px, and the direction in the picture from there to the snake.
    pub(crate) fn holder_end(&self) -> (Point2<f64>, Vector2<f64>) {
        let at = |z_mm: f64| self.holder_pixel(&BodyPoint { s_mm: 0.0, local: Vector3::new(0.0, 0.0, z_mm) });
        (at(-HOLDER_MM), (at(0.0) - at(-HOLDER_MM)).normalize())
    }

    /// The part of the picture that the body covers, and `reach_px` around it.
    pub(crate) fn image_region(&self, profile: impl Into<BendProfile>, reach_px: f64) -> Region {
        let curve = self.curve(profile);
        let (robot, lens) = (self.robot, self.lens);
        let tool = robot.body.tool;
        let end_mm = robot.length_mm + tool.map_or(0.0, |tool| tool.length_mm);
        let steps = ((end_mm + HOLDER_MM) / AXIS_STEP_MM).ceil() as usize;
        let axis_pixel = |k: usize| {
            let along_mm = end_mm - k as f64 * AXIS_STEP_MM;
            let s_mm = along_mm.min(robot.length_mm);
            self.pixel(&curve, &BodyPoint { s_mm, local: Vector3::new(0.0, 0.0, along_mm - s_mm) })
        };
        let wider = tool.map_or(1.0, |tool| (tool.diameter_mm / robot.body.disk_diameter_mm).max(1.0));
        let reach_px = 0.5 * wider * self.diameter_px() + reach_px;
        Region::along((0..=steps).map(axis_pixel), reach_px, (lens.width, lens.height))
    }

    /// The snake's diameter in the picture at the base, px.
    pub(crate) fn diameter_px(&self) -> f64 {
        let depth_mm = self.camera_from_base.translation.vector.z.max(1.0);
        self.robot.body.disk_diameter_mm * self.lens.focal_px.max() / depth_mm
    }

    /// Distance between outline points in the coarse stages of a fit, px.
    pub(crate) fn coarse_spacing_px(&self) -> f64 {
        (COARSE_SPACING * self.diameter_px()).max(LEAST_COARSE_SPACING_PX)
    }
}
