//! The verdict as a value: its level, its reasons, and what to do about them.

use crate::observation::Wiring;
use serde::Serialize;
use std::fmt;

/// Whether a result can be relied on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// Nothing speaks against it.
    #[default]
    Good,
    /// It may be right; a person should look at the reasons first.
    Look,
    /// It is wrong, or nothing says that it is right.
    DoNotUse,
}

impl fmt::Display for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Good => "good",
            Self::Look => "look at this",
            Self::DoNotUse => "do not use",
        })
    }
}

/// What kind of reason. The words of files and JSON are these in snake_case. Of reasons of one level, those further up come first: each
/// may be the cause of those below it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Code {
    /// A file or a row is missing, or cannot be read (`check`).
    Files,
    /// There is not one frame, or not one reading.
    NothingToJudge,
    /// A recording breaks off, or has messages that cannot be read.
    RecordingDamaged,
    /// Two sources say different things of one index or one moment.
    ContradictoryReadings,
    /// An encoder's readings stand still, or one's stand in two columns.
    EncoderStuck,
    /// Another order, sign, unit or numbering of the readings explains the bends far better.
    Wiring,
    /// The pictures stand still while the readings move.
    CameraStuck,
    /// From some frame on all readings are larger or smaller by one step: encoders or actuators were homed anew.
    Rehomed,
    /// One encoder or actuator moves more or less than it says, which accounts for the gap.
    EncoderScale,
    /// Time stamps run backwards, or the encoders' clock is not the frames'.
    Clock,
    /// Times are in another unit than seconds.
    TimeUnit,
    /// The camera or the base moved since the straight picture.
    RigDrift,
    /// The printed sheet bows, waves or is stretched by more than paper and printers do.
    SheetNotFlat,
    /// The gap has the form that a wrong camera file gives it.
    CameraLens,
    /// Frames could not be measured, more than disturbances account for.
    ManyNotMeasured,
    /// The readings do not show the force that the backbones are said to share.
    ForceLimits,
    /// η or λ lies where no such robot is.
    ParameterOutOfRange,
    /// The naive model (η = 1, λ = 0) explains the measurements better.
    WorseThanNaive,
    /// Measurements contradict the model, more than disturbances account for.
    ManyRejected,
    /// The model leaves more than the measurements' noise.
    GapAboveNoise,
    /// The poses leave open what the table needs to know.
    WorkspaceNotCovered,
    /// It was right once, and what was measured since does not confirm it.
    Stale,
}

impl Code {
    /// Every kind of reason.
    pub const ALL: [Self; 22] = [
        Self::Files,
        Self::NothingToJudge,
        Self::RecordingDamaged,
        Self::ContradictoryReadings,
        Self::EncoderStuck,
        Self::Wiring,
        Self::CameraStuck,
        Self::Rehomed,
        Self::EncoderScale,
        Self::Clock,
        Self::TimeUnit,
        Self::RigDrift,
        Self::SheetNotFlat,
        Self::CameraLens,
        Self::ManyNotMeasured,
        Self::ForceLimits,
        Self::ParameterOutOfRange,
        Self::WorseThanNaive,
        Self::ManyRejected,
        Self::GapAboveNoise,
        Self::WorkspaceNotCovered,
        Self::Stale,
    ];
}

/// How a mistake would be written down, for machines.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Suggestion {
    /// How the log is to be read.
    #[serde(flatten)]
    pub wiring: Wiring,
    /// Seconds to be added to the log's time stamps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clock_offset_s: Option<f64>,
    /// The view whose azimuth is wrong.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub view: Option<String>,
    /// That view's `delta_offset_deg` as it should be; where the present one is not known, what is to be added to it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub delta_offset_deg: Option<f64>,
    /// Whether the pictures are mirrored.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub mirrored: bool,
}

impl Suggestion {
    /// The lines of experiment.toml that say how the log is to be read; none where it is read rightly.
    fn to_paste(&self) -> Vec<String> {
        let Wiring { columns, signs, scale, index_shift } = &self.wiring;
        if self.wiring.is_straight() {
            return Vec::new();
        }
        let lines = [
            "[wiring]".to_owned(),
            format!("columns = {columns:?}"),
            format!("signs = {signs:?}"),
            format!("scale = {scale:?}"),
            format!("index_shift = {index_shift}"),
        ];
        lines.into()
    }
}

