//! The pinhole camera with OpenCV's distortion model, and its fisheye camera.
//!
//! Source: OpenCV documentation, calib3d, "Detailed description" (rational, tangential and thin-prism terms); "Fisheye camera model", which is
//! that of J. Kannala, S. S. Brandt, IEEE Transactions on Pattern Analysis and Machine Intelligence 28, 2006, with angles from the axis.

use nalgebra::{Matrix2, Matrix2x3, Point2, Point3, RowVector3, Vector2, Vector3};

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
    /// k1 k2 k3 k4 of a fisheye (equidistant model), in place of `distortion`.
    pub fisheye: Option<[f64; 4]>,
}

impl Lens {
    /// The pixel at which a point of the camera frame (mm, z > 0) is seen.
    ///
    /// Points at or behind the camera, and those with a NaN in them, project to NaN, which no image contains.
    pub fn project(&self, point: &Point3<f64>) -> Point2<f64> {
        self.project_with_jacobian(point).0
    }

    /// The pixel of [`project`](Self::project), and how it follows the point, px per mm.
    // So that nothing of the slopes is worked out where only the pixel is asked for.
    #[inline(always)]
    pub fn project_with_jacobian(&self, point: &Point3<f64>) -> (Point2<f64>, Matrix2x3<f64>) {
        if point.z <= 0.0 || point.iter().any(|v| v.is_nan()) {
            return (Point2::new(f64::NAN, f64::NAN), Matrix2x3::repeat(f64::NAN));
        }
        let per_z = 1.0 / point.z;
        let (x, y) = (point.x * per_z, point.y * per_z);
        let (distorted, slopes) = self.distort_with_jacobian(Point2::new(x, y));
        let seen = distorted.coords.component_mul(&self.focal_px) + self.centre_px.coords;
        let row = |axis: usize| {
            let per_mm = self.focal_px[axis] * per_z;
            let (by_x, by_y) = (per_mm * slopes[(axis, 0)], per_mm * slopes[(axis, 1)]);
            RowVector3::new(by_x, by_y, -(by_x * x + by_y * y))
        };
        (seen.into(), Matrix2x3::from_rows(&[row(0), row(1)]))
    }

    /// The direction (unit length, camera frame) from which light falls on a pixel.
    ///
    /// NaN for a pixel that the distortion model reaches from no direction.
    pub fn ray(&self, pixel: &Point2<f64>) -> Vector3<f64> {
        let ideal = self.undistort(Point2::new(
            (pixel.x - self.centre_px.x) / self.focal_px.x,
            (pixel.y - self.centre_px.y) / self.focal_px.y,
        ));
        Vector3::new(ideal.x, ideal.y, 1.0).normalize()
    }

    /// The lens of the same picture made half as large, each pixel the mean of four.
    #[must_use]
    pub fn halved(&self) -> Self {
        let half = Vector2::new(0.5, 0.5);
        Self {
            width: self.width / 2,
            height: self.height / 2,
            focal_px: self.focal_px / 2.0,
            centre_px: (self.centre_px + half) / 2.0 - half,
            ..self.clone()
        }
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
        self.distort_with_jacobian(ideal).0
    }

