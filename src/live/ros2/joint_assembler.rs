//! Readings of all backbones from messages that may have one joint or all of them.
//!
//! By the rules for recordings: a message of other joints passes by; each joint is a series of its own, and where two messages say different
//! things of one moment neither is used. The moments of readings are those of the first joint; the others' positions there are interpolated.

use super::super::stream::SentReading;
use super::sole_publisher::{Heard, SolePublisher};
use crate::bag::messages::JointState;
use crate::record::Neighbouring;
use crate::robot::PerBackbone;
use rustdds::GUID;
use std::collections::{BTreeSet, VecDeque};
use std::time::Instant;

/// Positions kept of each joint while another lags behind. Convention: a resource limit, a second of the fastest bus.
const MAX_KEPT: usize = 1000;
/// A position further than this from the next is not interpolated to, s. Convention: as between the encoders' readings.
const MAX_GAP_S: f64 = 0.5;
/// A time earlier than the last by more than this comes from a clock that was set anew, s. Convention: as for the encoders' readings.
const CLOCK_SET_BACK_S: f64 = 0.25;
/// Messages after which a joint that none of them had is told. Convention: enough for drivers that send one joint a message.
const ENOUGH: u32 = 50;
/// Names of joints that such a sentence lists. Convention: a display choice.
const LISTED: usize = 12;

/// What a message gave.
#[derive(Debug, Default, PartialEq)]
pub struct Assembled {
    /// Readings, in order of their times.
    pub readings: Vec<SentReading>,
    /// What the user is to know.
    pub remarks: Vec<String>,
}

/// The positions that still wait for those of other joints.
#[derive(Debug)]
pub struct JointAssembler {
    topic: String,
    mm_per_unit: f64,
    joints: Vec<Joint>,
    /// Messages so far, and the other joints that they had.
    messages: u32,
    others: BTreeSet<String>,
}

#[derive(Debug)]
struct Joint {
    name: String,
    publisher: SolePublisher<GUID>,
    /// Times, s, and positions.
    series: VecDeque<(f64, f64)>,
    /// The latest of them, also where it is no longer waited with.
    last: Option<(f64, f64)>,
}

impl JointAssembler {
    /// Joints of a topic, one for each backbone.
    pub fn new(topic: &str, joints: &[String], mm_per_unit: f64) -> Self {
        let joint = |name: &String| Joint {
            name: name.clone(),
            publisher: SolePublisher::new(),
            series: VecDeque::new(),
            last: None,
        };
        let joints = joints.iter().map(joint).collect();
        Self { topic: topic.to_owned(), mm_per_unit, joints, messages: 0, others: BTreeSet::new() }
    }

    /// Takes a message of a publisher.
    pub fn take(&mut self, state: &JointState, publisher: GUID, now: Instant) -> Assembled {
        let mut assembled = Assembled::default();
        self.messages = self.messages.saturating_add(1);
        for (name, position) in state.names.iter().zip(&state.positions) {
            match self.joints.iter_mut().find(|joint| joint.name == *name) {
                Some(joint) => joint.take(&self.topic, state.stamp_s, *position, publisher, now, &mut assembled),
                None if self.others.len() < LISTED => drop(self.others.insert(name.clone())),
                None => {}
            }
        }
        if self.messages == ENOUGH {
            assembled.remarks.extend(self.missing());
        }
        while let Some(reading) = self.next() {
            assembled.readings.push(reading);
        }
        assembled
    }

    /// A joint that no message had so far.
    fn missing(&self) -> Option<String> {
        let missing = self.joints.iter().find(|joint| joint.last.is_none())?;
        let seen = self.joints.iter().filter(|joint| joint.last.is_some()).map(|joint| &joint.name);
        let known: Vec<&str> = seen.chain(&self.others).map(String::as_str).collect();
        Some(format!(
            "no joint {:?} with a position on {}; it has {}: name them by --joints",
            missing.name,
            self.topic,
            known.join(", ")
        ))
    }

    /// The reading of the first joint's earliest moment, once the others' positions there are known.
    fn next(&mut self) -> Option<SentReading> {
        loop {
            let (stamp_s, _) = *self.joints.first()?.series.front()?;
            if self.joints.iter().any(|joint| joint.series.back().is_none_or(|(last_s, _)| *last_s < stamp_s)) {
                return None;
            }
            let positions: Option<Vec<f64>> = self.joints.iter().map(|joint| joint.at(stamp_s)).collect();
            self.joints.iter_mut().for_each(|joint| joint.forget_before(stamp_s));
            self.joints[0].series.pop_front();
            if let Some(q_mm) = positions.as_deref().and_then(PerBackbone::of) {
                return Some(SentReading::Reading { stamp_s, q_mm: q_mm * self.mm_per_unit });
            }
        }
    }
}

