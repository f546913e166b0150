//! The force on the tip that explains measured deflections, with the verdict on it: what `force` answers.

use super::{Subject, Verdict, one_cause};
use crate::error::Result;
use crate::estimate::{ForceRow, TipForce, tip_force};
use crate::observation::{EncoderReading, Measurement};
use crate::robot::Model;

/// That a force does not explain all.
const UNEXPLAINED: &str = "no one force explains what was measured: with the force found";
/// What to do then.
const REMEDY: &str = "measure the unloaded snake and see what the model misses there (`snakeloop evaluate`): that is taken for a force here; if it \
                      misses nothing, the force was not the same in all frames (force.csv has each), or not at the tip";

/// What measurements and readings of a loaded snake say of the force, judged.
#[derive(Debug, Clone)]
pub struct JudgedForce {
    /// The rows of force.csv: the force that explains each measurement.
    pub rows: Vec<ForceRow>,
    /// The one force that explains all of them together.
    pub force: TipForce,
    /// Whether the model explains them under that force.
    pub verdict: Verdict,
}

impl JudgedForce {
    /// Finds the force, and judges the model that is loaded by it. `subject` says how readings and views are wired.
    ///
    /// # Errors
    /// As [`tip_force`]; what `subject` says.
    pub fn of(
        model: &Model,
        sd_encoder_mm: f64,
        data: (&[Measurement], &[EncoderReading]),
        subject: impl for<'a> Fn(&'a Model) -> Result<Subject<'a>>,
    ) -> Result<Self> {
        let (measurements, readings) = data;
        let (rows, force) = tip_force(model, sd_encoder_mm, measurements, readings)?;
        let mut loaded = model.clone();
        loaded.effects.extend(force.effect());
        let subjects = [&subject(model)?, &subject(&loaded)?];
        let verdict = one_cause::verdict(subjects, data, measurements, [UNEXPLAINED, REMEDY]);
        Ok(Self { rows, force, verdict })
    }
}
