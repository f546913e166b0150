//! MCAP files (<https://mcap.dev/spec>): channels of JSON messages, each with its time.
//!
//! What is used of the format: schemas and channels first, then chunks of messages that are not compressed (pictures are already), behind each
//! chunk where its messages are, and at the end a summary with which a viewer finds a time without reading the rest. Checksums
//! are 0, which means none. That is little enough to be written here: the format's own crate would bring twenty more, and one of them
//! has most dependencies built anew in another form.

use crate::error::{Error, Result};
use crate::record::write::PendingFile;
use std::io::Write;
use std::path::{Path, PathBuf};

const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// A chunk ends with the message that makes it this long, bytes.
const CHUNK_BYTES: usize = 1 << 20;

/// The kinds of record.
mod opcode {
    pub const HEADER: u8 = 0x01;
    pub const FOOTER: u8 = 0x02;
    pub const SCHEMA: u8 = 0x03;
    pub const CHANNEL: u8 = 0x04;
    pub const MESSAGE: u8 = 0x05;
    pub const CHUNK: u8 = 0x06;
    pub const MESSAGE_INDEX: u8 = 0x07;
    pub const CHUNK_INDEX: u8 = 0x08;
    pub const STATISTICS: u8 = 0x0b;
    pub const DATA_END: u8 = 0x0f;
}

/// An MCAP file being written; it appears under its name when it is [finished](Self::finish).
#[derive(Debug)]
pub struct Recorder {
    path: PathBuf,
    file: PendingFile,
    /// Bytes in the file.
    written: u64,
    channels: Vec<Channel>,
    /// The records of all schemas and channels, which the summary repeats.
    described: Vec<u8>,
    /// The messages that are not in the file yet.
    chunk: Vec<u8>,
    chunk_times: Option<Times>,
    times: Option<Times>,
    chunks: u32,
    /// The records that tell where the chunks are.
    chunk_indexes: Vec<u8>,
}

#[derive(Debug, Default)]
struct Channel {
    messages: u64,
    /// Time and place in the chunk at hand of each message.
    index: Vec<(u64, u64)>,
}

/// The first and the last of some times, ns.
#[derive(Debug, Clone, Copy)]
struct Times(u64, u64);

impl Times {
    fn with(earlier: Option<Self>, time_ns: u64) -> Self {
        earlier.map_or(Self(time_ns, time_ns), |Self(first, last)| Self(first.min(time_ns), last.max(time_ns)))
    }
}

