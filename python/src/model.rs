//! `Model`: what to command, and where a command leads.

use crate::arrays::{matrix, radians_of, readings_of, shaped};
use crate::error::{raised, wrong};
use crate::tables::warn;
use crate::threads::by_rows;
use numpy::ndarray::ArrayD;
use numpy::{PyArray2, PyArrayDyn};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use rayon::prelude::*;
use snakeloop::geometry::Configuration;
use snakeloop::record::{model_toml, read_model, write_model};
use snakeloop::robot::{Mechanics, Model};
use std::path::PathBuf;

/// A robot, its friction, and what was learned of its actuation lines.
#[pyclass(name = "Model", module = "snakeloop", frozen, eq)]
#[derive(Clone, PartialEq)]
pub struct PyModel(pub Model);

#[pymethods]
impl PyModel {
    /// Reads a model.toml.
    #[staticmethod]
    fn read(path: PathBuf) -> PyResult<Self> {
        read_model(&path).map(Self).map_err(raised)
    }

    /// The paper's robot (Table I) with naive compensation: η = 1, λ = 0.
    #[staticmethod]
    #[pyo3(name = "default")]
    fn paper() -> Self {
        Self(Model::default())
    }

    /// Writes a model.toml, whole or not at all.
    fn write(&self, path: PathBuf) -> PyResult<()> {
        write_model(&path, &self.0).map_err(raised)
    }

    /// The q̃ to command so that the snake takes these poses, mm (Eq. 23).
    ///
    /// Angles in radians (theta, delta) or degrees (theta_deg, delta_deg), numbers or arrays, which are broadcast against each
    /// other to a shape S. Returns an array of shape S + (backbones,). NaN where an angle is NaN.
    #[pyo3(signature = (theta=None, delta=None, *, theta_deg=None, delta_deg=None))]
    fn command<'py>(
        &self,
        py: Python<'py>,
        theta: Option<Bound<'py, PyAny>>,
        delta: Option<Bound<'py, PyAny>>,
        theta_deg: Option<Bound<'py, PyAny>>,
        delta_deg: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        tell_of_neighbours(py, &self.0)?;
        let theta = radians_of("theta", theta, theta_deg)?;
        let delta = radians_of("delta", delta, delta_deg)?;
        let (shape, theta, delta) = broadcast(theta, delta)?;
        let width = self.0.robot.backbone_count();
        let mut commands = vec![0.0; theta.len() * width];
        let mechanics = Mechanics::new(&self.0);
        by_rows(py, theta.len(), |rows| {
            let out = commands[rows.start * width..rows.end * width].par_chunks_exact_mut(width);
            out.zip(&theta[rows.clone()]).zip(&delta[rows]).for_each(|((command, &theta), &delta)| {
                command.copy_from_slice(&mechanics.command(Configuration { theta, delta }.bend_vector(), None));
            });
        })?;
        shaped(py, &[&shape[..], &[width]].concat(), commands)
    }

    /// The poses that commands lead to: (theta_deg, delta_deg), arrays of the shape of q_mm less its last axis.
    ///
    /// q_mm has a column for each backbone, mm. NaN where the model has no answer: a q̃ that is not finite, or that bends the
    /// snake beyond 120°.
    fn forward<'py>(
        &self,
        py: Python<'py>,
        q_mm: &Bound<'py, PyAny>,
    ) -> PyResult<(Bound<'py, PyArrayDyn<f64>>, Bound<'py, PyArrayDyn<f64>>)> {
        tell_of_neighbours(py, &self.0)?;
        let (shape, readings) = readings_of(q_mm, self.0.robot.backbone_count())?;
        let (mut theta_deg, mut delta_deg) = (vec![f64::NAN; readings.len()], vec![f64::NAN; readings.len()]);
        by_rows(py, readings.len(), |rows| {
            let out = theta_deg[rows.clone()].par_iter_mut().zip(&mut delta_deg[rows.clone()]);
            out.zip(&readings[rows]).for_each(|((theta_deg, delta_deg), q_mm)| {
                if let Ok(response) = self.0.forward(q_mm) {
                    (*theta_deg, *delta_deg) = (response.configuration.theta_deg(), response.configuration.delta_deg());
                }
            });
        })?;
        Ok((shaped(py, &shape, theta_deg)?, shaped(py, &shape, delta_deg)?))
    }

    /// η; 1 where it was not estimated.
    #[getter]
    fn eta(&self) -> f64 {
        self.0.parameters().x
    }

    /// λ, mm; 0 where it was not estimated.
    #[getter]
    fn lambda_mm(&self) -> f64 {
        self.0.parameters().y
    }

    /// Covariance of (η, λ in mm), 2 × 2; zeros where they were not estimated.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        matrix(py, &self.0.parameter_covariance())
    }

    /// How many secondary backbones the robot has.
    #[getter]
    fn backbones(&self) -> usize {
        self.0.robot.backbone_count()
    }

    /// The model's effects: for each its name, form, and parameters with value, sd and unit.
    #[getter]
    fn effects<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let effects = PyList::empty(py);
        for (k, effect) in self.0.effects.iter().enumerate() {
            let parameters = PyDict::new(py);
            for ((spec, value), sd) in effect.parameters().iter().zip(&effect.values).zip(self.0.effect_sds(k)) {
                let parameter = PyDict::new(py);
                parameter.set_item("value", value)?;
                parameter.set_item("sd", sd)?;
                parameter.set_item("unit", spec.unit)?;
                parameters.set_item(spec.name, parameter)?;
            }
            let entry = PyDict::new(py);
            entry.set_item("name", effect.physics.name)?;
            entry.set_item("form", effect.physics.form)?;
            entry.set_item("parameters", parameters)?;
            effects.append(entry)?;
        }
        Ok(effects)
    }

    fn __repr__(&self) -> String {
        let x = self.0.parameters();
        let effects: Vec<_> = self.0.effects.iter().map(|effect| effect.physics.name).collect();
        let effects = if effects.is_empty() { String::new() } else { format!(", effects {}", effects.join(", ")) };
        match self.0.estimate {
            Some(e) => format!(
                "<Model η = {:.4} ± {:.4}, λ = {:.4} ± {:.4} mm{effects}>",
                x.x,
                e.sd_eta(),
                x.y,
                e.sd_lambda_mm()
            ),
            None => format!("<Model naive (η = 1, λ = 0){effects}>"),
        }
    }

    /// The text of its model.toml.
    fn __str__(&self) -> PyResult<String> {
        model_toml(&self.0).map_err(raised)
    }
}

