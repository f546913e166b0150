//! One pose under a registration: its best bend, and what it says of the registration.

use super::{RIG, Registration};
use crate::geometry::{Configuration, Pose};
use crate::observation::TrackerPose;
use crate::robot::MAX_THETA;
use nalgebra::{Matrix2, Matrix3, Matrix6x2, SMatrix, SVector, Vector2, Vector3};
use std::f64::consts::PI;

/// Residuals of a pose. Derived: three of its position, three of its orientation, and two of the bend of the straight one.
pub(super) const ROWS: usize = 8;
/// How well a snake that is called straight is, rad.
///
/// Convention: half a degree, which an eye sees beside a ruler.
const STRAIGHT_RAD: f64 = 0.5 * PI / 180.0;

/// What a pose is fitted for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Role {
    /// Its own bend.
    Alone,
    /// The registration, with others that err alike.
    InSweep,
    /// The registration, as the pose in which the snake is unbent.
    Straight,
}

/// A pose with its best bend.
#[derive(Debug, Clone, Copy)]
pub struct Fitted {
    /// rad.
    pub bend: Vector2<f64>,
    /// Measured less predicted, in units of σ.
    pub(super) residual: SVector<f64, ROWS>,
    pub(super) by_bend: SMatrix<f64, ROWS, 2>,
    by_rig: SMatrix<f64, ROWS, RIG>,
}

impl Fitted {
    /// The squared residual in units of σ².
    pub fn chi_square(&self) -> f64 {
        self.residual.norm_squared()
    }

    /// (JᵗJ)⁻¹ Jᵗ by the bend.
    pub(super) fn solver(&self) -> Option<SMatrix<f64, 2, ROWS>> {
        Some((self.by_bend.tr_mul(&self.by_bend)).try_inverse()? * self.by_bend.transpose())
    }

    /// The derivative by the registration with the bend at its best for each: (1 − J J⁺) J_rig.
    pub(super) fn projected(&self) -> SMatrix<f64, ROWS, RIG> {
        self.solver().map_or(self.by_rig, |solver| self.by_rig - self.by_bend * (solver * self.by_rig))
    }
}

impl Registration {
    /// The bend of the arc from the base, along its axis, through the position: its chord leans by θ/2.
    pub(super) fn first_bend(&self, pose: &TrackerPose) -> Vector2<f64> {
        let Some(position) = pose.position_mm else { return Vector2::zeros() };
        let point = self.tracker_from_base.inverse_transform_point(&position).coords;
        let theta = (2.0 * point.xy().norm().atan2(point.z)).min(MAX_THETA);
        point.xy().try_normalize(0.0).unwrap_or_default() * theta
    }

    /// The tip's frame, and its twist per rad of each component of the bend, of a snake that shortens.
    fn tip(&self, bend: Vector2<f64>) -> (Pose, Matrix6x2<f64>) {
        let mut tip = self.robot.frame_at(Configuration::from_bend_vector(bend), self.robot.length_mm);
        let mut twist = self.robot.tip_jacobian_bend(bend);
        let share = 1.0 - self.shortening * bend.norm();
        let slope = bend.try_normalize(0.0).unwrap_or_default() * -self.shortening;
        let velocity = twist.fixed_rows::<3>(0) * share + tip.translation.vector * slope.transpose();
        twist.fixed_rows_mut::<3>(0).copy_from(&velocity);
        tip.translation.vector *= share;
        (tip, twist)
    }

    /// The best bend of a pose by the method of Gauss and Newton, from `start` or the arc's chord; `None` where the pose has no position.
    pub fn fit(&self, pose: &TrackerPose, role: Role, start: Option<Vector2<f64>>) -> Option<Fitted> {
        /// Convention: an iteration cap.
        const STEPS: usize = 20;
        /// rad. Convention: a step within which the arcs' curvature is harmless.
        const LONGEST_STEP: f64 = 0.3;
        /// rad. Convention: far below any noise.
        const CONVERGED: f64 = 1e-9;
        pose.position_mm?;
        let mut fitted = self.linearised(pose, role, start.unwrap_or_else(|| self.first_bend(pose)))?;
        for _ in 0..STEPS {
            let step = fitted.solver()? * fitted.residual;
            let bend = fitted.bend + step.cap_magnitude(LONGEST_STEP);
            fitted = self.linearised(pose, role, bend.cap_magnitude(MAX_THETA))?;
            if step.norm() < CONVERGED {
                break;
            }
        }
        Some(fitted)
    }

