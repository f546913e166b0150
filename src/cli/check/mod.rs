//! `check`: whether an experiment is fit for a run, in seconds, and what to do where it is not.
//!
//! Files, sizes, indices and clocks are looked at as they stand. A small share of the frames is then measured, by the rig as the straight
//! picture gives it, and every pose of a tracker; they are passed to the verdict's rules. What a run will know of η and λ is predicted by
//! the estimator itself from measurements as it expects them at every reading.

mod expected;
mod files;

use super::console::Console;
use super::inputs::{encoders_of, model_of};
use super::trackers::{OpenTracker, open_tracker};
use super::verdict::{VerdictArgs, reasons_of_files, subject, unit_is_stated, verdict_text};
use super::views::{rig_of, rig_picture_name, rig_reason, sheet_reason};
use crate::camera::{FrameSource, picture_size_for};
use crate::cli::failure::Failure;
use crate::estimate::Options;
use crate::measure::Eye;
use crate::observation::{EncoderReading, Measurement, Status};
use crate::record::{Checked, Experiment, Fault, View};
use crate::report::decimation::keeps;
use crate::robot::Model;
use crate::statistics::order::median;
use crate::verdict::{Code, JudgedEstimate, Level, Reason, Verdict};
use crate::{Error, Result};
use expected::{Expected, coverage, expected, poses_of};
use files::{files_with_remedies, frames_remedy, name_in, pictures, spelled_otherwise};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

/// Frames of a view that are measured. Convention: what takes a second or two, and shows all sweeps of an experiment.
const MEASURED: usize = 36;

/// Check whether an experiment is ready for a run: files, sizes, indices, clocks, wiring, coverage, and the σ of η and λ to expect
///
/// Takes seconds, writes only what `-o` asks for, and says what to do about each fault. Exit code 1 if a run could not begin.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop check fixtures/bending")]
pub struct Args {
    /// The experiment: a folder with an experiment.toml, or that file
    experiment: PathBuf,
    /// A folder for rig.jpg: the straight picture with what was seen on it, the sheet, its lines and the snake
    #[arg(short, long, value_name = "FOLDER")]
    output: Option<PathBuf>,
    #[command(flatten)]
    verdict: VerdictArgs,
}

/// One thing that was looked at.
#[derive(Debug, Serialize)]
struct Look {
    /// `files`, `sizes`, `tracker`, `indices`, `clocks`, `frames` or `coverage`.
    what: &'static str,
    /// What was found.
    text: String,
}

#[derive(Serialize)]
struct Summary {
    verdict: Verdict,
    looks: Vec<Look>,
    #[serde(skip_serializing_if = "Option::is_none")]
    expected: Option<Expected>,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        let experiment = Experiment::read(&self.experiment)?;
        let mut inspection = Inspection { folder: self.output.clone(), ..Inspection::default() };
        inspection.files(&experiment);
        let summary =
            if inspection.reasons.is_empty() { inspection.with_data(console, &experiment)? } else { inspection.end() };
        console.result(&summary, || summary.text());
        console.next(match summary.verdict.level {
            Level::DoNotUse => "follow the remedy of the first reason, then check again".to_owned(),
            Level::Good | Level::Look => format!("snakeloop run {} -o out", self.experiment.display()),
        });
        match summary
            .verdict
            .reasons
            .iter()
            .find(|reason| reason.code == Code::Files && reason.level == Level::DoNotUse)
        {
            Some(_) => Err(Failure::Work(Error::content(
                &experiment.path,
                "cannot be used as it stands; the verdict says why",
            ))),
            None => self.verdict.check(&summary.verdict),
        }
    }
}

/// What was found so far.
#[derive(Default)]
struct Inspection {
    /// Where rig.jpg is written, if anywhere.
    folder: Option<PathBuf>,
    looks: Vec<Look>,
    reasons: Vec<Reason>,
    expected: Option<Expected>,
}

impl Inspection {
    fn saw(&mut self, what: &'static str, text: impl Into<String>) {
        self.looks.push(Look { what, text: text.into() });
    }

    fn fault(&mut self, code: Code, level: Level, text: impl Into<String>, remedy: impl Into<String>) {
        self.reasons.push(Reason::new(code, level, text, remedy));
    }

    fn end(self) -> Summary {
        Summary { verdict: Verdict::of(self.reasons), looks: self.looks, expected: self.expected }
    }

