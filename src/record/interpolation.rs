//! Readings at the times of frames, from readings at other times: on the line between the two around, where the motion allows it.
//!
//! How far a reading on that line may be off is what the readings themselves show: each is compared with the line between others as far
//! apart as the gap (leave-one-out cross-validation). A gap is bridged where nine of ten of these errors, as they are for the gap's length, are
//! harmless, or where the readings at its two ends agree, as those of a driver that publishes only changes do.

use super::table::{Fault, Warning};
use crate::observation::EncoderReading;
use crate::robot::PerBackbone;
use crate::statistics::order::quantile;
use std::collections::HashMap;
use std::path::Path;

/// What an interpolated reading may be off by, as a share of the range that the readings go through.
///
/// Convention: half the range bends a snake to about 90°, so that this is below 2° at the worst, and mostly far below.
const TOLERANCE: f64 = 0.02;
/// What is harmless however small that range is, mm.
///
/// Convention: below a degree of bend (0.026 mm a degree with Table I); readings of a snake at rest go through their noise alone.
const HARMLESS_MM: f64 = 0.02;
/// The share of the errors that must be harmless.
///
/// Convention: a tenth may be corners of the motion.
const SHARE: f64 = 0.9;
/// The fewest readings with a gap like one that is to be bridged on both sides.
///
/// Convention: fewer say nothing of a share of nine in ten.
const LEAST_TRIPLES: usize = 3;

/// The readings of one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stamped {
    /// s.
    pub time_s: f64,
    /// One for each backbone.
    pub q: PerBackbone,
}

/// Readings matched to frames by time.
#[derive(Debug, Clone, PartialEq)]
pub struct Matched {
    /// One for each frame that has one, in order of their index.
    pub readings: Vec<EncoderReading>,
    /// What keeps others from it.
    pub warnings: Vec<Warning>,
}

impl Matched {
    /// Readings from `what` in a file, at the times of frames by their index.
    pub fn of(path: &Path, what: &str, rows: Vec<Stamped>, stamps_s: &[(u64, f64)]) -> Self {
        let series = (0..rows.first().map_or(0, |row| row.q.len()))
            .map(|i| rows.iter().map(|row| (row.time_s, row.q[i])).collect())
            .collect();
        Self::of_series(path, what, series, stamps_s)
    }

    /// The same from a series of times and values, mm, for each backbone, which need not have the same times.
    pub fn of_series(path: &Path, what: &str, series: Vec<Vec<(f64, f64)>>, stamps_s: &[(u64, f64)]) -> Self {
        let warning = |message: String, fault: Fault| Warning { path: path.to_owned(), line: None, message, fault };
        let range = |times: &mut dyn Iterator<Item = f64>| {
            times.fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), time| (least.min(time), most.max(time)))
        };
        let (first, last) = range(&mut series.iter().flatten().map(|(time_s, _)| *time_s));
        let (from, to) = range(&mut stamps_s.iter().map(|(_, time_s)| *time_s));
        let mut warnings = Vec::new();
        let count = series.iter().map(Vec::len).max().unwrap_or(0);
        if !stamps_s.is_empty() && (first > to || last < from || (first == last && count > 1)) {
            let unset = |least: f64, most: f64| if least == most { " (its driver does not set them)" } else { "" };
            warnings.push(warning(
                format!(
                    "the stamps of {what} go from {first:.3} to {last:.3} s{}, those of frames and poses from {from:.3} to {to:.3} s{}: \
                     they come from two clocks, so that no frame has a reading",
                    unset(first, last),
                    unset(from, to)
                ),
                Fault::Clock,
            ));
            return Self { readings: Vec::new(), warnings };
        }
        let mut contradictions = Contradictions::default();
        let series: Vec<Vec<(f64, f64)>> = series.into_iter().map(|one| contradictions.taken_out(one)).collect();
        warnings.extend(contradictions.told(what).map(|message| warning(message, Fault::Contradiction)));
        let mut interpolation = Interpolation::new(series);
        let reading = |&(index, time_s): &(u64, f64)| {
            interpolation.at(time_s).map(|q_mm| EncoderReading::new(index, time_s, q_mm))
        };
        Self { readings: stamps_s.iter().filter_map(reading).collect(), warnings }
    }
}

/// Moments of which two readings say different things.
#[derive(Default)]
struct Contradictions {
    count: usize,
    all: usize,
    first: Option<(f64, f64, f64)>,
}

impl Contradictions {
    /// A series in order of time, each time once, without those that contradict each other.
    fn taken_out(&mut self, mut series: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
        series.retain(|(time_s, value)| time_s.is_finite() && value.is_finite());
        series.sort_by(|(one, _), (other, _)| one.total_cmp(other));
        let mut kept = Vec::with_capacity(series.len());
        let (mut count, mut all) = (0, 0);
        for moment in series.chunk_by(|(one, _), (other, _)| one == other) {
            all += 1;
            let (time_s, value) = moment[0];
            match moment.iter().find(|(_, other)| *other != value) {
                None => kept.push((time_s, value)),
                Some((_, other)) => {
                    count += 1;
                    self.first.get_or_insert((time_s, value, *other));
                }
            }
        }
        if count > self.count {
            (self.count, self.all) = (count, all);
        }
        kept
    }

