//! The loop: newest frame → θ, δ → journal → η, λ → shared state.

use super::annotated_video::AnnotatedVideo;
use super::autosave::save;
use super::bank_worker::BankWorker;
use super::commands::{Answer, Command, Request};
use super::discovery_worker::DiscoveryWorker;
use super::encoders::{Encoders, Lookup};
use super::final_tables::FinalTables;
use super::frame_queue::Captured;
use super::frame_timing::{FrameTiming, LATE_S};
use super::journal::{Entry, Journal};
use super::low_priority::on_one_thread;
use super::online_estimator::{OnlineEstimator, Update};
use super::recent_bends::RecentBends;
use super::shared_state::SharedState;
use super::silence::Silence;
use super::source::FrameReader;
use super::status::{EstimateStatus, FrameTimingState, GapState, PublicationStatus, Row, StemStatus};
use super::straight_reference::RenewableEye;
use super::verdict_worker::VerdictWorker;
use crate::camera::Frame;
use crate::error::Result;
use crate::measure::FrameMeasurement;
use crate::observation::{EncoderReading, Measurement, Status};
use crate::record::OutputFolder;
use nalgebra::Vector2;
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};
use tokio::sync::oneshot;
use tracing::debug;

/// Time that a measurement waits for its encoder reading. Convention: what a network delays a line, and no more.
const READING_TIMEOUT: Duration = Duration::from_millis(250);
/// Longest wait for a frame, after which commands are looked at. Convention.
///
/// Convention: a timeout.
const FRAME_TIMEOUT: Duration = Duration::from_millis(50);
/// The same while a measurement waits for its reading. Convention.
///
/// Convention: a timeout.
const FRAME_TIMEOUT_WHILE_WAITING: Duration = Duration::from_millis(2);

/// Time between two looks at whether the folder is still there. Convention.
///
/// Convention: a timeout.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// The parts of the loop.
pub struct Pipeline {
    /// The view's name.
    pub view: String,
    /// What measures frames.
    pub eye: Arc<RenewableEye>,
    /// Where frames come from.
    pub reader: FrameReader,
    /// Where encoder readings come from.
    pub encoders: Arc<Encoders>,
    /// What learns.
    pub estimator: OnlineEstimator,
    /// Where every measurement is written down.
    pub journal: Journal,
    /// The tables that stand at the end.
    pub tables: FinalTables,
    /// What everybody may see.
    pub shared: Arc<SharedState>,
    /// Where measured frames are drawn.
    pub video: Arc<AnnotatedVideo>,
    /// What searches for missing physics.
    pub discovery: DiscoveryWorker,
    /// What follows the structures that it left open.
    pub bank: BankWorker,
    /// What judges the model.
    pub verdict: VerdictWorker,
    /// What users ask for.
    pub requests: Receiver<Request>,
    /// Set when the loop is to end.
    pub stop: Arc<AtomicBool>,
    /// The folder to write to, while it is this loop's.
    pub folder: OutputFolder,
    /// Where that is.
    pub output: PathBuf,
    /// The latest bends, for the lag between picture and encoders.
    pub bends: Arc<RecentBends>,
}

/// A measurement that waits for its encoder reading.
struct Waiting {
    measurement: Measurement,
    time_s: f64,
    arrived: Instant,
    measured: Instant,
    late_s: f64,
}

/// Work that a user asked for, on a thread of its own, one at a time: held while it goes on.
#[derive(Debug, Default)]
struct Beside(Arc<()>);

impl Beside {
    /// Starts it, or refuses while the one before goes on.
    fn start(&self, answer: oneshot::Sender<Answer>, what: &str, work: impl FnOnce() -> Answer + Send + 'static) {
        if Arc::strong_count(&self.0) > 1 {
            let _ = answer.send(Err(format!("{what} already; wait for it")));
            return;
        }
        let held = Arc::clone(&self.0);
        std::thread::spawn(move || {
            let done = work();
            drop(held);
            let _ = answer.send(done);
        });
    }
}

