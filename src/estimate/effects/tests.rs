//! The joint estimate beside a batch fit, the scatter of many experiments, and what is known of exact effects.

use super::*;
use crate::estimate::filter::InformationFilter;
use crate::estimate::{Estimator, LinearisedMeasurement, Options, Verdict, estimate};
use crate::geometry::Configuration;
use crate::observation::{EncoderReading, Measurement};
use crate::robot::{Effect, Mechanics, PathPoint};
use crate::simulate::{BendingExperiment, Plant, SimulatedEye};
use nalgebra::{Matrix2, Matrix3, Matrix3x6, Matrix3xX, Vector3};
use rand::{SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, StandardNormal};

/// The readings' noise, mm (1σ).
///
/// Convention: that of the estimator's default.
const SD_ENCODER_MM: f64 = 0.0015;
/// An effect on the stiffness, one that remembers, one of the eye's time, and two at once; each with its parameters' sds.
const UNCERTAIN: [(&[&str], &[f64]); 4] = [
    (&["superelastic_softening:softening_per_rad2=0.1"], &[0.02]),
    (&["play_at_bend:half_gap_mm=0.08"], &[0.01]),
    (&["camera_latency:latency_s=0.1"], &[0.03]),
    (&["play_at_bend:half_gap_mm=0.08", "primary_compression:compliance_mm_per_n=0.005"], &[0.01, 0.001]),
];

/// A model whose friction is exact and whose effects have these sds, η and λ being known.
fn with_effects(effects: &[&str], sds: &[f64]) -> Model {
    let effects = effects.iter().map(|text| Effect::parse(text).unwrap()).collect();
    let mut model = Model { effects, eta: 1.221, lambda_mm: 0.1765, samples: Some(0), ..Model::default() };
    (model.friction.sd_mu, model.friction.sd_static_force_n) = (0.0, 0.0);
    let variances = [0.0, 0.0].iter().chain(sds).map(|sd| sd * sd);
    model.covariance = DMatrix::from_diagonal(&DVector::from_iterator(2 + sds.len(), variances));
    model
}

fn log(plant: &Model, sweep_poses: usize, seed: u64) -> (Vec<Measurement>, Vec<EncoderReading>) {
    let waypoints = BendingExperiment { jitter_deg: 1.5, sweep_poses, seed, ..Default::default() }.waypoints().unwrap();
    let samples = Plant { model: plant.clone(), sd_encoder_mm: SD_ENCODER_MM }.run(&waypoints, seed + 100);
    (SimulatedEye::default().observe(&samples, seed + 200), samples.iter().map(|sample| sample.reading).collect())
}

/// The parameters of a plant that a model's uncertainty allows for.
fn drawn(model: &Model, random: &mut StdRng) -> Model {
    let covariance = model.covariance();
    let mut values = model.parameter_values();
    for (j, value) in values.iter_mut().enumerate() {
        let gauss: f64 = StandardNormal.sample(random);
        *value += covariance[(j, j)].sqrt() * gauss;
    }
    model.with_parameter_values(&values)
}

