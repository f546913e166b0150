//! The frames that wait between the thread that reads them and the loop that measures them: a short queue that drops old frames.
//!
//! Nothing here reads, waits or looks at a clock; the frame reader of source.rs does that, and locks the queue.

use super::frame_timing::Lateness;
use super::status::{SourceState, SourceStatus};
use super::stream::Packed;
use crate::camera::Frame;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;

/// Frames that may wait to be measured; of a stream as many may wait undecoded. Convention: 67 ms at 60 frames/s, less than
/// makes a frame old.
const MAX_WAITING: usize = 4;
/// Decoded frames of a stream that may wait. Convention: one in hand and one ready.
const MAX_DECODED: usize = 2;
/// Remarks on a source that are kept. Convention: a resource limit.
const MAX_REMARKS: usize = 20;
/// Frames over which the rate is averaged. Convention: a display choice.
const RATE_SMOOTHING: f64 = 20.0;
/// Shortest time between two frames that the rate counts, s. Convention: a guard against division by zero.
const MIN_PERIOD_S: f64 = 1e-4;

/// A frame and when it was taken.
#[derive(Debug, Clone)]
pub struct Captured {
    /// The recording's index, or a running number; dropped frames are counted too.
    pub index: u64,
    /// When it was taken, by the source's clock, s.
    pub time_s: f64,
    /// When it arrived.
    pub at: Instant,
    /// By how much it arrived later than it was due, s.
    pub late_s: f64,
    /// The picture; `None` where it could not be read.
    pub frame: Option<Arc<Frame>>,
}

/// The arrival of a frame of a camera or stream.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrival {
    /// Its running number.
    pub index: u64,
    /// Unix time, s.
    pub time_s: f64,
    /// When it arrived.
    pub at: Instant,
    /// By how much it arrived later than it was due, s.
    pub late_s: f64,
}

impl Arrival {
    /// The frame that arrived; without a picture where that cannot be read.
    pub fn with(self, frame: Option<Frame>) -> Captured {
        let Self { index, time_s, at, late_s } = self;
        Captured { index, time_s, at, late_s, frame: frame.map(Arc::new) }
    }
}

/// Frames that wait, and what is known of their source.
#[derive(Debug)]
pub struct FrameQueue {
    /// What is known of the source.
    pub status: SourceStatus,
    /// Whether the reader is to stop.
    pub stop: bool,
    waiting: VecDeque<Captured>,
    /// Frames of a stream before they are decoded.
    undecoded: VecDeque<(Arrival, Packed)>,
    last_at: Option<Instant>,
    lateness: Lateness,
    /// The number of the next frame of a camera or stream.
    next_index: u64,
}

impl FrameQueue {
    /// An empty queue; the first frame of a camera or stream gets the number `first_index`.
    pub fn new(first_index: u64) -> Self {
        Self {
            status: SourceStatus::default(),
            stop: false,
            waiting: VecDeque::new(),
            undecoded: VecDeque::new(),
            last_at: None,
            lateness: Lateness::default(),
            next_index: first_index,
        }
    }

    /// A camera or stream was opened: its frames have a rate of their own.
    pub fn opened(&mut self) {
        self.lateness = Lateness::default();
    }

    /// A camera or stream is gone, or could not be opened.
    pub fn lost(&mut self, trouble: String) {
        self.status.state = if self.status.frames > 0 { SourceState::Lost } else { SourceState::Waiting };
        self.status.trouble = Some(trouble);
        self.last_at = None;
    }

    /// A recording is over, for the reason given where it was cut short.
    pub fn ended(&mut self, trouble: Option<String>) {
        self.status.state = SourceState::Ended;
        self.status.trouble = trouble;
    }

    /// Whether a recording is over and its last frame fetched.
    pub fn is_over(&self) -> bool {
        self.status.state == SourceState::Ended && self.waiting.is_empty()
    }

    /// Whether there is nothing to fetch yet, and something may still come.
    pub fn is_idle(&self) -> bool {
        self.waiting.is_empty() && self.status.state != SourceState::Ended && !self.stop
    }

    /// Counts a frame that arrived, and updates the rate.
    pub fn count(&mut self, at: Instant) {
        let status = &mut self.status;
        status.frames += 1;
        status.reconnects += u64::from(status.state == SourceState::Lost);
        status.state = SourceState::Running;
        status.trouble = None;
        if let Some(last) = self.last_at.replace(at) {
            let period_s = (at - last).as_secs_f64().max(MIN_PERIOD_S);
            let mean_s = match status.rate_fps {
                0.0 => period_s,
                rate_fps => 1.0 / rate_fps + (period_s - 1.0 / rate_fps) / RATE_SMOOTHING,
            };
            status.rate_fps = 1.0 / mean_s;
        }
    }

    /// Counts and numbers a frame of a camera or stream.
    pub fn arrival(&mut self, at: Instant, time_s: f64) -> Arrival {
        self.count(at);
        let index = self.next_index;
        self.next_index += 1;
        Arrival { index, time_s, at, late_s: self.lateness.arrived(at) }
    }

