//! ROS 2 recordings (MCAP) without ROS: the messages of a topic, one after another, memory independent of the file's size.
//!
//! The file is read from its beginning on, so that one that was never finished is read as far as it goes. Chunks may be plain, zstd or
//! lz4. The messages are CDR; those that this program knows are in [`messages`], each with the time of its header.
//!
//! Source: <https://mcap.dev/spec>, read by its own crate.

mod cdr;
pub mod messages;

pub use cdr::{Cdr, CdrResult, CdrWriter};
pub use messages::Stamped;

use crate::error::{Error, Result};
use mcap::McapError;
use mcap::records::Record;
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use serde::Deserialize;
use std::collections::{BTreeMap, HashMap};
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
    /// The MCAP file.
    pub bag: PathBuf,
    /// The topic's name.
    pub topic: String,
}

impl fmt::Display for Topic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of {}", self.topic, self.bag.display())
    }
}

impl Topic {
    /// The topic with its file relative to a folder.
    pub fn within(mut self, folder: &Path) -> Self {
        self.bag = folder.join(self.bag);
        self
    }

    /// An error about the topic.
    pub fn error(&self, message: impl fmt::Display) -> Error {
        Error::content(&self.bag, format!("topic {}: {message}", self.topic))
    }

    /// The topic's messages in the file's order.
    ///
    /// # Errors
    /// A file that cannot be opened.
    pub fn messages(&self) -> Result<Messages> {
        let mut file = File::open(&self.bag).map_err(Error::io(&self.bag, "read"))?;
        if let Some(why) = other_recording(&mut file).map_err(Error::io(&self.bag, "read"))? {
            return Err(Error::content(&self.bag, why));
        }
        let length = file.metadata().map_or(0, |about| about.len());
        let longest = usize::try_from(length).unwrap_or(usize::MAX).clamp(PACKED_RECORD_BYTES, RECORD_BYTES);
        let options = LinearReaderOptions::default()
            .with_validate_chunk_crcs(true)
            .with_skip_end_magic(true)
            .with_record_length_limit(longest);
        Ok(Messages {
            topic: self.clone(),
            file,
            reader: LinearReader::new_with_options(options),
            schemas: HashMap::new(),
            channels: HashMap::new(),
            ended: false,
        })
    }

    /// How many messages the topic has: by the summary at the end of a finished file, else by reading all of it.
    ///
    /// # Errors
    /// A file that cannot be opened.
    pub fn count(&self) -> Result<usize> {
        match self.counted_by_summary() {
            Some(count) => Ok(count),
            None => Ok(self.messages()?.filter(Result::is_ok).count()),
        }
    }

    /// What the file's summary says of the topic; `None` where there is none that can be read.
    fn counted_by_summary(&self) -> Option<usize> {
        let mut file = File::open(&self.bag).ok()?;
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

    /// The first message, decoded.
    ///
    /// # Errors
    /// A file that cannot be read, without such a topic, or whose messages are not of this kind.
    pub fn first<M: Stamped>(&self) -> Result<M> {
        let mut messages = self.messages()?;
        match messages.next() {
            Some(message) => message?.decoded(),
            None => {
                let known: Vec<String> = messages.topics().map(|(topic, kind)| format!("{topic} ({kind})")).collect();
                Err(self.error(format!("no message; the recording has {}", known.join(", "))))
            }
        }
    }

    /// All messages, decoded; for those that are small.
    ///
    /// # Errors
    /// As [`first`](Self::first).
    pub fn all<M: Stamped>(&self) -> Result<Vec<M>> {
        self.first::<M>()?;
        self.messages()?.map(|message| message?.decoded()).collect()
    }
}

/// What to do about a file that ROS 2 records as well but is no MCAP file; `None` for others. Leaves the file at its beginning.
///
/// Source: the first bytes of SQLite's format (<https://sqlite.org/fileformat.html>) and of a zstd frame (RFC 8878).
fn other_recording(file: &mut File) -> std::io::Result<Option<&'static str>> {
    if file.metadata()?.is_dir() {
        return Ok(Some("a folder, expected a recording; name the .mcap file in it"));
    }
    let mut first = Vec::new();
    file.by_ref().take(16).read_to_end(&mut first)?;
    file.rewind()?;
    Ok(match &first[..] {
        [b'S', b'Q', b'L', b'i', b't', b'e', ..] => {
            Some("a recording in SQLite, expected MCAP; convert it (ros2 bag convert, with storage_id: mcap)")
        }
        [0x28, 0xb5, 0x2f, 0xfd, ..] => Some("a file packed by zstd, expected MCAP; unpack it (zstd -d)"),
        _ => None,
    })
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

/// The messages of one topic.
pub struct Messages {
    topic: Topic,
    file: File,
    reader: LinearReader,
    /// Names of types, by their number in the file.
    schemas: HashMap<u16, String>,
    /// Topic, type and encoding of each channel.
    channels: HashMap<u16, (String, String, String)>,
    ended: bool,
}

impl Messages {
    /// The topics seen so far with their types, by name.
    fn topics(&self) -> impl Iterator<Item = (&str, &str)> {
        let topics: BTreeMap<&str, &str> =
            self.channels.values().map(|(topic, kind, _)| (topic.as_str(), kind.as_str())).collect();
        topics.into_iter()
    }

    /// The topic's next message; `None` at the end, which an unfinished file has where it was cut off.
    fn step(&mut self) -> Result<Option<Message>> {
        let damaged =
            |error: McapError| Error::content(&self.topic.bag, format!("no readable recording (MCAP): {error}"));
        loop {
            let (opcode, data) = match self.reader.next_event() {
                None => return Ok(None),
                Some(Ok(LinearReadEvent::ReadRequest(wanted))) => {
                    let read =
                        self.file.read(self.reader.insert(wanted)).map_err(Error::io(&self.topic.bag, "read"))?;
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
                    if *topic != self.topic.topic {
                        continue;
                    }
                    if encoding != "cdr" {
                        return Err(self
                            .topic
                            .error(format!("messages are in {encoding:?}, expected cdr, as ROS 2 records")));
                    }
                    return Ok(Some(Message { topic: self.topic.clone(), kind: kind.clone(), cdr: data.into_owned() }));
                }
                _ => {}
            }
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