    /// The same, and how the distorted coordinates (rows) follow the ideal ones.
    #[inline(always)]
    fn distort_with_jacobian(&self, ideal: Point2<f64>) -> (Point2<f64>, Matrix2<f64>) {
        if let Some(coefficients) = self.fisheye {
            return fisheye_with_jacobian(coefficients, ideal);
        }
        let [k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4] = self.distortion;
        let (x, y) = (ideal.x, ideal.y);
        let r2 = x * x + y * y;
        let (numerator, denominator) = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
        let per_denominator = 1.0 / denominator;
        let radial = numerator * per_denominator;
        let distorted = Point2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + s1 * r2 + s2 * r2 * r2,
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + s3 * r2 + s4 * r2 * r2,
        );
        // By r², as are the thin prism's slopes.
        let radial_slope =
            (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3) - radial * (k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6))) * per_denominator;
        let (prism_x, prism_y) = (s1 + 2.0 * s2 * r2, s3 + 2.0 * s4 * r2);
        let cross = 2.0 * radial_slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y;
        let slopes = Matrix2::new(
            radial + 2.0 * radial_slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x + 2.0 * prism_x * x,
            cross + 2.0 * prism_x * y,
            cross + 2.0 * prism_y * x,
            radial + 2.0 * radial_slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x + 2.0 * prism_y * y,
        );
        (distorted, slopes)
    }

    /// The inverse of [`distort`](Self::distort), by Newton's method with halved steps where a full one does not help.
    /// NaN where there is none: outside what the distortion model can image.
    fn undistort(&self, distorted: Point2<f64>) -> Point2<f64> {
        let missed = |ideal| {
            let (seen, slopes) = self.distort_with_jacobian(ideal);
            (seen - distorted, slopes)
        };
        let mut ideal = distorted;
        let (mut error, mut slopes) = missed(ideal);
        for _ in 0..30 {
            // A step squares the error: the one before this was made from 3e-7 at the most.
            if error.norm() < 1e-13 {
                return ideal;
            }
            let Some(step) = slopes.try_inverse().map(|inverse| inverse * error) else { break };
            let nearer = [1.0, 0.5, 0.25, 0.125].into_iter().find_map(|share| {
                let next = ideal - share * step;
                let (next_error, next_slopes) = missed(next);
                (next_error.norm() < error.norm()).then_some((next, next_error, next_slopes))
            });
            let Some(next) = nearer else { break };
            (ideal, error, slopes) = next;
        }
        // Rounding may keep the last digits from settling.
        if error.norm() < 1e-11 { ideal } else { Point2::new(f64::NAN, f64::NAN) }
    }
}

