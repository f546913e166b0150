//! What is written while the loop runs: model and table every so often, the journal to the disk every second.

use super::board::Board;
use super::encoders::Encoders;
use super::quiet::be_quiet;
use super::source::unix_time_s;
use crate::error::{Error, Result};
use crate::record::{write_compensation, write_model};
use crate::robot::{Grid, PerBackbone};
use nalgebra::Vector2;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How often the journal is brought to the disk, and the lag between picture and encoders looked at.
const SYNC_EVERY: Duration = Duration::from_secs(1);
const LAG_EVERY: u32 = 5;

/// The latest measured bends with their times, for the lag.
pub type Bends = Arc<Mutex<Vec<(f64, Vector2<f64>)>>>;

/// The thread that writes.
#[derive(Debug)]
pub struct Saver {
    thread: JoinHandle<()>,
    stop: Sender<()>,
}

/// What it needs.
pub struct Saving {
    /// Where the model stands.
    pub board: Arc<Board>,
    /// The journal, to be brought to the disk.
    pub journal: File,
    /// Where to write.
    pub output: PathBuf,
    /// How often.
    pub every: Duration,
    /// For the lag between picture and encoders.
    pub encoders: Arc<Encoders>,
    /// See `encoders`.
    pub bends: Bends,
    /// Q⁺, by columns.
    pub to_bend: PerBackbone<Vector2<f64>>,
}

impl Saver {
    /// Starts it.
    pub fn start(saving: Saving) -> Self {
        let (stop, stopped) = channel();
        let thread = std::thread::spawn(move || {
            be_quiet();
            saving.run(&stopped);
        });
        Self { thread, stop }
    }

    /// Ends it once the latest is written.
    pub fn finish(self) {
        drop(self.stop);
        let _ = self.thread.join();
    }
}

impl Saving {
    fn run(&self, stopped: &Receiver<()>) {
        let mut saved = Instant::now();
        let mut ticks = 0;
        while stopped.recv_timeout(SYNC_EVERY) == Err(RecvTimeoutError::Timeout) {
            ticks += 1;
            if let Err(error) = self.journal.sync_data() {
                self.board.lock().notice(format!("the journal cannot be brought to the disk: {error}"));
            }
            if ticks % LAG_EVERY == 0 {
                let bends = self.bends.lock().unwrap_or_else(PoisonError::into_inner).clone();
                self.encoders.estimate_lag(&bends, &self.to_bend);
            }
            if saved.elapsed() >= self.every && self.board.lock().model.estimate.is_some() {
                if let Err(error) = save(&self.board, &self.output) {
                    self.board.lock().notice(error.to_string());
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
pub fn save(board: &Board, output: &Path) -> Result<()> {
    let model = board.lock().model.clone();
    if model.estimate.is_none() {
        return Err(Error::Domain("η and λ are not known yet: no table was written".into()));
    }
    let path = output.join("model.toml");
    write_model(&path, &model)?;
    write_compensation(output, &model, &path.display().to_string(), &Grid::default())?;
    board.lock().state.saved_at_s = Some(unix_time_s());
    Ok(())
}
