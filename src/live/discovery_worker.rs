//! Runs `discover` on the samples so far, on a thread of low priority.

use super::bank_worker::{SharedBank, sentence as sentence_of_structures};
use super::low_priority::on_one_thread;
use super::shared_state::SharedState;
use super::status::DiscoveryStatus;
use crate::Result;
use crate::discover::{Bank, Data, Discovery, Verdict, discover_in_frames};
use crate::observation::{EncoderReading, Measurement};
use crate::record::{Provenance, learned_model_toml, write_atomically};
use crate::report::discovery::sentence;
use crate::robot::Model;
use crate::verdict::{Reason, Subject};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

/// After an answer `discover` is not started for this time. Convention: a resource limit.
const REST: Duration = Duration::from_secs(60);

/// Starts `discover` when it is asked to, one search at a time.
#[derive(Debug)]
pub struct DiscoveryWorker {
    shared: Arc<SharedState>,
    output: PathBuf,
    sd_encoder_mm: f64,
    bank: SharedBank,
    at_work: Arc<AtomicBool>,
    last: Option<Instant>,
}

impl DiscoveryWorker {
    /// A worker that writes discrepancy.json and discovered.toml into a folder, and puts there the bank of the structures left open.
    pub fn new(shared: Arc<SharedState>, output: PathBuf, sd_encoder_mm: f64, bank: SharedBank) -> Self {
        Self { shared, output, sd_encoder_mm, bank, at_work: Arc::default(), last: None }
    }

    /// Whether it can be started: it is not at work, and has rested.
    pub fn is_free(&self) -> bool {
        !self.at_work.load(Ordering::Relaxed) && self.last.is_none_or(|last| last.elapsed() > REST)
    }

    /// Starts a search from a model on measurements and their readings; the answer goes into the shared state.
    pub fn start(&mut self, (model, measurements, readings): (Model, Vec<Measurement>, Vec<EncoderReading>)) {
        self.last = Some(Instant::now());
        self.at_work.store(true, Ordering::Relaxed);
        match &mut self.shared.lock().state.discovery {
            Some(discovery) => discovery.running = true,
            none => {
                let sentence = "discover is looking at what was measured so far".into();
                *none = Some(DiscoveryStatus { running: true, sentence, ..DiscoveryStatus::default() });
            }
        }
        let (shared, output, sd_encoder_mm) = (Arc::clone(&self.shared), self.output.clone(), self.sd_encoder_mm);
        let (at_work, bank) = (Arc::clone(&self.at_work), Arc::clone(&self.bank));
        std::thread::spawn(move || {
            if let Some(mistake) = Subject::new(&model, sd_encoder_mm).wiring_mistake(&measurements, &readings) {
                shared.lock().state.discovery = Some(nothing_named(&mistake));
                at_work.store(false, Ordering::Relaxed);
                return;
            }
            let found = on_one_thread(|| -> Result<(Discovery, Option<Bank>)> {
                let data = Data::new(&measurements, &readings, sd_encoder_mm)?;
                let found = discover_in_frames(model, &data, &|_| ());
                write(&output, &found)?;
                let bank = Bank::new(&found, &data);
                Ok((found, bank))
            });
            let mut bank = bank.lock().unwrap_or_else(PoisonError::into_inner);
            shared.lock().state.discovery = Some(status(&found));
            *bank = found.ok().and_then(|(_, bank)| bank);
            at_work.store(false, Ordering::Relaxed);
        });
    }
}

/// No physics is named of a log that is wired otherwise than it is read.
fn nothing_named(mistake: &Reason) -> DiscoveryStatus {
    DiscoveryStatus {
        verdict: Verdict::Unexplained.word().into(),
        sentence: format!("no physics is named of these data: {}; {}", mistake.text, mistake.remedy),
        ..DiscoveryStatus::default()
    }
}

fn status(found: &Result<(Discovery, Option<Bank>)>) -> DiscoveryStatus {
    match found {
        Ok((found, bank)) => {
            let structures = bank.as_ref().map(Bank::structures).unwrap_or_default();
            DiscoveryStatus {
                running: false,
                verdict: found.verdict.word().into(),
                sentence: sentence(found),
                details: Some(found.json()),
                followed: bank.as_ref().map(|bank| sentence_of_structures(&structures, bank.index())),
                structures,
            }
        }
        Err(error) => {
            DiscoveryStatus { sentence: format!("discover has no answer yet: {error}"), ..DiscoveryStatus::default() }
        }
    }
}

fn write(output: &Path, found: &Discovery) -> Result<()> {
    write_atomically(&output.join("discrepancy.json"), format!("{:#}\n", found.json()).as_bytes())?;
    if found.verdict.has_effects() {
        let text = learned_model_toml(&found.model, None, &Provenance::new("live"))?;
        write_atomically(&output.join("discovered.toml"), text.as_bytes())?;
    }
    Ok(())
}
