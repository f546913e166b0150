//! What a run of an experiment will know, predicted from a sample of its measurements.

use crate::Result;
use crate::estimate::{Options, estimate};
use crate::geometry::Configuration;
use crate::observation::{EncoderReading, Measured, Measurement, Status};
use crate::report::decimation::keeps;
use crate::robot::{Estimate, MAX_THETA, Model, PerBackbone};
use crate::statistics::moments::rms;
use rand::SeedableRng;
use rand::rngs::StdRng;
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;
use std::collections::BTreeSet;

/// Readings for which a measurement is expected. Convention: a resource limit; with more of them σ only gets smaller.
const EXPECTED: usize = 500;
/// Seed of the errors that are drawn. Convention: any; the same experiment gives the same answer.
const SEED: u64 = 1;

/// Draws of errors that σ is the root mean square of.
///
/// Derived: the scatter of a dozen poses, three residuals each, varies by 1/√72 = 12 %, and of so many draws by 3 %.
const DRAWS: usize = 16;

/// What a run would know.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Expected {
    pub sd_eta: f64,
    pub sd_lambda_mm: f64,
    /// Measurements with readings behind it.
    pub measurements: usize,
}

impl Expected {
    /// What an estimate from so many measurements says.
    pub fn of(estimate: &Estimate, measurements: usize) -> Self {
        Self { sd_eta: estimate.sd_eta(), sd_lambda_mm: estimate.sd_lambda_mm(), measurements }
    }
}

/// The poses to which the model says the readings lead, for readings that have a frame.
pub fn poses_of(
    model: &Model,
    log: &[EncoderReading],
    indices: &BTreeSet<u64>,
) -> Vec<(EncoderReading, Configuration)> {
    let with_frame: Vec<&EncoderReading> = log.iter().filter(|row| indices.contains(&row.index)).collect();
    let count = with_frame.len();
    let some = with_frame.into_iter().enumerate().filter(|(k, _)| keeps(*k, EXPECTED, count)).map(|(_, row)| row);
    let pose = |row: &EncoderReading| {
        let alone = row.beside_resting_neighbours(model);
        Some((*row, model.forward(&alone.q_mm).ok()?.configuration))
    };
    some.filter_map(pose).filter(|(_, psi)| psi.theta <= MAX_THETA).collect()
}

/// Bends and directions that the readings imply, in words.
pub fn coverage(poses: &[(EncoderReading, Configuration)]) -> String {
    let bends = || poses.iter().map(|(_, psi)| *psi);
    let (least, most) = bends()
        .fold((f64::INFINITY, 0.0f64), |(least, most), psi| (least.min(psi.theta_deg()), most.max(psi.theta_deg())));
    // Sectors of 30° that hold a pose at which δ means something.
    let sectors: BTreeSet<i64> = bends()
        .filter(|psi| psi.theta_deg() > 5.0)
        .map(|psi| (psi.delta_deg() / 30.0).round().rem_euclid(12.0) as i64)
        .collect();
    format!("{} poses, θ {least:.0}° to {most:.0}°, in {} of 12 directions of δ", poses.len(), sectors.len())
}

/// σ of η and λ after a run, as the estimator itself gives them: at every pose the nearest measurement of the sample, and the reading that the
/// model gives for a bend that differs from it by errors drawn from its covariance. (Without them no residual is left, whose scatter
/// the estimator's σ heed.) Their root mean square over several draws: few poses scatter by chance.
pub fn expected(
    model: &Model,
    options: Options,
    measurements: &[Measurement],
    poses: &[(EncoderReading, Configuration)],
) -> Result<Option<Expected>> {
    let nearest = |psi: &Configuration| {
        let distance = |measured: &Measured| (measured.configuration.bend_vector() - psi.bend_vector()).norm();
        let seen = measurements.iter().filter_map(|measurement| measurement.measured);
        seen.min_by(|a, b| distance(a).total_cmp(&distance(b)))
    };
    let seen: Option<Vec<_>> = poses.iter().map(|(row, psi)| Some((row, nearest(psi)?))).collect();
    let Some(seen) = seen else { return Ok(None) };
    let mut random = StdRng::seed_from_u64(SEED);
    let draws = (0..DRAWS).map(|_| drawn(model, options, &seen, &mut random));
    let estimates = draws.collect::<Result<Option<Vec<Estimate>>>>()?;
    Ok(estimates.map(|estimates| Expected {
        sd_eta: rms(estimates.iter().map(Estimate::sd_eta)),
        sd_lambda_mm: rms(estimates.iter().map(Estimate::sd_lambda_mm)),
        measurements: seen.len(),
    }))
}

/// The estimate from one draw of the errors of these measurements and readings.
fn drawn(
    model: &Model,
    options: Options,
    seen: &[(&EncoderReading, Measured)],
    random: &mut StdRng,
) -> Result<Option<Estimate>> {
    let mut draw = || -> f64 { StandardNormal.sample(random) };
    let (mut all, mut readings) = (Vec::new(), Vec::new());
    for (row, measured) in seen {
        let (theta, delta) = (draw(), draw());
        let Configuration { theta: bend, delta: azimuth } = measured.configuration;
        let along = measured.correlation * theta + (1.0 - measured.correlation.powi(2)).max(0.0).sqrt() * delta;
        let truth =
            Configuration::new((bend + measured.sigma_theta * theta).abs(), azimuth + measured.sigma_delta * along);
        let noise = PerBackbone::from_fn(row.q_mm.len(), |_| options.sd_encoder_mm * draw());
        let q_mm = model.command(truth) + model.by_neighbours_mm(&row.neighbours) + noise;
        readings.push(EncoderReading { q_mm, ..**row });
        let (index, time_s, measured) = (row.index, Some(row.time_s), Some(*measured));
        all.push(Measurement { index, time_s, status: Status::Ok, measured, quality: None, view: None });
    }
    let plain = model.without_estimate();
    let (_, learned) = estimate(&plain, options, &all, &readings)?;
    Ok(learned.estimate())
}