impl Recorder {
    /// Starts the file.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn create(path: &Path) -> Result<Self> {
        let file = PendingFile::create(path)?;
        let mut recorder = Self {
            path: path.to_owned(),
            file,
            written: 0,
            channels: Vec::new(),
            described: Vec::new(),
            chunk: Vec::new(),
            chunk_times: None,
            times: None,
            chunks: 0,
            chunk_indexes: Vec::new(),
        };
        recorder.append(MAGIC)?;
        let [profile, library] = ["", "snakeloop"];
        recorder.append(&Content::default().text(profile).text(library).record(opcode::HEADER))?;
        Ok(recorder)
    }

    /// Adds a channel of JSON messages with their JSON schema, and gives its number; before the first message.
    ///
    /// # Errors
    /// A disk that is full or gone.
    pub fn channel(&mut self, topic: &str, schema_name: &str, schema: &str) -> Result<u16> {
        let channel = self.channels.len() as u16;
        // No schema may have the number 0.
        let number = channel + 1;
        let schema = Content::default().u16(number).text(schema_name).text("jsonschema").text(schema);
        let described = Content::default().u16(channel).u16(number).text(topic).text("json").sized(&[]);
        let records = [schema.record(opcode::SCHEMA), described.record(opcode::CHANNEL)].concat();
        self.append(&records)?;
        self.described.extend(records);
        self.channels.push(Channel::default());
        Ok(channel)
    }

    /// Writes a message into a channel.
    ///
    /// # Errors
    /// A disk that is full or gone.
    pub fn write(&mut self, channel: u16, time_ns: u64, json: &[u8]) -> Result<()> {
        let place = self.chunk.len() as u64;
        let Channel { messages, index } = &mut self.channels[usize::from(channel)];
        let message = Content::default().u16(channel).u32(*messages as u32).u64(time_ns).u64(time_ns).bytes(json);
        *messages += 1;
        index.push((time_ns, place));
        self.chunk.extend(message.record(opcode::MESSAGE));
        self.chunk_times = Some(Times::with(self.chunk_times, time_ns));
        self.times = Some(Times::with(self.times, time_ns));
        if self.chunk.len() >= CHUNK_BYTES { self.end_chunk() } else { Ok(()) }
    }

    /// How many messages a channel has.
    pub fn messages(&self, channel: u16) -> u64 {
        self.channels[usize::from(channel)].messages
    }

    /// Ends the file and gives it its name.
    ///
    /// # Errors
    /// A disk that is full or gone.
    pub fn finish(mut self) -> Result<()> {
        self.end_chunk()?;
        self.append(&Content::default().u32(0).record(opcode::DATA_END))?;
        let summary_start = self.written;
        let numbered = || (0u16..).zip(&self.channels);
        let Times(first, last) = self.times.unwrap_or(Times(0, 0));
        let counts =
            numbered().fold(Content::default(), |counts, (number, channel)| counts.u16(number).u64(channel.messages));
        let statistics = Content::default()
            .u64(self.channels.iter().map(|channel| channel.messages).sum())
            // As many schemas as channels; no attachments, no metadata.
            .u16(self.channels.len() as u16)
            .u32(self.channels.len() as u32)
            .u32(0)
            .u32(0)
            .u32(self.chunks)
            .u64(first)
            .u64(last)
            .sized(&counts.0);
        let footer = Content::default().u64(summary_start).u64(0).u32(0);
        let end = [
            &self.described[..],
            &statistics.record(opcode::STATISTICS),
            &self.chunk_indexes,
            &footer.record(opcode::FOOTER),
            MAGIC,
        ];
        self.append(&end.concat())?;
        self.file.commit()
    }

    /// Writes the messages at hand as a chunk, and where each channel's are in it.
    fn end_chunk(&mut self) -> Result<()> {
        let Some(Times(first, last)) = self.chunk_times.take() else { return Ok(()) };
        let size = self.chunk.len() as u64;
        let uncompressed = "";
        let about = Content::default().u64(first).u64(last);
        let chunk =
            about.clone().u64(size).u32(0).text(uncompressed).u64(size).bytes(&self.chunk).record(opcode::CHUNK);
        self.chunk.clear();
        let start = self.written;
        self.append(&chunk)?;
        let indexes_start = self.written;
        let mut places = Content::default();
        for number in 0..self.channels.len() {
            let index = std::mem::take(&mut self.channels[number].index);
            if index.is_empty() {
                continue;
            }
            places = places.u16(number as u16).u64(self.written);
            let entries =
                index.iter().fold(Content::default(), |entries, (time, place)| entries.u64(*time).u64(*place));
            self.append(&Content::default().u16(number as u16).sized(&entries.0).record(opcode::MESSAGE_INDEX))?;
        }
        let index = about
            .u64(start)
            .u64(chunk.len() as u64)
            .sized(&places.0)
            .u64(self.written - indexes_start)
            .text(uncompressed)
            .u64(size)
            .u64(size);
        self.chunk_indexes.extend(index.record(opcode::CHUNK_INDEX));
        self.chunks += 1;
        Ok(())
    }

    fn append(&mut self, bytes: &[u8]) -> Result<()> {
        self.file.write_all(bytes).map_err(Error::io(&self.path, "write"))?;
        self.written += bytes.len() as u64;
        Ok(())
    }
}

/// What a record holds: numbers little-endian, texts and lists behind their length in bytes.
#[derive(Debug, Clone, Default)]
struct Content(Vec<u8>);

impl Content {
    fn bytes(mut self, bytes: &[u8]) -> Self {
        self.0.extend_from_slice(bytes);
        self
    }

    fn u16(self, number: u16) -> Self {
        self.bytes(&number.to_le_bytes())
    }

    fn u32(self, number: u32) -> Self {
        self.bytes(&number.to_le_bytes())
    }

    fn u64(self, number: u64) -> Self {
        self.bytes(&number.to_le_bytes())
    }

    fn sized(self, bytes: &[u8]) -> Self {
        self.u32(bytes.len() as u32).bytes(bytes)
    }

    fn text(self, text: &str) -> Self {
        self.sized(text.as_bytes())
    }

    fn record(self, opcode: u8) -> Vec<u8> {
        let length = (self.0.len() as u64).to_le_bytes();
        [&[opcode], &length[..], &self.0].concat()
    }
}
