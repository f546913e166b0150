//! Measurements and readings as they would have been without a model's effects.

use crate::geometry::Configuration;
use crate::observation::{EncoderReading, Measured, Measurement};
use crate::robot::{Model, Observation};
use std::collections::HashMap;

/// A measurement with the encoder reading of its index, where there is one.
pub type Pair = (Measurement, Option<EncoderReading>);

/// Measurements, each with its reading, as they would have been without a model's effects.
///
/// If the model has no effects, the measurements pass through one by one. Effects depend on the whole path, which is then held in memory.
///
/// # Errors
/// What `measurements` gives.
pub fn pairs_without_effects<'a, E: 'a>(
    model: &Model,
    measurements: impl Iterator<Item = Result<Measurement, E>> + 'a,
    readings: &'a [EncoderReading],
) -> Result<Box<dyn Iterator<Item = Result<Pair, E>> + 'a>, E> {
    if model.effects.is_empty() {
        let by_index: HashMap<u64, &EncoderReading> = readings.iter().map(|reading| (reading.index, reading)).collect();
        return Ok(Box::new(measurements.map(move |measurement| {
            let measurement = measurement?;
            let reading = by_index.get(&measurement.index).copied().copied();
            Ok((measurement, reading))
        })));
    }
    let measurements: Vec<Measurement> = measurements.collect::<Result<_, E>>()?;
    let (measurements, readings) = without_effects(model, &measurements, readings);
    let by_index: HashMap<u64, EncoderReading> = readings.into_iter().map(|reading| (reading.index, reading)).collect();
    Ok(Box::new(measurements.into_iter().map(move |measurement| {
        let reading = by_index.get(&measurement.index).copied();
        Ok((measurement, reading))
    })))
}

/// Takes off what the model's effects did to the encoders and to the eye
/// ([`Model::without_effects`]), and to the readings by what neighbouring sections did. Every reading drives what has a memory; what has no angles or no reading stays as it is.
pub fn without_effects(
    model: &Model,
    measurements: &[Measurement],
    readings: &[EncoderReading],
) -> (Vec<Measurement>, Vec<EncoderReading>) {
    let readings = readings.iter().map(|reading| reading.beside_resting_neighbours(model));
    let (mut measurements, mut readings) = (measurements.to_vec(), readings.collect::<Vec<_>>());
    if model.effects.is_empty() {
        return (measurements, readings);
    }
    let place: HashMap<u64, usize> = measurements.iter().enumerate().map(|(k, m)| (m.index, k)).collect();
    let is_finite = |psi: Configuration| psi.theta.is_finite() && psi.delta.is_finite();
    let measured_at = |index: u64| -> Option<(usize, Measured)> {
        let m = *place.get(&index)?;
        Some((m, measurements[m].measured.filter(|measured| is_finite(measured.configuration))?))
    };
    let mut path: Vec<(usize, Option<(usize, Measured)>)> = readings
        .iter()
        .enumerate()
        .filter(|(_, reading)| reading.time_s.is_finite() && reading.q_mm.iter().all(|q| q.is_finite()))
        .map(|(r, reading)| (r, measured_at(reading.index)))
        .collect();
    path.sort_by(|a, b| readings[a.0].time_s.total_cmp(&readings[b.0].time_s));
    let observations = observations(&path, &readings);
    for (&(r, seen), without) in path.iter().zip(model.without_effects(&observations)) {
        if let Some((m, measured)) = seen {
            measurements[m].measured = Some(Measured { configuration: without.configuration, ..measured });
            readings[r].q_mm = without.q_mm;
        }
    }
    (measurements, readings)
}

/// The observations along a path of readings. One without a measurement gets the configuration of the one before it (at the start,
/// the first one measured), near which its bend is looked for. None where nothing was measured at all.
fn observations(path: &[(usize, Option<(usize, Measured)>)], readings: &[EncoderReading]) -> Vec<Observation> {
    let Some(mut near) = path.iter().find_map(|(_, seen)| Some(seen.as_ref()?.1.configuration)) else {
        return Vec::new();
    };
    let at = |&(r, seen): &(usize, Option<(usize, Measured)>)| {
        near = seen.map_or(near, |(_, measured)| measured.configuration);
        Observation { time_s: readings[r].time_s, q_mm: readings[r].q_mm, configuration: near }
    };
    path.iter().map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Effect;
    use crate::simulate::{BendingExperiment, Plant, SimulatedEye};

    #[test]
    fn readings_without_a_measurement_drive_a_play_as_well() {
        let play =
            Effect::new("motion_directed_backlash", Some("crossed by travel"), &[("half_gap_mm".to_owned(), 0.2)], 3);
        let model = Model { effects: vec![play.unwrap()], ..Model::default() };
        let trajectory = BendingExperiment { sweep_poses: 20, ..Default::default() }.waypoints().unwrap();
        let samples = Plant { model: model.clone(), sd_encoder_mm: 0.0 }.run(&trajectory, 1);
        let readings: Vec<_> = samples.iter().map(|s| s.reading).collect();
        let all = SimulatedEye::default().observe(&samples, 2);
        // The turns at the tops of the sweeps are not seen.
        let seen = |m: &Measurement| m.index == 0 || m.measured.unwrap().configuration.theta_deg() < 45.0;
        let mut some = all.clone();
        some.iter_mut().filter(|m| !seen(m)).for_each(|m| m.measured = None);
        let (_, of_all) = without_effects(&model, &all, &readings);
        let (_, of_some) = without_effects(&model, &some, &readings);
        let mut compared = 0;
        for k in (0..all.len()).filter(|&k| seen(&all[k])) {
            assert!((of_all[k].q_mm - of_some[k].q_mm).amax() < 1e-4, "{k}");
            compared += 1;
        }
        assert!(compared < all.len() - 30, "{compared} of {}", all.len());
    }
}
