//! MCAP files (<https://mcap.dev/spec>) as ROS 2 records them (<https://mcap.dev/spec/registry>): channels of CDR messages, each with its
//! time, and the definitions by which they are decoded. Chunks are not compressed, since pictures are already.

use crate::bag::messages::Definition;
use crate::error::{Error, Result};
use crate::record::write::PendingFile;
use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use mcap::{McapError, WriteOptions, Writer};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A chunk ends with the message that makes it this long, bytes.
///
/// Convention: a limit on memory, and on what a viewer reads to find a time.
const CHUNK_BYTES: u64 = 1 << 20;

/// An MCAP file being written; it appears under its name when it is [finished](Self::finish).
pub struct Recorder {
    path: PathBuf,
    writer: Writer<NoSeek<PendingFile>>,
    /// How many messages each channel has.
    messages: BTreeMap<u16, u32>,
}

impl Recorder {
    /// Starts the file.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn create(path: &Path) -> Result<Self> {
        let options = WriteOptions::new()
            .compression(None)
            .chunk_size(Some(CHUNK_BYTES))
            .profile("ros2")
            .library(concat!("snakeloop ", env!("CARGO_PKG_VERSION")))
            .disable_seeking(true);
        let writer = Writer::with_options(NoSeek::new(PendingFile::create(path)?), options);
        let writer = writer.map_err(|error| unwritten(path, error))?;
        Ok(Self { path: path.to_owned(), writer, messages: BTreeMap::new() })
    }

    /// Adds a channel of messages of one kind, and gives its number. It names no quality of service: how that is spelt depends on the
    /// release of ROS 2, and what is played without it is published by the default, reliably.
    ///
    /// # Errors
    /// A disk that is full or gone.
    pub fn channel(&mut self, topic: &str, kind: Definition) -> Result<u16> {
        let schema = self.writer.add_schema(&kind.name(), "ros2msg", kind.text().as_bytes());
        let channel = schema.and_then(|schema| self.writer.add_channel(schema, topic, "cdr", &BTreeMap::new()));
        let channel = channel.map_err(|error| unwritten(&self.path, error))?;
        self.messages.insert(channel, 0);
        Ok(channel)
    }

    /// Writes a message into a channel.
    ///
    /// # Errors
    /// A disk that is full or gone.
    pub fn write(&mut self, channel: u16, time_ns: u64, cdr: &[u8]) -> Result<()> {
        let sequence = self.messages.entry(channel).or_default();
        let header =
            MessageHeader { channel_id: channel, sequence: *sequence, log_time: time_ns, publish_time: time_ns };
        *sequence += 1;
        self.writer.write_to_known_channel(&header, cdr).map_err(|error| unwritten(&self.path, error))
    }

    /// How many messages a channel has.
    pub fn messages(&self, channel: u16) -> u64 {
        self.messages.get(&channel).copied().unwrap_or(0).into()
    }

    /// Ends the file and gives it its name.
    ///
    /// # Errors
    /// A disk that is full or gone.
    pub fn finish(mut self) -> Result<()> {
        self.writer.finish().map_err(|error| unwritten(&self.path, error))?;
        self.writer.into_inner().into_inner().commit()
    }
}

fn unwritten(path: &Path, error: McapError) -> Error {
    match error {
        McapError::Io(error) => Error::io(path, "write")(error),
        error => Error::content(path, error.to_string()),
    }
}
