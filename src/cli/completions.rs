//! `completions` and `manual`: what a shell and `man` want to know of the commands.

use super::console::{Console, print};
use crate::cli::failure::Failure;
use crate::record::write_atomically;
use crate::{Error, Result};
use clap::CommandFactory;
use clap_complete::Shell;
use serde::Serialize;
use std::path::PathBuf;

/// Print the completion script of a shell
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop completions bash > ~/.local/share/bash-completion/completions/snakeloop")]
pub struct Args {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

impl Args {
    pub fn run(&self) -> Result<(), Failure> {
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut super::Cli::command(), "snakeloop", &mut script);
        print(&String::from_utf8_lossy(&script));
        Ok(())
    }
}

/// Write the manual pages, one a command: OUT/snakeloop.1, OUT/snakeloop-run.1 and so on
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop manual -o ~/.local/share/man/man1")]
pub struct ManualArgs {
    /// The folder to write to; created if it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
}

#[derive(Serialize)]
struct Written {
    pages: usize,
    output: PathBuf,
}

impl ManualArgs {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        let mut root = super::Cli::command();
        root.build();
        let mut pages = 0;
        for (name, command) in named("", &root) {
            let path = self.output.join(format!("{name}.1"));
            let mut page = Vec::new();
            clap_mangen::Man::new(command).render(&mut page).map_err(Error::io(&path, "write"))?;
            write_atomically(&path, &page)?;
            pages += 1;
        }
        let written = Written { pages, output: self.output.clone() };
        console.result(&written, || format!("{pages} pages\n{}", written.output.display()));
        Ok(())
    }
}

/// A command and all below it, with names such as snakeloop-calibrate-rig; clap's own `help` is left out.
fn named(above: &str, command: &clap::Command) -> Vec<(String, clap::Command)> {
    let name = if above.is_empty() { command.get_name().to_owned() } else { format!("{above}-{}", command.get_name()) };
    let below = command.get_subcommands().filter(|below| below.get_name() != "help");
    let below: Vec<_> = below.flat_map(|below| named(&name, below)).collect();
    std::iter::once((name, command.clone())).chain(below).collect()
}
