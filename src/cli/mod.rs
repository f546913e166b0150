//! The command line: knows every module, and no module knows it.
//!
//! Each command is one file: what it may be told (a clap structure) and what it does, top to bottom.

mod calibrate;
mod check;
mod checksum;
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
mod live;
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
mod trackers;
mod verdict;
mod views;

use crate::{Error, Result};
use clap::{Parser, Subcommand};
use console::Console;
use failure::Failure;
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
    New(new::Args),
    Check(check::Args),
    Run(run::Args),
    Live(live::Args),
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
    Completions(completions::Args),
    Manual(completions::ManualArgs),
}

impl Command {
    fn run(&self, console: &Console) -> Result<(), Failure> {
        match self {
            Self::New(args) => args.run(console),
            Self::Check(args) => args.run(console),
            Self::Run(args) => args.run(console),
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
            Self::Completions(args) => args.run(),
            Self::Manual(args) => args.run(console),
        }
    }
}

/// Parses the arguments, runs the command, prints errors, gives the exit code.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let ended = cli.command.run(&cli.console).and_then(|()| match console::lost() {
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

    /// docs/src/reference/commands.md as it must be: what --help says of every command.
    fn reference() -> String {
        let mut text = "# Commands\n\nWhat `--help` says of each. Exit code 0 means done, 1 that the work failed, 2 wrong usage.\n".to_owned();
        let mut root = Cli::command().term_width(100);
        root.build();
        for mut command in with_all_below(&root) {
            if command.get_name() == "help" || command.get_display_name().is_some_and(|name| name.contains("-help-")) {
                continue;
            }
            let name = command.get_display_name().unwrap_or("snakeloop").replace('-', " ");
            let help = command.render_long_help().to_string();
            let lines: Vec<&str> = help.lines().map(str::trim_end).collect();
            text += &format!("\n## {name}\n\n```text\n{}\n```\n", lines.join("\n").trim_end());
        }
        text
    }

    #[test]
    fn the_book_says_of_every_command_what_help_says() {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/src/reference/commands.md");
        if std::env::var_os("WRITE_REFERENCE").is_some() {
            std::fs::write(&path, reference()).unwrap();
        }
        let book = std::fs::read_to_string(&path).unwrap();
        assert!(
            book == reference(),
            "docs/src/reference/commands.md is not what --help says; write it anew with \
             WRITE_REFERENCE=1 cargo test --no-default-features --features cli --lib the_book_says"
        );
    }

    #[test]
    fn the_book_has_every_page_that_it_lists_and_lists_every_page() {
        let source = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/src");
        let summary = std::fs::read_to_string(source.join("SUMMARY.md")).unwrap();
        let listed: Vec<&str> = summary.split("](").skip(1).filter_map(|rest| rest.split(')').next()).collect();
        for page in &listed {
            let text = std::fs::read_to_string(source.join(page)).unwrap();
            assert!(text.starts_with("# "), "{page}");
            let links = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
            for link in links.filter(|link| link.ends_with(".md")) {
                let target = source.join(page).parent().unwrap().join(link);
                assert!(target.is_file(), "{page} points to {link}");
            }
        }
        for pattern in ["*.md", "*/*.md"] {
            for page in glob::glob(source.join(pattern).to_str().unwrap()).unwrap() {
                let page = page.unwrap().strip_prefix(&source).unwrap().to_str().unwrap().to_owned();
                assert!(page == "SUMMARY.md" || listed.contains(&page.as_str()), "{page} is not in SUMMARY.md");
            }
        }
    }
}
