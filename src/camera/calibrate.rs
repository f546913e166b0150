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

mod fit;
mod halves;

pub use fit::PARAMETERS;
pub use halves::Halves;

use super::{Board, Lens, opencv, read_frame};
use crate::error::{DataError, Error, Result};
use crate::statistics::moments;
use crate::statistics::order::{mad_scale, median};
use fit::{Fit, parameters};
use halves::{halves, predicted_deg};
use nalgebra::{Point2, SMatrix, Vector2, Vector3};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The fewest pictures that a lens is fitted to, and that each of two halves must have.
///
/// Derived: each view of a plane gives two constraints on the intrinsic parameters, which are five with skew (Zhang, "A flexible
/// new technique for camera calibration", PAMI 2000, section 3.1).
const LEAST_PICTURES: usize = 3;
/// A picture is looked at only where its rms is so many times the others' median.
///
/// Convention: it marks a picture for a person to look at and has no part in the result.
pub const OUTLIER_RATIO: f64 = 1.5;
/// A picture is looked at only where its rms lies so many robust sigmas above the others' median.
///
/// Convention: it marks a picture for a person to look at and has no part in the result.
pub const OUTLIER_SIGMAS: f64 = 3.0;
/// Columns and rows of the cells that the picture is cut into to say how much of it the corners reach.
///
/// Convention: of a figure that is shown.
const CELLS: [usize; 2] = [8, 6];

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
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BoardView {
    /// The picture.
    pub path: PathBuf,
    /// Root mean square distance of its corners from where the lens projects them, px.
    pub rms_px: f64,
    /// The largest such distance, px.
    pub worst_px: f64,
    /// The angle between the board and the picture's plane, degrees. Boards all parallel to it do not tell the focal length.
    pub tilt_deg: f64,
    /// Whether its residuals stand out from the others': rms above both [`OUTLIER_RATIO`] times their median and the median +
    /// [`OUTLIER_SIGMAS`] robust sigmas (1.4826 times the median absolute deviation). Look at this picture; it still has its part in the result.
    pub outlier: bool,
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
        if let Some(why) = squares_counted(pictures, board)? {
            skipped.insert(0, why);
        }
        return Err(DataError::TooFewBoards { found: 0, needed: LEAST_PICTURES, skipped }.into());
    };
    if let Some((path, other, _)) = seen.iter().find(|(_, other, _)| *other != size) {
        let message = format!("{}×{} px, but {} has {}×{}", other.0, other.1, first.display(), size.0, size.1);
        return Err(Error::content(path, message));
    }
    if seen.len() < LEAST_PICTURES {
        return Err(DataError::TooFewBoards { found: seen.len(), needed: LEAST_PICTURES, skipped }.into());
    }

    let views: Vec<&[Point2<f64>]> = seen.iter().map(|(_, _, corners)| corners.as_slice()).collect();
    let fit = Fit::of(board, &views, size)?;
    let halves = (views.len() >= 2 * LEAST_PICTURES).then(|| halves(board, &views, size)).transpose()?;
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

/// What a picture shows.
enum Found {
    /// The picture's size, and the corners row by row.
    Corners((u32, u32), Vec<Point2<f64>>),
    /// No board, and why.
    Nothing(String),
}

fn find(path: &Path, board: &Board) -> Result<Found> {
    let frame = match read_frame(path) {
        Ok(frame) => frame,
        Err(error) => return Ok(Found::Nothing(error.to_string())),
    };
    Ok(match opencv::find_corners(&frame, board)? {
        Some(corners) => Found::Corners((frame.width, frame.height), corners),
        None => Found::Nothing(format!("no whole board of {}×{} inner corners", board.columns, board.rows)),
    })
}

/// Where a picture shows a whole board of one corner less each way: squares were counted in place of inner corners. Tells which picture,
/// and that.
fn squares_counted(pictures: &[PathBuf], board: &Board) -> Result<Option<(PathBuf, String)>> {
    let (columns, rows) = (board.columns.saturating_sub(1), board.rows.saturating_sub(1));
    let Ok(smaller) = Board::new(columns, rows, board.square_mm) else { return Ok(None) };
    for path in pictures {
        if let Found::Corners(..) = find(path, &smaller)? {
            let why = format!(
                "has {columns}×{rows} inner corners: {}×{} are the squares, so the corners are {columns}x{rows}",
                board.columns, board.rows
            );
            return Ok(Some((path.clone(), why)));
        }
    }
    Ok(None)
}

fn rms<'a>(residuals: impl Iterator<Item = &'a Vector2<f64>>) -> f64 {
    moments::rms(residuals.map(Vector2::norm))
}

fn board_views(paths: impl Iterator<Item = PathBuf>, fit: &Fit) -> Vec<BoardView> {
    let view_rms: Vec<f64> = fit.residuals.iter().map(|view| rms(view.iter())).collect();
    let middle = median(&mut view_rms.clone());
    let spread = mad_scale(view_rms.iter().map(|r| r - middle));
    paths
        .zip(&fit.residuals)
        .zip(&fit.camera_from_board)
        .zip(&view_rms)
        .map(|(((path, residuals), pose), &rms_px)| BoardView {
            path,
            rms_px,
            worst_px: residuals.iter().map(Vector2::norm).fold(0.0, f64::max),
            tilt_deg: (pose * Vector3::z()).z.abs().min(1.0).acos().to_degrees(),
            outlier: rms_px > OUTLIER_RATIO * middle && rms_px > middle + OUTLIER_SIGMAS * spread,
        })
        .collect()
}

/// The share of the picture's [`CELLS`] with a corner in them.
fn coverage(views: &[&[Point2<f64>]], size: (u32, u32)) -> f64 {
    let cell = |value: f64, cells: usize, pixels: u32| {
        let at = ((value + 0.5) / f64::from(pixels) * cells as f64).floor();
        (at >= 0.0 && at < cells as f64).then_some(at as usize)
    };
    let seen: BTreeSet<(usize, usize)> = views
        .iter()
        .copied()
        .flatten()
        .filter_map(|corner| Some((cell(corner.x, CELLS[0], size.0)?, cell(corner.y, CELLS[1], size.1)?)))
        .collect();
    seen.len() as f64 / (CELLS[0] * CELLS[1]) as f64
}

#[cfg(all(test, feature = "opencv"))]
mod with_opencv;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use approx::assert_abs_diff_eq;

    pub fn lens() -> Lens {
        let mut distortion = [0.0; 12];
        distortion[..5].copy_from_slice(&[-0.28, 0.09, 0.001, -0.0005, 0.02]);
        Lens {
            width: 640,
            height: 480,
            focal_px: Vector2::new(533.0, 534.0),
            centre_px: Point2::new(342.0, 234.0),
            distortion,
            fisheye: None,
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
    fn pictures_that_show_no_board_are_named() {
        let board = Board::new(9, 6, 25.0).unwrap();
        let message = calibrate_camera(&["no/such.png".into()], &board).unwrap_err().to_string();
        assert!(message.contains("0 pictures show the whole board") && message.contains("no/such.png"), "{message}");
    }
}
