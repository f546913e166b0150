//! What tests of several stages work on.

use super::data::Data;
use crate::robot::Model;
use crate::simulate::{BendingExperiment, Plant, SimulatedEye};

/// Standard deviation of the encoders, mm.
pub const SD_ENCODER_MM: f64 = 0.0015;

/// The paper's robot with η = 1.2 and λ = 0.15 mm.
pub fn truth() -> Model {
    Model { eta: 1.2, lambda_mm: 0.15, samples: Some(0), ..Model::default() }
}

/// An experiment with a robot that lacks nothing, with the noise of the simulated eye and encoders.
pub fn experiment(seed: u64) -> Data {
    let trajectory = BendingExperiment { sweep_poses: 20, ..Default::default() }.waypoints().unwrap();
    let samples = Plant { model: truth(), sd_encoder_mm: SD_ENCODER_MM }.run(&trajectory, seed);
    let readings: Vec<_> = samples.iter().map(|s| s.reading).collect();
    Data::new(&SimulatedEye::default().observe(&samples, seed + 1000), &readings, SD_ENCODER_MM).unwrap()
}
