//! The command line: knows every module, and no module knows it.
//!
//! Each command is one file: what it may be told (a clap structure) and what it does, top to bottom. A program carries `run` out by
//! [`run_experiment`].

mod calibrate;
mod check;
mod checksum;
#[cfg(feature = "cli")]
mod completions;
mod console;
mod discover;
mod estimate;
mod estimator;
mod evaluate;
mod export;
mod failure;
mod flow;
mod force;
mod inputs;
mod invert;
#[cfg(feature = "cli")]
mod live;
#[cfg(feature = "cli")]
mod log;
mod measure;
mod measuring;
mod merge;
mod new;
mod origin;
mod overlays;
mod print;
mod render;
mod reproduce;
mod run;
mod shard;
mod simulate;
mod table;
#[cfg(feature = "cli")]
mod topics;
mod trackers;
mod verdict;
mod views;

use crate::{Error, Result};
use clap::{Parser, Subcommand};
pub use console::Caller;
use console::Console;
use failure::Failure;
pub use run::{Summary as RunSummary, run_experiment};
use std::process::ExitCode;

/// Measures a snake-like surgical robot in camera frames, learns its actuation losses and compensates them.
#[derive(Debug, Parser)]
#[command(
    name = "snakeloop",
    version = env!("SNAKELOOP_VERSION"),
    after_help = "Example:\n  snakeloop run fixtures/bending -o out\n\n\
                  Angles: theta is the bend from straight (theta_0 − theta_L in the paper), delta the azimuth that the \
                  tip leans towards. Exit code: 0 done, 1 the work failed, 2 wrong usage."
)]
struct Cli {
    #[command(flatten)]
    console: Console,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    New(new::Args),
    Check(check::Args),
    Run(run::Args),
    #[cfg(feature = "cli")]
    Live(Box<live::Args>),
    Measure(measure::Args),
    Merge(merge::Args),
    Estimate(estimate::Args),
    Table(table::Args),
    Invert(invert::Args),
    Discover(discover::Args),
    Force(force::Args),
    Evaluate(evaluate::Args),
    Export(export::Args),
    Simulate(simulate::Args),
    Render(render::Args),
    Print(print::Args),
    Calibrate(calibrate::Args),
    Reproduce(reproduce::Args),
    #[cfg(feature = "cli")]
    Completions(completions::Args),
    #[cfg(feature = "cli")]
    Manual(completions::ManualArgs),
}

impl Command {
    fn run(&self, console: &Console) -> Result<(), Failure> {
        match self {
            Self::New(args) => args.run(console),
            Self::Check(args) => args.run(console),
            Self::Run(args) => args.run(console),
            #[cfg(feature = "cli")]
            Self::Live(args) => args.run(console),
            Self::Measure(args) => args.run(console),
            Self::Merge(args) => args.run(console),
            Self::Estimate(args) => args.run(console),
            Self::Table(args) => args.run(console),
            Self::Invert(args) => args.run(console),
            Self::Discover(args) => args.run(console),
            Self::Force(args) => args.run(console),
            Self::Evaluate(args) => args.run(console),
            Self::Export(args) => args.run(console),
            Self::Simulate(args) => args.run(console),
            Self::Render(args) => args.run(console),
            Self::Print(args) => args.run(console),
            Self::Calibrate(args) => args.run(console),
            Self::Reproduce(args) => args.run(console),
            #[cfg(feature = "cli")]
            Self::Completions(args) => args.run(),
            #[cfg(feature = "cli")]
            Self::Manual(args) => args.run(console),
        }
    }
}

/// Shows what happens from here on, if it was asked for.
fn begin(console: &Console) -> Result<(), Failure> {
    #[cfg(feature = "cli")]
    log::start(console.verbosity())?;
    // Without the program nobody listens, and the library's `main` is not called.
    #[cfg(not(feature = "cli"))]
    let _ = console;
    tracing::info!(version = env!("SNAKELOOP_VERSION"), "begins");
    Ok(())
}

/// Parses the arguments, runs the command, prints errors, gives the exit code.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let ended = begin(&cli.console).and_then(|()| cli.command.run(&cli.console)).and_then(|()| match console::lost() {
        None => Ok(()),
        Some(message) => {
            let what = "standard output: the result was not written".into();
            Err(Error::Unavailable { what, message: message.into() }.into())
        }
    });
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            console::complain(format_args!("error: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

#[cfg(all(test, feature = "cli"))]
mod tests;
