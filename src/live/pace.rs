//! Whether frames come when they are due, and are measured while they are fresh.
//!
//! A frame is paired with the encoders by the time at which it came. One that was held up on its way shows an earlier
//! moment than that: it is late, and nothing is learned from it. Where frames come in time and the loop alone is slow,
//! the pairing stays right, and all that is wrong is that the answer comes late.

use super::source::SourceStatus;
use serde::Serialize;
use std::time::{Duration, Instant};

/// Nothing is learned from frames that come later than this, s.
pub const LATE_S: f64 = 0.1;
/// Frames that are older when they are measured are not fresh any more, s; nor are they where more than this share is dropped.
const OLD_S: f64 = 0.1;
const MANY_DROPPED: f64 = 0.1;
/// They are fresh again below this part of that.
const FRESH_AGAIN: f64 = 0.7;
/// Over this time drops are counted, and for so long a late frame is spoken of.
const OVER: Duration = Duration::from_secs(2);

/// By how much frames are late, by the rate at which the others come.
///
/// After a gap frames are late until as many have come as were due; what is still missing then was lost on the way, and is
/// forgotten in some seconds.
#[derive(Debug, Default)]
pub struct Schedule {
    last: Option<Instant>,
    /// Time between frames, s.
    period_s: f64,
    frames: u32,
    late_s: f64,
}

impl Schedule {
    /// A frame came; by how much it is late, s.
    pub fn came(&mut self, at: Instant) -> f64 {
        // Frames that first tell the rate, then that it is averaged over; and the time in which a loss is forgotten, s.
        const FIRST: u32 = 20;
        const SMOOTHING: u32 = 150;
        const FORGOTTEN_S: f64 = 0.5;
        let Some(last) = self.last.replace(at) else { return 0.0 };
        let seconds = (at - last).as_secs_f64();
        if self.frames >= FIRST {
            self.late_s = (self.late_s + seconds - self.period_s).max(0.0);
            self.late_s *= (-seconds.min(self.period_s) / FORGOTTEN_S).exp();
        }
        self.frames = (self.frames + 1).min(SMOOTHING);
        // A gap and the burst after it leave the mean as it was.
        self.period_s += (seconds - self.period_s) / f64::from(self.frames);
        self.late_s
    }
}

/// How fresh frames are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PaceState {
    /// They come in time and are measured at once.
    Fresh,
    /// They come in time, but faster than they can be measured: many are dropped, or all are old when they are measured.
    Behind,
    /// They come late from the source: their time is not certain, and nothing is learned from them.
    Late,
}

/// The figures of the pace.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PaceStatus {
    /// The verdict.
    pub state: PaceState,
    /// How old frames are when they are measured, from their arrival, ms; smoothed.
    pub age_ms: f64,
    /// Share of the frames of the last seconds that were dropped.
    pub dropped: f64,
    /// Frames so far that came late and were not learned from.
    pub late: u64,
    /// What is wrong, in words, and what to do.
    pub sentence: Option<String>,
}

impl PaceStatus {
    /// Before the first frame.
    pub fn at_start() -> Self {
        Self { state: PaceState::Fresh, age_ms: 0.0, dropped: 0.0, late: 0, sentence: None }
    }
}

/// Watches the pace.
#[derive(Debug)]
pub struct Pace {
    age_s: f64,
    dropped: f64,
    late: u64,
    late_s: f64,
    last_late: Option<Instant>,
    behind: bool,
    /// When drops were counted last, with the source's counts then.
    counted: (Instant, u64, u64),
}

impl Pace {
    /// Before the first frame.
    pub fn new(now: Instant) -> Self {
        Self { age_s: 0.0, dropped: 0.0, late: 0, late_s: 0.0, last_late: None, behind: false, counted: (now, 0, 0) }
    }

    /// A frame that came `late_s` late was learned from `age_s` after it came.
    pub fn took(&mut self, now: Instant, age_s: f64, late_s: f64) {
        // About so many of the last frames count.
        const SMOOTHING: f64 = 10.0;
        self.age_s += (age_s - self.age_s) / SMOOTHING;
        if late_s > LATE_S {
            self.late += 1;
            self.late_s = late_s;
            self.last_late = Some(now);
        }
    }

    /// The figures now.
    pub fn status(&mut self, now: Instant, source: &SourceStatus) -> PaceStatus {
        let (since, frames, dropped) = self.counted;
        if now - since >= OVER {
            let came = source.frames.saturating_sub(frames);
            self.dropped = source.dropped.saturating_sub(dropped) as f64 / came.max(1) as f64;
            self.counted = (now, source.frames, source.dropped);
            if came == 0 {
                self.age_s = 0.0;
            }
        }
        let age_ms = 1000.0 * self.age_s;
        let part = if self.behind { FRESH_AGAIN } else { 1.0 };
        self.behind = self.age_s > part * OLD_S || self.dropped > part * MANY_DROPPED;
        let (state, sentence) = if self.last_late.is_some_and(|last| now - last < OVER) {
            let late_ms = 1000.0 * self.late_s;
            let sentence = format!(
                "frames come up to {late_ms:.0} ms after they are due: they were held up on their way, their time is not \
                 certain, and nothing is learned from them"
            );
            (PaceState::Late, Some(sentence))
        } else if self.behind {
            let dropped = match 100.0 * self.dropped {
                percent if percent < 1.0 => String::new(),
                percent => format!(", and {percent:.0} % are dropped"),
            };
            let sentence = format!(
                "frames are {age_ms:.0} ms old when they are measured{dropped}; send fewer or smaller ones, or give the machine \
                 less to do beside"
            );
            (PaceState::Behind, Some(sentence))
        } else {
            (PaceState::Fresh, None)
        };
        PaceStatus { state, age_ms, dropped: self.dropped, late: self.late, sentence }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// Lateness of frames that come at these seconds.
    fn lateness(at: impl IntoIterator<Item = f64>) -> Vec<f64> {
        let began = Instant::now();
        let mut schedule = Schedule::default();
        at.into_iter().map(|s| schedule.came(began + Duration::from_secs_f64(s))).collect()
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
        let source = |frames, dropped| SourceStatus { frames, dropped, ..SourceStatus::waiting() };
        let mut pace = Pace::new(began);
        (0..50).for_each(|k| pace.took(at(f64::from(k) / 25.0), 0.03, 0.0));
        assert_eq!(pace.status(at(2.0), &source(50, 0)).state, PaceState::Fresh);
        (0..50).for_each(|k| pace.took(at(2.0 + f64::from(k) / 25.0), 0.04, 0.0));
        let status = pace.status(at(4.0), &source(150, 50));
        assert_eq!((status.state, status.dropped), (PaceState::Behind, 0.5));
        assert!(status.sentence.unwrap().contains("40 ms old when they are measured, and 50 % are dropped"));
        pace.took(at(4.0), 0.04, 0.5);
        let status = pace.status(at(4.1), &source(151, 50));
        assert_eq!((status.state, status.late), (PaceState::Late, 1));
        assert!(status.sentence.unwrap().contains("500 ms after they are due"));
        assert_eq!(pace.status(at(6.1), &source(200, 50)).state, PaceState::Fresh);
    }
}
