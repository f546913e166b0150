//! One cross-section of the body in the camera's frame, and points of the body's surface on it.

use super::parts::{BodyPoint, Piece};
use super::projection::Projection;
use crate::camera::Lens;
use crate::robot::Curve;
use nalgebra::{Matrix3, Point2, Point3, Vector2, Vector3};

/// A point of a surface that may lie on the silhouette's border; the rest of the body is not taken into account yet.
pub(super) struct SurfacePoint {
    pub body: BodyPoint,
    pub piece: Piece,
    /// See [`OutlinePoint::lateral`](super::OutlinePoint::lateral).
    pub lateral: f64,
    /// See [`OutlinePoint::face_px`](super::OutlinePoint::face_px).
    pub face_px: f64,
    /// Where it is seen, px.
    pub pixel: Point2<f64>,
    /// The projection of a direction that points out of the snake.
    pub outward: Vector2<f64>,
    /// The projection of the border's direction.
    pub along: Vector2<f64>,
}

/// A section of the snake as the camera sees it.
pub(super) struct Section<'a> {
    lens: &'a Lens,
    /// Arc length, mm.
    pub s_mm: f64,
    /// Rotation from the section's frame to the camera's.
    camera_from_section: Matrix3<f64>,
    /// The section's origin in the camera frame, mm.
    origin_mm: Vector3<f64>,
    /// The camera's centre of projection in the section's frame, mm.
    pub camera_centre: Point3<f64>,
}

impl<'a> Section<'a> {
    pub fn new(view: &Projection<'a>, curve: &Curve, s_mm: f64) -> Self {
        let pose = view.camera_from_base * curve.frame_at(s_mm);
        let camera_from_section = pose.rotation.to_rotation_matrix().into_inner();
        let origin_mm = pose.translation.vector;
        let camera_centre = Point3::from(-camera_from_section.tr_mul(&origin_mm));
        Self { lens: view.lens, s_mm, camera_from_section, origin_mm, camera_centre }
    }

    /// How large a millimetre across the line of sight is seen at a point of the section's frame (mm), px, and the sine of the angle at
    /// which the plane through it across the tangent is seen: positive from the side of the tip.
    pub fn scale_and_slant(&self, local: Vector3<f64>) -> (f64, f64) {
        let sight = self.camera_centre.coords - local;
        let distance_mm = sight.norm();
        (self.lens.focal_px.x / distance_mm, sight.z / distance_mm)
    }

    fn in_camera(&self, local: Vector3<f64>) -> Point3<f64> {
        Point3::from(self.camera_from_section * local + self.origin_mm)
    }

    /// The pixel of a point of the section's frame (mm).
    pub fn pixel(&self, local: Vector3<f64>) -> Point2<f64> {
        self.lens.project(&self.in_camera(local))
    }

    /// The pixel of a point, and the projection of a direction at it, px per unit of the direction.
    pub fn pixel_and_direction(&self, local: Vector3<f64>, direction: Vector3<f64>) -> (Point2<f64>, Vector2<f64>) {
        let (pixel, jacobian) = self.lens.project_with_jacobian(&self.in_camera(local));
        (pixel, jacobian * (self.camera_from_section * direction))
    }

    /// A surface point with its outward and tangential directions; vectors are in the section's frame.
    pub fn surface_point(
        &self,
        local: Vector3<f64>,
        piece: Piece,
        lateral: f64,
        outward: Vector3<f64>,
        along: Vector3<f64>,
    ) -> SurfacePoint {
        let (pixel, jacobian) = self.lens.project_with_jacobian(&self.in_camera(local));
        let project = jacobian * self.camera_from_section;
        SurfacePoint {
            body: BodyPoint { s_mm: self.s_mm, local },
            piece,
            lateral,
            face_px: 0.0,
            pixel,
            outward: project * outward,
            along: project * along,
        }
    }
}
