//! The lens from pictures of a chessboard.
//!
//! OpenCV finds the corners and minimises the reprojection error. What the result is worth is worked out here: the
//! parameters' covariance, each picture's residuals, how much of the picture the corners reach, and whether two halves of
//! the pictures agree.
//!
//! # Sigmas
//!
//! With N corners seen, each giving two coordinates, and p parameters (nine of the lens, six for every picture), the
//! residuals' variance is s² = Σ r² / (2 N − p), and the covariance s² (JᵗJ)⁻¹. OpenCV up to 4.6 divides by N − p instead
//! of 2 N − p, so that its own sigmas are about √2 too large; a Monte-Carlo test below shows which are right.
//!
//! This is the sampling error alone: it says how far the noise of the corners moves the parameters, not whether lens and
//! board are what the model takes them for. The two halves' disagreement beyond it is the sign that they are not.

use super::opencv;
use super::{Frame, Lens, read_frame};
use crate::error::{Error, Result};
use crate::geometry::Pose;
use nalgebra::{
    Matrix3, Matrix6, Point2, Point3, SMatrix, SVector, Translation3, UnitQuaternion, Vector2, Vector3, Vector6,
};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A plain chessboard.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Board {
    /// Inner corners along a row.
    pub columns: usize,
    /// Inner corners along a column.
    pub rows: usize,
    /// Side of a square, mm. It sets the scale of the boards' distances only; the lens does not depend on it.
    pub square_mm: f64,
}

/// The lens's parameters, in the order of all arrays here.
pub const PARAMETERS: [&str; 9] = ["fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3"];

/// A lens and what it rests on.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraCalibration {
    /// The lens, with five distortion coefficients.
    pub lens: Lens,
    /// Covariance of its [`PARAMETERS`].
    pub covariance: SMatrix<f64, 9, 9>,
    /// Root mean square distance of all corners from where the lens projects them, px.
    pub rms_px: f64,
    /// The pictures that were used.
    pub views: Vec<BoardView>,
    /// The pictures that were not, and why.
    pub skipped: Vec<(PathBuf, String)>,
    /// The share of the picture, cut into 8×6 cells, in which at least one corner was seen, 0 to 1.
    pub coverage: f64,
    /// What the covariance means at the snake: see [`Halves::rms_deg`].
    pub sigma_deg: f64,
    /// How far two halves of the pictures agree; `None` with fewer than six pictures.
    pub halves: Option<Halves>,
}

/// One picture of the board.
#[derive(Debug, Clone, PartialEq)]
pub struct BoardView {
    /// The picture.
    pub path: PathBuf,
    /// Root mean square distance of its corners from where the lens projects them, px.
    pub rms_px: f64,
    /// The largest such distance, px.
    pub worst_px: f64,
    /// The angle between the board and the picture's plane, degrees. Boards all parallel to it do not tell the focal length.
    pub tilt_deg: f64,
    /// Whether its residuals stand out from the others': rms above both 1.5 times their median and the median + 3 robust
    /// sigmas (1.4826 times the median absolute deviation). Look at this picture; it still has its part in the result.
    pub outlier: bool,
}

/// Two lenses, from every other picture and from the rest, compared in what they do to the snake's angles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Halves {
    /// By how much a short straight piece of the snake seems turned in the picture's plane, from one lens to the other:
    /// root mean square over all directions and all places where corners were seen, as far out as both halves reach,
    /// degrees. A turn of the whole camera is taken out first, because the rig's calibration takes it up.
    pub rms_deg: f64,
    /// What the two halves' covariances predict for it, degrees.
    pub expected_deg: f64,
}

impl Halves {
    /// Whether the halves differ by more than twice what the sigmas predict: then something is wrong that the sigmas do
    /// not know of, a board that is not flat, a lens that moved or that the model does not fit.
    pub fn disagree(&self) -> bool {
        // NaN is no agreement.
        self.rms_deg.is_nan() || self.expected_deg.is_nan() || self.rms_deg > 2.0 * self.expected_deg
    }
}

