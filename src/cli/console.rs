//! What the program says: results on standard output, everything else on standard error.

use serde::Serialize;
use std::fmt::Display;
use std::io::Write;

/// The two switches that every command has.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct Console {
    /// Say nothing but errors and, with --json, the result
    #[arg(long, global = true)]
    quiet: bool,
    /// Print the result as JSON on standard output instead of text
    #[arg(long, global = true)]
    json: bool,
}

impl Console {
    /// Prints a result: JSON where it was asked for, else text for people unless quiet.
    pub fn result(&self, value: &impl Serialize, text: impl FnOnce() -> String) {
        if self.json {
            // Numbers, text and lists of them always serialise.
            print_line(&serde_json::to_string_pretty(value).unwrap_or_default());
        } else if !self.quiet {
            print_line(text().trim_end());
        }
    }

    /// Prints warnings, one a line, unless quiet.
    pub fn warn(&self, warnings: impl IntoIterator<Item = impl Display>) {
        if !self.quiet {
            for warning in warnings {
                eprintln!("warning: {warning}");
            }
        }
    }
}

/// Prints a line; a reader that has gone away (`| head`) is no error.
fn print_line(text: &str) {
    let _ = writeln!(std::io::stdout(), "{text}");
}
