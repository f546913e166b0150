//! Whether one cause, a force or the stem's angle, explains what a model misses without it.
//!
//! Whatever the model misses is taken for the cause, be it a slipped encoder or another robot's model. Of what is left alone can be told whether it is
//! one.

use super::reason::{Code, Level, Reason};
use super::{Subject, Verdict};
use crate::observation::{EncoderReading, Measurement};

/// A cause that leaves more than this share of what the model misses without it, in rms, explains nothing.
///
/// Convention: half; it then accounts for three quarters of the squares.
const MOST_LEFT: f64 = 0.5;

/// The verdict on a model with the cause, by what it leaves of some of the measurements and what the model without it does; a mistake of the whole log comes
/// before. `unexplained` says that the cause does not explain all, and `remedy` what to do.
pub(super) fn verdict(
    [without, with]: [&Subject; 2],
    (measurements, readings): (&[Measurement], &[EncoderReading]),
    judged: &[Measurement],
    [unexplained, remedy]: [&str; 2],
) -> Verdict {
    if let Some(mistake) = without.wiring_mistake(measurements, readings) {
        return Verdict::of(vec![mistake]);
    }
    let [before, left] = [without, with].map(|subject| subject.health(judged, readings));
    let explains = left.missed() < MOST_LEFT * before.missed();
    let of_cause = |reason: Reason| match reason.code {
        Code::GapAboveNoise => Reason {
            level: if explains { reason.level } else { Level::DoNotUse },
            text: format!("{unexplained}, {}", reason.text),
            remedy: remedy.to_owned(),
            ..reason
        },
        _ => reason,
    };
    Verdict::of(left.reasons(with.model, true, true).into_iter().map(of_cause).collect())
}
