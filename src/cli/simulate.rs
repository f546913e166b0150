//! `simulate`: what the encoders of a robot with hidden η and λ read during a bending experiment.

use super::console::Console;
use super::inputs::{model_or_paper, rows};
use crate::record::{Waypoint, encoders_csv, measurements_csv, read_trajectory, truth_csv, write_atomically};
use crate::robot::Effect;
use crate::simulate::{BendingExperiment, Plant, SimulatedEye};
use crate::{Error, Result};
use serde::Serialize;
use std::path::PathBuf;

/// Simulate a bending experiment: writes OUT/encoders.csv and OUT/truth.csv
///
/// The snake is bent up and down at each δ of the sweeps, then led once round at a fixed θ. It obeys the model, whose η
/// and λ an estimator is to find again. Or it is led along a trajectory of your own, such as `discover --next` writes.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop simulate --model hidden.toml --observe -o simulated")]
pub struct Args {
    /// What the snake obeys (model.toml); without it the paper's, with Table I
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    /// An effect that the snake obeys besides, such as load_directed_backlash:play_mm=0.08; may be given again
    #[arg(long, value_name = "NAME:PARAMETER=VALUE,...", value_parser = Effect::parse)]
    effect: Vec<Effect>,
    /// The folder to write to; created where it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Poses and times to lead it along instead (index,time_s,theta_deg,delta_deg)
    #[arg(long, value_name = "CSV", conflicts_with_all =
        ["sweeps", "sweep_theta", "sweep_poses", "round_theta", "round_poses", "jitter"])]
    trajectory: Option<PathBuf>,
    /// δ of the sweeps, degrees, separated by commas
    #[arg(long, value_name = "DEGREES", value_delimiter = ',', allow_hyphen_values = true, default_value = "0,120")]
    sweeps: Vec<f64>,
    /// Least and largest θ of a sweep, degrees
    #[arg(long, value_name = "LEAST,LARGEST", value_delimiter = ',', default_value = "5,76")]
    sweep_theta: Vec<f64>,
    /// Poses on the way up of each sweep, and as many down
    #[arg(long, value_name = "COUNT", default_value_t = BendingExperiment::default().sweep_poses)]
    sweep_poses: usize,
    /// θ of the round, degrees
    #[arg(long, value_name = "DEGREES", default_value_t = BendingExperiment::default().round_theta_deg)]
    round_theta: f64,
    /// Poses of the round; 0 leaves it out
    #[arg(long, value_name = "COUNT", default_value_t = BendingExperiment::default().round_poses)]
    round_poses: usize,
    /// Standard deviation by which the poses miss their nominal angles, degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 1.0)]
    jitter: f64,
    /// Standard deviation of an encoder reading, mm
    #[arg(long, value_name = "MM", default_value_t = 0.0015)]
    encoder_sd: f64,
    /// Also write what an eye with typical noise would measure, to OUT/measurements.csv
    #[arg(long)]
    observe: bool,
    /// Seed of all noise: the same seed gives the same files
    #[arg(long, value_name = "NUMBER", default_value_t = 1)]
    seed: u64,
}

#[derive(Serialize)]
struct Summary {
    poses: usize,
    seconds: f64,
    output: PathBuf,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<()> {
        if !(0.0..=10.0).contains(&self.encoder_sd) {
            return Err(Error::Usage(format!("--encoder-sd {}: expected 0 to 10 mm", self.encoder_sd)));
        }
        let trajectory = match &self.trajectory {
            Some(path) => rows(console, read_trajectory(path)?),
            None => self.bending_experiment()?,
        };
        let mut model = model_or_paper(self.model.as_deref())?;
        model.effects.extend(self.effect.iter().cloned());
        let plant = Plant { model, sd_encoder_mm: self.encoder_sd };
        let samples = plant.run(&trajectory, self.seed.wrapping_add(1));

        let readings: Vec<_> = samples.iter().map(|sample| sample.reading).collect();
        let truths: Vec<_> = samples.iter().map(|sample| sample.truth).collect();
        self.write("encoders.csv", &encoders_csv(&readings))?;
        self.write("truth.csv", &truth_csv(&truths))?;
        if self.observe {
            let measurements = SimulatedEye::default().observe(&samples, self.seed.wrapping_add(2));
            self.write("measurements.csv", &measurements_csv(&measurements))?;
        }
        let seconds = readings.last().map_or(0.0, |reading| reading.time_s);
        let summary = Summary { poses: samples.len(), seconds, output: self.output.clone() };
        console.result(&summary, || {
            format!("{} poses in {:.1} s\n{}", summary.poses, summary.seconds, summary.output.display())
        });
        Ok(())
    }

    fn bending_experiment(&self) -> Result<Vec<Waypoint>> {
        let &[least, largest] = &self.sweep_theta[..] else {
            return Err(Error::Usage(format!("--sweep-theta: {} numbers, expected 2", self.sweep_theta.len())));
        };
        BendingExperiment {
            sweep_delta_deg: self.sweeps.clone(),
            sweep_theta_deg: (least, largest),
            sweep_poses: self.sweep_poses,
            round_theta_deg: self.round_theta,
            round_poses: self.round_poses,
            jitter_deg: self.jitter,
            seed: self.seed,
            ..BendingExperiment::default()
        }
        .waypoints()
    }

    fn write(&self, name: &str, text: &str) -> Result<()> {
        write_atomically(&self.output.join(name), text.as_bytes())
    }
}
