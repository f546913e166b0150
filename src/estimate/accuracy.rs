//! How far measurements are from a known truth: errors of θ and δ, and whether their sigmas are honest.

use super::gap::LEAST_THETA_FOR_DELTA;
use crate::geometry::wrap_angle;
use crate::observation::{Measurement, Truth};
use crate::statistics::moments::{mean, rms};
use serde::Serialize;

/// How far one measured angle is from the truth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AngleScore {
    /// Frames that count.
    pub samples: usize,
    /// Root mean square error, degrees.
    pub rms_deg: f64,
    /// The mean error, degrees.
    pub mean_deg: f64,
    /// The largest error, degrees.
    pub worst_deg: f64,
    /// The frame that has it.
    pub worst_index: Option<u64>,
    /// Share of the errors within 3σ, 0 to 1.
    pub within_3_sigma: f64,
    /// Mean of (error/σ)²: near 1 where the sigmas are honest.
    pub reduced_chi2: f64,
}

/// How far a set of measurements is from the truth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Accuracy {
    /// Frames whose truth is known.
    pub frames: usize,
    /// Those of them that were measured.
    pub measured: usize,
    /// θ, over all measured frames.
    pub theta: AngleScore,
    /// δ, over those bent by 15° or more.
    pub delta: AngleScore,
}

/// Compares measurements with the truth, by index.
pub fn accuracy(measurements: &[Measurement], truths: &[Truth]) -> Accuracy {
    let mut frames = 0;
    let mut theta = Vec::new();
    let mut delta = Vec::new();
    for measurement in measurements {
        let Some(truth) = truths.iter().find(|truth| truth.index == measurement.index) else { continue };
        frames += 1;
        let Some(measured) = &measurement.measured else { continue };
        let (found, psi) = (measured.configuration, truth.configuration);
        theta.push(AngleError {
            index: measurement.index,
            error: found.theta - psi.theta,
            sigma: measured.sigma_theta,
        });
        if psi.theta >= LEAST_THETA_FOR_DELTA {
            let error = wrap_angle(found.delta - psi.delta);
            delta.push(AngleError { index: measurement.index, error, sigma: measured.sigma_delta });
        }
    }
    Accuracy { frames, measured: theta.len(), theta: AngleScore::of(&theta), delta: AngleScore::of(&delta) }
}

struct AngleError {
    index: u64,
    error: f64,
    sigma: f64,
}

impl AngleScore {
    /// Zeros where there is nothing to score.
    fn of(errors: &[AngleError]) -> Self {
        let worst = errors.iter().max_by(|a, b| a.error.abs().total_cmp(&b.error.abs()));
        Self {
            samples: errors.len(),
            rms_deg: rms(errors.iter().map(|e| e.error)).to_degrees(),
            mean_deg: mean(errors.iter().map(|e| e.error)).to_degrees(),
            worst_deg: worst.map_or(0.0, |e| e.error.abs().to_degrees()),
            worst_index: worst.map(|e| e.index),
            within_3_sigma: mean(errors.iter().map(|e| f64::from(e.error.abs() <= 3.0 * e.sigma))),
            reduced_chi2: mean(errors.iter().map(|e| (e.error / e.sigma).powi(2))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Configuration;
    use crate::observation::{Measured, Status};
    use approx::assert_relative_eq;

    fn measurement(index: u64, theta_deg: f64, delta_deg: f64, sigma_deg: f64) -> Measurement {
        Measurement {
            index,
            time_s: None,
            status: Status::Ok,
            measured: Some(Measured::independent(
                Configuration::from_degrees(theta_deg, delta_deg),
                sigma_deg.to_radians(),
                sigma_deg.to_radians(),
                0.0,
            )),
            quality: None,
            view: None,
        }
    }

    fn truth(index: u64, theta_deg: f64, delta_deg: f64) -> Truth {
        Truth { index, configuration: Configuration::from_degrees(theta_deg, delta_deg) }
    }

    #[test]
    fn errors_are_what_hand_calculation_says() {
        let unmeasured = Measurement { status: Status::NoSnake, measured: None, ..measurement(3, 0.0, 0.0, 1.0) };
        let measurements = [
            measurement(0, 30.3, 179.0, 0.1),
            measurement(1, 10.0, 90.0, 0.1),
            measurement(2, 50.4, 10.0, 0.1),
            unmeasured,
        ];
        let truths = [truth(0, 30.0, -179.0), truth(1, 10.0, 0.0), truth(2, 50.0, 10.0), truth(3, 5.0, 0.0)];
        let score = accuracy(&measurements, &truths);
        assert_eq!((score.frames, score.measured), (4, 3));
        assert_relative_eq!(score.theta.rms_deg, (0.25f64 / 3.0).sqrt(), max_relative = 1e-9);
        assert_relative_eq!(score.theta.worst_deg, 0.4, max_relative = 1e-9);
        assert_eq!(score.theta.worst_index, Some(2));
        assert_relative_eq!(score.theta.reduced_chi2, (9.0 + 0.0 + 16.0) / 3.0, max_relative = 1e-9);
        assert_eq!(score.delta.samples, 2, "δ is not scored near straight");
        assert_relative_eq!(score.delta.worst_deg, 2.0, max_relative = 1e-9);
        assert_relative_eq!(score.delta.within_3_sigma, 0.5);
    }

    #[test]
    fn nothing_in_common_is_no_frame() {
        assert_eq!(accuracy(&[], &[truth(0, 1.0, 1.0)]).frames, 0);
    }
}
