//! From one measurement to the next estimate, with what the dashboard shows beside it.

use super::gap::{GapStatus, Gathered, Watch};
use crate::Result;
use crate::estimate::{Estimator, Options, Step, without_effects};
use crate::geometry::Configuration;
use crate::record::{EncoderReading, Measurement};
use crate::robot::Model;
use std::collections::VecDeque;

/// Samples of the past that effects with a memory are judged by.
const PAST: usize = 64;

/// The estimator and all that looks over its shoulder.
#[derive(Debug)]
pub struct Learner {
    start: Model,
    options: Options,
    estimator: Estimator,
    /// The first sample and the latest, for effects that remember; empty without effects.
    past: VecDeque<(Measurement, EncoderReading)>,
    watch: Watch,
    gathered: Gathered,
}

/// What one measurement did.
#[derive(Debug, Clone)]
pub struct Learned {
    /// What became of it in the estimator.
    pub step: Step,
    /// What the model before it expected from the encoders.
    pub expected: Option<Configuration>,
    /// The watch on the gap.
    pub gap: GapStatus,
}

impl Learner {
    /// Begins with a model, whose effects stay.
    ///
    /// # Errors
    /// An option out of its range.
    pub fn new(start: Model, options: Options) -> Result<Self> {
        let estimator = Estimator::new(&start.plain(), options)?;
        let (watch, gathered) = (Watch::default(), Gathered::default());
        Ok(Self { start, options, estimator, past: VecDeque::new(), watch, gathered })
    }

    /// Forgets all measurements.
    ///
    /// # Errors
    /// None that [`new`](Self::new) had not.
    pub fn reset(&mut self) -> Result<()> {
        *self = Self::new(self.start.clone(), self.options)?;
        Ok(())
    }

    /// The model with its effects and the estimate as it stands.
    pub fn model(&self) -> Model {
        Model { effects: self.start.effects.clone(), ..self.estimator.model().clone() }
    }

    /// What `discover` gets to see: the model to start from, and samples spread over the run.
    pub fn gathered(&self) -> (Model, Vec<Measurement>, Vec<EncoderReading>) {
        let (measurements, readings) = self.gathered.samples();
        (self.start.clone(), measurements, readings)
    }

    /// Takes one measurement and its reading.
    pub fn take(&mut self, measurement: &Measurement, reading: Option<&EncoderReading>) -> Learned {
        let expected = reading.and_then(|reading| self.model().forward(&reading.q_mm).ok());
        let step = match reading {
            Some(reading) => {
                self.gathered.take(measurement, reading);
                let (measurement, reading) = self.without_effects(measurement, reading);
                self.estimator.update(&measurement, Some(&reading))
            }
            None => self.estimator.update(measurement, None),
        };
        let gap = self.watch.see(step.verdict, self.estimator.consistency());
        Learned { step, expected: expected.map(|response| response.configuration), gap }
    }

    /// The sample as it would be without the model's effects, by the path that led to it.
    fn without_effects(
        &mut self,
        measurement: &Measurement,
        reading: &EncoderReading,
    ) -> (Measurement, EncoderReading) {
        if self.start.effects.is_empty() || measurement.measured.is_none() {
            return (measurement.clone(), *reading);
        }
        if self.past.len() == PAST {
            // The first one stays: drifts count from it.
            self.past.remove(1);
        }
        self.past.push_back((measurement.clone(), *reading));
        let (measurements, readings): (Vec<_>, Vec<_>) = self.past.iter().cloned().unzip();
        let (mut measurements, mut readings) = without_effects(&self.start, &measurements, &readings);
        measurements.pop().zip(readings.pop()).unwrap_or_else(|| (measurement.clone(), *reading))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::estimate;
    use crate::robot::{Effect, Estimate};
    use crate::simulate::{BendingExperiment, Plant, SimulatedEye};
    use nalgebra::Matrix2;

    #[test]
    fn learns_what_the_estimator_learns_from_the_whole_file() {
        let truth = Estimate { eta: 1.221, lambda_mm: 0.1765, covariance: Matrix2::zeros(), samples: 0 };
        for effects in [vec![], vec![Effect::parse("load_directed_backlash:play_mm=0.08").unwrap()]] {
            let start = Model { effects, ..Model::default() };
            let plant = Model { estimate: Some(truth), ..start.clone() };
            let (measurements, readings) = experiment(&plant);
            let mut learner = Learner::new(start.clone(), Options::default()).unwrap();
            for (measurement, reading) in measurements.iter().zip(&readings) {
                learner.take(measurement, Some(reading));
            }
            let (_, whole) = estimate(&start, Options::default(), &measurements, &readings).unwrap();
            let (ours, theirs) = (learner.model().parameters(), whole.parameters());
            assert!((ours - theirs).amax() < 2e-3, "{ours} {theirs}");
            assert!((ours.x - 1.221).abs() < 0.03 && (ours.y - 0.1765).abs() < 0.01, "{ours}");
        }
    }

    fn experiment(plant: &Model) -> (Vec<Measurement>, Vec<EncoderReading>) {
        let waypoints = BendingExperiment::default().waypoints().unwrap();
        let samples = Plant { model: plant.clone(), sd_encoder_mm: 0.0015 }.run(&waypoints, 1);
        let measurements = SimulatedEye::default().observe(&samples, 2);
        (measurements, samples.iter().map(|sample| sample.reading).collect())
    }
}
