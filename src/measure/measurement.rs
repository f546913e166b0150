//! The measurement of one frame: the bend vector with its covariance, and the same as θ and δ.

use crate::geometry::{Configuration, wrap_angle};
use crate::observation::{Measured, Measurement, Quality, Status};
use nalgebra::{Matrix2, Matrix2x6, Vector2};
use std::f64::consts::PI;

/// How far the grid of [`in_polar_terms`] reaches, σ.
///
/// Derived: outside ±3.5σ lies less than a thousandth of a Gaussian in two dimensions, which the weights' sum leaves out too.
const GRID_REACH: f64 = 3.5;
/// Grid points to either side.
///
/// Convention: steps of a quarter of σ, at which a Gaussian's moments are exact to rounding.
const GRID_HALF: i32 = 14;
/// The squared distance, in units of the covariance, within which a Gaussian in two dimensions has the probability that one in one
/// dimension has within 3σ.
///
/// Derived: −2 ln 0.0027.
const THREE_SIGMAS_SQUARED: f64 = 11.83;
/// The largest correlation that is reported.
///
/// Convention: keeps the covariance invertible.
const LARGEST_CORRELATION: f64 = 0.999;

/// What one frame says.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameMeasurement {
    /// The verdict; anything but [`Status::Ok`] comes without angles.
    pub status: Status,
    /// The angles.
    pub measured: Option<Measured>,
    /// The same as a bend vector, which stays Gaussian near straight, for [`fused`](super::fused).
    pub bend: Option<Bend>,
    /// How good the fit was, where there was one.
    pub quality: Option<Quality>,
}

/// A bend vector θ (cos δ, sin δ) and its covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bend {
    /// rad.
    pub vector: Vector2<f64>,
    /// rad².
    pub covariance: Matrix2<f64>,
    /// The part of the error that the rig's other frames share, see [`Measured::by_rig`].
    pub by_rig: Matrix2x6<f64>,
}

impl FrameMeasurement {
    /// The measurement of a snake with this bend.
    pub(super) fn of(bend: Bend, quality: Quality) -> Self {
        let fitted_covariance = Some(bend.covariance);
        let measured =
            Measured { fitted_covariance, by_rig: bend.by_rig, ..in_polar_terms(bend.vector, &bend.covariance) };
        Self { status: Status::Ok, measured: Some(measured), bend: Some(bend), quality: Some(quality) }
    }

    /// Its row of measurements.csv: the frame of this index and time, of a view where there are several.
    pub fn row(self, index: u64, time_s: Option<f64>, view: Option<String>) -> Measurement {
        Measurement { index, time_s, status: self.status, measured: self.measured, quality: self.quality, view }
    }

    /// A frame that could not be measured, and why.
    pub(super) fn failed(status: Status, quality: Option<Quality>) -> Self {
        Self { status, measured: None, bend: None, quality }
    }
}

impl From<Measured> for FrameMeasurement {
    /// A measurement that comes from elsewhere, such as a tracker, of which nothing but angles and errors is known.
    fn from(measured: Measured) -> Self {
        let Measured { configuration, by_rig, .. } = measured;
        let covariance = measured.bend_covariance(configuration);
        let bend = Bend { vector: configuration.bend_vector(), covariance, by_rig };
        Self { status: Status::Ok, measured: Some(measured), bend: Some(bend), quality: Some(Quality::default()) }
    }
}

/// θ, δ and their errors for a bend vector with a covariance (rad²).
///
/// Far from straight this is the linear propagation. Near straight δ may be anything, so the errors are mean squares over the bend
/// vector's distribution, computed on a grid of ±3.5σ. If straight lies within three sigmas, the σ of δ is at least π/3, so that three
/// sigmas of it cover the whole circle.
fn in_polar_terms(bend: Vector2<f64>, covariance: &Matrix2<f64>) -> Measured {
    let configuration = Configuration::from_bend_vector(bend);
    let eigen = covariance.symmetric_eigen();
    let axes = eigen.eigenvectors * Matrix2::from_diagonal(&eigen.eigenvalues.map(|v| v.max(0.0).sqrt()));
    let (mut weights, mut tt, mut dd, mut td) = (0.0, 0.0, 0.0, 0.0);
    for i in -GRID_HALF..=GRID_HALF {
        for j in -GRID_HALF..=GRID_HALF {
            let z = Vector2::new(f64::from(i), f64::from(j)) * (GRID_REACH / f64::from(GRID_HALF));
            let weight = (-0.5 * z.norm_squared()).exp();
            let other = Configuration::from_bend_vector(bend + axes * z);
            let theta = other.theta - configuration.theta;
            let delta = wrap_angle(other.delta - configuration.delta);
            weights += weight;
            tt += weight * theta * theta;
            dd += weight * delta * delta;
            td += weight * theta * delta;
        }
    }
    let from_straight = covariance.try_inverse().map_or(0.0, |information| bend.dot(&(information * bend)));
    let all_round = if from_straight < THREE_SIGMAS_SQUARED { PI / 3.0 } else { 0.0 };
    let correlation = if tt * dd > 0.0 { td / (tt * dd).sqrt() } else { 0.0 };
    Measured::independent(
        configuration,
        (tt / weights).sqrt(),
        (dd / weights).sqrt().max(all_round),
        correlation.clamp(-LARGEST_CORRELATION, LARGEST_CORRELATION),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, Normal};

    #[test]
    fn far_from_straight_the_polar_errors_are_those_of_linear_propagation() {
        let (theta, delta) = (0.8_f64, 0.6_f64);
        let bend = Configuration::new(theta, delta).bend_vector();
        let covariance = Matrix2::new(4e-6, 1e-6, 1e-6, 2e-6);
        let polar = in_polar_terms(bend, &covariance);
        let jacobian = Matrix2::new(delta.cos(), delta.sin(), -delta.sin() / theta, delta.cos() / theta);
        let linear = jacobian * covariance * jacobian.transpose();
        assert_relative_eq!(polar.sigma_theta, linear[(0, 0)].sqrt(), max_relative = 0.01);
        assert_relative_eq!(polar.sigma_delta, linear[(1, 1)].sqrt(), max_relative = 0.01);
        assert_relative_eq!(polar.covariance()[(0, 1)], linear[(0, 1)], epsilon = 2e-8);
    }

    #[test]
    fn at_straight_delta_is_anything() {
        let polar = in_polar_terms(Vector2::new(1e-9, 0.0), &(Matrix2::identity() * 1e-6));
        // A direction uniform over the circle has σ = π/√3.
        assert_relative_eq!(polar.sigma_delta, PI / 3.0_f64.sqrt(), max_relative = 0.05);
        assert!(polar.sigma_theta > 1e-3);
    }

    #[test]
    fn the_direction_is_within_three_sigmas_however_near_to_straight() {
        const SIGMA: f64 = 1e-3;
        const DRAWS: u32 = 20_000;
        let mut random = StdRng::seed_from_u64(7);
        let noise = Normal::new(0.0, SIGMA).unwrap();
        for theta in [0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 10.0] {
            let truth = Vector2::new(theta * SIGMA, 0.0);
            let is_outside = |_: &u32| {
                let seen = truth + Vector2::from_fn(|_, _| noise.sample(&mut random));
                let polar = in_polar_terms(seen, &(Matrix2::identity() * SIGMA * SIGMA));
                wrap_angle(polar.configuration.delta).abs() > 3.0 * polar.sigma_delta
            };
            let outside = (0..DRAWS).filter(is_outside).count();
            assert!(outside as f64 / f64::from(DRAWS) < 0.01, "θ {theta} σ: {outside} of {DRAWS}");
        }
    }
}
