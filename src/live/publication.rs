//! The gate before what live publishes: whether the model as it stands may replace the table in the folder, and whether anything may be
//! commanded by at all.
//!
//! Nothing is published before the first verdict, and nothing under a red one. Between two verdicts the gate itself watches: the encoders, the gap,
//! the last poses, and whether anything is measured at all.
//!
//! Encoders that stand still while the snake moves, a log that contradicts the picture, or a moment's wrong restart of the estimator give
//! an η and λ that fit the last few measurements and nothing else. So the model is judged, as a verdict judges it, on the last poses
//! that the snake took; and nothing is published while it misses them by more than noise or the encoders are stuck. What was published stays
//! then, and is marked stale.

use super::confirmation::Confirmation;
use super::online_estimator::Update;
use super::status::{GapState, PublicationState, PublicationStatus};
use crate::estimate::{NewPoses, PlainSample, Verdict as RowVerdict};
use crate::observation::Status;
use crate::robot::Model;
use crate::verdict::{Code, Level, Subject, Verdict};
use std::collections::VecDeque;
use std::time::Instant;

/// Poses on which the model is judged, each a new one ([`NewPoses`]) after the one before; as many measurements are used before a gap is told.
/// Convention: twice what `discover` needs to decide anything.
pub const POSES: usize = 50;

/// Poses on which a stem that is followed is judged: those before were of another angle, if it moves.
///
/// Convention: half a memory of the usual forgetting.
pub const STEM_POSES: usize = 10;

/// Poses without which nothing is published.
///
/// Convention: three to tell whether the two numbers explain them, and two that may be wrong; a few readings of another moment at nearly one pose
/// agree with each other on a wrong η.
const LEAST_POSES: usize = 5;

/// Measurements rejected in a row, from which on nothing may be commanded by.
///
/// Convention: a hand or a reflection spoils one or two; the estimator begins anew after eight that agree with each other.
const REJECTED: usize = 3;

/// Why a model may not be published.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Withheld {
    /// Red where nothing may be commanded by; amber where the model that was published last still may.
    pub level: Level,
    /// The reason's code, as verdicts name it.
    pub code: Code,
    /// The reason in a sentence.
    pub text: String,
}

/// What the gate decides from.
#[derive(Debug, Clone)]
pub struct PublicationGate {
    sd_encoder_mm: f64,
    /// How many of the last poses the model is judged on.
    most_poses: usize,
    poses: VecDeque<PlainSample>,
    new_poses: NewPoses,
    gap: GapState,
    /// Whether the encoders stand still while the snake moves.
    is_stuck: bool,
    /// How many measurements in a row were rejected, up to the last one.
    rejected: usize,
    /// How often all that was learned was begun anew.
    beginnings: usize,
    /// When frames were measured.
    confirmation: Confirmation,
    /// The last verdict, and when it was passed.
    verdict: Option<(Verdict, Instant)>,
    /// The model that was published last.
    published: Option<Published>,
}

/// A model that was published.
#[derive(Debug, Clone)]
struct Published {
    model: Model,
    at: Instant,
    /// Whether a verdict has found it good since, or an earlier run left it.
    was_good: bool,
}

impl PublicationGate {
    /// A gate for readings of this standard deviation, mm, that judges on so many of the last poses; `published` is what stands there.
    pub fn new(sd_encoder_mm: f64, most_poses: usize, published: Option<Model>) -> Self {
        let published = published.map(|model| Published { model, at: Instant::now(), was_good: true });
        let (poses, new_poses, gap) = (VecDeque::new(), NewPoses::default(), GapState::Unknown);
        let confirmation = Confirmation::default();
        Self {
            sd_encoder_mm,
            most_poses,
            poses,
            new_poses,
            gap,
            is_stuck: false,
            rejected: 0,
            beginnings: 0,
            confirmation,
            verdict: None,
            published,
        }
    }

    /// Takes the verdict on what was measured so far.
    pub fn take_verdict(&mut self, verdict: Verdict) {
        if let Some(published) = &mut self.published {
            published.was_good |= verdict.level == Level::Good;
        }
        self.verdict = Some((verdict, Instant::now()));
    }

    /// Whether the encoders are found to stand still while the snake moves.
    pub fn is_stuck(&self) -> bool {
        self.is_stuck
    }

    /// The last verdict, and its age in seconds.
    pub fn verdict(&self) -> Option<(&Verdict, f64)> {
        self.verdict.as_ref().map(|(verdict, at)| (verdict, at.elapsed().as_secs_f64()))
    }

    /// All that was learned is begun anew, as the user or the measurements ask: the last poses and the verdict were those of another robot, and what
    /// was published for it is no longer the last good one.
    pub fn begin_anew(&mut self) {
        self.verdict = None;
        self.poses.clear();
        self.rejected = 0;
        self.beginnings += 1;
        if let Some(published) = &mut self.published {
            published.was_good = false;
        }
    }

