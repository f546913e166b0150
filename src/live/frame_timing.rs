//! Whether frames arrive when they are due, and are measured at once.
//!
//! A frame is paired with the encoders by the time at which it arrived. One that was held back on its way shows an earlier moment than
//! that: it is late, and nothing is learned from it. Where frames arrive on time and only the loop is slow, the pairing stays right;
//! the answer just comes later.

use super::status::{FrameTimingState, FrameTimingStatus, SourceStatus};
use std::time::{Duration, Instant};

/// Nothing is learned from frames that arrive later than this, s. Convention: a robot that bends at 10 °/s moves 1°, the paper's
/// measurement error, in this time.
pub const LATE_S: f64 = 0.1;
/// Frames older than this when they are measured are behind, s. Convention: the same time as for late frames.
const OLD_S: f64 = LATE_S;
/// So are frames of which more than this share is dropped. Convention: a display choice.
const MANY_DROPPED: f64 = 0.1;
/// Hysteresis: frames are behind no longer once both figures are below this share of their limits. Convention: a display choice that
/// keeps the verdict from flickering.
const HYSTERESIS: f64 = 0.7;
/// Drops are counted over this time, and a late frame is told of for as long. Convention: a display choice.
const WINDOW: Duration = Duration::from_secs(2);
/// Frames over which the age is averaged. Convention: a display choice.
const AGE_SMOOTHING: f64 = 10.0;

/// Frames after which the rate is known well enough to call one late.
///
/// Convention: under a second of most cameras; until then no frame is called late.
const FIRST_FRAMES: u32 = 20;
/// Frames over which the period is averaged; a stall and the burst after it, which are shorter, leave the mean as it was.
///
/// Convention: five seconds at 30 frames a second.
const PERIOD_SMOOTHING: u32 = 150;
/// Time in which lateness decays, s: frames still missing after a stall were lost, and those that follow are not late.
///
/// Convention: longer than between two frames, and short beside the time for which a late frame is told of.
const LATENESS_DECAY_S: f64 = 0.5;

/// By how much frames are late, judged by the rate at which the others arrive.
///
/// After a gap frames are late until as many have arrived as were due. What is missing even then was lost on the way.
#[derive(Debug, Default)]
pub struct Lateness {
    last: Option<Instant>,
    /// Mean time between frames, s.
    period_s: f64,
    frames: u32,
    late_s: f64,
}

impl Lateness {
    /// A frame arrived; by how much it is late, s.
    pub fn arrived(&mut self, at: Instant) -> f64 {
        let Some(last) = self.last.replace(at) else { return 0.0 };
        let seconds = (at - last).as_secs_f64();
        if self.frames >= FIRST_FRAMES {
            self.late_s = (self.late_s + seconds - self.period_s).max(0.0);
            self.late_s *= (-seconds.min(self.period_s) / LATENESS_DECAY_S).exp();
        }
        self.frames = (self.frames + 1).min(PERIOD_SMOOTHING);
        self.period_s += (seconds - self.period_s) / f64::from(self.frames);
        self.late_s
    }
}

/// Judges the frames' timing.
#[derive(Debug)]
pub struct FrameTiming {
    age_s: f64,
    waited_s: f64,
    dropped: f64,
    late: u64,
    late_s: f64,
    last_late: Option<Instant>,
    behind: bool,
    /// When drops were counted last, with the source's counts of frames and drops then.
    counted: (Instant, u64, u64),
}

impl FrameTiming {
    /// Before the first frame.
    pub fn new(now: Instant) -> Self {
        Self {
            age_s: 0.0,
            waited_s: 0.0,
            dropped: 0.0,
            late: 0,
            late_s: 0.0,
            last_late: None,
            behind: false,
            counted: (now, 0, 0),
        }
    }

    /// A frame that arrived `late_s` late was measured `age_s` after its arrival, and waited for its reading for `waited_s` then.
    pub fn measured(&mut self, now: Instant, age_s: f64, waited_s: f64, late_s: f64) {
        self.age_s += (age_s - self.age_s) / AGE_SMOOTHING;
        self.waited_s += (waited_s - self.waited_s) / AGE_SMOOTHING;
        if late_s > LATE_S {
            self.late += 1;
            self.late_s = late_s;
            self.last_late = Some(now);
        }
    }

    /// The timing now.
    pub fn status(&mut self, now: Instant, source: &SourceStatus) -> FrameTimingStatus {
        self.count_drops(now, source);
        let share_of_limit = if self.behind { HYSTERESIS } else { 1.0 };
        let age_s = self.age_s + self.waited_s;
        self.behind = age_s > share_of_limit * OLD_S || self.dropped > share_of_limit * MANY_DROPPED;
        let (state, sentence) = if self.last_late.is_some_and(|last| now - last < WINDOW) {
            (FrameTimingState::Late, Some(self.late_sentence()))
        } else if self.behind {
            (FrameTimingState::Behind, Some(self.behind_sentence()))
        } else {
            (FrameTimingState::Fresh, None)
        };
        let age_ms = 1000.0 * age_s;
        FrameTimingStatus { state, age_ms, dropped: self.dropped, late: self.late, sentence }
    }

    fn count_drops(&mut self, now: Instant, source: &SourceStatus) {
        let (since, frames, dropped) = self.counted;
        if now - since < WINDOW {
            return;
        }
        let arrived = source.frames.saturating_sub(frames);
        self.dropped = source.dropped.saturating_sub(dropped) as f64 / arrived.max(1) as f64;
        self.counted = (now, source.frames, source.dropped);
        if arrived == 0 {
            (self.age_s, self.waited_s) = (0.0, 0.0);
        }
    }

