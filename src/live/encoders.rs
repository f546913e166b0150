//! Encoder readings as they come: lines of CSV or JSON from standard input, a socket or a growing file.
//!
//! A line is `time_s,q1_mm,q2_mm,q3_mm` (a number for each backbone), with or without a header that names these columns in another order (encoders.csv's
//! own works), or JSON: `{"time_s": 1.5, "q_mm": [0.1, -0.2, 0.1]}`, or with `q1_mm` … `q3_mm`. Readings are matched to frames
//! by time, interpolated linearly between neighbours.

use super::clock::{ClockState, FrameClock, Lag, Offset, motion_lag};
use crate::error::{Error, Result};
use crate::input::read_line;
use crate::observation::EncoderReading;
use crate::robot::PerBackbone;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::{HashMap, VecDeque};
use std::fs::File;
use std::io::{BufRead, BufReader, ErrorKind, Read, Seek};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Where lines come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum EncoderSource {
    /// Standard input.
    Stdin,
    /// A TCP server, `host:port`.
    Tcp(String),
    /// A Unix socket that somebody listens on.
    Unix(PathBuf),
    /// A file that grows.
    File(PathBuf),
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
            return port
                .map(|_| Self::Tcp(address.to_owned()))
                .ok_or_else(|| Error::Usage(format!("encoders {text:?}: expected tcp://HOST:PORT")));
        }
        if let Some(path) = text.strip_prefix("unix:") {
            return Ok(Self::Unix(path.into()));
        }
        Ok(Self::File(text.into()))
    }
}

/// What the encoders' side is doing.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EncoderStatus {
    /// `none`, `log` (a finished file, matched by index), `waiting`, `running` or `lost`.
    pub state: &'static str,
    /// Why it is not running, where that is known.
    pub trouble: Option<String>,
    /// Readings so far.
    pub readings: u64,
    /// Lines that were none.
    pub bad_lines: u64,
    /// The latest such line and what is wrong with it.
    pub last_bad: Option<String>,
    /// Whose clock the stamps are in.
    pub clock: ClockState,
    /// What is added to a stamp to have the frames' time, s.
    pub offset_s: f64,
    /// By how much the picture is behind the encoders, by the motion.
    pub lag: Option<Lag>,
}

/// The reading of one frame, if there is one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lookup {
    /// This.
    Found(EncoderReading),
    /// It may still come.
    NotYet,
    /// There is none.
    Never,
}

/// Readings further apart than this are not interpolated between, s.
const MOST_GAP_S: f64 = 0.5;
/// Readings that are kept: some minutes of a fast bus.
const MOST_READINGS: usize = 120_000;
/// Lines longer than this are refused, and no more of them is kept.
const LONGEST_LINE: usize = 4096;
/// Encoders silent for so long are lost.
const SILENT: Duration = Duration::from_secs(2);
/// How long to wait before a missing socket or file is tried again, and between looks at a file.
const RETRY: Duration = Duration::from_millis(250);
const LOOK_AGAIN: Duration = Duration::from_millis(5);

/// The encoders' side.
#[derive(Debug)]
pub enum Encoders {
    /// There are none.
    None,
    /// A finished log, matched by the frames' index.
    Log(HashMap<u64, EncoderReading>),
    /// Lines as they come.
    Feed(Feed),
}

impl Encoders {
    /// The reading of a frame.
    pub fn at(&self, index: u64, time_s: f64) -> Lookup {
        match self {
            Self::None => Lookup::Never,
            Self::Log(readings) => readings.get(&index).map_or(Lookup::Never, |reading| Lookup::Found(*reading)),
            Self::Feed(feed) => feed.shared.lock().at(index, time_s),
        }
    }

    /// Their figures.
    pub fn status(&self) -> EncoderStatus {
        let quiet = |state, readings| EncoderStatus {
            state,
            trouble: None,
            readings,
            bad_lines: 0,
            last_bad: None,
            clock: ClockState::Shared,
            offset_s: 0.0,
            lag: None,
        };
        match self {
            Self::None => quiet("none", 0),
            Self::Log(readings) => quiet("log", readings.len() as u64),
            Self::Feed(feed) => feed.shared.lock().status(),
        }
    }

