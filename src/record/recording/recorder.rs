//! MCAP files (<https://mcap.dev/spec>): channels of JSON messages, each with its time. Chunks are not compressed, since pictures are
//! already.

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
            .library("snakeloop")
            .disable_seeking(true);
        let writer = Writer::with_options(NoSeek::new(PendingFile::create(path)?), options);
        let writer = writer.map_err(|error| unwritten(path, error))?;
        Ok(Self { path: path.to_owned(), writer, messages: BTreeMap::new() })
    }

    /// Adds a channel of JSON messages with their JSON schema, and gives its number.
    ///
    /// # Errors
    /// A disk that is full or gone.
    pub fn channel(&mut self, topic: &str, schema_name: &str, schema: &str) -> Result<u16> {
        let schema = self.writer.add_schema(schema_name, "jsonschema", schema.as_bytes());
        let channel = schema.and_then(|schema| self.writer.add_channel(schema, topic, "json", &BTreeMap::new()));
        let channel = channel.map_err(|error| unwritten(&self.path, error))?;
        self.messages.insert(channel, 0);
        Ok(channel)
    }

    /// Writes a message into a channel.
    ///
    /// # Errors
    /// A disk that is full or gone.
    pub fn write(&mut self, channel: u16, time_ns: u64, json: &[u8]) -> Result<()> {
        let sequence = self.messages.entry(channel).or_default();
        let header =
            MessageHeader { channel_id: channel, sequence: *sequence, log_time: time_ns, publish_time: time_ns };
        *sequence += 1;
        self.writer.write_to_known_channel(&header, json).map_err(|error| unwritten(&self.path, error))
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
