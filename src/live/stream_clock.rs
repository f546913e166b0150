//! When the frames of a stream were taken that tells it by a clock of its own, as RTSP does.
//!
//! A frame arrives later than it was taken, by the delay of coding, network and decoding, which a busy machine makes longer. The least
//! difference between arrival and stamp over some seconds is the offset of the clocks and the shortest delay ([`ClockOffset`]), so that
//! a frame that was held up still has its time.

use super::clock_offset::ClockOffset;

/// A frame that seems to have been under way for longer than this, s, or to come from the future, shows that the stream's clock was set anew.
///
/// Convention: longer than players buffer; from then on the clock is learned anew.
const LONGEST_DELAY_S: f64 = 2.0;

/// The clock of one stream.
#[derive(Debug)]
pub struct StreamClock(ClockOffset);

impl Default for StreamClock {
    fn default() -> Self {
        Self(ClockOffset::new(None))
    }
}

impl StreamClock {
    /// When a frame was taken that carries this stamp and arrived at this Unix time, s; `None` where the stream's clock cannot be told.
    pub fn taken_s(&mut self, stamp_s: f64, arrival_s: f64) -> Option<f64> {
        self.0.observe(stamp_s, arrival_s);
        let (_, offset_s) = self.0.estimate();
        let taken_s = stamp_s + offset_s;
        if (0.0..=LONGEST_DELAY_S).contains(&(arrival_s - taken_s)) {
            return Some(taken_s);
        }
        self.0.restart();
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    const BEGAN_S: f64 = 1.76e9;

    #[test]
    fn a_frame_that_was_held_up_has_its_own_time() {
        let mut random = rand::rngs::StdRng::seed_from_u64(1);
        let mut clock = StreamClock::default();
        for k in 0..3000 {
            let true_s = BEGAN_S + f64::from(k) / 15.0;
            // 30 ms at least; every tenth frame is held up by as much as half a second.
            let held_s = if k % 10 == 3 { random.random_range(0.1..0.5) } else { random.random_range(0.0..0.02) };
            let taken_s = clock.taken_s(true_s - BEGAN_S + 0.5, true_s + 0.03 + held_s).unwrap();
            assert!(k < 20 || (taken_s - true_s - 0.03).abs() < 5e-3, "{k}: {}", taken_s - true_s);
        }
    }

    #[test]
    fn a_clock_that_is_set_anew_is_learned_anew() {
        let mut clock = StreamClock::default();
        let mut unknown = 0;
        for k in 0..600 {
            let true_s = BEGAN_S + f64::from(k) / 30.0;
            let stamp_s = f64::from(k) / 30.0 + if k < 300 { 50.0 } else { 1.0 };
            match clock.taken_s(stamp_s, true_s) {
                Some(taken_s) => assert!((taken_s - true_s).abs() < 1e-6, "{k}"),
                None => unknown += 1,
            }
        }
        assert_eq!(unknown, 1);
    }
}
