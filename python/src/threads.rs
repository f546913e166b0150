//! Work without the interpreter's lock, which Ctrl-C can end.

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use std::ops::Range;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

/// How often a Ctrl-C is looked for.
///
/// Convention: a person takes less than a tenth of a second for at once.
const LOOKS: Duration = Duration::from_millis(50);

/// How many rows of an array are worked on between two looks for a Ctrl-C.
///
/// Convention: at a microsecond a row, some hundredths of a second.
const ROWS: usize = 1 << 15;

/// Does `work` on a thread of its own while other threads of Python run.
///
/// # Errors
/// `KeyboardInterrupt` at a Ctrl-C. The work cannot be stopped: its thread ends by itself, with the process at the latest.
pub fn interruptible<T: Send + 'static>(py: Python<'_>, work: impl FnOnce() -> T + Send + 'static) -> PyResult<T> {
    let (sender, receiver) = channel();
    std::thread::spawn(move || sender.send(work()));
    // A receiver may be used by one thread at a time only, and this one is.
    let receiver = std::sync::Mutex::new(receiver);
    loop {
        let received = py.detach(|| match receiver.lock() {
            Ok(receiver) => receiver.recv_timeout(LOOKS),
            Err(_) => Err(RecvTimeoutError::Disconnected),
        });
        match received {
            Ok(result) => return Ok(result),
            Err(RecvTimeoutError::Timeout) => py.check_signals()?,
            Err(RecvTimeoutError::Disconnected) => return Err(PyRuntimeError::new_err("snakeloop: the work panicked")),
        }
    }
}

/// Does `work` on the rows of an array, some at a time, while other threads of Python run.
///
/// # Errors
/// `KeyboardInterrupt` at a Ctrl-C; what `work` says.
pub fn by_rows(py: Python<'_>, rows: usize, mut work: impl FnMut(Range<usize>) + Send) -> PyResult<()> {
    for first in (0..rows).step_by(ROWS) {
        py.detach(|| work(first..rows.min(first + ROWS)));
        py.check_signals()?;
    }
    Ok(())
}
