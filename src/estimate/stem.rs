//! The flexible stem: how far the actuation line is bent, when everything else about it is known.
//!
//! Section V's generalisation. With η, λ, μ and f_s known, Eq. 18 is linear in the capstan factor y = e^{μΦ} of the line's total
//! bending angle Φ (the cone's is 2φ = 82°):
//!
//! ```text
//! q̃ − q − η K_d⁻¹ τ − λ = K_c⁻¹ (η τ + f_s) y        Φ = ln y / μ
//! ```
//!
//! so that one number is estimated, by the same linearised measurements as η and λ ([`LinearisedMeasurement`]), with forgetting: at each measurement
//! all earlier information is multiplied by the forgetting factor. The line's length, and so K_c, stays as the stem changes its shape.
//!
//! # What it can and cannot do
//!
//! Forgetting trades noise for lag: with a factor f a stem that bends steadily is followed f/(1 − f) measurements late, and the noise
//! is that of (1 + f)/(1 − f) measurements. The reported standard deviation holds the measurements' noise, what the errors of
//! η, λ, μ and f_s do to Φ, and, where predictions miss by more than both, as they do while the stem moves, that excess. A measurement
//! beyond the estimator's gate pulls no more than one at the gate (Huber's loss): rejected, a stem that jumps would never be found again.
//! A bend's own part of the signal is small beside the stretch in the holder, so a straight snake says next to nothing.
//!
//! η and λ of a model that was estimated with the line at a known angle share their errors with μ and f_s; at that angle these
//! cancel, and Φ is known best near it.

use super::friction::parameters_by_friction;
use super::options::{DEFAULT_GATE_SD, DEFAULT_SD_ENCODER_MM, check_forgetting, check_sd_encoder};
use super::sample::{Follower, Log};
use super::{LinearisedMeasurement, Reason, Sample, Weighting};
use crate::error::{ArgumentError, Result};
use crate::observation::{EncoderReading, Measurement};
use crate::robot::Model;
use crate::statistics::correlation::SerialScatter;
use crate::statistics::robust::Loss;
use nalgebra::{Matrix2, Matrix4, Vector1, Vector3, Vector4};
use std::f64::consts::PI;

/// The standard deviation of Φ before the first measurement, about the model's, rad.
///
/// Convention: half a turn, which says next to nothing beside one measurement of a bent snake.
const PRIOR_SD: f64 = PI;
/// The least y that is believed; a straight line has 1.
///
/// Convention: a numerical guard that keeps ln y finite where noise makes y negative.
const LEAST_FACTOR: f64 = 0.2;
/// The forgetting factor where none is given.
///
/// Convention: a default that `--forgetting` replaces; a memory of 1/(1 − 0.95) = 20 measurements.
const DEFAULT_FORGETTING: f64 = 0.95;

/// How the stem is followed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StemOptions {
    /// Forgetting factor: the share of all earlier information that is kept at each measurement, in (0, 1].
    pub forgetting: f64,
    /// Standard deviation of an encoder reading, mm.
    pub sd_encoder_mm: f64,
}

impl Default for StemOptions {
    /// A memory of twenty measurements, encoders good to 1.5 µm.
    fn default() -> Self {
        Self { forgetting: DEFAULT_FORGETTING, sd_encoder_mm: DEFAULT_SD_ENCODER_MM }
    }
}

/// The stem's total bending angle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StemAngle {
    /// Φ, rad.
    pub phi: f64,
    /// Its standard deviation, rad.
    pub sd: f64,
}

/// One row of stem.csv.
#[derive(Debug, Clone, PartialEq)]
pub struct StemRow {
    /// The frame's index.
    pub index: u64,
    /// Time, s.
    pub time_s: Option<f64>,
    /// Total bending angle of the line, rad.
    pub phi: f64,
    /// Its standard deviation, rad.
    pub sd_phi: f64,
    /// Why the measurement was not used, in snake_case; `None` where it was.
    pub reason: Option<String>,
}

/// Follows the total bending angle of a flexible stem.
#[derive(Debug, Clone)]
pub struct Stem {
    /// The model, with the line bent as it was when η and λ were estimated.
    model: Model,
    /// What its effects remember.
    follower: Follower,
    options: StemOptions,
    /// y = e^{μΦ}.
    factor: f64,
    /// Sum of the measurements' weights, multiplied by the forgetting factor at each.
    information: f64,
    /// Variance of the weighted sum of which y is the mean: the weights, multiplied by the factor's square.
    noise: f64,
    /// What is never forgotten.
    least_information: f64,
    /// ∂(information · y)/∂(η, λ, f_s), by which their errors move y.
    by_parameters: Vector3<f64>,
    /// How the innovations compare with what is promised.
    scatter: SerialScatter<1>,
}

