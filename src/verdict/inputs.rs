//! Whether there is anything to judge, and whether the times mean what they are taken for.
//!
//! The unit of the times is told by how fast the snake bends by them: θ and δ are angles whatever the log is kept in, so that their path over
//! the time between is a speed that a factor of a thousand takes out of all that such robots do.

use super::evidence::Evidence;
use super::reason::{Code, Level, Reason};
use crate::estimate::MOST_JUDGED;
use crate::geometry::Configuration;
use crate::observation::{EncoderReading, Measurement, Status};
use crate::statistics::order::median;
use nalgebra::Vector2;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

/// How fast such a snake bends on the average of a run, with all its pauses, degrees per second.
///
/// Convention: from 60° in 20 minutes to 60° in 6 ms. A unit that is wrong by a thousand takes a robot out of it that bends by 0.05 to 50° a
/// second; slower runs are doubted until `time_unit` is written down.
const SPEEDS_DEG_PER_S: RangeInclusive<f64> = 0.05..=1e4;
/// Units that times are kept in besides seconds, s, with their names and how `[log]` calls them.
///
/// Derived: thousandths of each other.
const UNITS: [(f64, &str, &str); 3] =
    [(1e-3, "milliseconds", "ms"), (1e-6, "microseconds", "us"), (1e-9, "nanoseconds", "ns")];
/// By how much the log's clock may run faster or slower than the frames', as a factor.
///
/// Convention: a video's rate is often stated wrongly, 25 for 30 frames a second; a log of another numbering is off by more.
const RATES: RangeInclusive<f64> = 0.5..=2.0;
/// Fewer steps than these say nothing of a clock.
///
/// Convention: a median of three bears one outlier.
const LEAST_STEPS: usize = 3;

/// That nothing was measured, or nothing read: a verdict on nothing is not good.
pub(super) fn nothing_to_judge(evidence: &Evidence, log: &[EncoderReading]) -> Option<Reason> {
    let (text, remedy) = match (evidence.frames, log.is_empty()) {
        (0, _) => {
            ("there is not one frame or pose to judge", "look whether frames and poses are where experiment.toml says")
        }
        (_, true) => (
            "there is not one encoder reading: nothing was learned, and nothing says whether the angles agree with the robot",
            "give the log of the encoders; `snakeloop check` says what it lacks",
        ),
        _ => return None,
    };
    Some(Reason::new(Code::NothingToJudge, Level::DoNotUse, text, remedy))
}

/// What is odd about the times of measurements and of the log that belongs to them. `unit_is_stated` says that somebody wrote the unit down.
pub fn doubts_of_times(measurements: &[Measurement], log: &[EncoderReading], unit_is_stated: bool) -> Option<Reason> {
    let measurements = &measurements[..measurements.len().min(MOST_JUDGED)];
    let times_s: BTreeMap<u64, f64> = log.iter().map(|reading| (reading.index, reading.time_s)).collect();
    if let Some(reason) = other_rate(measurements, &times_s) {
        return Some(reason);
    }
    if unit_is_stated { None } else { odd_speed(measurements, &times_s) }
}

/// Steps of the log's time that are not those of the frames' own.
fn other_rate(measurements: &[Measurement], times_s: &BTreeMap<u64, f64>) -> Option<Reason> {
    let pairs: Vec<(f64, f64)> =
        measurements.iter().filter_map(|m| Some((m.time_s?, *times_s.get(&m.index)?))).collect();
    let ratio = |pair: &[(f64, f64)]| {
        Some((pair[1].1 - pair[0].1) / (pair[1].0 - pair[0].0)).filter(|r| *r > 0.0 && r.is_finite())
    };
    let mut ratios: Vec<f64> = pairs.windows(2).filter_map(ratio).collect();
    if ratios.len() < LEAST_STEPS {
        return None;
    }
    let ratio = median(&mut ratios);
    if RATES.contains(&ratio) {
        return None;
    }
    if let Some((_, name, key)) = UNITS.iter().find(|(seconds, ..)| RATES.contains(&(ratio * seconds))) {
        let text = format!(
            "the log's times grow {ratio:.3e} times as fast as the frames': they are in {name}, and are taken for seconds"
        );
        return Some(Reason::new(Code::TimeUnit, Level::DoNotUse, text, unit_remedy(key)));
    }
    let text = format!(
        "the log's time grows {ratio:.3} times as fast as that of the frames with the same index: the log's index is not the frame's number, or \
         one of the clocks is wrong"
    );
    let remedy = "match the rows by time: under [log] of experiment.toml name the column of `time` and leave `index` out; or number the rows as \
                  the frames are";
    Some(Reason::new(Code::Clock, Level::DoNotUse, text, remedy))
}