    fn late_sentence(&self) -> String {
        format!(
            "frames come up to {:.0} ms after they are due: they were held up on their way, their time is not certain, and \
             nothing is learned from them",
            1000.0 * self.late_s
        )
    }

    fn behind_sentence(&self) -> String {
        if self.waited_s > self.age_s && self.dropped <= MANY_DROPPED {
            return format!(
                "measurements wait {:.0} ms for the encoder reading of their moment: send readings more often and at once, or say \
                 how far their clock is off (--encoder-offset)",
                1000.0 * self.waited_s
            );
        }
        let dropped = match 100.0 * self.dropped {
            percent if percent < 1.0 => String::new(),
            percent => format!(", and {percent:.0} % are dropped"),
        };
        format!(
            "frames are {:.0} ms old when they are measured{dropped}; send fewer or smaller ones, or end other programs \
             on this machine",
            1000.0 * self.age_s
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// Lateness of frames that come at these seconds.
    fn lateness(at: impl IntoIterator<Item = f64>) -> Vec<f64> {
        let began = Instant::now();
        let mut lateness = Lateness::default();
        at.into_iter().map(|s| lateness.arrived(began + Duration::from_secs_f64(s))).collect()
    }

    #[test]
    fn frames_that_jitter_come_in_groups_or_get_lost_now_and_then_are_not_late() {
        let mut random = rand::rngs::StdRng::seed_from_u64(1);
        let jitter: Vec<f64> = (0..3000).map(|_| random.random_range(0.0..0.02)).collect();
        for rate in [15.0, 30.0, 60.0] {
            let late = lateness(jitter.iter().enumerate().map(|(k, jitter)| k as f64 / rate + jitter));
            assert!(late.iter().all(|&late| late < 0.03), "{rate}");
        }
        // In pairs, as over some buses.
        let late = lateness((0..1000).map(|k| f64::from(k / 2) / 15.0 + 0.01 * f64::from(k % 2)));
        assert!(late.iter().all(|&late| late < 0.03), "{late:?}");
        let late = lateness((0..3000).filter(|k| k % 20 != 7).map(|k| f64::from(k) / 30.0));
        assert!(late.iter().all(|&late| late < 0.04));
        // The first of five that come together is late by four periods, and no more.
        let late = lateness((0..3000).map(|k| f64::from(k / 5) / 6.0 + 0.001 * f64::from(k % 5)));
        assert!(late.iter().all(|&late| late < 0.14) && late.iter().any(|&late| late > 0.12));
    }

    #[test]
    fn frames_that_were_held_up_are_late_until_they_have_caught_up() {
        for (rate, held_s) in [(30.0, 0.5), (60.0, 1.0), (15.0, 0.4)] {
            // From 20 s on nothing comes for a while, then all that was held up at once.
            let held = 20.0..20.0 + held_s;
            let due: Vec<f64> = (0..(40.0 * rate) as u32).map(|k| f64::from(k) / rate).collect();
            let came = due.iter().map(|s| if held.contains(s) { held.end } else { *s });
            for (late, due) in lateness(came).into_iter().zip(&due) {
                let truly = if held.contains(due) { held.end - due } else { 0.0 };
                assert!(truly < LATE_S + 0.2 * held_s || late > LATE_S, "{rate}: {late} at {due}");
                assert!(held.contains(due) || late < LATE_S, "{rate}: {late} at {due}");
            }
        }
    }

    #[test]
    fn a_rate_that_changes_for_good_is_learned() {
        let late = lateness((0..300).map(|k| f64::from(k) / 30.0).chain((0..300).map(|k| 10.0 + f64::from(k) / 15.0)));
        assert!(late[..300].iter().chain(&late[480..]).all(|&late| late < LATE_S), "{late:?}");
    }

    #[test]
    fn a_slow_loop_is_behind_and_a_held_up_frame_late() {
        let began = Instant::now();
        let at = |s: f64| began + Duration::from_secs_f64(s);
        let source = |frames, dropped| SourceStatus { frames, dropped, ..SourceStatus::default() };
        let mut timing = FrameTiming::new(began);
        (0..50).for_each(|k| timing.measured(at(f64::from(k) / 25.0), 0.03, 0.0, 0.0));
        assert_eq!(timing.status(at(2.0), &source(50, 0)).state, FrameTimingState::Fresh);
        (0..50).for_each(|k| timing.measured(at(2.0 + f64::from(k) / 25.0), 0.04, 0.0, 0.0));
        let status = timing.status(at(4.0), &source(150, 50));
        assert_eq!((status.state, status.dropped), (FrameTimingState::Behind, 0.5));
        assert!(status.sentence.unwrap().contains("40 ms old when they are measured, and 50 % are dropped"));
        timing.measured(at(4.0), 0.04, 0.0, 0.5);
        let status = timing.status(at(4.1), &source(151, 50));
        assert_eq!((status.state, status.late), (FrameTimingState::Late, 1));
        assert!(status.sentence.unwrap().contains("500 ms after they are due"));
        assert_eq!(timing.status(at(6.1), &source(200, 50)).state, FrameTimingState::Fresh);
    }

    #[test]
    fn waiting_for_slow_encoders_is_not_blamed_on_load() {
        let began = Instant::now();
        let mut timing = FrameTiming::new(began);
        (0..50).for_each(|_| timing.measured(began, 0.03, 0.25, 0.0));
        let status = timing.status(began, &SourceStatus::default());
        assert_eq!(status.state, FrameTimingState::Behind);
        let sentence = status.sentence.unwrap();
        assert!(sentence.contains("for the encoder reading") && !sentence.contains("other programs"), "{sentence}");
        (0..50).for_each(|_| timing.measured(began, 0.3, 0.0, 0.0));
        assert!(timing.status(began, &SourceStatus::default()).sentence.unwrap().contains("other programs"));
    }
}
