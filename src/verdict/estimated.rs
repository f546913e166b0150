//! η and λ learned from measurements and readings, with the verdict on them: what `estimate` answers.

use super::inputs::doubts_of_times;
use super::shared_force::without_shared_force;
use super::{Subject, Verdict};
use crate::error::Result;
use crate::estimate::{self, EstimateRow, Options, estimate, or_one_gain};
use crate::observation::{EncoderReading, Measurement};
use crate::robot::{ForceLimits, Model};

/// What measurements and readings teach, judged.
#[derive(Debug, Clone)]
pub struct JudgedEstimate {
    /// The rows of estimate.csv: what became of each measurement.
    pub rows: Vec<EstimateRow>,
    /// The model with its estimate, or with one gain for all bends in its place; without an estimate where the measurements do not tell it.
    pub model: Model,
    /// The readings that it was learned from: without the force that the backbones shared within limits.
    pub readings: Vec<EncoderReading>,
    /// Whether it can be relied on.
    pub verdict: Verdict,
}

impl JudgedEstimate {
    /// Learns from all measurements, in order, each with the reading of its index, and judges what was learned. `limits` are the force limits
    /// within which the robot was commanded, `subject` says how readings and views are wired, `unit_is_stated` that somebody wrote down the
    /// unit of the log's times.
    ///
    /// The force that backbones share depends on η, which the bending part of the readings alone tells: it is estimated from the readings as they
    /// are.
    ///
    /// # Errors
    /// [`ArgumentError::OutOfRange`](crate::error::ArgumentError::OutOfRange) for an option out of its range; what `subject` says.
    pub fn of(
        start: &Model,
        options: Options,
        limits: Option<&ForceLimits>,
        (measurements, readings): (&[Measurement], &[EncoderReading]),
        unit_is_stated: bool,
        subject: impl for<'a> FnOnce(&'a Model) -> Result<Subject<'a>>,
    ) -> Result<Self> {
        let learned = |readings: &[EncoderReading]| -> Result<_> {
            let (rows, model) = estimate(start, options, measurements, readings)?;
            let (model, replaced) = or_one_gain(model, measurements, readings);
            Ok((rows, model, replaced))
        };
        let (readings, doubt_of_limits) = match limits {
            Some(limits) => {
                let (_, first, _) = learned(readings)?;
                without_shared_force(&first, limits, (measurements, readings), options.sd_encoder_mm)
            }
            None => (readings.to_vec(), None),
        };
        let (rows, model, replaced) = learned(&readings)?;
        let count = |verdict| rows.iter().filter(|row| row.verdict == verdict).count();
        let used_and_rejected = Some((count(estimate::Verdict::Used), count(estimate::Verdict::Rejected)));
        let subject = Subject { used_and_rejected, replaced, ..subject(&model)? };
        let doubts = doubts_of_times(measurements, &readings, unit_is_stated).into_iter().chain(doubt_of_limits);
        let verdict = doubts.fold(subject.verdict(measurements, &readings), Verdict::and);
        Ok(Self { rows, model, readings, verdict })
    }
}