/// The fisheye's distorted coordinates, s (x, y) with s = θ_d/r, θ_d = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸), θ = atan r; and how they follow the
/// ideal ones: s 1 + (s'/r) (x, y)ᵗ(x, y).
fn fisheye_with_jacobian([k1, k2, k3, k4]: [f64; 4], ideal: Point2<f64>) -> (Point2<f64>, Matrix2<f64>) {
    /// Below it the angle is the tangent to rounding, and the quotients would lose their digits.
    ///
    /// Derived: the next terms are of relative size r².
    const NEAR_AXIS: f64 = 1e-7;
    let r = ideal.coords.norm();
    if r < NEAR_AXIS {
        return (ideal, Matrix2::identity());
    }
    let angle = r.atan();
    let a2 = angle * angle;
    let distorted = angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))));
    let slope = 1.0 + a2 * (3.0 * k1 + a2 * (5.0 * k2 + a2 * (7.0 * k3 + a2 * 9.0 * k4)));
    let scale = distorted / r;
    let scale_slope = (slope / (1.0 + r * r) - scale) / r;
    let slopes = Matrix2::identity() * scale + ideal.coords * ideal.coords.transpose() * (scale_slope / r);
    ((ideal.coords * scale).into(), slopes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;
    use proptest::prelude::*;

    fn lens(coefficients: &[f64]) -> Lens {
        let mut distortion = [0.0; 12];
        distortion[..coefficients.len()].copy_from_slice(coefficients);
        Lens {
            width: 1280,
            height: 720,
            focal_px: Vector2::new(800.0, 820.0),
            centre_px: Point2::new(639.5, 359.5),
            distortion,
            fisheye: None,
        }
    }

    const FISHEYE: [f64; 4] = [0.08, -0.03, 0.012, -0.004];
    const FISHEYE_POINTS: [([f64; 3], [f64; 2]); 4] = [
        ([0.3, -0.2, 1.7], [779.0932792799838, 264.1112591586777]),
        ([-40.0, 25.0, 90.0], [306.3856318680165, 572.901392084552]),
        ([12.0, -3.5, 30.0], [946.2722126595572, 267.7878905903199]),
        ([90.0, 40.0, 50.0], [1497.2350916901255, 750.2459862143904]),
    ];

    /// The pixels are those of OpenCV 5.0's `cv::fisheye::projectPoints` for the same camera.
    #[test]
    fn a_fisheye_projects_as_opencv_does() {
        let lens = Lens { fisheye: Some(FISHEYE), ..lens(&[]) };
        for (point, pixel) in FISHEYE_POINTS {
            assert_abs_diff_eq!(lens.project(&Point3::from(point)), Point2::from(pixel), epsilon = 1e-9);
        }
        assert_abs_diff_eq!(lens.project(&Point3::new(0.0, 0.0, 9.0)), Point2::new(639.5, 359.5), epsilon = 1e-12);
    }

    proptest! {
        #[test]
        fn a_fisheyes_ray_gives_its_pixel_back_and_its_jacobian_is_its_derivative(u in 0.0..1279.0, v in 0.0..719.0) {
            let lens = Lens { fisheye: Some(FISHEYE), ..lens(&[]) };
            let ray = lens.ray(&Point2::new(u, v));
            let (back, jacobian) = lens.project_with_jacobian(&Point3::from(50.0 * ray));
            prop_assert!((back - Point2::new(u, v)).norm() < 1e-8, "{u} {v} comes back as {back}");
            for axis in 0..3 {
                let step = Vector3::ith(axis, 1e-4);
                let at = |step: Vector3<f64>| lens.project(&Point3::from(50.0 * ray + step));
                prop_assert!(((at(step) - at(-step)) / 2e-4 - jacobian.column(axis)).norm() < 1e-6);
            }
        }
    }

    const COEFFICIENTS: [f64; 12] =
        [-0.28, 0.07, 0.0012, -0.0009, 0.013, 0.021, -0.015, 0.004, 0.0011, -0.0007, 0.0015, 0.0003];

    /// The pixels are those of OpenCV 4.6's `cv::projectPoints` for the same camera.
    #[test]
    fn projects_as_opencv_does() {
        let points = [[0.3, -0.2, 1.7], [-40.0, 25.0, 90.0], [12.0, -3.5, 30.0], [1e-3, 2e-3, 5.0]];
        let expected = [
            (
                5,
                [
                    [778.801400961347, 264.332840830969],
                    [308.598431833867, 571.627412013836],
                    [944.196367133916, 268.541945450590],
                    [639.659999943040, 359.828000375232],
                ],
            ),
            (
                8,
                [
                    [778.673998488117, 264.419899187676],
                    [310.149438847108, 570.633798145979],
                    [943.218586993370, 268.834260971774],
                    [639.659999942368, 359.828000373854],
                ],
            ),
            (
                12,
                [
                    [778.712450135008, 264.475725674428],
                    [310.348912250553, 570.990230530524],
                    [943.354485913123, 269.055217279644],
                    [639.660000118368, 359.828000619854],
                ],
            ),
        ];
        for (count, pixels) in expected {
            let lens = lens(&COEFFICIENTS[..count]);
            for (point, pixel) in points.iter().zip(pixels) {
                assert_abs_diff_eq!(lens.project(&Point3::from(*point)), Point2::from(pixel), epsilon = 1e-9);
            }
        }
    }

    #[test]
    fn without_distortion_a_pixel_is_a_ratio() {
        let pixel = lens(&[]).project(&Point3::new(20.0, -10.0, 200.0));
        assert_abs_diff_eq!(pixel, Point2::new(639.5 + 80.0, 359.5 - 41.0), epsilon = 1e-12);
        assert_abs_diff_eq!(lens(&[]).ray(&Point2::new(639.5, 359.5)), Vector3::z(), epsilon = 1e-15);
    }

    proptest! {
        #[test]
        fn the_projections_jacobian_is_its_derivative(x in -30.0..30.0f64, y in -20.0..20.0f64, z in 40.0..200.0f64) {
            let (lens, point) = (lens(&COEFFICIENTS), Point3::new(x, y, z));
            let (pixel, jacobian) = lens.project_with_jacobian(&point);
            prop_assert_eq!(pixel, lens.project(&point));
            for axis in 0..3 {
                let step = Vector3::ith(axis, 1e-4);
                let numeric = (lens.project(&(point + step)) - lens.project(&(point - step))) / 2e-4;
                prop_assert!((numeric - jacobian.column(axis)).norm() < 1e-6);
            }
        }
    }

    #[test]
    fn what_cannot_be_imaged_is_nan_and_in_no_picture() {
        let lens = lens(&COEFFICIENTS);
        for point in
            [[0.0, 0.0, 0.0], [1.0, 2.0, -5.0], [f64::NAN, 0.0, 1.0], [0.0, f64::NAN, 1.0], [0.0, 0.0, f64::NAN]]
        {
            let pixel = lens.project(&Point3::from(point));
            assert!(pixel.x.is_nan() && pixel.y.is_nan() && !lens.contains(&pixel, 0.0), "{point:?} gives {pixel}");
        }
        // A strong barrel sees nothing beyond the radius where r (1 + k1 r²) turns back: r = 1 / √(−3 k1), image 2/3 of it.
        let barrel = Lens { distortion: [-0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], ..lens };
        let limit = 800.0 * 2.0 / 3.0 / 1.5f64.sqrt();
        assert!(barrel.ray(&Point2::new(639.5 + 0.99 * limit, 359.5)).iter().all(|v| v.is_finite()));
        assert!(barrel.ray(&Point2::new(639.5 + 1.01 * limit, 359.5)).iter().all(|v| v.is_nan()));
    }

    #[test]
    fn the_lens_of_a_picture_half_as_large_sees_a_point_in_the_middle_of_its_four_pixels() {
        let lens = lens(&[-0.2, 0.1]);
        let point = Point3::new(3.0, -2.0, 90.0);
        let (whole, half) = (lens.project(&point), lens.halved().project(&point));
        assert_abs_diff_eq!(whole, half * 2.0 + Vector2::new(0.5, 0.5), epsilon = 1e-9);
    }

    /// Whether the radial distortion grows all the way to the picture's corners, and so has an inverse there.
    /// To spare is what the tangential and prism terms of the property below can add: 0.02 at the corners.
    fn images_the_corners(lens: &Lens) -> bool {
        let [k1, k2, _, _, k3, k4, k5, k6, ..] = lens.distortion;
        let corner = lens.centre_px.coords.component_div(&lens.focal_px).norm() + 0.02;
        let radii = (0..2000).map(|i| {
            let r = f64::from(i) * 1e-3;
            let r2 = r * r;
            r * (1.0 + k1 * r2 + k2 * r2.powi(2) + k3 * r2.powi(3))
                / (1.0 + k4 * r2 + k5 * r2.powi(2) + k6 * r2.powi(3))
        });
        let mut before = -1.0;
        for radius in radii {
            if radius <= before || radius >= corner {
                return radius >= corner;
            }
            before = radius;
        }
        false
    }

    proptest! {
        /// Over whole pictures of lenses as laboratories have them, normal to wide-angle, whose model does not fold
        /// before the corners.
        #[test]
        fn projecting_a_ray_gives_its_pixel_back(
            u in 0.0..1279.0, v in 0.0..719.0, depth_mm in 1.0..1000.0,
            k1 in -0.35..0.1, k2 in 0.0..0.1, k3 in -0.02..0.02, p in proptest::array::uniform2(-0.002..0.002f64),
            rational in proptest::array::uniform3(-0.02..0.02f64), prism in proptest::array::uniform4(-0.002..0.002f64),
        ) {
            let lens = Lens {
                distortion: [
                    k1, k2, p[0], p[1], k3, rational[0], rational[1], rational[2], prism[0], prism[1], prism[2], prism[3],
                ],
                focal_px: Vector2::new(1000.0, 1010.0),
                ..lens(&[])
            };
            prop_assume!(images_the_corners(&lens));
            let pixel = Point2::new(u, v);
            let ray = lens.ray(&pixel);
            prop_assert!((ray.norm() - 1.0).abs() < 1e-12);
            let back = lens.project(&Point3::from(depth_mm * ray));
            prop_assert!((back - pixel).norm() < 1e-9, "{pixel} comes back as {back}");
        }

        #[test]
        fn the_jacobian_is_the_slope(x in -0.8..0.8, y in -0.8..0.8) {
            let lens = lens(&COEFFICIENTS);
            let step = 1e-6;
            let slope = |dx, dy| {
                (lens.distort(Point2::new(x + dx, y + dy)) - lens.distort(Point2::new(x - dx, y - dy))) / (2.0 * step)
            };
            let numeric = Matrix2::from_columns(&[slope(step, 0.0), slope(0.0, step)]);
            prop_assert!((lens.distort_with_jacobian(Point2::new(x, y)).1 - numeric).norm() < 1e-8);
        }
    }
}
