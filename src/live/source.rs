//! Where live frames come from: a thread that keeps the newest.
//!
//! Recordings (picture sequences and videos) are played at their rate, as a camera would deliver them; their clock is the
//! recording's own, from 0. Cameras and streams are read as fast as they deliver, so that nothing stale queues up before
//! us, and opened again when they fall silent; their clock is Unix time. A few frames may
//! wait, so that one that takes longer to measure costs none; where they pile up, all but the newest are dropped and counted.
//! Those of a stream of JPEGs wait undecoded: one thread notes when each came, another decodes what is wanted.

use super::clock::FrameClock;
use super::mjpeg::MotionJpeg;
use super::pace::Schedule;
use crate::Result;
use crate::camera::{Capture, CaptureSettings, CaptureTarget, Frame, FrameSource, decode_frame};
use serde::Serialize;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// What frames come from.
#[derive(Debug)]
pub enum Source {
    /// Pictures or a video, played at a rate (frames/s) or, without one, at the video's own.
    Recording {
        /// The frames.
        frames: FrameSource,
        /// Frames per second; a video may do without.
        rate_fps: Option<f64>,
    },
    /// A camera or stream, with the settings to ask for.
    Device {
        /// What to open.
        target: CaptureTarget,
        /// What to ask it for.
        settings: CaptureSettings,
    },
}

impl Source {
    /// Whether frames come from a file, with a clock of their own.
    pub fn is_recording(&self) -> bool {
        matches!(self, Self::Recording { .. })
    }
}

/// Pictures without a rate are played at this many frames per second.
const USUAL_FPS: f64 = 30.0;
/// Frames that may wait to be measured: at 60 frames/s, 67 ms. Of JPEGs as many may wait undecoded, and these decoded.
const MOST_WAITING: usize = 4;
const MOST_DECODED: usize = 2;
/// How long to wait before a silent camera is tried again.
const RETRY: Duration = Duration::from_millis(250);

/// One frame as it came.
#[derive(Debug, Clone)]
pub struct Captured {
    /// The recording's index, or a running number, dropped frames counted too.
    pub index: u64,
    /// When it was taken by the source's clock, s.
    pub time_s: f64,
    /// When it was there.
    pub at: Instant,
    /// By how much that was later than it was due, s.
    pub late_s: f64,
    /// The picture; `None` where it could not be read.
    pub frame: Option<Arc<Frame>>,
}

/// What a source is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SourceState {
    /// Not a frame yet.
    Waiting,
    /// Frames come.
    Running,
    /// It was there and fell silent; it is tried again.
    Lost,
    /// The recording is over.
    Ended,
}

/// The figures of a source.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SourceStatus {
    /// What it is doing.
    pub state: SourceState,
    /// Why it is not running, where that is known.
    pub trouble: Option<String>,
    /// Frames that came.
    pub frames: u64,
    /// Frames that gave way to newer ones before they were fetched.
    pub dropped: u64,
    /// How often it came back.
    pub reconnects: u64,
    /// Frames per second over the last frames.
    pub rate_fps: f64,
    /// What a camera or stream says of itself.
    pub settings: Option<CaptureSettings>,
}

impl SourceStatus {
    /// Before the first frame.
    pub fn waiting() -> Self {
        Self {
            state: SourceState::Waiting,
            trouble: None,
            frames: 0,
            dropped: 0,
            reconnects: 0,
            rate_fps: 0.0,
            settings: None,
        }
    }
}

/// The reader thread and what it shares.
#[derive(Debug)]
pub struct Reader {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    slot: Mutex<Slot>,
    changed: Condvar,
    clock: Arc<FrameClock>,
}

#[derive(Debug)]
struct Slot {
    waiting: VecDeque<Captured>,
    /// JPEGs, before they are decoded.
    undecoded: VecDeque<(Arrival, Vec<u8>)>,
    status: SourceStatus,
    last_at: Option<Instant>,
    schedule: Schedule,
    /// The number of the next frame of a camera or stream.
    next_index: u64,
    stop: bool,
}

/// A frame of a camera or stream has come.
#[derive(Debug, Clone, Copy)]
struct Arrival {
    index: u64,
    time_s: f64,
    at: Instant,
    late_s: f64,
}

impl Arrival {
    fn with(self, frame: Option<Frame>) -> Captured {
        let Self { index, time_s, at, late_s } = self;
        Captured { index, time_s, at, late_s, frame: frame.map(Arc::new) }
    }
}