/// What changes while the loop runs.
struct Progress {
    began: Instant,
    timing: FrameTiming,
    waiting: VecDeque<Waiting>,
    newest: Option<Arc<Frame>>,
    last_bend: Option<Vector2<f64>>,
    paused: bool,
    saving: Beside,
    calibrating: Beside,
    /// When it was last looked whether the folder is still there.
    looked: Instant,
    /// Why the folder cannot be written to, as it was last told.
    unwritable: Option<String>,
    silence: Silence,
}

impl Pipeline {
    /// Runs until it is asked to end or a recording has ended, then writes everything once more.
    ///
    /// # Errors
    /// A journal or a file that cannot be written.
    pub fn run(mut self) -> Result<()> {
        let now = Instant::now();
        let mut progress = Progress {
            began: now,
            timing: FrameTiming::new(now),
            waiting: VecDeque::new(),
            newest: None,
            last_bend: None,
            paused: false,
            saving: Beside::default(),
            calibrating: Beside::default(),
            looked: now,
            unwritable: None,
            silence: Silence::new(now),
        };
        while !self.is_over(&progress) {
            self.obey_commands(&mut progress)?;
            let timeout = if progress.waiting.is_empty() { FRAME_TIMEOUT } else { FRAME_TIMEOUT_WHILE_WAITING };
            if let Some(captured) = self.reader.next(timeout) {
                progress.newest = captured.frame.clone().or(progress.newest.take());
                if !progress.paused {
                    self.measure(captured, &mut progress);
                }
            }
            self.learn(&mut progress)?;
            self.show(&mut progress);
            self.restore(&mut progress);
        }
        self.finish(progress)
    }

    /// Whether it was asked to end, or a recording has ended.
    fn is_over(&self, progress: &Progress) -> bool {
        self.stop.load(Ordering::Relaxed) || (self.reader.is_over() && progress.waiting.is_empty())
    }

    /// Measures a frame, near the bend of the one before; the measurement then waits for its reading.
    fn measure(&self, Captured { index, time_s, at, late_s, frame }: Captured, progress: &mut Progress) {
        let eye = self.eye.get();
        let found = match (&frame, progress.last_bend) {
            (Some(frame), Some(last)) => eye.track(frame, last),
            (Some(frame), None) => eye.measure(frame),
            (None, _) => FrameMeasurement { status: Status::Unreadable, measured: None, bend: None, quality: None },
        };
        let bend = found.bend;
        progress.last_bend = bend.map(|bend| bend.vector).or(progress.last_bend);
        let view = Some(self.view.clone());
        let measurement = found.row(index, Some(time_s), view);
        if let Some(frame) = &frame {
            self.video.offer(frame, &measurement, &eye);
        }
        if let Some(bend) = bend.filter(|_| late_s <= LATE_S) {
            self.bends.add(time_s, bend.vector);
        }
        progress.waiting.push_back(Waiting { measurement, time_s, arrived: at, measured: Instant::now(), late_s });
    }

    /// Takes every measurement, in order, whose reading is there or will not come.
    fn learn(&mut self, progress: &mut Progress) -> Result<()> {
        while let Some(first) = progress.waiting.front() {
            let out_of_time = || first.arrived.elapsed() > READING_TIMEOUT || self.stop.load(Ordering::Relaxed);
            let reading = match self.encoders.at(first.measurement.index, first.time_s) {
                // Nobody knows at which moment a late frame was taken.
                _ if first.late_s > LATE_S => None,
                Lookup::Found(reading) => Some(reading),
                Lookup::Never => None,
                Lookup::NotYet if out_of_time() => None,
                Lookup::NotYet => break,
            };
            if let Some(waiting) = progress.waiting.pop_front() {
                self.take(waiting, reading, &mut progress.timing)?;
            }
        }
        Ok(())
    }

