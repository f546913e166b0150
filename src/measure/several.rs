//! Several views of one snake at one moment.

use crate::measure::measurement::{Bend, FrameMeasurement};
use crate::observation::{Quality, Status};
use nalgebra::{Matrix2, Matrix2x6, Vector2};

/// Views whose bends lie within this distance of their mean, rad, do not contradict each other whatever their sigmas say.
///
/// Convention: half a degree; what they differ by widens the sigma of their mean instead.
const CONTRADICTION_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;
/// Views contradict each other if the squared normalised distances of their bends from the mean exceed this per degree of freedom.
///
/// Derived: two views whose sigmas are a third too small exceed it once in 200 moments, e^(−12/1.5²).
const CONTRADICTION_CHI2: f64 = 12.0;

/// What several views say together: the mean of their bends, weighted by their information. To first order this is the fit to
/// the edges of all of them at once, since the errors of the views are independent.
///
/// A view that cannot measure is left out; where none can, the first one's reason stands. Views that scatter more than their sigmas
/// say widen the sigma of the mean by Birge's ratio; views that contradict each other give [`Status::ViewsDisagree`] and no angles.
pub fn fused(measurements: &[FrameMeasurement]) -> FrameMeasurement {
    let seen: Vec<(Bend, Quality)> = measurements.iter().filter_map(|s| s.bend.zip(s.quality)).collect();
    let alone = || measurements.iter().find(|s| s.bend.is_some()).or(measurements.first()).cloned();
    if seen.len() < 2 {
        return alone().unwrap_or(FrameMeasurement::failed(Status::NoSnake, None));
    }
    let informed: Option<Vec<(Bend, Matrix2<f64>)>> =
        seen.iter().map(|(bend, _)| Some((*bend, bend.covariance.try_inverse()?))).collect();
    let Some(informed) = informed else { return FrameMeasurement::failed(Status::NoSnake, None) };
    let information: Matrix2<f64> = informed.iter().map(|(_, information)| information).sum();
    let Some(covariance) = information.try_inverse() else { return FrameMeasurement::failed(Status::NoSnake, None) };
    let mean = covariance * informed.iter().map(|(bend, weight)| weight * bend.vector).sum::<Vector2<f64>>();

    // Birge's ratio squared: χ² per degree of freedom.
    let off = |(bend, weight): &(Bend, Matrix2<f64>)| {
        let off = bend.vector - mean;
        off.dot(&(weight * off))
    };
    let chi2_per_dof = informed.iter().map(off).sum::<f64>() / (2.0 * (seen.len() as f64 - 1.0));
    let quality = together(&seen);
    let apart = seen.iter().any(|(bend, _)| (bend.vector - mean).norm() > CONTRADICTION_RAD);
    if chi2_per_dof > CONTRADICTION_CHI2 && apart {
        return FrameMeasurement::failed(Status::ViewsDisagree, Some(quality));
    }
    // Each view has a rig of its own, and a row has room for the errors of one: those of several count as the moment's own.
    let bend = Bend { vector: mean, covariance: covariance * chi2_per_dof.max(1.0), by_rig: Matrix2x6::zeros() };
    FrameMeasurement::of(bend, quality)
}

fn together(seen: &[(Bend, Quality)]) -> Quality {
    let edges: usize = seen.iter().map(|(_, q)| q.edges).sum();
    let mean = |of: &dyn Fn(&Quality) -> f64| {
        seen.iter().map(|(_, q)| of(q) * q.edges as f64).sum::<f64>() / edges.max(1) as f64
    };
    let most = |of: fn(&Quality) -> Option<f64>| seen.iter().filter_map(|(_, q)| of(q)).reduce(f64::max);
    Quality {
        edges,
        inlier_fraction: mean(&|q| q.inlier_fraction),
        rms_px: mean(&|q| q.rms_px.powi(2)).sqrt(),
        base_moved_px: most(|q| q.base_moved_px),
        grid_moved_px: most(|q| q.grid_moved_px),
        // Of the view that sees the tip best.
        shape: seen.iter().filter_map(|(_, q)| q.shape).min_by(|a, b| a.sigma_tip_theta.total_cmp(&b.sigma_tip_theta)),
        // The views' profiles end at bends of their own.
        profile: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn measurement(x: f64, y: f64, sigma_x: f64, sigma_y: f64) -> FrameMeasurement {
        let covariance = Matrix2::new(sigma_x.powi(2), 0.0, 0.0, sigma_y.powi(2));
        let quality = Quality { edges: 1000, inlier_fraction: 0.9, rms_px: 0.1, ..Quality::default() };
        FrameMeasurement::of(Bend { vector: Vector2::new(x, y), covariance, by_rig: Matrix2x6::zeros() }, quality)
    }

    #[test]
    fn two_views_at_right_angles_are_as_good_in_every_direction() {
        let together = fused(&[measurement(0.5, 0.502, 1e-4, 2e-3), measurement(0.502, 0.5, 2e-3, 1e-4)]);
        let bend = together.bend.unwrap();
        assert_relative_eq!(bend.vector, Vector2::new(0.5, 0.5), epsilon = 1e-5);
        // Two measurements of one number: 1/σ² = 1/σ₁² + 1/σ₂².
        let variance = 1.0 / (1e8 + 1.0 / 4e-6);
        assert_relative_eq!(bend.covariance, Matrix2::identity() * variance, max_relative = 1e-9);
    }

    #[test]
    fn a_view_that_fails_leaves_the_other_to_answer() {
        let seen = measurement(0.3, 0.1, 1e-3, 1e-3);
        let together = fused(&[FrameMeasurement::failed(Status::Occluded, None), seen.clone()]);
        assert_eq!(together, seen);
        let none =
            fused(&[FrameMeasurement::failed(Status::Occluded, None), FrameMeasurement::failed(Status::Blurred, None)]);
        assert_eq!(none.status, Status::Occluded);
    }

    #[test]
    fn views_that_contradict_each_other_give_no_angles() {
        let together = fused(&[measurement(0.30, 0.1, 1e-3, 1e-3), measurement(0.36, 0.1, 1e-3, 1e-3)]);
        assert_eq!((together.status, together.measured), (Status::ViewsDisagree, None));
        // 4σ between them, but only a sixth of a degree: nine times the variance, not a contradiction.
        let together = fused(&[measurement(0.3, 0.1, 5e-4, 5e-4), measurement(0.303, 0.1, 5e-4, 5e-4)]);
        assert_relative_eq!(together.bend.unwrap().covariance[(0, 0)], 9.0 * 2.5e-7 / 2.0, max_relative = 1e-9);
    }
}
