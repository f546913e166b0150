//! The messages of one topic, waited for, and what is wrong with who publishes it.

use super::super::encoders::SILENCE;
use super::super::stream::Came;
use super::node::{Node, Reader};
use crate::error::{Error, Result};
use futures_util::StreamExt;
use rustdds::GUID;
use rustdds::dds::ReadError;
use std::fmt;
use std::time::{Duration, Instant};
use tokio::runtime::{Builder, Runtime};
use tokio::time::timeout;

/// Time between two looks at whether to go on, and at who publishes before anybody does. Convention: a timeout.
const POLL: Duration = Duration::from_millis(100);

/// A topic whose type is known once somebody publishes it.
pub struct Subscription {
    node: Node,
    topic: String,
    /// The types that can be read.
    kinds: &'static [&'static str],
    /// Messages that may wait.
    depth: i32,
    /// The reader, and the type that it reads.
    reader: Option<(Reader, &'static str)>,
    runtime: Runtime,
    /// Types that were told of as not to be read.
    told: Vec<String>,
}

impl fmt::Debug for Subscription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Subscription").field("topic", &self.topic).field("kinds", &self.kinds).finish_non_exhaustive()
    }
}

/// A message as it came.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    /// Its type.
    pub kind: &'static str,
    /// Its bytes.
    pub cdr: Vec<u8>,
    /// Who published it.
    pub publisher: GUID,
    /// Its number among those of this publisher.
    pub number: i64,
}

impl Subscription {
    /// Subscribes to a topic of one of these types.
    ///
    /// # Errors
    /// A thread that cannot be set up.
    pub fn new(node: &Node, topic: &str, kinds: &'static [&'static str], depth: i32) -> Result<Self> {
        let wrong =
            |e: std::io::Error| Error::Unavailable { what: format!("ROS 2, topic {topic}"), message: e.to_string() };
        let runtime = Builder::new_current_thread().enable_time().build().map_err(wrong)?;
        let (node, topic) = (node.clone(), topic.to_owned());
        Ok(Self { node, topic, kinds, depth, reader: None, runtime, told: Vec::new() })
    }

    /// The topic's name.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// The next message, waited for while `goes_on` says so; `None` where none came for two seconds.
    pub fn next(&mut self, goes_on: &dyn Fn() -> bool) -> Option<Came<Message>> {
        let began = Instant::now();
        while goes_on() && began.elapsed() < SILENCE {
            if let Some(remark) = self.look() {
                return Some(Came::Remark(remark));
            }
            let Some((reader, kind)) = &self.reader else {
                std::thread::sleep(POLL);
                continue;
            };
            let mut messages = Box::pin(reader.as_async_stream());
            match self.runtime.block_on(async { timeout(POLL, messages.next()).await }) {
                Err(_) => {}
                Ok(None) => return None,
                Ok(Some(Err(ReadError::Deserialization { reason }))) => {
                    return Some(Came::Remark(format!("{}: a message cannot be read: {reason}", self.topic)));
                }
                Ok(Some(Err(error))) => return Some(Came::Remark(format!("{}: {error}", self.topic))),
                Ok(Some(Ok(message))) => {
                    let (publisher, number) = (message.writer_guid(), i64::from(message.sequence_number));
                    return Some(Came::One(Message { kind, cdr: message.into_value(), publisher, number }));
                }
            }
        }
        None
    }

    /// Why no message came, in words.
    pub fn trouble(&self) -> String {
        let kinds = self.node.kinds_of(&self.topic);
        let topic = &self.topic;
        match &kinds[..] {
            [] if self.reader.is_some() => format!("nobody publishes {topic} any more: see that its node still runs"),
            [] => format!(
                "nobody publishes {topic} in domain {}: see that the topic is named as `ros2 topic list` does, and the domain \
                 (--domain, ROS_DOMAIN_ID)",
                self.node.domain()
            ),
            kinds if !kinds.iter().any(|kind| self.kinds.contains(&kind.as_str())) => self.wrong_kind(kinds),
            _ => format!("{topic} has a publisher, and nothing comes from it"),
        }
    }

    fn wrong_kind(&self, kinds: &[String]) -> String {
        format!("{} is published as {}, expected {}", self.topic, kinds.join(" and "), self.kinds.join(" or "))
    }

    /// Makes the reader once the type is known; a remark on a publisher whose type cannot be read.
    fn look(&mut self) -> Option<String> {
        if self.reader.is_some() {
            return None;
        }
        let found = self.node.kinds_of(&self.topic);
        if let Some(kind) = self.kinds.iter().find(|kind| found.iter().any(|found| found == *kind)) {
            match self.node.reader(&self.topic, kind, self.depth) {
                Ok(reader) => self.reader = Some((reader, kind)),
                Err(error) => return Some(error.to_string()),
            }
        }
        let strange: Vec<String> = found.into_iter().filter(|kind| !self.kinds.contains(&kind.as_str())).collect();
        if strange.is_empty() || strange.iter().all(|kind| self.told.contains(kind)) {
            return None;
        }
        let remark = self.wrong_kind(&strange);
        self.told.extend(strange);
        Some(remark)
    }
}
