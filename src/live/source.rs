//! Where live frames come from: a thread that reads them and keeps the newest.
//!
//! Recordings (picture sequences and videos) are played at their rate, as a camera would deliver them; their clock is the recording's
//! own, from 0. Cameras and streams are read as fast as they deliver, so that no old frame waits in a buffer before this one, and are
//! opened again when they fall silent; their clock is Unix time. A few frames may wait, so that one which takes longer to measure
//! costs none. Where they pile up, all but the newest are dropped and counted. The frames of a stream that sends them packed (JPEGs, or
//! messages of ROS 2) wait undecoded: one thread notes when each arrived, another decodes those that are wanted. Where a stream says when
//! its frames were taken, their clock is the stream's.

use super::clock::{FrameClock, unix_time_s};
use super::frame_queue::{Arrival, Captured, FrameQueue};
use super::frame_stamps::FrameStamps;
use super::motion_jpeg::MotionJpeg;
use super::status::SourceStatus;
use super::stream::{Came, FrameStream, Packed, SentFrame};
use crate::Result;
use crate::camera::{Capture, CaptureSettings, CaptureTarget, FrameSource, Lens};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

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
    /// A stream that is there already.
    Stream(Box<dyn FrameStream>),
}

impl Source {
    /// Whether frames come from a file, with a clock of their own.
    pub fn is_recording(&self) -> bool {
        matches!(self, Self::Recording { .. })
    }
}

/// Rate at which pictures are played where the user gives none, frames/s. Convention: a usual camera's.
const DEFAULT_FPS: f64 = 30.0;
/// Time before a silent camera is opened again; one that does not open is left alone for twice as long each time, up to
/// [`LONGEST_RETRY`]. Convention.
///
/// Convention: a timeout.
const RETRY: Duration = Duration::from_millis(250);
/// The longest of these times. Convention.
///
/// Convention: a timeout.
const LONGEST_RETRY: Duration = Duration::from_secs(2);
/// Time that the end waits for the thread. Convention.
///
/// Convention: a timeout.
const LEAVE: Duration = Duration::from_millis(500);

/// The thread that reads frames, and the queue that it fills.
#[derive(Debug)]
pub struct FrameReader {
    shared: Arc<SharedQueue>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct SharedQueue {
    queue: Mutex<FrameQueue>,
    changed: Condvar,
    clock: Arc<FrameClock>,
    /// The camera that the frames are read for.
    lens: Lens,
}

impl FrameReader {
    /// Starts to read the frames of a camera with this lens, and sets the clock once they have times. Frames of a camera or stream are numbered
    /// from `first_index`; of a recording, earlier ones are passed over.
    ///
    /// # Errors
    /// A video that cannot be opened any more; in a build without OpenCV any camera, and any stream but one of JPEGs. A camera or
    /// stream that is not there yet is waited for.
    pub fn start(source: Source, first_index: u64, clock: Arc<FrameClock>, lens: Lens) -> Result<Self> {
        if let Source::Device { target, settings } = &source
            && cfg!(not(feature = "opencv"))
            && !matches!(target, CaptureTarget::Stream(address) if address.starts_with("http://"))
        {
            Capture::open(target, settings)?;
        }
        let queue = Mutex::new(FrameQueue::new(first_index));
        let shared = Arc::new(SharedQueue { queue, changed: Condvar::new(), clock, lens });
        let of_thread = Arc::clone(&shared);
        let thread = std::thread::spawn(move || match source {
            Source::Recording { frames, rate_fps } => of_thread.play(&frames, rate_fps, first_index),
            Source::Device { target, settings } => of_thread.capture(&target, &settings),
            Source::Stream(stream) => of_thread.listen(stream),
        });
        Ok(Self { shared, thread: Some(thread) })
    }

