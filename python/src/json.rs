//! JSON to Python's own values and back.

use crate::error::wrong;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::Value;

/// JSON as Python's own values.
pub fn to_python<'py>(py: Python<'py>, json: &Value) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (json.to_string(),))
}

/// A dict of numbers, NumPy's among them, texts, lists and dicts as JSON. `what` is named in errors.
///
/// # Errors
/// Another thing in it; a number that is not finite.
pub fn of_dict(what: &str, dict: &Bound<'_, PyDict>) -> PyResult<Value> {
    let py = dict.py();
    let options = PyDict::new(py);
    options.set_item("default", py.import("operator")?.call_method1("methodcaller", ("tolist",))?)?;
    options.set_item("allow_nan", false)?;
    let text = py.import("json")?.call_method("dumps", (dict,), Some(&options));
    let text: String = text.map_err(|e| wrong(format!("{what}: {e}")))?.extract()?;
    serde_json::from_str(&text).map_err(|e| wrong(format!("{what}: {e}")))
}
