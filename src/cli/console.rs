//! What the program says: results on standard output, everything else on standard error.

use crate::{Error, Result};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;
use std::fmt::Display;
use std::io::{ErrorKind, IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError, mpsc};
use std::time::Duration;

/// What ends sooner shows no stages. Convention: as long as one waits without asking.
const SHOWN_AFTER: Duration = Duration::from_secs(2);

/// How often a spinner turns. Convention: a display choice.
const TICK: Duration = Duration::from_millis(150);

/// The switches that every command has.
#[derive(Debug, Clone, clap::Args)]
pub struct Console {
    /// Print only errors and, with --json, the result
    #[arg(long, global = true)]
    quiet: bool,
    /// Print the result as JSON on standard output instead of text
    #[arg(long, global = true)]
    json: bool,
    /// Show on standard error what is done, stage by stage, with the time of each; -vv also shows single frames. The environment variable
    /// SNAKELOOP_LOG=info or debug does the same
    #[arg(short, long, global = true, action = clap::ArgAction::Count, conflicts_with = "quiet")]
    verbose: u8,
    /// The program that called the command, where that was no shell.
    #[arg(skip)]
    caller: Option<Arc<Caller>>,
}

/// A program that calls a command as a function. Nothing is printed for it: it gets the warnings, and may end the work.
#[derive(Debug, Default)]
pub struct Caller {
    warnings: Mutex<Vec<String>>,
    ends: AtomicBool,
}

impl Caller {
    /// The warnings so far, each once.
    pub fn warnings(&self) -> Vec<String> {
        std::mem::take(&mut self.warnings.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Ends the work at the next frame.
    pub fn end(&self) {
        self.ends.store(true, Ordering::Relaxed);
    }
}

impl Console {
    /// For a command that a program calls.
    pub fn of_caller(caller: Arc<Caller>) -> Self {
        Self { quiet: true, json: false, verbose: 0, caller: Some(caller) }
    }

    /// An error where the program that called the command ended it.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn require_wanted(&self) -> Result<()> {
        let ended = self.caller.as_ref().is_some_and(|caller| caller.ends.load(Ordering::Relaxed));
        if ended { Err(Error::Ended) } else { Ok(()) }
    }

    /// How often `-v` was given.
    #[cfg(feature = "cli")]
    pub fn verbosity(&self) -> u8 {
        self.verbose
    }

    /// Whether progress is drawn: on a terminal, and not between the lines of `-v`.
    fn is_drawn(&self) -> bool {
        !self.quiet && self.verbose == 0 && std::io::stderr().is_terminal()
    }

    /// Prints a result: JSON where it was asked for, else text for people unless quiet.
    pub fn result(&self, value: &impl Serialize, text: impl FnOnce() -> String) {
        if self.json {
            // Numbers, text and lists of them always serialise.
            print(&(serde_json::to_string_pretty(value).unwrap_or_default() + "\n"));
        } else if !self.quiet {
            print(&(text().trim_end().to_owned() + "\n"));
        }
    }

    /// Says below a result what to do next, where it is printed for people.
    pub fn next(&self, step: impl Display) {
        if self.may_ask() {
            print(&format!("next: {step}\n"));
        }
    }

    /// Prints warnings, one a line, unless quiet; hands them to the program that called the command.
    pub fn warn(&self, warnings: impl IntoIterator<Item = impl Display>) {
        if let Some(caller) = &self.caller {
            let mut kept = caller.warnings.lock().unwrap_or_else(PoisonError::into_inner);
            kept.extend(warnings.into_iter().map(|warning| warning.to_string()));
        } else if !self.quiet {
            for warning in warnings {
                complain(format_args!("warning: {warning}"));
            }
        }
    }

    /// Tells a person something on the way, unless quiet.
    pub fn say(&self, text: impl Display) {
        if !self.quiet {
            complain(format_args!("{text}"));
        }
    }

    /// Whether a person may be asked: not where the result is for machines, or nothing is to be said.
    pub fn may_ask(&self) -> bool {
        !self.quiet && !self.json
    }

    /// A progress bar over so many steps, or an unknown number; it shows only on a terminal, and not when quiet.
    pub fn progress(&self, steps: Option<usize>, doing: &'static str) -> ProgressBar {
        let target = if self.is_drawn() { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let bar = ProgressBar::with_draw_target(steps.map(|steps| steps as u64), target).with_message(doing);
        let template = match steps {
            Some(_) => "{msg} {wide_bar} {pos}/{len}, {eta} left",
            None => "{msg} {spinner} {pos}, {per_sec}",
        };
        match ProgressStyle::with_template(template) {
            Ok(style) => bar.with_style(style),
            Err(_) => bar,
        }
    }

    /// Does what may take long in stages of which nobody knows the length; from [`SHOWN_AFTER`] on the stage's name is shown, as
    /// [`progress`](Self::progress) is.
    pub fn in_stages<T>(&self, work: impl FnOnce(&dyn Fn(&'static str)) -> T) -> T {
        if !self.is_drawn() {
            return work(&|_| ());
        }
        let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::hidden());
        let style = ProgressStyle::with_template("{spinner} {msg} ({elapsed})");
        let bar = style.map_or(bar.clone(), |style| bar.with_style(style));
        let (ended, end) = mpsc::channel::<()>();
        let shown = &bar;
        let out = std::thread::scope(|scope| {
            scope.spawn(move || {
                if end.recv_timeout(SHOWN_AFTER) == Err(mpsc::RecvTimeoutError::Timeout) {
                    shown.set_draw_target(ProgressDrawTarget::stderr());
                    shown.enable_steady_tick(TICK);
                }
            });
            let out = work(&|stage| bar.set_message(stage));
            drop(ended);
            out
        });
        bar.finish_and_clear();
        out
    }
}

/// Why a result did not reach standard output.
static LOST: OnceLock<String> = OnceLock::new();

/// Why a result that was printed did not arrive, as on a disk that is full.
pub fn lost() -> Option<&'static str> {
    LOST.get().map(String::as_str)
}

/// Prints a result as it is, as a shell reads it. A reader that has gone away (`| head`) is no error; any other failure is kept for
/// the end of the program ([`lost`]).
pub fn print(text: &str) {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => drop(LOST.set(e.to_string())),
        _ => {}
    }
}

/// Writes a line on standard error. Where nobody takes it, closed or on a full disk, it is lost and the work goes on.
pub fn complain(line: impl Display) {
    let _ = writeln!(std::io::stderr(), "{line}");
}
