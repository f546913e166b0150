//! The state that the threads of `live` share. Whoever reads it takes a copy, so that nobody holds the lock for long.

use super::latency::Histogram;
use super::publication::{PublicationGate, Withheld};
use super::status::{Row, State};
use crate::estimate::Verdict as RowVerdict;
use crate::observation::Measurement;
use crate::robot::Model;
use crate::verdict::{Level, Verdict};
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Rows kept for `GET /api/measurements`: 200 s of 60 frames/s. Convention: a resource limit.
const MAX_ROWS: usize = 12_000;
/// Notices kept. Convention: a display choice.
const MAX_NOTICES: usize = 20;

/// The shared state behind its lock.
#[derive(Debug)]
pub struct SharedState(Mutex<LiveState>);

/// All that is shared.
#[derive(Debug)]
pub struct LiveState {
    /// What `GET /api/state` gives.
    pub state: State,
    /// The model with the latest estimate.
    pub model: Model,
    /// The latest rows, oldest first.
    rows: VecDeque<Row>,
    /// How many notices there were; the last of them are in the state.
    notices: u64,
    /// All latencies.
    pub latencies: Histogram,
    /// Number of frames by their status.
    pub by_status: BTreeMap<String, u64>,
    /// Whether the model may be published, and what was.
    pub gate: PublicationGate,
}

/// A model that may be commanded by, and what it is worth.
#[derive(Debug, Clone)]
pub struct Commanding {
    /// The model.
    pub model: Model,
    /// The last verdict.
    pub verdict: Verdict,
    /// Seconds since the model was confirmed: since the verdict, or since it was published where what came since does not confirm it.
    pub age_s: f64,
}

impl LiveState {
    /// Adds a measurement that was made now.
    pub fn add(&mut self, measurement: &Measurement, verdict: RowVerdict, row: Row) {
        self.count(measurement, verdict);
        self.latencies.add(row.latency_ms / 1000.0);
        self.state.latency = self.latencies.status(row.latency_ms);
        self.state.estimate = row.estimate;
        self.state.stem = row.stem;
        self.state.latest = Some(row.clone());
        if self.rows.len() == MAX_ROWS {
            self.rows.pop_front();
        }
        self.rows.push_back(row);
    }

    /// Counts a measurement, made now or taken over from an earlier run.
    pub fn count(&mut self, measurement: &Measurement, verdict: RowVerdict) {
        self.state.measurements += 1;
        self.state.measured += u64::from(measurement.measured.is_some());
        self.state.rejected += u64::from(verdict == RowVerdict::Rejected);
        *self.by_status.entry(measurement.status.to_string()).or_default() += 1;
    }

    /// Adds a message for the user; the same message only once in a row.
    pub fn notice(&mut self, text: impl Into<String>) {
        let text = text.into();
        if self.state.notices.last() == Some(&text) {
            return;
        }
        if self.state.notices.len() == MAX_NOTICES {
            self.state.notices.remove(0);
        }
        self.state.notices.push(text);
        self.notices += 1;
    }

    /// The notices after the first `seen` ones, as far as they are kept, and how many there were in all.
    pub fn notices_after(&self, seen: u64) -> (Vec<String>, u64) {
        let new = usize::try_from(self.notices.saturating_sub(seen)).unwrap_or(usize::MAX);
        let kept = &self.state.notices;
        (kept[kept.len().saturating_sub(new)..].to_vec(), self.notices)
    }
}

impl SharedState {
    /// The state at the start of a run.
    pub fn new(state: State, model: Model, gate: PublicationGate) -> Self {
        Self(Mutex::new(LiveState {
            state,
            model,
            rows: VecDeque::new(),
            notices: 0,
            latencies: Histogram::default(),
            by_status: BTreeMap::new(),
            gate,
        }))
    }

    /// Locks it; to be held for moments only.
    pub fn lock(&self) -> MutexGuard<'_, LiveState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The model to command by, if there is one, and whether the one as it stands may be published: the one as it stands if it may; the one
    /// published last if the reason is amber and a verdict has found that one good; none under a red one.
    pub fn model_to_command_by(&self) -> (Option<Commanding>, Result<(), Withheld>) {
        let (model, gate) = {
            let shared = self.lock();
            (shared.model.clone(), shared.gate.clone())
        };
        let decided = gate.judge(&model);
        let verdict = |gate: &PublicationGate| gate.verdict().map(|(verdict, age_s)| (verdict.clone(), age_s));
        let commanding = verdict(&gate).and_then(|(verdict, age_s)| match &decided {
            Ok(()) => Some(Commanding { model, verdict, age_s }),
            Err(why) if why.level == Level::DoNotUse => None,
            Err(_) => gate.last_good().map(|(model, age_s)| Commanding { model: model.clone(), verdict, age_s }),
        });
        (commanding, decided)
    }