/// Warns that what is answered holds while the neighbouring sections are at rest, where the model has a coupling with them.
pub fn tell_of_neighbours(py: Python<'_>, model: &Model) -> PyResult<()> {
    model.resting_neighbours().map_or(Ok(()), |words| warn(py, words))
}

/// The common shape of two arrays of angles, and the numbers of each by rows.
fn broadcast(theta: ArrayD<f64>, delta: ArrayD<f64>) -> PyResult<(Vec<usize>, Vec<f64>, Vec<f64>)> {
    let no_common =
        format!("theta of shape {:?} and delta of shape {:?} do not go together", theta.shape(), delta.shape());
    let axes = theta.ndim().max(delta.ndim());
    let length = |array: &ArrayD<f64>, axis: usize| {
        (axis + array.ndim()).checked_sub(axes).map_or(1, |axis| array.shape()[axis])
    };
    let shape: Vec<usize> = (0..axes)
        .map(|axis| match (length(&theta, axis), length(&delta, axis)) {
            (1, other) => other,
            (one, _) => one,
        })
        .collect();
    let numbers = |array: ArrayD<f64>| {
        if array.shape() == shape && array.is_standard_layout() {
            // Memory that is touched for the first time takes longer than a command.
            return Some(array.into_raw_vec_and_offset().0);
        }
        Some(array.broadcast(&shape[..])?.iter().copied().collect())
    };
    let (of_theta, of_delta) = numbers(theta).zip(numbers(delta)).ok_or_else(|| wrong(no_common))?;
    Ok((shape, of_theta, of_delta))
}
