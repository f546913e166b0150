//! `discover`, in the background, on what a run has gathered so far.

use super::board::{Board, DiscoveryStatus};
use super::quiet::alone;
use crate::Result;
use crate::discover::{Data, Discovery, Verdict, discover_in_frames};
use crate::observation::{EncoderReading, Measurement};
use crate::record::{write_atomically, write_model};
use crate::report::discovery::sentence;
use crate::robot::Model;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// After an answer nothing is asked for so long.
const REST: Duration = Duration::from_secs(60);

/// Asks `discover` now and then.
#[derive(Debug)]
pub struct Finder {
    board: Arc<Board>,
    output: PathBuf,
    sd_encoder_mm: f64,
    at_work: Arc<AtomicBool>,
    last: Option<Instant>,
}

impl Finder {
    /// One that writes discrepancy.json and discovered.toml into a folder.
    pub fn new(board: Arc<Board>, output: PathBuf, sd_encoder_mm: f64) -> Self {
        Self { board, output, sd_encoder_mm, at_work: Arc::default(), last: None }
    }

    /// Whether it may be asked: it is not at work, and has rested.
    pub fn is_free(&self) -> bool {
        !self.at_work.load(Ordering::Relaxed) && self.last.is_none_or(|last| last.elapsed() > REST)
    }

    /// Starts to look; the answer comes to the board.
    pub fn look(&mut self, (model, measurements, readings): (Model, Vec<Measurement>, Vec<EncoderReading>)) {
        self.last = Some(Instant::now());
        self.at_work.store(true, Ordering::Relaxed);
        {
            let mut content = self.board.lock();
            match &mut content.state.discovery {
                Some(discovery) => discovery.running = true,
                none => {
                    let sentence = "discover is looking at what was measured so far".into();
                    *none = Some(DiscoveryStatus { running: true, verdict: String::new(), sentence, details: None });
                }
            }
        }
        let (board, output, sd_encoder_mm) = (Arc::clone(&self.board), self.output.clone(), self.sd_encoder_mm);
        let at_work = Arc::clone(&self.at_work);
        std::thread::spawn(move || {
            let found = alone(|| -> Result<Discovery> {
                let data = Data::new(&measurements, &readings, sd_encoder_mm)?;
                let found = discover_in_frames(model, &data)?;
                write(&output, &found)?;
                Ok(found)
            });
            board.lock().state.discovery = Some(match found {
                Ok(found) => DiscoveryStatus {
                    running: false,
                    verdict: found.verdict.word().into(),
                    sentence: sentence(&found),
                    details: Some(found.json()),
                },
                Err(error) => DiscoveryStatus {
                    running: false,
                    verdict: String::new(),
                    sentence: format!("discover has no answer yet: {error}"),
                    details: None,
                },
            });
            at_work.store(false, Ordering::Relaxed);
        });
    }
}

fn write(output: &Path, found: &Discovery) -> Result<()> {
    write_atomically(&output.join("discrepancy.json"), format!("{:#}\n", found.json()).as_bytes())?;
    if found.verdict == Verdict::Named {
        write_model(&output.join("discovered.toml"), &found.model)?;
    }
    Ok(())
}
