//! One file of a recording, read record by record from its beginning on.
//!
//! Each record of the file, which may be a chunk of many messages, is read by a reader of its own and only once its checksum is known to be right: so
//! damage costs the record that it is in. How many messages were lost with it stands in the indices behind the chunk.
//!
//! Source: <https://mcap.dev/spec>, "Records".

use super::files::{MAGIC, ends_whole};
use super::{Message, Topic};
use crate::error::{Error, Result};
use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::PathBuf;

/// The longest record of a file, bytes: a chunk, or a message in it.
///
/// Convention: a limit on memory; recorders write chunks of some megabytes.
pub(super) const RECORD_BYTES: usize = 1 << 30;
/// The longest record of a file that is shorter than this, bytes. No record is longer than its file but one that was packed, and memory for
/// a record is taken before it is read: a few damaged bytes must not take a gigabyte.
///
/// Convention: a limit on memory; a plain picture of 21 megapixels.
const PACKED_RECORD_BYTES: usize = 64 << 20;
/// Bytes before a record's content: its kind, and its length.
///
/// Source: the specification, "Records".
const HEAD_BYTES: usize = 9;

/// One file of a recording.
pub(super) struct Part {
    path: PathBuf,
    file: File,
    /// How long the file is, bytes.
    length: u64,
    /// The record that is read now.
    record: Place,
    reader: LinearReader,
    /// Messages of the topic that it gave so far.
    given: usize,
    /// Names of types, by their number in the file.
    schemas: HashMap<u16, String>,
    /// Topic, type and encoding of each channel.
    channels: HashMap<u16, (String, String, String)>,
    /// Messages of the topic that were lost by damage and not told yet, and the damage.
    lost: (usize, String),
    /// Nothing more can be read.
    is_over: bool,
}

/// Where a record stands in its file, bytes.
#[derive(Clone, Copy)]
struct Place {
    kind: u8,
    from: u64,
    to: u64,
}

impl Part {
    /// The file before its first record.
    ///
    /// # Errors
    /// A file that cannot be opened.
    pub fn open(path: PathBuf) -> Result<Self> {
        let file = File::open(&path).map_err(Error::io(&path, "read"))?;
        let length = file.metadata().map_or(0, |about| about.len());
        // What the file begins with is read as a record, which has no content.
        let start = Place { kind: 0, from: 0, to: MAGIC.len() as u64 };
        let mut part = Self {
            path,
            file,
            length,
            record: start,
            reader: LinearReader::new(),
            given: 0,
            schemas: HashMap::new(),
            channels: HashMap::new(),
            lost: (0, String::new()),
            is_over: false,
        };
        part.begin(start)?;
        Ok(part)
    }

    /// Whether nothing more can be read.
    pub fn is_over(&self) -> bool {
        self.is_over
    }

    /// The topics seen so far, each with its type.
    pub fn topics(&self) -> BTreeMap<&str, &str> {
        self.channels.values().map(|(topic, kind, _)| (topic.as_str(), kind.as_str())).collect()
    }

    /// The topic's next message; `None` at the end, which an unfinished file has where it was cut off.
    ///
    /// # Errors
    /// A message that is lost by damage, or, if [`is_over`](Self::is_over) then, all that follow.
    pub fn step(&mut self, wanted: &Topic) -> Result<Option<Message>> {
        loop {
            if self.lost.0 > 0 {
                self.lost.0 -= 1;
                return Err(self.damaged(format!("{}; this message is lost", self.lost.1)));
            }
            if self.is_over {
                return Ok(None);
            }
            match self.read_on(wanted) {
                Ok(Some(message)) => return Ok(Some(message)),
                Ok(None) => self.next_record()?,
                Err(Fault::Of(error)) => {
                    self.is_over = true;
                    return Err(error);
                }
                Err(Fault::Damage(McapError::UnexpectedEof | McapError::UnexpectedEoc))
                    if self.is_cut() && !ends_whole(&self.path) =>
                {
                    self.is_over = true;
                }
                Err(Fault::Damage(why)) => match self.lost_with_record(wanted)? {
                    Some(count) => self.lost = (count, why.to_string()),
                    None => return Err(self.damaged(format!("{why}; what follows is not read"))),
                },
            }
        }
    }

    fn damaged(&self, why: impl fmt::Display) -> Error {
        Error::content(&self.path, format!("no readable recording (MCAP): {why}"))
    }

    /// Whether the record reaches beyond the file's end.
    fn is_cut(&self) -> bool {
        self.record.to > self.length
    }

    /// Goes to the record behind this one, if there is one.
    fn next_record(&mut self) -> Result<()> {
        // Unless it can be read, nothing can.
        self.is_over = true;
        let Some(next) = self.record_behind()? else { return Ok(()) };
        self.begin(next)?;
        self.is_over = false;
        Ok(())
    }

