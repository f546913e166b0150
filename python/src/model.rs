//! `Model`: what to command, and where a command leads.

use crate::arrays::{matrix, numbers_of, radians_of, readings_of, shaped};
use crate::error::{raised, wrong};
use crate::robot::{PyRobot, robot_in};
use crate::tables::warn;
use crate::threads::by_rows;
use numpy::ndarray::ArrayD;
use numpy::{IntoPyArray, PyArray2, PyArrayDyn};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use rayon::prelude::*;
use snakeloop::geometry::Configuration;
use snakeloop::record::{
    Provenance, do_not_use_mark, learned_model_toml, model_toml, read_model, stale_mark, write_atomically,
};
use snakeloop::robot::{Effect, Grid, Mechanics, Model, PerBackbone, TableRow};
use snakeloop::verdict::{Code, Level, Reason, Verdict};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Effects by name, the parameters of each by name.
pub type Effects = BTreeMap<String, BTreeMap<String, f64>>;

/// θ and δ of each pose.
type Angles<'py> = (Bound<'py, PyArrayDyn<f64>>, Bound<'py, PyArrayDyn<f64>>);

/// A robot, its friction, and what was learned of its actuation lines.
#[pyclass(name = "Model", module = "snakeloop", frozen, eq)]
#[derive(Clone)]
pub struct PyModel {
    pub model: Model,
    /// Whether it can be relied on, where it was learned and judged; it is written with the model.
    pub verdict: Option<Verdict>,
}

impl From<Model> for PyModel {
    fn from(model: Model) -> Self {
        Self { model, verdict: None }
    }
}

impl PartialEq for PyModel {
    /// Whatever was said of them.
    fn eq(&self, other: &Self) -> bool {
        self.model == other.model
    }
}

impl PyModel {
    /// Why it must not be used, if that is so.
    pub fn must_not_be_used(&self) -> Option<String> {
        let judged = self.verdict.as_ref().and_then(Verdict::why_not).map(str::to_owned);
        judged.or_else(|| self.model.estimate().and_then(|estimate| estimate.implausible()))
    }

    /// An error where it must not be used.
    pub fn require_usable(&self) -> PyResult<()> {
        let refused =
            |why| wrong(format!("model: this model must not be used: {why}; start with one that can be used"));
        self.must_not_be_used().map_or(Ok(()), |why| Err(refused(why)))
    }

    /// In a line.
    pub fn words(&self) -> String {
        let x = self.model.parameters();
        let effects: Vec<_> = self.model.effects.iter().map(|effect| effect.physics.name).collect();
        let effects = if effects.is_empty() { String::new() } else { format!(", effects {}", effects.join(", ")) };
        match self.model.estimate() {
            Some(e) => {
                let (sd_eta, sd_lambda_mm) = (e.sd_eta(), e.sd_lambda_mm());
                format!("η = {:.4} ± {sd_eta:.4}, λ = {:.4} ± {sd_lambda_mm:.4} mm{effects}", x.x, x.y)
            }
            None => format!("naive (η = 1, λ = 0){effects}"),
        }
    }
}

#[pymethods]
impl PyModel {
    /// A robot with naive compensation: η = 1, λ = 0. robot: a Robot, or a Model whose robot it has; the paper's without.
    #[new]
    #[pyo3(signature = (robot=None))]
    fn new(robot: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        Ok(Model { robot: robot_in(robot)?, ..Model::default() }.into())
    }

