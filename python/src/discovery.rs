//! `discover`: which effect the model lacks.

use crate::error::{raised, wrong};
use crate::json;
use crate::model::PyModel;
use crate::tables::{encoders_of, measurements_of};
use crate::threads::interruptible;
use crate::verdict::framed;
use pyo3::prelude::*;
use serde_json::Value;
use snakeloop::Result;
use snakeloop::discover::{Data, Localisation, discover as search, discover_in_frames, nothing_named};
use snakeloop::estimate::Options;
use snakeloop::estimate::gap::gap;
use snakeloop::observation::{EncoderReading, Measurement};
use snakeloop::record::Provenance;
use snakeloop::report::discovery::{Page, lines};
use snakeloop::report::verdict::verdict_page;
use snakeloop::robot::Model;
use snakeloop::verdict::{Subject, Verdict, doubts_of_times};

/// How high the page is shown in a notebook, lines. Convention: a display choice.
const PAGE_LINES: usize = 40;

/// What `discover` found: verdict, effects, gap, and the model with the effects added.
#[pyclass(name = "Discovery", module = "snakeloop", frozen)]
pub struct PyDiscovery {
    json: Value,
    text: String,
    page: String,
    model: Model,
}

/// Compares what a model predicts with what was measured, and names what is missing.
///
/// measurements and encoders: paths of measurements.csv and encoders.csv, data frames, or dicts of arrays with these files' columns.
/// model: the Model to start from; the paper's without. sd_encoder_mm: standard deviation of an encoder reading, mm.
///
/// Takes seconds to minutes, during which other threads of Python run. A Ctrl-C raises KeyboardInterrupt at once; what was begun
/// then goes on in the background to its end, or to that of the process.
#[pyfunction]
#[pyo3(signature = (measurements, encoders, model=None, *, sd_encoder_mm=None))]
pub fn discover(
    py: Python<'_>,
    measurements: &Bound<'_, PyAny>,
    encoders: &Bound<'_, PyAny>,
    model: Option<&PyModel>,
    sd_encoder_mm: Option<f64>,
) -> PyResult<PyDiscovery> {
    let sd_encoder_mm = sd_encoder_mm.unwrap_or(Options::default().sd_encoder_mm);
    if !(sd_encoder_mm > 0.0 && sd_encoder_mm <= 1.0) {
        return Err(wrong(format!("sd_encoder_mm is {sd_encoder_mm}, expected more than 0, to 1 mm")));
    }
    let model = model.map_or_else(Model::default, |model| model.model.clone());
    let readings = encoders_of(encoders, &model)?;
    let measurements = measurements_of(measurements)?;
    interruptible(py, move || discovered(model, &measurements, &readings, sd_encoder_mm))?.map_err(raised)
}

/// As the command `discover` does.
fn discovered(
    model: Model,
    measurements: &[Measurement],
    readings: &[EncoderReading],
    sd_encoder_mm: f64,
) -> Result<PyDiscovery> {
    let data = Data::new(measurements, readings, sd_encoder_mm)?;
    let mistake = Subject::new(&model, sd_encoder_mm).wiring_mistake(measurements, readings);
    if let Some(mistake) = mistake.or_else(|| doubts_of_times(measurements, readings, false)) {
        let verdict = Verdict::of(vec![mistake]);
        let json = nothing_named(&gap(&model, measurements, readings), &verdict, &data.remarks);
        let text = format!("unexplained: no effect is named from these data\n{}", verdict.lines().join("\n"));
        return Ok(PyDiscovery {
            json,
            text,
            page: verdict_page("snakeloop: discover", &verdict, &Provenance::new("discover")),
            model,
        });
    }
    let from_frames = measurements.iter().any(|measurement| measurement.quality.is_some());
    let found = if from_frames { discover_in_frames(model, &data, &|_| ()) } else { search(&model, &data) };
    let localised = Localisation::new(&found, &data);
    let page = Page {
        found: &found,
        data: &data,
        gap: localised.as_ref(),
        correction: None,
        next: None,
        made_from: &Provenance::new("discover"),
    }
    .html();
    Ok(PyDiscovery { json: found.json(), text: lines(&found), page, model: found.model })
}

#[pymethods]
impl PyDiscovery {
    /// "named", "partly", "none" or "unexplained".
    #[getter]
    fn verdict(&self) -> &str {
        self.json["verdict"].as_str().unwrap_or_default()
    }

    /// The effects, as in discrepancy.json: name, parameters with value, sd and unit, evidence, removes, probability.
    #[getter]
    fn effects<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::to_python(py, &self.json["effects"])
    }

    /// The gap on data that the fit did not see, as in discrepancy.json: before_mm, after_mm, noise_floor_mm …
    #[getter]
    fn gap<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::to_python(py, &self.json["gap"])
    }

    /// What was passed over or could not be decided, in sentences.
    #[getter]
    fn remarks<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::to_python(py, &self.json["remarks"])
    }

    /// All of discrepancy.json.
    fn as_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::to_python(py, &self.json)
    }

    /// The model, with the effects where they are named.
    #[getter]
    fn model(&self) -> PyModel {
        self.model.clone().into()
    }

    fn __repr__(&self) -> String {
        format!("<Discovery {}>", self.text.lines().next().unwrap_or_default())
    }

    fn __str__(&self) -> &str {
        &self.text
    }

    /// The command's report.html in a frame of its own, so that neither its style nor the notebook's reaches the other.
    fn _repr_html_(&self) -> String {
        framed(&self.page, PAGE_LINES)
    }
}