    /// Where the record behind this one stands; `None` at the end of the file.
    fn record_behind(&mut self) -> Result<Option<Place>> {
        let from = self.record.to;
        let head = self.bytes(from, from + HEAD_BYTES as u64)?;
        let Some((&kind, length)) = head.split_first() else { return Ok(None) };
        let Ok(length) = <[u8; HEAD_BYTES - 1]>::try_from(length) else { return Ok(None) };
        let to = u64::from_le_bytes(length).saturating_add(from + HEAD_BYTES as u64);
        Ok(Some(Place { kind, from, to }))
    }

    /// The file's bytes from one place to another, or to its end.
    fn bytes(&mut self, from: u64, to: u64) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let sought = self.file.seek(SeekFrom::Start(from));
        let read = sought.and_then(|_| (&self.file).take(to.saturating_sub(from)).read_to_end(&mut bytes));
        read.map_err(Error::io(&self.path, "read"))?;
        Ok(bytes)
    }

    /// Begins to read a record.
    fn begin(&mut self, record: Place) -> Result<()> {
        self.file.seek(SeekFrom::Start(record.from)).map_err(Error::io(&self.path, "read"))?;
        (self.record, self.given) = (record, 0);
        let longest = usize::try_from(self.length).unwrap_or(usize::MAX).clamp(PACKED_RECORD_BYTES, RECORD_BYTES);
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(record.from > 0)
            .with_skip_end_magic(true)
            // What was cut off has no checksum, and is read as far as it goes.
            .with_prevalidate_chunk_crcs(!self.is_cut())
            .with_record_length_limit(longest);
        self.reader = LinearReader::new_with_options(options);
        Ok(())
    }

    /// How many of the topic's messages were lost with this record, by the indices behind it; `None` if nothing tells. Goes to the record behind them.
    fn lost_with_record(&mut self, wanted: &Topic) -> Result<Option<usize>> {
        // Without a number for those that follow nothing more can be used.
        self.is_over = true;
        if self.record.kind != op::CHUNK || self.is_cut() {
            return Ok(None);
        }
        let (given, mut lost) = (self.given, None);
        while let Some(index) = self.record_behind()?.filter(|next| next.kind == op::MESSAGE_INDEX) {
            self.record = index;
            match self.indexed(wanted)? {
                Some(count) => lost = Some(lost.unwrap_or(0) + count),
                None => return Ok(None),
            }
        }
        if lost.is_some() {
            self.next_record()?;
        }
        Ok(lost.map(|lost| lost.saturating_sub(given)))
    }

    /// How many of the topic's messages an index counts; `None` if it is damaged, or of a channel that nobody introduced.
    fn indexed(&mut self, wanted: &Topic) -> Result<Option<usize>> {
        let Place { from, to, .. } = self.record;
        if self.is_cut() || to - from > PACKED_RECORD_BYTES as u64 {
            return Ok(None);
        }
        let bytes = self.bytes(from + HEAD_BYTES as u64, to)?;
        let Ok(Record::MessageIndex(index)) = mcap::parse_record(op::MESSAGE_INDEX, &bytes) else { return Ok(None) };
        let channel = self.channels.get(&index.channel_id);
        Ok(channel.map(|(topic, ..)| if *topic == wanted.topic { index.records.len() } else { 0 }))
    }

    /// The topic's next message in the record; `None` at its end.
    fn read_on(&mut self, wanted: &Topic) -> std::result::Result<Option<Message>, Fault> {
        loop {
            let (opcode, data) = match self.reader.next_event() {
                None => return Ok(None),
                Some(event) => match event.map_err(Fault::Damage)? {
                    LinearReadEvent::ReadRequest(bytes) => {
                        let place = self.reader.insert(bytes);
                        let read = up_to(&mut self.file, self.record.to, place);
                        self.reader.notify_read(read.map_err(|e| Fault::Of(Error::io(&self.path, "read")(e)))?);
                        continue;
                    }
                    LinearReadEvent::Record { opcode, data } => (opcode, data),
                },
            };
            match mcap::parse_record(opcode, data).map_err(Fault::Damage)? {
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
                        let why = format!("messages are in {encoding:?}, expected cdr, as ROS 2 records");
                        return Err(Fault::Of(wanted.error(why)));
                    }
                    self.given += 1;
                    return Ok(Some(Message { topic: wanted.clone(), kind: kind.clone(), cdr: data.into_owned() }));
                }
                _ => {}
            }
        }
    }
}

/// Reads bytes of a file, none behind a place in it.
fn up_to(file: &mut File, end: u64, place: &mut [u8]) -> std::io::Result<usize> {
    let left = end.saturating_sub(file.stream_position()?);
    let most = usize::try_from(left).unwrap_or(usize::MAX).min(place.len());
    file.read(&mut place[..most])
}

/// Why reading stopped.
enum Fault {
    /// Bytes that make no sense.
    Damage(McapError),
    /// Anything else.
    Of(Error),
}
