//! The bending angle of a flexible stem, with the verdict on it: what `estimate --stem` answers.

use super::{Subject, Verdict, one_cause};
use crate::error::Result;
use crate::estimate::{StemOptions, StemRow, estimate_stem};
use crate::observation::{EncoderReading, Measurement};
use crate::robot::Model;

/// That the last angle does not explain all.
const UNEXPLAINED: &str = "no angle of the stem explains the last measurements: with the last one";
/// What to do then.
const REMEDY: &str = "if the stem did not move meanwhile, measure with the stem as it was when η and λ were learned, and see what the model misses there \
                      (`snakeloop evaluate`): that is taken for an angle here";

/// What measurements and readings say of the stem, judged.
#[derive(Debug, Clone)]
pub struct JudgedStem {
    /// The rows of stem.csv: the angle after each measurement.
    pub rows: Vec<StemRow>,
    /// The model with the stem bent by the last angle.
    pub model: Model,
    /// Whether the model explains with its last angle what was measured within the memory of the forgetting.
    pub verdict: Verdict,
}

impl JudgedStem {
    /// Follows the stem, and judges the model that it leads to. `subject` says how readings and views are wired.
    ///
    /// # Errors
    /// As [`estimate_stem`]; what `subject` says.
    pub fn of(
        start: &Model,
        options: StemOptions,
        data: (&[Measurement], &[EncoderReading]),
        subject: impl for<'a> Fn(&'a Model) -> Result<Subject<'a>>,
    ) -> Result<Self> {
        let (measurements, readings) = data;
        let (rows, model) = estimate_stem(start, options, measurements, readings)?;
        // A memory that forgets nothing holds all of them.
        let memory = (1.0 / (1.0 - options.forgetting)).ceil() as usize;
        let recent = &measurements[measurements.len().saturating_sub(memory)..];
        let verdict = one_cause::verdict([&subject(start)?, &subject(&model)?], data, recent, [UNEXPLAINED, REMEDY]);
        Ok(Self { rows, model, verdict })
    }
}