impl Joint {
    fn take(
        &mut self,
        topic: &str,
        stamp_s: f64,
        position: f64,
        publisher: GUID,
        now: Instant,
        assembled: &mut Assembled,
    ) {
        let name = &self.name;
        match self.publisher.hear(publisher, now) {
            Heard::PassedOver => return,
            Heard::TakenOfTwo => assembled.remarks.push(format!(
                "two publishers send joint {name:?} on {topic}: that of the one that came first is taken, the other's passed over; end one of them"
            )),
            Heard::Taken => {}
        }
        let mut bad =
            |why: String| assembled.readings.push(SentReading::Bad(format!("joint {name:?} on {topic}: {why}")));
        if stamp_s == 0.0 || !stamp_s.is_finite() || !position.is_finite() {
            return bad(format!("position {position} at {stamp_s} s, expected numbers, and a header with its time"));
        }
        match self.last {
            Some((last_s, last)) if stamp_s == last_s && position == last => return,
            Some((last_s, _)) if stamp_s == last_s => {
                if self.series.back().is_some_and(|(kept_s, _)| *kept_s == stamp_s) {
                    self.series.pop_back();
                }
                let why = format!(
                    "{topic} says two things of joint {name:?} at one moment, as when two programs send it; neither is used"
                );
                return assembled.readings.push(SentReading::Contradicted { stamp_s, why });
            }
            Some((last_s, _)) if stamp_s < last_s && last_s - stamp_s < CLOCK_SET_BACK_S => {
                return bad(format!("time {stamp_s} is not after {last_s}"));
            }
            Some((last_s, _)) if stamp_s < last_s => self.series.clear(),
            _ => {}
        }
        self.last = Some((stamp_s, position));
        if self.series.len() == MAX_KEPT {
            self.series.pop_front();
        }
        self.series.push_back((stamp_s, position));
    }

    /// The position at a time, s, interpolated linearly between its neighbours.
    fn at(&self, time_s: f64) -> Option<f64> {
        let after = self.series.partition_point(|(stamp_s, _)| *stamp_s < time_s);
        let around = Neighbouring::of(after, |k| self.series.get(k).copied(), time_s)?;
        (around.gap_s() <= MAX_GAP_S).then(|| around.at(time_s))
    }

    /// Forgets what no later moment, s, needs.
    fn forget_before(&mut self, time_s: f64) {
        while self.series.get(1).is_some_and(|(stamp_s, _)| *stamp_s <= time_s) {
            self.series.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assembler(joints: &[&str]) -> JointAssembler {
        JointAssembler::new("/joint_states", &joints.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>(), 1000.0)
    }

    fn state(stamp_s: f64, joints: &[(&str, f64)]) -> JointState {
        let (names, positions) = joints.iter().map(|(name, position)| ((*name).to_owned(), *position)).unzip();
        JointState { stamp_s, names, positions }
    }

    fn reading(stamp_s: f64, q_mm: &[f64]) -> SentReading {
        SentReading::Reading { stamp_s, q_mm: PerBackbone::of(q_mm).unwrap() }
    }

    #[test]
    fn joints_of_one_message_are_a_reading_in_their_own_order_and_others_pass_by() {
        let mut joints = assembler(&["b1", "b2", "b3"]);
        let mut take = |state: &JointState| joints.take(state, GUID::GUID_UNKNOWN, Instant::now());
        let found = take(&state(5.0, &[("grip", 7.0), ("b3", 0.003), ("b1", 0.001), ("b2", 0.002)]));
        assert_eq!(found, Assembled { readings: vec![reading(5.0, &[1.0, 2.0, 3.0])], remarks: vec![] });
        assert_eq!(take(&state(5.1, &[("grip", 7.0)])), Assembled::default());
        // The same twice is once, and what contradicts is not used.
        assert_eq!(take(&state(5.0, &[("b1", 0.001), ("b2", 0.002), ("b3", 0.003)])), Assembled::default());
        let found = take(&state(5.0, &[("b2", 0.009)]));
        assert!(matches!(&found.readings[..], [SentReading::Contradicted { stamp_s: 5.0, .. }]), "{found:?}");
        let found = take(&state(4.9, &[("b1", 0.001)]));
        assert!(
            matches!(&found.readings[..], [SentReading::Bad(why)] if why.contains("4.9 is not after 5")),
            "{found:?}"
        );
        let found = take(&state(5.2, &[("b1", f64::NAN), ("b2", 0.0), ("b3", 0.0)]));
        assert!(matches!(&found.readings[..], [SentReading::Bad(why)] if why.contains("position NaN")), "{found:?}");
    }

    #[test]
    fn joints_with_a_message_each_meet_at_the_first_ones_moments() {
        let mut joints = assembler(&["b1", "b2"]);
        let mut found = Vec::new();
        for k in 0..5 {
            let t = f64::from(k) / 10.0 + 1.0;
            found.extend(joints.take(&state(t, &[("b1", t)]), GUID::GUID_UNKNOWN, Instant::now()).readings);
            found.extend(
                joints.take(&state(t + 0.05, &[("b2", 2.0 * t + 0.1)]), GUID::GUID_UNKNOWN, Instant::now()).readings,
            );
        }
        assert_eq!(found.len(), 4, "the first has no second joint before it: {found:?}");
        for found in found {
            let SentReading::Reading { stamp_s, q_mm } = found else { panic!("{found:?}") };
            assert!((q_mm[0] - 1000.0 * stamp_s).abs() < 1e-9 && (q_mm[1] - 2000.0 * stamp_s).abs() < 1e-9, "{q_mm:?}");
        }
    }

    #[test]
    fn a_joint_that_never_comes_and_two_publishers_of_one_are_told() {
        let mut joints = assembler(&["b1", "b4"]);
        let one = state(1.0, &[("b1", 0.0), ("grip", 0.0)]);
        let told: Vec<String> =
            (0..60).flat_map(|_| joints.take(&one, GUID::GUID_UNKNOWN, Instant::now()).remarks).collect();
        assert_eq!(told, ["no joint \"b4\" with a position on /joint_states; it has b1, grip: name them by --joints"]);
        let other = GUID::new_participant_guid();
        let mut take = |stamp_s, publisher| joints.take(&state(stamp_s, &[("b1", 0.0)]), publisher, Instant::now());
        assert_eq!(take(1.1, other), Assembled::default());
        let remarks = take(1.2, GUID::GUID_UNKNOWN).remarks;
        assert!(remarks[0].contains("two publishers send joint \"b1\""), "{remarks:?}");
    }
}