    /// Whether every file that the experiment names is there.
    fn files(&mut self, experiment: &Experiment) {
        let mut named = vec![];
        for (path, remedy) in files_with_remedies(experiment) {
            let name = name_in(experiment, &path);
            if !path.exists() {
                let other = spelled_otherwise(&path);
                let remedy =
                    other.map_or(remedy, |other| format!("{other} is there: correct the name in experiment.toml"));
                self.fault(Code::Files, Level::DoNotUse, format!("{name} is not there"), remedy);
            } else if !named.contains(&name) {
                named.push(name);
            }
        }
        for error in experiment.bags().filter(|bag| bag.path().exists()).filter_map(|bag| bag.files().err()) {
            let remedy = "name an MCAP file, the folder of a split recording, or the list of its files";
            self.fault(Code::Files, Level::DoNotUse, error.to_string(), remedy);
        }
        for view in
            experiment.views.iter().filter(|view| view.frames.topic().is_none_or(|topic| topic.bag.files().is_ok()))
        {
            match view.open_frames(experiment.folder()) {
                Ok(source) => {
                    let count = source.count().ok().flatten().map_or("a video".to_owned(), |n| format!("{n} frames"));
                    named.push(format!("{count} of {}", view.name));
                }
                Err(error) => {
                    let remedy = frames_remedy(experiment, view, &error);
                    self.fault(Code::Files, Level::DoNotUse, error.to_string(), remedy);
                }
            }
        }
        self.saw("files", named.join(", "));
    }

    /// All that can be said once the files are there.
    fn with_data(mut self, console: &Console, experiment: &Experiment) -> Result<Summary> {
        let model = model_of(console, experiment)?;
        self.sizes(experiment);
        let Checked { rows: log, warnings } = match encoders_of(experiment, &model) {
            Ok(checked) => checked,
            Err(error) => {
                let remedy = "see \"Bring your own log\" and \"Use a tracker, or ROS 2 recordings\" in the book";
                self.fault(Code::Files, Level::DoNotUse, error.to_string(), remedy);
                return Ok(self.end());
            }
        };
        self.reasons.extend(reasons_of_files(experiment, &warnings)?);
        for warning in warnings.iter().filter(|warning| warning.fault == Fault::Row).take(3) {
            self.fault(
                Code::Files,
                Level::Look,
                warning.to_string(),
                "correct the row, or leave it: only its frame is lost",
            );
        }
        let trackers = self.trackers(console, experiment, &model, &log);
        let indices = self.indices(experiment, &trackers, &log)?;
        self.clocks(&log);
        let mut measurements = Vec::new();
        for view in &experiment.views {
            measurements.extend(self.measured(experiment, view, &model, &log)?);
        }
        measurements.extend(trackers.iter().flat_map(OpenTracker::rows));
        measurements.sort_by_key(|measurement| measurement.index);
        self.judge(experiment, &model, &measurements, &log, &indices)?;
        Ok(self.end())
    }

    /// Whether pictures are as large as the camera files say.
    fn sizes(&mut self, experiment: &Experiment) {
        for view in &experiment.views {
            let lens = match view.lens() {
                Ok(lens) => lens,
                Err(error) => {
                    let remedy =
                        "`snakeloop calibrate camera` writes a camera file, OpenCV's and ROS's are read as well";
                    self.fault(Code::Files, Level::DoNotUse, error.to_string(), remedy);
                    continue;
                }
            };
            let mut sizes = BTreeMap::<(u32, u32), (usize, String)>::new();
            for path in pictures(experiment, view) {
                if let Some(size) = picture_size_for(&path, &lens) {
                    let name = name_in(experiment, &path);
                    sizes.entry(size).or_insert((0, name)).0 += 1;
                }
            }
            let expected = (lens.width, lens.height);
            for ((width, height), (count, name)) in sizes.iter().filter(|(size, _)| **size != expected) {
                let text = format!(
                    "{count} pictures of view {} have {width}×{height} px ({name}), and the camera file says {}×{}",
                    view.name, lens.width, lens.height
                );
                let remedy = match (*height, *width) == expected {
                    true => {
                        "exchange the two numbers, if a list of NumPy or MATLAB gave the height first; else turn the frames as the camera was \
                             calibrated, or calibrate it as they are"
                    }
                    false => {
                        "calibrate the camera at the size of the frames, or take the frames at the size of the calibration; cropped or \
                              scaled pictures need a camera file of their own"
                    }
                };
                self.fault(Code::CameraLens, Level::DoNotUse, text, remedy);
            }
            let fitting = sizes.get(&expected).map_or(0, |(count, _)| *count);
            self.saw(
                "sizes",
                format!("{}: {fitting} pictures of {}×{} px, as the camera file", view.name, lens.width, lens.height),
            );
        }
    }