impl Reader {
    /// Starts to read, and sets the clock once frames have times. Frames get running numbers from `first_index`; of a recording, earlier ones are passed over.
    ///
    /// # Errors
    /// A video that cannot be opened any more; in a build without OpenCV any camera, and any stream but one of JPEGs. What
    /// merely is not there (yet) is waited for.
    pub fn start(source: Source, first_index: u64, clock: Arc<FrameClock>) -> Result<Self> {
        if let Source::Device { target, settings } = &source
            && cfg!(not(feature = "opencv"))
            && !matches!(target, CaptureTarget::Stream(address) if address.starts_with("http://"))
        {
            Capture::open(target, settings)?;
        }
        let slot = Mutex::new(Slot {
            waiting: VecDeque::new(),
            undecoded: VecDeque::new(),
            status: SourceStatus::waiting(),
            last_at: None,
            schedule: Schedule::default(),
            next_index: first_index,
            stop: false,
        });
        let shared = Arc::new(Shared { slot, changed: Condvar::new(), clock });
        let theirs = Arc::clone(&shared);
        let thread = std::thread::spawn(move || match source {
            Source::Recording { frames, rate_fps } => theirs.play(&frames, rate_fps, first_index),
            Source::Device { target, settings } => theirs.watch(&target, &settings),
        });
        Ok(Self { shared, thread: Some(thread) })
    }

    /// The next frame, once; waits for it so long. `None` where none came, or none will.
    pub fn next(&self, wait: Duration) -> Option<Captured> {
        let slot = self.shared.lock();
        let idle = |slot: &mut Slot| slot.waiting.is_empty() && slot.status.state != SourceState::Ended && !slot.stop;
        let (mut slot, _) =
            self.shared.changed.wait_timeout_while(slot, wait, idle).unwrap_or_else(PoisonError::into_inner);
        let next = slot.waiting.pop_front();
        // There is room for another.
        self.shared.changed.notify_all();
        next
    }

    /// The figures so far.
    pub fn status(&self) -> SourceStatus {
        self.shared.lock().status.clone()
    }

