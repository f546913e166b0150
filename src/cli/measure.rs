//! `measure`: frames to measurements.csv.

use super::console::Console;
use super::inputs::{encoders_of, model_of, rows};
use super::views::{Throughput, count_by_status, measure_frames, open_views, require_some_measured};
use crate::Result;
use crate::record::{Experiment, measurements_csv, write_atomically};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Measure θ and δ in every frame of an experiment: writes OUT/measurements.csv
///
/// A frame that cannot be measured has its row too, with the reason as its status.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop measure fixtures/bending -o out")]
pub struct Args {
    /// The experiment: a folder with an experiment.toml, or that file
    experiment: PathBuf,
    /// The folder to write to; created where it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
}

#[derive(Serialize)]
struct Summary {
    frames: usize,
    statuses: BTreeMap<String, usize>,
    #[serde(flatten)]
    throughput: Throughput,
    measurements: PathBuf,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<()> {
        let experiment = Experiment::read(&self.experiment)?;
        let model = model_of(&experiment)?;
        let encoders = rows(console, encoders_of(&experiment)?);
        let views = open_views(&experiment, &model.robot)?;
        let (measurements, throughput) = measure_frames(console, &views, &encoders)?;
        let path = self.output.join("measurements.csv");
        write_atomically(&path, measurements_csv(&measurements).as_bytes())?;
        require_some_measured(&experiment, &measurements)?;
        let statuses = count_by_status(&measurements);
        let summary = Summary { frames: measurements.len(), statuses, throughput, measurements: path };
        console.result(&summary, || summary.text());
        Ok(())
    }
}

impl Summary {
    fn text(&self) -> String {
        let statuses: Vec<_> = self.statuses.iter().map(|(status, count)| format!("{count} {status}")).collect();
        format!(
            "{} frames: {}\n{:.1} frames/s, {:.0} % of it decoding\n{}",
            self.frames,
            statuses.join(", "),
            self.throughput.frames_per_second,
            100.0 * self.throughput.decoding_share,
            self.measurements.display()
        )
    }
}