    /// One measurement: into the journal, the estimator and the shared state.
    fn take(&mut self, waiting: Waiting, reading: Option<EncoderReading>, timing: &mut FrameTiming) -> Result<()> {
        let Waiting { mut measurement, mut time_s, arrived, measured, late_s } = waiting;
        if let (Encoders::Log(_), Some(reading)) = (&*self.encoders, &reading) {
            // The log knows better than the rate at which the recording is played.
            time_s = reading.time_s;
            measurement.time_s = Some(time_s);
        }
        self.journal.append(&Entry::Measured(measurement.clone(), reading))?;
        let update = self.estimator.update(&measurement, reading.as_ref());
        self.tables.add(&measurement, reading.as_ref(), &update)?;
        let latency_s = arrived.elapsed().as_secs_f64();
        timing.measured(Instant::now(), (measured - arrived).as_secs_f64(), measured.elapsed().as_secs_f64(), late_s);
        let mut row = self.row(&measurement, time_s, reading.as_ref(), &update);
        row.latency_ms = 1000.0 * latency_s;
        debug!(index = row.index, status = %measurement.status, update = row.verdict, latency_ms = row.latency_ms, "measured");
        if update.is_stuck {
            row.reason = "the encoders stand still while the snake moves".into();
        }
        if late_s > LATE_S {
            row.reason = format!("came {:.0} ms late: its time is not certain", 1000.0 * late_s);
        }
        self.publish(&measurement, row, &update);
        if self.verdict.is_due() {
            let (_, measurements, readings) = self.estimator.samples();
            self.verdict.start(measurements, readings);
        }
        if let Some(reading) = reading.filter(|_| !update.is_stuck) {
            self.bank.add(&measurement, &reading);
        }
        // The gap is that of the model as given; while what was found accounts for it there is nothing to search.
        let is_explained = self.bank.accounts_for_samples();
        if update.gap.state == GapState::Above && !is_explained && self.discovery.is_free() {
            self.discovery.start(self.estimator.samples());
        }
        Ok(())
    }

    fn row(
        &self,
        measurement: &Measurement,
        time_s: f64,
        reading: Option<&EncoderReading>,
        Update { step, expected, stem, .. }: &Update,
    ) -> Row {
        let q_mm = reading.map(|reading| reading.q_mm);
        Row {
            q_measured_mm: q_mm,
            q_mm,
            expected_theta_deg: expected.map(|psi| psi.theta_deg()),
            expected_delta_deg: expected.map(|psi| psi.delta_deg()),
            verdict: step.verdict.to_string(),
            reason: step.reason.as_ref().map(ToString::to_string).unwrap_or_default(),
            residual_mm: step.residual_mm,
            estimate: EstimateStatus::of(&self.estimator.model()),
            stem: stem.map(StemStatus::from),
            ..Row::of(measurement, time_s)
        }
    }

    fn publish(&self, measurement: &Measurement, row: Row, update: &Update) {
        let mut shared = self.shared.lock();
        if update.gap.state == GapState::Above && shared.state.gap.state != GapState::Above {
            shared.notice("the gap between model and measurements has left the noise: discover looks for the cause");
        }
        if update.step.restarted {
            let index = measurement.index;
            shared.notice(format!("frame {index}: measurements agree on something new (an actuator was re-homed, a tool changed); η and λ start afresh"));
        }
        shared.state.gap = update.gap;
        shared.gate.confirm(&measurement.status, update.sample.is_some());
        shared.gate.add(update);
        shared.model = self.estimator.model();
        shared.add(measurement, update.step.verdict, row);
    }

    /// Makes the folder and the journal anew where somebody removed them.
    fn restore(&mut self, progress: &mut Progress) {
        if progress.looked.elapsed() < LOOK_EVERY {
            return;
        }
        progress.looked = Instant::now();
        let restored = self.journal.file.restore();
        let restored =
            restored.and_then(|restored| if restored { self.folder.restore().map(|()| true) } else { Ok(false) });
        let why = restored.as_ref().err().map(ToString::to_string);
        let is_told = why.is_some() && why == progress.unwritable;
        progress.unwritable = why;
        let mut shared = self.shared.lock();
        match restored {
            Ok(false) => {}
            Ok(true) => {
                shared.state.publication = PublicationStatus::default();
                shared.notice(format!(
                    "{} was removed: the journal is written again in full, the table at the next save",
                    self.output.display()
                ));
            }
            // The journal stays open, wherever it was moved to, and takes what is measured.
            Err(_) if is_told => {}
            Err(error) => shared.notice(format!(
                "{} cannot be written to; the loop continues, and writing is tried again every second: {error}",
                self.output.display()
            )),
        }
    }

