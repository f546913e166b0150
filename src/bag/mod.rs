//! ROS 2 recordings (MCAP) without ROS: the messages of a topic, one after another, memory independent of the file's size.
//!
//! The file is read from its beginning on, so that one that was never finished is read as far as it goes, and of one that is damaged what is
//! whole. Chunks may be plain, zstd or lz4. The messages are CDR; those that this program knows are in [`messages`], each with the time of its
//! header.
//!
//! Source: <https://mcap.dev/spec>, read by its own crate.

mod cdr;
mod files;
pub mod messages;
mod part;

pub use cdr::{Cdr, CdrResult, CdrWriter};
pub use files::Bag;
pub use messages::Stamped;

use crate::error::{Error, Result};
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};
use part::{Part, RECORD_BYTES};
use serde::Deserialize;
use std::collections::{BTreeMap, VecDeque};
use std::fmt;
use std::fs::File;
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};

/// A topic of a recording, as experiment.toml names it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Topic {
    /// The recording.
    pub bag: Bag,
    /// The topic's name.
    pub topic: String,
}

impl fmt::Display for Topic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of {}", self.topic, self.bag)
    }
}

impl Topic {
    /// The topic with its file relative to a folder.
    pub fn within(mut self, folder: &Path) -> Self {
        self.bag = self.bag.within(folder);
        self
    }

    /// An error about the topic.
    pub fn error(&self, message: impl fmt::Display) -> Error {
        Error::content(self.bag.path(), format!("topic {}: {message}", self.topic))
    }

    /// An error in words, without the file's name where it begins with that.
    pub fn in_words(&self, error: &Error) -> String {
        let (text, name) = (error.to_string(), format!("{}: ", self.bag.path().display()));
        text.strip_prefix(&name).unwrap_or(&text).to_owned()
    }

    /// The topic's messages in the order of the files.
    ///
    /// # Errors
    /// A file that cannot be opened, or is no MCAP file.
    pub fn messages(&self) -> Result<Messages> {
        let mut files: VecDeque<PathBuf> = self.bag.files()?.into();
        let first = files.pop_front().unwrap_or_default();
        Ok(Messages { topic: self.clone(), part: Part::open(first)?, files, seen: BTreeMap::new(), ended: false })
    }

    /// How many messages the topic has: by the summaries at the ends of finished files, else by reading all of them.
    ///
    /// # Errors
    /// A file that cannot be opened.
    pub fn count(&self) -> Result<usize> {
        match self.counted_by_summaries()? {
            Some(count) => Ok(count),
            None => Ok(self.messages()?.filter(Result::is_ok).count()),
        }
    }

    /// How many messages of the topic the summaries of all files count; `None` if a file has no readable one.
    fn counted_by_summaries(&self) -> Result<Option<usize>> {
        Ok(self.bag.files()?.iter().map(|file| self.counted_by_summary(file)).sum())
    }

    /// How many messages of the topic a file's summary counts; `None` if the file has no readable summary.
    fn counted_by_summary(&self, file: &Path) -> Option<usize> {
        let mut file = File::open(file).ok()?;
        let length = file.metadata().ok()?.len();
        let options = SummaryReaderOptions::default().with_file_size(length).with_record_length_limit(RECORD_BYTES);
        let mut reader = SummaryReader::new_with_options(options);
        while let Some(event) = reader.next_event() {
            match event.ok()? {
                SummaryReadEvent::ReadRequest(wanted) => {
                    let read = file.read(reader.insert(wanted)).ok()?;
                    reader.notify_read(read);
                }
                SummaryReadEvent::SeekRequest(to) => reader.notify_seeked(file.seek(to).ok()?),
            }
        }
        let summary = reader.finish()?;
        let counts = summary.stats?.channel_message_counts;
        let of_topic = summary.channels.values().filter(|channel| channel.topic == self.topic);
        usize::try_from(of_topic.filter_map(|channel| counts.get(&channel.id)).sum::<u64>()).ok()
    }