    /// Estimates the lag between picture and encoders anew from the last measured bends and their times.
    pub fn estimate_lag(&self, bends: &[(f64, Vector2<f64>)], to_bend: &PerBackbone<Vector2<f64>>) {
        let Self::Feed(feed) = self else { return };
        let readings = feed.shared.lock().in_frames_time(bends);
        let lag = motion_lag(bends, |time_s| interpolate(&readings, time_s).map(|q| to_bend.tr_mul(&q)));
        if lag.is_some() {
            feed.shared.lock().lag = lag;
        }
    }
}

/// Lines as they come, read by a thread.
#[derive(Debug)]
pub struct Feed {
    shared: Arc<Shared>,
}

impl Feed {
    /// Starts to read the encoders of so many backbones. What is not there yet is waited for.
    pub fn start(source: EncoderSource, backbones: usize, clock: Arc<FrameClock>, given_offset_s: Option<f64>) -> Self {
        let readings = Readings {
            parser: LineParser::new(backbones),
            stamped: VecDeque::new(),
            offset: Offset::new(given_offset_s),
            lag: None,
            count: 0,
            bad_lines: 0,
            last_bad: None,
            trouble: None,
            last_unix_s: None,
        };
        let shared = Arc::new(Shared { readings: Mutex::new(readings), clock, stop: AtomicBool::new(false) });
        let theirs = Arc::clone(&shared);
        // Not joined: a read of standard input cannot be interrupted.
        std::thread::spawn(move || theirs.run(&source));
        Self { shared }
    }
}

impl Drop for Feed {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
    }
}

#[derive(Debug)]
struct Shared {
    readings: Mutex<Readings>,
    clock: Arc<FrameClock>,
    stop: AtomicBool,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Readings> {
        self.readings.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Reads until the source is gone, and again when it is back.
    fn run(&self, source: &EncoderSource) {
        while !self.stopped() {
            let ended = match source {
                EncoderSource::Stdin => return self.trouble(self.lines(std::io::stdin().lock()).err()),
                EncoderSource::Tcp(address) => TcpStream::connect(address).and_then(|stream| {
                    stream.set_read_timeout(Some(SILENT))?;
                    self.lines(BufReader::new(stream))
                }),
                EncoderSource::Unix(path) => self.unix(path),
                EncoderSource::File(path) => self.follow(path),
            };
            self.trouble(ended.err());
            self.lock().parser.columns = None;
            std::thread::sleep(RETRY);
        }
    }

    fn trouble(&self, error: Option<std::io::Error>) {
        let timeout = |kind| matches!(kind, ErrorKind::WouldBlock | ErrorKind::TimedOut);
        self.lock().trouble = Some(match error {
            Some(error) if timeout(error.kind()) => "nothing came for two seconds".into(),
            Some(error) => error.to_string(),
            None => "the other side has closed".into(),
        });
    }

    #[cfg(unix)]
    fn unix(&self, path: &Path) -> std::io::Result<()> {
        let stream = std::os::unix::net::UnixStream::connect(path)?;
        stream.set_read_timeout(Some(SILENT))?;
        self.lines(BufReader::new(stream))
    }

    #[cfg(not(unix))]
    fn unix(&self, _: &Path) -> std::io::Result<()> {
        Err(std::io::Error::new(ErrorKind::Unsupported, "this system has no Unix sockets"))
    }

    /// Reads lines to the end.
    fn lines(&self, mut from: impl BufRead) -> std::io::Result<()> {
        let mut line = Vec::new();
        while !self.stopped() {
            // A last line without its end may have lost digits.
            if !read_line(&mut from, LONGEST_LINE + 1, &mut line)?.ended {
                return Ok(());
            }
            self.take(&line);
        }
        Ok(())
    }

    /// Reads a file as it grows, from its beginning; from there again where it is shortened or another takes its name.
    fn follow(&self, path: &Path) -> std::io::Result<()> {
        let mut file = File::open(path)?;
        let mut pending = Vec::new();
        let mut idle = 0;
        while !self.stopped() {
            let before = pending.len();
            file.by_ref().take(1 << 20).read_to_end(&mut pending)?;
            if pending.len() == before {
                idle += 1;
                // Every second or so, since it asks the file system.
                if idle % 200 == 0 && std::fs::metadata(path)?.len() < file.stream_position()? {
                    return Ok(());
                }
                std::thread::sleep(LOOK_AGAIN);
                continue;
            }
            let end = pending.iter().rposition(|&byte| byte == b'\n').map_or(0, |at| at + 1);
            for line in pending[..end].split_inclusive(|&byte| byte == b'\n') {
                self.take(line);
            }
            pending.drain(..end);
            // The beginning is kept, by which the line is seen to be too long once it ends.
            pending.truncate(LONGEST_LINE + 1);
        }
        Ok(())
    }

    fn take(&self, line: &[u8]) {
        let arrival_s = self.clock.now_s();
        let mut readings = self.lock();
        match readings.parser.parse(line) {
            Ok(Some((stamp_s, q_mm))) => readings.add(stamp_s, q_mm, arrival_s),
            Ok(None) => {}
            Err(why) => {
                readings.bad_lines += 1;
                readings.last_bad = Some(why);
            }
        }
    }
}

/// The readings so far, by the encoders' own stamps.
#[derive(Debug)]
struct Readings {
    parser: LineParser,
    stamped: VecDeque<(f64, PerBackbone)>,
    offset: Offset,
    lag: Option<Lag>,
    count: u64,
    bad_lines: u64,
    last_bad: Option<String>,
    trouble: Option<String>,
    last_unix_s: Option<f64>,
}

impl Readings {
    fn add(&mut self, stamp_s: f64, q_mm: PerBackbone, arrival_s: Option<f64>) {
        if let Some(&(last_s, _)) = self.stamped.back()
            && stamp_s <= last_s
        {
            // A clock that goes back by more than a stutter was set anew.
            if last_s - stamp_s < 1.0 {
                self.bad_lines += 1;
                self.last_bad = Some(format!("time_s {stamp_s} is not after {last_s}"));
                return;
            }
            self.stamped.clear();
        }
        if let Some(arrival_s) = arrival_s {
            self.offset.observe(stamp_s, arrival_s);
        }
        if self.stamped.len() == MOST_READINGS {
            self.stamped.pop_front();
        }
        self.stamped.push_back((stamp_s, q_mm));
        self.count += 1;
        self.trouble = None;
        self.last_unix_s = Some(super::source::unix_time_s());
    }

