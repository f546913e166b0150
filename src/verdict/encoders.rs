//! Whether encoders and camera are alive: columns that stand still, columns that repeat another, readings that freeze, pictures that freeze.
//!
//! Every spread leaves out the values farthest from the median, so that a gross reading or two decide nothing.

use super::reason::{Code, Level, Reason};
use super::rules::REJECTED_IN_ORDER;
use crate::estimate::{NEW_POSE, PlainSample};
use crate::observation::MOVED_SDS;
use crate::robot::Robot;
use crate::statistics::line::Line;
use crate::statistics::moments::standard_deviation;
use crate::statistics::order::median;
use nalgebra::Vector2;

/// A column stands still where its spread is less than this share of what the bends seen ask of it, measured by the column for which
/// that share is largest.
///
/// Convention: a tenth. The ratio of variances is then 100, which two samples of one spread exceed with a probability below 0.002 from four
/// samples on (F distribution with 3 and 3 degrees of freedom).
const STILL: f64 = 0.1;
/// A column follows the bends where no more than this share of its spread is left beside them.
///
/// Convention: half; the bends then account for three quarters of its variance, and noise of ten samples for none.
const MOST_BESIDE: f64 = 0.5;
/// Fewer samples than this say nothing of spreads. Convention: see [`STILL`].
const LEAST_SAMPLES: usize = 4;
/// A picture is the one before again if its bend differs by less than so many standard deviations.
///
/// Derived: two errors of their own are so near once in 80,000 steps (1 − exp(−0.005²/2)); where the rig's share of σ is ten times the frames' own,
/// as a snake's that rests in its play, once in 800, and [`LEAST_FROZEN`] steps in a row by no chance. The same picture gives the same bend to 1e-6°.
const SAME_SDS: f64 = 0.005;
/// So many steps in a row in which the bend moved and no reading changed at all.
///
/// Convention: one could be a single wrong measurement. Two apart from each other are a loop that comes back to one command at another pose,
/// which is hysteresis.
const LEAST_FROZEN: usize = 2;

/// What is wrong with the encoders.
pub(super) fn stuck(robot: &Robot, samples: &[PlainSample]) -> Option<Reason> {
    let text = columns_stuck(robot, samples).or_else(|| frozen(samples))?;
    let remedy =
        "repair or reconnect the encoder and log its readings anew; nothing that was learned from these can be used";
    Some(Reason::new(Code::EncoderStuck, Level::DoNotUse, text, remedy))
}

/// Columns whose readings stand still while the snake moves, or repeat another column's.
fn columns_stuck(robot: &Robot, samples: &[PlainSample]) -> Option<String> {
    if samples.len() < LEAST_SAMPLES {
        return None;
    }
    let by_bend = robot.displacement_by_bend();
    let count = robot.backbone_count();
    let spread = |value: &dyn Fn(&PlainSample) -> f64| robust_spread(samples.iter().map(value).collect());
    let asked = |column: Vector2<f64>| spread(&|s: &PlainSample| column.dot(&s.measured.configuration.bend_vector()));
    let noise = samples.iter().map(|s| s.measured.sigma_theta).sum::<f64>() / samples.len() as f64;
    // What noise of the eye alone asks for is no motion.
    let least_asked = robot.backbone_circle_radius_mm * noise * MOVED_SDS;
    let share = |i: usize| (spread(&|s: &PlainSample| s.q_mm[i]), asked(by_bend[i]));
    let shares: Vec<Option<f64>> =
        (0..count).map(share).map(|(own, asked)| (asked > least_asked).then(|| own / asked)).collect();
    let largest = shares.iter().flatten().copied().fold(0.0, f64::max);
    // Beside a column that a counter's jump spreads, the others seem to stand still, and follow the bends all the same.
    let follows = |value: &dyn Fn(&PlainSample) -> f64, column: Vector2<f64>| {
        let motion = |s: &PlainSample| column.dot(&s.measured.configuration.bend_vector());
        let slope = Line::through(samples.iter().map(|s| (motion(s), value(s)))).slope;
        spread(&|s: &PlainSample| value(s) - slope * motion(s)) < MOST_BESIDE * spread(value)
    };
    let still: Vec<String> = (0..count)
        .filter(|&i| shares[i].is_some_and(|share| share <= STILL * largest) && !follows(&|s| s.q_mm[i], by_bend[i]))
        .map(|i| format!("q{}", i + 1))
        .collect();
    if !still.is_empty() {
        let verb = if still.len() == 1 { "stands" } else { "stand" };
        return Some(format!("{} {verb} still while the snake moves", still.join(", ")));
    }
    let pairs = (0..count).flat_map(|i| (0..i).map(move |j| (j, i)));
    let mut same = pairs.filter(|&(j, i)| {
        let (difference, column) = (|s: &PlainSample| s.q_mm[i] - s.q_mm[j], by_bend[i] - by_bend[j]);
        let (own, asked) = (spread(&difference), asked(column));
        asked > least_asked && own <= STILL * largest * asked && !follows(&difference, column)
    });
    let (j, i) = same.next()?;
    Some(format!("q{} repeats q{}: the snake's motion implies different readings", i + 1, j + 1))
}

