//! A thread that reads encoder lines from standard input, a socket or a growing file, and connects again when they are gone; or readings
//! from a stream.

use super::line_buffer::LineBuffer;
use super::readings::{Readings, SILENCE};
use crate::error::{ArgumentError, Error, Result};
use crate::live::clock::{FrameClock, unix_time_s};
use crate::live::stream::ReadingStream;
use std::fmt;
use std::fs::File;
use std::io::{ErrorKind, Read, Seek};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Time before a missing socket or file is tried again. Convention.
///
/// Convention: a timeout.
const RETRY: Duration = Duration::from_millis(250);
/// Time between two looks at a file that has not grown. Convention: shorter than a frame lasts.
const POLL: Duration = Duration::from_millis(5);
/// Looks at a file between two checks whether it was replaced or shortened, which ask the file system. Convention: about a second.
const POLLS_BETWEEN_CHECKS: u32 = 200;
/// Readings that waited for this time without a pause are told. Convention: what a busy machine may fall behind without harm.
const BEHIND: Duration = Duration::from_secs(1);
/// Bytes read at a time. Convention: a resource limit.
const CHUNK: usize = 64 << 10;

/// Where encoder lines come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum EncoderSource {
    /// Standard input.
    Stdin,
    /// A TCP server, `host:port`.
    Tcp(String),
    /// A Unix socket that a server listens at.
    Unix(PathBuf),
    /// A file that grows.
    File(PathBuf),
}

impl fmt::Display for EncoderSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stdin => f.pad("standard input"),
            Self::Tcp(address) => write!(f, "tcp://{address}"),
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
            Self::File(path) => write!(f, "{}", path.display()),
        }
    }
}

impl FromStr for EncoderSource {
    type Err = Error;

    /// `-`, `tcp://HOST:PORT`, `unix:PATH`, or a file.
    fn from_str(text: &str) -> Result<Self> {
        if text == "-" {
            return Ok(Self::Stdin);
        }
        if let Some(address) = text.strip_prefix("tcp://") {
            let port = address.rsplit_once(':').and_then(|(_, port)| port.parse::<u16>().ok());
            return port.map(|_| Self::Tcp(address.to_owned())).ok_or_else(|| {
                ArgumentError::Syntax { what: "encoders", text: text.to_owned(), expected: "tcp://HOST:PORT" }.into()
            });
        }
        if let Some(path) = text.strip_prefix("unix:") {
            return Ok(Self::Unix(path.into()));
        }
        Ok(Self::File(text.into()))
    }
}

/// The thread that reads, and the readings that it fills.
#[derive(Debug)]
pub struct LineReader {
    shared: Arc<SharedReadings>,
}

#[derive(Debug)]
struct SharedReadings {
    readings: Mutex<Readings>,
    clock: Arc<FrameClock>,
    stop: AtomicBool,
}

impl LineReader {
    /// The same of a stream that is there already.
    pub fn listen(mut stream: Box<dyn ReadingStream>, readings: Readings, clock: Arc<FrameClock>) -> Self {
        let shared = Arc::new(SharedReadings { readings: Mutex::new(readings), clock, stop: AtomicBool::new(false) });
        let of_thread = Arc::clone(&shared);
        std::thread::spawn(move || of_thread.hear(&mut *stream));
        Self { shared }
    }

    /// Starts to read. A source that is not there yet is waited for.
    pub fn start(source: EncoderSource, readings: Readings, clock: Arc<FrameClock>) -> Self {
        let shared = Arc::new(SharedReadings { readings: Mutex::new(readings), clock, stop: AtomicBool::new(false) });
        let of_thread = Arc::clone(&shared);
        // Not joined: a read of standard input cannot be interrupted.
        std::thread::spawn(move || of_thread.run(&source));
        Self { shared }
    }

    /// Locks the readings; to be held for moments only.
    pub fn lock(&self) -> MutexGuard<'_, Readings> {
        self.shared.lock()
    }
}

impl Drop for LineReader {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
    }
}

