//! Closed-loop simulation of controller, robot and camera: the controller commands through its compensation table, a simulated snake
//! obeys its own hidden model, a rendered frame shows where it went, the eye measures it, the estimator updates η and λ, and the next
//! command uses them.
//!
//! The controller knows the robot's constants and nothing of η and λ: it starts with Section IV's naive compensation. The camera is
//! calibrated from a rendered straight picture, as a real one is. After each frame the table's error is computed over a grid of poses,
//! from where the simulated snake would go.
//!
//! λ cannot be learned here. It is common to all backbones and moves no bend, and the common part of what the encoders read is what the
//! controller itself commanded: what it leaves out becomes internal force of the redundant backbones. The controller therefore goes on
//! commanding λ = 0, and its model says with the σ of λ that nothing is known of it ([`SD_OF_UNSEEN_LAMBDA_MM`]).

use crate::camera::Frame;
use crate::error::{Error, Result};
use crate::estimate::{Estimator, Options};
use crate::geometry::Configuration;
use crate::measure::{Eye, RigOptions, calibrate_rig};
use crate::observation::{EncoderReading, Measured, Measurement, Status};
use crate::robot::{Estimate, Model};
use crate::simulate::{Scene, render};
use crate::statistics::moments::RunningSquares;
use crate::verdict::MOST_LAMBDA_MM;
use image::DynamicImage;
use nalgebra::Matrix2;
use rand::SeedableRng;
use rand::rngs::StdRng;
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;
use std::path::Path;

/// What a closed loop knows of λ, as its standard deviation about 0, mm.
///
/// Derived: √3 = √(1/∫₀¹ x² dx): the root mean square of a play that lies anywhere between none and [`MOST_LAMBDA_MM`].
pub const SD_OF_UNSEEN_LAMBDA_MM: f64 = MOST_LAMBDA_MM / 1.732_050_807_568_877_2;

/// A closed-loop simulation.
#[derive(Debug, Clone)]
pub struct ClosedLoop {
    /// What the snake obeys. History, as of motion-directed effects, acts as for a single pose.
    pub plant: Model,
    /// Camera, grid target and light.
    pub scene: Scene,
    /// Pitch of the grid target's thin lines, mm.
    pub grid_pitch_mm: f64,
    /// Standard deviation of an encoder reading, mm.
    pub sd_encoder_mm: f64,
    /// Seed of all noise.
    pub seed: u64,
}

/// One cycle of the loop: a command, its frame and the estimate after it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cycle {
    /// Number of the command, from 0.
    pub index: u64,
    /// Where the snake was to go: θ, degrees.
    pub desired_theta_deg: f64,
    /// Where the snake was to go: δ, degrees.
    pub desired_delta_deg: f64,
    /// Where it went: θ, degrees.
    pub reached_theta_deg: f64,
    /// Where it went: δ, degrees.
    pub reached_delta_deg: f64,
    /// What the eye measured: θ, degrees.
    pub measured_theta_deg: Option<f64>,
    /// What the eye measured: δ, degrees.
    pub measured_delta_deg: Option<f64>,
    /// `ok`, or why there are no angles.
    pub status: String,
    /// η after the measurement.
    pub eta: Option<f64>,
    /// Its standard deviation.
    pub sd_eta: Option<f64>,
    /// λ after the measurement, mm.
    pub lambda_mm: Option<f64>,
    /// Its standard deviation, mm.
    pub sd_lambda_mm: Option<f64>,
    /// How far the snake was from where it was to go, as a bend vector, degrees.
    pub error_deg: f64,
    /// The same over the table of the model after this measurement, rms, degrees.
    pub table_error_deg: f64,
}

impl ClosedLoop {
    /// Runs one cycle for each desired pose; `done` is called after each. Gives the cycles and the controller's model at the end.
    ///
    /// # Errors
    /// A scene that cannot be drawn or from which no rig can be calibrated; a pose that the plant cannot reach.
    pub fn run(&self, poses: &[Configuration], done: &dyn Fn()) -> Result<(Vec<Cycle>, Model)> {
        self.scene.check()?;
        let eye = self.eye()?;
        let naive = self.naive();
        let options = Options { sd_encoder_mm: self.sd_encoder_mm.max(1e-6), ..Options::default() };
        let mut estimator = Estimator::new(&naive, options)?;
        let mut random = StdRng::seed_from_u64(self.seed);
        let mut cycles = Vec::with_capacity(poses.len());
        let mut controller = naive;
        for (index, &desired) in (0u64..).zip(poses) {
            let command = controller.command(desired);
            let reached = self.plant.forward(&command)?.configuration;
            let noise = command.map(|_| StandardNormal.sample(&mut random)) * self.sd_encoder_mm;
            let reading = EncoderReading::new(index, index as f64, command + noise);
            let seen = eye.measure(&frame(&self.scene, reached, self.seed.wrapping_add(1 + index))?);
            let measurement = seen.row(index, Some(reading.time_s), None);
            estimator.update(&measurement, Some(&reading));
            controller = without_lambda(&estimator.model());
            let (learned, table_error_deg) = (controller.estimate(), self.table_error_deg(&controller)?);
            cycles.push(cycle(desired, reached, &measurement, learned, table_error_deg));
            done();
        }
        Ok((cycles, controller))
    }