/// Weighted least squares over all rows and the prior, by Gauss–Newton: every path is solved anew. Gives the parameters and their covariance.
fn batch(
    model: &Model,
    (measurements, readings): &(Vec<Measurement>, Vec<EncoderReading>),
) -> (DVector<f64>, DMatrix<f64>) {
    let times: Vec<f64> = readings.iter().map(|reading| reading.time_s).collect();
    let q: Vec<_> = readings.iter().map(|reading| reading.q_mm).collect();
    let seen: Vec<_> = measurements.iter().map(|one| one.measured.unwrap().configuration.bend_vector()).collect();
    let covariances: Vec<Matrix2<f64>> = {
        let mechanics = Mechanics::new(model);
        let path = mechanics.solve_path(&times, &q, Some(&seen), Some(seen[0]));
        let of = |(point, one): (&PathPoint, &Measurement)| {
            let (bend, measured) = (point.solution.bend, one.measured.unwrap());
            let line = mechanics.line_jacobian(bend, &point.motion).bend_by_line;
            measured.bend_covariance(Configuration::from_bend_vector(bend))
                + line.cross_gram(&line) * SD_ENCODER_MM.powi(2)
        };
        path.iter().zip(measurements).map(of).collect()
    };
    let prior = model.covariance().diagonal();
    let start = DVector::from_vec(model.parameter_values());
    let residuals = |x: &DVector<f64>| {
        let model = model.with_parameter_values(x.as_slice());
        let mechanics = Mechanics::new(&model);
        let path = mechanics.solve_path(&times, &q, Some(&seen), Some(seen[0]));
        let bends: Vec<_> = path.iter().map(|point| point.solution.bend).collect();
        let exposed = mechanics.exposed_bends(&times, &bends);
        let mut all = Vec::new();
        for k in 0..path.len() {
            let gap = seen[k] - mechanics.apparent_bend(exposed[k]);
            all.extend(covariances[k].cholesky().unwrap().l().solve_lower_triangular(&gap).unwrap().iter());
            all.push(path[k].solution.residual_mm.mean() * 3f64.sqrt() / SD_ENCODER_MM);
        }
        all.extend((2..x.len()).map(|j| (x[j] - start[j]) / prior[j].sqrt()));
        DVector::from_vec(all)
    };
    let mut x = start.clone();
    let mut covariance = DMatrix::zeros(x.len(), x.len());
    for _ in 0..6 {
        let columns: Vec<_> = (0..x.len())
            .map(|j| {
                let step = if j < 2 { 1e-4 } else { 1e-2 * prior[j].sqrt() };
                let at = |sign: f64| {
                    let mut moved = x.clone();
                    moved[j] += sign * step;
                    residuals(&moved)
                };
                (at(1.0) - at(-1.0)) / (2.0 * step)
            })
            .collect();
        let jacobian = DMatrix::from_columns(&columns);
        covariance = jacobian.tr_mul(&jacobian).try_inverse().unwrap();
        x -= &covariance * jacobian.tr_mul(&residuals(&x));
    }
    (x, covariance)
}

#[test]
fn the_joint_estimate_is_the_batch_fit_of_all_rows() {
    let mut random = StdRng::seed_from_u64(3);
    for (effects, sds) in UNCERTAIN {
        let given = with_effects(effects, sds);
        for seed in 0..3 {
            let log = log(&drawn(&given, &mut random), 6, seed);
            let (_, found) = estimate(&given, Options::default(), &log.0, &log.1).unwrap();
            let (x, covariance) = batch(&given, &log);
            for (j, value) in found.parameter_values().into_iter().enumerate() {
                let sd = covariance[(j, j)].sqrt();
                // What the residuals of 36 measurements show inflates variances by up to a half.
                let (off, ratio) = ((value - x[j]) / sd, found.covariance()[(j, j)].sqrt() / sd);
                assert!(off.abs() < 0.3 && (0.95..1.3).contains(&ratio), "{effects:?} {seed} {j}: {off} {ratio}");
            }
        }
    }
}

#[test]
fn what_is_found_scatters_as_its_covariance_says() {
    let (mut random, seeds) = (StdRng::seed_from_u64(7), 60);
    for (effects, sds) in UNCERTAIN {
        let given = with_effects(effects, sds);
        let mut squares = DVector::zeros(2 + sds.len());
        for seed in 0..seeds {
            let plant = drawn(&given, &mut random);
            let (measurements, readings) = log(&plant, 30, 1000 + seed);
            let (_, found) = estimate(&given, Options::default(), &measurements, &readings).unwrap();
            let off = DVector::from_vec(found.parameter_values()) - DVector::from_vec(plant.parameter_values());
            squares += off.component_mul(&off).component_div(&found.covariance().diagonal());
            assert!(found.effect_sds(0)[0] < 0.5 * sds[0], "{effects:?}: {:?}", found.effect_sds(0));
        }
        // χ² of 60 degrees of freedom lies between 35.5 and 92.0 in 99 of 100 (any table).
        assert!(squares.iter().all(|square| (35.5..92.0).contains(square)), "{effects:?} {squares}");
    }
}

#[test]
fn effects_that_are_all_but_exact_give_what_exact_ones_do() {
    for (effects, sds) in UNCERTAIN {
        let [exact, nearly] =
            [0.0, 1e-6].map(|share| with_effects(effects, &sds.iter().map(|sd| sd * share).collect::<Vec<_>>()));
        let (measurements, readings) = log(&exact, 6, 5);
        let [exact, nearly] = [exact, nearly]
            .map(|given| estimate(&given, Options::default(), &measurements, &readings).unwrap().1.estimate().unwrap());
        assert!((exact.eta - nearly.eta).abs() < 1e-5 * exact.sd_eta(), "{exact:?} {nearly:?}");
        assert!((exact.lambda_mm - nearly.lambda_mm).abs() < 1e-5 * exact.sd_lambda_mm());
        assert!((exact.covariance - nearly.covariance).norm() < 1e-6 * exact.covariance.norm());
    }
}

