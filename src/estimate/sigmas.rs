//! Noise of measurements that do not say how sure they are.

use crate::geometry::{Configuration, sinc};
use crate::observation::{EncoderReading, Measurement};
use crate::robot::Robot;
use crate::statistics::order::mad_scale;
use nalgebra::{Matrix2x3, Matrix3, Rotation2, Vector2, Vector3};
use std::collections::HashMap;
use std::f64::consts::PI;

/// Fewer steps than this say nothing about noise.
///
/// Convention: the standard error of a scale by the MAD is 1.17/√n of it (Rousseeuw and Croux 1993), 40 % here; such a sigma is still
/// better than one from nowhere.
const LEAST_STEPS: usize = 8;
/// What is assumed where nothing can be said, rad (0.5°).
///
/// Source: the repeatability that the paper states above Eq. 22.
const REPEATABILITY: f64 = 0.5 * PI / 180.0;

/// Gives measurements without sigmas (NaN) those that their own scatter shows, and says so in words.
///
/// The bend vector is nearly a linear function of the readings. What a straight-line fit leaves of it from one measurement to
/// the next is mostly noise: the model's faults change slowly, and the few jumps at reversals do not move a median.
pub fn with_sigmas(measurements: &[Measurement], readings: &[EncoderReading]) -> (Vec<Measurement>, Option<String>) {
    let mut measurements = measurements.to_vec();
    let lacks = |m: &Measurement| m.measured.is_some_and(|m| m.sigma_theta.is_nan() || m.sigma_delta.is_nan());
    let without = measurements.iter().filter(|m| lacks(m)).count();
    if without == 0 {
        return (measurements, None);
    }
    let (along, across, source) = match scatter(&measurements, readings) {
        Some((along, across)) => (along, across, "as they scatter from one measurement to the next"),
        None => (REPEATABILITY, REPEATABILITY, "the paper's repeatability, since too few have encoder readings"),
    };
    for measured in measurements.iter_mut().filter_map(|m| m.measured.as_mut()) {
        if measured.sigma_theta.is_nan() {
            measured.sigma_theta = along;
        }
        if measured.sigma_delta.is_nan() {
            measured.sigma_delta = (across / measured.configuration.theta.sin().abs().max(1e-3)).min(PI);
        }
    }
    let (along, across) = (along.to_degrees(), across.to_degrees());
    let remark = format!(
        "{without} measurements have no sigmas: σ_θ = {along:.3}° and σ_δ = {across:.3}°/sin θ are taken, {source}"
    );
    (measurements, Some(remark))
}

/// Standard deviations along the bend and across it, rad.
fn scatter(measurements: &[Measurement], readings: &[EncoderReading]) -> Option<(f64, f64)> {
    let by_index: HashMap<u64, &EncoderReading> = readings.iter().map(|reading| (reading.index, reading)).collect();
    let robot = Robot { backbones: readings.first().map_or(0, |reading| reading.q_mm.len() as u8), ..Robot::default() };
    let mut pairs: Vec<(f64, Vector3<f64>, Vector2<f64>, Configuration)> = measurements
        .iter()
        .filter_map(|m| {
            let (reading, psi) = (by_index.get(&m.index)?, m.measured?.configuration);
            let implied = robot.bend_by_displacement().tr_mul(&reading.q_mm);
            let finite = implied.iter().chain([&psi.theta, &psi.delta, &reading.time_s]).all(|x| x.is_finite());
            finite.then(|| (reading.time_s, implied.push(1.0), psi.bend_vector(), psi))
        })
        .collect();
    if pairs.len() <= LEAST_STEPS {
        return None;
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let squared: Matrix3<f64> = pairs.iter().map(|(_, implied, _, _)| implied * implied.transpose()).sum();
    let mixed: Matrix2x3<f64> = pairs.iter().map(|(_, implied, bend, _)| bend * implied.transpose()).sum();
    let line = mixed * squared.pseudo_inverse(1e-9).ok()?;
    let left: Vec<Vector2<f64>> = pairs.iter().map(|(_, implied, bend, _)| bend - line * implied).collect();
    // Across the bend, θ σ_δ is θ/sin θ times what does not depend on θ.
    let turned = |k: usize, psi: Configuration| {
        let step = Rotation2::new(-psi.delta) * (left[k] - left[k - 1]);
        Vector2::new(step.x, step.y * sinc(psi.theta))
    };
    let steps: Vec<Vector2<f64>> = (1..left.len()).map(|k| turned(k, pairs[k].3)).collect();
    // Two measurements' noise is in a step.
    let sd = |part: fn(&Vector2<f64>) -> f64| mad_scale(steps.iter().map(part)) / 2f64.sqrt();
    let (along, across) = (sd(|step| step.x), sd(|step| step.y));
    (along > 0.0 && across > 0.0).then_some((along, across))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Model;
    use crate::simulate::{BendingExperiment, Plant, SimulatedEye};

    #[test]
    fn the_scatter_is_the_noise_that_the_eye_had() {
        let ride = BendingExperiment { sweep_poses: 30, round_poses: 40, jitter_deg: 1.0, ..Default::default() };
        let samples = Plant { model: Model::default(), sd_encoder_mm: 0.0015 }.run(&ride.waypoints().unwrap(), 1);
        let readings: Vec<_> = samples.iter().map(|sample| sample.reading).collect();
        let mut measurements = SimulatedEye::default().observe(&samples, 2);
        let told = measurements.clone();
        assert_eq!(with_sigmas(&told, &readings), (told, None));
        for measured in measurements.iter_mut().filter_map(|m| m.measured.as_mut()) {
            (measured.sigma_theta, measured.sigma_delta) = (f64::NAN, f64::NAN);
        }
        let (filled, remark) = with_sigmas(&measurements, &readings);
        let measured = filled[20].measured.unwrap();
        let across = (measured.sigma_delta * measured.configuration.theta.sin()).to_degrees();
        assert!((measured.sigma_theta.to_degrees() - 0.12).abs() < 0.04, "{remark:?}");
        assert!((across - 0.25).abs() < 0.1, "{remark:?}");
        assert!(remark.unwrap().starts_with("160 measurements have no sigmas"));
        let (filled, remark) = with_sigmas(&measurements, &[]);
        assert!(filled[0].measured.unwrap().sigma_theta > 0.0 && remark.unwrap().contains("repeatability"));
    }
}