impl CameraCalibration {
    /// Each parameter's name, value and standard deviation.
    pub fn parameters(&self) -> [(&'static str, f64, f64); 9] {
        let values = parameters(&self.lens);
        std::array::from_fn(|k| (PARAMETERS[k], values[k], self.covariance[(k, k)].sqrt()))
    }
}

/// Calibrates the camera from pictures of a board. Pictures that cannot be read or show no whole board are skipped.
///
/// # Errors
/// Fewer than three usable pictures, pictures of different sizes, boards that leave the lens undetermined; and any use
/// without the `opencv` feature.
pub fn calibrate_camera(pictures: &[PathBuf], board: &Board) -> Result<CameraCalibration> {
    if board.columns < 3 || board.rows < 3 || !(board.square_mm > 0.0 && board.square_mm.is_finite()) {
        let Board { columns, rows, square_mm } = board;
        return Err(Error::Usage(format!(
            "a board of {columns}×{rows} inner corners, {square_mm} mm apart: at least 3×3 are needed, at a positive distance"
        )));
    }
    let found: Vec<Found> = pictures.par_iter().map(|path| find(path, board)).collect::<Result<_>>()?;
    let mut seen = Vec::new();
    let mut skipped = Vec::new();
    for (path, found) in pictures.iter().zip(found) {
        match found {
            Found::Corners(size, corners) => seen.push((path.clone(), size, corners)),
            Found::Nothing(why) => skipped.push((path.clone(), why)),
        }
    }
    let Some(&(ref first, size, _)) = seen.first() else {
        return Err(too_few(0, &skipped));
    };
    if let Some((path, other, _)) = seen.iter().find(|(_, other, _)| *other != size) {
        let message = format!("{}×{} px, but {} has {}×{}", other.0, other.1, first.display(), size.0, size.1);
        return Err(Error::content(path, message));
    }
    if seen.len() < 3 {
        return Err(too_few(seen.len(), &skipped));
    }

    let views: Vec<&[Point2<f64>]> = seen.iter().map(|(_, _, corners)| corners.as_slice()).collect();
    let fit = Fit::of(board, &views, size)?;
    let halves = (views.len() >= 6).then(|| halves(board, &views, size)).transpose()?;
    Ok(CameraCalibration {
        covariance: fit.covariance,
        rms_px: rms(fit.residuals.iter().flatten()),
        views: board_views(seen.iter().map(|(path, _, _)| path.clone()), &fit),
        skipped,
        coverage: coverage(&views, size),
        sigma_deg: predicted_deg(&fit.lens, &fit.covariance, &views.concat()),
        halves,
        lens: fit.lens,
    })
}

fn too_few(count: usize, skipped: &[(PathBuf, String)]) -> Error {
    let reasons: Vec<String> = skipped.iter().map(|(path, why)| format!("\n  {}: {why}", path.display())).collect();
    Error::Domain(format!("{count} pictures show the whole board, at least 3 are needed{}", reasons.concat()))
}

/// What a picture shows.
enum Found {
    /// The picture's size, and the corners row by row.
    Corners((u32, u32), Vec<Point2<f64>>),
    /// No board, and why.
    Nothing(String),
}

fn find(path: &Path, board: &Board) -> Result<Found> {
    let frame: Frame = match read_frame(path) {
        Ok(frame) => frame,
        Err(error) => return Ok(Found::Nothing(error.to_string())),
    };
    Ok(match opencv::find_corners(&frame, board)? {
        Some(corners) => Found::Corners((frame.width, frame.height), corners),
        None => Found::Nothing(format!("no whole board of {}×{} inner corners", board.columns, board.rows)),
    })
}

impl Board {
    /// The inner corners on the board, mm, row by row; z is away from the camera.
    pub(super) fn corners(&self) -> Vec<Point3<f64>> {
        let corner = |k: usize| Point3::new((k % self.columns) as f64, (k / self.columns) as f64, 0.0) * self.square_mm;
        (0..self.columns * self.rows).map(corner).collect()
    }
}

/// A lens fitted to some views.
struct Fit {
    lens: Lens,
    camera_from_board: Vec<Pose>,
    /// Seen minus projected, px, for each view and corner.
    residuals: Vec<Vec<Vector2<f64>>>,
    covariance: SMatrix<f64, 9, 9>,
}

impl Fit {
    fn of(board: &Board, views: &[&[Point2<f64>]], size: (u32, u32)) -> Result<Self> {
        let (lens, camera_from_board) = opencv::calibrate(board, views, size)?;
        let corners = board.corners();
        let residual = |pose: &Pose, corner: &Point3<f64>, seen: &Point2<f64>| seen - lens.project(&(pose * corner));
        let residuals: Vec<Vec<Vector2<f64>>> = views
            .iter()
            .zip(&camera_from_board)
            .map(|(seen, pose)| corners.iter().zip(*seen).map(|(corner, seen)| residual(pose, corner, seen)).collect())
            .collect();
        let covariance = covariance(&lens, &camera_from_board, &corners, &residuals).ok_or_else(|| {
            Error::Domain("the boards leave the lens undetermined; tilt the board more, and differently".into())
        })?;
        Ok(Self { lens, camera_from_board, residuals, covariance })
    }
}

/// Covariance of the lens's parameters, s² (JᵗJ)⁻¹ with the boards' poses eliminated. `None` where JᵗJ is singular.
fn covariance(
    lens: &Lens,
    poses: &[Pose],
    corners: &[Point3<f64>],
    residuals: &[Vec<Vector2<f64>>],
) -> Option<SMatrix<f64, 9, 9>> {
    let mut information = SMatrix::<f64, 9, 9>::zeros();
    for pose in poses {
        let mut lens_part = SMatrix::<f64, 9, 9>::zeros();
        let mut cross = SMatrix::<f64, 9, 6>::zeros();
        let mut pose_part = Matrix6::zeros();
        for corner in corners {
            let by_lens = lens_jacobian(lens, &(pose * corner));
            let by_pose = pose_jacobian(lens, pose, corner);
            lens_part += by_lens.transpose() * by_lens;
            cross += by_lens.transpose() * by_pose;
            pose_part += by_pose.transpose() * by_pose;
        }
        information += lens_part - cross * pose_part.try_inverse()? * cross.transpose();
    }
    let coordinates = 2 * corners.len() * poses.len();
    let parameters = 9 + 6 * poses.len();
    let squares: f64 = residuals.iter().flatten().map(Vector2::norm_squared).sum();
    // Scaled to a unit diagonal, because the parameters' sizes differ by powers of ten.
    let scale = information.diagonal().map(|v| 1.0 / v.sqrt());
    let scaled = SMatrix::<f64, 9, 9>::from_fn(|i, j| information[(i, j)] * scale[i] * scale[j]);
    let inverse = scaled.cholesky()?.inverse();
    let variance = squares / (coordinates as f64 - parameters as f64);
    let covariance = SMatrix::<f64, 9, 9>::from_fn(|i, j| variance * inverse[(i, j)] * scale[i] * scale[j]);
    covariance.iter().all(|v| v.is_finite()).then_some(covariance)
}

/// How a point's pixel follows the lens's parameters, by central differences.
fn lens_jacobian(lens: &Lens, point: &Point3<f64>) -> SMatrix<f64, 2, 9> {
    let values = parameters(lens);
    SMatrix::from_columns(&std::array::from_fn::<Vector2<f64>, 9, _>(|k| {
        let step = if k < 4 { 1e-3 } else { 1e-6 };
        let moved = |by: f64| {
            let mut values = values;
            values[k] += by;
            with_parameters(lens, &values).project(point)
        };
        (moved(step) - moved(-step)) / (2.0 * step)
    }))
}

/// How a corner's pixel follows the board's pose: turned about the board's origin, and moved relative to its distance.
fn pose_jacobian(lens: &Lens, pose: &Pose, corner: &Point3<f64>) -> SMatrix<f64, 2, 6> {
    let distance = pose.translation.vector.norm();
    SMatrix::from_columns(&std::array::from_fn::<Vector2<f64>, 6, _>(|k| {
        let step = 1e-6;
        let moved = |by: f64| {
            let twist = Vector6::ith(k, by);
            let turn = UnitQuaternion::from_scaled_axis(twist.fixed_rows::<3>(0).into_owned());
            let shift = Translation3::from(distance * twist.fixed_rows::<3>(3).into_owned());
            let moved = Pose::from_parts(shift * pose.translation, turn * pose.rotation);
            lens.project(&(moved * corner))
        };
        (moved(step) - moved(-step)) / (2.0 * step)
    }))
}

fn parameters(lens: &Lens) -> SVector<f64, 9> {
    let Lens { focal_px: f, centre_px: c, distortion: d, .. } = lens;
    SVector::from([f.x, f.y, c.x, c.y, d[0], d[1], d[2], d[3], d[4]])
}

fn with_parameters(lens: &Lens, values: &SVector<f64, 9>) -> Lens {
    let mut lens = lens.clone();
    lens.focal_px = Vector2::new(values[0], values[1]);
    lens.centre_px = Point2::new(values[2], values[3]);
    lens.distortion[..5].copy_from_slice(&values.as_slice()[4..]);
    lens
}

fn rms<'a>(residuals: impl Iterator<Item = &'a Vector2<f64>>) -> f64 {
    let (sum, count) = residuals.fold((0.0, 0), |(sum, count), r| (sum + r.norm_squared(), count + 1));
    (sum / f64::from(count)).sqrt()
}

