//! A view of the robot for the unit tests of the rooms: no picture is rendered.

use super::body::Projection;
use crate::camera::Lens;
use crate::geometry::Pose;
use crate::robot::Robot;
use nalgebra::{Matrix3, Point2, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};

/// A camera and the robot before it.
pub struct Scene {
    pub lens: Lens,
    pub camera_from_base: Pose,
    pub robot: Robot,
}

impl Scene {
    /// A pinhole camera of 800 × 600 px that looks at the snake from the side, 120 mm away, so that a disk is 52 px wide, turned by
    /// `turn` (rad, about its own axes) about the base.
    pub fn new(turn: Vector3<f64>) -> Self {
        // The camera's x is the base's x, its y points against z_b and its z along y_b.
        let facing = Rotation3::from_matrix_unchecked(Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0));
        let rotation = UnitQuaternion::from_scaled_axis(turn) * UnitQuaternion::from_rotation_matrix(&facing);
        Self {
            lens: Lens {
                width: 800,
                height: 600,
                focal_px: Vector2::repeat(1500.0),
                centre_px: Point2::new(399.5, 299.5),
                distortion: [0.0; 12],
                fisheye: None,
            },
            camera_from_base: Pose::from_parts(Translation3::new(0.0, 12.0, 120.0), rotation),
            robot: Robot::default(),
        }
    }

    pub fn view(&self) -> Projection<'_> {
        Projection { lens: &self.lens, camera_from_base: self.camera_from_base, robot: &self.robot }
    }
}