    /// How often that was.
    pub fn beginnings(&self) -> usize {
        self.beginnings
    }

    /// Notes that a frame came now, and whether its measurement has a reading that could be used.
    pub fn confirm(&mut self, status: &Status, is_sample: bool) {
        self.confirmation.add(Instant::now(), status, is_sample);
    }

    /// Notes the end of the run, after which nothing is expected.
    pub fn end(&mut self) {
        self.confirmation.end(Instant::now());
    }

    /// Takes what one measurement did.
    pub fn add(&mut self, update: &Update) {
        (self.gap, self.is_stuck) = (update.gap.state, update.is_stuck);
        if update.step.restarted {
            self.begin_anew();
        }
        self.rejected = match update.step.verdict {
            RowVerdict::Rejected => self.rejected + 1,
            RowVerdict::Used => 0,
            RowVerdict::Skipped => self.rejected,
        };
        let Some(sample) = update.sample else { return };
        if self.is_stuck {
            // Nor those before it was found out.
            self.poses.retain(|pose| pose.q_mm != sample.q_mm);
            return;
        }
        if self.new_poses.is_new(sample.measured.configuration.bend_vector()) {
            if self.poses.len() == self.most_poses {
                self.poses.pop_front();
            }
            self.poses.push_back(sample);
        }
    }

    /// The model that was published last, and how many seconds ago.
    pub fn published(&self) -> Option<(&Model, f64)> {
        self.published.as_ref().map(|published| (&published.model, published.at.elapsed().as_secs_f64()))
    }

    /// The same, if a verdict has found it good: what was never good is not the last good one.
    pub fn last_good(&self) -> Option<(&Model, f64)> {
        self.published().filter(|_| self.published.as_ref().is_some_and(|published| published.was_good))
    }

    /// Notes that a model was published.
    pub fn publish(&mut self, model: Model) {
        let was_good = self.verdict.as_ref().is_some_and(|(verdict, _)| verdict.level == Level::Good);
        self.published = Some(Published { model, at: Instant::now(), was_good });
    }

    /// Whether a model may be published; why not, if it may not.
    ///
    /// # Errors
    /// The reason.
    pub fn judge(&self, model: &Model) -> Result<(), Withheld> {
        let withheld = |level, code, text: String| Err(Withheld { level, code, text });
        let red = |code, text: String| withheld(Level::DoNotUse, code, text);
        if self.is_stuck {
            return red(Code::EncoderStuck, "the encoders stand still while the snake moves".into());
        }
        if self.rejected >= REJECTED {
            let text = format!("the last {} measurements contradict what was learned before", self.rejected);
            return red(Code::ManyRejected, text);
        }
        let Some((verdict, _)) = &self.verdict else {
            return red(Code::WorkspaceNotCovered, "no verdict was passed yet".into());
        };
        if let Some(worst) = verdict.reasons.first().filter(|worst| worst.level == Level::DoNotUse) {
            return red(worst.code, worst.text.clone());
        }
        if let Some(why) = model.estimate().and_then(|estimate| estimate.implausible()) {
            return red(Code::ParameterOutOfRange, why);
        }
        if let Some((code, text)) = self.confirmation.doubt(Instant::now()) {
            return withheld(Level::Look, code, text);
        }
        if self.gap == GapState::Above {
            let text = "the model leaves more of the measurements than their noise";
            return withheld(Level::Look, Code::GapAboveNoise, text.into());
        }
        if self.poses.len() < LEAST_POSES {
            let text = format!("{} poses were measured with a reading, and {LEAST_POSES} are needed", self.poses.len());
            return withheld(Level::Look, Code::WorkspaceNotCovered, text);
        }
        match Subject::new(model, self.sd_encoder_mm).missed_bends(&Vec::from_iter(self.poses.iter().copied())) {
            Some(missed) => withheld(missed.level, missed.code, format!("of the last poses: {}", missed.text)),
            None => Ok(()),
        }
    }

    /// What is to be shown of a decision.
    pub fn status(&self, decided: &Result<(), Withheld>) -> PublicationStatus {
        let (state, why) = match (decided, &self.published) {
            (Ok(()), None) => (PublicationState::Nothing, None),
            (Ok(()), Some(_)) => (PublicationState::Current, None),
            (Err(why), None) => (PublicationState::Withheld, Some(why)),
            (Err(why), Some(_)) => (PublicationState::Stale, Some(why)),
        };
        PublicationStatus {
            state,
            level: why.map(|why| why.level),
            code: why.map(|why| why.code),
            reason: why.map(|why| why.text.clone()),
        }
    }
}

#[cfg(test)]
mod tests;
