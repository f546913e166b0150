//! `simulate`: what encoders and an eye would say of a snake whose model is known.

use crate::error::{raised, wrong};
use crate::model::{Effects, PyModel, with_effects};
use crate::tables::Table;
use numpy::IntoPyArray;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use snakeloop::geometry::Configuration;
use snakeloop::observation::{Measured, Waypoint};
use snakeloop::robot::Model;
use snakeloop::simulate::{BendingExperiment, Plant, Sample, SimulatedEye};

/// The largest standard deviation of an encoder reading, mm.
///
/// Convention: the estimator's own limit.
const MOST_SD_MM: f64 = 10.0;

/// Simulates an experiment: (measurements, encoders, truth), dicts of arrays with the columns of the files of these names.
///
/// model: what the snake obeys; the paper's without. effects: what it obeys besides, {name: {parameter: value}}. trajectory: a
/// table with index, time_s, theta_deg, delta_deg; the bending experiment of the paper without. seed: the same gives the same noise.
#[pyfunction]
#[pyo3(signature = (model=None, *, effects=None, trajectory=None, seed=1, sd_encoder_mm=0.0015))]
pub fn simulate<'py>(
    py: Python<'py>,
    model: Option<&PyModel>,
    effects: Option<Effects>,
    trajectory: Option<&Bound<'py, PyAny>>,
    seed: u64,
    sd_encoder_mm: f64,
) -> PyResult<(Bound<'py, PyDict>, Bound<'py, PyDict>, Bound<'py, PyDict>)> {
    if !(0.0..=MOST_SD_MM).contains(&sd_encoder_mm) {
        return Err(wrong(format!("sd_encoder_mm is {sd_encoder_mm}, expected 0 to {MOST_SD_MM} mm")));
    }
    let model = model.map_or_else(Model::default, |model| model.model.clone());
    let model = with_effects(model, effects.unwrap_or_default())?;
    let waypoints = match trajectory {
        Some(trajectory) => waypoints_of(trajectory)?,
        None => {
            BendingExperiment { seed, jitter_deg: 1.0, ..BendingExperiment::default() }.waypoints().map_err(raised)?
        }
    };
    let backbones = model.robot.backbone_count();
    let plant = Plant { model, sd_encoder_mm };
    let (samples, measured) = py.detach(|| {
        let samples = plant.run(&waypoints, seed.wrapping_add(1));
        let measurements = SimulatedEye::default().observe(&samples, seed.wrapping_add(2));
        let measured: Vec<Measured> = measurements.into_iter().filter_map(|measurement| measurement.measured).collect();
        (samples, measured)
    });
    let truth: Vec<Configuration> = samples.iter().map(|sample| sample.truth.configuration).collect();
    let seen: Vec<Configuration> = measured.iter().map(|measured| measured.configuration).collect();

    let measurements = table(py, &samples)?;
    set_angles(&measurements, &seen)?;
    column(&measurements, "sigma_theta_deg", measured.iter().map(|measured| measured.sigma_theta.to_degrees()))?;
    column(&measurements, "sigma_delta_deg", measured.iter().map(|measured| measured.sigma_delta.to_degrees()))?;
    measurements.set_item("status", vec!["ok"; samples.len()])?;
    let encoders = table(py, &samples)?;
    for i in 0..backbones {
        column(&encoders, &format!("q{}_mm", i + 1), samples.iter().map(|sample| sample.reading.q_mm[i]))?;
    }
    let angles = PyDict::new(py);
    angles.set_item("index", indices(py, &samples))?;
    set_angles(&angles, &truth)?;
    Ok((measurements, encoders, angles))
}

fn waypoints_of(trajectory: &Bound<'_, PyAny>) -> PyResult<Vec<Waypoint>> {
    let table = Table::new("trajectory", trajectory)?;
    let (times_s, theta) = (table.numbers("time_s")?, table.numbers("theta_deg")?);
    let poses = theta.into_iter().zip(table.numbers("delta_deg")?);
    let waypoint =
        |(time_s, (theta_deg, delta_deg))| Waypoint::new(time_s, Configuration::from_degrees(theta_deg, delta_deg));
    Ok(times_s.into_iter().zip(poses).map(waypoint).collect())
}

/// A table with the columns `index` and `time_s`.
fn table<'py>(py: Python<'py>, samples: &[Sample]) -> PyResult<Bound<'py, PyDict>> {
    let table = PyDict::new(py);
    table.set_item("index", indices(py, samples))?;
    column(&table, "time_s", samples.iter().map(|sample| sample.reading.time_s))?;
    Ok(table)
}

fn indices<'py>(py: Python<'py>, samples: &[Sample]) -> Bound<'py, numpy::PyArray1<u64>> {
    samples.iter().map(|sample| sample.reading.index).collect::<Vec<u64>>().into_pyarray(py)
}

fn set_angles(table: &Bound<'_, PyDict>, poses: &[Configuration]) -> PyResult<()> {
    column(table, "theta_deg", poses.iter().map(Configuration::theta_deg))?;
    column(table, "delta_deg", poses.iter().map(Configuration::delta_deg))
}

fn column(table: &Bound<'_, PyDict>, name: &str, numbers: impl Iterator<Item = f64>) -> PyResult<()> {
    table.set_item(name, numbers.collect::<Vec<f64>>().into_pyarray(table.py()))
}
