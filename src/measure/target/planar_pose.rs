//! The camera's pose to a plane, from places of the plane and the pixels at which they are seen.
//!
//! Far away a plane looks almost the same when it leans towards the camera as when it leans away by as much, and a fit may end at
//! either (G. Schweighofer, A. Pinz, "Robust Pose Estimation from a Planar Target", IEEE PAMI 28, 2006). [`fit_from_afar`] therefore
//! fits from both sides and keeps the better one.

use crate::camera::Lens;
use crate::geometry::{Pose, perturbed};
use crate::statistics::least_squares::{Options, minimise};
use crate::statistics::order::{SD_BY_MAD, median};
use nalgebra::{DVector, Matrix2, Point2, Point3, SVector, Translation3, UnitQuaternion, Vector2, Vector3, Vector6};

/// Rounds of fitting and trimming.
///
/// Convention: a cap; what is trimmed is far off, and found in the first round that trims.
const ROUNDS: usize = 3;
/// Where distances are trimmed, in medians of themselves: four standard deviations along one direction, and 4.7 in two.
///
/// Derived: the median of |x| is σ/1.4826 in one dimension and 1.177 σ in two; normal errors are beyond the limit once in 16,000 and
/// 65,000 times.
const LIMIT_ALONG_NORMAL: f64 = 4.0 * SD_BY_MAD;
const LIMIT_IN_PLANE: f64 = 4.0;
/// Added to that limit, px.
///
/// Convention: keeps places that fit to rounding from trimming each other.
const ROUNDING_PX: f64 = 1e-3;
/// Steps of central differences, rad and mm.
///
/// Convention: pixels move by about 10⁻² px, where rounding and curvature are both far below what is measured.
const STEPS: [f64; 6] = [1e-5, 1e-5, 1e-5, 1e-4, 1e-4, 1e-4];

/// A place of the target seen in the picture.
#[derive(Debug, Clone, Copy)]
pub struct TargetPoint {
    /// Where it is seen, px.
    pub pixel: Point2<f64>,
    /// Where it is on the target, mm, in the grid frame.
    pub target_mm: Point2<f64>,
}

/// A pose fitted to what was seen of the target.
#[derive(Debug, Clone)]
pub struct PoseFit {
    /// The camera's pose to the target.
    pub camera_from_grid: Pose,
    /// Variance of its rotation about each of the camera's axes, rad².
    pub rotation_variance: Vector3<f64>,
    /// Scatter of what was kept about the pose, px per coordinate.
    pub rms_px: f64,
}

/// Fits the pose to places whose `count` error vectors, px, `error_px` gives at any pose: least squares over those within a limit
/// of their median length, the limit being found again after every fit (Talwar's loss).
///
/// `design_effect` is how many of the errors count as one.
fn fit_trimmed<const D: usize>(
    start: &Pose,
    count: usize,
    error_px: impl Fn(&Pose, usize) -> SVector<f64, D>,
    limit_medians: f64,
    is_near: bool,
    design_effect: f64,
) -> Option<PoseFit> {
    let mut pose = *start;
    let mut kept: Vec<usize> = (0..count).collect();
    let mut fit = None;
    for round in 0..ROUNDS {
        if is_near || round > 0 {
            let sizes: Vec<f64> = (0..count).map(|k| error_px(&pose, k).norm()).collect();
            let limit = limit_medians * median(&mut sizes.clone()) + ROUNDING_PX;
            kept = (0..count).filter(|&k| sizes[k] < limit).collect();
        }
        let residuals = |x: &DVector<f64>| {
            let moved = perturbed(&pose, &Vector6::from_column_slice(x.as_slice()));
            let errors = kept.iter().map(|&k| error_px(&moved, k));
            DVector::from_iterator(D * kept.len(), errors.flat_map(|error| error.data.0[0]))
        };
        let steps = DVector::from_column_slice(&STEPS);
        let solution = minimise(residuals, DVector::zeros(STEPS.len()), &steps, &Options::default()).ok()?;
        pose = perturbed(&pose, &Vector6::from_column_slice(solution.parameters.as_slice()));
        let variance = solution.residuals.norm_squared() / solution.residuals.len() as f64;
        let covariance = solution.covariance()? * (variance * design_effect);
        let rotation_variance = Vector3::from_fn(|k, _| covariance[(k, k)]);
        fit = Some(PoseFit { camera_from_grid: pose, rotation_variance, rms_px: variance.sqrt() });
    }
    fit
}

/// Fits the pose to places of the target, from one from which the fit converges.
pub fn fit_points(lens: &Lens, points: &[TargetPoint], start: &Pose, design_effect: f64) -> Option<PoseFit> {
    let error = |pose: &Pose, k: usize| project_target(lens, pose, &points[k].target_mm) - points[k].pixel;
    fit_trimmed(start, points.len(), error, LIMIT_IN_PLANE, false, design_effect)
}

