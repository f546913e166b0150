//! `reproduce`: the paper's tables and figures, side by side with what this gives.

use super::console::Console;
use crate::Result;
use crate::cli::failure::Failure;
use crate::record::write_atomically;
use crate::report::reproduction::page;
use crate::reproduce::{Comparison, reproduce};
use serde::Serialize;
use std::path::PathBuf;

/// Compute the paper's tables and figures anew, beside the printed ones: writes OUT/report.html and CSV files
///
/// Table II, Eq. 14, Fig. 8, 9, 10, 11, Table III and Eq. 26, each with the paper's figure, this program's, and why they differ.
/// Where the paper measured its robot, a simulated robot with the paper's η and λ is used.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop reproduce -o reproduced")]
pub struct Args {
    /// The folder to write to; created if it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Seed of the simulated noise: the same seed gives the same files
    #[arg(long, value_name = "NUMBER", default_value_t = 1)]
    seed: u64,
}

#[derive(Serialize)]
struct Summary<'a> {
    comparisons: &'a [Comparison],
    output: PathBuf,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        let all = reproduce(self.seed)?;
        for (name, text) in all.files()? {
            write_atomically(&self.output.join(name), text.as_bytes())?;
        }
        let report = self.output.join("report.html");
        write_atomically(&report, page(&all).as_bytes())?;
        let summary = Summary { comparisons: &all.comparisons, output: report };
        console.result(&summary, || {
            let lines = summary.comparisons.iter().map(|c| {
                let paper = c.paper.map_or("–".to_owned(), |paper| format!("{paper:.4}"));
                format!("{:<14}{:>10}{:>12.4} {:<10} {}", c.place, paper, c.ours, c.unit, c.quantity)
            });
            let header = format!("{:<14}{:>10}{:>12}", "place", "paper", "ours");
            [header].into_iter().chain(lines).collect::<Vec<_>>().join("\n")
                + &format!("\n{}", summary.output.display())
        });
        console.next(format_args!("open {} in a browser", summary.output.display()));
        Ok(())
    }
}
