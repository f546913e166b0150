//! `Estimator`: measurements in, one at a time, η and λ out.

use crate::arrays::{matrix, readings_of};
use crate::error::{raised, wrong};
use crate::eye::PyMeasurement;
use crate::model::{PyModel, tell_of_neighbours};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use snakeloop::estimate::{Estimator, Options, Step};
use snakeloop::observation::EncoderReading;
use snakeloop::robot::Model;

/// The recursive estimator of η and λ (Eq. 19).
#[pyclass(name = "Estimator", module = "snakeloop")]
pub struct PyEstimator {
    estimator: Estimator,
    updates: u64,
}

#[pymethods]
impl PyEstimator {
    /// Starts with nothing known of η and λ. model: whose robot, friction and effects are used; the paper's without.
    /// sd_encoder_mm: standard deviation of an encoder reading, mm. Warns where effects follow neighbouring sections, which are at rest here.
    #[new]
    #[pyo3(signature = (model=None, *, sd_encoder_mm=None))]
    fn new(py: Python<'_>, model: Option<&PyModel>, sd_encoder_mm: Option<f64>) -> PyResult<Self> {
        let mut options = Options::default();
        options.sd_encoder_mm = sd_encoder_mm.unwrap_or(options.sd_encoder_mm);
        let model = model.map_or_else(Model::default, |model| model.model.clone());
        tell_of_neighbours(py, &model)?;
        Ok(Self { estimator: Estimator::new(&model, options).map_err(raised)?, updates: 0 })
    }

    /// Takes one measurement and the encoder readings of its frame, mm, shape (backbones,).
    fn update(&mut self, measurement: &PyMeasurement, q_mm: &Bound<'_, PyAny>) -> PyResult<PyStep> {
        let (shape, readings) = readings_of(q_mm, self.estimator.model().robot.backbone_count())?;
        let [q_mm] = readings[..] else {
            return Err(wrong(format!("q_mm: {shape:?} readings, expected those of one measurement")));
        };
        let index = self.updates;
        self.updates += 1;
        let measurement = measurement.0.clone().row(index, None, None);
        Ok(PyStep(self.estimator.update(&measurement, Some(&EncoderReading::new(index, index as f64, q_mm)))))
    }

    /// η; None while the measurements do not tell.
    #[getter]
    fn eta(&self) -> Option<f64> {
        self.estimator.model().estimate().map(|estimate| estimate.eta)
    }

    /// λ, mm; None while the measurements do not tell.
    #[getter]
    fn lambda_mm(&self) -> Option<f64> {
        self.estimator.model().estimate().map(|estimate| estimate.lambda_mm)
    }

    /// Covariance of (η, λ in mm), 2 × 2; None while the measurements do not tell.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray2<f64>>> {
        self.estimator.model().estimate().map(|estimate| matrix(py, &estimate.covariance))
    }

    /// The model with the estimate as it stands.
    #[getter]
    fn model(&self) -> PyModel {
        self.estimator.model().into()
    }
}

/// What one measurement did to the estimate.
#[pyclass(name = "Step", module = "snakeloop", frozen)]
pub struct PyStep(Step);

#[pymethods]
impl PyStep {
    /// "used", "rejected" (an outlier) or "skipped" (nothing to use).
    #[getter]
    fn verdict(&self) -> String {
        self.0.verdict.to_string()
    }

    /// Why it was not used, in snake_case; None where it was.
    #[getter]
    fn reason(&self) -> Option<String> {
        self.0.reason.as_ref().map(ToString::to_string)
    }

    /// Measured ε less what the estimate before predicted, for each backbone, mm; None before the first estimate.
    #[getter]
    fn residual_mm<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.0.residual_mm.map(|residual_mm| PyArray1::from_slice(py, &residual_mm))
    }

    fn __repr__(&self) -> String {
        let reason = self.0.reason.as_ref().map(|reason| format!(": {reason}")).unwrap_or_default();
        format!("<Step {}{reason}>", self.0.verdict)
    }
}