    /// The first message of this kind, decoded.
    ///
    /// # Errors
    /// A file that cannot be read, without such a topic, or whose messages are not of this kind.
    pub fn first<M: Stamped>(&self) -> Result<M> {
        let mut messages = self.messages()?;
        let mut why = None;
        for message in messages.by_ref() {
            match message.and_then(|message| message.decoded()) {
                Ok(found) => return Ok(found),
                Err(error) => why = why.or(Some(error)),
            }
        }
        Err(why.unwrap_or_else(|| {
            let known: Vec<String> = messages.topics().map(|(topic, kind)| format!("{topic} ({kind})")).collect();
            self.error(format!("no message; the recording has {}", known.join(", ")))
        }))
    }

    /// All messages, decoded, for those that are small; and in words what could not be read.
    ///
    /// # Errors
    /// As [`first`](Self::first).
    pub fn all<M: Stamped>(&self) -> Result<(Vec<M>, Vec<String>)> {
        self.first::<M>()?;
        let (mut found, mut faults, mut lost, mut bad) = (Vec::new(), Vec::new(), None, (0, String::new()));
        for message in self.messages()? {
            match message.map(|message| message.decoded()) {
                Ok(Ok(message)) => found.push(message),
                Ok(Err(error)) => bad = (bad.0 + 1, if bad.0 == 0 { self.in_words(&error) } else { bad.1 }),
                Err(error) => lost = Some(self.in_words(&error)),
            }
        }
        if let Some(why) = lost {
            let read = found.len() + bad.0;
            let of_all = self.counted_by_summaries()?.map(|all| format!(": {read} of {all} messages were read"));
            faults.push(why + &of_all.unwrap_or_default());
        }
        match bad {
            (0, _) => {}
            (count, first) => {
                faults.push(format!("{first}; {count} of {} messages are passed over", found.len() + count))
            }
        }
        Ok((found, faults))
    }
}

/// One message of a topic, not decoded yet.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    topic: Topic,
    /// Its type, such as `sensor_msgs/msg/Image`.
    kind: String,
    cdr: Vec<u8>,
}

impl Message {
    /// The message as a value.
    ///
    /// # Errors
    /// Another kind of message, or bytes that are none.
    pub fn decoded<M: Stamped>(&self) -> Result<M> {
        M::decoded(&self.kind, &self.cdr).map_err(|why| self.topic.error(why))
    }

    /// The time of its header, s, which all kinds begin with; `None` where it is cut short.
    pub fn stamp_s(&self) -> Option<f64> {
        messages::stamp_s(&self.cdr)
    }

    /// An error about the message.
    pub fn error(&self, why: impl fmt::Display) -> Error {
        self.topic.error(why)
    }
}

/// The messages of one topic, file by file.
pub struct Messages {
    topic: Topic,
    part: Part,
    /// Those that follow.
    files: VecDeque<PathBuf>,
    /// The topics of the files before, with their types.
    seen: BTreeMap<String, String>,
    ended: bool,
}

impl Messages {
    /// The topics seen so far with their types, by name.
    fn topics(&self) -> impl Iterator<Item = (&str, &str)> {
        let before = self.seen.iter().map(|(topic, kind)| (topic.as_str(), kind.as_str()));
        let topics: BTreeMap<&str, &str> = before.chain(self.part.topics()).collect();
        topics.into_iter()
    }

    /// The next message of this file or of one that follows.
    fn step(&mut self) -> Result<Option<Message>> {
        loop {
            if let Some(message) = self.part.step(&self.topic)? {
                return Ok(Some(message));
            }
            let Some(next) = self.files.pop_front() else { return Ok(None) };
            let topics = self.part.topics().into_iter().map(|(topic, kind)| (topic.to_owned(), kind.to_owned()));
            self.seen.extend(topics);
            self.part = Part::open(next)?;
        }
    }
}

impl Iterator for Messages {
    type Item = Result<Message>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let step = self.step().transpose();
        self.ended = match &step {
            Some(Ok(_)) => false,
            // If nobody knows how many messages are lost, those that follow have no number.
            Some(Err(_)) => self.part.is_over(),
            None => true,
        };
        step
    }
}

#[cfg(test)]
mod tests;