    /// Whether a recording is over and its last frame fetched.
    pub fn is_over(&self) -> bool {
        let slot = self.shared.lock();
        slot.status.state == SourceState::Ended && slot.waiting.is_empty()
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        self.shared.lock().stop = true;
        self.shared.changed.notify_all();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Slot> {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn set(&self, state: SourceState, trouble: Option<String>) {
        let mut slot = self.lock();
        slot.status.state = state;
        slot.status.trouble = trouble;
        self.changed.notify_all();
    }

    /// Sleeps unless it is to stop; says whether to go on.
    fn sleep(&self, time: Duration) -> bool {
        let slot = self.lock();
        let waited = self.changed.wait_timeout_while(slot, time, |slot| !slot.stop);
        !waited.unwrap_or_else(PoisonError::into_inner).0.stop
    }

    /// Notes that a frame has come.
    fn count(&self, slot: &mut Slot, at: Instant) {
        // Rates are smoothed over about so many frames.
        const SMOOTHING: f64 = 20.0;
        let status = &mut slot.status;
        status.frames += 1;
        status.reconnects += u64::from(status.state == SourceState::Lost);
        status.state = SourceState::Running;
        status.trouble = None;
        if let Some(last) = slot.last_at.replace(at) {
            let seconds = (at - last).as_secs_f64().max(1e-4);
            let weight = if status.rate_fps == 0.0 { 1.0 } else { 1.0 / SMOOTHING };
            let mean_seconds = if status.rate_fps > 0.0 { 1.0 / status.rate_fps } else { seconds };
            status.rate_fps = 1.0 / (mean_seconds * (1.0 - weight) + seconds * weight);
        }
    }

    /// Notes that a frame of a camera or stream has come now.
    fn arrival(&self, slot: &mut Slot) -> Arrival {
        let (at, time_s) = (Instant::now(), unix_time_s());
        self.count(slot, at);
        let index = slot.next_index;
        slot.next_index += 1;
        Arrival { index, time_s, at, late_s: slot.schedule.came(at) }
    }

    /// Puts a frame behind those that wait, or in their place; says whether to go on.
    fn offer(&self, slot: &mut Slot, captured: Captured) -> bool {
        if slot.waiting.len() == MOST_WAITING {
            slot.status.dropped += MOST_WAITING as u64;
            slot.waiting.clear();
        }
        slot.waiting.push_back(captured);
        self.changed.notify_all();
        !slot.stop
    }

    fn play(&self, source: &FrameSource, rate_fps: Option<f64>, first_index: u64) {
        let frames = match source.frames() {
            Ok(frames) => frames,
            Err(error) => return self.set(SourceState::Ended, Some(error.to_string())),
        };
        let mut began: Option<(Instant, f64)> = None;
        for (position, frame) in frames.enumerate() {
            let by_rate = position as f64 / rate_fps.unwrap_or(USUAL_FPS);
            let time_s = if rate_fps.is_some() { by_rate } else { frame.time_s.unwrap_or(by_rate) };
            let index = frame.index;
            if index < first_index {
                continue;
            }
            // Decoded first, so that it is there when it is due.
            let picture = frame.read().ok().map(Arc::new);
            let (start, first_s) = *began.get_or_insert_with(|| {
                self.clock.set(time_s);
                (Instant::now(), time_s)
            });
            let due = start + Duration::from_secs_f64((time_s - first_s).max(0.0));
            if !self.sleep(due.saturating_duration_since(Instant::now())) {
                return;
            }
            let at = Instant::now();
            let mut slot = self.lock();
            self.count(&mut slot, at);
            if !self.offer(&mut slot, Captured { index, time_s, at, late_s: 0.0, frame: picture }) {
                return;
            }
        }
        self.set(SourceState::Ended, None);
    }

    fn watch(&self, target: &CaptureTarget, settings: &CaptureSettings) {
        self.clock.set(unix_time_s());
        loop {
            let trouble = match Opened::open(target, settings) {
                Ok(opened) => {
                    {
                        let mut slot = self.lock();
                        slot.schedule = Schedule::default();
                        slot.status.settings = opened.settings();
                    }
                    match opened {
                        Opened::Jpegs(stream) => self.jpegs(*stream),
                        Opened::Capture(capture) => self.pictures(capture),
                    }
                    "no more frames come; trying again".to_owned()
                }
                Err(error) => error.to_string(),
            };
            let was_there = self.lock().status.frames > 0;
            self.set(if was_there { SourceState::Lost } else { SourceState::Waiting }, Some(trouble));
            self.lock().last_at = None;
            if !self.sleep(RETRY) {
                return;
            }
        }
    }

    /// Frames that OpenCV decodes.
    fn pictures(&self, mut capture: Capture) {
        while let Some(frame) = capture.read() {
            let mut slot = self.lock();
            let arrival = self.arrival(&mut slot);
            if !self.offer(&mut slot, arrival.with(Some(frame))) {
                return;
            }
        }
    }

    /// A stream of JPEGs: another thread reads them, so that what they are decoded for holds up none on its way.
    fn jpegs(&self, mut stream: MotionJpeg) {
        let over = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while let Some(jpeg) = stream.read() {
                    let mut slot = self.lock();
                    let arrival = self.arrival(&mut slot);
                    if slot.undecoded.len() == MOST_WAITING {
                        slot.status.dropped += MOST_WAITING as u64;
                        slot.undecoded.clear();
                    }
                    slot.undecoded.push_back((arrival, jpeg));
                    self.changed.notify_all();
                    if slot.stop {
                        break;
                    }
                }
                over.store(true, Ordering::Relaxed);
                let _slot = self.lock();
                self.changed.notify_all();
            });
            while let Some((arrival, jpeg)) = self.wanted(&over) {
                let frame = decode_frame(&jpeg).ok();
                let mut slot = self.lock();
                if let (None, Some(frame)) = (slot.status.settings, &frame) {
                    let size = Some((frame.width, frame.height));
                    slot.status.settings = Some(CaptureSettings { size, ..CaptureSettings::default() });
                }
                self.offer(&mut slot, arrival.with(frame));
            }
        });
    }

    /// The next JPEG to decode, once there is room for its picture; `None` where none will come.
    fn wanted(&self, over: &AtomicBool) -> Option<(Arrival, Vec<u8>)> {
        let slot = self.lock();
        let idle = |slot: &mut Slot| {
            let ready = !slot.undecoded.is_empty() && slot.waiting.len() < MOST_DECODED;
            let over = over.load(Ordering::Relaxed) && slot.undecoded.is_empty();
            !(ready || over || slot.stop)
        };
        let mut slot = self.changed.wait_while(slot, idle).unwrap_or_else(PoisonError::into_inner);
        if slot.stop { None } else { slot.undecoded.pop_front() }
    }
}

/// A camera or stream that is open.
enum Opened {
    Jpegs(Box<MotionJpeg>),
    Capture(Capture),
}

impl Opened {
    fn open(target: &CaptureTarget, settings: &CaptureSettings) -> Result<Self> {
        if let CaptureTarget::Stream(address) = target
            && let Some(stream) = MotionJpeg::open(address)?
        {
            return Ok(Self::Jpegs(Box::new(stream)));
        }
        Capture::open(target, settings).map(Self::Capture)
    }

    /// What it says of itself.
    fn settings(&self) -> Option<CaptureSettings> {
        match self {
            Self::Jpegs(_) => None,
            Self::Capture(capture) => Some(capture.settings()),
        }
    }
}

/// Seconds since 1970.
pub fn unix_time_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}
