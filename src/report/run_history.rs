//! The history of a run as its report shows it: all rows of a short run, of a long one a part that does not grow with it.

use super::decimation::keeps;
use crate::estimate::{EstimateRow, Verdict};
use crate::observation::{Measurement, Status};

/// Rows that are plotted. Convention: a display choice.
const PLOTTED: usize = 1000;
/// Rows in each of the lists. Convention: a display choice.
const LISTED: usize = 500;
/// Frames that are pictured, spread over the run, and as many at most of those that failed. Convention: a display choice.
const PICTURED: usize = 24;

/// The rows of a run that its report shows.
#[derive(Debug, Clone)]
pub struct RunHistory {
    /// Rows spread over the run: the measurement, and the estimate after it.
    pub plotted: Vec<(Measurement, EstimateRow)>,
    /// The first frames that could not be measured.
    pub unmeasured: Vec<Measurement>,
    /// How many there were of them.
    pub unmeasured_count: usize,
    /// The first measurements that the estimator did not use.
    pub unused: Vec<(Measurement, EstimateRow)>,
    /// How many there were of them.
    pub unused_count: usize,
    /// Frames to be pictured: some that are spread over the run, and the first that failed.
    pub pictured: Vec<Measurement>,
}

impl RunHistory {
    /// Of the rows of a run, each a measurement and what the estimator made of it.
    pub fn of(measurements: &[Measurement], rows: &[EstimateRow]) -> Self {
        let count = measurements.len();
        let all = || measurements.iter().zip(rows);
        let of_pair = |(measurement, row): (&Measurement, &EstimateRow)| (measurement.clone(), row.clone());
        let plotted = all().enumerate().filter(|(rank, _)| keeps(*rank, PLOTTED, count));
        let failed = |measurement: &&Measurement| measurement.status != Status::Ok;
        let is_unused = |(measurement, row): &(&Measurement, &EstimateRow)| {
            row.verdict != Verdict::Used && measurement.measured.is_some()
        };
        let mut failures = 0;
        let pictured = measurements.iter().enumerate().filter(|(rank, measurement)| {
            failures += usize::from(failed(measurement));
            failed(measurement) && failures <= PICTURED || keeps(*rank, PICTURED, count)
        });
        Self {
            plotted: plotted.map(|(_, pair)| of_pair(pair)).collect(),
            unmeasured: measurements.iter().filter(failed).take(LISTED).cloned().collect(),
            unmeasured_count: measurements.iter().filter(failed).count(),
            unused: all().filter(is_unused).take(LISTED).map(of_pair).collect(),
            unused_count: all().filter(is_unused).count(),
            pictured: pictured.map(|(_, measurement)| measurement.clone()).collect(),
        }
    }
}

/// Whether a frame of this rank is drawn for the report: all that failed, and some spread over the run; the first ones where the
/// number of frames is not known beforehand.
pub fn is_drawn(measurement: &Measurement, rank: usize, count: Option<usize>) -> bool {
    let sampled = count.map_or(rank < PICTURED, |count| keeps(rank, PICTURED, count));
    sampled || measurement.status != Status::Ok
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(count: u64) -> RunHistory {
        let measurement = |index| {
            let status = if index % 3 == 0 { Status::NoSnake } else { Status::Ok };
            Measurement { index, time_s: None, status, measured: None, quality: None, view: None }
        };
        let row = |index| EstimateRow {
            index,
            time_s: None,
            estimate: None,
            verdict: Verdict::Skipped,
            reason: String::new(),
            residual_mm: None,
            view: None,
        };
        let (measurements, rows): (Vec<_>, Vec<_>) = (0..count).map(|index| (measurement(index), row(index))).unzip();
        RunHistory::of(&measurements, &rows)
    }

    #[test]
    fn a_short_run_is_shown_whole_and_a_long_one_in_part() {
        let short = rows(20);
        assert_eq!((short.plotted.len(), short.unmeasured.len(), short.pictured.len()), (20, 7, 20));
        let long = rows(30_000);
        assert_eq!((long.plotted.len(), long.unmeasured.len(), long.unmeasured_count), (PLOTTED, LISTED, 10_000));
        assert!(long.pictured.len() <= 2 * PICTURED && long.pictured.len() >= PICTURED);
        assert!(long.pictured.iter().all(|m| is_drawn(m, m.index as usize, Some(30_000))));
        let gaps: Vec<u64> = long.plotted.windows(2).map(|pair| pair[1].0.index - pair[0].0.index).collect();
        assert!(gaps.iter().all(|&gap| gap == 30));
    }
}
