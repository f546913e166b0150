//! The command line: knows every module, and no module knows it.

use std::process::ExitCode;

/// Parses the arguments, runs the command, prints errors, gives the exit code.
pub fn main() -> ExitCode {
    ExitCode::SUCCESS
}
