//! Encoder readings from a topic of `JointState`: the joints' positions at the times of frames or poses.
//!
//! Each joint is a series of its own, so that a message may have one joint or all of them, and messages of other joints pass by.

use super::experiment::Experiment;
use super::interpolation::Matched;
use super::source::JointTopic;
use super::table::{Fault, Warning};
use crate::bag::messages::JointState;
use crate::bag::{Message, Topic};
use crate::error::{Error, Result};
use std::collections::BTreeSet;

impl Experiment {
    /// The times, s, at which readings are taken from a recording or a log without indices, each with its index: those of the first view whose
    /// frames tell them, or of the first tracker.
    ///
    /// # Errors
    /// An experiment in which nothing tells times: picture files do where stamps are their names; a recording that cannot be read.
    pub fn stamps_s(&self) -> Result<Vec<(u64, f64)>> {
        let of_topic = |topic: &Topic| -> Result<Vec<(u64, f64)>> {
            let stamp =
                |(index, message): (u64, Result<Message>)| Some((index, message.ok()?.stamp_s().unwrap_or(f64::NAN)));
            Ok((0..).zip(topic.messages()?).filter_map(stamp).collect())
        };
        if let Some(topic) = self.views.iter().find_map(|view| view.frames.topic()) {
            return of_topic(topic);
        }
        for view in &self.views {
            let source = view.open_frames(self.folder())?;
            let stamps: Vec<(u64, f64)> =
                source.frames()?.map_while(|frame| Some((frame.index, frame.time_s?))).collect();
            if !stamps.is_empty() {
                return Ok(stamps);
            }
        }
        if let Some(topic) = self.trackers.iter().find_map(|tracker| tracker.poses.topic()) {
            return of_topic(topic);
        }
        if let Some(tracker) = self.trackers.first() {
            let poses = super::read_tracker_poses(tracker.poses.path())?.rows;
            return Ok(poses.iter().map(|pose| (pose.index, pose.time_s)).collect());
        }
        let message = "the encoder readings are to be matched by time, but nothing says when the frames were taken: give an encoders.csv \
                       with each frame's index (under [log] `index` names its column), a video or a recording, or name the pictures by \
                       their stamps (frame_1738133057.457880.png)";
        Err(Error::content(&self.path, message))
    }
}

/// The readings of a robot of so many backbones at these times, each with its index, and what kept others from it. A time before the first
/// message, after the last, or in a gap that the motion does not let be bridged has none.
///
/// # Errors
/// A recording that cannot be read, has no such topic or joint; as many joints as the robot has no backbones; a unit that is not positive.
pub fn read_joints(joints: &JointTopic, stamps_s: &[(u64, f64)], backbones: usize) -> Result<Matched> {
    let (topic, unit) = (joints.topic(), joints.mm_per_unit);
    if joints.joints.len() != backbones {
        let message = format!("joints = {:?}, expected {backbones}, one for each backbone", joints.joints);
        return Err(topic.error(message));
    }
    if !(unit.is_finite() && unit > 0.0) {
        return Err(topic.error(format!("mm_per_unit = {unit}, expected more than 0 (1000 for joints in m)")));
    }
    let (states, faults) = topic.all::<JointState>()?;
    let series = joints.joints.iter().map(|name| series(&topic, (name, unit), &states)).collect::<Result<Vec<_>>>()?;
    let path = topic.bag.path();
    let mut matched = Matched::of_series(path, &topic.topic, series, stamps_s);
    let damage = |message: String| Warning { path: path.to_owned(), line: None, message, fault: Fault::Damage };
    matched.warnings.extend(faults.into_iter().map(damage));
    Ok(matched)
}

/// Times and positions, mm, of one joint, which sends so many mm as one.
fn series(topic: &Topic, (name, mm): (&str, f64), states: &[JointState]) -> Result<Vec<(f64, f64)>> {
    let position = |state: &JointState| {
        let place = state.names.iter().position(|known| known == name)?;
        Some((state.stamp_s, mm * state.positions.get(place)?))
    };
    let found: Vec<(f64, f64)> = states.iter().filter_map(position).collect();
    if found.is_empty() {
        let known: BTreeSet<&str> = states.iter().flat_map(|state| &state.names).map(String::as_str).collect();
        let known: Vec<&str> = known.into_iter().collect();
        return Err(topic.error(format!("no joint {name:?} with a position; it has {}", known.join(", "))));
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joints(names: &[&str], mm_per_unit: f64) -> JointTopic {
        let names = names.iter().map(|name| format!("{name:?}")).collect::<Vec<_>>().join(", ");
        let text = format!(
            "bag = \"tests/golden/ros2.mcap\"\ntopic = \"/joint_states\"\njoints = [{names}]\nmm_per_unit = {mm_per_unit:?}\n"
        );
        toml::from_str(&text).unwrap()
    }

    #[test]
    fn joints_are_read_by_name_at_the_times_of_messages() {
        // The positions of b1, b2, b3 are 1, 2, 3 mm times the message's number; one message every 0.2 s.
        let stamps_s: Vec<(u64, f64)> = (0..).zip([-0.1, 0.0, 0.2, 0.6, 0.7].map(|s| 1.7e9 + s)).collect();
        let readings = read_joints(&joints(&["b1", "b2", "b3"], 1000.0), &stamps_s, 3).unwrap().readings;
        assert_eq!(readings.iter().map(|reading| reading.index).collect::<Vec<_>>(), [1, 2, 3], "none outside the log");
        for (reading, messages) in readings.iter().zip([0.0, 1.0, 3.0]) {
            for (i, q) in reading.q_mm.iter().enumerate() {
                assert!((q - (i + 1) as f64 * messages).abs() < 1e-5, "{reading:?}");
            }
        }
        for (topic, expected) in [
            (joints(&["b1", "b2"], 1000.0), "expected 3, one for each backbone"),
            (joints(&["b1", "b2", "b4"], 1000.0), "no joint \"b4\" with a position; it has b1, b2, b3, grip"),
            (joints(&["b1", "b2", "b3"], 0.0), "mm_per_unit = 0, expected more than 0"),
        ] {
            let message = read_joints(&topic, &stamps_s, 3).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}
