//! Whether the encoders are alive: columns that stand still, columns that repeat another, readings that freeze.

use super::evidence::Sample;
use super::reason::{Code, Level, Reason};
use crate::estimate::bend_covariance;
use crate::robot::Robot;
use crate::statistics::moments::standard_deviation;
use nalgebra::Vector2;

/// A column stands still where its spread is less than this share of what the bends seen ask of it, measured by the column for which
/// that share is largest.
///
/// Convention: a tenth. The ratio of variances is then 100, which two samples of one spread exceed with a probability below 0.002 from four
/// samples on (F distribution with 3 and 3 degrees of freedom).
const STILL: f64 = 0.1;
/// Fewer samples than this say nothing of spreads. Convention: see [`STILL`].
const LEAST_SAMPLES: usize = 4;
/// The bend has moved where it changed by more than so many standard deviations.
///
/// Derived: the gate's 4.5, which noise exceeds once in 20,000 steps.
const MOVED_SDS: f64 = 4.5;
/// So many steps in which the bend moved and no reading changed at all. Convention: one could be a single wrong measurement.
const LEAST_FROZEN: usize = 2;

/// What is wrong with the encoders.
pub(super) fn stuck(robot: &Robot, samples: &[Sample]) -> Option<Reason> {
    let text = columns_stuck(robot, samples).or_else(|| frozen(samples))?;
    let remedy =
        "repair or reconnect the encoder and log its readings anew; nothing that was learned from these can be used";
    Some(Reason::new(Code::EncoderStuck, Level::DoNotUse, text, remedy))
}

/// Columns whose readings stand still while the snake moves, or repeat another column's.
fn columns_stuck(robot: &Robot, samples: &[Sample]) -> Option<String> {
    if samples.len() < LEAST_SAMPLES {
        return None;
    }
    let by_bend = robot.displacement_by_bend();
    let count = robot.backbone_count();
    let spread = |value: &dyn Fn(&Sample) -> f64| standard_deviation(&samples.iter().map(value).collect::<Vec<_>>());
    let asked = |column: Vector2<f64>| spread(&|s: &Sample| column.dot(&s.measured.configuration.bend_vector()));
    let noise = samples.iter().map(|s| s.measured.sigma_theta).sum::<f64>() / samples.len() as f64;
    // What noise of the eye alone asks for is no motion.
    let least_asked = robot.backbone_circle_radius_mm * noise * MOVED_SDS;
    let share = |i: usize| (spread(&|s: &Sample| s.q_mm[i]), asked(by_bend[i]));
    let shares: Vec<Option<f64>> =
        (0..count).map(share).map(|(own, asked)| (asked > least_asked).then(|| own / asked)).collect();
    let largest = shares.iter().flatten().copied().fold(0.0, f64::max);
    let still: Vec<String> = (0..count)
        .filter(|&i| shares[i].is_some_and(|share| share <= STILL * largest))
        .map(|i| format!("q{}", i + 1))
        .collect();
    if !still.is_empty() {
        let verb = if still.len() == 1 { "stands" } else { "stand" };
        return Some(format!("{} {verb} still while the snake moves", still.join(", ")));
    }
    let pairs = (0..count).flat_map(|i| (0..i).map(move |j| (j, i)));
    let mut same = pairs.filter(|&(j, i)| {
        let (own, asked) = (spread(&|s: &Sample| s.q_mm[i] - s.q_mm[j]), asked(by_bend[i] - by_bend[j]));
        asked > least_asked && own <= STILL * largest * asked
    });
    let (j, i) = same.next()?;
    Some(format!("q{} repeats q{}: the snake's motion asks for different readings", i + 1, j + 1))
}

/// Readings that do not change at all while the bend moves.
fn frozen(samples: &[Sample]) -> Option<String> {
    let moved = |a: &Sample, b: &Sample| {
        let [from, to] = [a, b].map(|sample| sample.measured.configuration);
        let covariance = bend_covariance(&a.measured, from) + bend_covariance(&b.measured, to);
        let step = to.bend_vector() - from.bend_vector();
        covariance.cholesky().is_some_and(|factor| step.dot(&factor.solve(&step)) > MOVED_SDS.powi(2))
    };
    let is_frozen = |pair: &&[Sample]| pair[0].q_mm == pair[1].q_mm && moved(&pair[0], &pair[1]);
    let steps: Vec<&[Sample]> = samples.windows(2).filter(is_frozen).collect();
    let (first, last) = (steps.first()?, steps.last()?);
    (steps.len() >= LEAST_FROZEN).then(|| {
        format!(
            "all readings stand still in {} steps between frames {} and {} while the snake moves",
            steps.len(),
            first[0].index,
            last[1].index
        )
    })
}
