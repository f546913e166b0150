//! The board: what everybody may look at while the loop runs. Whoever looks takes a copy and holds up nobody.

use super::encoders::EncoderStatus;
use super::gap::{GapState, GapStatus};
use super::latency::{Histogram, LatencyStatus};
use super::pace::PaceStatus;
use super::source::SourceStatus;
use crate::estimate::{StemAngle, Verdict};
use crate::observation::Measurement;
use crate::robot::{Model, PerBackbone};
use serde::Serialize;
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Rows that are kept to be asked for: some minutes.
const MOST_ROWS: usize = 12_000;
/// Notices that are kept.
const MOST_NOTICES: usize = 20;

/// One measurement and what came of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// The frame's index.
    pub index: u64,
    /// Its time, s.
    pub time_s: f64,
    /// `ok`, or why there are no angles.
    pub status: String,
    /// θ and δ as measured, degrees, with their standard deviations.
    pub theta_deg: Option<f64>,
    /// See `theta_deg`.
    pub delta_deg: Option<f64>,
    /// See `theta_deg`.
    pub sigma_theta_deg: Option<f64>,
    /// See `theta_deg`.
    pub sigma_delta_deg: Option<f64>,
    /// What the encoders read, mm.
    pub q_mm: Option<PerBackbone>,
    /// θ and δ that the model expects from that, degrees.
    pub expected_theta_deg: Option<f64>,
    /// See `expected_theta_deg`.
    pub expected_delta_deg: Option<f64>,
    /// `used`, `rejected` or `skipped` by the estimator.
    pub verdict: String,
    /// Why not used.
    pub reason: String,
    /// Measured ε less predicted ε per backbone, mm.
    pub residual_mm: Option<PerBackbone>,
    /// The estimate after it.
    pub estimate: Option<EstimateStatus>,
    /// The stem's angle after it, where that is followed.
    pub stem: Option<StemStatus>,
    /// From the frame's arrival to the estimate, ms.
    pub latency_ms: f64,
}

/// η and λ with their standard deviations.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct EstimateStatus {
    /// η.
    pub eta: f64,
    /// Its standard deviation.
    pub sd_eta: f64,
    /// λ, mm.
    pub lambda_mm: f64,
    /// Its standard deviation, mm.
    pub sd_lambda_mm: f64,
    /// Measurements behind it.
    pub samples: usize,
}

impl EstimateStatus {
    /// Of a model, where it has one.
    pub fn of(model: &Model) -> Option<Self> {
        model.estimate.map(|estimate| Self {
            eta: estimate.eta,
            sd_eta: estimate.sd_eta(),
            lambda_mm: estimate.lambda_mm,
            sd_lambda_mm: estimate.sd_lambda_mm(),
            samples: estimate.samples,
        })
    }
}

/// The total bending angle of a flexible stem.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StemStatus {
    /// Φ, degrees.
    pub phi_deg: f64,
    /// Its standard deviation, degrees.
    pub sd_phi_deg: f64,
}

impl From<StemAngle> for StemStatus {
    fn from(angle: StemAngle) -> Self {
        Self { phi_deg: angle.phi.to_degrees(), sd_phi_deg: angle.sd.to_degrees() }
    }
}

/// What discover found last.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DiscoveryStatus {
    /// Whether it is at work.
    pub running: bool,
    /// `named`, `none`, `unexplained`, or empty before the first answer.
    pub verdict: String,
    /// The answer in words, or why there is none.
    pub sentence: String,
    /// discrepancy.json's content.
    pub details: Option<serde_json::Value>,
}

