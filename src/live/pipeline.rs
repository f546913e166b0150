//! The loop: newest frame → θ, δ → journal → η, λ → board.

use super::board::{Board, EstimateStatus, Row, State, StemStatus};
use super::clock::FrameClock;
use super::encoders::{EncoderSource, Encoders, Feed, Lookup};
use super::finder::Finder;
use super::gap::GapState;
use super::journal::{Entry, Journal};
use super::latency::Histogram;
use super::learner::{Learned, Learner};
use super::pace::{LATE_S, Pace, PaceState};
use super::pictures::Pictures;
use super::quiet::alone;
use super::saver::{Bends, Saver, Saving, save};
use super::source::{Captured, Reader, Source};
use crate::camera::{Frame, Lens};
use crate::error::{Error, Result};
use crate::estimate::{Options, StemOptions};
use crate::measure::{Eye, FrameMeasurement, RigOptions, calibrate_rig};
use crate::observation::{EncoderReading, Measurement, Status};
use crate::robot::{Model, Robot};
use nalgebra::Vector2;
use std::collections::{HashMap, VecDeque};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tokio::sync::oneshot;

/// One camera, ready to measure.
#[derive(Debug)]
pub struct View {
    /// Its name.
    pub name: String,
    /// Its lens.
    pub lens: Lens,
    /// The robot before it.
    pub robot: Robot,
    /// What a new straight reference is calibrated with.
    pub rig_options: RigOptions,
    /// What measures its frames.
    pub eye: Eye,
}

/// Where encoder readings come from.
#[derive(Debug)]
pub enum EncoderInput {
    /// From nowhere.
    None,
    /// From a finished log, matched by the frames' index.
    Log(Vec<EncoderReading>),
    /// As lines that come.
    Lines {
        /// Where from.
        source: EncoderSource,
        /// What to add to a stamp to have the frames' time, s; estimated where it is not given.
        offset_s: Option<f64>,
    },
}

/// All that a run needs.
#[derive(Debug)]
pub struct Setup {
    /// The camera's view.
    pub view: View,
    /// Where frames come from.
    pub source: Source,
    /// That in words.
    pub source_name: String,
    /// Where encoder readings come from.
    pub encoders: EncoderInput,
    /// The model to start from; its effects are obeyed.
    pub model: Model,
    /// The estimator's settings.
    pub options: Options,
    /// Settings to follow a flexible stem with, in place of η and λ.
    pub stem: Option<StemOptions>,
    /// The folder to write to.
    pub output: PathBuf,
    /// Whether to go on with the journal that is there.
    pub resume: bool,
    /// How often model and table are written.
    pub save_every: Duration,
}

/// What the loop can be told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// Measure, or let frames pass.
    Pause(bool),
    /// Take the newest frame for a picture of the unbent snake and calibrate the rig anew.
    Reference,
    /// Forget η and λ.
    Reset,
    /// Write model and table now.
    Save,
}

/// What came of a command, in words.
pub type Answer = std::result::Result<String, String>;

/// A running loop.
pub struct Live {
    /// What it shows.
    pub board: Arc<Board>,
    /// Its annotated video.
    pub pictures: Arc<Pictures>,
    commands: Sender<(Command, oneshot::Sender<Answer>)>,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Result<()>>,
}

/// A handle to tell a loop something.
#[derive(Debug, Clone)]
pub struct Commands(Sender<(Command, oneshot::Sender<Answer>)>);

impl Commands {
    /// Tells it; the answer comes through the channel, unless the run is over.
    pub fn send(&self, command: Command) -> oneshot::Receiver<Answer> {
        let (answer, answered) = oneshot::channel();
        let _ = self.0.send((command, answer));
        answered
    }
}

/// How long a measurement waits for its encoder reading.
const WAIT_FOR_READING: Duration = Duration::from_millis(250);
/// How long the loop sleeps at most, so that it hears commands.
const LISTEN_EVERY: Duration = Duration::from_millis(50);
/// While a measurement waits for its reading.
const LOOK_AGAIN: Duration = Duration::from_millis(2);
/// Bends that the lag is estimated from, and the time between them, s.
const LAG_BENDS: usize = 600;
const LAG_STEP_S: f64 = 0.03;