    fn at(&self, index: u64, time_s: f64) -> Lookup {
        let stamp_s = time_s - self.offset.estimate().1;
        match self.stamped.back() {
            Some(&(last_s, _)) if last_s >= stamp_s => {}
            _ if self.is_silent() => return Lookup::Never,
            _ => return Lookup::NotYet,
        }
        let after = self.stamped.partition_point(|&(s, _)| s < stamp_s);
        let earlier = after.checked_sub(1).map_or(self.stamped[after], |before| self.stamped[before]);
        match between(earlier, self.stamped[after], stamp_s) {
            Some(q_mm) => Lookup::Found(EncoderReading { index, time_s, q_mm }),
            None => Lookup::Never,
        }
    }

    /// Those readings, in the frames' time, that surround the times of some bends.
    fn in_frames_time(&self, bends: &[(f64, Vector2<f64>)]) -> Vec<(f64, PerBackbone)> {
        const AROUND_S: f64 = 1.0;
        let (Some(first), Some(last)) = (bends.first(), bends.last()) else { return Vec::new() };
        let offset_s = self.offset.estimate().1;
        let from = self.stamped.partition_point(|&(s, _)| s + offset_s < first.0 - AROUND_S);
        let to = self.stamped.partition_point(|&(s, _)| s + offset_s < last.0 + AROUND_S);
        self.stamped.range(from..to).map(|&(s, q)| (s + offset_s, q)).collect()
    }

    /// Whether nothing has come for a while, so that nothing need be waited for.
    fn is_silent(&self) -> bool {
        self.last_unix_s.is_none_or(|last| super::source::unix_time_s() - last > SILENT.as_secs_f64())
    }

