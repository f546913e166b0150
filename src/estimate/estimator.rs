//! The recursive estimator: measurements in, one at a time; η, λ and what is uncertain in the model's effects out.
//!
//! # How a measurement is judged
//!
//! 1. Not measured, without an encoder reading, not finite or outside the workspace: skipped.
//! 2. The first eight measurements are judged together, after each of them, by least trimmed squares: the majority that agrees best
//!    decides who is an outlier. So a bad first pair is found out by the next ones.
//! 3. From then on the recursion of Eq. 19 runs, and a measurement whose residual is farther from the prediction than
//!    [`Options::gate`] standard deviations, in units of the distance that is typical, is rejected.
//! 4. Eight rejected in a row, of which six agree with each other, mean that the estimate and not the measurements went
//!    wrong (another tool, a re-homed actuator): the estimate starts afresh from these.
//!
//! # What the reported covariance holds
//!
//! The measurements' own (Eq. 21 with V_v measured rather than assumed), inflated by what the residuals show
//! ([`Consistency`](super::Consistency)), and that of what was known of the effects beforehand, which is not inflated; with the rig's errors
//! counted once and not once for each measurement ([`covariance_by_rig`](InformationFilter::covariance_by_rig)); plus what the friction
//! constants' own uncertainty shifts: a wrong f_s moves λ, a wrong μ scales η, and no number of measurements averages that away.

use super::consistency::Whitened;
use super::effects::EffectsPrior;
use super::friction::friction_covariance;
use super::gate::{Gate, squared_distances};
use super::initial::{InitialEstimate, MOST, Undecided};
use super::sample::Follower;
use super::{Consistency, InformationFilter, LinearisedMeasurement, Options, Reason, Sample, Verdict};
use crate::error::Result;
use crate::observation::{EncoderReading, Measurement};
use crate::robot::{DataRange, Estimate, Mechanics, Model, PerBackbone};
use crate::statistics::trimmed::majority;
use nalgebra::{DMatrix, DVector};

/// A verdict on an earlier measurement that a later one overturned.
#[derive(Debug, Clone, PartialEq)]
pub struct Revision {
    /// Which one, counted in calls of [`Estimator::update`] from 0.
    pub update: usize,
    /// `None` if it is used after all.
    pub reason: Option<Reason>,
}

/// What one measurement did.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// What became of it.
    pub verdict: Verdict,
    /// Why it was not used.
    pub reason: Option<Reason>,
    /// The estimate after it; `None` while measurements do not pin both parameters.
    pub estimate: Option<Estimate>,
    /// Measured ε less what the estimate before it predicted, per backbone, mm; `None` before the first estimate.
    pub residual_mm: Option<PerBackbone>,
    /// The innovation: what the estimate before it did not predict, whitened by the predicted covariance; `None` while the first
    /// measurements are judged together.
    pub innovation: Option<Whitened>,
    /// Earlier verdicts that this measurement changed.
    pub revisions: Vec<Revision>,
    /// Whether the estimate started afresh, leaving all measurements before the last eight behind.
    pub restarted: bool,
}

/// The recursive estimator of η, λ and the uncertain parameters of the effects.
#[derive(Debug, Clone)]
pub struct Estimator {
    /// The model that was given.
    given: Model,
    /// The same, with the estimate as it stands and the bends that it was learned on. Measurements are linearised about it: until the first ones
    /// are judged for good its effects are as they were given, since so these measurements came.
    model: Model,
    /// What is known of the effects beforehand.
    prior: EffectsPrior,
    /// What the effects remember.
    follower: Follower,
    options: Options,
    updates: usize,
    /// `None` until the first measurements are judged for good.
    running: Option<(InformationFilter, Consistency)>,
    /// x̂ and its covariance as they were last published.
    published: Option<(DVector<f64>, DMatrix<f64>)>,
    /// Measurements whose verdict may still change: the first ones, or those rejected in a row since the last one used.
    undecided: Vec<Undecided>,
    gate: Gate,
}

impl Estimator {
    /// Starts with nothing known of η and λ: an estimate that the model already has is not used, since it may come from
    /// the very measurements to follow. What the model says of its effects must come from other measurements: an effect's parameters with a
    /// standard deviation are estimated as well, from there on, and all others are obeyed as they are given.
    ///
    /// # Errors
    /// [`ArgumentError::OutOfRange`](crate::error::ArgumentError::OutOfRange) for an option out of its range.
    pub fn new(model: &Model, options: Options) -> Result<Self> {
        options.check()?;
        let prior = EffectsPrior::of(model);
        Ok(Self {
            given: model.clone(),
            model: model.without_estimate(),
            follower: Follower::by_parameters(prior.parameters()),
            prior,
            options,
            updates: 0,
            running: None,
            published: None,
            undecided: Vec::new(),
            gate: Gate::new(options.gate),
        })
    }

