//! The verdict as commands print it and end by it.

use super::failure::Failure;
use crate::Result;
use crate::observation::Wiring;
use crate::record::{Experiment, Fault, Warning};
use crate::robot::Model;
use crate::verdict::{Code, Level, Reason, Subject, Verdict, ViewOffset};

/// What a command does with its verdict.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct VerdictArgs {
    /// End with exit code 1 if the verdict is "do not use"; the files are written all the same
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

/// What the files themselves say against a result: recordings that break off, readings that contradict each other, clocks that do not meet.
///
/// # Errors
/// A recording that is not there.
pub fn reasons_of_files(experiment: &Experiment, warnings: &[Warning]) -> Result<Vec<Reason>> {
    let mut reasons = reasons_of(warnings);
    let mut seen = Vec::new();
    for bag in experiment.bags() {
        if !seen.contains(&bag) {
            reasons.extend(bag.unfinished()?.into_iter().map(damaged));
            seen.push(bag);
        }
    }
    Ok(reasons)
}

/// What warnings of a file say against a result; rows that make no sense cost themselves only.
pub fn reasons_of(warnings: &[Warning]) -> Vec<Reason> {
    let of = |fault: Fault| warnings.iter().filter(move |warning| warning.fault == fault);
    let contradictions = of(Fault::Contradiction).next().map(|first| {
        let others = of(Fault::Contradiction).count() - 1;
        let more = if others > 0 { format!(" (and {others} more)") } else { String::new() };
        let remedy =
            "find out what writes the second one, and remove it; `joints`, or a separate topic, says which one counts";
        Reason::new(Code::ContradictoryReadings, Level::Look, format!("{first}{more}"), remedy)
    });
    let clock = of(Fault::Clock).map(|warning| {
        let remedy = "stamp frames and readings by one clock; in ROS let the driver set header.stamp, or give an encoders.csv with each frame's index";
        Reason::new(Code::Clock, Level::DoNotUse, warning.to_string(), remedy)
    });
    let damage = of(Fault::Damage).map(|warning| damaged(warning.to_string()));
    contradictions.into_iter().chain(clock).chain(damage).collect()
}

fn damaged(text: String) -> Reason {
    let remedy = "copy the recording again; `mcap doctor` and `mcap recover` show and repair the damage; the part that could be read was used";
    Reason::new(Code::RecordingDamaged, Level::Look, text, remedy)
}

/// Whether an experiment says in which unit the times of its log are.
pub fn unit_is_stated(experiment: Option<&Experiment>) -> bool {
    experiment.and_then(|experiment| experiment.log.as_ref()).is_some_and(|log| log.time_unit.is_some())
}
