//! A thread that writes while the loop runs: model and table every so often, the journal to the disk every second.

use super::clock::unix_time_s;
use super::encoders::Encoders;
use super::low_priority::lower_priority;
use super::recent_bends::RecentBends;
use super::shared_state::SharedState;
use crate::error::{DataError, Result};
use crate::record::{write_compensation, write_model};
use crate::robot::{Grid, PerBackbone};
use nalgebra::Vector2;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How often the journal is brought to the disk. Convention: what a loss of power may cost.
const SYNC_EVERY: Duration = Duration::from_secs(1);
/// The lag between picture and encoders is estimated once in so many syncs. Convention: it changes slowly.
const SYNCS_PER_LAG: u32 = 5;

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
    pub journal: File,
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
        let mut syncs = 0;
        while stopped.recv_timeout(SYNC_EVERY) == Err(RecvTimeoutError::Timeout) {
            syncs += 1;
            if let Err(error) = self.journal.sync_data() {
                self.shared.lock().notice(format!("the journal cannot be brought to the disk: {error}"));
            }
            if syncs % SYNCS_PER_LAG == 0 {
                self.encoders.estimate_lag(&self.bends.copy(), &self.to_bend);
            }
            if saved.elapsed() >= self.every && self.shared.lock().model.estimate.is_some() {
                if let Err(error) = save(&self.shared, &self.output) {
                    self.shared.lock().notice(error.to_string());
                }
                saved = Instant::now();
            }
        }
        let _ = self.journal.sync_data();
    }
}

/// Writes model.toml, compensation.csv and compensation.json.
///
/// # Errors
/// No estimate yet; a file that cannot be written.
pub fn save(shared: &SharedState, output: &Path) -> Result<()> {
    let model = shared.lock().model.clone();
    if model.estimate.is_none() {
        return Err(DataError::NoEstimateYet.into());
    }
    let path = output.join("model.toml");
    write_model(&path, &model)?;
    write_compensation(output, &model, &path.display().to_string(), &Grid::default())?;
    shared.lock().state.saved_at_s = Some(unix_time_s());
    Ok(())
}
