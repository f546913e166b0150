//! The estimator over a whole sequence of measurements, and the rows of estimate.csv.

use super::estimator::{Estimator, Revision, Step};
use super::sample::Log;
use super::{EstimateRow, EtaLambda, Options, Verdict};
use crate::error::Result;
use crate::observation::{EncoderReading, Measurement};
use crate::robot::Model;
use std::collections::VecDeque;

/// Estimates η and λ from all measurements, in order, each with the encoder reading of its index.
///
/// Gives the rows of estimate.csv, with verdicts as they stood at the end, and the model with its estimate (the model
/// as it was given, less an estimate it had, where the measurements do not pin one). The model's effects are obeyed, and stay in the model.
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
    let all = measurements.iter().cloned().map(Ok);
    let model = estimate_each(model, options, all, readings, |_, row| {
        rows.push(row);
        Ok(())
    })?;
    Ok((rows, model))
}

/// [`estimate`] of measurements that need not be in memory: `each` is given the measurements and their rows of estimate.csv, in order, as soon
/// as no later measurement can change their verdict.
///
/// # Errors
/// [`ArgumentError::OutOfRange`](crate::error::ArgumentError::OutOfRange) for an option out of its range; what `measurements` and `each` give.
pub fn estimate_each(
    model: &Model,
    options: Options,
    measurements: impl Iterator<Item = Result<Measurement>>,
    readings: &[EncoderReading],
    mut each: impl FnMut(Measurement, EstimateRow) -> Result<()>,
) -> Result<Model> {
    let (mut estimator, mut log) = (Estimator::new(model, options)?, Log::new(model, readings));
    // The rows whose verdict may still change, and how many came before them.
    let (mut open, mut decided) = (VecDeque::new(), 0);
    for measurement in measurements {
        let measurement = measurement?;
        let (before, reading) = log.until(measurement.index);
        before.iter().for_each(|reading| estimator.pass(reading));
        let mut step = estimator.update(&measurement, reading);
        for Revision { update, reason } in std::mem::take(&mut step.revisions) {
            let (_, row): &mut (Measurement, EstimateRow) = &mut open[update - decided];
            row.verdict = if reason.is_none() { Verdict::Used } else { Verdict::Rejected };
            row.reason = reason.map(|reason| reason.to_string()).unwrap_or_default();
        }
        let row = row(&measurement, step);
        open.push_back((measurement, row));
        for (measurement, row) in open.drain(..estimator.decided() - decided) {
            each(measurement, row)?;
        }
        decided = estimator.decided();
    }
    open.into_iter().try_for_each(|(measurement, row)| each(measurement, row))?;
    Ok(estimator.model())
}

fn row(measurement: &Measurement, step: Step) -> EstimateRow {
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
        view: measurement.view.clone(),
    }
}