    fn told(&self, what: &str) -> Option<String> {
        let (time_s, one, other) = self.first?;
        let Self { count, all, .. } = self;
        Some(format!(
            "{what} has two different values for {count} of {all} moments (at {time_s:.3} s {one} and {other}), as if two programs \
             sent it; neither is used"
        ))
    }
}

/// Readings over time between which lines are drawn as far as the motion allows it.
pub(crate) struct Interpolation {
    backbones: Vec<Backbone>,
}

impl Interpolation {
    /// Of the times, s, and values, mm, of each backbone, in order of time and each time once.
    pub fn new(series: Vec<Vec<(f64, f64)>>) -> Self {
        Self { backbones: Backbone::all(series) }
    }

    /// Of readings of all backbones at the same times.
    #[cfg(feature = "live")]
    pub fn of<'a>(readings: impl Iterator<Item = &'a (f64, PerBackbone)> + Clone) -> Self {
        let backbones = readings.clone().next().map_or(0, |(_, q_mm)| q_mm.len());
        let of = |i: usize| readings.clone().map(|(time_s, q_mm)| (*time_s, q_mm[i])).collect();
        Self::new((0..backbones).map(of).collect())
    }

    /// The readings at a time, s; `None` beyond the ends, and in a gap in which they may have been otherwise, and where there are none.
    pub fn at(&mut self, time_s: f64) -> Option<PerBackbone> {
        if self.backbones.is_empty() {
            return None;
        }
        let q_mm: Option<Vec<f64>> = self.backbones.iter_mut().map(|backbone| backbone.at(time_s)).collect();
        PerBackbone::of(&q_mm?)
    }
}

/// The values of a series before and after a time, s; both the same one if it has that very time.
pub(crate) struct Neighbouring {
    earlier: (f64, f64),
    later: (f64, f64),
}

impl Neighbouring {
    /// Those around a time of a series of times and values in order, given by its elements and the position of the first that is not before
    /// that time; `None` beyond its ends.
    pub fn of(after: usize, get: impl Fn(usize) -> Option<(f64, f64)>, time_s: f64) -> Option<Self> {
        let later = get(after)?;
        let earlier = if later.0 == time_s { later } else { get(after.checked_sub(1)?)? };
        Some(Self { earlier, later })
    }

    /// The time between them, s.
    pub fn gap_s(&self) -> f64 {
        self.later.0 - self.earlier.0
    }

    /// By how much they differ.
    fn difference(&self) -> f64 {
        (self.later.1 - self.earlier.1).abs()
    }

    /// The value on the line through both, at that time.
    pub fn at(&self, time_s: f64) -> f64 {
        if self.later.0 == time_s {
            return self.later.1;
        }
        let share = (time_s - self.earlier.0) / self.gap_s();
        self.earlier.1 * (1.0 - share) + self.later.1 * share
    }
}

/// One backbone's readings in order of time.
struct Backbone {
    series: Vec<(f64, f64)>,
    tolerance: f64,
    /// By the power of two below a gap's length: the squared time that makes the errors 1, where enough readings tell.
    errors: HashMap<i32, Option<f64>>,
}

impl Backbone {
    fn all(series: Vec<Vec<(f64, f64)>>) -> Vec<Self> {
        let range = |one: &Vec<(f64, f64)>| {
            let values = || one.iter().map(|(_, value)| *value);
            values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
        };
        let tolerance = (TOLERANCE * series.iter().map(range).fold(0.0, f64::max)).max(HARMLESS_MM);
        series.into_iter().map(|series| Self { series, tolerance, errors: HashMap::new() }).collect()
    }

    /// The reading at a time.
    fn at(&mut self, time_s: f64) -> Option<f64> {
        let after = self.series.partition_point(|(stamp_s, _)| *stamp_s < time_s);
        let around = Neighbouring::of(after, |k| self.series.get(k).copied(), time_s)?;
        (around.difference() <= self.tolerance || self.is_bridged(around.gap_s())).then(|| around.at(time_s))
    }

    /// Whether the line over a gap of this length is as good as the readings.
    fn is_bridged(&mut self, gap_s: f64) -> bool {
        let power = gap_s.log2().floor() as i32;
        if !self.errors.contains_key(&power) {
            let error = self.error_per_square(2f64.powi(power) / 2.0);
            self.errors.insert(power, error);
        }
        let error = self.errors.get(&power).copied().flatten();
        error.is_some_and(|error| error * gap_s * gap_s <= self.tolerance)
    }

