//! The trackers of an experiment, measured: their poses take part like a view's frames.

use super::console::Console;
use super::inputs::rows;
use crate::measure::{FrameMeasurement, TrackedPoses, TrackerOptions, measure_poses};
use crate::observation::{EncoderReading, Measurement};
use crate::record::{Experiment, Source, Tracker, read_tracker_poses, tracker_poses_of};
use crate::robot::Robot;
use crate::{Error, Result};

/// A tracker whose poses are measured.
pub struct OpenTracker {
    /// The tracker's name.
    pub name: String,
    /// For each pose its index, time in s, and measurement; in order of the index.
    pub measurements: Vec<(u64, f64, FrameMeasurement)>,
}

impl OpenTracker {
    /// The indices of its poses, in order.
    pub fn indices(&self) -> Box<dyn Iterator<Item = u64> + Send + '_> {
        Box::new(self.measurements.iter().map(|(index, _, _)| *index))
    }

    /// Its poses as rows of measurements.
    pub fn rows(&self) -> impl Iterator<Item = Measurement> + '_ {
        let row = |(index, time_s, found): &(u64, f64, FrameMeasurement)| {
            found.clone().row(*index, Some(*time_s), Some(self.name.clone()))
        };
        self.measurements.iter().map(row)
    }

    /// Its pose of an index: the tracker, the time in s and the measurement.
    pub fn at(&self, index: u64) -> Option<(&Self, f64, &FrameMeasurement)> {
        let place = self.measurements.binary_search_by_key(&index, |(index, _, _)| *index).ok()?;
        let (_, time_s, measurement) = &self.measurements[place];
        Some((self, *time_s, measurement))
    }
}

/// Reads and measures the poses of every tracker, and says what came of it.
///
/// # Errors
/// A file that cannot be read, poses that cannot be registered.
pub fn open_trackers(
    console: &Console,
    experiment: &Experiment,
    robot: &Robot,
    encoders: &[EncoderReading],
) -> Result<Vec<OpenTracker>> {
    let mut trackers = Vec::new();
    for tracker in &experiment.trackers {
        let (tracker, remarks) = open_tracker(console, tracker, robot, encoders)?;
        for remark in remarks {
            console.say(format!("tracker {}: {remark}", tracker.name));
        }
        trackers.push(tracker);
    }
    Ok(trackers)
}

/// Reads and measures the poses of one tracker, with what is to be said of them, in sentences.
///
/// # Errors
/// As [`open_trackers`].
pub fn open_tracker(
    console: &Console,
    tracker: &Tracker,
    robot: &Robot,
    encoders: &[EncoderReading],
) -> Result<(OpenTracker, Vec<String>)> {
    let Tracker { name, poses: source, straight, delta_offset_deg, base_mm } = tracker;
    let poses = rows(
        console,
        match source {
            Source::Files(path) => read_tracker_poses(path)?,
            Source::Topic(topic) => tracker_poses_of(topic)?,
        },
    );
    let options = TrackerOptions {
        straight: *straight,
        delta_offset: delta_offset_deg.map(f64::to_radians),
        base_mm: base_mm.map(Into::into),
    };
    let tracked = measure_poses(&poses, encoders, robot, &options);
    let TrackedPoses { measurements, remarks } =
        tracked.map_err(|why| Error::content(source.path(), why.to_string()))?;
    Ok((OpenTracker { name: name.clone(), measurements }, remarks))
}
