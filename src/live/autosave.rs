//! A thread that writes while the loop runs: model and table every so often, the journal to the disk every second.

use super::clock::unix_time_s;
use super::encoders::Encoders;
use super::low_priority::lower_priority;
use super::publication::Withheld;
use super::recent_bends::RecentBends;
use super::shared_state::{Commanding, SharedState};
use super::status::{PublicationState, PublicationStatus};
use crate::error::{DataError, Error, Result};
use crate::record::line_file::LineFile;
use crate::record::{
    Provenance, Worth, compensation_files, learned_model_toml, mark_stale, unmark_stale, write_atomically,
    write_together,
};
use crate::robot::PerBackbone;
use nalgebra::Vector2;
use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tracing::info;

/// How often the journal is brought to the disk. Convention: what a loss of power may cost.
const SYNC_EVERY: Duration = Duration::from_secs(1);
/// The lag between picture and encoders is estimated once in so many syncs. Convention: it changes slowly.
const SYNCS_PER_LAG: u32 = 5;

/// The file that tells whether the table beside it is the model's as it stands.
pub const PUBLICATION: &str = "publication.json";

/// The file that has every notice with its Unix time, s.
const LOG: &str = "live.log";
/// Nothing is appended to a larger log, bytes. Convention: a resource limit, some hundred thousand notices.
const LOG_BYTES: u64 = 16 << 20;

/// The thread that writes.
#[derive(Debug)]
pub struct AutosaveThread {
    thread: JoinHandle<()>,
    stop: Sender<()>,
}

/// What it needs.
pub struct Autosave {
    /// Where the model is.
    pub shared: Arc<SharedState>,
    /// The journal, to be brought to the disk.
    pub journal: LineFile,
    /// The folder to write to.
    pub output: PathBuf,
    /// How often model and table are written.
    pub every: Duration,
    /// The encoders, whose lag is estimated.
    pub encoders: Arc<Encoders>,
    /// The bends that the lag is estimated from.
    pub bends: Arc<RecentBends>,
    /// Q⁺, by columns: bend vectors from readings.
    pub to_bend: PerBackbone<Vector2<f64>>,
}

impl AutosaveThread {
    /// Starts it.
    pub fn start(autosave: Autosave) -> Self {
        let (stop, stopped) = channel();
        let thread = std::thread::spawn(move || {
            lower_priority();
            autosave.run(&stopped);
        });
        Self { thread, stop }
    }

    /// Ends it once what it is writing is written.
    pub fn finish(self) {
        drop(self.stop);
        let _ = self.thread.join();
    }
}

impl Autosave {
    fn run(&self, stopped: &Receiver<()>) {
        let mut saved = Instant::now();
        let (mut syncs, mut logged) = (0, 0);
        while stopped.recv_timeout(SYNC_EVERY) == Err(RecvTimeoutError::Timeout) {
            syncs += 1;
            self.log(&mut logged);
            if let Err(error) = self.journal.sync() {
                self.shared.lock().notice(format!("the journal cannot be brought to the disk: {error}"));
            }
            if syncs % SYNCS_PER_LAG == 0 {
                self.encoders.estimate_lag(&self.bends.copy(), &self.to_bend);
            }
            let (is_known, is_stuck) = {
                let shared = self.shared.lock();
                (shared.model.estimate().is_some(), shared.gate.is_stuck())
            };
            if !is_known && !is_stuck {
                continue;
            }
            let written = if is_known && saved.elapsed() >= self.every {
                saved = Instant::now();
                save(&self.shared, &self.output).map(|_| ())
            } else {
                review(&self.shared, &self.output)
            };
            if let Err(error) = written {
                self.shared.lock().notice(error.to_string());
            }
        }
        self.log(&mut logged);
        let _ = self.journal.sync();
    }
}

impl Autosave {
    /// Appends the notices that were not logged yet to the log, which nobody need watch; a log that cannot be written is no reason to stop.
    fn log(&self, logged: &mut u64) {
        let (notices, all) = self.shared.lock().notices_after(*logged);
        if notices.is_empty() {
            return;
        }
        let path = self.output.join(LOG);
        let mut lines = String::new();
        if std::fs::metadata(&path).map_or(0, |about| about.len()) < LOG_BYTES {
            notices.iter().for_each(|notice| lines += &format!("{:.3} {notice}\n", unix_time_s()));
        }
        let opened = OpenOptions::new().append(true).create(true).open(&path);
        if opened.and_then(|mut log| log.write_all(lines.as_bytes())).is_ok() {
            *logged = all;
        }
    }
}

/// Writes model.toml, compensation.csv and compensation.json, if the model may be published, and says why not if it may not.
///
/// # Errors
/// No estimate yet; a file that cannot be written.
pub fn save(shared: &SharedState, output: &Path) -> Result<std::result::Result<(), Withheld>> {
    let (commanding, decided) = shared.model_to_command_by();
    if let (Ok(()), Some(Commanding { model, verdict, .. })) = (&decided, commanding) {
        if model.estimate().is_none() {
            return Err(DataError::NoEstimateYet.into());
        }
        let path = output.join("model.toml");
        let (mut files, _) = compensation_files(output, &model, &path.display().to_string(), Worth::of(&verdict))?;
        files.push((path.clone(), learned_model_toml(&model, Some(&verdict), &Provenance::new("live"))?));
        write_together(&files)?;
        info!(path = %path.display(), verdict = %verdict.level, "model and table written");
        let mut shared = shared.lock();
        shared.state.saved_at_s = Some(unix_time_s());
        shared.gate.publish(model);
    }
    tell(shared, output, &decided)?;
    Ok(decided)
}

/// Looks whether the table that stands there still may.
///
/// # Errors
/// A file that cannot be written.
fn review(shared: &SharedState, output: &Path) -> Result<()> {
    let (_, decided) = shared.model_to_command_by();
    tell(shared, output, &decided)
}

/// Brings the mark in the files, publication.json, the state and the notices up to date with what was decided.
fn tell(shared: &SharedState, output: &Path, decided: &std::result::Result<(), Withheld>) -> Result<()> {
    let (status, former) = {
        let shared = shared.lock();
        (shared.gate.status(decided), shared.state.publication.clone())
    };
    if (status.state, status.code) == (former.state, former.code) {
        shared.lock().state.publication = status;
        return Ok(());
    }
    let reason = status.reason.as_deref().unwrap_or_default();
    let written = write_status(output, &status, reason);
    let said = match status.state {
        PublicationState::Stale => Some(format!("the table in the folder is stale and stays as it is: {reason}")),
        PublicationState::Withheld => Some(format!("no table is written: {reason}")),
        PublicationState::Current if former.code.is_some() => Some("the table is written again".to_owned()),
        PublicationState::Current | PublicationState::Nothing => None,
    };
    let mut shared = shared.lock();
    if let Some(said) = said {
        shared.notice(said);
    }
    shared.state.publication = status;
    written
}

/// Marks the table that stands in the folder as stale, or takes the mark away, and writes publication.json.
fn write_status(output: &Path, status: &PublicationStatus, reason: &str) -> Result<()> {
    match status.state {
        PublicationState::Stale => mark_stale(output, reason)?,
        PublicationState::Current => unmark_stale(output)?,
        PublicationState::Nothing | PublicationState::Withheld => {}
    }
    let json = serde_json::to_string_pretty(status).map_err(Error::encode("publication.json"))?;
    write_atomically(&output.join(PUBLICATION), (json + "\n").as_bytes())
}
