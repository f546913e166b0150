//! The pinhole camera with OpenCV's distortion model.
//!
//! Source: OpenCV documentation, calib3d, "Detailed description" (rational, tangential and thin-prism terms).

use nalgebra::{Point2, Point3, Vector2, Vector3};

/// Intrinsics and distortion of one camera. Pixel centres are at integers.
#[derive(Debug, Clone, PartialEq)]
pub struct Lens {
    /// Image width, px.
    pub width: u32,
    /// Image height, px.
    pub height: u32,
    /// Focal lengths (fx, fy), px.
    pub focal_px: Vector2<f64>,
    /// Principal point (cx, cy), px.
    pub centre_px: Point2<f64>,
    /// k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4; a camera with 5 or 8 coefficients has zeros for the rest.
    pub distortion: [f64; 12],
}

impl Lens {
    /// The pixel at which a point of the camera frame (mm, z > 0) is seen.
    ///
    /// Points at or behind the camera project to NaN, which no image contains.
    pub fn project(&self, point: &Point3<f64>) -> Point2<f64> {
        if point.z <= 0.0 {
            return Point2::new(f64::NAN, f64::NAN);
        }
        let distorted = self.distort(Point2::new(point.x / point.z, point.y / point.z));
        Point2::new(self.focal_px.x * distorted.x + self.centre_px.x, self.focal_px.y * distorted.y + self.centre_px.y)
    }

    /// The direction (unit length, camera frame) from which light falls on a pixel.
    pub fn ray(&self, pixel: &Point2<f64>) -> Vector3<f64> {
        let ideal = self.undistort(Point2::new(
            (pixel.x - self.centre_px.x) / self.focal_px.x,
            (pixel.y - self.centre_px.y) / self.focal_px.y,
        ));
        Vector3::new(ideal.x, ideal.y, 1.0).normalize()
    }

    /// Whether a pixel position lies within the picture, at least `margin` px from its border.
    pub fn contains(&self, pixel: &Point2<f64>, margin: f64) -> bool {
        pixel.x >= margin
            && pixel.y >= margin
            && pixel.x <= f64::from(self.width) - 1.0 - margin
            && pixel.y <= f64::from(self.height) - 1.0 - margin
    }

    /// Ideal normalised coordinates (x/z, y/z) to distorted ones.
    pub fn distort(&self, ideal: Point2<f64>) -> Point2<f64> {
        let [k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4] = self.distortion;
        let (x, y) = (ideal.x, ideal.y);
        let r2 = x * x + y * y;
        let radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
        Point2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + s1 * r2 + s2 * r2 * r2,
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + s3 * r2 + s4 * r2 * r2,
        )
    }

    /// The inverse of [`distort`](Self::distort), by fixed-point iteration; converges for the distortions of real lenses.
    fn undistort(&self, distorted: Point2<f64>) -> Point2<f64> {
        let mut ideal = distorted;
        for _ in 0..50 {
            let error = self.distort(ideal) - distorted;
            ideal -= error;
            if error.norm() < 1e-14 {
                break;
            }
        }
        ideal
    }
}