/// One reason of a verdict.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reason {
    /// What kind.
    pub code: Code,
    /// What the verdict is for this reason alone.
    pub level: Level,
    /// What is seen, in a sentence with its figures.
    pub text: String,
    /// What to do next.
    pub remedy: String,
    /// The mistake's correction, where there is one that can be written down.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub suggestion: Option<Suggestion>,
    /// The backbone that is meant, from 1, where it is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub backbone: Option<usize>,
    /// What this backbone's readings are to be multiplied by, where their scale is wrong.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<f64>,
}

impl Reason {
    /// A reason without a suggestion.
    pub fn new(code: Code, level: Level, text: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { code, level, text: text.into(), remedy: remedy.into(), suggestion: None, backbone: None, scale: None }
    }
}

/// Whether a result can be relied on, and why not.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Verdict {
    /// The worst of the reasons' levels.
    pub level: Level,
    /// The worst first.
    pub reasons: Vec<Reason>,
}

impl Verdict {
    /// That of these reasons: ranked by level, and within a level by what may be the cause of what.
    pub fn of(mut reasons: Vec<Reason>) -> Self {
        reasons.sort_by_key(|reason| (std::cmp::Reverse(reason.level), reason.code));
        Self { level: reasons.first().map_or(Level::Good, |reason| reason.level), reasons }
    }

    /// The verdict with one more reason.
    pub fn and(self, reason: Reason) -> Self {
        let mut reasons = self.reasons;
        reasons.push(reason);
        Self::of(reasons)
    }

    /// Why what was judged must not be used, if that is so.
    pub fn why_not(&self) -> Option<&str> {
        self.reasons.first().filter(|worst| worst.level == Level::DoNotUse).map(|worst| worst.text.as_str())
    }

    /// Whether there is a reason of a kind.
    pub fn has(&self, code: Code) -> bool {
        self.reasons.iter().any(|reason| reason.code == code)
    }

    /// Lines for people: the level, and under it each reason with its remedy and what to paste into experiment.toml.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = vec![format!("verdict: {}", self.level)];
        for Reason { text, remedy, suggestion, .. } in &self.reasons {
            lines.push(format!("  - {text}"));
            lines.push(format!("    → {remedy}"));
            lines.extend(suggestion.iter().flat_map(Suggestion::to_paste).map(|line| format!("      {line}")));
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reason(code: Code, level: Level) -> Reason {
        Reason::new(code, level, "seen", "do")
    }

    #[test]
    fn the_worst_reason_comes_first_and_is_the_level() {
        assert_eq!(Verdict::of(vec![]).level, Level::Good);
        let verdict = Verdict::of(vec![reason(Code::GapAboveNoise, Level::Look), reason(Code::Clock, Level::Look)]);
        assert_eq!((verdict.level, verdict.reasons[0].code), (Level::Look, Code::Clock));
        let verdict = verdict.and(reason(Code::WorseThanNaive, Level::DoNotUse));
        assert_eq!((verdict.level, verdict.reasons[0].code), (Level::DoNotUse, Code::WorseThanNaive));
        assert_eq!(verdict.lines()[..3], ["verdict: do not use", "  - seen", "    → do"]);
    }

    #[test]
    fn the_json_is_that_of_the_contract() {
        let mut wiring = reason(Code::Wiring, Level::DoNotUse);
        let swapped = Wiring { columns: vec![1, 3, 2], ..Wiring::straight(3) };
        let (clock_offset_s, view, delta_offset_deg) = (None, None, None);
        wiring.suggestion =
            Some(Suggestion { wiring: swapped, clock_offset_s, view, delta_offset_deg, mirrored: false });
        let expected = serde_json::json!({"level": "do_not_use", "reasons": [{
            "code": "wiring", "level": "do_not_use", "text": "seen", "remedy": "do",
            "suggestion": {"columns": [1, 3, 2], "signs": [1, 1, 1], "scale": 1.0, "index_shift": 0},
        }]});
        assert_eq!(serde_json::to_value(Verdict::of(vec![wiring])).unwrap(), expected);
    }
}
