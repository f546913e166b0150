//! ROS 2 recordings (MCAP) without ROS: the messages of a topic, one after another, memory independent of the file's size.
//!
//! The file is read from its beginning on, so that one that was never finished is read as far as it goes. Chunks may be plain, zstd or
//! lz4. The messages are CDR; those that this program knows are in [`messages`], each with the time of its header.
//!
//! Source: <https://mcap.dev/spec>, read by its own crate.

mod cdr;
mod files;
pub mod messages;

pub use cdr::{Cdr, CdrResult, CdrWriter};
pub use files::Bag;
pub use messages::Stamped;

use crate::error::{Error, Result};
use mcap::McapError;
use mcap::records::Record;
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use serde::Deserialize;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::fmt;
use std::fs::File;
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};

/// The longest record of a file, bytes: a chunk, or a message in it.
///
/// Convention: a limit on memory; recorders write chunks of some megabytes.
const RECORD_BYTES: usize = 1 << 30;
/// The longest record of a file that is shorter than this, bytes. No record is longer than its file but one that was packed, and memory for
/// a record is taken before it is read: a few damaged bytes must not take a gigabyte.
///
/// Convention: a limit on memory; a plain picture of 21 megapixels.
const PACKED_RECORD_BYTES: usize = 64 << 20;

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
        let (mut found, mut faults, mut bad) = (Vec::new(), Vec::new(), (0, String::new()));
        for message in self.messages()? {
            match message.map(|message| message.decoded()) {
                Ok(Ok(message)) => found.push(message),
                Ok(Err(error)) => bad = (bad.0 + 1, if bad.0 == 0 { self.in_words(&error) } else { bad.1 }),
                Err(error) => {
                    let read = self
                        .counted_by_summaries()?
                        .map(|all| format!(": {} of {all} messages were read", found.len()));
                    faults.push(format!(
                        "{}; what follows is not read{}",
                        self.in_words(&error),
                        read.unwrap_or_default()
                    ));
                }
            }
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

/// One file of a recording.
struct Part {
    path: PathBuf,
    file: File,
    reader: LinearReader,
    /// Names of types, by their number in the file.
    schemas: HashMap<u16, String>,
    /// Topic, type and encoding of each channel.
    channels: HashMap<u16, (String, String, String)>,
}

impl Part {
    fn open(path: PathBuf) -> Result<Self> {
        let file = File::open(&path).map_err(Error::io(&path, "read"))?;
        let length = file.metadata().map_or(0, |about| about.len());
        let longest = usize::try_from(length).unwrap_or(usize::MAX).clamp(PACKED_RECORD_BYTES, RECORD_BYTES);
        let options = LinearReaderOptions::default()
            .with_validate_chunk_crcs(true)
            .with_skip_end_magic(true)
            .with_record_length_limit(longest);
        let reader = LinearReader::new_with_options(options);
        Ok(Self { path, file, reader, schemas: HashMap::new(), channels: HashMap::new() })
    }

    /// The topic's next message; `None` at the end, which an unfinished file has where it was cut off.
    fn step(&mut self, wanted: &Topic) -> Result<Option<Message>> {
        let damaged = |error: McapError| Error::content(&self.path, format!("no readable recording (MCAP): {error}"));
        loop {
            let (opcode, data) = match self.reader.next_event() {
                None => return Ok(None),
                Some(Ok(LinearReadEvent::ReadRequest(wanted))) => {
                    let read = self.file.read(self.reader.insert(wanted)).map_err(Error::io(&self.path, "read"))?;
                    self.reader.notify_read(read);
                    continue;
                }
                Some(Ok(LinearReadEvent::Record { opcode, data })) => (opcode, data),
                Some(Err(McapError::UnexpectedEof | McapError::UnexpectedEoc)) => return Ok(None),
                Some(Err(error)) => return Err(damaged(error)),
            };
            match mcap::parse_record(opcode, data).map_err(damaged)? {
                Record::Schema { header, .. } => {
                    self.schemas.insert(header.id, header.name);
                }
                Record::Channel(channel) => {
                    let kind = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                    self.channels.insert(channel.id, (channel.topic, kind, channel.message_encoding));
                }
                Record::Message { header, data } => {
                    let Some((topic, kind, encoding)) = self.channels.get(&header.channel_id) else { continue };
                    if *topic != wanted.topic {
                        continue;
                    }
                    if encoding != "cdr" {
                        return Err(
                            wanted.error(format!("messages are in {encoding:?}, expected cdr, as ROS 2 records"))
                        );
                    }
                    return Ok(Some(Message { topic: wanted.clone(), kind: kind.clone(), cdr: data.into_owned() }));
                }
                _ => {}
            }
        }
    }

    fn topics(&self) -> impl Iterator<Item = (&str, &str)> {
        self.channels.values().map(|(topic, kind, _)| (topic.as_str(), kind.as_str()))
    }
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
            let topics: Vec<_> = self.part.topics().map(|(topic, kind)| (topic.to_owned(), kind.to_owned())).collect();
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
        // Nothing can be told of what follows damage.
        self.ended = !matches!(step, Some(Ok(_)));
        step
    }
}

#[cfg(test)]
mod tests;
