//! `Verdict`: whether a result can be relied on.

use crate::error::wrong;
use crate::json;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use serde_json::Value;
use snakeloop::report::verdict::verdict_alone;
use snakeloop::verdict::Verdict;

/// Whether a result can be relied on, and why not.
#[pyclass(name = "Verdict", module = "snakeloop", frozen, eq)]
#[derive(Clone, PartialEq)]
pub struct PyVerdict(pub Verdict);

impl PyVerdict {
    fn json(&self) -> PyResult<Value> {
        serde_json::to_value(&self.0).map_err(|e| wrong(e.to_string()))
    }
}

#[pymethods]
impl PyVerdict {
    /// "good", "look" or "do_not_use": the worst of the reasons' levels.
    #[getter]
    fn level<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::to_python(py, &self.json()?["level"])
    }

    /// The reasons, the worst first: dicts with code, level, text, remedy, and suggestion where the mistake can be written down.
    #[getter]
    fn reasons<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::to_python(py, &self.json()?["reasons"])
    }

    /// Refused: a verdict is neither true nor false.
    fn __bool__(&self) -> PyResult<bool> {
        Err(PyTypeError::new_err(
            "a verdict is neither true nor false: compare its level with \"good\", \"look\", \"do_not_use\"",
        ))
    }

    fn __repr__(&self) -> String {
        let worst = self.0.reasons.first().map(|reason| format!(": {}", reason.text)).unwrap_or_default();
        format!("<Verdict {}{worst}>", self.0.level)
    }

    /// As the program prints it.
    pub fn __str__(&self) -> String {
        self.0.lines().join("\n")
    }

    fn _repr_html_(&self) -> String {
        framed(&verdict_alone(&self.0), 4 + 6 * self.0.reasons.len())
    }
}

/// A page in a frame of its own, so that neither its style nor the notebook's reaches the other; so many lines high.
pub fn framed(page: &str, lines: usize) -> String {
    let escaped = page.replace('&', "&amp;").replace('"', "&quot;");
    format!("<iframe srcdoc=\"{escaped}\" style=\"width: 100%; height: {lines}rem; border: 0\"></iframe>")
}
