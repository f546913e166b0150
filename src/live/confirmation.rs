//! Whether what is commanded by is still confirmed: how long ago a frame was measured that has an encoder reading.
//!
//! A table stays right while nobody looks, or becomes wrong: nothing tells. A camera that was pushed, a lens cap, a cable that was pulled and a loop
//! that is paused are all noticed by the same rule.

use super::silence::PATIENCE;
use crate::observation::Status;
use crate::statistics::order::median;
use crate::verdict::Code;
use std::collections::VecDeque;
use std::time::Instant;

/// A time without a measurement is not told if it is shorter than [`PATIENCE`], or than so many usual steps from one measurement to the next. Convention: two frames of a slow camera may fail.
const STEPS: f64 = 3.0;
/// Steps whose median is the usual one. Convention: few, so that another rate is the usual one after some frames.
const USUAL: usize = 9;

/// When frames were measured, and what came in place of measurements.
#[derive(Debug, Clone, Default)]
pub struct Confirmation {
    /// The last measurements that had a reading, oldest first.
    measured: VecDeque<Instant>,
    /// The last frame that gave none, and its status.
    failed: Option<(Instant, Status)>,
    /// The end of the run, after which nothing is expected.
    ended: Option<Instant>,
}

impl Confirmation {
    /// Takes a frame that came now, and whether its measurement has a reading that could be used.
    pub fn add(&mut self, now: Instant, status: &Status, is_sample: bool) {
        if !is_sample {
            self.failed = Some((now, status.clone()));
            return;
        }
        if self.measured.len() > USUAL {
            self.measured.pop_front();
        }
        self.measured.push_back(now);
    }

    /// Notes the end of the run.
    pub fn end(&mut self, now: Instant) {
        self.ended = Some(now);
    }

    /// Why nothing confirms what is commanded by, if that is so.
    pub fn doubt(&self, now: Instant) -> Option<(Code, String)> {
        let now = self.ended.unwrap_or(now);
        let Some(&last) = self.measured.back() else {
            return Some((Code::NothingToJudge, "no frame was measured yet that has an encoder reading".into()));
        };
        let steps = self.measured.iter().zip(self.measured.iter().skip(1));
        let usual_s = median(&mut steps.map(|(one, next)| (*next - *one).as_secs_f64()).collect::<Vec<_>>());
        let silent_s = now.saturating_duration_since(last).as_secs_f64();
        if silent_s <= PATIENCE.as_secs_f64().max(STEPS * usual_s) {
            return None;
        }
        let fails = self.failed.as_ref().filter(|(at, _)| *at > last && now.saturating_duration_since(*at) <= PATIENCE);
        Some(match fails {
            None => (Code::NothingToJudge, format!("no frame was measured for {silent_s:.0} s")),
            Some((_, Status::Ok)) => {
                (Code::NothingToJudge, format!("no measured frame had an encoder reading for {silent_s:.0} s"))
            }
            Some((_, status)) => {
                let code = match status {
                    Status::CameraMoved | Status::BaseMoved | Status::GridLost => Code::RigDrift,
                    _ => Code::ManyNotMeasured,
                };
                let (meaning, _) = status.explained();
                (code, format!("no frame was measured for {silent_s:.0} s ({status}: {meaning})"))
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    /// A run of frames at a step, s, then `silence_s` without a measurement, in which frames of a status come.
    fn after(step_s: f64, silence_s: f64, instead: Option<Status>) -> Option<(Code, String)> {
        let began = Instant::now();
        let at = |seconds: f64| began + Duration::from_secs_f64(seconds);
        let mut confirmation = Confirmation::default();
        let frames = 20;
        (0..frames).for_each(|k| confirmation.add(at(f64::from(k) * step_s), &Status::Ok, true));
        let last_s = f64::from(frames - 1) * step_s;
        let failed = (1..).map(|k| f64::from(k) * step_s).take_while(|seconds| *seconds < silence_s);
        if let Some(status) = instead {
            failed.for_each(|seconds| confirmation.add(at(last_s + seconds), &status, false));
        }
        confirmation.doubt(at(last_s + silence_s))
    }

    #[test]
    fn what_comes_in_place_of_measurements_is_told_after_three_seconds() {
        for (instead, code, word) in [
            (None, Code::NothingToJudge, "no frame was measured for 4 s"),
            (Some(Status::Ok), Code::NothingToJudge, "no measured frame had an encoder reading"),
            (Some(Status::CameraMoved), Code::RigDrift, "(camera_moved: "),
            (Some(Status::Occluded), Code::ManyNotMeasured, "(occluded: "),
        ] {
            assert_eq!(after(0.1, 2.9, instead.clone()), None);
            let (found, text) = after(0.1, 4.0, instead).unwrap();
            assert!(found == code && text.contains(word), "{text}");
        }
        assert_eq!(Confirmation::default().doubt(Instant::now()).unwrap().0, Code::NothingToJudge);
    }

    #[test]
    fn a_slow_camera_is_given_its_time_and_a_run_that_is_over_is_left_as_it_was() {
        assert_eq!(after(5.0, 14.0, None), None);
        assert!(after(5.0, 16.0, None).is_some());
        let now = Instant::now();
        let mut confirmation = Confirmation::default();
        confirmation.add(now, &Status::Ok, true);
        confirmation.end(now + Duration::from_secs(1));
        assert_eq!(confirmation.doubt(now + Duration::from_secs(1000)), None);
    }
}