impl Live {
    /// Opens the journal, starts reading, measuring, learning and writing.
    ///
    /// # Errors
    /// A journal that is in the way or cannot be read, an option out of its range, a source that cannot exist.
    pub fn start(setup: Setup) -> Result<Self> {
        let Setup { view, source, source_name, encoders, model, options, stem, output, resume, save_every } = setup;
        let mut learner = Learner::new(model.clone(), options, stem)?;
        let clock = Arc::new(FrameClock::default());
        let encoders = Arc::new(match encoders {
            EncoderInput::None => Encoders::None,
            EncoderInput::Log(readings) => {
                Encoders::Log(readings.into_iter().map(|reading| (reading.index, reading)).collect::<HashMap<_, _>>())
            }
            EncoderInput::Lines { source, offset_s } => {
                let backbones = model.robot.backbone_count();
                Encoders::Feed(Feed::start(source, backbones, Arc::clone(&clock), offset_s))
            }
        });
        let board = Arc::new(Board::new(State::at_start(source_name, encoders.status()), model.clone()));
        let mut next_index = 0;
        let (journal, remark) = if resume {
            Journal::resume(&output, |entry| match entry {
                Entry::Measured(measurement, reading) => {
                    next_index = next_index.max(measurement.index + 1);
                    let learned = learner.take(&measurement, reading.as_ref());
                    let mut content = board.lock();
                    content.count(&measurement, learned.step.verdict);
                    content.state.resumed += 1;
                    content.state.gap = learned.gap;
                }
                Entry::Reset => {
                    let _ = learner.reset();
                }
            })?
        } else {
            (Journal::create(&output)?, None)
        };
        let reader = Reader::start(source, next_index, clock)?;
        {
            let mut content = board.lock();
            content.state.estimate = EstimateStatus::of(&learner.model());
            content.state.stem = learner.stem().map(StemStatus::from);
            content.model = learner.model();
            content.state.notices.extend(remark);
        }
        let bends = Bends::default();
        let saver = Saver::start(Saving {
            board: Arc::clone(&board),
            journal: journal.sync_handle()?,
            output: output.clone(),
            every: save_every,
            encoders: Arc::clone(&encoders),
            bends: Arc::clone(&bends),
            to_bend: model.robot.bend_by_displacement(),
        });
        let pictures = Pictures::start();
        let (commands, requests) = channel();
        let stop = Arc::new(AtomicBool::new(false));
        let View { name, lens, robot, rig_options, eye } = view;
        let loop_ = Loop {
            finder: Finder::new(Arc::clone(&board), output.clone(), options.sd_encoder_mm),
            reference: Reference { lens, robot, rig_options, output: output.clone() },
            eye: Arc::new(Mutex::new(Arc::new(eye))),
            name,
            reader,
            encoders,
            learner,
            journal,
            board: Arc::clone(&board),
            pictures: Arc::clone(&pictures),
            requests,
            stop: Arc::clone(&stop),
            output,
            waiting: VecDeque::new(),
            newest: None,
            bends,
            last_bend: None,
            paused: false,
            pace: Pace::new(Instant::now()),
            began: Instant::now(),
        };
        let thread = std::thread::spawn(move || {
            let result = loop_.run();
            saver.finish();
            result
        });
        Ok(Self { board, pictures, commands, stop, thread })
    }

    /// A handle to tell it something.
    pub fn commands(&self) -> Commands {
        Commands(self.commands.clone())
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
            Ok(result) => result.map(|()| self.board.lock().latencies.clone()),
            Err(_) => Err(Error::Domain("the loop broke off; all that was measured is in the journal".into())),
        }
    }
}

/// A measurement that waits for its encoder reading.
struct Waiting {
    measurement: Measurement,
    time_s: f64,
    arrived: Instant,
    late_s: f64,
}

struct Loop {
    name: String,
    eye: Arc<Mutex<Arc<Eye>>>,
    reader: Reader,
    encoders: Arc<Encoders>,
    learner: Learner,
    journal: Journal,
    board: Arc<Board>,
    pictures: Arc<Pictures>,
    finder: Finder,
    reference: Reference,
    requests: Receiver<(Command, oneshot::Sender<Answer>)>,
    stop: Arc<AtomicBool>,
    output: PathBuf,
    waiting: VecDeque<Waiting>,
    newest: Option<Arc<Frame>>,
    bends: Bends,
    last_bend: Option<Vector2<f64>>,
    paused: bool,
    pace: Pace,
    began: Instant,
}

impl Loop {
    fn run(mut self) -> Result<()> {
        while !self.is_over() {
            self.listen()?;
            let wait = if self.waiting.is_empty() { LISTEN_EVERY } else { LOOK_AGAIN };
            if let Some(captured) = self.reader.next(wait) {
                self.newest = captured.frame.clone().or(self.newest.take());
                if !self.paused {
                    self.measure(captured);
                }
            }
            self.learn()?;
            self.show();
        }
        self.settle()
    }

