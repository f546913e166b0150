//! The command line: knows every module, and no module knows it.
//!
//! Each command is one file: what it may be told (a clap structure) and what it does, top to bottom.

mod calibrate;
mod console;
mod discover;
mod estimate;
mod estimator;
mod evaluate;
mod inputs;
mod invert;
mod live;
mod measure;
mod render;
mod reproduce;
mod run;
mod simulate;
mod table;
mod views;

use crate::Result;
use clap::{Parser, Subcommand};
use console::Console;
use std::process::ExitCode;

/// Measures a snake-like surgical robot in camera frames, learns its actuation losses and compensates them.
#[derive(Debug, Parser)]
#[command(
    name = "snakeloop",
    version,
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
    Run(run::Args),
    Live(live::Args),
    Measure(measure::Args),
    Estimate(estimate::Args),
    Table(table::Args),
    Invert(invert::Args),
    Discover(discover::Args),
    Evaluate(evaluate::Args),
    Simulate(simulate::Args),
    Render(render::Args),
    Calibrate(calibrate::Args),
    Reproduce(reproduce::Args),
}

impl Command {
    fn run(&self, console: &Console) -> Result<()> {
        match self {
            Self::Run(args) => args.run(console),
            Self::Live(args) => args.run(console),
            Self::Measure(args) => args.run(console),
            Self::Estimate(args) => args.run(console),
            Self::Table(args) => args.run(console),
            Self::Invert(args) => args.run(console),
            Self::Discover(args) => args.run(console),
            Self::Evaluate(args) => args.run(console),
            Self::Simulate(args) => args.run(console),
            Self::Render(args) => args.run(console),
            Self::Calibrate(args) => args.run(console),
            Self::Reproduce(args) => args.run(console),
        }
    }
}

/// Parses the arguments, runs the command, prints errors, gives the exit code.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    match cli.command.run(&cli.console) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    fn with_all_below(command: &clap::Command) -> Vec<clap::Command> {
        let below = command.get_subcommands().flat_map(with_all_below);
        std::iter::once(command.clone()).chain(below).collect()
    }

    #[test]
    fn every_command_has_an_example_and_every_flag_a_help_text() {
        Cli::command().debug_assert();
        for command in with_all_below(&Cli::command()) {
            let name = command.get_name().to_owned();
            assert!(command.get_about().is_some(), "{name}: no help text");
            let example = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            assert!(example.contains("Example:\n  snakeloop "), "{name}: no example");
            for flag in command.get_arguments() {
                assert!(flag.get_help().is_some(), "{name} {}: no help text", flag.get_id());
            }
        }
    }
}