/// Fits the pose to distances, px, of places from where a pose puts them, along one direction each, from a pose that is nearly right.
pub fn fit_distances(
    start: &Pose,
    count: usize,
    distance_px: impl Fn(&Pose, usize) -> f64,
    design_effect: f64,
) -> Option<PoseFit> {
    let error = |pose: &Pose, k: usize| SVector::<f64, 1>::new(distance_px(pose, k));
    fit_trimmed(start, count, error, LIMIT_ALONG_NORMAL, true, design_effect)
}

/// [`fit_points`] where nothing is known of the tilt: from both of the poses that look alike from afar.
pub fn fit_from_afar(lens: &Lens, points: &[TargetPoint], start: &Pose, design_effect: f64) -> Option<PoseFit> {
    let one = fit_points(lens, points, start, design_effect)?;
    let middle = points.iter().map(|p| p.target_mm.coords).sum::<Vector2<f64>>() / points.len() as f64;
    let mirrored = leaning_the_other_way(&one.camera_from_grid, &Point2::from(middle));
    let other = fit_points(lens, points, &mirrored, design_effect);
    Some(other.filter(|other| other.rms_px < one.rms_px).unwrap_or(one))
}

/// The pose in which a place of the target (mm) is where it is, and the target leans as far to the other side of its line of
/// sight.
fn leaning_the_other_way(camera_from_grid: &Pose, target_mm: &Point2<f64>) -> Pose {
    let place = Point3::new(target_mm.x, target_mm.y, 0.0);
    let seen = camera_from_grid * place;
    let sight = seen.coords.normalize();
    let normal = camera_from_grid * Vector3::z();
    let mirrored = sight * (2.0 * sight.dot(&normal)) - normal;
    let turn = UnitQuaternion::rotation_between(&normal, &mirrored).unwrap_or_default();
    let rotation = turn * camera_from_grid.rotation;
    Pose::from_parts(Translation3::from(seen.coords - rotation * place.coords), rotation)
}

/// A camera square to the target, from the pitch, the gradients (pitches per px) of the target's coordinates and one place of it.
pub fn square_pose(lens: &Lens, pitch_mm: f64, gradients: [Vector2<f64>; 2], point: &TargetPoint) -> Pose {
    // A px is a pitch over the gradient's length.
    let mm_per_px = (gradients[0].norm() * gradients[1].norm()).sqrt() * pitch_mm;
    let depth = lens.focal_px.x * mm_per_px;
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), gradients[0].y.atan2(gradients[0].x));
    let seen = lens.ray(&point.pixel);
    let at = seen * (depth / seen.z) - rotation * Vector3::new(point.target_mm.x, point.target_mm.y, 0.0);
    Pose::from_parts(Translation3::from(at), rotation)
}

/// The pixel of a place on the target (mm).
pub fn project_target(lens: &Lens, camera_from_grid: &Pose, target_mm: &Point2<f64>) -> Point2<f64> {
    lens.project(&(camera_from_grid * Point3::new(target_mm.x, target_mm.y, 0.0)))
}

