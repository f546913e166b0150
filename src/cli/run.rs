//! `run`: the main job, from frames and encoders to a compensation table and a report.

use super::console::Console;
use super::estimate::Estimated;
use super::estimator::EstimatorArgs;
use super::inputs::{encoders_of, model_of};
use super::table::largest_correction_mm;
use super::views::{OpenView, Throughput, count_by_status, measure_frames, open_views, require_some_measured};
use crate::camera::SourceFrame;
use crate::estimate::estimate;
use crate::record::{
    Checked, Experiment, Measurement, Status, estimates_csv, measurements_csv, write_atomically, write_compensation,
    write_model,
};
use crate::report::html::{Picture, Report};
use crate::report::overlay::{angles, overlay};
use crate::robot::{Grid, Model};
use crate::simulate::score::{self, Gap};
use crate::{Error, Result};
use image::codecs::jpeg::JpegEncoder;
use image::imageops::FilterType;
use image::{RgbImage, imageops};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

/// Measured frames that `--overlays sample` draws, besides the frames that failed.
const SAMPLE: usize = 24;
/// Width of the pictures in the report, px.
const THUMBNAIL_WIDTH: u32 = 640;

/// Do the main job: measure every frame, update η and λ, write the compensation table and a report
///
/// Writes measurements.csv, estimate.csv, model.toml, compensation.csv, compensation.json, overlays/ and report.html
/// into OUT, and prints a summary.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop run fixtures/bending -o out")]
pub struct Args {
    /// The experiment: a folder with an experiment.toml, or that file
    experiment: PathBuf,
    /// The folder to write to; created where it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Which frames to draw with the model on them
    #[arg(long, value_enum, default_value_t = Overlays::Sample)]
    overlays: Overlays,
    /// Follow a camera that moves: find it anew in every frame by grid and holder
    #[arg(long)]
    follow: bool,
    #[command(flatten)]
    estimator: EstimatorArgs,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Overlays {
    /// Every frame
    All,
    /// The frames that failed and about two dozen spread over the run
    Sample,
    /// None
    None,
}

#[derive(Serialize)]
struct Summary {
    frames: usize,
    statuses: BTreeMap<String, usize>,
    #[serde(flatten)]
    estimated: Estimated,
    /// What the updated model leaves.
    gap: Gap,
    /// What the naive model (η = 1, λ = 0) leaves.
    naive_gap: Gap,
    /// Poses in the compensation table.
    poses: usize,
    /// The largest correction |q̃ − q| in it, mm.
    largest_correction_mm: f64,
    #[serde(flatten)]
    throughput: Throughput,
    output: PathBuf,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<()> {
        let experiment = Experiment::read(&self.experiment)?;
        if experiment.encoders.is_none() {
            let message = "encoders is missing; `run` needs an encoder log, `measure` does without";
            return Err(Error::content(&experiment.path, message));
        }
        let start = model_of(&experiment)?;
        let Checked { rows: encoders, warnings } = encoders_of(&experiment)?;
        console.warn(&warnings);
        let views = open_views(&experiment, &start.robot)?;

        let (measurements, throughput) = measure_frames(console, &views, &encoders, self.follow)?;
        self.write("measurements.csv", &measurements_csv(&measurements))?;
        require_some_measured(&experiment, &measurements)?;

        let (steps, model) = estimate(&start, self.estimator.options(1.0), &measurements, &encoders)?;
        self.write("estimate.csv", &estimates_csv(&steps))?;
        let pictures = self.draw(console, &views, &measurements)?;

        let estimated = Estimated::of(&steps, model.estimate, &experiment.path)?;
        let model_path = self.output.join("model.toml");
        write_model(&model_path, &model)?;
        let table = write_compensation(&self.output, &model, &model_path.display().to_string(), &Grid::default())?;
        let naive = Model { estimate: None, ..model.clone() };
        let summary = Summary {
            frames: measurements.len(),
            statuses: count_by_status(&measurements),
            estimated,
            gap: score::gap(&model, &measurements, &encoders),
            naive_gap: score::gap(&naive, &measurements, &encoders),
            poses: table.len(),
            largest_correction_mm: largest_correction_mm(&table),
            throughput,
            output: self.output.clone(),
        };
        let report = Report {
            title: format!("snakeloop: {}", name_of(&experiment)),
            summary: summary.lines(),
            measurements: &measurements,
            estimates: &steps,
            pictures,
            warnings: warnings.iter().map(ToString::to_string).collect(),
            provenance: provenance(&experiment),
        };
        self.write("report.html", &report.html())?;
        console.result(&summary, || summary.text());
        Ok(())
    }