    /// Residuals of a pose at a bend, in the base's axes and in units of σ, with the derivatives of what is predicted.
    fn linearised(&self, pose: &TrackerPose, role: Role, bend: Vector2<f64>) -> Option<Fitted> {
        let (tip, twist) = self.tip(bend);
        let (arm, turned) = (tip.rotation * self.sensor_mm, tip.rotation.to_rotation_matrix());
        let place = tip.translation.vector + arm;
        let seen = self.tracker_from_base.inverse_transform_point(&pose.position_mm?).coords;
        let mut fitted =
            Fitted { bend, residual: SVector::zeros(), by_bend: SMatrix::zeros(), by_rig: SMatrix::zeros() };

        let alike = if role == Role::InSweep { self.design_effects } else { (1.0, 1.0) };
        let sigma_mm = self.sigma_mm * alike.0.sqrt() * pose.sigma_mm.unwrap_or(1.0);
        let sigma_rad = self.sigma_rad * alike.1.sqrt();
        fitted.residual.fixed_rows_mut::<3>(0).copy_from(&((seen - place) / sigma_mm));
        for axis in 0..2 {
            let (velocity, turning) = (twist.fixed_view::<3, 1>(0, axis), twist.fixed_view::<3, 1>(3, axis));
            let by_bend = velocity + turning.cross(&arm);
            fitted.by_bend.fixed_view_mut::<3, 1>(0, axis).copy_from(&(by_bend / sigma_mm));
            fitted
                .by_rig
                .fixed_view_mut::<3, 1>(0, axis)
                .copy_from(&(Vector3::ith(axis, 1.0).cross(&place) / sigma_mm));
        }
        fitted.by_rig.fixed_view_mut::<3, 3>(0, 2).copy_from(&(Matrix3::identity() / sigma_mm));
        fitted.by_rig.fixed_view_mut::<3, 3>(0, 5).copy_from(&(turned.matrix() / sigma_mm));
        let unshortened = self.robot.frame_at(Configuration::from_bend_vector(bend), self.robot.length_mm).translation;
        fitted.by_rig.fixed_view_mut::<3, 1>(0, 11).copy_from(&(unshortened.vector * (-bend.norm() / sigma_mm)));

        if let Some(orientation) = pose.orientation.filter(|_| self.has_orientations) {
            let predicted = tip.rotation * self.turn;
            let left = self.tracker_from_base.rotation.inverse() * orientation * predicted.inverse();
            fitted.residual.fixed_rows_mut::<3>(3).copy_from(&(left.scaled_axis() / sigma_rad));
            fitted.by_bend.fixed_view_mut::<3, 2>(3, 0).copy_from(&(twist.fixed_view::<3, 2>(3, 0) / sigma_rad));
            let tilts = SMatrix::<f64, 3, 2>::identity() / sigma_rad;
            fitted.by_rig.fixed_view_mut::<3, 2>(3, 0).copy_from(&tilts);
            fitted.by_rig.fixed_view_mut::<3, 3>(3, 8).copy_from(&(turned.matrix() / sigma_rad));
        }
        if role == Role::Straight {
            fitted.residual.fixed_rows_mut::<2>(6).copy_from(&(-bend / STRAIGHT_RAD));
            fitted.by_bend.fixed_view_mut::<2, 2>(6, 0).copy_from(&(Matrix2::identity() / STRAIGHT_RAD));
        }
        Some(fitted)
    }

    /// Covariance of a pose's bend by its own noise, rad², and what independent unit errors of the registration do to it, rad.
    pub fn errors(&self, fit: &Fitted) -> Option<(Matrix2<f64>, SMatrix<f64, 2, RIG>)> {
        let solver = fit.solver()?;
        Some((solver * solver.transpose(), solver * fit.by_rig * self.covariance.cholesky()?.l()))
    }

    /// Rows of a pose less what its bend takes.
    pub fn degrees_of_freedom(&self, pose: &TrackerPose) -> f64 {
        if self.has_orientations && pose.orientation.is_some() { 4.0 } else { 1.0 }
    }
}
