//! Scores: how far measurements are from the truth, and how far a model is from measurements.

use crate::estimate::pairs_without_effects;
use crate::geometry::{Configuration, wrap_angle};
use crate::observation::{EncoderReading, Measurement, Truth};
use crate::robot::{Model, PerBackbone};
use nalgebra::Vector2;
use serde::Serialize;
use std::convert::Infallible;

/// Below this bend δ means too little to be scored, rad (15°).
pub const LEAST_THETA_FOR_DELTA: f64 = 15.0 * std::f64::consts::PI / 180.0;

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

/// What a model leaves unexplained of a set of measurements.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Gap {
    /// Measurements with an encoder reading.
    pub samples: usize,
    /// Root mean square over all backbones of q̃ − q(ψ) − ε(ψ), mm.
    pub rms_eps_mm: f64,
    /// The same that the measurements' own sigmas alone would leave, mm.
    pub noise_floor_mm: f64,
    /// Root mean square of measured θ less the θ that the model predicts from q̃, degrees.
    pub rms_theta_deg: f64,
    /// The same of δ, over measurements bent by 15° or more, degrees.
    pub rms_delta_deg: f64,
    /// Measurements that count for `rms_delta_deg`.
    pub delta_samples: usize,
    /// Measurements whose q̃ the model has no answer for; they count for ε only.
    pub unpredicted: usize,
}

/// Measures the gap between a model and data: every measurement that has angles and an encoder reading counts. What the
/// model's effects do along the path is taken off first.
pub fn gap(model: &Model, measurements: &[Measurement], encoders: &[EncoderReading]) -> Gap {
    match gap_of(model, measurements.iter().cloned().map(Ok::<_, Infallible>), encoders) {
        Ok(gap) => gap,
        Err(never) => match never {},
    }
}

/// [`gap`] of measurements that need not be in memory.
///
/// # Errors
/// What `measurements` gives.
pub fn gap_of<E>(
    model: &Model,
    measurements: impl Iterator<Item = std::result::Result<Measurement, E>>,
    encoders: &[EncoderReading],
) -> std::result::Result<Gap, E> {
    let pairs = pairs_without_effects(model, measurements, encoders)?;
    let model = &model.plain();
    let [mut eps, mut noise, mut theta, mut delta] = [Squares::default(); 4];
    let (mut samples, mut unpredicted) = (0, 0);
    for pair in pairs {
        let (Measurement { measured: Some(measured), .. }, Some(reading)) = pair? else { continue };
        let psi = measured.configuration;
        samples += 1;
        (reading.q_mm - model.command(psi)).iter().for_each(|&left| eps.add(left));
        let command_by_angles = command_by_configuration(model, psi);
        let covariance = measured.covariance();
        command_by_angles.iter().for_each(|by| noise.add(by.dot(&(covariance * by)).max(0.0).sqrt()));
        match model.forward(&reading.q_mm) {
            Ok(response) => {
                let predicted = response.configuration;
                theta.add(psi.theta - predicted.theta);
                if psi.theta >= LEAST_THETA_FOR_DELTA {
                    delta.add(wrap_angle(psi.delta - predicted.delta));
                }
            }
            Err(_) => unpredicted += 1,
        }
    }
    Ok(Gap {
        samples,
        rms_eps_mm: eps.rms(),
        noise_floor_mm: noise.rms(),
        rms_theta_deg: theta.rms().to_degrees(),
        delta_samples: delta.count,
        rms_delta_deg: delta.rms().to_degrees(),
        unpredicted,
    })
}

/// Sum of squares, and of how many.
#[derive(Clone, Copy, Default)]
struct Squares {
    sum: f64,
    count: usize,
}

impl Squares {
    fn add(&mut self, value: f64) {
        self.sum += value * value;
        self.count += 1;
    }

    /// 0 of nothing.
    fn rms(&self) -> f64 {
        if self.count > 0 { (self.sum / self.count as f64).sqrt() } else { 0.0 }
    }
}

/// ∂(q + ε)/∂(θ, δ), mm per rad: what an error of the angles does to the ε that is inferred from them.
fn command_by_configuration(model: &Model, psi: Configuration) -> PerBackbone<Vector2<f64>> {
    model.robot.jacobian_q_psi(psi) + model.alpha(psi)
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    if count > 0.0 { sum / count } else { 0.0 }
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    mean(values.map(|value| value * value)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation::{Measured, Status};
    use approx::assert_relative_eq;
    use rand::SeedableRng;
    use rand::rngs::StdRng;
    use rand_distr::{Distribution, StandardNormal};

    fn measurement(index: u64, theta_deg: f64, delta_deg: f64, sigma_deg: f64) -> Measurement {
        Measurement {
            index,
            time_s: None,
            status: Status::Ok,
            measured: Some(Measured {
                configuration: Configuration::from_degrees(theta_deg, delta_deg),
                sigma_theta: sigma_deg.to_radians(),
                sigma_delta: sigma_deg.to_radians(),
                correlation: 0.0,
            }),
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
    fn a_perfect_model_leaves_nothing_but_the_noise_that_the_sigmas_announce() {
        let model = Model::default();
        let mut rng = StdRng::seed_from_u64(7);
        let mut gauss = || -> f64 { StandardNormal.sample(&mut rng) };
        let (sigma_deg, frames) = (0.3, 3000);
        let mut measurements = Vec::new();
        let mut encoders = Vec::new();
        for index in 0..frames {
            let psi = Configuration::from_degrees(20.0 + 60.0 * (index as f64 / frames as f64), 0.7 * index as f64);
            encoders.push(EncoderReading { index, time_s: 0.0, q_mm: model.command(psi) });
            let (theta, delta) = (psi.theta_deg() + sigma_deg * gauss(), psi.delta_deg() + sigma_deg * gauss());
            measurements.push(measurement(index, theta, delta, sigma_deg));
        }
        let gap = gap(&model, &measurements, &encoders);
        assert_eq!((gap.samples, gap.unpredicted), (3000, 0));
        assert_relative_eq!(gap.rms_eps_mm, gap.noise_floor_mm, max_relative = 0.03);
        assert_relative_eq!(gap.rms_theta_deg, sigma_deg, max_relative = 0.04);
        assert_relative_eq!(gap.rms_delta_deg, sigma_deg, max_relative = 0.04);
    }

    #[test]
    fn a_constant_offset_of_one_backbone_is_its_share_of_the_rms() {
        let model = Model::default();
        let psi = Configuration::from_degrees(40.0, 10.0);
        let mut q_mm = model.command(psi);
        q_mm[0] += 0.03;
        let gap = gap(&model, &[measurement(5, 40.0, 10.0, 0.1)], &[EncoderReading { index: 5, time_s: 0.0, q_mm }]);
        assert_relative_eq!(gap.rms_eps_mm, 0.03 / 3f64.sqrt(), max_relative = 1e-9);
        assert!(gap.rms_theta_deg > 0.1);
    }

    #[test]
    fn nothing_in_common_is_no_sample() {
        assert_eq!(gap(&Model::default(), &[measurement(0, 1.0, 1.0, 1.0)], &[]).samples, 0);
        assert_eq!(accuracy(&[], &[truth(0, 1.0, 1.0)]).frames, 0);
    }
}
