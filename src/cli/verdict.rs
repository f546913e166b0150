//! The verdict as commands print it and end by it.

use super::failure::Failure;
use super::views::{RigRefused, sheet_text};
use crate::Result;
use crate::measure::{Rig, RigError};
use crate::observation::{EncoderReading, Measurement, Wiring};
use crate::record::{Experiment, Fault, Warning};
use crate::robot::Model;
use crate::verdict::{Code, Level, Reason, Subject, Verdict, ViewOffset, doubts_of_times};

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

/// The most by which the sheet may bow, mm (rms).
///
/// Derived: what is known of paper before a sheet is seen, 1 mm over 40 mm to either side.
const MOST_BOW_MM: f64 = 1.0;
/// The most by which its two pitches may differ, as a share.
///
/// Derived: twice the 2 % of a printer.
const MOST_STRETCH: f64 = 0.04;

/// A sheet that is further from flat and square than paper and printers are: measured, but doubtful.
pub fn sheet_reason(view: &str, rig: &Rig) -> Option<Reason> {
    let shape = &rig.sheet_shape;
    (shape.rms_mm() > MOST_BOW_MM || shape.anisotropy.abs() > MOST_STRETCH).then(|| {
        let text = format!("view {view}: {}", sheet_text(rig));
        Reason::new(Code::SheetNotFlat, Level::Look, text, FLATTEN)
    })
}

/// The reason that a view's straight picture gives no rig.
pub fn rig_reason(error: &crate::Error) -> Reason {
    let is_of_the_sheet = matches!(error, crate::Error::Rig { source, .. }
        if matches!(source.downcast_ref(), Some(RigRefused { error: RigError::SheetNotFlat { .. }, .. })));
    let (code, remedy) = if is_of_the_sheet { (Code::SheetNotFlat, FLATTEN) } else { (Code::Files, LOOK_AT_THE_RIG) };
    Reason::new(code, Level::DoNotUse, error.to_string(), remedy)
}

const FLATTEN: &str = "lay the sheet flat, on a plate or held by tape all around, and print it at 100 %; see \"Take the straight picture\" in the book";
const LOOK_AT_THE_RIG: &str =
    "`check -o FOLDER` draws what was seen into FOLDER/rig.jpg; see \"Take the straight picture\" in the book";

/// Rows by which the unit of the times is told. Convention: a resource limit, far beyond what is needed.
const TIMED: usize = 2000;

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

/// A doubt of the times' unit, or of which row belongs to which frame, from some of the measurements.
///
/// # Errors
/// What `measurements` gives.
pub fn doubt_of_times<E>(
    measurements: impl Iterator<Item = Result<Measurement, E>>,
    log: &[EncoderReading],
    experiment: Option<&Experiment>,
) -> Result<Option<Reason>, E> {
    let some = measurements.take(TIMED).collect::<Result<Vec<_>, E>>()?;
    let is_stated =
        experiment.and_then(|experiment| experiment.log.as_ref()).is_some_and(|log| log.time_unit.is_some());
    Ok(doubts_of_times(&some, log, is_stated))
}