    /// Reads a model.toml. Warns of one that must not be used, or is marked as stale.
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let model = read_model(&path).map_err(raised)?;
        if let Some(why) = stale_mark(&path) {
            warn(py, &format!("{}: this model is marked as stale: {why}", path.display()))?;
        }
        let reason = |why: String| {
            Reason::new(
                Code::Files,
                Level::DoNotUse,
                why,
                "see where the model was learned, correct that and learn again",
            )
        };
        let read = Self { model, verdict: do_not_use_mark(&path).map(|why| Verdict::of(vec![reason(why)])) };
        if let Some(why) = read.must_not_be_used() {
            warn(py, &format!("{}: this model must not be used: {why}", path.display()))?;
        }
        Ok(read)
    }

    /// The paper's robot (Table I) with naive compensation: η = 1, λ = 0.
    #[staticmethod]
    #[pyo3(name = "default")]
    fn paper() -> Self {
        Model::default().into()
    }

    /// Writes a model.toml, whole or not at all; with the verdict on it, where there is one.
    fn write(&self, path: PathBuf) -> PyResult<()> {
        let text = match &self.verdict {
            Some(verdict) => learned_model_toml(&self.model, Some(verdict), &Provenance::new("Model.write")),
            None => model_toml(&self.model),
        };
        text.and_then(|text| write_atomically(&path, text.as_bytes())).map_err(raised)
    }

    /// This model with further effects, as `--effect` adds them: {name: {parameter: value}}.
    fn with_effects(&self, effects: Effects) -> PyResult<Self> {
        Ok(Self { model: with_effects(self.model.clone(), effects)?, verdict: self.verdict.clone() })
    }

    /// What to command for every pose of a grid: a dict of arrays with the columns of compensation.csv, one row a pose, δ running fastest.
    ///
    /// theta_deg and delta_deg: the grid's axes, numbers or arrays of one dimension; without, those of the command `table`.
    #[pyo3(signature = (theta_deg=None, delta_deg=None))]
    fn table<'py>(
        &self,
        py: Python<'py>,
        theta_deg: Option<&Bound<'py, PyAny>>,
        delta_deg: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        tell_of_single_poses(py, &self.model)?;
        let grid = Grid::within_data(&self.model);
        let axis = |given: Option<&Bound<'py, PyAny>>, usual: Vec<f64>| match given {
            Some(given) => Ok(numbers_of(given)?.into_iter().collect()),
            None => PyResult::Ok(usual),
        };
        let thetas_deg: Vec<f64> = axis(theta_deg, grid.theta.values_deg().collect())?;
        let deltas_deg: Vec<f64> = axis(delta_deg, grid.azimuths_deg().collect())?;
        let poses: Vec<(f64, f64)> =
            thetas_deg.iter().flat_map(|theta| deltas_deg.iter().map(move |delta| (*theta, *delta))).collect();
        let mut rows = Vec::with_capacity(poses.len());
        by_rows(py, poses.len(), |range| {
            rows.par_extend(poses[range].par_iter().map(|&(theta, delta)| TableRow::asked(&self.model, theta, delta)));
        })?;
        let rows: Vec<TableRow> = rows.into_iter().collect::<snakeloop::Result<_>>().map_err(raised)?;
        self.columns(py, &rows)
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
        tell_of_single_poses(py, &self.model)?;
        let theta = radians_of("theta", theta, theta_deg)?;
        let delta = radians_of("delta", delta, delta_deg)?;
        let (shape, theta, delta) = broadcast(theta, delta)?;
        let width = self.model.robot.backbone_count();
        let mut commands = vec![0.0; theta.len() * width];
        let mechanics = Mechanics::new(&self.model);
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
    fn forward<'py>(&self, py: Python<'py>, q_mm: &Bound<'py, PyAny>) -> PyResult<Angles<'py>> {
        tell_of_single_poses(py, &self.model)?;
        let (shape, readings) = readings_of(q_mm, self.model.robot.backbone_count())?;
        let (mut theta_deg, mut delta_deg) = (vec![f64::NAN; readings.len()], vec![f64::NAN; readings.len()]);
        by_rows(py, readings.len(), |rows| {
            let out = theta_deg[rows.clone()].par_iter_mut().zip(&mut delta_deg[rows.clone()]);
            out.zip(&readings[rows]).for_each(|((theta_deg, delta_deg), q_mm)| {
                if let Ok(response) = self.model.forward(q_mm) {
                    (*theta_deg, *delta_deg) = (response.configuration.theta_deg(), response.configuration.delta_deg());
                }
            });
        })?;
        Ok((shaped(py, &shape, theta_deg)?, shaped(py, &shape, delta_deg)?))
    }

    /// η; 1 where it was not estimated.
    #[getter]
    fn eta(&self) -> f64 {
        self.model.parameters().x
    }

    /// λ, mm; 0 where it was not estimated.
    #[getter]
    fn lambda_mm(&self) -> f64 {
        self.model.parameters().y
    }

    /// Covariance of (η, λ in mm), 2 × 2; zeros where they were not estimated.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        matrix(py, &self.model.parameter_covariance())
    }

    /// The constants of its robot.
    #[getter]
    fn robot(&self) -> PyRobot {
        PyRobot(self.model.robot.clone())
    }

    /// How many secondary backbones the robot has.
    #[getter]
    fn backbones(&self) -> usize {
        self.model.robot.backbone_count()
    }

    /// The model's effects: for each its name, form, and parameters with value, sd and unit.
    #[getter]
    fn effects<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let effects = PyList::empty(py);
        for (k, effect) in self.model.effects.iter().enumerate() {
            let parameters = PyDict::new(py);
            for ((spec, value), sd) in effect.parameters().iter().zip(&effect.values).zip(self.model.effect_sds(k)) {
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
        format!("<Model {}>", self.words())
    }

    /// The text of its model.toml.
    fn __str__(&self) -> PyResult<String> {
        model_toml(&self.model).map_err(raised)
    }
}

