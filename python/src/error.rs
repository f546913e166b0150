//! The library's errors as one exception, which carries file and line where there are any.

use pyo3::create_exception;
use pyo3::exceptions::PyException;
use pyo3::prelude::*;
use snakeloop::Error;

create_exception!(
    snakeloop,
    SnakeloopError,
    PyException,
    "What went wrong, where, and what to do about it.\n\n\
     `path` is the file (str) and `line` its line, counted from 1, where there are any; None else."
);

/// An error of the library as an exception.
pub fn raised(error: Error) -> PyErr {
    let (path, line) = match &error {
        Error::Io { path, .. } | Error::Rig { path: Some(path), .. } => (Some(path.clone()), None),
        Error::Content { path, line, .. } => (Some(path.clone()), *line),
        _ => (None, None),
    };
    let raised = SnakeloopError::new_err(error.to_string());
    Python::attach(|py| {
        let value = raised.value(py);
        let path = path.map(|path| path.display().to_string());
        // An instance of an exception takes any attribute.
        value
            .setattr("path", path)
            .and_then(|()| value.setattr("line", line))
            .map_or_else(|e| e, |()| raised.clone_ref(py))
    })
}

/// An error about what a caller gave.
pub fn wrong(message: impl Into<String>) -> PyErr {
    SnakeloopError::new_err(message.into())
}
