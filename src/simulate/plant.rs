//! The plant: what encoders and an eye would say of a snake whose model is known. For tests, and for whoever has no robot.

use crate::geometry::{Configuration, sinc};
use crate::observation::{EncoderReading, Measured, Measurement, Status, Truth, Waypoint};
use crate::robot::{Mechanics, Model, PerBackbone};
use nalgebra::{Rotation2, Vector2};
use rand::SeedableRng;
use rand::rngs::StdRng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::PI;

/// A snake with an actuation line that follows its (hidden) model, read by encoders with noise.
#[derive(Debug, Clone, PartialEq)]
pub struct Plant {
    /// What the snake obeys; its η and λ are what an estimator is to find.
    pub model: Model,
    /// Standard deviation of an encoder reading, mm.
    pub sd_encoder_mm: f64,
}

/// One instant of a simulated experiment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// What the encoders read.
    pub reading: EncoderReading,
    /// What a frame of the same index shows: what the snake did, a moment ago where the camera is late.
    pub truth: Truth,
    /// What an eye without noise makes of it: the same, but for effects on the eye.
    pub apparent: Configuration,
}

impl Plant {
    /// Leads the snake along a trajectory; indices count from 0. The same seed gives the same noise.
    pub fn run(&self, trajectory: &[Waypoint], seed: u64) -> Vec<Sample> {
        let mut random = StdRng::seed_from_u64(seed);
        let times_s: Vec<f64> = trajectory.iter().map(|waypoint| waypoint.time_s).collect();
        let bends: Vec<_> = trajectory.iter().map(|waypoint| waypoint.configuration.bend_vector()).collect();
        let backbones = self.model.robot.backbone_count();
        let mechanics = Mechanics::new(&self.model);
        let exposed = mechanics.exposed_bends(&times_s, &bends);
        let observations = mechanics.observations(&times_s, &bends);
        let all = observations.iter().zip(exposed).enumerate();
        all.map(|(k, (observation, exposed))| {
            let index = k as u64;
            let noise = PerBackbone::from_fn(backbones, |_| StandardNormal.sample(&mut random)) * self.sd_encoder_mm;
            let neighbours = trajectory[k].neighbours;
            let q_mm = observation.q_mm + self.model.by_neighbours_mm(&neighbours) + noise;
            Sample {
                reading: EncoderReading { index, time_s: observation.time_s, q_mm, neighbours },
                truth: Truth { index, configuration: Configuration::from_bend_vector(exposed) },
                apparent: observation.configuration,
            }
        })
        .collect()
    }
}

/// An eye that measures the true bend with Gaussian noise, and says truly how much.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedEye {
    /// Standard deviation of θ, degrees.
    pub sigma_theta_deg: f64,
    /// Standard deviation across the bend, degrees: δ is good to this over sin θ.
    pub sigma_across_deg: f64,
}

impl Default for SimulatedEye {
    /// σ_θ = 0.12°, σ_δ = 0.25°/sin θ.
    ///
    /// Convention: the project's own simulated eye.
    fn default() -> Self {
        Self { sigma_theta_deg: 0.12, sigma_across_deg: 0.25 }
    }
}

impl SimulatedEye {
    /// Measurements of a simulated experiment. The same seed gives the same noise.
    pub fn observe(&self, samples: &[Sample], seed: u64) -> Vec<Measurement> {
        let mut random = StdRng::seed_from_u64(seed);
        samples
            .iter()
            .map(|sample| Measurement {
                index: sample.truth.index,
                time_s: Some(sample.reading.time_s),
                status: Status::Ok,
                measured: Some(self.measure(sample.apparent, &mut random)),
                quality: None,
                view: None,
            })
            .collect()
    }

    /// The noise is drawn along and across the bend, so that it is smooth through the straight snake.
    fn measure(&self, truth: Configuration, random: &mut StdRng) -> Measured {
        let mut draw = || -> f64 { StandardNormal.sample(random) };
        let sigma_theta = self.sigma_theta_deg.to_radians();
        let across = self.sigma_across_deg.to_radians() / sinc(truth.theta);
        let error = Rotation2::new(truth.delta) * Vector2::new(sigma_theta * draw(), across * draw());
        let configuration = Configuration::from_bend_vector(truth.bend_vector() + error);
        let sigma_delta = (self.sigma_across_deg.to_radians() / configuration.theta.sin().abs()).min(PI);
        Measured::independent(configuration, sigma_theta, sigma_delta, 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::wrap_angle;
    use crate::simulate::trajectory::BendingExperiment;
    use crate::statistics::moments::rms;

    fn plant() -> Plant {
        Plant { model: Model::default(), sd_encoder_mm: 0.0015 }
    }

    #[test]
    fn encoders_read_the_command_that_leads_there_plus_noise() {
        let trajectory = BendingExperiment { sweep_poses: 200, ..Default::default() }.waypoints().unwrap();
        let samples = plant().run(&trajectory, 3);
        let noise = |s: &Sample| (s.reading.q_mm - Model::default().command(s.truth.configuration)).norm();
        let sd = rms(samples.iter().map(noise)) / 3f64.sqrt();
        // Of n numbers the sd scatters by 1/√(2n): four of that.
        let scatter = 1.0 / (2.0 * 3.0 * samples.len() as f64).sqrt();
        assert!((sd / 0.0015 - 1.0).abs() < 4.0 * scatter, "{sd}");
        assert_eq!(samples, plant().run(&trajectory, 3));
        assert_ne!(samples, plant().run(&trajectory, 4));
    }

    #[test]
    fn the_eyes_errors_are_as_large_as_it_says() {
        let trajectory = BendingExperiment { sweep_poses: 1000, ..Default::default() }.waypoints().unwrap();
        let samples = plant().run(&trajectory, 3);
        let measurements = SimulatedEye::default().observe(&samples, 4);
        let mut squares = [0.0; 2];
        for (sample, measurement) in samples.iter().zip(&measurements) {
            let (truth, measured) = (sample.truth.configuration, measurement.measured.unwrap());
            squares[0] += ((measured.configuration.theta - truth.theta) / measured.sigma_theta).powi(2);
            squares[1] += (wrap_angle(measured.configuration.delta - truth.delta) / measured.sigma_delta).powi(2);
        }
        let scales = squares.map(|sum| (sum / samples.len() as f64).sqrt());
        let scatter = 1.0 / (2.0 * samples.len() as f64).sqrt();
        assert!(scales.iter().all(|scale| (scale - 1.0).abs() < 4.0 * scatter), "{scales:?}");
    }
}