impl Stem {
    /// Starts at the model's own line.
    ///
    /// # Errors
    /// [`ArgumentError`] for a model without an estimate of η and λ, without friction, or for an option out of its range.
    pub fn new(model: &Model, options: StemOptions) -> Result<Self> {
        if model.estimate().is_none() {
            return Err(ArgumentError::NoEstimate { what: "the stem's angle" }.into());
        }
        if model.friction.mu <= 0.0 {
            return Err(ArgumentError::NoFriction { mu: model.friction.mu }.into());
        }
        check_forgetting(options.forgetting)?;
        check_sd_encoder(options.sd_encoder_mm)?;
        let factor = (model.friction.mu * model.robot.line.total_angle()).exp();
        let information = (factor * model.friction.mu * PRIOR_SD).powi(-2);
        Ok(Self {
            model: model.clone(),
            follower: Follower::default(),
            options,
            factor,
            information,
            noise: information,
            least_information: information,
            by_parameters: Vector3::zeros(),
            scatter: SerialScatter::new(0),
        })
    }

    /// Takes one measurement and the encoder reading of the same index; the angle after it.
    ///
    /// # Errors
    /// The reason why the measurement says nothing; the angle stays as it was.
    pub fn update(
        &mut self,
        measurement: &Measurement,
        reading: Option<&EncoderReading>,
    ) -> std::result::Result<StemAngle, Reason> {
        let sample = self.take(measurement, reading)?;
        self.learn(&sample)
    }

    /// Takes a reading whose frame was not measured: it drives the effects that have a memory.
    pub fn pass(&mut self, reading: &EncoderReading) {
        self.follower.pass(&self.model(), reading);
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
        let bent = self.model();
        self.follower.take(&bent, measurement, reading)
    }

    /// Learns from what [`take`](Self::take) gave; the angle after it.
    ///
    /// # Errors
    /// The reason why the measurement says nothing; the angle stays as it was.
    pub(crate) fn learn(&mut self, sample: &Sample) -> std::result::Result<StemAngle, Reason> {
        let bent = self.model();
        let linearised = LinearisedMeasurement::new(&bent, Weighting::Measured, self.options.sd_encoder_mm, sample);
        let eta = bent.parameters().x;
        // The columns of H are κτ and 1, and what effects make of them.
        let [stretch, ones] = [0, 1].map(|axis| linearised.h.column(axis).into_owned());
        let cone_compliance = bent.robot.cone_compliance_mm_per_n();
        let tau = stretch / bent.line_compliance_mm_per_n();
        let by_factor = (tau * eta + ones * bent.friction.static_force_n) * cone_compliance;
        let Some(weight) = linearised.covariance.try_inverse() else { return Err(Reason::NotFinite) };

        let mut gained = by_factor.dot(&(weight * by_factor));
        if !(gained > 0.0 && gained.is_finite()) {
            return Err(Reason::NotFinite);
        }
        self.forget();
        let innovation = by_factor.dot(&(weight * linearised.residual(bent.parameters().as_slice()))) / gained;
        let distance = innovation / (1.0 / gained + self.variance()).sqrt();
        let share = Loss::Huber(DEFAULT_GATE_SD).weight(distance);
        self.noise += gained * share.powi(2);
        gained *= share;
        let static_part = ones * (self.factor * cone_compliance);
        let by_errors = [stretch, ones, static_part].map(|by| by_factor.dot(&(weight * by)) * share);
        self.by_parameters -= Vector3::from(by_errors);
        self.scatter.add(Vector1::new(distance.clamp(-DEFAULT_GATE_SD, DEFAULT_GATE_SD)));
        self.information += gained;
        self.factor = (self.factor + innovation * gained / self.information).max(LEAST_FACTOR);
        Ok(self.angle())
    }

    /// The angle as it stands.
    pub fn angle(&self) -> StemAngle {
        let mu = self.model.friction.mu;
        let phi = self.factor.ln() / mu;
        let by_factor = 1.0 / (self.factor * mu);
        let noise = by_factor.powi(2) * self.variance() * self.scatter.reduced_chi_square().max(1.0);
        let [by_eta, by_lambda, by_static] = (self.by_parameters * (by_factor / self.information)).into();
        let by_errors = Vector4::new(by_eta, by_lambda, -phi / mu, by_static);
        let known = by_errors.dot(&(self.covariance() * by_errors));
        StemAngle { phi, sd: (noise + known.max(0.0)).sqrt() }
    }

    /// The model with the stem bent as far as it was found to be: what to compensate with.
    pub fn model(&self) -> Model {
        let mut model = self.model.clone();
        model.robot.line = model.robot.line.bent_through((self.factor.ln() / self.model.friction.mu).max(0.0));
        model
    }