/// The standard deviation without the tenth of the values that is farthest from the median, one at least.
fn robust_spread(mut values: Vec<f64>) -> f64 {
    let centre = median(&mut values);
    values.sort_unstable_by(|a, b| (a - centre).abs().total_cmp(&(b - centre).abs()));
    let left_out = (REJECTED_IN_ORDER * values.len() as f64).ceil() as usize;
    values.truncate(values.len() - left_out);
    standard_deviation(&values)
}

/// Pictures that do not change at all while the readings ask for other poses: the same picture again and again.
pub(super) fn camera_stuck(robot: &Robot, samples: &[PlainSample]) -> Option<Reason> {
    let implied = |sample: &PlainSample| robot.bend_by_displacement().tr_mul(&sample.q_mm);
    let is_frozen = |pair: &[PlainSample]| {
        (implied(&pair[1]) - implied(&pair[0])).norm() > NEW_POSE
            && pair[0].measured.moved_sds(&pair[1].measured).is_some_and(|sds| sds < SAME_SDS)
    };
    let frozen: Vec<&[PlainSample]> = samples.windows(2).filter(|pair| is_frozen(pair)).collect();
    let in_a_row = samples.windows(LEAST_FROZEN + 1).any(|row| row.windows(2).all(is_frozen));
    let (first, last) = (frozen.first()?, frozen.last()?);
    in_a_row.then(|| {
        let text = format!(
            "the picture stands still in {} steps between frames {} and {} although the readings imply other bends",
            frozen.len(),
            first[0].index,
            last[1].index
        );
        let remedy = "see whether the camera or its recording froze, and take the frames anew; nothing that was learned from these can be used";
        Reason::new(Code::CameraStuck, Level::DoNotUse, text, remedy)
    })
}

/// Readings that do not change at all, in steps that follow each other, while the bend moves.
fn frozen(samples: &[PlainSample]) -> Option<String> {
    let is_frozen =
        |pair: &[PlainSample]| pair[0].q_mm == pair[1].q_mm && pair[0].measured.has_moved(&pair[1].measured);
    let steps: Vec<&[PlainSample]> = samples.windows(2).filter(|pair| is_frozen(pair)).collect();
    let in_a_row = samples.windows(LEAST_FROZEN + 1).any(|row| row.windows(2).all(is_frozen));
    let (first, last) = (steps.first()?, steps.last()?);
    in_a_row.then(|| {
        format!(
            "all readings stand still in {} steps between frames {} and {} while the snake moves",
            steps.len(),
            first[0].index,
            last[1].index
        )
    })
}