/// The place of the target (mm) seen at a pixel, and the gradients of its coordinates (rows), mm per px; `None` where the line of sight
/// leads away from the target.
pub fn target_at(lens: &Lens, camera_from_grid: &Pose, pixel: &Point2<f64>) -> Option<(Point2<f64>, Matrix2<f64>)> {
    let grid_from_camera = camera_from_grid.inverse();
    let eye = grid_from_camera * Point3::origin();
    let hit = |p: &Point2<f64>| -> Option<Point2<f64>> {
        let ray = grid_from_camera * lens.ray(p);
        let distance = -eye.z / ray.z;
        (distance > 0.0).then(|| Point2::new(eye.x + distance * ray.x, eye.y + distance * ray.y))
    };
    let centre = hit(pixel)?;
    let right = hit(&(pixel + Vector2::x()))? - centre;
    let down = hit(&(pixel + Vector2::y()))? - centre;
    Some((centre, Matrix2::from_columns(&[right, down])))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::scene::Scene;
    use crate::statistics::moments::{mean, rms};
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, Normal};

    /// The lens of the default scene, of a longer focal length.
    fn long_lens() -> Lens {
        Lens { focal_px: [5000.0, 5000.0].into(), ..Scene::default().lens }
    }

    /// A target `depth_mm` away that leans by `lean_deg` about an axis in the picture at this angle.
    fn leaning(depth_mm: f64, about_deg: f64, lean_deg: f64) -> Pose {
        let (sin, cos) = about_deg.to_radians().sin_cos();
        let lean = UnitQuaternion::from_scaled_axis(Vector3::new(cos, sin, 0.0) * lean_deg.to_radians());
        Pose::from_parts(Translation3::new(0.0, 0.0, depth_mm), lean)
    }

    /// Places seen on a lattice of pixels, with normal errors of this σ in both coordinates.
    fn seen(lens: &Lens, pose: &Pose, columns: std::ops::Range<i32>, noise_px: f64, seed: u64) -> Vec<TargetPoint> {
        let mut random = StdRng::seed_from_u64(seed);
        let noise = Normal::new(0.0, noise_px).unwrap();
        let pixels = columns.flat_map(|x| (0..20).map(move |y| (x, y)));
        pixels
            .map(|(x, y)| {
                let pixel = Point2::new(30.0 + 35.0 * f64::from(x), 30.0 + 35.0 * f64::from(y));
                let (target_mm, _) = target_at(lens, pose, &pixel).unwrap();
                TargetPoint { pixel: pixel + Vector2::from_fn(|_, _| noise.sample(&mut random)), target_mm }
            })
            .collect()
    }

    #[test]
    fn the_pixel_of_a_place_shows_that_place_and_its_gradients_are_those_of_differences() {
        let lens = Lens { distortion: Scene::default().lens.distortion, ..long_lens() };
        let pose = leaning(240.0, 30.0, 12.0);
        for pixel in [Point2::new(100.0, 80.0), Point2::new(700.0, 500.0)] {
            let (place, gradient) = target_at(&lens, &pose, &pixel).unwrap();
            assert!((project_target(&lens, &pose, &place) - pixel).norm() < 1e-6);
            let step = 1e-3;
            for (axis, by) in [Vector2::x() * step, Vector2::y() * step].into_iter().enumerate() {
                let ahead = target_at(&lens, &pose, &(pixel + by)).unwrap().0;
                let slope = (ahead - place) / step;
                assert!((slope - gradient.column(axis)).norm() < 1e-4 * gradient.norm());
            }
        }
        // A target seen almost edge-on has its horizon in the picture, and beyond it there is nothing.
        let edge_on = leaning(240.0, 0.0, 89.0);
        let sides =
            [-1000.0, 1000.0].map(|dy| target_at(&long_lens(), &edge_on, &(lens.centre_px + Vector2::new(0.0, dy))));
        assert_eq!(sides.iter().filter(|side| side.is_none()).count(), 1);
    }

    #[test]
    fn exact_places_give_the_exact_pose_however_many_of_them_are_wrong() {
        let lens = long_lens();
        let pose = leaning(260.0, 120.0, 15.0);
        let mut points = seen(&lens, &pose, 0..30, 0.0, 0);
        // Every seventh is an edge of something else.
        points.iter_mut().step_by(7).for_each(|p| p.pixel.x += 40.0);
        let fit = fit_from_afar(&lens, &points, &Pose::translation(0.0, 0.0, 260.0), 1.0).unwrap();
        assert!(fit.camera_from_grid.rotation.angle_to(&pose.rotation) < 1e-6);
        assert!((fit.camera_from_grid.translation.vector - pose.translation.vector).norm() < 1e-4);
        assert!(fit.rms_px < 1e-6, "{}", fit.rms_px);
    }

    /// A target 260 mm away through a long lens, of which only the picture's right side is seen.
    #[test]
    fn a_target_that_leans_is_not_taken_for_one_that_leans_the_other_way() {
        let lens = long_lens();
        for about_deg in [0.0_f64, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0] {
            let pose = leaning(260.0, about_deg, 20.0);
            let points = seen(&lens, &pose, 25..34, 0.035, about_deg as u64);
            let fit = fit_from_afar(&lens, &points, &Pose::translation(0.0, 0.0, 260.0), 1.0).unwrap();
            let off_deg = fit.camera_from_grid.rotation.angle_to(&pose.rotation).to_degrees();
            assert!(off_deg < 0.1, "a target leaning about {about_deg}° is placed {off_deg:.2}° off");
            // The mirrored lean fits worse by far more than the noise.
            let mirrored = leaning(260.0, about_deg, -20.0);
            let start = leaning_the_other_way(&pose, &points[0].target_mm);
            assert!(start.rotation.angle_to(&mirrored.rotation).to_degrees() < 15.0);
        }
    }

    #[test]
    fn the_predicted_variance_of_the_rotation_is_that_of_the_scatter() {
        let lens = long_lens();
        let pose = leaning(250.0, 60.0, 10.0);
        let draws = 150;
        let fits: Vec<PoseFit> = (0..draws)
            .map(|seed| fit_points(&lens, &seen(&lens, &pose, 0..20, 0.1, seed), &pose, 1.0).unwrap())
            .collect();
        assert!((mean(fits.iter().map(|fit| fit.rms_px)) - 0.1).abs() < 0.002);
        for axis in 0..3 {
            let error = |fit: &PoseFit| (fit.camera_from_grid.rotation * pose.rotation.inverse()).scaled_axis()[axis];
            let seen = rms(fits.iter().map(error));
            let predicted = mean(fits.iter().map(|fit| fit.rotation_variance[axis])).sqrt();
            // 150 draws tell a standard deviation to 6 %; three and a half times that.
            assert!((seen / predicted - 1.0).abs() < 0.2, "axis {axis}: {seen} seen, {predicted} predicted");
        }
    }
}
