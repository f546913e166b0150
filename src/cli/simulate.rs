//! `simulate`: what the encoders of a robot with hidden η and λ read during a bending experiment.

use super::console::Console;
use super::inputs::{WorthArgs, rows, with_effects};
use crate::Result;
use crate::cli::failure::Failure;
use crate::closed_loop::ClosedLoop;
use crate::estimate::EtaLambda;
use crate::observation::Waypoint;
use crate::quantity::with_sd;
use crate::record::{
    Worth, compensation_files, csv_of, encoders_csv, measurements_csv, model_toml, read_trajectory, truth_csv,
    write_atomically, write_together,
};
use crate::report::learning::learning_curve;
use crate::robot::{Effect, Estimate, Model};
use crate::simulate::{BendingExperiment, Plant, Scene, SimulatedEye};
use nalgebra::Matrix2;
use serde::Serialize;
use std::path::PathBuf;

/// Simulate a bending experiment: writes OUT/encoders.csv and OUT/truth.csv
///
/// The snake bends up and down at each δ of the sweeps, then moves once round at a fixed θ; or it follows your own trajectory, such as the
/// one that `discover --next` writes. It obeys the model, whose η and λ `estimate` should find again. With --closed-loop the whole loop is
/// simulated instead: controller, camera and robot.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop simulate --model hidden.toml --observe -o simulated")]
pub struct Args {
    /// The model that the snake obeys (model.toml); without it the paper's, with Table I. With --closed-loop a model without η and λ gets the
    /// paper's, 1.221 and 0.1765 mm, which are hidden from the controller
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    /// An effect that the snake obeys in addition, such as load_directed_backlash:play_mm=0.08; may be repeated
    #[arg(long, value_name = "NAME:PARAMETER=VALUE,...", value_parser = Effect::parse)]
    effect: Vec<Effect>,
    /// The folder to write to; created if it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Poses and times to follow instead (index,time_s,theta_deg,delta_deg); n1_q1_mm and so on are the encoder readings of a neighbouring
    /// section
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
    /// Poses of the round; 0 for no round
    #[arg(long, value_name = "COUNT", default_value_t = BendingExperiment::default().round_poses)]
    round_poses: usize,
    /// Standard deviation by which the poses miss their nominal angles, degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 1.0)]
    jitter: f64,
    /// Standard deviation of an encoder reading, mm
    #[arg(long, value_name = "MM", default_value_t = 0.0015)]
    encoder_sd: f64,
    /// Also write what a camera with typical noise would measure, to OUT/measurements.csv
    #[arg(long)]
    observe: bool,
    /// Simulate controller and robot: command the poses through the table learned so far, render and measure the bend that the snake
    /// reached, and learn from it. Writes OUT/closed_loop.csv, closed_loop.svg, model.toml and the table instead. λ changes no bend,
    /// so that a closed loop cannot learn it: its σ in model.toml says so
    #[arg(long, conflicts_with = "observe")]
    closed_loop: bool,
    /// With --closed-loop: camera, grid target and light (scene.toml); by default a clean picture
    #[arg(long, value_name = "SCENE", requires = "closed_loop")]
    scene: Option<PathBuf>,
    /// Seed of all noise: the same seed gives the same files
    #[arg(long, value_name = "NUMBER", default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    worth: WorthArgs,
}

#[derive(Serialize)]
struct Summary {
    poses: usize,
    seconds: f64,
    /// Why the model that the snake obeys must not be used.
    #[serde(skip_serializing_if = "Option::is_none")]
    do_not_use: Option<String>,
    output: PathBuf,
}

/// What the snake of a closed loop hides where its model says nothing.
///
/// Source: the paper's Table III, last row.
const HIDDEN: Estimate =
    Estimate { eta: 1.221, lambda_mm: 0.1765, covariance: Matrix2::new(0.0, 0.0, 0.0, 0.0), samples: 0 };

#[derive(Serialize)]
struct Closed {
    frames: usize,
    /// Rms miss of the naive table, degrees.
    table_error_before_deg: f64,
    /// The same of the last one.
    table_error_after_deg: f64,
    /// What the snake obeyed.
    hidden: EtaLambda,
    /// What was learned; `None` where too little was measured.
    #[serde(flatten)]
    learned: Option<EtaLambda>,
    /// Why the model that the snake obeys must not be used.
    #[serde(skip_serializing_if = "Option::is_none")]
    do_not_use: Option<String>,
    output: PathBuf,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        if !(0.0..=10.0).contains(&self.encoder_sd) {
            return Err(Failure::Usage(format!("--encoder-sd {}: expected 0 to 10 mm", self.encoder_sd)));
        }
        let trajectory = match &self.trajectory {
            Some(path) => rows(console, read_trajectory(path)?),
            None => self.bending_experiment()?,
        };
        let (model, do_not_use) = self.worth.model(console, self.model.as_deref())?;
        let mut model = with_effects(console, model, &self.effect)?;
        if self.closed_loop || trajectory.iter().any(|waypoint| waypoint.neighbours.count() < model.neighbours()) {
            console.warn(model.resting_neighbours());
        }
        if self.closed_loop {
            if model.samples.is_none() {
                model = model.with_estimate(HIDDEN);
            }
            return Ok(self.close_the_loop(console, (model, do_not_use), &trajectory)?);
        }
        let plant = Plant { model, sd_encoder_mm: self.encoder_sd };
        let samples = plant.run(&trajectory, self.seed.wrapping_add(1));

