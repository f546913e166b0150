//! The verdict as commands print it and end by it.

use super::failure::Failure;
use crate::observation::Wiring;
use crate::record::Experiment;
use crate::robot::Model;
use crate::verdict::{Level, Subject, Verdict, ViewOffset};

/// What a command does with its verdict.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct VerdictArgs {
    /// End with exit code 1 where the verdict is "do not use"; the files are written all the same
    #[arg(long)]
    strict: bool,
}

impl VerdictArgs {
    /// An error for a verdict of "do not use", where that was asked for.
    pub fn check(self, verdict: &Verdict) -> Result<(), Failure> {
        match verdict.reasons.first() {
            Some(worst) if self.strict && verdict.level == Level::DoNotUse => Err(Failure::Verdict(worst.text.clone())),
            _ => Ok(()),
        }
    }
}

/// The lines that come before all others.
pub fn verdict_text(verdict: &Verdict) -> String {
    verdict.lines().join("\n") + "\n"
}

/// What is to be judged of an experiment.
pub fn subject<'a>(model: &'a Model, experiment: &Experiment, wiring: Wiring, sd_encoder_mm: f64) -> Subject<'a> {
    let offset =
        |view: &crate::record::View| ViewOffset { name: view.name.clone(), delta_offset_deg: view.delta_offset_deg };
    Subject { wiring, views: experiment.views.iter().map(offset).collect(), ..Subject::new(model, sd_encoder_mm) }
}