#[test]
fn what_measurements_said_of_an_effect_is_forgotten_and_what_was_known_before_is_not() {
    let prior = EffectsPrior::of(&with_effects(&["play_at_bend:half_gap_mm=0.08"], &[0.01]));
    let row = |h: [f64; 3], z: f64| LinearisedMeasurement {
        z: Vector3::new(z, 0.0, 0.2),
        h: Matrix3xX::from_columns(&[
            Vector3::new(h[0], h[1], 0.0),
            Vector3::new(0.0, 0.0, 1.0),
            Vector3::new(h[1], h[2], 0.0),
        ]),
        covariance: Matrix3::identity() * 1e-4,
        by_rig: Matrix3x6::zeros(),
    };
    let mut filter = InformationFilter::new(&prior);
    let unit = prior.parameters[0].1;
    (0..50).for_each(|_| filter.absorb(&row([0.3, 0.1, 1.0], 0.4)));
    let play = |filter: &InformationFilter| {
        let (x, covariance) = filter.solution().unwrap();
        (x[2] * unit, covariance[(2, 2)].sqrt() * unit)
    };
    let (learned_mm, sd_mm) = play(&filter);
    assert!((learned_mm - 0.08).abs() > 0.1 && sd_mm < 0.002, "{learned_mm} {sd_mm}");
    for _ in 0..2000 {
        filter.forget(0.9);
        filter.absorb(&row([0.0, 0.0, 0.0], 0.0));
    }
    let (known_mm, sd_mm) = play(&filter);
    assert!((known_mm - 0.08).abs() < 1e-4 && (0.0099..=0.01).contains(&sd_mm), "{known_mm} {sd_mm}");
}

#[test]
fn a_fresh_start_goes_back_to_what_was_known_of_the_effects_before() {
    let given = with_effects(&["play_at_bend:half_gap_mm=0.08"], &[0.01]);
    let (measurements, readings) = log(&given, 12, 3);
    let mut estimator = Estimator::new(&given, Options::default()).unwrap();
    let mut sds_mm = Vec::new();
    for (k, (measurement, reading)) in measurements.iter().zip(&readings).enumerate() {
        // All actuators are homed anew.
        let moved_mm = if k < 50 { 0.0 } else { 0.5 };
        let reading = EncoderReading { q_mm: reading.q_mm.add_scalar(moved_mm), ..*reading };
        let step = estimator.update(measurement, Some(&reading));
        assert_eq!(step.restarted, k == 57, "{k}");
        sds_mm.push(estimator.model().effect_sds(0)[0]);
    }
    assert!(sds_mm[56] < 0.005 && sds_mm[57] > 1.3 * sds_mm[56] && sds_mm[57] < 0.01, "{sds_mm:?}");
    assert!((estimator.model().parameters().y - 0.6765).abs() < 0.002);
}

#[test]
fn gross_readings_are_rejected_and_leave_what_is_learned_of_the_effects() {
    for (effects, sds) in UNCERTAIN {
        let given = with_effects(effects, sds);
        let (measurements, readings) = log(&given, 12, 4);
        let mut broken = readings.clone();
        broken[20].q_mm[1] = -99.0;
        broken[40].q_mm[0] = 1e200;
        let learned = |given: &Model, readings: &[EncoderReading]| {
            let (rows, found) = estimate(given, Options::default(), &measurements, readings).unwrap();
            (rows.iter().filter(|row| row.verdict != Verdict::Used).count(), found)
        };
        let ((_, whole), (lost, less)) = (learned(&given, &readings), learned(&given, &broken));
        // What exact effects remember is as wrong after such a reading.
        let (lost_beside_exact, _) = learned(&with_effects(effects, &vec![0.0; sds.len()]), &broken);
        assert_eq!(lost, lost_beside_exact, "{effects:?}");
        let off = DVector::from_vec(less.parameter_values()) - DVector::from_vec(whole.parameter_values());
        let sds = whole.covariance().diagonal().map(f64::sqrt);
        assert!(off.component_div(&sds).amax() < 1.0, "{effects:?}: {}", off.component_div(&sds));
    }
}