    /// The trackers whose poses can be registered, all of their poses measured.
    fn trackers(
        &mut self,
        console: &Console,
        experiment: &Experiment,
        model: &Model,
        log: &[EncoderReading],
    ) -> Vec<OpenTracker> {
        let mut trackers = Vec::new();
        for tracker in &experiment.trackers {
            match open_tracker(console, tracker, &model.robot, log) {
                Ok((tracker, remarks)) => {
                    self.saw("tracker", format!("{}: {}", tracker.name, remarks.join("; ")));
                    trackers.push(tracker);
                }
                Err(error) => {
                    let remedy = "see \"Use a tracker, or ROS 2 recordings\" in the book";
                    self.fault(Code::Files, Level::DoNotUse, error.to_string(), remedy);
                }
            }
        }
        trackers
    }

    /// Which frames and poses have a reading; gives their indices.
    fn indices(
        &mut self,
        experiment: &Experiment,
        trackers: &[OpenTracker],
        log: &[EncoderReading],
    ) -> Result<BTreeSet<u64>> {
        let read: BTreeSet<u64> = log.iter().map(|row| row.index).collect();
        let mut frames: BTreeSet<u64> = trackers.iter().flat_map(OpenTracker::indices).collect();
        // The unbent pose is there to register the base, and need not be one of the ride.
        for straight in experiment.trackers.iter().map(|tracker| tracker.straight).filter(|index| !read.contains(index))
        {
            frames.remove(&straight);
        }
        for view in &experiment.views {
            match view.open_frames(experiment.folder())? {
                FrameSource::Pictures(files) => frames.extend(files.iter().map(|file| file.index)),
                source => match source.count()? {
                    Some(count) => frames.extend(0..count as u64),
                    None => frames.extend(&read),
                },
            }
        }
        if experiment.encoders.is_none() {
            self.saw("indices", "no encoder log: angles can be measured (`snakeloop measure`), η and λ not learned");
            let remedy = "log the encoders, `index,time_s,q1_mm,q2_mm,q3_mm`, and name the file as `encoders` in experiment.toml";
            self.fault(Code::Files, Level::Look, "no encoder log is named", remedy);
            return Ok(BTreeSet::new());
        }
        let both: BTreeSet<u64> = frames.intersection(&read).copied().collect();
        self.saw(
            "indices",
            format!(
                "{} of {} frames and poses have a reading, of {} rows in the log",
                both.len(),
                frames.len(),
                read.len()
            ),
        );
        let without = frames.len() - both.len();
        if without > 0 && !both.is_empty() {
            let first = frames.difference(&read).next().copied().unwrap_or_default();
            let text = format!("{without} of {} frames have no reading, frame {first} first", frames.len());
            let remedy = "the index of a row is the number in its frame's file name; frames without a reading are measured, but nothing is learned from them";
            self.fault(Code::Files, Level::Look, text, remedy);
        }
        Ok(both)
    }

    fn clocks(&mut self, log: &[EncoderReading]) {
        let (Some(first), Some(last)) = (log.first(), log.last()) else { return };
        let mut steps: Vec<f64> = log.windows(2).map(|pair| pair[1].time_s - pair[0].time_s).collect();
        let step = if steps.is_empty() {
            String::new()
        } else {
            format!(", a row every {:.3} s (median)", median(&mut steps))
        };
        self.saw("clocks", format!("the log goes from {:.3} to {:.3} s{step}", first.time_s, last.time_s));
    }

    /// Some frames of a view, measured by the rig as its straight picture gives it.
    fn measured(
        &mut self,
        experiment: &Experiment,
        view: &View,
        model: &Model,
        log: &[EncoderReading],
    ) -> Result<Vec<Measurement>> {
        let Ok(lens) = view.lens() else { return Ok(Vec::new()) };
        let drawn = self.folder.as_ref().map(|folder| folder.join(rig_picture_name(view, experiment)));
        let rig = match rig_of(view, &lens, &model.robot, drawn.as_deref()) {
            Ok(rig) => rig,
            Err(error) => {
                self.reasons.push(rig_reason(&error));
                return Ok(Vec::new());
            }
        };
        self.reasons.extend(sheet_reason(&view.name, &rig));
        let eye = Eye::new(lens, rig, model.robot.clone());
        let source = view.open_frames(experiment.folder())?;
        let count = source.count()?.unwrap_or(MEASURED);
        let frames = source.frames()?.enumerate().filter(|(k, _)| keeps(*k, MEASURED, count)).take(MEASURED);
        let frames: Vec<_> = frames.map(|(_, frame)| frame).collect();
        let measurements: Vec<Result<Measurement>> = frames
            .into_par_iter()
            .map(|frame| {
                let (index, own_s) = (frame.index, frame.time_s);
                let found = eye.measure(&frame.read_for(eye.lens())?);
                let logged = || log.binary_search_by_key(&index, |row| row.index).ok().map(|row| log[row].time_s);
                let time_s = own_s.or_else(logged);
                Ok(found.row(index, time_s, Some(view.name.clone())))
            })
            .collect();
        let all = measurements.len();
        let (measurements, unreadable): (Vec<Measurement>, Vec<Error>) = parted(measurements);
        self.unreadable(view, all, &unreadable);
        let mut sigmas: Vec<f64> = measurements.iter().filter_map(|one| Some(one.measured?.sigma_theta)).collect();
        let (ok, length_px) = (sigmas.len(), eye.projection().straight_length_px());
        let sigma = if ok > 0 {
            format!(", σ of θ {:.2}° (median)", median(&mut sigmas).to_degrees())
        } else {
            String::new()
        };
        let seen =
            format!("{}: {ok} of {all} looked at were measured, the snake {length_px:.0} px long{sigma}", view.name);
        self.saw("frames", seen);
        if let Some(remark) = source.remark(eye.lens())? {
            self.saw("frames", format!("{}: {remark}", view.name));
        }
        if let Some(small) = eye.small_picture() {
            self.saw("frames", format!("{}: {small}", view.name));
        }
        Ok(measurements)
    }