    /// Brings what changes without a measurement up to date.
    fn show(&self, progress: &mut Progress) {
        let (source, encoders) = (self.reader.status(), self.encoders.status());
        let timing = progress.timing.status(Instant::now(), &source);
        let silent = progress.silence.told(Instant::now(), &source, &encoders);
        let mut shared = self.shared.lock();
        silent.into_iter().for_each(|notice| shared.notice(notice));
        if timing.state != FrameTimingState::Fresh && timing.state != shared.state.timing.state {
            shared.notice(timing.sentence.clone().unwrap_or_default());
        }
        let known = [&shared.state.source.remarks, &shared.state.encoders.remarks];
        let is_new = |remark: &&String| !known.iter().any(|known| known.contains(remark));
        let remarks: Vec<String> = source.remarks.iter().chain(&encoders.remarks).filter(is_new).cloned().collect();
        remarks.into_iter().for_each(|remark| shared.notice(remark));
        shared.state.timing = timing;
        shared.state.elapsed_s = progress.began.elapsed().as_secs_f64();
        shared.state.source = source;
        shared.state.encoders = encoders;
    }

    fn obey_commands(&mut self, progress: &mut Progress) -> Result<()> {
        while let Ok((command, answer)) = self.requests.try_recv() {
            match command {
                Command::Pause(paused) => {
                    progress.paused = paused;
                    self.shared.lock().state.paused = paused;
                    let _ = answer.send(Ok(if paused { "paused" } else { "measuring" }.into()));
                }
                Command::Reset => {
                    let done = self.reset()?;
                    let _ = answer.send(Ok(done.into()));
                }
                Command::Save => progress.saving.start(answer, "the table is being written", self.saving()),
                Command::Reference => match progress.newest.clone() {
                    Some(frame) => {
                        progress.calibrating.start(answer, "a straight reference is being taken", self.renewing(frame));
                    }
                    None => drop(answer.send(Err("no frame has come yet".into()))),
                },
            }
        }
        Ok(())
    }

    /// Forgets all measurements; says what begins anew.
    fn reset(&mut self) -> Result<&'static str> {
        self.journal.append(&Entry::Reset)?;
        let done = self.estimator.reset()?;
        self.bank.forget();
        let mut shared = self.shared.lock();
        shared.model = self.estimator.model();
        shared.state.estimate = EstimateStatus::of(&shared.model);
        shared.state.stem = self.estimator.stem().map(StemStatus::from);
        shared.state.discovery = None;
        shared.gate.begin_anew();
        shared.notice(done);
        Ok(done)
    }

    /// What writes model and table.
    fn saving(&self) -> impl FnOnce() -> Answer + Send + 'static {
        let (shared, output) = (Arc::clone(&self.shared), self.output.clone());
        move || match save(&shared, &output) {
            Ok(Ok(())) => Ok(format!("model and table are in {}", output.display())),
            Ok(Err(why)) => Err(format!("no table was written: {}", why.text)),
            Err(error) => Err(error.to_string()),
        }
    }

    /// What calibrates the rig from a frame.
    fn renewing(&self, frame: Arc<Frame>) -> impl FnOnce() -> Answer + Send + 'static {
        let (eye, shared) = (Arc::clone(&self.eye), Arc::clone(&self.shared));
        move || {
            let result = match on_one_thread(|| eye.renew(&frame)) {
                Ok(()) => Ok("the newest frame is the straight reference now; rig.toml has it".to_owned()),
                Err(message) => Err(format!("this frame cannot be the straight reference: {message}")),
            };
            shared.lock().notice(result.clone().unwrap_or_else(|refused| refused));
            result
        }
    }

    /// The end: measurements that wait are taken, and everything is written once more.
    fn finish(mut self, mut progress: Progress) -> Result<()> {
        self.stop.store(true, Ordering::Relaxed);
        self.learn(&mut progress)?;
        self.show(&mut progress);
        self.shared.lock().gate.end();
        let (_, measurements, readings) = self.estimator.samples();
        self.verdict.finish(&measurements, &readings);
        let is_estimated = self.shared.lock().model.estimate().is_some();
        let saved = if is_estimated { save(&self.shared, &self.output).map(|_| ()) } else { Ok(()) };
        self.tables.finish()?;
        self.shared.lock().state.ended = true;
        saved
    }
}
