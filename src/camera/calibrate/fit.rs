//! The lens fitted to the corners of several boards, and the covariance of its parameters.

use crate::camera::{Board, Lens, opencv};
use crate::error::{DataError, Result};
use crate::geometry::Pose;
use nalgebra::{Matrix6, Point2, Point3, SMatrix, SVector, Translation3, UnitQuaternion, Vector2, Vector6};

/// The lens's parameters, in the order of all arrays here.
pub const PARAMETERS: [&str; 9] = ["fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3"];

/// A lens fitted to some views.
pub struct Fit {
    pub lens: Lens,
    pub camera_from_board: Vec<Pose>,
    /// Seen minus projected, px, for each view and corner.
    pub residuals: Vec<Vec<Vector2<f64>>>,
    pub covariance: SMatrix<f64, 9, 9>,
}

impl Fit {
    pub fn of(board: &Board, views: &[&[Point2<f64>]], size: (u32, u32)) -> Result<Self> {
        let (lens, camera_from_board) = opencv::calibrate(board, views, size)?;
        let corners = board.corners();
        let residual = |pose: &Pose, corner: &Point3<f64>, seen: &Point2<f64>| seen - lens.project(&(pose * corner));
        let residuals: Vec<Vec<Vector2<f64>>> = views
            .iter()
            .zip(&camera_from_board)
            .map(|(seen, pose)| corners.iter().zip(*seen).map(|(corner, seen)| residual(pose, corner, seen)).collect())
            .collect();
        let covariance =
            covariance(&lens, &camera_from_board, &corners, &residuals).ok_or(DataError::LensUndetermined)?;
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

pub fn parameters(lens: &Lens) -> SVector<f64, 9> {
    let Lens { focal_px: f, centre_px: c, distortion: d, .. } = lens;
    SVector::from([f.x, f.y, c.x, c.y, d[0], d[1], d[2], d[3], d[4]])
}

pub fn with_parameters(lens: &Lens, values: &SVector<f64, 9>) -> Lens {
    let mut lens = lens.clone();
    lens.focal_px = Vector2::new(values[0], values[1]);
    lens.centre_px = Point2::new(values[2], values[3]);
    lens.distortion[..5].copy_from_slice(&values.as_slice()[4..]);
    lens
}