/// Everything at one moment, as `GET /api/state` gives it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct State {
    /// The program's version.
    pub version: &'static str,
    /// What frames come from, in words.
    pub source_name: String,
    /// Seconds since the run began.
    pub elapsed_s: f64,
    /// Whether measuring is paused.
    pub paused: bool,
    /// Whether the run is over.
    pub ended: bool,
    /// Measurements taken over from an earlier run.
    pub resumed: u64,
    /// Measurements so far, by their status; those taken over are among them.
    pub measurements: u64,
    /// Those with angles.
    pub measured: u64,
    /// Those that the estimator rejected.
    pub rejected: u64,
    /// The source's figures.
    pub source: SourceStatus,
    /// The encoders' figures.
    pub encoders: EncoderStatus,
    /// From the frame's arrival to the estimate.
    pub latency: LatencyStatus,
    /// Whether frames come when they are due and are measured while they are fresh.
    pub pace: PaceStatus,
    /// The latest measurement.
    pub latest: Option<Row>,
    /// η and λ.
    pub estimate: Option<EstimateStatus>,
    /// The stem's angle, where that is followed.
    pub stem: Option<StemStatus>,
    /// Whether the model accounts for what is measured.
    pub gap: GapStatus,
    /// What discover found last.
    pub discovery: Option<DiscoveryStatus>,
    /// Unix time of the last table written, s.
    pub saved_at_s: Option<f64>,
    /// What a person should know, latest last.
    pub notices: Vec<String>,
}

impl State {
    /// Before the first frame.
    pub fn at_start(source_name: String, encoders: EncoderStatus) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION"),
            source_name,
            elapsed_s: 0.0,
            paused: false,
            ended: false,
            resumed: 0,
            measurements: 0,
            measured: 0,
            rejected: 0,
            source: SourceStatus::waiting(),
            encoders,
            latency: LatencyStatus::default(),
            pace: PaceStatus::at_start(),
            latest: None,
            estimate: None,
            stem: None,
            gap: GapStatus { state: GapState::Unknown, bending: 1.0, common: 1.0, rejected: 0.0 },
            discovery: None,
            saved_at_s: None,
            notices: Vec::new(),
        }
    }
}

/// The board.
#[derive(Debug)]
pub struct Board(Mutex<Content>);

/// What stands on it.
#[derive(Debug)]
pub struct Content {
    /// The figures.
    pub state: State,
    /// The model with the latest estimate.
    pub model: Model,
    /// The latest rows.
    rows: VecDeque<Row>,
    /// All latencies.
    pub latencies: Histogram,
    /// Frames that could be read but not measured, and those measured, by status.
    pub by_status: std::collections::BTreeMap<String, u64>,
}

impl Content {
    /// Adds a measurement that was made now.
    pub fn add(&mut self, measurement: &Measurement, verdict: Verdict, row: Row) {
        self.count(measurement, verdict);
        self.latencies.add(row.latency_ms / 1000.0);
        self.state.latency = self.latencies.status(row.latency_ms);
        self.state.estimate = row.estimate;
        self.state.stem = row.stem;
        self.state.latest = Some(row.clone());
        if self.rows.len() == MOST_ROWS {
            self.rows.pop_front();
        }
        self.rows.push_back(row);
    }

    /// Counts a measurement, made now or taken over from an earlier run.
    pub fn count(&mut self, measurement: &Measurement, verdict: Verdict) {
        self.state.measurements += 1;
        self.state.measured += u64::from(measurement.measured.is_some());
        self.state.rejected += u64::from(verdict == Verdict::Rejected);
        *self.by_status.entry(measurement.status.to_string()).or_default() += 1;
    }

    /// Says something to whoever looks; the same thing only once in a row.
    pub fn notice(&mut self, text: impl Into<String>) {
        let text = text.into();
        if self.state.notices.last() == Some(&text) {
            return;
        }
        if self.state.notices.len() == MOST_NOTICES {
            self.state.notices.remove(0);
        }
        self.state.notices.push(text);
    }
}

impl Board {
    /// A board that shows this.
    pub fn new(state: State, model: Model) -> Self {
        Self(Mutex::new(Content {
            state,
            model,
            rows: VecDeque::new(),
            latencies: Histogram::default(),
            by_status: std::collections::BTreeMap::new(),
        }))
    }

    /// What stands on it, for a moment.
    pub fn lock(&self) -> MutexGuard<'_, Content> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A copy of the figures.
    pub fn state(&self) -> State {
        self.lock().state.clone()
    }

    /// Rows after an index, the earliest first, at most so many; without an index the latest.
    pub fn rows_after(&self, index: Option<u64>, most: usize) -> Vec<Row> {
        let content = self.lock();
        let rows = &content.rows;
        let from = match index {
            Some(index) => rows.partition_point(|row| row.index <= index),
            None => rows.len().saturating_sub(most),
        };
        rows.range(from..).take(most).cloned().collect()
    }
}
