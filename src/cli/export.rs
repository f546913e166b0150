//! `export`: a run as one file for other people's viewers.

use super::console::Console;
use crate::Result;
use crate::cli::failure::Failure;
use crate::record::{Experiment, Recorded, write_recording};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Write a run as a ROS 2 recording (MCAP), for Foxglove, RViz, PlotJuggler and the like, or to be read again
///
/// Every row of measurements.csv, estimate.csv, encoders.csv, stem.csv and force.csv in DIR becomes a message with the row's time, every
/// frame a compressed image.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop run fixtures/bending -o out && \
                  snakeloop export out --experiment fixtures/bending -o run.mcap")]
pub struct Args {
    /// The folder that `run`, `measure` or `live` wrote to
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// The experiment of the run: adds its encoder log, and its frames if they are PNG or JPEG files
    #[arg(long)]
    experiment: Option<PathBuf>,
    /// The file to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

#[derive(Serialize)]
struct Written<'a> {
    #[serde(flatten)]
    recorded: &'a Recorded,
    output: &'a Path,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        let experiment = self.experiment.as_deref().map(Experiment::read).transpose()?;
        let recorded = write_recording(&self.output, &self.folder, experiment.as_ref())?;
        console.warn(&recorded.remarks);
        let written = Written { recorded: &recorded, output: &self.output };
        console.result(&written, || {
            let lines = recorded.messages.iter().map(|(topic, messages)| format!("{topic:<20} {messages} messages\n"));
            lines.collect::<String>() + &self.output.display().to_string()
        });
        console.next(format_args!("open {} in Foxglove", self.output.display()));
        Ok(())
    }
}
