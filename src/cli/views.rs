//! The views of an experiment, made ready to measure, and the measuring itself.

use super::console::Console;
use crate::camera::{Frame, FrameSource, Lens, SourceFrame, read_frame};
use crate::geometry::Configuration;
use crate::measure::{Explanation, Eye, Rig, RigOptions, Sighting, calibrate_rig, fused};
use crate::record::{EncoderReading, Experiment, Measurement, RigSource, Status, View};
use crate::report::overlay::Shape;
use crate::robot::Robot;
use crate::{Error, Result};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// One view: where its frames are and the eye that measures them.
pub struct OpenView {
    name: String,
    eye: Eye,
    frames: FrameSource,
}

/// How long measuring took, and what for.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Throughput {
    /// Wall time, s.
    pub seconds: f64,
    /// Frames per second of wall time, end to end.
    pub frames_per_second: f64,
    /// Share of the computing time that reading and decoding the pictures took, 0 to 1.
    pub decoding_share: f64,
}

/// Reads cameras and rigs and finds the frames of every view; calibrates rigs that are given by a straight picture.
pub fn open_views(experiment: &Experiment, robot: &Robot) -> Result<Vec<OpenView>> {
    experiment.views.iter().map(|view| OpenView::open(view, experiment, robot)).collect()
}

/// The rig of a view: from its file, or calibrated from its straight picture.
pub fn rig_of(view: &View, lens: &Lens, robot: &Robot) -> Result<Rig> {
    let delta_offset = view.delta_offset_deg.to_radians();
    match &view.rig {
        RigSource::File(path) => Ok(Rig::read(path)?.looking_from(delta_offset)),
        RigSource::Straight { picture, grid_pitch_mm, standoff_mm } => {
            let options = RigOptions { grid_pitch_mm: *grid_pitch_mm, standoff_mm: *standoff_mm, delta_offset };
            calibrate_rig(&read_frame(picture)?, lens, robot, &options)
                .map_err(|message| Error::Rig { path: picture.clone(), message })
        }
    }
}

impl OpenView {
    fn open(view: &View, experiment: &Experiment, robot: &Robot) -> Result<Self> {
        let frames = FrameSource::open(experiment.folder(), &view.frames)?;
        let lens = Lens::read(&view.camera)?;
        let rig = rig_of(view, &lens, robot)?;
        let eye = Eye::new(lens, rig, robot.clone()).refined(sample(&frames)?);
        Ok(Self { name: view.name.clone(), eye, frames })
    }

    /// The frames whose index is wanted, once more, for a person to look at.
    ///
    /// # Errors
    /// A video that cannot be opened any more.
    pub fn frames(&self, wanted: impl Fn(u64) -> bool + Send) -> Result<impl ParallelIterator<Item = SourceFrame>> {
        Ok(self.frames.frames()?.filter(move |frame| wanted(frame.index)).par_bridge())
    }

    /// The view's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The model's shape in this view's picture.
    pub fn shape(&self, psi: Configuration) -> Shape {
        Shape::of(&self.eye.projection(), psi)
    }

    /// Measures one frame and tells every stage of it.
    pub fn explain(&self, frame: &Frame) -> Explanation {
        self.eye.explain(frame)
    }

    /// Measures one frame, and adds up how long reading and measuring took.
    fn measure(&self, source: SourceFrame, reading: &Clock, measuring: &Clock) -> Seen<'_> {
        let (index, time_s) = (source.index, source.time_s);
        let sighting = match reading.time(|| source.read()) {
            Ok(frame) => measuring.time(|| self.eye.measure(&frame)),
            Err(_) => without_angles(Status::Unreadable),
        };
        Seen { index, time_s, view: &self.name, sighting }
    }

    /// Measures frames in order with an eye that goes with its camera: where the camera is, is found frame by frame; the
    /// measuring itself is done in parallel.
    fn follow(
        &self,
        frames: impl Iterator<Item = SourceFrame>,
        reading: &Clock,
        measuring: &Clock,
        done: impl Fn() + Sync,
    ) -> Vec<Seen<'_>> {
        let at_once = 4 * rayon::current_num_threads();
        let mut eye = self.eye.clone();
        let mut frames = frames.peekable();
        let mut seen = Vec::new();
        while frames.peek().is_some() {
            let mut batch = Vec::new();
            for source in frames.by_ref().take(at_once) {
                let (index, time_s) = (source.index, source.time_s);
                let found = match reading.time(|| source.read()) {
                    Err(_) => Err(Status::Unreadable),
                    Ok(frame) => measuring.time(|| eye.following(&frame)).map(|there| (there, frame)),
                };
                if let Ok((there, _)) = &found {
                    eye = there.clone();
                }
                batch.push((index, time_s, found));
            }
            let measure = |(index, time_s, found)| {
                let sighting = match found {
                    Ok((eye, frame)) => measuring.time(|| Eye::measure(&eye, &frame)),
                    Err(status) => without_angles(status),
                };
                done();
                Seen { index, time_s, view: &self.name, sighting }
            };
            seen.par_extend(batch.into_par_iter().map(measure));
        }
        seen
    }
}

fn without_angles(status: Status) -> Sighting {
    Sighting { status, measured: None, bend: None, quality: None }
}

