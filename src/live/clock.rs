//! The frames' clock: Unix time for a camera or stream, the recording's own time for a recording.

use std::sync::{Mutex, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

/// Seconds since 1970.
pub fn unix_time_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}

/// The frames' clock. The source of the frames sets it; holds Unix time less the frames' time, s.
#[derive(Debug, Default)]
pub struct FrameClock(Mutex<Option<f64>>);

impl FrameClock {
    /// Says that it is `time_s` now.
    pub fn set(&self, time_s: f64) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(unix_time_s() - time_s);
    }

    /// The time now, s; `None` before the first frame of a recording.
    pub fn now_s(&self) -> Option<f64> {
        let behind = *self.0.lock().unwrap_or_else(PoisonError::into_inner);
        behind.map(|behind| unix_time_s() - behind)
    }
}
