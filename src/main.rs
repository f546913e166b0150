//! The `snakeloop` program: a thin shell around [`snakeloop::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    snakeloop::cli::main()
}
