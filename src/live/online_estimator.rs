//! The estimator of a running loop: from one measurement to the next estimate, with what is watched beside it. It is the one of `run`.

use super::gap_monitor::GapMonitor;
use super::standstill::Standstill;
use super::status::GapStatus;
use crate::estimate::{self, Estimator, Options, PlainSample, Reason, Stem, StemAngle, StemOptions, Step, Verdict};
use crate::geometry::Configuration;
use crate::observation::{EncoderReading, Measurement};
use crate::robot::Model;
use crate::statistics::spread::Spread;

/// Samples that are kept for `discover`, spread over the run. Convention: a resource limit; `discover` takes the longer the more there are.
const MOST_SAMPLES: usize = 500;

/// What is estimated.
#[derive(Debug, Clone)]
enum Subject {
    /// η and λ.
    Parameters(Box<Estimator>),
    /// How far the stem is bent.
    Stem(Box<Stem>),
}

/// The estimator, the monitor of its innovations, and the samples for `discover`.
#[derive(Debug)]
pub struct OnlineEstimator {
    start: Model,
    options: Options,
    stem: Option<StemOptions>,
    subject: Subject,
    monitor: GapMonitor,
    samples: Spread<(Measurement, EncoderReading)>,
    standstill: Standstill,
    before_standstill: Option<BeforeStandstill>,
}

/// What was known before the readings stood still.
#[derive(Debug)]
struct BeforeStandstill {
    subject: Subject,
    monitor: GapMonitor,
    index: u64,
}

/// What one measurement did.
#[derive(Debug, Clone)]
pub struct Update {
    /// What the estimator did with it.
    pub step: Step,
    /// The configuration that the model before it predicted from the encoders.
    pub expected: Option<Configuration>,
    /// Whether the model accounts for the measurements.
    pub gap: GapStatus,
    /// The stem's angle after it, where it is followed.
    pub stem: Option<StemAngle>,
    /// The measurement with its reading as the estimator took them; `None` where they cannot be used.
    pub sample: Option<PlainSample>,
    /// Whether the encoders stand still while the snake moves; nothing is learned then.
    pub is_stuck: bool,
}

impl OnlineEstimator {
    /// Begins with a model, whose effects stay. With settings for a stem its angle is followed, and η and λ are the model's.
    ///
    /// # Errors
    /// An option out of its range; a stem of a model without η and λ.
    pub fn new(start: Model, options: Options, stem: Option<StemOptions>) -> crate::Result<Self> {
        let subject = match stem {
            None => Subject::Parameters(Box::new(Estimator::new(&start, options)?)),
            Some(options) => Subject::Stem(Box::new(Stem::new(&start, options)?)),
        };
        let (monitor, samples) = (GapMonitor::default(), Spread::new(MOST_SAMPLES));
        let standstill = Standstill::new(options.sd_encoder_mm);
        Ok(Self { start, options, stem, subject, monitor, samples, standstill, before_standstill: None })
    }