    /// Whether it was asked to end, or a recording has ended.
    fn is_over(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || (self.reader.is_over() && self.waiting.is_empty())
    }

    /// What a frame shows; the measurement then waits for its reading.
    fn measure(&mut self, Captured { index, time_s, at, late_s, frame }: Captured) {
        let eye = Arc::clone(&self.eye.lock().unwrap_or_else(PoisonError::into_inner));
        let measurement = match &frame {
            Some(frame) => look(&eye, frame, self.last_bend),
            None => FrameMeasurement { status: Status::Unreadable, measured: None, bend: None, quality: None },
        };
        let FrameMeasurement { status, measured, bend, quality } = measurement;
        self.last_bend = bend.map(|bend| bend.vector).or(self.last_bend);
        let view = Some(self.name.clone());
        let measurement = Measurement { index, time_s: Some(time_s), status, measured, quality, view };
        if let Some(frame) = &frame {
            self.pictures.offer(frame, &measurement, &eye);
        }
        if let Some(bend) = bend.filter(|_| late_s <= LATE_S) {
            self.remember(time_s, bend.vector);
        }
        self.waiting.push_back(Waiting { measurement, time_s, arrived: at, late_s });
    }

    /// Keeps bends for the lag, not too close together.
    fn remember(&self, time_s: f64, bend: Vector2<f64>) {
        let mut bends = self.bends.lock().unwrap_or_else(PoisonError::into_inner);
        if bends.last().is_none_or(|(last_s, _)| time_s - last_s >= LAG_STEP_S) {
            if bends.len() == LAG_BENDS {
                bends.remove(0);
            }
            bends.push((time_s, bend));
        }
    }

    /// Takes every measurement, in order, whose reading is there or will not come.
    fn learn(&mut self) -> Result<()> {
        while let Some(first) = self.waiting.front() {
            let reading = match self.encoders.at(first.measurement.index, first.time_s) {
                // At which moment it was taken nobody knows.
                _ if first.late_s > LATE_S => None,
                Lookup::Found(reading) => Some(reading),
                Lookup::Never => None,
                Lookup::NotYet if first.arrived.elapsed() > WAIT_FOR_READING || self.stop.load(Ordering::Relaxed) => {
                    None
                }
                Lookup::NotYet => break,
            };
            if let Some(waiting) = self.waiting.pop_front() {
                self.take(waiting, reading)?;
            }
        }
        Ok(())
    }

    /// One measurement: into the journal, the estimator, and onto the board.
    fn take(&mut self, waiting: Waiting, reading: Option<EncoderReading>) -> Result<()> {
        let Waiting { mut measurement, mut time_s, arrived, late_s } = waiting;
        if let (Encoders::Log(_), Some(reading)) = (&*self.encoders, &reading) {
            // The log knows better than the rate at which the recording is played.
            time_s = reading.time_s;
            measurement.time_s = Some(time_s);
        }
        let entry = Entry::Measured(measurement.clone(), reading);
        self.journal.append(&entry)?;
        let learned = self.learner.take(&measurement, reading.as_ref());
        let model = self.learner.model();
        let latency_s = arrived.elapsed().as_secs_f64();
        self.pace.took(Instant::now(), latency_s, late_s);
        let mut row = row(&measurement, time_s, reading.as_ref(), &learned, &model, 1000.0 * latency_s);
        if late_s > LATE_S {
            row.reason = format!("came {:.0} ms late: its time is not certain", 1000.0 * late_s);
        }
        let mut content = self.board.lock();
        if learned.gap.state == GapState::Above && content.state.gap.state != GapState::Above {
            content.notice("the gap between model and measurements has left the noise: discover is asked for its name");
        }
        if learned.step.restarted {
            content.notice(format!(
                "frame {}: measurements agree on something new; η and λ start afresh",
                measurement.index
            ));
        }
        content.state.gap = learned.gap;
        content.model = model;
        content.add(&measurement, learned.step.verdict, row);
        drop(content);
        if learned.gap.state == GapState::Above && self.finder.is_free() {
            self.finder.look(self.learner.gathered());
        }
        Ok(())
    }

    /// Brings the figures that change by themselves up to date.
    fn show(&mut self) {
        let (source, encoders) = (self.reader.status(), self.encoders.status());
        let pace = self.pace.status(Instant::now(), &source);
        let mut content = self.board.lock();
        if pace.state != PaceState::Fresh && pace.state != content.state.pace.state {
            content.notice(pace.sentence.clone().unwrap_or_default());
        }
        content.state.pace = pace;
        content.state.elapsed_s = self.began.elapsed().as_secs_f64();
        content.state.source = source;
        content.state.encoders = encoders;
    }