        let readings: Vec<_> = samples.iter().map(|sample| sample.reading).collect();
        let truths: Vec<_> = samples.iter().map(|sample| sample.truth).collect();
        self.write("encoders.csv", &encoders_csv(&readings, plant.model.robot.backbone_count()))?;
        self.write("truth.csv", &truth_csv(&truths))?;
        if self.observe {
            let measurements = SimulatedEye::default().observe(&samples, self.seed.wrapping_add(2));
            self.write("measurements.csv", &measurements_csv(&measurements))?;
        }
        let seconds = readings.last().map_or(0.0, |reading| reading.time_s);
        let summary = Summary { poses: samples.len(), seconds, do_not_use, output: self.output.clone() };
        console.result(&summary, || {
            format!("{} poses in {:.1} s\n{}", summary.poses, summary.seconds, summary.output.display())
        });
        if self.observe {
            let out = self.output.display();
            console.next(format_args!(
                "snakeloop estimate --measurements {out}/measurements.csv --encoders {out}/encoders.csv -o estimated"
            ));
        }
        Ok(())
    }

    fn close_the_loop(
        &self,
        console: &Console,
        (plant, do_not_use): (Model, Option<String>),
        trajectory: &[Waypoint],
    ) -> Result<()> {
        let clean = || Ok(Scene { robot: plant.robot.clone(), ..Scene::default() });
        let scene = self.scene.as_deref().map_or_else(clean, Scene::read)?;
        let simulation = ClosedLoop {
            plant,
            grid_pitch_mm: scene.grid_pitch_mm()?,
            scene,
            sd_encoder_mm: self.encoder_sd,
            seed: self.seed,
        };
        let poses: Vec<_> = trajectory.iter().map(|waypoint| waypoint.configuration).collect();
        let bar = console.progress(Some(poses.len()), "closing the loop");
        let (cycles, model) = simulation.run(&poses, &|| bar.inc(1))?;
        bar.finish_and_clear();
        let first = simulation.table_error_deg(&simulation.naive())?;
        self.write("closed_loop.csv", &csv_of(&cycles)?)?;
        if let Some(svg) = learning_curve(first, &cycles) {
            self.write("closed_loop.svg", &svg)?;
        }
        let model_path = self.output.join("model.toml");
        let worth = Worth { do_not_use: do_not_use.as_deref(), ..Worth::default() };
        let (mut files, _) = compensation_files(&self.output, &model, &model_path.display().to_string(), worth)?;
        files.push((model_path, model_toml(&model)?));
        write_together(&files)?;
        let summary = Closed {
            frames: cycles.len(),
            table_error_before_deg: first,
            table_error_after_deg: cycles.last().map_or(first, |cycle| cycle.table_error_deg),
            hidden: EtaLambda::from(simulation.plant.estimate().unwrap_or(HIDDEN)),
            learned: model.estimate().map(EtaLambda::from),
            do_not_use,
            output: self.output.clone(),
        };
        console.result(&summary, || summary.text());
        Ok(())
    }

    fn bending_experiment(&self) -> Result<Vec<Waypoint>, Failure> {
        let &[least, largest] = &self.sweep_theta[..] else {
            return Err(Failure::Usage(format!("--sweep-theta: {} numbers, expected 2", self.sweep_theta.len())));
        };
        let experiment = BendingExperiment {
            sweep_delta_deg: self.sweeps.clone(),
            sweep_theta_deg: (least, largest),
            sweep_poses: self.sweep_poses,
            round_theta_deg: self.round_theta,
            round_poses: self.round_poses,
            jitter_deg: self.jitter,
            seed: self.seed,
            ..BendingExperiment::default()
        };
        Ok(experiment.waypoints()?)
    }

    fn write(&self, name: &str, text: &str) -> Result<()> {
        write_atomically(&self.output.join(name), text.as_bytes())
    }
}

impl Closed {
    fn text(&self) -> String {
        let Self { frames, table_error_before_deg, table_error_after_deg, hidden, learned, output, .. } = self;
        let (before, after) = (table_error_before_deg, table_error_after_deg);
        let mut text = format!("{frames} frames; the table's error fell from {before:.2}° to {after:.3}° rms\n");
        text += &match learned {
            None => "η was not learned: too few frames were measured\n".to_owned(),
            Some(EtaLambda { eta, sd_eta, lambda_mm, sd_lambda_mm }) => format!(
                "η {} learned, {:.4} hidden\n\
                 λ {} mm, {:.4} mm hidden: it moves no bend, and a closed loop cannot see it\n",
                with_sd(*eta, *sd_eta),
                hidden.eta,
                with_sd(*lambda_mm, *sd_lambda_mm),
                hidden.lambda_mm
            ),
        };
        text + &output.display().to_string()
    }
}
