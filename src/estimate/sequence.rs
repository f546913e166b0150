//! The estimator over a whole sequence of measurements, and the rows of estimate.csv.

use super::estimator::{Estimator, Revision, Step};
use super::{EstimateRow, EtaLambda, Options, Verdict, pairs_without_effects};
use crate::error::Result;
use crate::observation::{EncoderReading, Measurement};
use crate::robot::Model;
use std::collections::VecDeque;

/// Rounds in which η and what effects do with it find each other.
///
/// Convention: each round leaves a small share of the one before (an effect's part of η); three are beyond the estimate's own digits.
const ROUNDS: usize = 3;

/// Estimates η and λ from all measurements, in order, each with the encoder reading of its index.
///
/// Gives the rows of estimate.csv, with verdicts as they stood at the end, and the model with its estimate (the model
/// as it was given, less an estimate it had, where the measurements do not pin one). What the model's effects do is
/// taken off first and stays in the model.
///
/// # Errors
/// [`ArgumentError::OutOfRange`](crate::error::ArgumentError::OutOfRange) for an option out of its range.
pub fn estimate(
    model: &Model,
    options: Options,
    measurements: &[Measurement],
    readings: &[EncoderReading],
) -> Result<(Vec<EstimateRow>, Model)> {
    let mut rows = Vec::with_capacity(measurements.len());
    let all = || Ok(measurements.iter().cloned().map(Ok));
    let model = estimate_each(model, options, all, readings, |row| {
        rows.push(row);
        Ok(())
    })?;
    Ok((rows, model))
}

/// [`estimate`] of measurements that need not be in memory: `measurements` goes through them, more than once where the model has
/// effects, and `each` is given the rows of estimate.csv, in order, as soon as no later measurement can change their verdict.
///
/// # Errors
/// [`ArgumentError::OutOfRange`](crate::error::ArgumentError::OutOfRange) for an option out of its range; what `measurements` and `each` give.
pub fn estimate_each<I: Iterator<Item = Result<Measurement>>>(
    model: &Model,
    options: Options,
    measurements: impl Fn() -> Result<I>,
    readings: &[EncoderReading],
    each: impl FnMut(EstimateRow) -> Result<()>,
) -> Result<Model> {
    let mut start = model.clone();
    if start.estimate.is_none() && !start.effects.is_empty() {
        // The effects depend on η, and η is known only after they are subtracted: iterate.
        for _ in 0..ROUNDS {
            start.estimate = one_round(&start, options, measurements()?, readings, |_| Ok(()))?.estimate;
        }
    }
    one_round(&start, options, measurements()?, readings, each)
}

/// [`estimate_each`], with the effects as they act under the model's own η and λ.
fn one_round(
    model: &Model,
    options: Options,
    measurements: impl Iterator<Item = Result<Measurement>>,
    readings: &[EncoderReading],
    mut each: impl FnMut(EstimateRow) -> Result<()>,
) -> Result<Model> {
    let mut estimator = Estimator::new(&model.plain(), options)?;
    // The rows whose verdict may still change, and how many came before them.
    let (mut open, mut decided) = (VecDeque::new(), 0);
    for pair in pairs_without_effects(model, measurements, readings)? {
        let (measurement, reading) = pair?;
        let mut step = estimator.update(&measurement, reading.as_ref());
        for Revision { update, reason } in std::mem::take(&mut step.revisions) {
            let row: &mut EstimateRow = &mut open[update - decided];
            row.verdict = if reason.is_none() { Verdict::Used } else { Verdict::Rejected };
            row.reason = reason.map(|reason| reason.to_string()).unwrap_or_default();
        }
        open.push_back(row(measurement, step));
        for row in open.drain(..estimator.decided() - decided) {
            each(row)?;
        }
        decided = estimator.decided();
    }
    open.into_iter().try_for_each(each)?;
    let learned = estimator.model();
    Ok(Model { learned: learned.learned, ..model.with_estimate(learned.estimate) })
}

fn row(measurement: Measurement, step: Step) -> EstimateRow {
    EstimateRow {
        index: measurement.index,
        time_s: measurement.time_s,
        estimate: step.estimate.map(|estimate| EtaLambda {
            eta: estimate.eta,
            lambda_mm: estimate.lambda_mm,
            sd_eta: estimate.sd_eta(),
            sd_lambda_mm: estimate.sd_lambda_mm(),
        }),
        verdict: step.verdict,
        reason: step.reason.map(|reason| reason.to_string()).unwrap_or_default(),
        residual_mm: step.residual_mm,
        view: measurement.view,
    }
}
