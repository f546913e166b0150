//! The reverse of a load in the statics: which force on the tip explains a measured deflection.
//!
//! With η and λ known, Eq. 18 with Eq. 9's wrench says at a measured bend b
//!
//! ```text
//! q̃ − q(b) − ε(b) = −η κ Q(QᵗQ)⁻¹ J_pbᵗ F + noise,      J_pb the tip's velocity per rad of b
//! ```
//!
//! linear in the force F (N, in {b}) that the environment applies at the centre of the end disk's far face. The noise is that of a
//! [`LinearisedMeasurement`](super::LinearisedMeasurement); the errors of η and λ are common to all measurements and estimated beside F, held by their covariance.
//!
//! # What cannot be seen
//!
//! A snake of constant curvature moves its tip on a surface. A force square to that surface does no work on it and moves nothing: one
//! measurement sees two directions of three, and a straight snake none along itself. Measurements at different bends under the same
//! force have different blind directions and together see all three. A direction along which the force would be known to no
//! better than [`BLIND_SD_N`] counts as unseen; the force has no part along it, and its covariance says nothing there.
//!
//! The blind direction of a measurement is that of the bend as it was measured, so that noise alone makes it wander, and many measurements of one pose
//! seem to see all three. That information N = Σ (∂H/∂b σ_b)ᵗ W (∂H/∂b σ_b) is no motion of the snake: its errors are those of the residuals, and
//! push the force by up to n N/√I of its σ, of n measurements with the information I. A direction in which that is above one counts as unseen too.

use super::options::check_sd_encoder;
use super::sample::{Follower, Log};
use super::{LinearisedMeasurement, Sample, Weighting};
use crate::error::{ArgumentError, DataError, Result};
use crate::geometry::Configuration;
use crate::observation::{EncoderReading, Measured, Measurement};
use crate::robot::effects::{TIP_LOAD, physics};
use crate::robot::{Effect, Model};
use crate::statistics::information::SquareRootInformation;
use nalgebra::{DVector, Matrix2, Matrix2xX, Matrix3, Matrix3xX, Vector2, Vector3};

/// The standard deviation, N, from which a direction counts as unseen.
///
/// Convention: ten newtons are more than such a snake bears, so that a force known no better is not known.
pub const BLIND_SD_N: f64 = 10.0;

/// A force on the tip, and how well it is known.
#[derive(Debug, Clone, PartialEq)]
pub struct TipForce {
    /// F, N, in {b}; nothing of it lies along the unseen directions.
    pub force_n: Vector3<f64>,
    /// Covariance of F, N², within the directions that are seen.
    pub covariance_n2: Matrix3<f64>,
    /// Unit vectors along which a force cannot be told.
    pub unseen: Vec<Vector3<f64>>,
}

impl TipForce {
    /// The force as an effect of a model that is loaded by it.
    pub fn effect(&self) -> Option<Effect> {
        Some(Effect::of(physics(TIP_LOAD)?, self.force_n.iter().copied().collect()))
    }
}

/// The force that explains one measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredForce {
    /// The force, N, in {b}.
    pub force_n: Vector3<f64>,
    /// Its standard deviations within the directions that are seen, N.
    pub sd_n: Vector3<f64>,
    /// The direction, a unit vector, along which a force moves nothing.
    pub unseen: Option<Vector3<f64>>,
}

/// One row of force.csv.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceRow {
    /// The frame's index.
    pub index: u64,
    /// Time, s.
    pub time_s: Option<f64>,
    /// The force, where there was a measurement.
    pub force: Option<MeasuredForce>,
    /// Why the measurement was not used, in snake_case; `None` where it was.
    pub reason: Option<String>,
}

/// What measurements say of one force F beside η and λ, which are known within their covariance.
///
/// The parameters are two independent unit errors, which the covariance's root turns into those of η and λ, and F: nothing is asked of a
/// covariance that has no inverse, such as that of η and λ that are known exactly.
#[derive(Debug, Clone)]
struct ForceFilter {
    information: SquareRootInformation,
    /// L of the covariance L Lᵗ of (η, λ).
    root: Matrix2<f64>,
    /// The information on F that noise of the bends makes, N⁻².
    by_noise: Matrix3<f64>,
    /// How many measurements were added.
    count: usize,
}

