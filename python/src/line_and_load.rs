//! `estimate_stem` and `tip_force`: what a model with known η and λ tells of the line and of a load.

use crate::arrays::shaped;
use crate::error::{raised, wrong};
use crate::model::PyModel;
use crate::tables::{columns_of_csv, encoders_of, measurements_of, warn};
use crate::verdict::PyVerdict;
use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use snakeloop::estimate::{Options, StemOptions, StemRow, TipForce, with_sigmas};
use snakeloop::observation::{EncoderReading, Measurement};
use snakeloop::record::{forces_csv, stems_csv};
use snakeloop::robot::Model;
use snakeloop::verdict::{JudgedForce, JudgedStem, Subject};

/// The bending angle of a flexible stem, as it was followed.
#[pyclass(name = "StemEstimate", module = "snakeloop", frozen)]
pub struct PyStemEstimate {
    rows: Vec<StemRow>,
    model: PyModel,
    columns: Py<PyDict>,
}

/// Follows the total bending angle Φ of a flexible stem, as the command `estimate --stem`.
///
/// measurements and encoders: as in `estimate`. model: the Model with η, λ and friction known. forgetting: share of the information that is kept
/// from one measurement to the next, 0.95 without. sd_encoder_mm: standard deviation of an encoder reading, mm; 0.0015 without.
#[pyfunction]
#[pyo3(name = "estimate_stem", signature = (measurements, encoders, model, *, forgetting=None, sd_encoder_mm=None))]
pub fn estimate_stem_of(
    py: Python<'_>,
    measurements: &Bound<'_, PyAny>,
    encoders: &Bound<'_, PyAny>,
    model: &PyModel,
    forgetting: Option<f64>,
    sd_encoder_mm: Option<f64>,
) -> PyResult<PyStemEstimate> {
    let usual = StemOptions::default();
    let options = StemOptions {
        forgetting: forgetting.unwrap_or(usual.forgetting),
        sd_encoder_mm: sd_encoder_mm.unwrap_or(usual.sd_encoder_mm),
    };
    let (start, measurements, readings) = inputs(py, measurements, encoders, model)?;
    let data = (&measurements[..], &readings[..]);
    let judged =
        py.detach(|| JudgedStem::of(&start, options, data, |model| Ok(Subject::new(model, options.sd_encoder_mm))));
    let JudgedStem { rows, model: bent, verdict } = judged.map_err(raised)?;
    if rows.iter().all(|row| row.reason.is_some()) {
        return Err(wrong("no measurement could be used; angles with status ok and encoder readings are needed"));
    }
    let columns = columns_of_csv(py, &stems_csv(&rows))?.unbind();
    Ok(PyStemEstimate { rows, model: PyModel { model: bent, verdict: Some(verdict) }, columns })
}

#[pymethods]
impl PyStemEstimate {
    /// Whether the angle can be relied on, and why not.
    #[getter]
    fn verdict(&self) -> PyVerdict {
        PyVerdict(self.model.verdict.clone().unwrap_or_default())
    }

    /// Φ after the last measurement, degrees.
    #[getter]
    fn phi_deg(&self) -> f64 {
        self.rows.last().map_or(f64::NAN, |row| row.phi.to_degrees())
    }

    /// Its standard deviation, degrees.
    #[getter]
    fn sd_phi_deg(&self) -> f64 {
        self.rows.last().map_or(f64::NAN, |row| row.sd_phi.to_degrees())
    }

    /// The model with the stem bent by the last Φ.
    #[getter]
    fn model(&self) -> PyModel {
        self.model.clone()
    }

    /// Φ after each measurement: a dict of arrays with the columns of stem.csv.
    #[getter]
    fn rows(&self, py: Python<'_>) -> Py<PyDict> {
        self.columns.clone_ref(py)
    }

    fn __repr__(&self) -> String {
        format!("<StemEstimate Φ = {:.2} ± {:.2}°: {}>", self.phi_deg(), self.sd_phi_deg(), self.verdict().0.level)
    }
}

/// A force on the tip that explains measured deflections.
#[pyclass(name = "TipForce", module = "snakeloop", frozen)]
pub struct PyTipForce {
    force: TipForce,
    verdict: PyVerdict,
    columns: Py<PyDict>,
}

/// Finds the force on the tip that explains measured deflections, as the command `force`.
///
/// measurements and encoders: of the loaded snake, as in `estimate`. model: the Model with η and λ of the unloaded snake. sd_encoder_mm:
/// standard deviation of an encoder reading, mm; 0.0015 without.
#[pyfunction]
#[pyo3(name = "tip_force", signature = (measurements, encoders, model, *, sd_encoder_mm=None))]
pub fn tip_force_of(
    py: Python<'_>,
    measurements: &Bound<'_, PyAny>,
    encoders: &Bound<'_, PyAny>,
    model: &PyModel,
    sd_encoder_mm: Option<f64>,
) -> PyResult<PyTipForce> {
    let sd_encoder_mm = sd_encoder_mm.unwrap_or(Options::default().sd_encoder_mm);
    let (start, measurements, readings) = inputs(py, measurements, encoders, model)?;
    let data = (&measurements[..], &readings[..]);
    let judged =
        py.detach(|| JudgedForce::of(&start, sd_encoder_mm, data, |model| Ok(Subject::new(model, sd_encoder_mm))));
    let JudgedForce { rows, force, verdict } = judged.map_err(raised)?;
    let columns = columns_of_csv(py, &forces_csv(&rows))?.unbind();
    Ok(PyTipForce { force, verdict: PyVerdict(verdict), columns })
}

#[pymethods]
impl PyTipForce {
    /// Whether the model explains the measurements under this force, and why not.
    #[getter]
    fn verdict(&self) -> PyVerdict {
        self.verdict.clone()
    }

    /// The force that explains all measurements together, N, shape (3,), in the base frame; it has no part along the unseen directions.
    #[getter]
    fn force_n<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        shaped(py, &[3], self.force.force_n.iter().copied().collect())
    }

    /// Its covariance within the directions that are seen, N², 3 × 3.
    #[getter]
    fn covariance_n2<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        shaped(py, &[3, 3], self.force.covariance_n2.iter().copied().collect())
    }

    /// Unit vectors along which no measurement shows a force, shape (count, 3).
    #[getter]
    fn unseen<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let unseen = self.force.unseen.iter().flat_map(|direction| direction.iter().copied()).collect();
        shaped(py, &[self.force.unseen.len(), 3], unseen)
    }

    /// The force that explains each measurement: a dict of arrays with the columns of force.csv.
    #[getter]
    fn rows(&self, py: Python<'_>) -> Py<PyDict> {
        self.columns.clone_ref(py)
    }

    fn __repr__(&self) -> String {
        let force = self.force.force_n;
        format!("<TipForce ({:.3}, {:.3}, {:.3}) N: {}>", force.x, force.y, force.z, self.verdict.0.level)
    }
}

/// The library's values of what both functions take; a model that must not be used is refused.
fn inputs(
    py: Python<'_>,
    measurements: &Bound<'_, PyAny>,
    encoders: &Bound<'_, PyAny>,
    model: &PyModel,
) -> PyResult<(Model, Vec<Measurement>, Vec<EncoderReading>)> {
    model.require_usable()?;
    let readings = encoders_of(encoders, &model.model)?;
    let (measurements, remark) = with_sigmas(&measurements_of(measurements)?, &readings);
    remark.map_or(Ok(()), |remark| warn(py, &remark))?;
    Ok((model.model.clone(), measurements, readings))
}