    /// The model with the estimate as it stands.
    pub fn model(&self) -> Model {
        let mut model = self.model.clone();
        if let Some((x, covariance)) = &self.published {
            self.prior.place(&mut model, x, covariance);
        }
        model
    }

    /// How residuals compare with their promised covariances; `None` while the first measurements are being judged.
    pub fn consistency(&self) -> Option<&Consistency> {
        self.running.as_ref().map(|(_, consistency)| consistency)
    }

    /// Takes a reading whose frame was not measured, or for which none was taken: it drives the effects that have a memory.
    pub fn pass(&mut self, reading: &EncoderReading) {
        self.follower.pass(Self::followed(&self.given, &self.model), reading);
    }

    /// The model that the log is followed by: the one that was given until there is an estimate, so that nothing jumps when there is one.
    fn followed<'m>(given: &'m Model, model: &'m Model) -> &'m Model {
        if model.estimate().is_some() { model } else { given }
    }

    /// Takes one measurement and the encoder reading of the same index.
    pub fn update(&mut self, measurement: &Measurement, reading: Option<&EncoderReading>) -> Step {
        let sample = self.take(measurement, reading);
        self.learn(sample)
    }

    /// What of a measurement and its reading can be used; they are not learned from yet.
    ///
    /// # Errors
    /// Why nothing of it can be used.
    pub(crate) fn take(
        &mut self,
        measurement: &Measurement,
        reading: Option<&EncoderReading>,
    ) -> std::result::Result<Sample, Reason> {
        self.follower.take(Self::followed(&self.given, &self.model), measurement, reading)
    }

    /// Learns from what [`take`](Self::take) gave.
    pub(crate) fn learn(&mut self, sample: std::result::Result<Sample, Reason>) -> Step {
        let number = self.updates;
        self.updates += 1;
        let mut step = Step {
            verdict: Verdict::Skipped,
            reason: None,
            estimate: self.model.estimate(),
            residual_mm: None,
            innovation: None,
            revisions: Vec::new(),
            restarted: false,
        };
        match sample {
            Ok(sample) => self.judge(Undecided { update: number, sample, reported_used: true }, &mut step),
            Err(reason) => step.reason = Some(reason),
        }
        step
    }

    fn judge(&mut self, sample: Undecided, step: &mut Step) {
        let linearised = sample.linearised(&self.model, &self.options);
        step.residual_mm = self.published.as_ref().map(|(x, _)| self.residual_mm(x, &sample.sample, &linearised));
        step.reason = match self.running.take() {
            None => self.first_measurement(sample, step),
            Some((filter, consistency)) => self.next_measurement(filter, consistency, sample, &linearised, step),
        };
        step.verdict = if step.reason.is_some() { Verdict::Rejected } else { Verdict::Used };
        step.estimate = self.model.estimate();
    }

    /// One of the first measurements: all of them are judged anew, and for good once there are enough.
    fn first_measurement(&mut self, sample: Undecided, step: &mut Step) -> Option<Reason> {
        self.hold(sample);
        let initial = InitialEstimate::of(&self.undecided, &self.model, &self.prior, &self.options)?;
        step.revisions = self.revise(&initial);
        let own = initial.outliers.last().cloned().flatten();
        if self.undecided.len() == MOST {
            self.run_from(initial);
        } else {
            self.model.learned = Some(self.range_of(&initial));
            let consistency = Consistency::of_fit(&initial.x, initial.agreeing());
            self.publish(&initial.filter, &consistency);
        }
        own
    }

    /// Eq. 19 for one more measurement, behind the gate.
    fn next_measurement(
        &mut self,
        mut filter: InformationFilter,
        mut consistency: Consistency,
        sample: Undecided,
        linearised: &LinearisedMeasurement,
        step: &mut Step,
    ) -> Option<Reason> {
        let predicted = filter.solution().and_then(|(x, covariance)| {
            let (residual, predicted) = (linearised.residual(x.as_slice()), linearised.predicted(&covariance));
            Some((Whitened::new(&residual, &predicted)?, squared_distances(linearised, &residual, &predicted)?))
        });
        let Some((whitened, distances)) = predicted else {
            self.running = Some((filter, consistency));
            return Some(Reason::NotFinite);
        };
        step.innovation = Some(whitened);
        let outlier = self.gate.outlier(&distances);
        self.gate.remember(distances);
        if let Some(outlier) = outlier {
            self.running = Some((filter, consistency));
            return self.reject(sample, outlier, step);
        }
        self.undecided.clear();
        if self.options.forgetting < 1.0 {
            filter.forget(self.options.forgetting);
            consistency.forget(self.options.forgetting);
        }
        filter.absorb(linearised);
        consistency.add(&whitened);
        let measured = sample.sample.measured;
        self.model.learned.get_or_insert_default().add(
            measured.configuration,
            measured.sigma_theta,
            measured.sigma_delta,
        );
        self.go_on(filter, consistency);
        None
    }