    /// How far readings lie from the line between those at least so long before and after, in the middle and per square of the time
    /// between them: what [`SHARE`] of them do not exceed.
    ///
    /// Derived: at a constant acceleration a the line over a gap T is off by a/2 · s(1 − s) T² at the share s of the gap, and in the middle by
    /// a/8 · T².
    fn error_per_square(&self, aside_s: f64) -> Option<f64> {
        let series = &self.series;
        let error = |i: usize| {
            let (time_s, value) = series[i];
            let before = series.partition_point(|(stamp_s, _)| *stamp_s <= time_s - aside_s).checked_sub(1)?;
            let (one, other) =
                (series[before], *series.get(series.partition_point(|(stamp_s, _)| *stamp_s < time_s + aside_s))?);
            let span_s = other.0 - one.0;
            let share = (time_s - one.0) / span_s;
            let off = (value - one.1 * (1.0 - share) - other.1 * share).abs();
            Some(off / (4.0 * share * (1.0 - share)) / (span_s * span_s))
        };
        let mut errors: Vec<f64> = (0..series.len()).filter_map(error).collect();
        (errors.len() >= LEAST_TRIPLES).then(|| quantile(&mut errors, SHARE))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matched(series: Vec<(f64, f64)>, stamps_s: &[f64]) -> Matched {
        let stamps: Vec<(u64, f64)> = (0..).zip(stamps_s.iter().copied()).collect();
        Matched::of_series(Path::new("run.mcap"), "/joint_states", vec![series], &stamps)
    }

    /// What a joint does: 3 sin t, up to 3 per second.
    fn motion(time_s: f64) -> f64 {
        3.0 * time_s.sin()
    }

    #[test]
    fn bursts_are_bridged_as_evenly_spaced_readings_are() {
        // Three messages within a millisecond, ten times a second: the usual distance is that within a burst.
        let bursts = (0..100).flat_map(|k| [0.0, 0.0005, 0.001].map(|late| 0.1 * f64::from(k) + late));
        let log: Vec<(f64, f64)> = bursts.map(|time_s| (time_s, motion(time_s))).collect();
        let stamps: Vec<f64> = (0..90).map(|k| 0.05 + 0.1 * f64::from(k)).collect();
        let found = matched(log, &stamps);
        assert_eq!(found.readings.len(), 90);
        for reading in &found.readings {
            assert!((reading.q_mm[0] - motion(reading.time_s)).abs() < 0.01, "{reading:?}");
        }
    }

    #[test]
    fn a_gap_is_bridged_where_nothing_moved_and_not_where_it_did() {
        let all = (0..200).map(|k| 0.05 * f64::from(k));
        let with_gap = |motion: fn(f64) -> f64| {
            all.clone().filter(|t| !(3.01..5.99).contains(t)).map(|t| (t, motion(t))).collect::<Vec<_>>()
        };
        let found = matched(with_gap(motion), &[2.0, 4.5, 7.0]);
        assert_eq!(found.readings.iter().map(|r| r.index).collect::<Vec<_>>(), [0, 2]);
        // A driver that publishes changes only, at rest meanwhile.
        let found = matched(with_gap(|t| motion(t.clamp(0.0, 3.0) + (t - 6.0).max(0.0))), &[2.0, 4.5, 7.0]);
        assert_eq!(found.readings.len(), 3);
        assert!((found.readings[1].q_mm[0] - motion(3.0)).abs() < 0.06);
    }

    #[test]
    fn noise_of_a_snake_at_rest_is_no_motion() {
        let log: Vec<(f64, f64)> = (0..100).map(|k| (0.1 * f64::from(k), 1.0 + 0.002 * f64::from(k % 2))).collect();
        assert_eq!(matched(log, &[0.35, 4.55]).readings.len(), 2);
    }

    #[test]
    fn readings_that_contradict_each_other_at_one_moment_are_not_used() {
        let mut log: Vec<(f64, f64)> = (0..100).map(|k| (0.1 * f64::from(k), motion(0.1 * f64::from(k)))).collect();
        log.extend(log[..50].to_vec());
        assert_eq!(matched(log.clone(), &[2.0, 4.05]).readings.len(), 2, "the same twice is once");
        log.extend(log[1..99].iter().map(|(time_s, _)| (*time_s, -9.0)).collect::<Vec<_>>());
        let found = matched(log, &[2.0, 4.05]);
        assert!(found.readings.is_empty(), "{found:?}");
        assert!(
            found.warnings[0].message.contains("/joint_states has two different values for 98 of 100 moments"),
            "{found:?}"
        );
    }

    #[test]
    fn two_clocks_are_told_with_both() {
        let log = |offset: f64| (0..10).map(|k| (offset + f64::from(k), 1.0)).collect::<Vec<_>>();
        let said = |found: Matched| found.warnings[0].message.clone();
        let other = said(matched(log(1.7e9), &[0.0, 5.0]));
        assert!(
            other.contains("from 1700000000.000 to 1700000009.000 s, those of frames and poses from 0.000 to 5.000 s"),
            "{other}"
        );
        let unset = said(matched(vec![(0.0, 1.0), (0.0, 2.0)], &[0.0, 5.0]));
        assert!(unset.contains("from 0.000 to 0.000 s (its driver does not set them)"), "{unset}");
    }
}