    /// The same of a frame that says when it was taken, s: however late it comes, its time is certain.
    pub fn stamped_arrival(&mut self, at: Instant, stamp_s: f64) -> Arrival {
        Arrival { late_s: 0.0, ..self.arrival(at, stamp_s) }
    }

    /// Notes something that the user is to know of the source, once.
    pub fn remark(&mut self, text: String) {
        let remarks = &mut self.status.remarks;
        if remarks.len() < MAX_REMARKS && !remarks.contains(&text) {
            remarks.push(text);
        }
    }

    /// A picture that could be read; of one that could not, the reason is noted.
    pub fn readable<E: std::fmt::Display>(&mut self, picture: Result<Frame, E>) -> Option<Frame> {
        picture.map_err(|why| self.remark(format!("a picture cannot be read: {why}"))).ok()
    }

    /// Adds a frame; where as many wait as may, it takes their place.
    pub fn push(&mut self, captured: Captured) {
        if self.waiting.len() == MAX_WAITING {
            self.status.dropped += MAX_WAITING as u64;
            self.waiting.clear();
        }
        self.waiting.push_back(captured);
    }

    /// The same for a frame that is still to be decoded.
    pub fn push_undecoded(&mut self, arrival: Arrival, packed: Packed) {
        if self.undecoded.len() == MAX_WAITING {
            self.status.dropped += MAX_WAITING as u64;
            self.undecoded.clear();
        }
        self.undecoded.push_back((arrival, packed));
    }

    /// The next frame to measure.
    pub fn pop(&mut self) -> Option<Captured> {
        self.waiting.pop_front()
    }

    /// The next frame to decode, once there is room for its picture.
    pub fn pop_undecoded(&mut self) -> Option<(Arrival, Packed)> {
        if self.waiting.len() < MAX_DECODED { self.undecoded.pop_front() } else { None }
    }

    /// Whether no frame waits to be decoded.
    pub fn is_decoded(&self) -> bool {
        self.undecoded.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    /// A queue at which frames arrived every `period_s` and were not fetched.
    fn filled(frames: u32, period_s: f64) -> FrameQueue {
        let (mut queue, began) = (FrameQueue::new(7), Instant::now());
        for k in 0..frames {
            let at = began + Duration::from_secs_f64(f64::from(k) * period_s);
            let arrival = queue.arrival(at, f64::from(k) * period_s);
            queue.push(arrival.with(None));
        }
        queue
    }

    fn indices(queue: &mut FrameQueue) -> Vec<u64> {
        std::iter::from_fn(|| queue.pop()).map(|captured| captured.index).collect()
    }

    #[test]
    fn the_newest_frame_replaces_all_that_piled_up() {
        assert_eq!(indices(&mut filled(4, 0.1)), [7, 8, 9, 10]);
        let mut queue = filled(6, 0.1);
        assert_eq!((queue.status.frames, queue.status.dropped), (6, 4));
        assert_eq!(indices(&mut queue), [11, 12]);
    }

    #[test]
    fn jpegs_wait_until_there_is_room_for_their_picture() {
        let mut queue = FrameQueue::new(0);
        for _ in 0..3 {
            let arrival = queue.arrival(Instant::now(), 0.0);
            queue.push_undecoded(arrival, Packed::File(vec![1]));
        }
        for _ in 0..2 {
            let (arrival, _) = queue.pop_undecoded().unwrap();
            queue.push(arrival.with(None));
        }
        assert!(queue.pop_undecoded().is_none() && !queue.is_decoded());
        assert_eq!(queue.pop().unwrap().index, 0);
        assert_eq!(queue.pop_undecoded().unwrap().0.index, 2);
    }

    #[test]
    fn the_rate_is_that_of_the_arrivals() {
        let rate = filled(200, 0.04).status.rate_fps;
        assert!((rate - 25.0).abs() < 1e-6, "{rate}");
    }

    #[test]
    fn a_source_that_comes_back_is_counted_and_one_that_never_came_is_waited_for() {
        let mut queue = FrameQueue::new(0);
        queue.lost("no such device".into());
        assert_eq!(queue.status.state, SourceState::Waiting);
        queue.count(Instant::now());
        queue.lost("silent".into());
        assert_eq!((queue.status.state, queue.status.trouble.as_deref()), (SourceState::Lost, Some("silent")));
        queue.count(Instant::now());
        assert_eq!((queue.status.state, queue.status.reconnects), (SourceState::Running, 1));
        assert_eq!(queue.status.trouble, None);
    }

    #[test]
    fn a_recording_is_over_once_its_last_frame_is_fetched() {
        let mut queue = filled(1, 0.1);
        queue.ended(None);
        assert!(!queue.is_over() && !queue.is_idle());
        queue.pop();
        assert!(queue.is_over() && !queue.is_idle());
    }
}