    /// Rejects a measurement, or starts afresh where those rejected in a row agree with each other.
    fn reject(&mut self, sample: Undecided, outlier: Reason, step: &mut Step) -> Option<Reason> {
        self.hold(Undecided { reported_used: false, ..sample });
        if self.undecided.len() < MOST {
            return Some(outlier);
        }
        let fresh = InitialEstimate::of(&self.undecided, &self.model, &self.prior, &self.options);
        // One more than the majority, so that chance does not end a good estimate.
        let Some(initial) = fresh.filter(|initial| initial.agreeing().count() > majority(MOST)) else {
            return Some(outlier);
        };
        step.revisions = self.revise(&initial);
        step.restarted = true;
        let own = initial.outliers.last().cloned().flatten();
        self.run_from(initial);
        own
    }

    /// Holds a measurement among the undecided; where there are enough the earliest makes room.
    fn hold(&mut self, sample: Undecided) {
        if self.undecided.len() == MOST {
            self.undecided.remove(0);
        }
        self.undecided.push(sample);
    }

    /// The verdicts on earlier measurements that differ from those reported before. The latest gets its own now.
    fn revise(&mut self, initial: &InitialEstimate) -> Vec<Revision> {
        let mut revisions = Vec::new();
        for (sample, outlier) in self.undecided.iter_mut().zip(&initial.outliers) {
            if sample.reported_used != outlier.is_none() && sample.update + 1 != self.updates {
                revisions.push(Revision { update: sample.update, reason: outlier.clone() });
            }
            sample.reported_used = outlier.is_none();
        }
        revisions
    }

    /// The bends of the undecided measurements that agree.
    fn range_of(&self, initial: &InitialEstimate) -> DataRange {
        let mut range = DataRange::default();
        for (sample, _) in self.undecided.iter().zip(&initial.outliers).filter(|(_, outlier)| outlier.is_none()) {
            let measured = sample.sample.measured;
            range.add(measured.configuration, measured.sigma_theta, measured.sigma_delta);
        }
        range
    }

    /// Begins the recursion with what the first measurements say.
    fn run_from(&mut self, initial: InitialEstimate) {
        self.model.learned = Some(self.range_of(&initial));
        let consistency = Consistency::of_fit(&initial.x, initial.agreeing());
        self.undecided.clear();
        self.gate.restart(initial.squared_distances());
        self.go_on(initial.filter, consistency);
    }

    /// Publishes what the recursion has arrived at, and linearises about it from now on.
    fn go_on(&mut self, filter: InformationFilter, consistency: Consistency) {
        self.publish(&filter, &consistency);
        self.running = Some((filter, consistency));
        if let Some((x, covariance)) = &self.published {
            self.prior.place(&mut self.model, x, covariance);
        }
    }

    /// Measured ε less what the estimate predicts, per backbone, mm.
    fn residual_mm(&self, x: &DVector<f64>, sample: &Sample, linearised: &LinearisedMeasurement) -> PerBackbone {
        let robot = &self.model.robot;
        let told = linearised.residual(x.as_slice());
        // What the linearised measurement leaves out of the readings: the parts that neither bend nor are common to all.
        let mechanics = Mechanics::new(&self.model);
        let left = match &sample.came {
            Some(came) => mechanics.misfit_mm(&sample.q_tilde, came.solution.bend, &came.motion),
            None => sample.q_tilde,
        };
        robot.from_bend_and_common(&(told - robot.bend_and_common(&left))) + left
    }

    /// Makes a filter's x̂ the estimate, with its honest covariance.
    fn publish(&mut self, filter: &InformationFilter, consistency: &Consistency) {
        let Some((x, covariance)) = filter.solution() else { return };
        let mut honest = consistency.inflate(&covariance, &filter.covariance_by_prior(&covariance))
            + filter.covariance_by_rig(&covariance);
        let mut of_estimate = honest.fixed_view_mut::<2, 2>(0, 0);
        of_estimate += friction_covariance(&self.model, x[0]);
        // Rounding leaves the last digits of the two halves apart.
        let honest = (&honest + honest.transpose()) / 2.0;
        (self.model.eta, self.model.lambda_mm, self.model.samples) = (x[0], x[1], Some(filter.measurements()));
        self.model.covariance.view_mut((0, 0), (2, 2)).copy_from(&honest.view((0, 0), (2, 2)));
        self.published = Some((x, honest));
    }
}
