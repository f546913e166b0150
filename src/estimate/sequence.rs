//! The estimator over a whole sequence of measurements, and the rows of estimate.csv.

use super::estimator::{Estimator, Revision, Step};
use super::sample::Log;
use super::{EstimateRow, EtaLambda, Options, Verdict};
use crate::error::Result;
use crate::observation::{EncoderReading, Measurement};
use crate::robot::Model;

/// Estimates η, λ and the uncertain parameters of the model's effects from all measurements, in order, each with the encoder reading of its index.
///
/// Gives the rows of estimate.csv, with verdicts as they stood at the end, and the model with its estimate (the model
/// as it was given, less an estimate it had, where the measurements do not pin one). Effects that are known exactly are obeyed as they are.
///
/// # Errors
/// [`ArgumentError::OutOfRange`](crate::error::ArgumentError::OutOfRange) for an option out of its range.
pub fn estimate(
    model: &Model,
    options: Options,
    measurements: &[Measurement],
    readings: &[EncoderReading],
) -> Result<(Vec<EstimateRow>, Model)> {
    let (mut estimator, mut log) = (Estimator::new(model, options)?, Log::new(model, readings));
    let mut rows: Vec<EstimateRow> = Vec::with_capacity(measurements.len());
    for measurement in measurements {
        let (before, reading) = log.until(measurement.index);
        before.iter().for_each(|reading| estimator.pass(reading));
        let mut step = estimator.update(measurement, reading);
        for Revision { update, reason } in std::mem::take(&mut step.revisions) {
            rows[update].verdict = if reason.is_none() { Verdict::Used } else { Verdict::Rejected };
            rows[update].reason = reason.map(|reason| reason.to_string()).unwrap_or_default();
        }
        rows.push(row(measurement, step));
    }
    Ok((rows, estimator.model()))
}

fn row(measurement: &Measurement, step: Step) -> EstimateRow {
    EstimateRow {
        index: measurement.index,
        time_s: measurement.time_s,
        estimate: step.estimate.map(EtaLambda::from),
        verdict: step.verdict,
        reason: step.reason.map(|reason| reason.to_string()).unwrap_or_default(),
        residual_mm: step.residual_mm,
        view: measurement.view.clone(),
    }
}