    /// Variance of y from the measurements' noise.
    fn variance(&self) -> f64 {
        self.noise / self.information.powi(2)
    }

    fn forget(&mut self) {
        let kept = (self.options.forgetting * self.information).max(self.least_information.min(self.information));
        self.by_parameters *= kept / self.information;
        self.noise *= (kept / self.information).powi(2);
        self.information = kept;
        self.scatter.forget(self.options.forgetting);
    }

    /// Covariance of (η, λ, μ, f_s).
    fn covariance(&self) -> Matrix4<f64> {
        let estimate = self.model.parameter_covariance();
        let friction = self.model.friction.covariance();
        let by_friction = parameters_by_friction(&self.model, self.model.parameters().x);
        let rest = estimate - by_friction * friction * by_friction.transpose();
        // An estimate that knows η and λ better than μ and f_s allow did not come from an estimation with these.
        let shared = rest.symmetric_eigenvalues().min() > -1e-6 * estimate.norm();
        let cross = if shared { by_friction * friction } else { Matrix2::zeros() };
        Matrix4::from_fn(|a, b| match (a / 2, b / 2) {
            (0, 0) => estimate[(a, b)],
            (0, _) => cross[(a, b - 2)],
            (_, 0) => cross[(b, a - 2)],
            _ => friction[(a - 2, b - 2)],
        })
    }
}