    /// What the controller knows at the start: the robot and its friction.
    pub fn naive(&self) -> Model {
        self.plant.plain().without_estimate()
    }

    /// The rms error (degrees, as a bend vector) of a controller's table: θ 15–75°, δ once round.
    ///
    /// # Errors
    /// A pose that the plant cannot reach.
    pub fn table_error_deg(&self, controller: &Model) -> Result<f64> {
        let grid = (1..=5).flat_map(|t| (0..8).map(move |d| (15.0 * f64::from(t), 45.0 * f64::from(d))));
        let mut errors = RunningSquares::default();
        for (theta_deg, delta_deg) in grid {
            let desired = Configuration::from_degrees(theta_deg, delta_deg);
            let reached = self.plant.forward(&controller.command(desired))?.configuration;
            errors.add((reached.bend_vector() - desired.bend_vector()).norm());
        }
        Ok(errors.rms().to_degrees())
    }

    /// The camera, calibrated from a straight picture.
    fn eye(&self) -> Result<Eye> {
        let straight = frame(&self.scene, Configuration::new(0.0, 0.0), self.seed)?;
        let options = RigOptions {
            grid_pitch_mm: self.grid_pitch_mm,
            standoff_mm: self.scene.paper.standoff_mm,
            delta_offset: 0.0,
        };
        let rig = calibrate_rig(&straight, &self.scene.lens, &self.plant.robot, &options)
            .map_err(Error::rig(Path::new("the rendered straight picture")))?;
        Ok(Eye::new(self.scene.lens.clone(), rig, self.plant.robot.clone()))
    }
}

/// What a closed loop has learned: η, and nothing of λ (see the module's text). Their errors are independent, since the bends that tell η do
/// not move with λ.
fn without_lambda(learned: &Model) -> Model {
    let Some(estimate) = learned.estimate() else { return learned.clone() };
    let covariance = Matrix2::new(estimate.covariance[(0, 0)], 0.0, 0.0, SD_OF_UNSEEN_LAMBDA_MM.powi(2));
    learned.clone().with_estimate(Estimate { lambda_mm: 0.0, covariance, ..estimate })
}

/// A rendered picture as a camera gives it.
fn frame(scene: &Scene, psi: Configuration, seed: u64) -> Result<Frame> {
    Frame::from_image(DynamicImage::ImageRgb8(render(scene, psi, seed)))
        .ok_or(Error::Scene("lens: the picture must have pixels"))
}

fn cycle(
    desired: Configuration,
    reached: Configuration,
    measurement: &Measurement,
    estimate: Option<Estimate>,
    table_error_deg: f64,
) -> Cycle {
    let ok = measurement.status == Status::Ok;
    let measured: Option<Measured> = measurement.measured.filter(|_| ok);
    Cycle {
        index: measurement.index,
        desired_theta_deg: desired.theta_deg(),
        desired_delta_deg: desired.delta_deg(),
        reached_theta_deg: reached.theta_deg(),
        reached_delta_deg: reached.delta_deg(),
        measured_theta_deg: measured.map(|m| m.configuration.theta_deg()),
        measured_delta_deg: measured.map(|m| m.configuration.delta_deg()),
        status: measurement.status.to_string(),
        eta: estimate.map(|e| e.eta),
        sd_eta: estimate.map(|e| e.sd_eta()),
        lambda_mm: estimate.map(|e| e.lambda_mm),
        sd_lambda_mm: estimate.map(|e| e.sd_lambda_mm()),
        error_deg: (reached.bend_vector() - desired.bend_vector()).norm().to_degrees(),
        table_error_deg,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_falls_once_the_eye_has_seen_a_few_bends() {
        let estimate = Estimate { eta: 1.221, lambda_mm: 0.1765, covariance: Matrix2::zeros(), samples: 0 };
        let simulation = ClosedLoop {
            plant: Model::default().with_estimate(estimate),
            scene: Scene::default(),
            grid_pitch_mm: 1.0,
            sd_encoder_mm: 0.0015,
            seed: 3,
        };
        let naive = simulation.table_error_deg(&simulation.naive()).unwrap();
        assert!(simulation.table_error_deg(&simulation.plant).unwrap() < 1e-6);
        let poses = [(30.0, 20.0), (55.0, 160.0), (70.0, 0.0)].map(|(t, d)| Configuration::from_degrees(t, d));
        let (cycles, model) = simulation.run(&poses, &|| ()).unwrap();
        assert!(cycles.iter().all(|cycle| cycle.status == "ok"), "{cycles:?}");
        assert!((cycles[0].table_error_deg - naive).abs() < 1e-9 && naive > 3.0, "one measurement pins nothing");
        assert!(cycles[2].table_error_deg < 0.1 * naive, "{naive}° at first, {}° at last", cycles[2].table_error_deg);
        assert!(cycles[0].error_deg > 2.0 && cycles[2].error_deg < 0.7, "{cycles:?}");
        let learned = model.estimate().unwrap();
        assert!((learned.eta - 1.221).abs() < 0.03);
        assert!((learned.lambda_mm - 0.1765).abs() < learned.sd_lambda_mm(), "what is not seen must be in the σ");
        let command = model.command(poses[0]);
        assert!(model.command_sds(poses[0])[0] > 0.9 * SD_OF_UNSEEN_LAMBDA_MM, "{command:?}");
    }
}