fn board_views(paths: impl Iterator<Item = PathBuf>, fit: &Fit) -> Vec<BoardView> {
    let view_rms: Vec<f64> = fit.residuals.iter().map(|view| rms(view.iter())).collect();
    let middle = median(view_rms.clone());
    let spread = 1.4826 * median(view_rms.iter().map(|r| (r - middle).abs()).collect());
    paths
        .zip(&fit.residuals)
        .zip(&fit.camera_from_board)
        .zip(&view_rms)
        .map(|(((path, residuals), pose), &rms_px)| BoardView {
            path,
            rms_px,
            worst_px: residuals.iter().map(Vector2::norm).fold(0.0, f64::max),
            tilt_deg: (pose * Vector3::z()).z.abs().min(1.0).acos().to_degrees(),
            outlier: rms_px > 1.5 * middle && rms_px > middle + 3.0 * spread,
        })
        .collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let half = values.len() / 2;
    match values.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => values[half],
        _ => (values[half - 1] + values[half]) / 2.0,
    }
}

/// The share of 8×6 cells of the picture with a corner in them.
fn coverage(views: &[&[Point2<f64>]], size: (u32, u32)) -> f64 {
    let cell = |value: f64, cells: f64, pixels: u32| ((value + 0.5) / f64::from(pixels) * cells).floor() as i64;
    let mut counts = BTreeMap::new();
    for corner in views.iter().copied().flatten() {
        *counts.entry((cell(corner.x, 8.0, size.0), cell(corner.y, 6.0, size.1))).or_insert(0) += 1;
    }
    counts.keys().filter(|(x, y)| (0..8).contains(x) && (0..6).contains(y)).count() as f64 / 48.0
}

