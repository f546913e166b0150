//! Why a command ended without its result, and the exit code that says so.

use crate::Error;

/// Why a command ended without its result.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The call cannot work as it was made.
    #[error("{0}")]
    Usage(String),
    /// The result must not be used, and the call asked to be told by the exit code.
    #[error("do not use (--strict): {0}")]
    Verdict(String),
    /// The model must not be used, and the call did not ask for it all the same.
    #[error("{0}; correct that and learn again, or use the model with --even-if-bad")]
    BadModel(String),
    /// The work failed.
    #[error(transparent)]
    Work(#[from] Error),
}

impl Failure {
    /// Work that failed because what the call named, an address or a terminal, cannot be used.
    #[cfg(feature = "cli")]
    pub fn of_call(error: Error) -> Self {
        Self::Usage(error.to_string())
    }

    /// The process exit code: 2 for a wrong call, 1 for work that failed.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Usage(_) | Self::Work(Error::Argument(_)) => 2,
            Self::Verdict(_) | Self::BadModel(_) | Self::Work(_) => 1,
        }
    }
}
