//! `run` and `estimate`: the commands of these names.

use crate::arrays::matrix;
use crate::error::raised;
use crate::model::PyModel;
use crate::tables::{columns_of_csv, encoders_of, measurements_of, warn};
use crate::threads::interruptible;
use crate::verdict::{PyVerdict, framed};
use numpy::PyArray2;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use snakeloop::Error;
use snakeloop::cli::{Caller, RunSummary, run_experiment};
use snakeloop::estimate::{Options, with_sigmas};
use snakeloop::record::estimates_csv;
use snakeloop::robot::Model;
use snakeloop::verdict::{JudgedEstimate, Subject};
use std::fs::read_to_string;
use std::path::PathBuf;
use std::sync::Arc;
use tempfile::TempDir;

/// How high report.html is shown in a notebook, lines. Convention: a display choice.
const REPORT_LINES: usize = 40;

/// What `run` gave.
#[pyclass(name = "Run", module = "snakeloop", frozen)]
pub struct PyRun {
    verdict: PyVerdict,
    model: PyModel,
    measurements: Py<PyDict>,
    text: String,
    page: String,
    out: PathBuf,
    /// Where `out` is, if no folder was named; it goes when this does.
    _folder: Option<TempDir>,
}

/// Does the main job on an experiment, as the command `run`: measures every frame, learns η and λ, writes the table and a report.
///
/// experiment: a folder with an experiment.toml, or that file. out: the folder to write to; without, a temporary one that lives as
/// long as the Run. Warnings of the command are warnings of Python.
///
/// Takes seconds to hours, during which other threads of Python run. A Ctrl-C raises KeyboardInterrupt at once; the work then ends at the
/// next frame.
#[pyfunction]
#[pyo3(signature = (experiment, out=None))]
pub fn run(py: Python<'_>, experiment: PathBuf, out: Option<PathBuf>) -> PyResult<PyRun> {
    let caller = Arc::new(Caller::default());
    let called = caller.clone();
    let work = move || {
        let (out, folder) = match out {
            Some(out) => (out, None),
            None => {
                let folder = tempfile::tempdir().map_err(Error::io(&std::env::temp_dir(), "create a folder in"))?;
                (folder.path().to_owned(), Some(folder))
            }
        };
        run_experiment(&experiment, &out, called).map(|summary| (summary, out, folder))
    };
    let ended = interruptible(py, work).inspect_err(|_| caller.end())?;
    for warning in caller.warnings() {
        warn(py, &warning)?;
    }
    let (summary, out, folder) = ended.map_err(raised)?;
    let read = |name: &str| {
        let path = out.join(name);
        read_to_string(&path).map_err(|e| raised(Error::io(&path, "read")(e)))
    };
    let measurements = columns_of_csv(py, &read("measurements.csv")?)?.unbind();
    let (text, page) = (summary.text(), read("report.html")?);
    let RunSummary { verdict, model, .. } = summary;
    let model = PyModel { model, verdict: Some(verdict.clone()) };
    Ok(PyRun { verdict: PyVerdict(verdict), model, measurements, text, page, out, _folder: folder })
}

#[pymethods]
impl PyRun {
    /// Whether the result can be relied on, and why not.
    #[getter]
    fn verdict(&self) -> PyVerdict {
        self.verdict.clone()
    }

    /// η; None where the measurements do not tell.
    #[getter]
    fn eta(&self) -> Option<f64> {
        self.model.model.estimate().map(|estimate| estimate.eta)
    }

    /// λ, mm; None where the measurements do not tell.
    #[getter]
    fn lambda_mm(&self) -> Option<f64> {
        self.model.model.estimate().map(|estimate| estimate.lambda_mm)
    }

    /// The measurements of all frames: a dict of arrays with the columns of measurements.csv.
    #[getter]
    fn measurements(&self, py: Python<'_>) -> Py<PyDict> {
        self.measurements.clone_ref(py)
    }

    /// The model that was learned; the experiment's own where the measurements do not tell.
    #[getter]
    fn model(&self) -> PyModel {
        self.model.clone()
    }