    /// Forgets all measurements; says what begins anew.
    ///
    /// # Errors
    /// Those of [`new`](Self::new).
    pub fn reset(&mut self) -> crate::Result<&'static str> {
        *self = Self::new(self.start.clone(), self.options, self.stem)?;
        Ok(match self.subject {
            Subject::Parameters(_) => "η and λ begin anew",
            Subject::Stem(_) => "the stem's angle begins anew",
        })
    }

    /// What is believed of the robot: all that was learned, but for what came since the readings stood still, if the bend has moved since.
    fn believed(&self) -> &Subject {
        let before = self.before_standstill.as_ref().filter(|_| self.standstill.is_suspect());
        before.map_or(&self.subject, |before| &before.subject)
    }

    /// The model with its effects and what is estimated so far. While readings stand still and the bend has moved, it is the model of
    /// before: a few such measurements are enough for an estimator to start afresh on them, and fewer than tell that the encoders are stuck.
    pub fn model(&self) -> Model {
        match self.believed() {
            Subject::Parameters(estimator) => estimator.model(),
            Subject::Stem(stem) => stem.model(),
        }
    }

    /// The stem's angle as it stands, where it is followed.
    pub fn stem(&self) -> Option<StemAngle> {
        match self.believed() {
            Subject::Parameters(_) => None,
            Subject::Stem(stem) => Some(stem.angle()),
        }
    }

    /// What `discover` works on: the model to start from, and samples spread over the run.
    pub fn samples(&self) -> (Model, Vec<Measurement>, Vec<EncoderReading>) {
        let (measurements, readings) = self.samples.kept.iter().cloned().unzip();
        (self.start.clone(), measurements, readings)
    }

    /// Takes one measurement and its reading.
    pub fn update(&mut self, measurement: &Measurement, reading: Option<&EncoderReading>) -> Update {
        let model = self.model();
        let taken = self.subject.take(measurement, reading);
        let came = taken.as_ref().ok().and_then(|sample| sample.came.as_ref());
        let expected = match came {
            Some(came) => Some(Configuration::from_bend_vector(came.solution.bend)),
            None => reading.and_then(|reading| Some(model.forward(&reading.q_mm).ok()?.configuration)),
        };
        let sample = reading.zip(taken.as_ref().ok()).map(|(reading, sample)| {
            let (measured, q_mm) = sample.without_effects(&model);
            PlainSample { index: measurement.index, time_s: reading.time_s, measured, q_mm }
        });
        let is_stuck = match &sample {
            Some(sample) => self.is_stuck(sample),
            None => self.standstill.is_stuck(),
        };
        let step = if is_stuck {
            self.subject.learn(Err(Reason::NoEncoderReading))
        } else {
            reading.into_iter().for_each(|reading| self.samples.add((measurement.clone(), *reading)));
            self.subject.learn(taken)
        };
        let consistency = match &self.subject {
            Subject::Parameters(estimator) => estimator.consistency(),
            // A stem that is followed takes up what the model misses, and its sigma allows for that.
            Subject::Stem(_) => None,
        };
        let pose = expected.map(|psi| psi.bend_vector());
        let gap = self.monitor.add(pose, step.verdict, step.innovation.as_ref(), consistency);
        Update { step, expected, gap, stem: self.stem(), sample, is_stuck }
    }

    /// Whether the encoders are found to stand still while the snake moves. What was learned since they stopped is then forgotten.
    fn is_stuck(&mut self, sample: &PlainSample) -> bool {
        if self.standstill.add(sample) {
            let (subject, monitor) = (self.subject.clone(), self.monitor.clone());
            self.before_standstill = Some(BeforeStandstill { subject, monitor, index: sample.index });
        }
        if self.standstill.is_stuck()
            && let Some(BeforeStandstill { subject, monitor, index }) = self.before_standstill.take()
        {
            (self.subject, self.monitor) = (subject, monitor);
            self.samples.kept.retain(|(measurement, _)| measurement.index < index);
        }
        self.standstill.is_stuck()
    }
}

impl Subject {
    fn take(
        &mut self,
        measurement: &Measurement,
        reading: Option<&EncoderReading>,
    ) -> Result<estimate::Sample, Reason> {
        match self {
            Self::Parameters(estimator) => estimator.take(measurement, reading),
            Self::Stem(stem) => stem.take(measurement, reading),
        }
    }