    /// The next frame; waits at most so long. `None` where none arrived, or none will.
    pub fn next(&self, timeout: Duration) -> Option<Captured> {
        let shared = &self.shared;
        let waited = shared.changed.wait_timeout_while(shared.lock(), timeout, |queue| queue.is_idle());
        let next = waited.unwrap_or_else(PoisonError::into_inner).0.pop();
        // There is room for another.
        shared.changed.notify_all();
        next
    }

    /// What is known of the source.
    pub fn status(&self) -> SourceStatus {
        self.shared.lock().status.clone()
    }

    /// Whether a recording is over and its last frame fetched.
    pub fn is_over(&self) -> bool {
        self.shared.lock().is_over()
    }
}

impl Drop for FrameReader {
    /// Waits for the thread a moment only: a camera's driver may hold it for as long as it likes, and it ends with the process then.
    fn drop(&mut self) {
        self.shared.update(|queue| queue.stop = true);
        let Some(thread) = self.thread.take() else { return };
        let asked = Instant::now();
        while !thread.is_finished() && asked.elapsed() < LEAVE {
            std::thread::sleep(LEAVE / 50);
        }
    }
}

impl SharedQueue {
    fn lock(&self) -> MutexGuard<'_, FrameQueue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the queue and wakes whoever waits for a change; says whether to go on.
    fn update(&self, change: impl FnOnce(&mut FrameQueue)) -> bool {
        let mut queue = self.lock();
        change(&mut queue);
        self.changed.notify_all();
        !queue.stop
    }

    /// Sleeps unless it is to stop; says whether to go on.
    fn sleep(&self, time: Duration) -> bool {
        let waited = self.changed.wait_timeout_while(self.lock(), time, |queue| !queue.stop);
        !waited.unwrap_or_else(PoisonError::into_inner).0.stop
    }

    /// Plays a recording at its rate.
    fn play(&self, source: &FrameSource, rate_fps: Option<f64>, first_index: u64) {
        let frames = match source.frames() {
            Ok(frames) => frames,
            Err(error) => {
                self.update(|queue| queue.ended(Some(error.to_string())));
                return;
            }
        };
        if let Ok(Some(remark)) = source.remark(&self.lens) {
            self.update(|queue| queue.remark(remark));
        }
        let mut began: Option<(Instant, f64)> = None;
        for (position, frame) in frames.enumerate() {
            let by_rate = position as f64 / rate_fps.unwrap_or(DEFAULT_FPS);
            let time_s = if rate_fps.is_some() { by_rate } else { frame.time_s.unwrap_or(by_rate) };
            let index = frame.index;
            if index < first_index {
                continue;
            }
            // Decoded before it is due, so that decoding does not delay it.
            let picture = frame.read_for(&self.lens);
            let (start, first_s) = *began.get_or_insert_with(|| {
                self.clock.set(time_s);
                (Instant::now(), time_s)
            });
            let due = start + Duration::from_secs_f64((time_s - first_s).max(0.0));
            let go_on = self.sleep(due.saturating_duration_since(Instant::now()))
                && self.update(|queue| {
                    let at = Instant::now();
                    queue.count(at);
                    let arrival = Arrival { index, time_s, at, late_s: 0.0 };
                    let frame = queue.readable(picture);
                    queue.push(arrival.with(frame));
                });
            if !go_on {
                return;
            }
        }
        self.update(|queue| queue.ended(None));
    }

    /// Reads a camera or stream, and opens it again whenever it is gone.
    fn capture(&self, target: &CaptureTarget, settings: &CaptureSettings) {
        self.clock.set(unix_time_s());
        let mut retry = RETRY;
        loop {
            let trouble = match Opened::open(target, settings) {
                Ok(opened) => {
                    retry = RETRY;
                    self.update(|queue| {
                        queue.opened();
                        queue.status.settings = opened.settings();
                        let remarks = queue.status.settings.map(|found| found.remarks(settings));
                        queue.status.remarks = remarks.unwrap_or_default();
                    });
                    match opened {
                        Opened::Jpegs(mut stream) => self.read_stream(&mut *stream, &mut FrameStamps::default()),
                        Opened::Capture(capture) => self.read_pictures(capture),
                    }
                    "no more frames come; trying again".to_owned()
                }
                Err(error) => error.to_string(),
            };
            self.update(|queue| queue.lost(trouble));
            if !self.sleep(retry) {
                return;
            }
            retry = (2 * retry).min(LONGEST_RETRY);
        }
    }