impl PyModel {
    /// Rows of a table under the names of compensation.csv.
    fn columns<'py>(&self, py: Python<'py>, rows: &[TableRow]) -> PyResult<Bound<'py, PyDict>> {
        let columns = PyDict::new(py);
        let numbers = |name: &str, of: &dyn Fn(&TableRow) -> f64| {
            columns.set_item(name, rows.iter().map(of).collect::<Vec<f64>>().into_pyarray(py))
        };
        numbers("theta_deg", &|row| row.configuration.theta_deg())?;
        numbers("delta_deg", &|row| row.configuration.delta_deg())?;
        type Lengths = fn(&TableRow) -> &PerBackbone;
        let (q, command, sd): (Lengths, Lengths, Lengths) =
            (|row| &row.q_mm, |row| &row.command_mm, |row| &row.sd_command_mm);
        for (name, of) in [("q", q), ("qc", command), ("sd_qc", sd)] {
            for i in 0..self.model.robot.backbone_count() {
                numbers(&format!("{name}{}_mm", i + 1), &|row| of(row)[i])?;
            }
        }
        let flags = |name: &str, of: &dyn Fn(&TableRow) -> bool| {
            columns.set_item(name, rows.iter().map(|row| u8::from(of(row))).collect::<Vec<u8>>().into_pyarray(py))
        };
        if rows.iter().any(|row| row.beyond_data.is_some()) {
            flags("beyond_data", &|row| row.beyond_data == Some(true))?;
        }
        flags("extrapolated", &|row| row.extrapolated)?;
        if self.must_not_be_used().is_some() {
            flags("do_not_use", &|_| true)?;
        }
        Ok(columns)
    }
}

/// A model with further effects.
///
/// # Errors
/// An unknown effect or parameter, one that is missing, a value out of its range.
pub fn with_effects(mut model: Model, effects: Effects) -> PyResult<Model> {
    for (name, parameters) in effects {
        let parameters: Vec<(String, f64)> = parameters.into_iter().collect();
        let effect = Effect::new(&name, None, &parameters, model.robot.backbone_count()).map_err(raised)?;
        model.effects.push(effect);
    }
    Ok(model)
}

/// Warns of what an answer for a single pose takes for granted, as the command `table`.
fn tell_of_single_poses(py: Python<'_>, model: &Model) -> PyResult<()> {
    model.conditions_of_single_poses().iter().try_for_each(|condition| warn(py, condition))
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