    fn status(&self) -> EncoderStatus {
        let (clock, offset_s) = self.offset.estimate();
        EncoderStatus {
            state: match self.last_unix_s {
                None => "waiting",
                Some(_) if self.is_silent() => "lost",
                Some(_) => "running",
            },
            trouble: self.trouble.clone(),
            readings: self.count,
            bad_lines: self.bad_lines,
            last_bad: self.last_bad.clone(),
            clock,
            offset_s,
            lag: self.lag,
        }
    }
}

/// The reading at a time, of readings in order.
fn interpolate(readings: &[(f64, PerBackbone)], time_s: f64) -> Option<PerBackbone> {
    let after = readings.partition_point(|&(s, _)| s < time_s);
    between(*readings.get(after.checked_sub(1)?)?, *readings.get(after)?, time_s)
}

fn between(earlier: (f64, PerBackbone), later: (f64, PerBackbone), time_s: f64) -> Option<PerBackbone> {
    let step = later.0 - earlier.0;
    if step > MOST_GAP_S || later.0 < time_s || earlier.0 > time_s {
        return None;
    }
    let share = if step > 0.0 { (time_s - earlier.0) / step } else { 1.0 };
    Some(earlier.1 + (later.1 - earlier.1) * share)
}

/// Reads lines of encoder readings, CSV or JSON, and remembers the header that it met.
#[derive(Debug)]
pub struct LineParser {
    /// time_s, q1_mm, q2_mm, ...: one for each backbone.
    names: Vec<String>,
    /// Where they stand.
    columns: Option<Vec<usize>>,
}

/// A stamp, s, and q̃, mm; `None` for a header, a comment or an empty line; else what is wrong with the line.
pub type Parsed = std::result::Result<Option<(f64, PerBackbone)>, String>;

#[derive(Deserialize)]
struct JsonReading {
    time_s: f64,
    q_mm: Option<PerBackbone>,
    /// q1_mm, q2_mm, ... among others.
    #[serde(flatten)]
    others: HashMap<String, Value>,
}

impl LineParser {
    /// For the lines of a robot of so many backbones.
    pub fn new(backbones: usize) -> Self {
        let q = (1..=backbones).map(|i| format!("q{i}_mm"));
        Self { names: ["time_s".to_owned()].into_iter().chain(q).collect(), columns: None }
    }

    /// What a line says.
    ///
    /// # Errors
    /// A line that is no reading, in words that show its beginning.
    pub fn parse(&mut self, line: &[u8]) -> Parsed {
        if line.len() > LONGEST_LINE {
            return Err(format!("more than {LONGEST_LINE} bytes in a line, expected {}", self.names.join(",")));
        }
        let line = String::from_utf8_lossy(line);
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            return Ok(None);
        }
        let values = if line.starts_with('{') { self.json(line)? } else { self.csv(line)? };
        let Some((time_s, q_mm)) = values else { return Ok(None) };
        // Beyond these a number is a slip of units or a broken line. Written so that what is not finite fails.
        if !(time_s.is_finite() && q_mm.iter().all(|q| q.abs() <= 1e3)) {
            return Err(format!("{}: not a reading in mm", start_of(line)));
        }
        Ok(Some((time_s, q_mm)))
    }

    fn csv(&mut self, line: &str) -> Parsed {
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        if fields.iter().any(|field| self.names.iter().any(|name| name == field)) {
            let place = |name: &String| {
                fields.iter().position(|field| field == name).ok_or_else(|| format!("the header has no {name}"))
            };
            let columns = self.names.iter().map(place).collect::<std::result::Result<_, _>>()?;
            let further = format!("q{}_mm", self.names.len());
            if fields.contains(&further.as_str()) {
                return Err(format!("the header has {further}, expected {}", self.names.join(",")));
            }
            self.columns = Some(columns);
            return Ok(None);
        }
        let expected = || format!("{}: expected {}", start_of(line), self.names.join(","));
        let in_order: Vec<usize>;
        let columns = match &self.columns {
            Some(columns) => columns,
            None if fields.len() == self.names.len() => {
                in_order = (0..fields.len()).collect();
                &in_order
            }
            None => return Err(expected()),
        };
        let number = |column: &usize| fields.get(*column).and_then(|field| field.parse::<f64>().ok());
        let values: Option<Vec<f64>> = columns.iter().map(number).collect();
        let values = values.ok_or_else(expected)?;
        Ok(PerBackbone::of(&values[1..]).map(|q_mm| (values[0], q_mm)))
    }

    fn json(&self, line: &str) -> Parsed {
        let wrong = |why: String| format!("{}: {why}", start_of(line));
        let JsonReading { time_s, q_mm, others } = serde_json::from_str(line).map_err(|e| wrong(e.to_string()))?;
        let backbones = self.names.len() - 1;
        let single = || -> Option<PerBackbone> {
            let numbers: Option<Vec<f64>> = self.names[1..].iter().map(|name| others.get(name)?.as_f64()).collect();
            PerBackbone::of(&numbers?)
        };
        let q_mm = q_mm.or_else(single).filter(|q_mm| q_mm.len() == backbones);
        let further = format!("q{}_mm", backbones + 1);
        match q_mm {
            Some(q_mm) if !others.contains_key(&further) => Ok(Some((time_s, q_mm))),
            _ => Err(wrong(format!("expected q_mm of {backbones} numbers, or q1_mm to q{backbones}_mm"))),
        }
    }
}