impl ForceFilter {
    fn new(model: &Model) -> Self {
        let own = model.parameter_covariance().symmetric_eigen();
        let root = own.eigenvectors * Matrix2::from_diagonal(&own.eigenvalues.map(|value| value.max(0.0).sqrt()));
        let mut information = SquareRootInformation::none(5);
        let _ = information.absorb(&Matrix2xX::identity(5), &Vector2::zeros());
        Self { information, root, by_noise: Matrix3::zeros(), count: 0 }
    }

    /// Adds one measurement; one whose covariance is not positive definite says nothing.
    fn add(&mut self, model: &Model, sd_encoder_mm: f64, sample: &Sample) {
        let one = LinearisedMeasurement::new(model, Weighting::Measured, sd_encoder_mm, sample);
        let mut h = Matrix3xX::zeros(5);
        h.fixed_columns_mut::<2>(0).copy_from(&(&one.h * self.root));
        h.fixed_columns_mut::<3>(2).copy_from(&by_force(model, sample.measured.configuration));
        let residual = one.residual(model.parameters().as_slice());
        if let (Some(h), Some(residual)) = (one.whitened(&h), one.whitened(&residual))
            // Numbers that are not finite say nothing either.
            && self.information.absorb(&h, &residual)
        {
            self.count += 1;
            let wander = by_noise(model, &sample.measured).into_iter().filter_map(|part| one.whitened(&part));
            self.by_noise += wander.map(|part| part.transpose() * part).sum::<Matrix3<f64>>();
        }
    }

    /// The force, once η and λ are let go within their covariance.
    fn force(&self) -> TipForce {
        let is_seen = |direction: &DVector<f64>, sd_n: f64| {
            let by_noise = direction.dot(&(self.by_noise * direction));
            sd_n < BLIND_SD_N && self.count as f64 * by_noise * sd_n * sd_n < 1.0
        };
        let (force_n, covariance_n2, unseen) = self.information.of_last(3).seen(is_seen);
        let in_space = |vector: &DVector<f64>| vector.fixed_rows::<3>(0).into_owned();
        TipForce {
            force_n: in_space(&force_n),
            covariance_n2: covariance_n2.fixed_view::<3, 3>(0, 0).into_owned(),
            unseen: unseen.iter().map(in_space).collect(),
        }
    }
}

/// ∂q̃/∂F at a pose, mm/N, as bend and common part.
fn by_force(model: &Model, psi: Configuration) -> Matrix3<f64> {
    let tip = model.robot.tip_jacobian_bend(psi.bend_vector());
    let scale = -(model.parameters().x * model.line_compliance_mm_per_n());
    let columns = [0, 1, 2].map(|axis| {
        let on_bend = tip.fixed_view::<1, 2>(axis, 0).transpose();
        model.robot.bend_and_common(&(model.robot.bend_by_displacement() * on_bend)) * scale
    });
    Matrix3::from_columns(&columns)
}

/// By how much [`by_force`] wanders with each of a measured bend's two independent errors of one standard deviation, mm/N.
fn by_noise(model: &Model, measured: &Measured) -> [Matrix3<f64>; 2] {
    let psi = measured.configuration;
    let errors = measured.bend_covariance(psi).symmetric_eigen();
    [0, 1].map(|k| {
        let error = errors.eigenvectors.column(k) * errors.eigenvalues[k].max(0.0).sqrt();
        let at = |sign: f64| by_force(model, Configuration::from_bend_vector(psi.bend_vector() + error * sign));
        (at(1.0) - at(-1.0)) / 2.0
    })
}

