//! `Robot`: the constants of one robot.

use crate::error::{raised, wrong};
use crate::json;
use crate::model::PyModel;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use snakeloop::record::robot_of;
use snakeloop::robot::Robot;

/// The constants of one robot.
#[pyclass(name = "Robot", module = "snakeloop", frozen, eq)]
#[derive(Clone, PartialEq)]
pub struct PyRobot(pub Robot);

#[pymethods]
impl PyRobot {
    /// A robot by its constants, under the keys of [robot] in a model.toml; its tables are dicts. What is left out is the paper's.
    #[new]
    #[pyo3(signature = (**constants))]
    fn new(py: Python<'_>, constants: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let constants = json::of_dict("robot", constants.unwrap_or(&PyDict::new(py)))?;
        robot_of(constants).map(Self).map_err(raised)
    }

    /// All constants, as a dict of the form in which Robot takes them.
    #[getter]
    fn constants<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::to_python(py, &serde_json::to_value(&self.0).map_err(|e| wrong(e.to_string()))?)
    }

    fn __repr__(&self) -> String {
        let Robot { length_mm, backbone_circle_radius_mm: radius_mm, body, .. } = &self.0;
        format!(
            "<Robot {} backbones on a circle of radius {radius_mm} mm, {length_mm} mm long, Ø {} mm>",
            self.0.backbone_count(),
            body.disk_diameter_mm
        )
    }
}

/// The robot that a Robot or a Model is or has; the paper's without.
///
/// # Errors
/// Anything else.
pub fn robot_in(given: Option<&Bound<'_, PyAny>>) -> PyResult<Robot> {
    let Some(given) = given else { return Ok(Robot::default()) };
    if let Ok(robot) = given.cast::<PyRobot>() {
        return Ok(robot.get().0.clone());
    }
    match given.cast::<PyModel>() {
        Ok(model) => Ok(model.get().model.robot.clone()),
        Err(_) => Err(wrong(format!("robot: {}, expected a Robot or a Model", given.get_type()))),
    }
}