    /// Reads frames that OpenCV decodes.
    fn read_pictures(&self, mut capture: Capture) {
        while let Some(frame) = capture.read() {
            let go_on = self.update(|queue| {
                let arrival = queue.arrival(Instant::now(), unix_time_s());
                queue.push(arrival.with(Some(frame)));
            });
            if !go_on {
                return;
            }
        }
    }

    /// Reads a stream that is there, however long it is silent. Its clock is known once a frame came.
    fn listen(&self, mut stream: Box<dyn FrameStream>) {
        let mut stamps = FrameStamps::default();
        while self.update(|queue| queue.opened()) {
            self.read_stream(&mut *stream, &mut stamps);
            let trouble = stream.trouble();
            self.update(|queue| queue.lost(trouble));
        }
    }

    /// Reads a stream on one thread and decodes its frames on this one, so that decoding delays no arrival.
    fn read_stream(&self, stream: &mut dyn FrameStream, stamps: &mut FrameStamps) {
        let over = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while let Some(came) = stream.next(&|| !self.lock().stop)
                    && self.arrived(came, stamps)
                {}
                self.update(|_| over.store(true, Ordering::Relaxed));
            });
            while let Some((arrival, packed)) = self.next_undecoded(&over) {
                let frame = packed.frame_for(&self.lens);
                self.update(|queue| {
                    if let (None, Ok(frame)) = (queue.status.settings, &frame) {
                        let size = Some((frame.width, frame.height));
                        queue.status.settings = Some(CaptureSettings { size, ..CaptureSettings::default() });
                    }
                    let frame = queue.readable(frame);
                    queue.push(arrival.with(frame));
                });
            }
        });
    }

    /// Takes what came on a stream; says whether to go on.
    fn arrived(&self, came: Came<SentFrame>, stamps: &mut FrameStamps) -> bool {
        let (at, unix_s) = (Instant::now(), unix_time_s());
        let sent = match came {
            Came::Remark(text) => return self.update(|queue| queue.remark(text)),
            Came::One(sent) => sent,
        };
        let Some(stamp_s) = sent.stamp_s else {
            return self.update(|queue| {
                let arrival = queue.arrival(at, unix_s);
                queue.push_undecoded(arrival, sent.packed);
            });
        };
        match stamps.take(stamp_s, unix_s) {
            Err(why) => self.update(|queue| queue.remark(why)),
            Ok(remark) => {
                // By the latest frame: a simulated clock need not run at the pace of this machine's.
                self.clock.set(stamp_s);
                self.update(|queue| {
                    remark.into_iter().for_each(|remark| queue.remark(remark));
                    let arrival = queue.stamped_arrival(at, stamp_s);
                    queue.push_undecoded(arrival, sent.packed);
                })
            }
        }
    }

    /// The next frame to decode, waited for; `None` where none will come.
    fn next_undecoded(&self, over: &AtomicBool) -> Option<(Arrival, Packed)> {
        let mut queue = self.lock();
        loop {
            if queue.stop || (over.load(Ordering::Relaxed) && queue.is_decoded()) {
                return None;
            }
            if let Some(next) = queue.pop_undecoded() {
                return Some(next);
            }
            queue = self.changed.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
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

    /// The settings that it reports.
    fn settings(&self) -> Option<CaptureSettings> {
        match self {
            Self::Jpegs(_) => None,
            Self::Capture(capture) => Some(capture.settings()),
        }
    }
}
