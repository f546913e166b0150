//! A registration's residuals and their derivatives: those of the poses, each at its best bend, and of what is known beforehand.

use super::pose::ROWS;
use super::{Fitted, PRIORS, RIG, Registration, Role, STATED_BASE_MM, TURN_RAD};
use crate::observation::TrackerPose;
use crate::statistics::least_squares::Problem;
use nalgebra::{DMatrix, DVector, Vector3};

/// The registration as a least-squares problem, its numbers counted from `around`; the first pose is the straight one.
pub struct Sweep<'a> {
    /// The straight pose, then the others.
    pub poses: &'a [&'a TrackerPose],
    /// Where the numbers are zero.
    pub around: &'a Registration,
}

impl Problem for Sweep<'_> {
    type Evaluation = (Registration, Vec<Fitted>);

    fn evaluate(&self, parameters: &DVector<f64>, near: Option<&Self::Evaluation>) -> Option<Self::Evaluation> {
        let moved = self.around.moved(parameters);
        let fit = |(k, pose): (usize, &&TrackerPose)| {
            let role = if k == 0 { Role::Straight } else { Role::InSweep };
            moved.fit(pose, role, near.and_then(|(_, fits)| fits.get(k)).map(|fit| fit.bend))
        };
        let fits: Option<Vec<Fitted>> = self.poses.iter().enumerate().map(fit).collect();
        Some((moved, fits?))
    }

    fn residuals(&self, (registration, fits): &Self::Evaluation) -> DVector<f64> {
        let of_poses = fits.iter().flat_map(|fit| fit.residual.iter().copied());
        let turned = (registration.turn * self.around.turn.inverse()).scaled_axis();
        let sigmas_mm = registration.sensor_sigmas_mm();
        let of_priors = registration.sensor_mm.iter().zip(sigmas_mm).map(|(mm, sigma_mm)| -mm / sigma_mm);
        let shortening = -registration.shortening / registration.shortening_sigma();
        let of_base = registration.stated_base_mm.map_or(Vector3::zeros(), |stated| {
            (stated.coords - registration.tracker_from_base.translation.vector) / STATED_BASE_MM
        });
        let of_priors = of_priors
            .chain((turned / -TURN_RAD).iter().copied().collect::<Vec<_>>())
            .chain([shortening])
            .chain(of_base.iter().copied());
        DVector::from_iterator(ROWS * fits.len() + PRIORS, of_poses.chain(of_priors))
    }

    fn jacobian(&self, _: &DVector<f64>, (registration, fits): &Self::Evaluation) -> DMatrix<f64> {
        let mut jacobian = DMatrix::zeros(ROWS * fits.len() + PRIORS, RIG);
        for (k, fit) in fits.iter().enumerate() {
            // Residuals are measured less predicted.
            jacobian.fixed_view_mut::<ROWS, RIG>(ROWS * k, 0).copy_from(&-fit.projected());
        }
        let priors = ROWS * fits.len();
        for (axis, sigma_mm) in registration.sensor_sigmas_mm().into_iter().enumerate() {
            jacobian[(priors + axis, 5 + axis)] = -1.0 / sigma_mm;
            jacobian[(priors + 3 + axis, 8 + axis)] = -1.0 / TURN_RAD;
        }
        jacobian[(priors + 6, 11)] = -1.0 / registration.shortening_sigma();
        if registration.stated_base_mm.is_some() {
            let axes = registration.tracker_from_base.rotation.to_rotation_matrix();
            jacobian.fixed_view_mut::<3, 3>(priors + 7, 2).copy_from(&(axes.matrix() / -STATED_BASE_MM));
        }
        jacobian
    }
}