    /// The folder with the files that the command writes.
    #[getter]
    fn out(&self) -> PathBuf {
        self.out.clone()
    }

    fn __repr__(&self) -> String {
        format!("<Run {:?}: {}>", self.out, self.verdict.0.level)
    }

    /// As the command prints it.
    fn __str__(&self) -> &str {
        &self.text
    }

    /// The command's report.html.
    fn _repr_html_(&self) -> String {
        framed(&self.page, REPORT_LINES)
    }
}

/// What `estimate` learned.
#[pyclass(name = "Estimate", module = "snakeloop", frozen)]
pub struct PyEstimate {
    verdict: PyVerdict,
    model: PyModel,
    rows: Py<PyDict>,
}

/// Learns η and λ from measurements and encoder readings, and judges them, as the command `estimate`.
///
/// measurements and encoders: paths of measurements.csv and encoders.csv, data frames, or dicts of arrays with these files' columns.
/// model: the Model that gives robot, friction and effects; the paper's without. sd_encoder_mm: standard deviation of an encoder reading, mm.
#[pyfunction]
#[pyo3(signature = (measurements, encoders, model=None, *, sd_encoder_mm=None))]
pub fn estimate(
    py: Python<'_>,
    measurements: &Bound<'_, PyAny>,
    encoders: &Bound<'_, PyAny>,
    model: Option<&PyModel>,
    sd_encoder_mm: Option<f64>,
) -> PyResult<PyEstimate> {
    let mut options = Options::default();
    options.sd_encoder_mm = sd_encoder_mm.unwrap_or(options.sd_encoder_mm);
    model.map_or(Ok(()), PyModel::require_usable)?;
    let start = model.map_or_else(Model::default, |model| model.model.clone());
    let readings = encoders_of(encoders, &start)?;
    let (measurements, remark) = with_sigmas(&measurements_of(measurements)?, &readings);
    remark.map_or(Ok(()), |remark| warn(py, &remark))?;
    let learned = interruptible(py, move || {
        JudgedEstimate::of(&start, options, None, (&measurements, &readings), false, |model| {
            Ok(Subject::new(model, options.sd_encoder_mm))
        })
    })?;
    let JudgedEstimate { rows, model, verdict, .. } = learned.map_err(raised)?;
    let rows = columns_of_csv(py, &estimates_csv(&rows, model.robot.backbone_count()))?.unbind();
    let model = PyModel { model, verdict: Some(verdict.clone()) };
    Ok(PyEstimate { verdict: PyVerdict(verdict), model, rows })
}

#[pymethods]
impl PyEstimate {
    /// Whether the estimate can be relied on, and why not.
    #[getter]
    fn verdict(&self) -> PyVerdict {
        self.verdict.clone()
    }

    /// η; None where the measurements do not tell.
    #[getter]
    fn eta(&self) -> Option<f64> {
        self.model.model.estimate().map(|estimate| estimate.eta)
    }

    /// λ, mm; None where the measurements do not tell.
    #[getter]
    fn lambda_mm(&self) -> Option<f64> {
        self.model.model.estimate().map(|estimate| estimate.lambda_mm)
    }

    /// Covariance of (η, λ in mm), 2 × 2; None where the measurements do not tell.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray2<f64>>> {
        self.model.model.estimate().map(|estimate| matrix(py, &estimate.covariance))
    }

    /// The model with the estimate.
    #[getter]
    fn model(&self) -> PyModel {
        self.model.clone()
    }

    /// What became of each measurement: a dict of arrays with the columns of estimate.csv.
    #[getter]
    fn rows(&self, py: Python<'_>) -> Py<PyDict> {
        self.rows.clone_ref(py)
    }

    fn __repr__(&self) -> String {
        format!("<Estimate: {}, {}>", self.verdict.0.level, self.model.words())
    }

    fn __str__(&self) -> String {
        format!("{}\n{}", self.verdict.__str__(), self.model.words())
    }
}
