//! Whether encoders and camera are alive: columns that stand still, columns that repeat another, readings that freeze, pictures that freeze.
//!
//! Every spread leaves out the values farthest from the median, so that a gross reading or two decide nothing.

use super::evidence::Sample;
use super::reason::{Code, Level, Reason};
use super::rules::REJECTED_IN_ORDER;
use crate::estimate::NEW_POSE;
use crate::observation::MOVED_SDS;
use crate::robot::Robot;
use crate::statistics::moments::standard_deviation;
use crate::statistics::order::median;
use nalgebra::Vector2;

/// A column stands still where its spread is less than this share of what the bends seen ask of it, measured by the column for which
/// that share is largest.
///
/// Convention: a tenth. The ratio of variances is then 100, which two samples of one spread exceed with a probability below 0.002 from four
/// samples on (F distribution with 3 and 3 degrees of freedom).
const STILL: f64 = 0.1;
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
pub(super) fn stuck(robot: &Robot, samples: &[Sample]) -> Option<Reason> {
    let text =
        columns_stuck(robot, samples).or_else(|| frozen(samples)).or_else(|| columns_stuck_in_part(robot, samples))?;
    let remedy =
        "repair or reconnect the encoder and log its readings anew; nothing that was learned from these can be used";
    Some(Reason::new(Code::EncoderStuck, Level::DoNotUse, text, remedy))
}

/// Columns whose readings stand still while the snake moves, or repeat another column's.
fn columns_stuck(robot: &Robot, samples: &[Sample]) -> Option<String> {
    let spreads = Spreads::of(robot, samples)?;
    spreads.still().or_else(|| spreads.repeated())
}

/// How far readings and bends spread over some samples.
struct Spreads<'a> {
    robot: &'a Robot,
    samples: &'a [Sample],
    /// What noise of the eye alone asks of a reading, mm.
    least_asked_mm: f64,
    /// Of each column that the bends ask anything of, the share of that which it does.
    shares: Vec<Option<f64>>,
    /// The largest.
    largest: f64,
}

impl<'a> Spreads<'a> {
    /// `None` of too few samples.
    fn of(robot: &'a Robot, samples: &'a [Sample]) -> Option<Self> {
        if samples.len() < LEAST_SAMPLES {
            return None;
        }
        let noise = samples.iter().map(|s| s.measured.sigma_theta).sum::<f64>() / samples.len() as f64;
        let least_asked_mm = robot.backbone_circle_radius_mm * noise * MOVED_SDS;
        let mut spreads = Self { robot, samples, least_asked_mm, shares: Vec::new(), largest: 0.0 };
        let by_bend = robot.displacement_by_bend();
        let share = |i: usize| Some(spreads.read(&|s| s.q_mm[i]) / spreads.asked(by_bend[i])?);
        spreads.shares = (0..robot.backbone_count()).map(share).collect();
        spreads.largest = spreads.shares.iter().flatten().copied().fold(0.0, f64::max);
        Some(spreads)
    }

    /// Of a number of each sample's readings, mm.
    fn read(&self, value: &dyn Fn(&Sample) -> f64) -> f64 {
        robust_spread(self.samples.iter().map(value).collect())
    }

    /// Of what the bends ask of a column, mm; `None` if noise alone asks as much.
    fn asked(&self, by_bend: Vector2<f64>) -> Option<f64> {
        let asked = self.read(&|s| by_bend.dot(&s.measured.configuration.bend_vector()));
        Some(asked).filter(|asked| *asked > self.least_asked_mm)
    }

    fn still(&self) -> Option<String> {
        let is_still = |share: &Option<f64>| share.is_some_and(|share| share <= STILL * self.largest);
        let still = self.shares.iter().zip(1..).filter(|(share, _)| is_still(share));
        let still: Vec<String> = still.map(|(_, number)| format!("q{number}")).collect();
        let verb = if still.len() == 1 { "stands" } else { "stand" };
        (!still.is_empty()).then(|| format!("{} {verb} still while the snake moves", still.join(", ")))
    }

    fn repeated(&self) -> Option<String> {
        let by_bend = self.robot.displacement_by_bend();
        let mut pairs = (0..self.shares.len()).flat_map(|i| (0..i).map(move |j| (j, i)));
        let (j, i) = pairs.find(|&(j, i)| {
            let own = self.read(&|s| s.q_mm[i] - s.q_mm[j]);
            self.asked(by_bend[i] - by_bend[j]).is_some_and(|asked| own <= STILL * self.largest * asked)
        })?;
        Some(format!("q{} repeats q{}: the snake's motion implies different readings", i + 1, j + 1))
    }
}

/// Columns that stand still in a part of the log, and do not change at all there, while others and the snake move.
fn columns_stuck_in_part(robot: &Robot, samples: &[Sample]) -> Option<String> {
    (0..robot.backbone_count()).find_map(|i| {
        let is_same = |a: &Sample, b: &Sample| a.q_mm[i] == b.q_mm[i];
        let part = samples.chunk_by(is_same).max_by_key(|part| part.len())?;
        let (first, last) = (part.first()?, part.last()?);
        let others_move = part.iter().any(|sample| sample.q_mm != first.q_mm);
        let spreads = Spreads::of(robot, part).filter(|_| others_move)?;
        // A log of few decimals does not change where little is asked of it.
        spreads.asked(robot.displacement_by_bend()[i]).filter(|asked_mm| *asked_mm > resolution_mm(samples, i))?;
        spreads.still().map(|text| format!("between frames {} and {} {text}", first.index, last.index))
    })
}

/// The least difference of two readings of a column, mm; 0 where there is none.
fn resolution_mm(samples: &[Sample], column: usize) -> f64 {
    let mut readings: Vec<f64> = samples.iter().map(|sample| sample.q_mm[column]).collect();
    readings.sort_unstable_by(f64::total_cmp);
    let steps = readings.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0);
    steps.min_by(f64::total_cmp).unwrap_or(0.0)
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
pub(super) fn camera_stuck(robot: &Robot, samples: &[Sample]) -> Option<Reason> {
    let implied = |sample: &Sample| robot.bend_by_displacement().tr_mul(&sample.q_mm);
    let is_frozen = |pair: &[Sample]| {
        (implied(&pair[1]) - implied(&pair[0])).norm() > NEW_POSE
            && pair[0].measured.moved_sds(&pair[1].measured).is_some_and(|sds| sds < SAME_SDS)
    };
    let frozen: Vec<&[Sample]> = samples.windows(2).filter(|pair| is_frozen(pair)).collect();
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
fn frozen(samples: &[Sample]) -> Option<String> {
    let is_frozen = |pair: &[Sample]| pair[0].q_mm == pair[1].q_mm && pair[0].measured.has_moved(&pair[1].measured);
    let steps: Vec<&[Sample]> = samples.windows(2).filter(|pair| is_frozen(pair)).collect();
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