fn halves(board: &Board, views: &[&[Point2<f64>]], size: (u32, u32)) -> Result<Halves> {
    let [even_views, odd_views] =
        [0, 1].map(|start| views.iter().skip(start).step_by(2).copied().collect::<Vec<&[Point2<f64>]>>());
    let (even, odd) = (Fit::of(board, &even_views, size)?, Fit::of(board, &odd_views, size)?);
    // Farther from the middle than its own corners reach, a half's distortion is a guess.
    let radius = |corner: &Point2<f64>| (corner - even.lens.centre_px).norm();
    let reach = |views: &[&[Point2<f64>]]| views.iter().copied().flatten().map(radius).fold(0.0, f64::max);
    let both_reach = reach(&even_views).min(reach(&odd_views));
    let places: Vec<Point2<f64>> =
        views.iter().copied().flatten().copied().filter(|corner| radius(corner) <= both_reach).collect();
    let turns = turns(&even.lens, &odd.lens, &places);
    Ok(Halves {
        rms_deg: (turns.iter().map(|t| t * t).sum::<f64>() / turns.len() as f64).sqrt().to_degrees(),
        expected_deg: predicted_deg(&even.lens, &(even.covariance + odd.covariance), &places),
    })
}

/// Root mean square of the [`turns`] that parameters with this covariance cause, degrees.
fn predicted_deg(lens: &Lens, covariance: &SMatrix<f64, 9, 9>, places: &[Point2<f64>]) -> f64 {
    let values = parameters(lens);
    // Steps of a tenth of a sigma: small against what the lens does, large against rounding.
    let columns: Vec<Vec<f64>> = (0..9)
        .map(|k| {
            let step = 0.1 * covariance[(k, k)].sqrt();
            let moved = |by: f64| {
                let mut values = values;
                values[k] += by;
                turns(lens, &with_parameters(lens, &values), places)
            };
            moved(step).iter().zip(moved(-step)).map(|(a, b)| (a - b) / (2.0 * step)).collect()
        })
        .collect();
    let count = columns[0].len();
    let variance = |row: usize| {
        let slope = SVector::<f64, 9>::from_fn(|k, _| columns[k][row]);
        (slope.transpose() * covariance * slope).x
    };
    ((0..count).map(variance).sum::<f64>() / count as f64).sqrt().to_degrees()
}

