//! A run as one ROS 2 recording (MCAP), to be looked at beside the robot's own, or to be read again.
//!
//! | topic | one message |
//! | --- | --- |
//! | `/measurement`, `/estimate`, `/stem`, `/force` | a row of measurements.csv, estimate.csv, stem.csv, force.csv as `snakeloop_msgs/msg/Measurement` and so on: the columns as fields behind a header, in their order; an empty number is NaN |
//! | `/encoders` | a row of encoders.csv as `sensor_msgs/msg/JointState`, a joint a backbone, in m |
//! | `/camera/NAME/compressed` | a frame of that view as it is on the disk, as `sensor_msgs/msg/CompressedImage` |
//!
//! The definitions of all types stand in the file, so that a reader needs no package of them. Times and stamps are the rows' own `time_s`.
//! All tables are gone through at once, row by row, so that messages come in order of time and memory does not grow with the rows.

mod camera;
mod recorder;
mod table;
#[cfg(test)]
mod tests;

use super::table::Warning;
use super::{EncoderLog, Experiment};
use crate::error::{Error, Result};
use camera::Camera;
use recorder::Recorder;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use table::Table;

/// The tables that a run's folder may have, measurements first: to them frames belong.
const TABLES: [&str; 5] = ["measurement", "estimate", "encoders", "stem", "force"];

/// What a recording holds.
#[derive(Debug, Default, Serialize)]
pub struct Recorded {
    /// How many messages each topic has.
    pub messages: BTreeMap<String, u64>,
    /// What was left out, and why.
    #[serde(skip)]
    pub remarks: Vec<String>,
}

/// Writes the run in a folder as an MCAP file: its tables, and with its experiment the encoder log (where the folder has none) and
/// those frames that are still there.
///
/// # Errors
/// A folder without measurements.csv, a table without a column of times or indices or with a line too long, rows that all lack their
/// time; a file that cannot be written.
pub fn write_recording(path: &Path, folder: &Path, experiment: Option<&Experiment>) -> Result<Recorded> {
    let mut recorder = Recorder::create(path)?;
    let mut recorded = Recorded::default();
    let paths: Vec<(&str, PathBuf)> =
        TABLES.iter().filter_map(|&name| Some((name, place(name, folder, experiment)?))).collect();
    let mut tables: Vec<Table> =
        paths.iter().map(|(name, path)| Table::open(name, path, &mut recorder)).collect::<Result<_>>()?;
    let mut cameras = Vec::new();
    for view in experiment.into_iter().flat_map(|experiment| &experiment.views) {
        match Camera::open(view, experiment.map_or(folder, Experiment::folder), &mut recorder)? {
            Ok(camera) => cameras.push(camera),
            Err(why) => recorded.remarks.push(format!("view {}: {why}; its frames are left out", view.name)),
        }
    }
    while let Some(first) = (0..tables.len()).filter(|&i| tables[i].next.is_some()).min_by_key(|&i| tables[i].time_ns())
    {
        let Some(row) = tables[first].take()? else { break };
        if first == 0 {
            for camera in &mut cameras {
                camera.write(row.index, row.time_ns, &mut recorder)?;
            }
        }
        recorder.write(tables[first].channel, row.time_ns, &row.cdr)?;
    }
    for (topic, channel) in tables.iter().map(Table::topic).chain(cameras.iter().map(Camera::topic)) {
        recorded.messages.insert(topic, recorder.messages(channel));
    }
    if recorded.messages.values().all(|&messages| messages == 0) {
        let message = "no row has a time, and a recording is ordered by time; measure with an encoder log, or a video";
        return Err(Error::content(&folder.join("measurements.csv"), message));
    }
    recorder.finish()?;
    for table in tables {
        recorded.remarks.extend(table.warnings.in_order().iter().map(Warning::to_string));
    }
    for camera in cameras.iter().filter(|camera| camera.missed > 0) {
        let (topic, _) = camera.topic();
        recorded.remarks.push(format!("{topic}: {} frames are gone, or neither PNG nor JPEG", camera.missed));
    }
    Ok(recorded)
}

/// Where a table stands; measurements must be there.
fn place(name: &str, folder: &Path, experiment: Option<&Experiment>) -> Option<PathBuf> {
    let plural = if name == "measurement" { "measurements" } else { name };
    let path = folder.join(format!("{plural}.csv"));
    let log = || match experiment?.encoders.as_ref()? {
        EncoderLog::File(path) => Some(path.clone()),
        EncoderLog::Joints(_) => None,
    };
    let elsewhere = || log().filter(|_| name == "encoders");
    if name == "measurement" || path.exists() { Some(path) } else { elsewhere() }
}
