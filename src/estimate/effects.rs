//! Measurements and readings as they would have been without a model's effects.

use crate::observation::{EncoderReading, Measured, Measurement};
use crate::robot::{Model, Observation};
use std::collections::HashMap;

/// A measurement with the encoder reading of its index, where there is one.
pub type Pair = (Measurement, Option<EncoderReading>);

/// Measurements, each with its reading, as they would have been without a model's effects.
///
/// A model without effects lets them through one by one. What effects do hangs on the whole path, which is then held in memory.
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
/// ([`Model::without_effects`]). What has no angles or no reading stays as it is.
pub fn without_effects(
    model: &Model,
    measurements: &[Measurement],
    readings: &[EncoderReading],
) -> (Vec<Measurement>, Vec<EncoderReading>) {
    let (mut measurements, mut readings) = (measurements.to_vec(), readings.to_vec());
    if model.effects.is_empty() {
        return (measurements, readings);
    }
    let place: HashMap<u64, usize> = readings.iter().enumerate().map(|(k, reading)| (reading.index, k)).collect();
    let mut pairs: Vec<(usize, usize, Measured)> = measurements
        .iter()
        .enumerate()
        .filter_map(|(k, m)| Some((k, *place.get(&m.index)?, m.measured?)))
        .filter(|&(_, r, m)| {
            let numbers = [m.configuration.theta, m.configuration.delta, readings[r].time_s];
            numbers.iter().chain(&readings[r].q_mm).all(|value| value.is_finite())
        })
        .collect();
    pairs.sort_by(|a, b| readings[a.1].time_s.total_cmp(&readings[b.1].time_s));
    let observations: Vec<Observation> = pairs
        .iter()
        .map(|&(_, r, measured)| Observation {
            time_s: readings[r].time_s,
            q_mm: readings[r].q_mm,
            configuration: measured.configuration,
        })
        .collect();
    for (&(m, r, measured), without) in pairs.iter().zip(model.without_effects(&observations)) {
        measurements[m].measured = Some(Measured { configuration: without.configuration, ..measured });
        readings[r].q_mm = without.q_mm;
    }
    (measurements, readings)
}