impl SharedReadings {
    fn lock(&self) -> MutexGuard<'_, Readings> {
        self.readings.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Reads until the source is gone, and again when it is back. Standard input does not come back.
    fn run(&self, source: &EncoderSource) {
        while !self.is_stopped() {
            let ended = match source {
                EncoderSource::Stdin => self.read(std::io::stdin().lock(), || Ok(false)),
                EncoderSource::Tcp(address) => self.read_tcp(address),
                EncoderSource::Unix(path) => self.read_unix(path),
                EncoderSource::File(path) => self.follow(path),
            };
            self.lock().disconnected(format!("{source}: {}", trouble(ended.err())));
            if *source == EncoderSource::Stdin {
                return;
            }
            std::thread::sleep(RETRY);
        }
    }

    /// Takes readings from a stream, however long it is silent.
    fn hear(&self, stream: &mut dyn ReadingStream) {
        while !self.is_stopped() {
            match stream.next(&|| !self.is_stopped()) {
                Some(came) => self.lock().take_sent(came, self.clock.now_s(), unix_time_s()),
                None => self.lock().disconnected(stream.trouble()),
            }
        }
    }

    fn read_tcp(&self, address: &str) -> std::io::Result<()> {
        let stream = TcpStream::connect(address)?;
        stream.set_read_timeout(Some(SILENCE))?;
        self.read(stream, || Ok(false))
    }

    #[cfg(unix)]
    fn read_unix(&self, path: &Path) -> std::io::Result<()> {
        let stream = std::os::unix::net::UnixStream::connect(path)?;
        stream.set_read_timeout(Some(SILENCE))?;
        self.read(stream, || Ok(false))
    }

    #[cfg(not(unix))]
    fn read_unix(&self, _: &Path) -> std::io::Result<()> {
        Err(std::io::Error::new(ErrorKind::Unsupported, "this system has no Unix sockets"))
    }

    /// Reads a file as it grows, from its beginning, until it is shortened or another file takes its name.
    fn follow(&self, path: &Path) -> std::io::Result<()> {
        let file = File::open(path)?;
        let mut polls = 0;
        self.read(&file, || {
            std::thread::sleep(POLL);
            polls += 1;
            Ok(polls % POLLS_BETWEEN_CHECKS != 0 || std::fs::metadata(path)?.len() >= (&file).stream_position()?)
        })
    }

    /// Reads lines to the end; there `goes_on` says whether more may come.
    fn read(&self, mut from: impl Read, mut goes_on: impl FnMut() -> std::io::Result<bool>) -> std::io::Result<()> {
        let (mut lines, mut chunk) = (LineBuffer::default(), vec![0; CHUNK]);
        let mut behind_since: Option<Instant> = None;
        while !self.is_stopped() {
            let length = match from.read(&mut chunk) {
                Err(e) if e.kind() == ErrorKind::Interrupted => continue,
                length => length?,
            };
            let (arrival_s, unix_s) = (self.clock.now_s(), unix_time_s());
            let is_behind = length == CHUNK;
            behind_since = behind_since.filter(|_| is_behind).or(is_behind.then(Instant::now));
            let mut readings = self.lock();
            readings.set_waited(is_behind);
            lines.push(&chunk[..length], |line| readings.take(line, arrival_s, unix_s));
            if behind_since.is_some_and(|since| since.elapsed() > BEHIND) {
                readings.remark(
                    "encoder readings wait to be read: they come faster than this machine takes them, or are a long file from its beginning; \
                     until they are read, the newest frames have no reading"
                        .into(),
                );
            }
            drop(readings);
            if length == 0 && !goes_on()? {
                break;
            }
        }
        Ok(())
    }
}

/// Why a connection ended, in words.
fn trouble(error: Option<std::io::Error>) -> String {
    match error {
        Some(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
            format!("nothing came for {} s", SILENCE.as_secs())
        }
        Some(error) => error.to_string(),
        None => "the other side has closed".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_are_told_by_their_form() {
        let tcp = EncoderSource::Tcp("robot:5000".into());
        assert_eq!("tcp://robot:5000".parse::<EncoderSource>().unwrap(), tcp);
        assert_eq!("-".parse::<EncoderSource>().unwrap(), EncoderSource::Stdin);
        assert_eq!("unix:/run/a".parse::<EncoderSource>().unwrap(), EncoderSource::Unix("/run/a".into()));
        assert!("tcp://robot".parse::<EncoderSource>().is_err());
    }
}
