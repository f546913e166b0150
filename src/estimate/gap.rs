//! What a model leaves unexplained of measurements: the gap of ε, and of the θ and δ that it predicts from the encoders.

use super::pairs_without_effects;
use crate::geometry::{Configuration, wrap_angle};
use crate::observation::{EncoderReading, Measurement};
use crate::robot::{Model, PerBackbone};
use crate::statistics::moments::RunningSquares;
use nalgebra::Vector2;
use serde::Serialize;

/// Below this bend δ means too little to be scored, rad (15°).
///
/// Convention: fixed by the contract of `evaluate`'s `rms_delta_deg`; there an error across the bend counts four times in δ.
pub const LEAST_THETA_FOR_DELTA: f64 = 15.0 * std::f64::consts::PI / 180.0;

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
    let pairs = pairs_without_effects(model, measurements, encoders);
    let plain = &model.plain();
    let [mut eps, mut noise, mut theta, mut delta] = [RunningSquares::default(); 4];
    let (mut samples, mut unpredicted) = (0, 0);
    for pair in pairs {
        let (Measurement { measured: Some(measured), .. }, Some(reading)) = pair else { continue };
        let psi = measured.configuration;
        samples += 1;
        (reading.q_mm - plain.command(psi)).iter().for_each(|&left| eps.add(left));
        let command_by_angles = command_by_configuration(plain, psi);
        let covariance = measured.covariance();
        command_by_angles.iter().for_each(|by| noise.add(by.dot(&(covariance * by)).max(0.0).sqrt()));
        match plain.forward(&reading.q_mm) {
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
    Gap {
        samples,
        rms_eps_mm: eps.rms(),
        noise_floor_mm: noise.rms(),
        rms_theta_deg: theta.rms().to_degrees(),
        delta_samples: delta.count(),
        rms_delta_deg: delta.rms().to_degrees(),
        unpredicted,
    }
}

/// ∂(q + ε)/∂(θ, δ), mm per rad: what an error of the angles does to the ε that is inferred from them.
fn command_by_configuration(model: &Model, psi: Configuration) -> PerBackbone<Vector2<f64>> {
    model.robot.jacobian_q_psi(psi) + model.alpha(psi)
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
            encoders.push(EncoderReading::new(index, 0.0, model.command(psi)));
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
        let gap = gap(&model, &[measurement(5, 40.0, 10.0, 0.1)], &[EncoderReading::new(5, 0.0, q_mm)]);
        assert_relative_eq!(gap.rms_eps_mm, 0.03 / 3f64.sqrt(), max_relative = 1e-9);
        assert!(gap.rms_theta_deg > 0.1);
    }

    #[test]
    fn nothing_in_common_is_no_sample() {
        assert_eq!(gap(&Model::default(), &[measurement(0, 1.0, 1.0, 1.0)], &[]).samples, 0);
    }
}
