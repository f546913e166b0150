//! Encoder readings from a topic of `JointState`: the joints' positions at the times of frames or poses, interpolated between the two
//! messages around each.

use super::experiment::Experiment;
use super::source::JointTopic;
use crate::bag::messages::JointState;
use crate::bag::{Message, Topic};
use crate::error::{Error, Result};
use crate::observation::EncoderReading;
use crate::robot::PerBackbone;
use crate::statistics::order::median;

/// A gap between two messages that is not bridged, in units of the usual distance between them.
///
/// Convention: one lost message is bridged, more are not.
const LONGEST_GAP: f64 = 2.5;

impl Experiment {
    /// The times, s, at which a recording's joints are read, one an index from 0: those of the first view whose frames are in a recording, or
    /// of the first tracker whose poses are.
    ///
    /// # Errors
    /// An experiment without either, since picture files do not tell their times; a recording that cannot be read.
    pub fn stamps_s(&self) -> Result<Vec<f64>> {
        let of_view = self.views.iter().find_map(|view| view.frames.topic());
        let of_tracker = self.trackers.iter().find_map(|tracker| tracker.poses.topic());
        let Some(topic) = of_view.or(of_tracker) else {
            let message = "encoders are in a recording, and neither frames nor poses are: nothing tells when the frames were taken; \
                           give an encoders.csv with the readings of each frame's index";
            return Err(Error::content(&self.path, message));
        };
        let stamp = |message: Result<Message>| Ok(message?.stamp_s().unwrap_or(f64::NAN));
        topic.messages()?.map(stamp).collect()
    }
}

/// The readings of a robot of so many backbones at these times, one an index from 0. A time before the first message, after the last,
/// or in a gap between them has none.
///
/// # Errors
/// A recording that cannot be read, has no such topic or joint; as many joints as the robot has no backbones; a unit that is not positive.
pub fn read_joints(joints: &JointTopic, stamps_s: &[f64], backbones: usize) -> Result<Vec<EncoderReading>> {
    let (topic, unit) = (joints.topic(), joints.mm_per_unit);
    if joints.joints.len() != backbones {
        let message = format!("joints = {:?}, expected {backbones}, one for each backbone", joints.joints);
        return Err(topic.error(message));
    }
    if !(unit.is_finite() && unit > 0.0) {
        return Err(topic.error(format!("mm_per_unit = {unit}, expected more than 0 (1000 for joints in m)")));
    }
    let states: Vec<JointState> = topic.all()?;
    let mut log = states.iter().map(|state| row(&topic, joints, state)).collect::<Result<Vec<_>>>()?;
    log.sort_by(|(one, _), (other, _)| one.total_cmp(other));
    let mut steps: Vec<f64> = log.windows(2).map(|pair| pair[1].0 - pair[0].0).filter(|step| *step > 0.0).collect();
    let longest_s = if steps.is_empty() { 0.0 } else { LONGEST_GAP * median(&mut steps) };
    let reading = |(index, &time_s): (usize, &f64)| {
        let q_mm = interpolated(&log, time_s, longest_s)? * unit;
        Some(EncoderReading::new(index as u64, time_s, q_mm))
    };
    Ok(stamps_s.iter().enumerate().filter_map(reading).collect())
}

/// Time and positions of the named joints, in their order.
fn row(topic: &Topic, joints: &JointTopic, state: &JointState) -> Result<(f64, PerBackbone)> {
    let mut positions = PerBackbone::repeat(joints.joints.len(), 0.0);
    for (position, name) in positions.iter_mut().zip(&joints.joints) {
        let place = state.names.iter().position(|known| known == name);
        let found = place.and_then(|place| state.positions.get(place));
        let missing = || topic.error(format!("no joint {name:?}; it has {}", state.names.join(", ")));
        *position = *found.ok_or_else(missing)?;
    }
    Ok((state.stamp_s, positions))
}

/// The positions at a time, on the line between the messages around it.
fn interpolated(log: &[(f64, PerBackbone)], time_s: f64, longest_s: f64) -> Option<PerBackbone> {
    let after = log.partition_point(|(stamp_s, _)| *stamp_s < time_s);
    let (later_s, later) = log.get(after)?;
    if *later_s == time_s {
        return Some(*later);
    }
    let (earlier_s, earlier) = log.get(after.checked_sub(1)?)?;
    let share = (time_s - earlier_s) / (later_s - earlier_s);
    (later_s - earlier_s <= longest_s).then(|| *earlier * (1.0 - share) + *later * share)
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
    fn joints_are_read_by_name_between_messages() {
        // The positions of b1, b2, b3 are 1, 2, 3 mm times the message's number; one message every 0.2 s.
        let stamps_s = [-0.1, 0.0, 0.1, 0.35, 0.6, 0.7].map(|s| 1.7e9 + s);
        let readings = read_joints(&joints(&["b1", "b2", "b3"], 1000.0), &stamps_s, 3).unwrap();
        assert_eq!(
            readings.iter().map(|reading| reading.index).collect::<Vec<_>>(),
            [1, 2, 3, 4],
            "none outside the log"
        );
        for (reading, messages) in readings.iter().zip([0.0, 0.5, 1.75, 3.0]) {
            for (i, q) in reading.q_mm.iter().enumerate() {
                assert!((q - (i + 1) as f64 * messages).abs() < 1e-5, "{reading:?}");
            }
        }
        for (topic, expected) in [
            (joints(&["b1", "b2"], 1000.0), "expected 3, one for each backbone"),
            (joints(&["b1", "b2", "b4"], 1000.0), "no joint \"b4\"; it has b3, b1, b2, grip"),
            (joints(&["b1", "b2", "b3"], 0.0), "mm_per_unit = 0, expected more than 0"),
        ] {
            let message = read_joints(&topic, &stamps_s, 3).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn a_gap_in_the_log_is_not_bridged() {
        let at = |time_s: f64| (time_s, PerBackbone::repeat(3, time_s));
        let log = [at(0.0), at(0.1), at(0.5)];
        assert_eq!(interpolated(&log, 0.05, 0.25).unwrap()[0], 0.05);
        assert_eq!((interpolated(&log, 0.3, 0.25), interpolated(&log, 0.6, 0.25)), (None, None));
        assert_eq!(interpolated(&log, 0.5, 0.25).unwrap()[0], 0.5);
    }
}