    fn learn(&mut self, sample: Result<estimate::Sample, Reason>) -> Step {
        match self {
            Self::Parameters(estimator) => estimator.learn(sample),
            Self::Stem(stem) => {
                let before = stem.model();
                let learned = sample.and_then(|sample| stem.learn(&sample).map(|_| sample));
                let residual_mm = learned.as_ref().ok().map(|sample| {
                    let (measured, q_mm) = sample.without_effects(&before);
                    q_mm - before.plain().command(measured.configuration)
                });
                Step {
                    verdict: if learned.is_ok() { Verdict::Used } else { Verdict::Skipped },
                    reason: learned.err(),
                    estimate: before.estimate(),
                    innovation: None,
                    residual_mm,
                    revisions: Vec::new(),
                    restarted: false,
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{estimate, estimate_stem};
    use crate::live::status::GapState;
    use crate::robot::{Effect, Estimate};
    use crate::simulate::{BendingExperiment, Plant, SimulatedEye};
    use nalgebra::{DMatrix, Matrix2};

    #[test]
    fn learns_what_the_estimator_learns_from_the_whole_file() {
        let backlash = || Effect::parse("load_directed_backlash:play_mm=0.08").unwrap();
        for (effects, sd_mm) in [(vec![], 0.0), (vec![backlash()], 0.0), (vec![backlash()], 0.02)] {
            let mut start = Model { effects, ..Model::default() };
            if sd_mm > 0.0 {
                start.covariance = DMatrix::from_fn(3, 3, |a, b| if a + b == 4 { sd_mm * sd_mm } else { 0.0 });
            }
            let plant = Model { eta: 1.221, lambda_mm: 0.1765, samples: Some(0), ..start.clone() };
            let (measurements, readings) = experiment(&plant);
            let mut estimator = OnlineEstimator::new(start.clone(), Options::default(), None).unwrap();
            for (measurement, reading) in measurements.iter().zip(&readings) {
                estimator.update(measurement, Some(reading));
            }
            let (_, whole) = estimate(&start, Options::default(), &measurements, &readings).unwrap();
            let model = estimator.model();
            for (ours, theirs) in model.parameter_values().iter().zip(whole.parameter_values()) {
                assert!((ours - theirs).abs() < 1e-12, "{ours} {theirs}");
            }
            assert!((model.covariance() - whole.covariance()).amax() < 1e-12);
            let is_learned = sd_mm > 0.0 && model.effect_sds(0)[0] < sd_mm / 2.0;
            assert!(is_learned || model.effects == start.effects, "{:?}", model.effects);
            let ours = model.parameters();
            assert!((ours.x - 1.221).abs() < 0.03 && (ours.y - 0.1765).abs() < 0.01, "{ours}");
        }
    }

    #[test]
    fn a_stem_is_followed_as_in_the_whole_file_and_the_model_bends_with_it() {
        let known = Estimate { eta: 1.221, lambda_mm: 0.1765, covariance: Matrix2::zeros(), samples: 36 };
        let model = Model::default().with_estimate(known);
        let mut plant = model.clone();
        plant.robot.line = plant.robot.line.bent_through(130f64.to_radians());
        let (measurements, readings) = experiment(&plant);
        let mut estimator =
            OnlineEstimator::new(model.clone(), Options::default(), Some(StemOptions::default())).unwrap();
        let (rows, whole) = estimate_stem(&model, StemOptions::default(), &measurements, &readings).unwrap();
        for ((measurement, reading), row) in measurements.iter().zip(&readings).zip(&rows) {
            let update = estimator.update(measurement, Some(reading));
            let StemAngle { phi, sd } = update.stem.unwrap();
            assert!((phi - row.phi).abs() < 1e-12 && (sd - row.sd_phi).abs() < 1e-12);
            assert_eq!(update.step.estimate, Some(known), "η and λ are not touched");
        }
        assert_eq!(estimator.model(), whole);
        let at_end = estimator.stem().unwrap();
        assert!((at_end.phi.to_degrees() - 130.0).abs() < 4.0 * at_end.sd.to_degrees(), "{at_end:?}");
        assert!(estimator.reset().unwrap().contains("stem"));
        assert!((estimator.stem().unwrap().phi.to_degrees() - 82.0).abs() < 1e-9);
        assert!(OnlineEstimator::new(Model::default(), Options::default(), Some(StemOptions::default())).is_err());
    }

    #[test]
    fn the_gap_is_noise_where_the_model_holds_and_is_found_where_an_effect_is_missing() {
        let plain = Model { eta: 1.221, lambda_mm: 0.1765, samples: Some(0), ..Model::default() };
        let hidden = vec![Effect::parse("load_directed_backlash:play_mm=0.08").unwrap()];
        let with_effect = Model { effects: hidden, ..plain.clone() };
        let mut estimator = OnlineEstimator::new(Model::default(), Options::default(), None).unwrap();
        let mut states = Vec::new();
        for (plant, seeds) in [(&plain, 0..25), (&with_effect, 25..28)] {
            for seed in seeds {
                let (measurements, readings) = noisy_experiment(plant, seed);
                let pairs = measurements.iter().zip(&readings);
                states.extend(pairs.map(|(m, reading)| estimator.update(m, Some(reading)).gap.state));
            }
        }
        let change = states.len() * 25 / 28;
        assert!(states[..40].iter().all(|state| *state == GapState::Unknown));
        assert!(states[60..change].iter().all(|state| *state == GapState::Noise));
        let found = states[change..].iter().position(|state| *state == GapState::Above);
        assert!(found.is_some_and(|poses| poses < 36), "{found:?}");
    }

    fn experiment(plant: &Model) -> (Vec<Measurement>, Vec<EncoderReading>) {
        noisy_experiment(plant, 1)
    }

    fn noisy_experiment(plant: &Model, seed: u64) -> (Vec<Measurement>, Vec<EncoderReading>) {
        let waypoints = BendingExperiment::default().waypoints().unwrap();
        let samples = Plant { model: plant.clone(), sd_encoder_mm: 0.0015 }.run(&waypoints, seed);
        let measurements = SimulatedEye::default().observe(&samples, seed + 1);
        (measurements, samples.iter().map(|sample| sample.reading).collect())
    }
}