/// A bend that is far too slow or too fast by the log's times.
fn odd_speed(measurements: &[Measurement], times_s: &BTreeMap<u64, f64>) -> Option<Reason> {
    let bend = |m: &Measurement| -> Option<(f64, Vector2<f64>)> {
        let measured = m.measured.filter(|_| m.status == Status::Ok)?;
        let time_s = times_s.get(&m.index).copied().or(m.time_s)?;
        Some((time_s, bend_deg(measured.configuration)))
    };
    let mut bends: BTreeMap<Option<&str>, Vec<(f64, Vector2<f64>)>> = BTreeMap::new();
    for (found, view) in measurements.iter().filter_map(|m| Some((bend(m)?, m.view.as_deref()))) {
        bends.entry(view).or_default().push(found);
    }
    let (mut path_deg, mut time_s, mut steps) = (0.0, 0.0, Vec::new());
    for pair in bends.values().flat_map(|bends| bends.windows(2)).filter(|pair| pair[1].0 > pair[0].0) {
        path_deg += (pair[1].1 - pair[0].1).norm();
        time_s += pair[1].0 - pair[0].0;
        steps.push(pair[1].0 - pair[0].0);
    }
    let speed = path_deg / time_s;
    if steps.len() < LEAST_STEPS || path_deg == 0.0 || SPEEDS_DEG_PER_S.contains(&speed) {
        return None;
    }
    let step_s = median(&mut steps);
    let unit = UNITS.iter().find(|(seconds, ..)| SPEEDS_DEG_PER_S.contains(&(speed / seconds)));
    let (what, remedy) = match unit {
        Some((_, name, key)) => (format!("time_s looks as if in {name}"), unit_remedy(key)),
        None => (
            "time_s is in no unit that makes sense".to_owned(),
            "write seconds into time_s, or say under [log] of experiment.toml what the log has: time_unit = \"s\", \"ms\", \"us\" or \"ns\"".to_owned(),
        ),
    };
    let text = format!(
        "{what}: as seconds, a row every {step_s:.3e} s, the snake bends by {speed:.1e}° a second on the average, and such robots by \
         {}° to {:.0e}°",
        SPEEDS_DEG_PER_S.start(),
        SPEEDS_DEG_PER_S.end()
    );
    Some(Reason::new(Code::TimeUnit, Level::Look, text, remedy))
}

fn unit_remedy(key: &str) -> String {
    format!(
        "write [log] with time_unit = {key:?} into experiment.toml, or call the column time_{key}; if it is in seconds all the same, time_unit = \"s\" \
         says so; η and λ do not depend on it, what `discover` finds does"
    )
}

/// The bend vector, degrees.
fn bend_deg(configuration: Configuration) -> Vector2<f64> {
    configuration.bend_vector().map(f64::to_degrees)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation::Measured;
    use crate::robot::PerBackbone;

    /// A snake that bends to and fro once in 20 s, seen `rate` times a second; its times are kept in a unit of `seconds`.
    fn run(rate: f64, seconds: f64) -> (Vec<Measurement>, Vec<EncoderReading>) {
        let at = |k: u64| k as f64 / rate;
        let measurement = |k: u64| {
            let theta_deg = 40.0 + 30.0 * (at(k) / 3.0).sin();
            let measured = Measured::independent(Configuration::from_degrees(theta_deg, 20.0), 0.002, 0.01, 0.0);
            let time_s = Some(at(k) / seconds);
            Measurement { index: k, time_s, status: Status::Ok, measured: Some(measured), quality: None, view: None }
        };
        let reading = |k: u64| EncoderReading::new(k, at(k) / seconds, PerBackbone::repeat(3, 0.0));
        ((0..200).map(measurement).collect(), (0..200).map(reading).collect())
    }

    #[test]
    fn a_unit_is_told_at_any_rate_and_seconds_are_left_alone() {
        for rate in [0.5, 2.0, 30.0, 120.0] {
            let (measurements, log) = run(rate, 1.0);
            assert_eq!(doubts_of_times(&measurements, &log, false), None, "{rate}/s");
            for (seconds, name, key) in UNITS {
                let (measurements, log) = run(rate, seconds);
                let found = doubts_of_times(&measurements, &log, false).unwrap();
                assert!(found.code == Code::TimeUnit && found.text.contains(name), "{rate}/s {name}: {found:?}");
                assert!(found.remedy.contains(&format!("time_unit = {key:?}")), "{found:?}");
                assert_eq!(doubts_of_times(&measurements, &log, true), None);
            }
        }
    }

    #[test]
    fn frames_with_a_clock_of_their_own_tell_the_unit_for_certain_and_another_numbering() {
        let (measurements, _) = run(30.0, 1.0);
        let (_, in_ms) = run(30.0, 1e-3);
        let found = doubts_of_times(&measurements, &in_ms, true).unwrap();
        assert!(found.level == Level::DoNotUse && found.text.contains("in milliseconds"), "{found:?}");
        // A row at every 10 ms, counted from 0 as the frames are.
        let (_, counted) = run(100.0, 1.0);
        let found = doubts_of_times(&measurements, &counted, false).unwrap();
        assert!(found.code == Code::Clock && found.text.contains("0.300 times as fast"), "{found:?}");
    }
}