    /// The model to command by, with what was learned, and why it is stale, if it is.
    ///
    /// # Errors
    /// Why nothing may be commanded by, in words.
    pub fn to_command_by(&self) -> Result<(Commanding, Option<String>), String> {
        let (commanding, decided) = self.model_to_command_by();
        let is_amber = decided.as_ref().is_err_and(|why| why.level == Level::Look);
        let stale = decided.err().map(|why| why.text);
        let never_good = match is_amber && self.lock().gate.published().is_some() {
            true => "; what was published before was never found good",
            false => "",
        };
        let why = || format!("nothing may be commanded by: {}{never_good}", stale.as_deref().unwrap_or_default());
        let commanding = commanding.ok_or_else(why)?;
        if commanding.model.estimate().is_none() {
            return Err("nothing may be commanded by: η and λ are not known yet".into());
        }
        Ok((commanding, stale))
    }

    /// A copy of what `GET /api/state` gives.
    pub fn state(&self) -> State {
        self.lock().state.clone()
    }

    /// Rows after an index, oldest first, at most `limit`; without an index from the oldest that is kept.
    pub fn rows_after(&self, index: Option<u64>, limit: usize) -> Vec<Row> {
        let shared = self.lock();
        let from = index.map_or(0, |index| shared.rows.partition_point(|row| row.index <= index));
        shared.rows.range(from..).take(limit).cloned().collect()
    }

    /// The latest rows, oldest first, at most `limit`.
    pub fn latest_rows(&self, limit: usize) -> Vec<Row> {
        let shared = self.lock();
        shared.rows.range(shared.rows.len().saturating_sub(limit)..).cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::publication::POSES;
    use crate::live::status::EncoderStatus;
    use crate::observation::Status;

    fn shared() -> SharedState {
        let state = State::at_start("camera 0".into(), EncoderStatus::at_rest("none", 0));
        SharedState::new(state, Model::default(), PublicationGate::new(0.0015, POSES, None))
    }

    fn add(shared: &SharedState, index: u64, status: Status, verdict: RowVerdict) {
        let measurement = Measurement { index, time_s: None, status, measured: None, quality: None, view: None };
        shared.lock().add(&measurement, verdict, Row::of(&measurement, 0.0));
    }

    #[test]
    fn the_latest_rows_are_kept_and_found_by_their_index() {
        let shared = shared();
        for index in 0..MAX_ROWS as u64 + 5 {
            add(&shared, index, Status::Ok, RowVerdict::Used);
        }
        let indices_of = |rows: Vec<Row>| rows.iter().map(|row| row.index).collect::<Vec<_>>();
        let indices = |after, limit| indices_of(shared.rows_after(after, limit));
        assert_eq!(indices_of(shared.latest_rows(3)), [12_002, 12_003, 12_004]);
        assert_eq!(indices(None, 2), [5, 6]);
        assert_eq!(indices(Some(0), 2), [5, 6], "the first five made room");
        assert_eq!(indices(Some(12_003), 10), [12_004]);
        assert!(indices(Some(12_004), 10).is_empty());
    }

    #[test]
    fn measurements_are_counted_by_status_and_verdict() {
        let shared = shared();
        add(&shared, 0, Status::NoSnake, RowVerdict::Skipped);
        add(&shared, 1, Status::Ok, RowVerdict::Rejected);
        add(&shared, 2, Status::NoSnake, RowVerdict::Skipped);
        let locked = shared.lock();
        assert_eq!((locked.state.measurements, locked.state.rejected), (3, 1));
        assert_eq!(locked.by_status["no_snake"], 2);
    }

    #[test]
    fn a_notice_is_not_repeated_and_the_oldest_make_room() {
        let shared = shared();
        let mut locked = shared.lock();
        locked.notice("same");
        locked.notice("same");
        assert_eq!(locked.state.notices.len(), 1);
        (0..30).for_each(|k| locked.notice(format!("notice {k}")));
        assert_eq!(locked.state.notices.len(), MAX_NOTICES);
        assert_eq!(locked.state.notices[0], "notice 10");
        assert_eq!(locked.notices_after(29), (vec!["notice 28".to_owned(), "notice 29".to_owned()], 31));
        assert_eq!((locked.notices_after(31).0.len(), locked.notices_after(0).0.len()), (0, MAX_NOTICES));
    }
}
