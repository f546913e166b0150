//! Joints of a topic as readings of all backbones.

use super::super::stream::{Came, ReadingStream, SentReading};
use super::joint_assembler::JointAssembler;
use super::node::Node;
use super::subscription::Subscription;
use crate::bag::Stamped;
use crate::bag::messages::JointState;
use crate::error::Result;
use std::collections::VecDeque;
use std::time::Instant;

/// Messages that may wait for the thread that reads them. Convention: a tenth of a second of a bus of 1 kHz.
const DEPTH: i32 = 100;

/// The joints of a topic.
#[derive(Debug)]
pub struct Joints {
    subscription: Subscription,
    assembler: JointAssembler,
    /// What a message gave and was not handed on yet.
    came: VecDeque<Came<SentReading>>,
}

impl Joints {
    /// Subscribes to a topic for these joints, one for each backbone.
    ///
    /// # Errors
    /// A thread that cannot be set up.
    pub fn of(node: &Node, topic: &str, joints: &[String], mm_per_unit: f64) -> Result<Self> {
        let subscription = Subscription::new(node, topic, JointState::KINDS, DEPTH)?;
        let assembler = JointAssembler::new(topic, joints, mm_per_unit);
        Ok(Self { subscription, assembler, came: VecDeque::new() })
    }
}

impl ReadingStream for Joints {
    fn next(&mut self, goes_on: &dyn Fn() -> bool) -> Option<Came<SentReading>> {
        while self.came.is_empty() {
            match self.subscription.next(goes_on)? {
                Came::Remark(text) => return Some(Came::Remark(text)),
                Came::One(message) => match JointState::decoded(message.kind, &message.cdr) {
                    Ok(state) => {
                        let found = self.assembler.take(&state, message.publisher, Instant::now());
                        self.came.extend(found.remarks.into_iter().map(Came::Remark));
                        self.came.extend(found.readings.into_iter().map(Came::One));
                    }
                    Err(why) => {
                        let why = format!("{}: a message is no JointState: {why}", self.subscription.topic());
                        self.came.push_back(Came::Remark(why.clone()));
                        self.came.push_back(Came::One(SentReading::Bad(why)));
                    }
                },
            }
        }
        self.came.pop_front()
    }

    fn trouble(&self) -> String {
        self.subscription.trouble()
    }
}