/// The force that explains each measurement, as the rows of force.csv, and the one force that explains all of them together.
///
/// The model's effects are obeyed, a `tip_load` among them: the force found is what comes on top.
///
/// # Errors
/// [`ArgumentError`] for a model without η and λ or encoder noise that is not above 0; [`DataError::NoMeasurement`] where no measurement can be used.
pub fn tip_force(
    model: &Model,
    sd_encoder_mm: f64,
    measurements: &[Measurement],
    readings: &[EncoderReading],
) -> Result<(Vec<ForceRow>, TipForce)> {
    if model.estimate().is_none() {
        return Err(ArgumentError::NoEstimate { what: "a force" }.into());
    }
    check_sd_encoder(sd_encoder_mm)?;
    let (mut log, mut follower) = (Log::new(model, readings), Follower::default());
    let mut all = ForceFilter::new(model);
    let mut used = 0;
    let rows = measurements
        .iter()
        .map(|measurement| {
            let (before, reading) = log.until(measurement.index);
            before.iter().for_each(|reading| follower.pass(model, reading));
            let found = follower.take(model, measurement, reading).map(|sample| {
                used += 1;
                all.add(model, sd_encoder_mm, &sample);
                let mut alone = ForceFilter::new(model);
                alone.add(model, sd_encoder_mm, &sample);
                alone.force()
            });
            ForceRow {
                index: measurement.index,
                time_s: measurement.time_s,
                force: found.as_ref().ok().map(|found| MeasuredForce {
                    force_n: found.force_n,
                    sd_n: found.covariance_n2.diagonal().map(|variance| variance.max(0.0).sqrt()),
                    unseen: found.unseen.first().copied(),
                }),
                reason: found.err().map(|reason| reason.to_string()),
            }
        })
        .collect();
    if used == 0 {
        return Err(DataError::NoMeasurement.into());
    }
    Ok((rows, all.force()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{Options, estimate};
    use crate::observation::Waypoint;
    use crate::robot::Estimate;
    use crate::simulate::{BendingExperiment, Plant, SimulatedEye};

    fn model(sd_eta: f64, sd_lambda_mm: f64) -> Model {
        let covariance = Matrix2::new(sd_eta.powi(2), 0.0, 0.0, sd_lambda_mm.powi(2));
        let estimate = Estimate { eta: 1.221, lambda_mm: 0.1765, covariance, samples: 36 };
        Model::default().with_estimate(estimate)
    }

    fn loaded(force_n: Vector3<f64>) -> Effect {
        let names = ["fx_n", "fy_n", "fz_n"];
        let values: Vec<_> = names.iter().zip(&force_n).map(|(name, f)| ((*name).to_owned(), *f)).collect();
        Effect::new("tip_load", None, &values, 3).unwrap()
    }

    /// Measurements of a bending experiment under a force.
    fn ride(model: &Model, force_n: Vector3<f64>, seed: u64) -> (Vec<Measurement>, Vec<EncoderReading>) {
        let plant = Plant { model: Model { effects: vec![loaded(force_n)], ..model.clone() }, sd_encoder_mm: 0.0015 };
        let samples = plant.run(&BendingExperiment::default().waypoints().unwrap(), seed);
        let readings = samples.iter().map(|sample| sample.reading).collect();
        (SimulatedEye::default().observe(&samples, seed + 1), readings)
    }

    #[test]
    fn one_force_over_many_bends_is_found_with_an_honest_covariance() {
        let truth = Vector3::new(0.2, -0.1, 0.15);
        let (mut distances, draws) = (0.0, 60);
        for seed in 0..draws {
            // The model's η and λ are off by what their covariance says.
            let offset = if seed % 2 == 0 { 1.0 } else { -1.0 };
            let mut robot = model(0.0, 0.0);
            robot.eta += 0.001 * offset;
            let (measurements, readings) = ride(&robot, truth, 10 * seed);
            let (rows, found) = tip_force(&model(0.001, 0.001), 0.0015, &measurements, &readings).unwrap();
            assert_eq!((rows.len(), found.unseen.len()), (36, 0));
            let off = found.force_n - truth;
            distances += off.dot(&(found.covariance_n2.try_inverse().unwrap() * off)) / 3.0;
            assert!(off.norm() < 0.2, "{off}");
        }
        let scale = (distances / draws as f64).sqrt();
        assert!((0.8..1.25).contains(&scale), "{scale}");
    }

    #[test]
    fn the_unseen_direction_is_the_one_that_moves_nothing() {
        let model = model(0.001, 0.0005);
        let (measurements, readings) = ride(&model, Vector3::new(0.3, 0.0, 0.0), 4);
        let (rows, _) = tip_force(&model, 0.0015, &measurements, &readings).unwrap();
        for (row, measurement) in rows.iter().zip(&measurements) {
            let MeasuredForce { force_n, unseen, .. } = row.force.unwrap();
            let unseen = unseen.expect("one measurement sees two directions");
            let psi = measurement.measured.unwrap().configuration;
            assert!((by_force(&model, psi) * unseen).norm() < 1e-6 && (unseen.norm() - 1.0).abs() < 1e-9);
            assert!(force_n.dot(&unseen).abs() < 1e-6 * (1.0 + force_n.norm()));
            // The same command holds the snake with any force along it.
            let pushed = Model { effects: vec![loaded(unseen * 3.0)], ..model.clone() };
            assert!((pushed.command(psi) - model.command(psi)).norm() < 1e-9);
        }
        let straight = by_force(&model, Configuration::new(0.0, 0.0));
        assert!((straight * Vector3::z()).norm() < 1e-12);
    }

    #[test]
    fn many_measurements_of_one_pose_see_two_directions_as_one_measurement_does() {
        let robot = model(0.001, 0.0005);
        let psi = Configuration::from_degrees(50.0, 30.0);
        let held: Vec<Waypoint> = (0..20).map(|k| Waypoint::new(f64::from(k), psi)).collect();
        let samples = Plant { model: robot.clone(), sd_encoder_mm: 0.0015 }.run(&held, 3);
        let readings: Vec<_> = samples.iter().map(|sample| sample.reading).collect();
        for seed in 0..20 {
            let measurements = SimulatedEye::default().observe(&samples, seed);
            let (_, found) = tip_force(&robot, 0.0015, &measurements, &readings).unwrap();
            assert_eq!(found.unseen.len(), 1, "{found:?}");
            assert!(found.force_n.norm() < 0.2, "{found:?}");
        }
    }

    #[test]
    fn a_known_load_is_obeyed_by_the_estimator_and_by_the_table() {
        let force = Vector3::new(0.3, 0.2, -0.4);
        let (measurements, readings) = ride(&model(0.0, 0.0), force, 9);
        let start = Model { effects: vec![loaded(force)], ..Model::default() };
        let (_, found) = estimate(&start, Options::default(), &measurements, &readings).unwrap();
        let x = found.estimate().unwrap();
        assert!((x.eta - 1.221).abs() < 3.0 * x.sd_eta() && x.sd_eta() < 0.01, "{} ± {}", x.eta, x.sd_eta());
        assert!((x.lambda_mm - 0.1765).abs() < 3.0 * x.sd_lambda_mm());
        // The commanded forces balance the loaded snake: Eq. 9 with the corrected sign, by the energy's slope.
        let psi = Configuration::from_degrees(40.0, 70.0);
        let moment = Effect::parse("tip_load:fx_n=0.3,fy_n=0.2,fz_n=-0.4,mx_n_mm=2,my_n_mm=-1,mz_n_mm=0.5").unwrap();
        let loaded = Model { effects: vec![moment], ..model(0.0, 0.0) };
        let wrench = nalgebra::Vector6::new(0.3, 0.2, -0.4, 2.0, -1.0, 0.5);
        let tau = loaded.robot.actuation_forces(psi.bend_vector(), Some(&wrench));
        let expected = loaded.robot.joint_displacements(psi)
            + (tau * (1.221 * loaded.line_compliance_mm_per_n())).add_scalar(loaded.static_friction_mm() + 0.1765);
        assert!((loaded.command(psi) - expected).norm() < 1e-9);
    }
}