    /// Does what it was told.
    fn listen(&mut self) -> Result<()> {
        while let Ok((command, answer)) = self.requests.try_recv() {
            match command {
                Command::Pause(paused) => {
                    self.paused = paused;
                    self.board.lock().state.paused = paused;
                    let _ = answer.send(Ok(if paused { "paused" } else { "measuring" }.into()));
                }
                Command::Reset => {
                    self.journal.append(&Entry::Reset)?;
                    let said = self.learner.reset()?;
                    let mut content = self.board.lock();
                    content.model = self.learner.model();
                    content.state.estimate = EstimateStatus::of(&content.model);
                    content.state.stem = self.learner.stem().map(StemStatus::from);
                    content.state.discovery = None;
                    content.notice(said);
                    let _ = answer.send(Ok(said.into()));
                }
                Command::Save => {
                    let (board, output) = (Arc::clone(&self.board), self.output.clone());
                    std::thread::spawn(move || {
                        let saved = save(&board, &output).map_err(|error| error.to_string());
                        let _ = answer.send(saved.map(|()| format!("model and table are in {}", output.display())));
                    });
                }
                Command::Reference => self.take_reference(answer),
            }
        }
        Ok(())
    }

    /// Calibrates the rig from the newest frame, beside the loop.
    fn take_reference(&self, answer: oneshot::Sender<Answer>) {
        let Some(frame) = self.newest.clone() else {
            let _ = answer.send(Err("no frame has come yet".into()));
            return;
        };
        let (reference, eye, board) = (self.reference.clone(), Arc::clone(&self.eye), Arc::clone(&self.board));
        std::thread::spawn(move || {
            let taken = alone(|| reference.take(&frame));
            let said = match taken {
                Ok(fresh) => {
                    *eye.lock().unwrap_or_else(PoisonError::into_inner) = Arc::new(fresh);
                    Ok("the newest frame is the straight reference now; rig.toml has it".to_owned())
                }
                Err(message) => Err(format!("this frame cannot be the straight reference: {message}")),
            };
            board.lock().notice(said.clone().unwrap_or_else(|refused| refused));
            let _ = answer.send(said);
        });
    }

    /// The end: what waits is taken, and everything is written once more.
    fn settle(mut self) -> Result<()> {
        self.stop.store(true, Ordering::Relaxed);
        self.learn()?;
        self.show();
        let result = if self.board.lock().model.estimate.is_some() { save(&self.board, &self.output) } else { Ok(()) };
        super::outcome::write(&self.output, self.learner)?;
        self.board.lock().state.ended = true;
        result
    }
}

/// What a frame shows, near the bend that the one before it showed.
fn look(eye: &Eye, frame: &Frame, last: Option<Vector2<f64>>) -> FrameMeasurement {
    last.map_or_else(|| eye.measure(frame), |last| eye.track(frame, last))
}

/// What a new straight reference needs.
#[derive(Debug, Clone)]
struct Reference {
    lens: Lens,
    robot: Robot,
    rig_options: RigOptions,
    output: PathBuf,
}

impl Reference {
    fn take(&self, frame: &Frame) -> std::result::Result<Eye, String> {
        let rig = calibrate_rig(frame, &self.lens, &self.robot, &self.rig_options)?;
        rig.write(&self.output.join("rig.toml")).map_err(|error| error.to_string())?;
        Ok(Eye::new(self.lens.clone(), rig, self.robot.clone()))
    }
}

fn row(
    measurement: &Measurement,
    time_s: f64,
    reading: Option<&EncoderReading>,
    learned: &Learned,
    model: &Model,
    latency_ms: f64,
) -> Row {
    let measured = measurement.measured;
    Row {
        index: measurement.index,
        time_s,
        status: measurement.status.to_string(),
        theta_deg: measured.map(|m| m.configuration.theta_deg()),
        delta_deg: measured.map(|m| m.configuration.delta_deg()),
        sigma_theta_deg: measured.map(|m| m.sigma_theta.to_degrees()),
        sigma_delta_deg: measured.map(|m| m.sigma_delta.to_degrees()),
        q_mm: reading.map(|reading| reading.q_mm),
        expected_theta_deg: learned.expected.map(|psi| psi.theta_deg()),
        expected_delta_deg: learned.expected.map(|psi| psi.delta_deg()),
        verdict: learned.step.verdict.to_string(),
        reason: learned.step.reason.as_ref().map(ToString::to_string).unwrap_or_default(),
        residual_mm: learned.step.residual_mm,
        estimate: EstimateStatus::of(model),
        stem: learned.stem.map(StemStatus::from),
        latency_ms,
    }
}
