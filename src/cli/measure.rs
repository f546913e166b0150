//! `measure`: frames to measurements.csv.

use super::console::Console;
use super::inputs::{encoders_of, files_read, maker, model_of, rows};
use super::measuring::{Count, Measured, MeasuringArgs, Summary};
use super::trackers::open_trackers;
use super::views::{OpenView, open_views};
use crate::camera::Frame;
use crate::cli::failure::Failure;
use crate::measure::FrameMeasurement;
use crate::observation::Measurement;
use crate::record::{Experiment, OutputFolder, write_atomically};
use crate::report::explain::{page, stages};
use crate::{Error, Result};
use image::{ImageFormat, RgbImage};
use serde::Serialize;
use std::io::Cursor;
use std::path::PathBuf;

/// Measure θ and δ in every frame of an experiment: writes OUT/measurements.csv
///
/// A frame that cannot be measured has a row too, with the reason as its status.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop measure fixtures/bending -o out")]
pub struct Args {
    /// The experiment: a folder with an experiment.toml, or that file
    experiment: PathBuf,
    /// The folder to write to; created if it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Only draw every stage of measuring this frame (its index) into OUT/explain-FRAME-VIEW/, to see why it failed
    #[arg(long, value_name = "FRAME")]
    explain: Option<u64>,
    #[command(flatten)]
    measuring: MeasuringArgs,
}

#[derive(Serialize)]
struct Explained {
    view: String,
    status: String,
    page: PathBuf,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        self.measuring.start_threads()?;
        let experiment = Experiment::read(&self.experiment)?;
        const OUTPUTS: [&str; 3] = ["measurements.journal", "measurements.csv", "rig.jpg"];
        let out = OutputFolder::claim(&self.output, &OUTPUTS, &files_read(&experiment, &[]))?;
        if self.explain.is_none() {
            out.refuse_mixing(&maker("measure", &experiment), &OUTPUTS)?;
        }
        let model = model_of(console, &experiment)?;
        let encoders = rows(console, encoders_of(&experiment, &model)?);
        let views = open_views(console, &experiment, &model.robot, &self.output)?;
        if let Some(index) = self.explain {
            return Ok(self.explain(console, &experiment, &views, index)?);
        }
        let trackers = open_trackers(console, &experiment, &model.robot, &encoders)?;
        let inputs = (self.experiment.as_path(), &experiment, &views[..], &trackers[..], &encoders[..], &model);
        let throughput = match self.measuring.measure(console, inputs, None, &self.output, |_| Ok(()))? {
            Measured::Shard(throughput) => throughput,
            Measured::Whole(journal, throughput) => {
                journal.remove()?;
                Count::of_file(&self.output.join("measurements.csv"))?.require_some_measured(&experiment)?;
                Some(throughput)
            }
        };
        let summary = Summary::of(&self.output, throughput)?;
        summary.tell(console, &experiment);
        Ok(())
    }

    /// Draws every stage of measuring one frame, in every view that has it.
    fn explain(&self, console: &Console, experiment: &Experiment, views: &[OpenView], index: u64) -> Result<()> {
        let mut explained = Vec::new();
        for view in views {
            for source in view.source().frames()?.filter(|frame| frame.index == index) {
                explained.push(self.explain_one(view, index, &source.read_for(view.eye().lens())?)?);
            }
        }
        if explained.is_empty() {
            return Err(Error::content(&experiment.path, format!("no view has a frame {index}")));
        }
        let line = |e: &Explained| format!("{}: {}, {}\n", e.view, e.status, e.page.display());
        console.result(&explained, || explained.iter().map(line).collect());
        Ok(())
    }

    fn explain_one(&self, view: &OpenView, index: u64, frame: &Frame) -> Result<Explained> {
        let explanation = view.explain(frame);
        let FrameMeasurement { status, measured, quality, .. } = explanation.measurement.clone();
        let measurement =
            Measurement { index, time_s: None, status, measured, quality, view: Some(view.name().to_owned()) };
        let stages = stages(frame, &explanation, &measurement, |profile| view.shape(profile));
        let folder = self.output.join(format!("explain-{index:05}-{}", view.name()));
        for stage in &stages {
            write_atomically(&folder.join(stage.file), &png(&stage.picture)?)?;
        }
        let title = format!("{}, frame {index}, {}", self.experiment.display(), view.name());
        let path = folder.join("index.html");
        write_atomically(&path, page(&title, &explanation, &measurement, &stages).as_bytes())?;
        Ok(Explained { view: view.name().to_owned(), status: measurement.status.to_string(), page: path })
    }
}

fn png(picture: &RgbImage) -> Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, ImageFormat::Png).map_err(Error::encode("a picture"))?;
    Ok(bytes.into_inner())
}