/// One view's part of a measurement.
struct Seen<'a> {
    index: u64,
    time_s: Option<f64>,
    view: &'a str,
    sighting: Sighting,
}

/// The row of one index from what its views saw.
fn row(seen: &[Seen], times: &HashMap<u64, f64>) -> Option<Measurement> {
    let index = seen.first()?.index;
    let sightings: Vec<Sighting> = seen.iter().map(|s| s.sighting.clone()).collect();
    let Sighting { status, measured, quality, .. } = fused(&sightings);
    let answered = |s: &&Seen| measured.is_none() || s.sighting.measured.is_some();
    let names: Vec<&str> = seen.iter().filter(answered).map(|s| s.view).collect();
    let time_s = seen.iter().find_map(|s| s.time_s).or_else(|| times.get(&index).copied());
    Some(Measurement { index, time_s, status, measured, quality, view: Some(names.join("+")) })
}

/// Frames from which a view's rig is refined: enough to see the snake bent to all sides.
const REFINING: usize = 24;

/// Frames spread over a sequence; what cannot be read is left out.
fn sample(source: &FrameSource) -> Result<impl ParallelIterator<Item = Frame>> {
    let count = source.count()?.unwrap_or(REFINING);
    let wanted = |i: usize| count <= REFINING || (i + 1) * REFINING / count > i * REFINING / count;
    // In order, so that sums over them are the same in every run.
    let frames = source.frames()?.enumerate();
    let chosen: Vec<_> = frames.filter(|(i, _)| wanted(*i)).map(|(_, frame)| frame).take(REFINING).collect();
    Ok(chosen.into_par_iter().filter_map(|frame| frame.read().ok()))
}

/// Measures every frame of every view in parallel: one row an index, in order; what several views saw under the same index
/// is put together.
///
/// A frame has the time that its source or else the encoder log tells. With `follow` a camera that moves is followed from
/// frame to frame.
///
/// # Errors
/// A video that cannot be opened any more.
pub fn measure_frames(
    console: &Console,
    views: &[OpenView],
    encoders: &[EncoderReading],
    follow: bool,
) -> Result<(Vec<Measurement>, Throughput)> {
    let times: HashMap<u64, f64> = encoders.iter().map(|reading| (reading.index, reading.time_s)).collect();
    let (reading, measuring) = (Clock::default(), Clock::default());
    let start = Instant::now();
    let mut seen: Vec<Seen> = Vec::new();
    for view in views {
        let bar = console.progress(view.frames.count()?, "measuring");
        let frames = Timed { frames: view.frames.frames()?, clock: &reading };
        let measure = |frame| {
            let seen = view.measure(frame, &reading, &measuring);
            bar.inc(1);
            seen
        };
        let mut of_view: Vec<Seen> = if follow {
            view.follow(frames, &reading, &measuring, || bar.inc(1))
        } else {
            frames.par_bridge().map(measure).collect()
        };
        bar.finish_and_clear();
        of_view.sort_by_key(|seen| seen.index);
        seen.append(&mut of_view);
    }
    // Stable: under one index the views keep their order.
    seen.sort_by_key(|seen| seen.index);
    let seconds = start.elapsed().as_secs_f64();
    let throughput = Throughput {
        seconds,
        frames_per_second: seen.len() as f64 / seconds,
        decoding_share: reading.seconds() / (reading.seconds() + measuring.seconds()),
    };
    let rows = seen.chunk_by(|a, b| a.index == b.index).filter_map(|seen| row(seen, &times));
    Ok((rows.collect(), throughput))
}

/// Frames whose decoding by the iterator itself, as a video's is, counts as reading.
struct Timed<'a, I> {
    frames: I,
    clock: &'a Clock,
}

impl<I: Iterator> Iterator for Timed<'_, I> {
    type Item = I::Item;

    fn next(&mut self) -> Option<I::Item> {
        self.clock.time(|| self.frames.next())
    }
}

/// How many frames ended with each status, `ok` among them.
pub fn count_by_status(measurements: &[Measurement]) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    for measurement in measurements {
        *counts.entry(measurement.status.to_string()).or_default() += 1;
    }
    counts
}

/// An error where not a single frame has angles.
pub fn require_some_measured(experiment: &Experiment, measurements: &[Measurement]) -> Result<()> {
    if measurements.iter().any(|measurement| measurement.measured.is_some()) {
        return Ok(());
    }
    let counts = count_by_status(measurements);
    let reasons: Vec<_> = counts.iter().map(|(status, count)| format!("{status} {count}")).collect();
    let message = format!(
        "none of the {} frames could be measured ({}); look at one beside the straight picture: same camera, same place?",
        measurements.len(),
        reasons.join(", ")
    );
    Err(Error::content(&experiment.path, message))
}

/// Adds up time over threads.
#[derive(Default)]
struct Clock {
    nanoseconds: AtomicU64,
}

impl Clock {
    fn time<T>(&self, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = work();
        let nanoseconds = u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX);
        self.nanoseconds.fetch_add(nanoseconds, Ordering::Relaxed);
        result
    }

    fn seconds(&self) -> f64 {
        Duration::from_nanos(self.nanoseconds.load(Ordering::Relaxed)).as_secs_f64()
    }
}