    /// Frames that cannot be read, with the reason of the first.
    fn unreadable(&mut self, view: &View, all: usize, unreadable: &[Error]) {
        let Some(first) = unreadable.first() else { return };
        let level = if unreadable.len() == all { Level::DoNotUse } else { Level::Look };
        let count = unreadable.len();
        let text = format!("{count} of {all} frames looked at of view {} cannot be read: {first}", view.name);
        let (_, remedy) = Status::Unreadable.explained();
        self.fault(Code::Files, level, text, remedy);
    }

    /// The verdict on the sample, where the snake goes, and what a run would know.
    fn judge(
        &mut self,
        experiment: &Experiment,
        model: &Model,
        measurements: &[Measurement],
        log: &[EncoderReading],
        indices: &BTreeSet<u64>,
    ) -> Result<()> {
        if log.is_empty() && experiment.encoders.is_some() {
            let text = "no frame and no pose has an encoder reading: a run would learn nothing";
            let remedy =
                "see the reason beside it; each reading needs the index of its frame, or a time by the frames' clock";
            self.fault(Code::NothingToJudge, Level::DoNotUse, text, remedy);
        }
        if measurements.is_empty() || log.is_empty() {
            return Ok(());
        }
        let options = Options::default();
        let wiring = experiment.wiring(model.robot.backbone_count())?;
        let is_stated = unit_is_stated(Some(experiment));
        let JudgedEstimate { model: learned, verdict, .. } =
            JudgedEstimate::of(model, options, None, (measurements, log), is_stated, |model| {
                Ok(subject(model, experiment, wiring, options.sd_encoder_mm))
            })?;
        let wired_wrong = verdict.has(Code::Wiring) || verdict.has(Code::EncoderStuck);
        // Which frames have no reading was told of all of them.
        self.reasons.extend(verdict.reasons.into_iter().filter(|reason| reason.code != Code::Files));
        let poses = poses_of(&learned, log, indices);
        if !wired_wrong && !poses.is_empty() {
            self.saw("coverage", coverage(&poses));
            let measured = measurements.iter().filter(|measurement| measurement.measured.is_some()).count();
            // A tracker's poses are all measured: what they teach need not be predicted.
            self.expected = match learned.estimate() {
                Some(estimate) if measured >= poses.len() => Some(Expected::of(&estimate, measured)),
                _ => expected(&learned, options, measurements, &poses)?,
            };
        }
        Ok(())
    }
}

/// What could be measured, and why the rest could not be read.
fn parted(measurements: Vec<Result<Measurement>>) -> (Vec<Measurement>, Vec<Error>) {
    let (mut measured, mut unreadable) = (Vec::new(), Vec::new());
    for measurement in measurements {
        match measurement {
            Ok(measurement) => measured.push(measurement),
            Err(why) => unreadable.push(why),
        }
    }
    (measured, unreadable)
}

impl Summary {
    fn text(&self) -> String {
        let mut text = verdict_text(&self.verdict);
        for Look { what, text: found } in &self.looks {
            text += &format!("{what:<9} {found}\n");
        }
        if let Some(Expected { sd_eta, sd_lambda_mm, measurements }) = self.expected {
            text +=
                &format!("expected  η ± {sd_eta:.4}, λ ± {sd_lambda_mm:.4} mm after a run of {measurements} poses\n");
        }
        text
    }
}