    fn write(&self, name: &str, text: &str) -> Result<()> {
        write_atomically(&self.output.join(name), text.as_bytes())
    }

    /// Draws the chosen frames into overlays/ and gives the sample of them, smaller, for the report.
    fn draw(&self, console: &Console, views: &[OpenView], measurements: &[Measurement]) -> Result<Vec<Picture>> {
        let sample = match self.overlays {
            Overlays::None => return Ok(Vec::new()),
            Overlays::All | Overlays::Sample => sample_of(measurements),
        };
        let chosen = match self.overlays {
            Overlays::All => measurements.iter().collect(),
            _ => sample.clone(),
        };
        let bar = console.progress(Some(chosen.len() * views.len()), "drawing");
        let mut pictures = Vec::new();
        for view in views {
            let by_index: HashMap<u64, &Measurement> = chosen.iter().map(|m| (m.index, *m)).collect();
            let drawn: Result<Vec<_>> = view
                .frames(|index| by_index.contains_key(&index))?
                .filter_map(|frame| by_index.get(&frame.index).map(|measurement| (frame, *measurement)))
                .map(|(frame, measurement)| {
                    let picture = draw_one(&self.output.join("overlays"), view, frame, measurement)?;
                    bar.inc(1);
                    Ok(picture.filter(|_| sample.contains(&measurement)).map(|picture| (measurement.index, picture)))
                })
                .collect();
            pictures.extend(drawn?.into_iter().flatten());
        }
        bar.finish_and_clear();
        pictures.sort_by_key(|(index, _)| *index);
        Ok(pictures.into_iter().map(|(_, picture)| picture).collect())
    }
}

/// The name of the experiment's folder.
fn name_of(experiment: &Experiment) -> String {
    let folder = experiment.folder();
    let full = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    full.file_name().map_or_else(|| full.display().to_string(), |name| name.to_string_lossy().into_owned())
}

/// What a run was made from.
fn provenance(experiment: &Experiment) -> Vec<(String, String)> {
    let shown = |path: &Path| path.display().to_string();
    let or_paper = |path: &Option<PathBuf>| path.as_deref().map_or("the paper's".to_owned(), shown);
    let mut lines = vec![
        ("program".to_owned(), format!("snakeloop {}", env!("CARGO_PKG_VERSION"))),
        ("experiment".to_owned(), shown(&experiment.path)),
        ("robot".to_owned(), or_paper(&experiment.robot)),
        ("starting model".to_owned(), or_paper(&experiment.model)),
    ];
    lines.extend(experiment.encoders.as_deref().map(|path| ("encoders".to_owned(), shown(path))));
    for view in &experiment.views {
        lines.push((format!("view {}", view.name), format!("{} through {}", view.frames, shown(&view.camera))));
    }
    lines
}

impl Summary {
    /// The figures that matter, by name.
    fn lines(&self) -> Vec<(String, String)> {
        let measured = self.statuses.get("ok").copied().unwrap_or(0);
        let failed: Vec<_> = self
            .statuses
            .iter()
            .filter(|(status, _)| *status != "ok")
            .map(|(status, count)| format!("{count} {status}"))
            .collect();
        let failed = if failed.is_empty() { String::new() } else { format!(" ({})", failed.join(", ")) };
        let (gap, naive, estimated) = (&self.gap, &self.naive_gap, &self.estimated);
        let lines = [
            ("frames measured", format!("{measured} of {}{failed}", self.frames)),
            ("measurements", estimated.counts()),
            ("force scale η", format!("{:.4} ± {:.4}", estimated.eta, estimated.sd_eta)),
            ("backlash λ", format!("{:.4} ± {:.4} mm", estimated.lambda_mm, estimated.sd_lambda_mm)),
            ("ε left (rms)", format!("{:.4} mm, noise alone {:.4} mm", gap.rms_eps_mm, gap.noise_floor_mm)),
            ("θ left (rms)", format!("{:.3}°, naive model {:.3}°", gap.rms_theta_deg, naive.rms_theta_deg)),
            ("δ left (rms)", format!("{:.3}°, naive model {:.3}°", gap.rms_delta_deg, naive.rms_delta_deg)),
            ("compensation", format!("{} poses, largest correction {:.3} mm", self.poses, self.largest_correction_mm)),
            (
                "speed",
                format!(
                    "{:.1} frames/s, {:.0} % of it decoding",
                    self.throughput.frames_per_second,
                    100.0 * self.throughput.decoding_share
                ),
            ),
        ];
        lines.map(|(name, value)| (name.to_owned(), value)).to_vec()
    }