/// The beginning of a line, to be shown.
fn start_of(line: &str) -> String {
    format!("{:?}", line.chars().take(60).collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::io::Write;
    use std::time::Instant;

    fn parsed(lines: &[&str]) -> Vec<Parsed> {
        let mut parser = LineParser::new(3);
        lines.iter().map(|line| parser.parse(line.as_bytes())).collect()
    }

    #[test]
    fn lines_of_every_kind_are_understood() {
        let expected = Ok(Some((1.5, PerBackbone::from([0.1, -0.2, 0.3]))));
        for lines in [
            &["1.5,0.1,-0.2,0.3"][..],
            &["time_s,q1_mm,q2_mm,q3_mm", "1.5, 0.1, -0.2, 0.3"],
            &["index,time_s,q1_mm,q2_mm,q3_mm", "7,1.5,0.1,-0.2,0.3"],
            &["q3_mm,q2_mm,q1_mm,time_s", "# a remark", "", "0.3,-0.2,0.1,1.5"],
            &[r#"{"time_s":1.5,"q_mm":[0.1,-0.2,0.3],"more":true}"#],
            &[r#"{"time_s":1.5,"q1_mm":0.1,"q2_mm":-0.2,"q3_mm":0.3}"#],
        ] {
            assert_eq!(parsed(lines).last().unwrap(), &expected, "{lines:?}");
        }
        for line in ["1.5,0.1", "a,b,c,d", "1.5,0.1,nan,0.3", "1.5,0.1,5000,0.3", "{\"time_s\":1}", "{", "1;2;3;4"] {
            assert!(parsed(&[line])[0].is_err(), "{line}");
        }
    }

    #[test]
    fn lines_of_another_robot_are_refused() {
        let said = |backbones: usize, line: &str| LineParser::new(backbones).parse(line.as_bytes());
        let four = Ok(Some((1.5, PerBackbone::from([0.1, -0.2, 0.3, 0.4]))));
        assert_eq!(said(4, "1.5,0.1,-0.2,0.3,0.4"), four);
        assert_eq!(said(4, r#"{"time_s":1.5,"q_mm":[0.1,-0.2,0.3,0.4]}"#), four);
        assert_eq!(said(4, r#"{"time_s":1.5,"q1_mm":0.1,"q2_mm":-0.2,"q3_mm":0.3,"q4_mm":0.4}"#), four);
        for (backbones, line, expected) in [
            (4, "1.5,0.1,-0.2,0.3", "expected time_s,q1_mm,q2_mm,q3_mm,q4_mm"),
            (3, "1.5,0.1,-0.2,0.3,0.4", "expected time_s,q1_mm,q2_mm,q3_mm"),
            (4, "time_s,q1_mm,q2_mm,q3_mm", "the header has no q4_mm"),
            (3, "time_s,q1_mm,q2_mm,q3_mm,q4_mm", "the header has q4_mm"),
            (4, r#"{"time_s":1.5,"q_mm":[0.1,-0.2,0.3]}"#, "expected q_mm of 4 numbers"),
            (3, r#"{"time_s":1.5,"q1_mm":0.1,"q2_mm":-0.2,"q3_mm":0.3,"q4_mm":0.4}"#, "q1_mm to q3_mm"),
        ] {
            let said = said(backbones, line).unwrap_err();
            assert!(said.contains(expected), "{line}: {said}");
        }
    }

    proptest! {
        #[test]
        fn any_line_is_read_or_refused(lines in proptest::collection::vec(".{0,60}|[-0-9.,eE{}\":a-z_]{0,60}", 0..6)) {
            let mut parser = LineParser::new(3);
            for line in lines {
                if let Ok(Some((time_s, q))) = parser.parse(line.as_bytes()) {
                    prop_assert!(time_s.is_finite() && q.iter().all(|q| q.is_finite()));
                }
            }
        }
    }

    #[test]
    fn no_part_of_a_line_is_taken_for_a_reading() {
        let readings = format!("0.0,0,0,0\n{}1.0,7,7,7\n0.1,1,1,1\n2.0,9,9,9", "x".repeat(3 * LONGEST_LINE));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("encoders.csv");
        std::fs::write(&path, &readings).unwrap();
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        for source in [EncoderSource::File(path), EncoderSource::Tcp(address)] {
            let tcp = matches!(source, EncoderSource::Tcp(_));
            let encoders = Encoders::Feed(Feed::start(source, 3, clock(), None));
            if tcp {
                listener.accept().unwrap().0.write_all(readings.as_bytes()).unwrap();
            }
            assert_eq!(found(&encoders, 0.05)[0], 0.5);
            let status = encoders.status();
            assert_eq!((status.readings, status.bad_lines), (2, 1), "{status:?}");
            assert!(status.last_bad.unwrap().contains("more than 4096 bytes"));
        }
    }

    fn clock() -> Arc<FrameClock> {
        let clock = Arc::new(FrameClock::default());
        clock.set(0.0);
        clock
    }

    /// Waits until there is an answer.
    fn found(encoders: &Encoders, time_s: f64) -> PerBackbone {
        let deadline = Instant::now() + Duration::from_secs(5);
        loop {
            match encoders.at(0, time_s) {
                Lookup::Found(reading) => return reading.q_mm,
                _ if Instant::now() > deadline => panic!("no reading: {:?}", encoders.status()),
                _ => std::thread::sleep(Duration::from_millis(5)),
            }
        }
    }

    #[test]
    fn a_growing_file_is_followed_and_interpolated() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("encoders.csv");
        let encoders = Encoders::Feed(Feed::start(EncoderSource::File(path.clone()), 3, clock(), None));
        assert_eq!(encoders.status().state, "waiting");
        let mut file = File::create(&path).unwrap();
        file.write_all(b"time_s,q1_mm,q2_mm,q3_mm\n0.0,0,0,0\n0.2,1,2,-1\n0.3,1,").unwrap();
        assert!((found(&encoders, 0.05) - PerBackbone::from([0.25, 0.5, -0.25])).norm() < 1e-12);
        assert_eq!(encoders.at(0, 0.25), Lookup::NotYet);
        file.write_all(b"3,-1\n9,0,0,0\n").unwrap();
        assert!((found(&encoders, 0.25) - PerBackbone::from([1.0, 2.5, -1.0])).norm() < 1e-12);
        assert_eq!(encoders.at(0, 5.0), Lookup::Never, "too far from any reading");
        assert_eq!(encoders.status().state, "running");
    }

    #[test]
    fn sockets_that_close_are_opened_again() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let source: EncoderSource = format!("tcp://{}", listener.local_addr().unwrap()).parse().unwrap();
        let encoders = Encoders::Feed(Feed::start(source, 3, clock(), None));
        for k in 0..2 {
            let (mut stream, _) = listener.accept().unwrap();
            let t = f64::from(k);
            writeln!(stream, "garbage\n{t},{k},0,0\n{},{k},0,0", t + 0.1).unwrap();
            assert_eq!(found(&encoders, t + 0.05)[0], t);
        }
        assert_eq!(encoders.status().bad_lines, 2);
    }

    #[cfg(unix)]
    #[test]
    fn a_unix_socket_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("encoders.sock");
        let listener = std::os::unix::net::UnixListener::bind(&path).unwrap();
        let source: EncoderSource = format!("unix:{}", path.display()).parse().unwrap();
        let encoders = Encoders::Feed(Feed::start(source, 3, clock(), Some(0.5)));
        let (mut stream, _) = listener.accept().unwrap();
        writeln!(stream, "{{\"time_s\": 1.0, \"q_mm\": [1, 2, 3]}}").unwrap();
        assert_eq!(found(&encoders, 1.5), PerBackbone::from([1.0, 2.0, 3.0]));
        assert_eq!(encoders.status().clock, ClockState::Given);
    }

    #[test]
    fn sources_are_told_by_their_form() {
        let tcp = EncoderSource::Tcp("robot:5000".into());
        assert_eq!("tcp://robot:5000".parse::<EncoderSource>().unwrap(), tcp);
        assert_eq!("-".parse::<EncoderSource>().unwrap(), EncoderSource::Stdin);
        assert!("tcp://robot".parse::<EncoderSource>().is_err());
    }
}
