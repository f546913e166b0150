//! The one error type of the library.
//!
//! Every variant carries what a reader needs to act: the file, the line or frame, what was found, what was expected
//! and what to do about it. [`Error::exit_code`] separates a wrong call (2) from work that failed (1).

use std::path::{Path, PathBuf};

/// What went wrong, where, and what to do about it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused a file or folder.
    #[error("{}: cannot {action}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The verb that failed: "read", "write", "create" …
        action: &'static str,
        /// The system's own words.
        source: std::io::Error,
    },
    /// A file was read, but something in it is not as it must be.
    #[error("{}{}: {message}", path.display(), line.map(|l| format!(":{l}")).unwrap_or_default())]
    Content {
        /// The file.
        path: PathBuf,
        /// The line, counted from 1, where one can be named.
        line: Option<u64>,
        /// What was found, what was expected, what to do.
        message: String,
    },
    /// The rig could not be calibrated from the straight picture.
    #[error("{}: rig calibration: {message}", path.display())]
    Rig {
        /// The straight picture.
        path: PathBuf,
        /// What was not found and what to change.
        message: String,
    },
    /// A quantity lies where the model has no answer.
    #[error("{0}")]
    Domain(String),
    /// The program was called in a way that cannot work.
    #[error("{0}")]
    Usage(String),
    /// The work needs OpenCV and this build has none.
    #[error("{what} needs OpenCV, which this build leaves out; build with the `opencv` feature (the default)")]
    NoOpenCv {
        /// What was asked for.
        what: String,
    },
    /// OpenCV answered with an error.
    #[error("OpenCV: {action}: {message}")]
    OpenCv {
        /// What was being done.
        action: String,
        /// OpenCV's own words.
        message: String,
    },
}

/// A result with the library's error.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// An error about the content of a file, with no line to name.
    pub fn content(path: &Path, message: impl Into<String>) -> Self {
        Self::Content { path: path.to_owned(), line: None, message: message.into() }
    }

    /// An error about one line (counted from 1) of a file.
    pub fn at_line(path: &Path, line: u64, message: impl Into<String>) -> Self {
        Self::Content { path: path.to_owned(), line: Some(line), message: message.into() }
    }

    /// An error of the operating system about a path.
    pub fn io(path: &Path, action: &'static str) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, action, source }
    }

    /// The process exit code this error stands for: 2 for a wrong call, 1 for work that failed.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Usage(_) => 2,
            _ => 1,
        }
    }
}
