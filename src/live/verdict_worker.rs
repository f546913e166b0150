//! Passes the verdict on what was measured so far, on a thread of low priority.

use super::low_priority::lower_priority;
use super::shared_state::SharedState;
use super::status::{PublicationState, PublicationStatus, State, nothing_judged};
use crate::observation::{EncoderReading, Measurement};
use crate::robot::Model;
use crate::verdict::{Code, Level, Reason, Subject, Verdict};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tracing::debug;

/// Time between verdicts, and until the first. Convention: what a fault may go unnoticed at the longest, where nothing else sees it; one verdict
/// takes some tenths of a second.
const EVERY: Duration = Duration::from_secs(2);

/// Passes verdicts, one at a time.
#[derive(Debug)]
pub struct VerdictWorker {
    shared: Arc<SharedState>,
    sd_encoder_mm: f64,
    at_work: Arc<AtomicBool>,
    last: Instant,
}

impl VerdictWorker {
    /// A worker that brings the verdict in the shared state up to date.
    pub fn new(shared: Arc<SharedState>, sd_encoder_mm: f64) -> Self {
        Self { shared, sd_encoder_mm, at_work: Arc::default(), last: Instant::now() }
    }

    /// Whether it is time for another.
    pub fn is_due(&self) -> bool {
        self.last.elapsed() >= EVERY && !self.at_work.load(Ordering::Relaxed)
    }

    /// Starts to judge the model as it stands, by samples of the run.
    pub fn start(&mut self, measurements: Vec<Measurement>, readings: Vec<EncoderReading>) {
        self.last = Instant::now();
        self.at_work.store(true, Ordering::Relaxed);
        let (shared, sd_encoder_mm, at_work) =
            (Arc::clone(&self.shared), self.sd_encoder_mm, Arc::clone(&self.at_work));
        std::thread::spawn(move || {
            lower_priority();
            judge(&shared, sd_encoder_mm, &measurements, &readings);
            at_work.store(false, Ordering::Relaxed);
        });
    }

    /// Judges now.
    pub fn finish(&self, measurements: &[Measurement], readings: &[EncoderReading]) {
        judge(&self.shared, self.sd_encoder_mm, measurements, readings);
    }
}

fn judge(shared: &SharedState, sd_encoder_mm: f64, measurements: &[Measurement], readings: &[EncoderReading]) {
    let (model, beginnings, rejected, measured, latest): (Model, usize, usize, u64, Option<String>) = {
        let shared = shared.lock();
        let State { rejected, measured, latest, .. } = &shared.state;
        let latest = latest.as_ref().map(|row| row.status.clone());
        (shared.model.clone(), shared.gate.beginnings(), *rejected as usize, *measured, latest)
    };
    let used = (measured as usize).saturating_sub(rejected);
    let subject = Subject { used_and_rejected: Some((used, rejected)), ..Subject::new(&model, sd_encoder_mm) };
    let verdict = subject.verdict(measurements, readings);
    let verdict = match measurements.is_empty() {
        true if shared.lock().gate.is_stuck() => {
            let text = "the encoders stand still while the snake moves, and nothing is learned from such readings";
            let remedy = "look at encoders and log: whether zeros, or one reading again and again, are sent in place of what is read";
            Verdict::of(vec![Reason::new(Code::EncoderStuck, Level::DoNotUse, text, remedy)])
        }
        true => nothing_judged(measured, latest.as_deref()),
        false => verdict,
    };
    debug!(verdict = %verdict.level, samples = measurements.len(), "judged");
    let mut shared = shared.lock();
    // A verdict on what was learned before all was begun anew is none on what is learned now.
    if !measurements.is_empty() && shared.gate.beginnings() == beginnings {
        shared.gate.take_verdict(verdict.clone());
    }
    shared.state.verdict = with_publication(verdict, &shared.state.publication);
}

/// The verdict with what keeps the table from being written, and what became of the one that stands there.
fn with_publication(verdict: Verdict, publication: &PublicationStatus) -> Verdict {
    let (Some(code), Some(text)) = (publication.code, &publication.reason) else { return verdict };
    let remedy = "look at encoders and camera; the table is written again once the model explains what is measured";
    // What is red because of the verdict is the verdict's own finding, which is made anew each time.
    let is_told = verdict.has(code) || code == Code::WorkspaceNotCovered;
    let level = publication.level.unwrap_or(Level::Look);
    let verdict = if is_told { verdict } else { verdict.and(Reason::new(code, level, text.clone(), remedy)) };
    if publication.state != PublicationState::Stale || code == Code::Stale {
        return verdict;
    }
    let text = "the table in the folder is the last one published, and is not written anew";
    verdict.and(Reason::new(Code::Stale, Level::Look, text, "command by it with care until it is current again"))
}