    fn text(&self) -> String {
        let lines = self.lines().into_iter().map(|(name, value)| format!("{name:<16} {value}\n"));
        lines.collect::<String>() + &format!("{:<16} {}", "written", self.output.join("report.html").display())
    }
}

/// The frames that failed, and [`SAMPLE`] of the others spread over the run.
fn sample_of(measurements: &[Measurement]) -> Vec<&Measurement> {
    let good = measurements.iter().filter(|m| m.status == Status::Ok).count();
    let mut seen = 0;
    let mut wanted = |measurement: &Measurement| {
        if measurement.status != Status::Ok {
            return true;
        }
        seen += 1;
        // As many multiples of good/SAMPLE are reached as pictures are wanted.
        good <= SAMPLE || seen * SAMPLE / good > (seen - 1) * SAMPLE / good
    };
    measurements.iter().filter(|m| wanted(m)).collect()
}

/// Draws one frame into the folder and gives it, smaller, for the report; `None` where it cannot be read.
fn draw_one(folder: &Path, view: &OpenView, frame: SourceFrame, measurement: &Measurement) -> Result<Option<Picture>> {
    let Ok(frame) = frame.read() else { return Ok(None) };
    let shape = measurement.measured.map(|measured| view.shape(measured.configuration));
    let picture = overlay(&frame, measurement, shape.as_ref());
    let path = folder.join(format!("{}_{:05}.jpg", view.name(), measurement.index));
    write_atomically(&path, &jpeg(&picture, 90)?)?;

    let caption = match &measurement.measured {
        Some(measured) => {
            let (theta, delta) = angles(measured);
            format!("frame {}: θ {theta}, δ {delta}", measurement.index)
        }
        None => format!("frame {}: {}", measurement.index, measurement.status),
    };
    Ok(Some(Picture { caption, jpeg: jpeg(&thumbnail(&picture), 80)? }))
}

fn thumbnail(picture: &RgbImage) -> RgbImage {
    let width = picture.width().min(THUMBNAIL_WIDTH);
    let height = (u64::from(picture.height()) * u64::from(width) / u64::from(picture.width())).max(1) as u32;
    imageops::resize(picture, width, height, FilterType::Triangle)
}

fn jpeg(picture: &RgbImage, quality: u8) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    match JpegEncoder::new_with_quality(&mut bytes, quality).encode_image(picture) {
        Ok(()) => Ok(bytes),
        Err(e) => Err(Error::Domain(format!("cannot encode a picture of {:?} px: {e}", picture.dimensions()))),
    }
}
