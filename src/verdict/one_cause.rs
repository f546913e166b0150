//! Whether one cause, a force or the stem's angle, explains what a model misses without it.
//!
//! Whatever the model misses is taken for the cause, be it a slipped encoder or another robot's model. Of what is left alone can be told whether it is
//! one.

use super::Verdict;
use super::health::Health;
use super::reason::{Code, Level, Reason};
use crate::robot::Model;

/// A cause that leaves more than this share of what the model misses without it, in rms, explains nothing.
///
/// Convention: half; it then accounts for three quarters of the squares.
const MOST_LEFT: f64 = 0.5;

/// The verdict on a model with the cause, by what it leaves and what it left without; `unexplained` says that the cause does not explain all, and `remedy`
/// what to do.
pub(super) fn verdict(without: &Health, left: &Health, model: &Model, unexplained: &str, remedy: &str) -> Verdict {
    let explains = left.missed() < MOST_LEFT * without.missed();
    let of_cause = |reason: Reason| match reason.code {
        Code::GapAboveNoise => Reason {
            level: if explains { reason.level } else { Level::DoNotUse },
            text: format!("{unexplained}, {}", reason.text),
            remedy: remedy.to_owned(),
            ..reason
        },
        _ => reason,
    };
    Verdict::of(left.reasons(model, true, true).into_iter().map(of_cause).collect())
}