/// By which angles, rad, short pieces of the picture (level, upright and along both diagonals) seem turned from one lens
/// to another, at each place. The turn of the whole camera that brings the two lenses' rays nearest is taken out first.
fn turns(one: &Lens, other: &Lens, places: &[Point2<f64>]) -> Vec<f64> {
    let turn = common_turn(places.iter().map(|place| (one.ray(place), other.ray(place))));
    let directions = [[0.5, 0.0], [0.0, 0.5], [0.35, 0.35], [0.35, -0.35]].map(Vector2::from);
    let turns_at = |place: &Point2<f64>| {
        let piece = |lens: &Lens, turn: &UnitQuaternion<f64>, direction: &Vector2<f64>| {
            let ideal = |pixel: Point2<f64>| {
                let ray = turn * lens.ray(&pixel);
                ray.xy() / ray.z
            };
            ideal(place + direction) - ideal(place - direction)
        };
        directions.map(|direction| {
            let (a, b) = (piece(one, &UnitQuaternion::identity(), &direction), piece(other, &turn, &direction));
            a.perp(&b).atan2(a.dot(&b))
        })
    };
    places.iter().flat_map(turns_at).collect()
}

/// The small turn that brings the second of each pair of unit vectors nearest to the first (least squares).
fn common_turn(pairs: impl Iterator<Item = (Vector3<f64>, Vector3<f64>)>) -> UnitQuaternion<f64> {
    let (normal, sum) = pairs.fold((Matrix3::zeros(), Vector3::zeros()), |(normal, sum), (a, b)| {
        (normal + Matrix3::identity() - b * b.transpose(), sum + b.cross(&a))
    });
    UnitQuaternion::from_scaled_axis(normal.try_inverse().map_or(Vector3::zeros(), |inverse| inverse * sum))
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;

    fn lens() -> Lens {
        let mut distortion = [0.0; 12];
        distortion[..5].copy_from_slice(&[-0.28, 0.09, 0.001, -0.0005, 0.02]);
        Lens {
            width: 640,
            height: 480,
            focal_px: Vector2::new(533.0, 534.0),
            centre_px: Point2::new(342.0, 234.0),
            distortion,
        }
    }

    /// Places all over the picture.
    fn places() -> Vec<Point2<f64>> {
        (0..63).map(|k| Point2::new(f64::from(k % 9) * 71.0 + 35.5, f64::from(k / 9) * 68.5 + 34.0)).collect()
    }

    #[test]
    fn a_lens_agrees_with_itself_however_it_is_turned_or_scaled() {
        assert!(turns(&lens(), &lens(), &places()).iter().all(|t| t.abs() < 1e-12));
        // A moved principal point is nearly a turned camera, a longer lens a nearer snake.
        let pinhole = Lens { distortion: [0.0; 12], centre_px: Point2::new(319.5, 239.5), ..lens() };
        let moved = Lens { centre_px: Point2::new(320.5, 239.5), ..pinhole.clone() };
        assert!(turns(&pinhole, &moved, &places()).iter().all(|t| t.abs() < 2e-3));
        let longer = Lens { focal_px: 1.01 * pinhole.focal_px, ..pinhole.clone() };
        assert!(turns(&pinhole, &longer, &places()).iter().all(|t| t.abs() < 1e-12));
    }

    #[test]
    fn a_wrong_aspect_turns_the_diagonals() {
        let pinhole = Lens { distortion: [0.0; 12], centre_px: Point2::new(319.5, 239.5), ..lens() };
        let wide = Lens { focal_px: pinhole.focal_px.component_mul(&Vector2::new(1.001, 1.0)), ..pinhole.clone() };
        for four in turns(&pinhole, &wide, &places()).chunks(4) {
            assert_abs_diff_eq!(four[0], 0.0, epsilon = 1e-6);
            assert_abs_diff_eq!(four[1], 0.0, epsilon = 1e-6);
            assert_abs_diff_eq!(four[2], 0.0005, epsilon = 5e-6);
            assert_abs_diff_eq!(four[3], -0.0005, epsilon = 5e-6);
        }
    }

    #[test]
    fn corners_in_every_cell_cover_the_picture() {
        let corner = |k: usize| Point2::new(80.0 * (k % 8) as f64 + 40.0, 80.0 * (k / 8) as f64 + 40.0);
        let all: Vec<Point2<f64>> = (0..48).map(corner).collect();
        assert_eq!(coverage(&[&all[..20], &all[10..]], (640, 480)), 1.0);
        assert_eq!(coverage(&[&all[..12], &all[..6]], (640, 480)), 0.25);
    }

    #[test]
    fn a_picture_that_stands_out_is_named() {
        let residual = |size: f64| vec![Vector2::new(size, 0.0), Vector2::new(0.0, size)];
        let fit = Fit {
            lens: lens(),
            camera_from_board: vec![Pose::rotation(Vector3::new(0.5, 0.0, 0.0)); 6],
            residuals: [0.20, 0.21, 0.19, 0.20, 0.60, 0.22].map(residual).to_vec(),
            covariance: SMatrix::identity(),
        };
        let views = board_views((0..6).map(|k| PathBuf::from(format!("{k}.png"))), &fit);
        assert_eq!(views.iter().map(|v| v.outlier).collect::<Vec<_>>(), [false, false, false, false, true, false]);
        assert_abs_diff_eq!(views[4].rms_px, 0.6, epsilon = 1e-12);
        assert_abs_diff_eq!(views[4].worst_px, 0.6, epsilon = 1e-12);
        assert_abs_diff_eq!(views[0].tilt_deg, 0.5f64.to_degrees(), epsilon = 1e-9);
    }

    #[test]
    fn wrong_calls_are_refused() {
        for (columns, rows, square_mm) in [(2, 6, 25.0), (9, 0, 25.0), (9, 6, 0.0), (9, 6, f64::NAN)] {
            let error = calibrate_camera(&[], &Board { columns, rows, square_mm }).unwrap_err();
            assert_eq!(error.exit_code(), 2, "{error}");
        }
        let board = Board { columns: 9, rows: 6, square_mm: 25.0 };
        let message = calibrate_camera(&["no/such.png".into()], &board).unwrap_err().to_string();
        assert!(message.contains("0 pictures show the whole board") && message.contains("no/such.png"), "{message}");
    }

    #[cfg(not(feature = "opencv"))]
    #[test]
    fn a_build_without_opencv_says_so() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("1.png");
        image::GrayImage::new(8, 8).save(&path).unwrap();
        let error = calibrate_camera(&[path], &Board { columns: 9, rows: 6, square_mm: 25.0 }).unwrap_err();
        assert!(matches!(error, Error::NoOpenCv { .. }), "{error}");
    }

    #[cfg(feature = "opencv")]
    mod with_opencv {
        use super::*;
        use image::{GrayImage, Luma};
        use nalgebra::Rotation3;
        use rand::{RngExt, SeedableRng, rngs::StdRng};
        use rand_distr::StandardNormal;

        const BOARD: Board = Board { columns: 9, rows: 6, square_mm: 25.0 };

        /// Twelve boards, tilted every way, that together fill the picture.
        fn poses() -> Vec<Pose> {
            let middle = Translation3::new(-100.0, -62.5, 0.0);
            let pose = |k: usize| {
                let around = k as f64 / 12.0 * std::f64::consts::TAU;
                let tilt = Rotation3::from_scaled_axis(Vector3::new(0.5 * around.cos(), 0.5 * around.sin(), 0.1));
                let place = Translation3::new(
                    70.0 * (3.0 * around).cos() - 20.0,
                    50.0 * (2.0 * around).sin(),
                    330.0 + 15.0 * (k % 4) as f64,
                );
                Pose::from_parts(place, UnitQuaternion::from(tilt)) * middle
            };
            (0..12).map(pose).collect()
        }

        fn corners_seen(lens: &Lens, noise_px: f64, seed: u64) -> Vec<Vec<Point2<f64>>> {
            let mut random = StdRng::seed_from_u64(seed);
            let mut noise = || noise_px * random.sample::<f64, _>(StandardNormal);
            let mut seen = |pose: Pose| {
                BOARD.corners().iter().map(|c| lens.project(&(pose * c)) + Vector2::new(noise(), noise())).collect()
            };
            poses().into_iter().map(&mut seen).collect()
        }

        fn fit(seen: &[Vec<Point2<f64>>]) -> Fit {
            let views: Vec<&[Point2<f64>]> = seen.iter().map(Vec::as_slice).collect();
            Fit::of(&BOARD, &views, (640, 480)).unwrap()
        }

        #[test]
        fn a_perfect_world_is_recovered() {
            let fit = fit(&corners_seen(&lens(), 0.0, 0));
            let difference = parameters(&fit.lens) - parameters(&lens());
            assert!(difference.rows(0, 4).amax() < 1e-3 && difference.rows(4, 5).amax() < 1e-4, "{difference}");
            assert!(rms(fit.residuals.iter().flatten()) < 1e-4);
        }

        /// The lens that Debian's `mrcal`, a program of its own with its own projection and solver, makes of the same
        /// corners: no regularisation, no outliers dropped, the board flat, as here. `None` where it is not installed.
        fn by_mrcal(seen: &[Vec<Point2<f64>>]) -> Option<SVector<f64, 9>> {
            let folder = tempfile::tempdir().unwrap();
            let corners = folder.path().join("corners.vnl");
            let line = |k: usize, c: &Point2<f64>| format!("board{k:02}.png {} {} 0\n", c.x, c.y);
            let lines = seen.iter().enumerate().flat_map(|(k, view)| view.iter().map(move |c| line(k, c)));
            std::fs::write(&corners, format!("# filename x y level\n{}", lines.collect::<String>())).unwrap();
            let output = std::process::Command::new("mrcal-calibrate-cameras")
                .arg("--corners-cache")
                .arg(&corners)
                .arg("--outdir")
                .arg(folder.path())
                .args(["--lensmodel", "LENSMODEL_OPENCV5", "--focal", "500", "--imagersize", "640", "480"])
                .args(["--object-spacing", "0.025", "--object-width-n", "9", "--object-height-n", "6"])
                .args(["--skip-regularization", "--skip-outlier-rejection", "--skip-calobject-warp-solve"])
                .arg("board*.png")
                .output()
                .ok()?;
            assert!(output.status.success(), "mrcal: {}", String::from_utf8_lossy(&output.stderr));
            let model = std::fs::read_to_string(folder.path().join("camera-0.cameramodel")).unwrap();
            let (_, rest) = model.split_once("'intrinsics': [").unwrap();
            let values = rest.split_once(']').unwrap().0.split(',').filter_map(|v| v.trim().parse().ok());
            Some(SVector::from_vec(values.collect()))
        }

        #[test]
        fn mrcal_finds_the_same_lens() {
            let seen = corners_seen(&lens(), 0.2, 3);
            let Some(theirs) = by_mrcal(&seen) else {
                println!("skipped: mrcal-calibrate-cameras is not installed (Debian: apt install mrcal)");
                return;
            };
            let fit = fit(&seen);
            let difference = (parameters(&fit.lens) - theirs).component_div(&fit.covariance.diagonal().map(f64::sqrt));
            println!("ours − mrcal's, in sigmas: {difference:.5}");
            assert!(difference.amax() < 0.01, "ours − mrcal's, in sigmas: {difference}");
        }

        /// Mean square of (estimate − truth) / sigma over many repetitions, for each parameter: 1 if the sigmas are right.
        #[test]
        fn sigmas_are_the_scatter_and_opencv_s_are_too_large() {
            let truth = parameters(&lens());
            let trials = 80;
            let squares: Vec<[SVector<f64, 9>; 2]> = (0..trials)
                .into_par_iter()
                .map(|seed| {
                    let seen = corners_seen(&lens(), 0.2, seed);
                    let fit = fit(&seen);
                    let error = parameters(&fit.lens) - truth;
                    let ours = error.component_div(&fit.covariance.diagonal().map(f64::sqrt));
                    let theirs = error.component_div(&opencv::own_sigmas(&BOARD, &seen, (640, 480)));
                    [ours, theirs].map(|ratio| ratio.component_mul(&ratio))
                })
                .collect();
            let mean = |which: usize| squares.iter().map(|s| s[which]).sum::<SVector<f64, 9>>() / trials as f64;
            println!(
                "mean square of error / sigma\nours {:.2}\nOpenCV's {:.2}",
                mean(0).transpose(),
                mean(1).transpose()
            );
            // A mean of 80 squares of normal numbers has σ = 0.16.
            assert!(mean(0).iter().all(|&m| (0.5..1.7).contains(&m)), "ours: {}", mean(0));
            assert!((mean(0).mean() - 1.0).abs() < 0.2, "ours: {}", mean(0));
            assert!((mean(1).mean() - 0.5).abs() < 0.1, "OpenCV's: {}", mean(1));
        }

        #[test]
        fn halves_agree_unless_something_is_wrong() {
            let halves_of = |seen: &[Vec<Point2<f64>>]| {
                let views: Vec<&[Point2<f64>]> = seen.iter().map(Vec::as_slice).collect();
                halves(&BOARD, &views, (640, 480)).unwrap()
            };
            let ratios: Vec<f64> = (0..20)
                .into_par_iter()
                .map(|seed| halves_of(&corners_seen(&lens(), 0.2, 1000 + seed)))
                .map(|halves| halves.rms_deg / halves.expected_deg)
                .collect();
            println!("rms / expected {ratios:.2?}");
            let mean_square = ratios.iter().map(|r| r * r).sum::<f64>() / 20.0;
            assert!((0.6..1.5).contains(&mean_square), "{mean_square}");
            assert!(ratios.iter().filter(|&&r| r > 2.0).count() <= 2, "{ratios:?}");

            // The lens was moved between one picture and the next.
            let other = Lens { focal_px: Vector2::new(533.0, 536.0), ..lens() };
            let (mut mixed, moved) = (corners_seen(&lens(), 0.05, 1), corners_seen(&other, 0.05, 2));
            for k in (1..12).step_by(2) {
                mixed[k].clone_from(&moved[k]);
            }
            let halves = halves_of(&mixed);
            assert!(halves.disagree(), "{halves:?}");
        }

        /// A picture of the board, black and white squares on a white sheet; `warp` shifts its pattern like a bent board.
        fn picture(lens: &Lens, pose: &Pose, warp: f64, seed: u64) -> GrayImage {
            let board_from_camera = pose.inverse();
            let origin = board_from_camera * Point3::origin();
            let light = |u: f64, v: f64| {
                let ray = board_from_camera * lens.ray(&Point2::new(u, v));
                let at = origin - ray * (origin.z / ray.z);
                let (x, y) = (at.x / 25.0, at.y / 25.0);
                let x = x + warp * (x - 4.0) * (x - 4.0);
                let on_squares = (-1.0..9.0).contains(&x) && (-1.0..6.0).contains(&y);
                if on_squares && (x.floor() + y.floor()).rem_euclid(2.0) < 1.0 { 40.0 } else { 210.0 }
            };
            let sharp = GrayImage::from_fn(640, 480, |x, y| {
                let samples = (0..16).map(|k| {
                    let offset = |i: i32| (f64::from(i) + 0.5) / 4.0 - 0.5;
                    light(f64::from(x) + offset(k % 4), f64::from(y) + offset(k / 4))
                });
                Luma([(samples.sum::<f64>() / 16.0).round() as u8])
            });
            let mut random = StdRng::seed_from_u64(seed);
            let mut blurred = image::imageops::blur(&sharp, 0.8);
            for level in blurred.iter_mut() {
                *level = (f64::from(*level) + 2.0 * random.sample::<f64, _>(StandardNormal)).round() as u8;
            }
            blurred
        }

        #[test]
        fn pictures_of_boards_give_the_lens_and_name_what_is_wrong() {
            let folder = tempfile::tempdir().unwrap();
            let mut paths: Vec<PathBuf> = (0..14).map(|k| folder.path().join(format!("{k:02}.png"))).collect();
            poses().par_iter().enumerate().for_each(|(k, pose)| {
                let warp = if k == 7 { 0.002 } else { 0.0 };
                picture(&lens(), pose, warp, k as u64).save(&paths[k]).unwrap();
            });
            GrayImage::from_pixel(640, 480, Luma([128])).save(&paths[12]).unwrap();
            std::fs::write(&paths[13], "no picture").unwrap();

            let result = calibrate_camera(&paths, &BOARD).unwrap();
            let names = |paths: Vec<&PathBuf>| -> Vec<String> {
                paths.iter().map(|p| p.file_stem().unwrap().to_string_lossy().into_owned()).collect()
            };
            assert_eq!(names(result.skipped.iter().map(|(path, _)| path).collect()), ["12", "13"]);
            assert_eq!(names(result.views.iter().filter(|v| v.outlier).map(|v| &v.path).collect()), ["07"]);
            assert!(result.coverage > 0.6, "{}", result.coverage);

            paths.truncate(12);
            paths.remove(7);
            let clean = calibrate_camera(&paths, &BOARD).unwrap();
            assert!(clean.rms_px < 0.15, "{}", clean.rms_px);
            for ((name, value, sigma), truth) in clean.parameters().into_iter().zip(&parameters(&lens())) {
                assert!((value - truth).abs() < 4.0 * sigma, "{name}: {value} ± {sigma}, truth {truth}");
            }
            assert!((0.001..0.1).contains(&clean.sigma_deg), "{}", clean.sigma_deg);
        }

        #[test]
        fn pictures_of_two_sizes_are_an_error() {
            let folder = tempfile::tempdir().unwrap();
            let paths = ["a.png", "b.png"].map(|name| folder.path().join(name));
            let whole = picture(&lens(), &poses()[0], 0.0, 0);
            whole.save(&paths[0]).unwrap();
            image::imageops::crop_imm(&whole, 0, 0, 639, 480).to_image().save(&paths[1]).unwrap();
            let message = calibrate_camera(&paths, &BOARD).unwrap_err().to_string();
            assert!(message.contains("639×480 px, but") && message.contains("640×480"), "{message}");
        }
    }
}
