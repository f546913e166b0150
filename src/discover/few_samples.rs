//! What samples that are too few for a search tell all the same: how large the gap is, and whether η and λ alone leave more than noise.

use super::data::LEAST_SAMPLES;
use super::discrepancy::gap_json;
use super::held_out::Gap;
use super::verdict::Verdict;
use crate::error::{DataError, Error, Result};
use crate::estimate::{self, Options, estimate, with_sigmas};
use crate::observation::{EncoderReading, Measurement};
use crate::robot::Model;
use crate::verdict::MEAN_SQUARE_OF_NOISE;
use serde_json::{Value, json};

/// Fewer samples than this say nothing of a gap either.
///
/// Derived: as many poses as the verdict's sign test needs before it can speak at its level, 2⁻¹⁰ < 0.001.
const LEAST_JUDGED: usize = 10;

/// The answer that needs no search.
#[derive(Debug, Clone)]
pub struct FewSamples {
    /// [`None`](Verdict::None) where η and λ leave noise, else [`Unexplained`](Verdict::Unexplained).
    pub verdict: Verdict,
    /// The model as given, with η and λ fitted to the samples.
    pub model: Model,
    /// What the model as given leaves.
    pub before: Gap,
    /// What the fitted one leaves of the same samples.
    pub after: Gap,
    /// The rms of ε that the measurements' noise alone leaves, mm.
    pub noise_floor_mm: f64,
    /// Usable samples.
    pub samples: usize,
    /// What is to be said of the data.
    pub remarks: Vec<String>,
}

impl FewSamples {
    /// The answer in place of the error of [`Data::new`](super::Data::new) on these samples.
    ///
    /// # Errors
    /// That error, if it is not [`DataError::TooFewSamples`], if they are too few even for this answer, or η and λ cannot be fitted to them;
    /// [`ArgumentError::OutOfRange`](crate::error::ArgumentError::OutOfRange) for a standard deviation that no encoder has.
    pub fn instead_of(
        error: Error,
        model: &Model,
        measurements: &[Measurement],
        readings: &[EncoderReading],
        sd_encoder_mm: f64,
    ) -> Result<Self> {
        let Error::Data(DataError::TooFewSamples { found, .. }) = error else { return Err(error) };
        Self::of(found, model, measurements, readings, sd_encoder_mm)?.ok_or(error)
    }

    /// The answer for so many usable samples; nothing where they are too few even for that, or η and λ cannot be fitted to them.
    fn of(
        samples: usize,
        model: &Model,
        measurements: &[Measurement],
        readings: &[EncoderReading],
        sd_encoder_mm: f64,
    ) -> Result<Option<Self>> {
        if samples < LEAST_JUDGED {
            return Ok(None);
        }
        let (measurements, without_sigmas) = with_sigmas(measurements, readings);
        let options = Options { sd_encoder_mm, ..Options::default() };
        let (_, fitted) = estimate(model, options, &measurements, readings)?;
        if fitted.estimate.is_none() {
            return Ok(None);
        }
        let before = estimate::gap::gap(model, &measurements, readings);
        let after = estimate::gap::gap(&fitted, &measurements, readings);
        let noise_mm = after.noise_floor_mm.hypot(sd_encoder_mm);
        // Ten samples of noise exceed it once in some thousand times: χ² with 18 degrees of freedom.
        let is_noise = after.rms_eps_mm.powi(2) <= MEAN_SQUARE_OF_NOISE * noise_mm.powi(2);
        let remark = format!(
            "no effect was looked for, which takes {LEAST_SAMPLES} samples at least: measure more poses; the gap after is that of the \
             samples to which η and λ were fitted"
        );
        Ok(Some(Self {
            verdict: if is_noise { Verdict::None } else { Verdict::Unexplained },
            model: fitted,
            before: before.into(),
            after: after.into(),
            noise_floor_mm: after.noise_floor_mm,
            samples,
            remarks: without_sigmas.into_iter().chain([remark]).collect(),
        }))
    }

    /// The answer in a sentence.
    pub fn sentence(&self) -> String {
        let samples = self.samples;
        match self.verdict {
            Verdict::None => format!("As far as {samples} samples can tell, what η and λ leave of the gap is noise."),
            _ => format!("η and λ leave more than noise, and {samples} samples are too few to look for what it is."),
        }
    }

    /// discrepancy.json.
    pub fn json(&self) -> Value {
        let x = self.model.parameters();
        json!({
            "verdict": self.verdict.word(),
            "effects": [],
            "gap": gap_json(&self.before, &self.after, self.noise_floor_mm),
            "eta": x.x,
            "lambda_mm": x.y,
            "samples": self.samples,
            "remarks": self.remarks,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Effect;
    use crate::simulate::{BendingExperiment, Plant, SimulatedEye};

    /// The answer to a part of an experiment of a robot with these effects, of every `stride`-th pose.
    fn answer(effects: Vec<Effect>, stride: usize, seed: u64) -> Option<FewSamples> {
        let trajectory = BendingExperiment { sweep_poses: 20, ..Default::default() }.waypoints().unwrap();
        let plant = Plant { model: Model { effects, ..Model::default() }, sd_encoder_mm: 0.0015 };
        let samples = plant.run(&trajectory, seed);
        let kept: Vec<_> = samples.iter().step_by(stride).cloned().collect();
        let readings: Vec<_> = kept.iter().map(|s| s.reading).collect();
        let measurements = SimulatedEye::default().observe(&kept, seed + 100);
        FewSamples::of(kept.len(), &Model::default(), &measurements, &readings, 0.0015).unwrap()
    }

    #[test]
    fn noise_is_called_noise_and_a_play_ten_times_as_large_is_not() {
        for seed in 0..20 {
            let found = answer(vec![], 5, seed).unwrap();
            assert_eq!(found.verdict, Verdict::None, "seed {seed}: {found:?}");
            let play = Effect::parse("motion_directed_backlash:half_gap_mm=0.02").unwrap();
            let found = answer(vec![play], 5, seed).unwrap();
            assert_eq!(found.verdict, Verdict::Unexplained, "seed {seed}: {found:?}");
        }
        assert!(answer(vec![], 20, 1).is_none());
    }
}
