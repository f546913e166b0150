//! A running loop: started, asked to end, and waited for.

use super::annotated_video::AnnotatedVideo;
use super::autosave::{Autosave, AutosaveThread};
use super::bank_worker::BankWorker;
use super::clock::FrameClock;
use super::commands::Commands;
use super::discovery_worker::DiscoveryWorker;
use super::final_tables::FinalTables;
use super::journal::{Entry, Journal};
use super::latency::Histogram;
use super::online_estimator::OnlineEstimator;
use super::pipeline::Pipeline;
use super::publication::{POSES, PublicationGate, STEM_POSES};
use super::recent_bends::RecentBends;
use super::setup::{Setup, View};
use super::shared_state::SharedState;
use super::source::FrameReader;
use super::status::{EstimateStatus, State, StemStatus};
use super::straight_reference::RenewableEye;
use super::verdict_worker::VerdictWorker;
use crate::error::{Error, Result};
use crate::record::{mark_stale, read_model, verdict_mark};
use crate::robot::Model;
use crate::verdict::Level;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use tracing::info;

/// A running loop.
pub struct Live {
    /// What it shows.
    pub shared: Arc<SharedState>,
    /// Its annotated video.
    pub video: Arc<AnnotatedVideo>,
    commands: Commands,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Result<()>>,
}

impl Live {
    /// Opens the journal, starts reading, measuring, learning and writing.
    ///
    /// # Errors
    /// A journal that is in the way or cannot be read, an option out of its range, a source that cannot exist.
    pub fn start(setup: Setup) -> Result<Self> {
        let Setup { view, source, source_name, encoders, model, options, stem, folder, resume, save_every } = setup;
        let output = folder.path().to_owned();
        info!(view = %view.name, source = %source_name, output = %output.display(), resume, "live begins");
        // What an earlier run left is not confirmed yet.
        mark_stale(&output, "an earlier run left it, and nothing that was measured since confirms it")?;
        let mut estimator = OnlineEstimator::new(model.clone(), options, stem)?;
        let clock = Arc::new(FrameClock::default());
        let encoders = Arc::new(encoders.open(Arc::clone(&clock)));
        let published = if resume { published_in(&output) } else { None };
        let gate =
            PublicationGate::new(options.sd_encoder_mm, if stem.is_some() { STEM_POSES } else { POSES }, published);
        let shared = Arc::new(SharedState::new(State::at_start(source_name, encoders.status()), model.clone(), gate));
        let mut tables = FinalTables::begin(&output, model.robot.backbone_count(), stem.is_some())?;
        let (journal, next_index) = open_journal(&output, resume, &mut estimator, &mut tables, &shared)?;
        let reader = FrameReader::start(source, next_index, clock, view.lens.clone())?;
        let bends = Arc::new(RecentBends::default());
        let autosave = AutosaveThread::start(Autosave {
            shared: Arc::clone(&shared),
            journal: journal.file.clone(),
            output: output.clone(),
            every: save_every,
            encoders: Arc::clone(&encoders),
            bends: Arc::clone(&bends),
            to_bend: model.robot.bend_by_displacement(),
        });
        let video = AnnotatedVideo::start();
        let (commands, requests) = Commands::channel();
        let stop = Arc::new(AtomicBool::new(false));
        let View { name, lens, robot, rig_options, eye } = view;
        eye.small_picture().into_iter().for_each(|small| shared.lock().notice(format!("view {name}: {small}")));
        let bank = BankWorker::new(Arc::clone(&shared));
        let discovery = DiscoveryWorker::new(Arc::clone(&shared), output.clone(), options.sd_encoder_mm, bank.bank());
        let verdict = VerdictWorker::new(Arc::clone(&shared), options.sd_encoder_mm);
        let eye = Arc::new(RenewableEye::new(eye, lens, robot, rig_options, output.clone()));
        let pipeline = Pipeline {
            view: name,
            eye,
            reader,
            encoders,
            estimator,
            journal,
            tables,
            shared: Arc::clone(&shared),
            video: Arc::clone(&video),
            discovery,
            bank,
            verdict,
            requests,
            stop: Arc::clone(&stop),
            folder,
            output,
            bends,
        };
        let thread = std::thread::spawn(move || {
            let result = pipeline.run();
            autosave.finish();
            result
        });
        Ok(Self { shared, video, commands, stop, thread })
    }

    /// A handle to tell it something.
    pub fn commands(&self) -> Commands {
        self.commands.clone()
    }

    /// Whether it has come to its end.
    pub fn is_over(&self) -> bool {
        self.thread.is_finished()
    }

    /// Asks it to end after the frame in hand.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Waits for its end, and gives all latencies.
    ///
    /// # Errors
    /// A journal or a file that could not be written.
    pub fn finish(self) -> Result<Histogram> {
        match self.thread.join() {
            Ok(result) => result.map(|()| self.shared.lock().latencies.clone()),
            Err(_) => Err(Error::Unavailable {
                what: "the loop broke off".into(),
                message: "all that was measured is in the journal".into(),
            }),
        }
    }
}

/// The model that an earlier run published into a folder, if its verdict stands above it and is not red.
fn published_in(output: &Path) -> Option<Model> {
    let path = output.join("model.toml");
    let was_good = || verdict_mark(&path).is_some_and(|(level, _)| level != Level::DoNotUse.to_string());
    read_model(&path).ok().filter(|model| model.estimate().is_some() && was_good())
}

/// Opens the journal and the index of the next frame. Where the run is resumed, estimator and tables take what the journal has.
fn open_journal(
    output: &Path,
    resume: bool,
    estimator: &mut OnlineEstimator,
    tables: &mut FinalTables,
    shared: &SharedState,
) -> Result<(Journal, u64)> {
    let (mut next_index, mut written) = (0, Ok(()));
    let (journal, remark) = if resume {
        Journal::resume(output, |entry| match entry {
            Entry::Measured(measurement, reading) => {
                next_index = next_index.max(measurement.index + 1);
                let update = estimator.update(&measurement, reading.as_ref());
                if written.is_ok() {
                    written = tables.add(&measurement, reading.as_ref(), &update);
                }
                let mut shared = shared.lock();
                shared.count(&measurement, update.step.verdict);
                shared.state.resumed += 1;
                shared.state.gap = update.gap;
                shared.gate.add(&update);
            }
            Entry::Reset => {
                let _ = estimator.reset();
            }
        })?
    } else {
        (Journal::create(output)?, None)
    };
    written?;
    let mut shared = shared.lock();
    shared.model = estimator.model();
    shared.state.estimate = EstimateStatus::of(&shared.model);
    shared.state.stem = estimator.stem().map(StemStatus::from);
    remark.into_iter().for_each(|remark| shared.notice(remark));
    Ok((journal, next_index))
}