/// Follows the stem through all measurements, in order: the rows of stem.csv and the model with the stem as it was at the end.
///
/// # Errors
/// As [`Stem::new`].
pub fn estimate_stem(
    model: &Model,
    options: StemOptions,
    measurements: &[Measurement],
    readings: &[EncoderReading],
) -> Result<(Vec<StemRow>, Model)> {
    let mut stem = Stem::new(model, options)?;
    let mut log = Log::new(model, readings);
    let rows = measurements
        .iter()
        .map(|measurement| {
            let (before, reading) = log.until(measurement.index);
            before.iter().for_each(|reading| stem.pass(reading));
            let reason = stem.update(measurement, reading).err();
            let StemAngle { phi, sd } = stem.angle();
            StemRow {
                index: measurement.index,
                time_s: measurement.time_s,
                phi,
                sd_phi: sd,
                reason: reason.map(|reason| reason.to_string()),
            }
        })
        .collect();
    Ok((rows, stem.model()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Configuration;
    use crate::observation::Truth;
    use crate::robot::{Estimate, Friction, PerBackbone};
    use crate::simulate::{Sample, SimulatedEye};
    use nalgebra::Vector2;
    use rand::SeedableRng;
    use rand::rngs::StdRng;
    use rand_distr::{Distribution, StandardNormal};

    fn known(friction: Friction) -> Model {
        Model { friction, eta: 1.221, lambda_mm: 0.1765, samples: Some(36), ..Model::default() }
    }

    fn exact() -> Model {
        known(Friction { sd_mu: 0.0, sd_static_force_n: 0.0, ..Friction::default() })
    }

    /// Measurements of a snake that goes up and down while the stem has the angles (degrees) of `stem_deg`.
    fn ride(model: &Model, stem_deg: &[f64], seed: u64) -> Vec<(Measurement, EncoderReading)> {
        let mut random = StdRng::seed_from_u64(seed);
        let samples: Vec<Sample> = (0u64..)
            .zip(stem_deg)
            .map(|(index, phi)| {
                let (at, time_s) = (index as f64, index as f64 * 0.1);
                let psi = Configuration::from_degrees(50.0 + 30.0 * (0.7 * at).sin(), 40.0 * at);
                let mut bent = model.clone();
                bent.robot.line = bent.robot.line.bent_through(phi.to_radians());
                let noise = PerBackbone::from_fn(3, |_| StandardNormal.sample(&mut random)) * 0.0015;
                let reading = EncoderReading::new(index, time_s, bent.command(psi) + noise);
                Sample { reading, truth: Truth { index, configuration: psi }, apparent: psi }
            })
            .collect();
        let eye = SimulatedEye { sigma_theta_deg: 0.05, sigma_across_deg: 0.1 };
        eye.observe(&samples, seed + 7).into_iter().zip(samples.iter().map(|sample| sample.reading)).collect()
    }

    fn followed(model: &Model, options: StemOptions, ride: &[(Measurement, EncoderReading)]) -> Vec<StemAngle> {
        let mut stem = Stem::new(model, options).unwrap();
        ride.iter().map(|(measurement, reading)| stem.update(measurement, Some(reading)).unwrap()).collect()
    }

    #[test]
    fn a_line_bent_otherwise_keeps_its_length() {
        let line = exact().robot.line;
        for degrees in [0.0, 10.0, 82.0, 200.0, 700.0] {
            let bent = line.bent_through(f64::to_radians(degrees));
            assert!((bent.cone_length_mm() - line.cone_length_mm()).abs() < 1e-9, "{degrees}");
            assert!((bent.total_angle().to_degrees() - degrees).abs() < 1e-9);
        }
    }

    #[test]
    fn a_stem_at_rest_is_found_and_its_sigma_holds() {
        let model = exact();
        let mut squares = 0.0;
        let draws = 150;
        for seed in 0..draws {
            let phi = 30.0 + seed as f64;
            let ride = ride(&model, &[phi; 60], 100 * seed);
            let last = *followed(&model, StemOptions::default(), &ride).last().unwrap();
            assert!(last.sd.to_degrees() < 5.0, "{}", last.sd.to_degrees());
            squares += ((last.phi - phi.to_radians()) / last.sd).powi(2);
        }
        let scale = (squares / draws as f64).sqrt();
        assert!((0.8..1.15).contains(&scale), "{scale}");
    }

    #[test]
    fn a_stem_that_bends_steadily_is_followed_as_late_as_the_memory_says() {
        let model = exact();
        let per_step = 1.0;
        let path: Vec<f64> = (0..160).map(|k| 40.0 + per_step * f64::from(k)).collect();
        for forgetting in [0.8, 0.9] {
            let options = StemOptions { forgetting, ..StemOptions::default() };
            let mut lag = 0.0;
            for seed in 0..20 {
                let angles = followed(&model, options, &ride(&model, &path, 1000 * seed));
                let late = |k: usize| path[k] - angles[k].phi.to_degrees();
                lag += (100..160).map(late).sum::<f64>() / 60.0 / 20.0;
            }
            let expected = per_step * forgetting / (1.0 - forgetting);
            assert!((lag / expected - 1.0).abs() < 0.3, "factor {forgetting}: {lag}° behind, expected {expected}°");
        }
    }

    #[test]
    fn after_a_jump_the_sigma_owns_up_and_then_settles() {
        let model = exact();
        let path: Vec<f64> = (0..200).map(|k| if k < 80 { 60.0 } else { 150.0 }).collect();
        let angles =
            followed(&model, StemOptions { forgetting: 0.9, ..StemOptions::default() }, &ride(&model, &path, 5));
        assert!(angles[85].sd > 1.4 * angles[79].sd, "{} {}", angles[85].sd, angles[79].sd);
        assert!((angles[199].phi.to_degrees() - 150.0).abs() < 4.0 * angles[199].sd.to_degrees());
        assert!((angles[140].phi.to_degrees() - 150.0).abs() < 15.0, "{}", angles[140].phi.to_degrees());
    }

    #[test]
    fn errors_of_the_constants_are_in_the_sigma() {
        // The robot's true friction is drawn; the model has the calibrated one, and η and λ as they then come out.
        let friction = Friction::default();
        let lower = friction.covariance().cholesky().unwrap().l();
        let mut random = StdRng::seed_from_u64(11);
        let mut squares = 0.0;
        let draws = 60;
        for seed in 0..draws {
            let draw = lower * Vector2::from_fn(|_, _| -> f64 { StandardNormal.sample(&mut random) });
            let truth = known(Friction {
                mu: friction.mu + draw.x,
                static_force_n: friction.static_force_n + draw.y,
                ..friction
            });
            let mut model = known(friction);
            let shift = parameters_by_friction(&model, 1.221) * -draw;
            let eta = 1.221 + shift.x;
            let by_friction = parameters_by_friction(&model, eta);
            model = model.with_estimate(Estimate {
                eta,
                lambda_mm: 0.1765 + shift.y,
                covariance: by_friction * friction.covariance() * by_friction.transpose(),
                samples: 36,
            });
            let last =
                *followed(&model, StemOptions::default(), &ride(&truth, &[160.0; 80], 500 * seed)).last().unwrap();
            squares += ((last.phi - 160f64.to_radians()) / last.sd).powi(2);
        }
        let scale = (squares / draws as f64).sqrt();
        assert!((0.7..1.3).contains(&scale), "{scale}");
    }

    #[test]
    fn what_cannot_be_told_is_said() {
        let without = Model::default();
        assert!(Stem::new(&without, StemOptions::default()).unwrap_err().to_string().contains("η and λ are known"));
        let nothing_kept = StemOptions { forgetting: 0.0, ..StemOptions::default() };
        assert!(matches!(Stem::new(&exact(), nothing_kept), Err(crate::Error::Argument(_))));
        let mut stem = Stem::new(&exact(), StemOptions::default()).unwrap();
        let (measurement, _) = ride(&exact(), &[82.0], 1)[0].clone();
        let before = stem.angle();
        assert_eq!(stem.update(&measurement, None), Err(Reason::NoEncoderReading));
        assert_eq!(stem.angle(), before);
    }
}
