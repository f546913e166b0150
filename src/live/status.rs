//! What the program shows of a running loop: the content of `GET /api/state` and `GET /api/measurements`.
//!
//! The names of the JSON keys are a contract with other people's programs. Every part of `live` fills its own status and depends on
//! this file alone.

use crate::camera::CaptureSettings;
use crate::discover::Followed;
use crate::estimate::{EtaLambda, StemAngle, Verdict};
use crate::observation::{Measurement, commonest_status};
use crate::robot::{Model, PerBackbone};
use crate::verdict::{Code, Level, Reason, Verdict as RunVerdict};
use nalgebra::Matrix2;
use serde::Serialize;
use std::collections::BTreeMap;

/// Everything at one moment, as `GET /api/state` gives it.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct State {
    /// The program's version.
    pub version: &'static str,
    /// What frames come from, in words.
    pub source_name: String,
    /// Whether what was learned so far can be relied on.
    pub verdict: RunVerdict,
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
    /// The frames' source.
    pub source: SourceStatus,
    /// The encoders.
    pub encoders: EncoderStatus,
    /// Time from a frame's arrival to the estimate.
    pub latency: LatencyStatus,
    /// Whether frames arrive on time and are measured at once.
    #[serde(rename = "pace")]
    pub timing: FrameTimingStatus,
    /// The latest measurement.
    pub latest: Option<Row>,
    /// η and λ.
    pub estimate: Option<EstimateStatus>,
    /// The stem's angle, where `--stem` follows it.
    pub stem: Option<StemStatus>,
    /// Whether the model accounts for what is measured.
    pub gap: GapStatus,
    /// What discover found last.
    pub discovery: Option<DiscoveryStatus>,
    /// Whether the table in the folder is that of the model as it stands.
    pub publication: PublicationStatus,
    /// Unix time at which the table was written last, s.
    pub saved_at_s: Option<f64>,
    /// Messages for the user, latest last.
    pub notices: Vec<String>,
}

impl State {
    /// Before the first frame.
    pub fn at_start(source_name: String, encoders: EncoderStatus) -> Self {
        let verdict = nothing_judged(0, None);
        Self { version: env!("CARGO_PKG_VERSION"), source_name, verdict, encoders, ..Self::default() }
    }
}

/// The verdict before anything was judged, of a run that measured so many frames, the latest with this status.
pub fn nothing_judged(measured: u64, latest: Option<&str>) -> RunVerdict {
    let text = match measured {
        0 => "nothing was judged yet: no frame was measured".to_owned(),
        _ => format!("nothing was judged yet: {measured} frames were measured, and none has an encoder reading"),
    };
    let failed =
        latest.filter(|_| measured == 0).and_then(|status| commonest_status(&BTreeMap::from([(status.to_owned(), 1)])));
    let remedy = failed
        .unwrap_or_else(|| "see that frames and readings come, and bend the snake in at least two planes".to_owned());
    RunVerdict::of(vec![Reason::new(Code::WorkspaceNotCovered, Level::Look, text, remedy)])
}

/// One measurement and what the estimator did with it.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Row {
    /// The frame's index.
    pub index: u64,
    /// Its time, s.
    pub time_s: f64,
    /// `ok`, or why there are no angles.
    pub status: String,
    /// Measured θ, degrees.
    pub theta_deg: Option<f64>,
    /// Measured δ, degrees.
    pub delta_deg: Option<f64>,
    /// Standard deviation of θ, degrees.
    pub sigma_theta_deg: Option<f64>,
    /// Standard deviation of δ, degrees.
    pub sigma_delta_deg: Option<f64>,
    /// Standard deviation of the bend vector θ (cos δ, sin δ) where it is least certain, degrees.
    pub sigma_bend_deg: Option<f64>,
    /// Encoder readings q̃, mm.
    pub q_measured_mm: Option<PerBackbone>,
    /// The same, under the name of earlier versions.
    pub q_mm: Option<PerBackbone>,
    /// θ that the model predicts from q̃, degrees.
    pub expected_theta_deg: Option<f64>,
    /// δ that the model predicts from q̃, degrees.
    pub expected_delta_deg: Option<f64>,
    /// `used`, `rejected` or `skipped` by the estimator.
    pub verdict: String,
    /// Why it was not used.
    pub reason: String,
    /// Measured ε less predicted ε per backbone, mm.
    pub residual_mm: Option<PerBackbone>,
    /// The estimate after it.
    pub estimate: Option<EstimateStatus>,
    /// The stem's angle after it, where `--stem` follows it.
    pub stem: Option<StemStatus>,
    /// Time from the frame's arrival to the estimate, ms.
    pub latency_ms: f64,
}

impl Row {
    /// A measurement at a time, s, that the estimator has not seen.
    pub fn of(measurement: &Measurement, time_s: f64) -> Self {
        let measured = measurement.measured;
        Self {
            index: measurement.index,
            time_s,
            status: measurement.status.to_string(),
            theta_deg: measured.map(|m| m.configuration.theta_deg()),
            delta_deg: measured.map(|m| m.configuration.delta_deg()),
            sigma_theta_deg: measured.map(|m| m.sigma_theta.to_degrees()),
            sigma_delta_deg: measured.map(|m| m.sigma_delta.to_degrees()),
            sigma_bend_deg: measured.map(|m| largest_sigma(&m.bend_covariance(m.configuration)).to_degrees()),
            verdict: Verdict::Skipped.to_string(),
            ..Self::default()
        }
    }
}

/// The square root of a covariance's largest eigenvalue: the standard deviation in the direction that is least certain.
fn largest_sigma(covariance: &Matrix2<f64>) -> f64 {
    covariance.symmetric_eigenvalues().max().max(0.0).sqrt()
}

/// η and λ with their standard deviations.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct EstimateStatus {
    /// Both, as they stand.
    #[serde(flatten)]
    pub parameters: EtaLambda,
    /// Number of measurements that it was estimated from.
    pub samples: usize,
}

impl EstimateStatus {
    /// The estimate of a model; `None` where it has none.
    pub fn of(model: &Model) -> Option<Self> {
        model.estimate().map(|estimate| Self { parameters: estimate.into(), samples: estimate.samples })
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

/// What a source of frames is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SourceState {
    /// No frame has come yet.
    #[default]
    Waiting,
    /// Frames come.
    Running,
    /// Frames came and stopped; the source is opened again and again.
    Lost,
    /// The recording is over.
    Ended,
}

/// The frames' source.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct SourceStatus {
    /// What it is doing.
    pub state: SourceState,
    /// Why it is not running, where that is known.
    pub trouble: Option<String>,
    /// Frames that came.
    pub frames: u64,
    /// Frames that newer ones replaced before they were measured.
    pub dropped: u64,
    /// How often it came back after it was lost.
    pub reconnects: u64,
    /// Frames per second, averaged over the last frames.
    pub rate_fps: f64,
    /// The settings that a camera or stream reports.
    pub settings: Option<CaptureSettings>,
    /// What of them is not as it was asked for, or moves the lens, and what is wrong with who sends the frames, in sentences.
    pub remarks: Vec<String>,
}

/// Whose clock the encoders' time stamps are in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ClockState {
    /// Nothing is known yet.
    #[default]
    Unknown,
    /// The frames' clock, as far as can be told.
    Shared,
    /// A clock of the encoders' own; its offset is estimated.
    Foreign,
    /// The user gave the offset.
    Given,
}

/// By how much the picture is behind the encoders.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Lag {
    /// Seconds; positive where the picture is late.
    pub seconds: f64,
    /// Its standard deviation, s.
    pub sd: f64,
}

/// The encoders.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct EncoderStatus {
    /// `none`, `log` (a finished file, matched by index), `waiting`, `running` or `lost`.
    pub state: &'static str,
    /// Why they are not running, where that is known.
    pub trouble: Option<String>,
    /// Readings so far.
    pub readings: u64,
    /// Lines that could not be read.
    pub bad_lines: u64,
    /// What is wrong with the latest such line.
    pub last_bad: Option<String>,
    /// Whose clock the time stamps are in.
    pub clock: ClockState,
    /// What is added to a time stamp to get the frames' time, s.
    pub offset_s: f64,
    /// By how much the picture is behind the encoders, estimated from the motion.
    pub lag: Option<Lag>,
    /// What is wrong with who sends them, in sentences.
    pub remarks: Vec<String>,
}

impl EncoderStatus {
    /// Encoders that are not read while the loop runs: `none`, or a finished `log` of so many readings.
    pub fn at_rest(state: &'static str, readings: u64) -> Self {
        Self { state, readings, clock: ClockState::Shared, ..Self::default() }
    }
}

/// Latencies, ms.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct LatencyStatus {
    /// The latest.
    pub last_ms: f64,
    /// The median.
    pub p50_ms: f64,
    /// The 99th percentile.
    pub p99_ms: f64,
    /// The largest.
    pub most_ms: f64,
}

/// Whether frames arrive on time and are measured at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FrameTimingState {
    /// They arrive on time and are measured at once.
    #[default]
    Fresh,
    /// They arrive on time, but faster than they can be measured: many are dropped, or all are old when they are measured.
    Behind,
    /// They arrive late: it is not certain when they were taken, and nothing is learned from them.
    Late,
}

/// The frames' timing.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct FrameTimingStatus {
    /// The verdict.
    pub state: FrameTimingState,
    /// Time from a frame's arrival to its measurement, ms; averaged over the last frames.
    pub age_ms: f64,
    /// Share of the frames of the last seconds that were dropped.
    pub dropped: f64,
    /// Frames so far that arrived late and were not learned from.
    pub late: u64,
    /// What is wrong and what to do about it.
    pub sentence: Option<String>,
}

/// Whether the model accounts for what is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum GapState {
    /// Too few measurements to say.
    Unknown,
    /// What the model leaves is noise.
    Noise,
    /// The model leaves more than noise.
    Above,
}

/// The gap between model and measurements.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GapStatus {
    /// The verdict.
    pub state: GapState,
    /// Mean square of the innovations' bending part in units of its predicted variance; 1 is noise.
    pub bending: f64,
    /// The same of the part that all backbones have in common.
    pub common: f64,
    /// Share of the last measurements that the gate rejected.
    pub rejected: f64,
}

impl Default for GapStatus {
    /// Before the first measurement.
    fn default() -> Self {
        Self { state: GapState::Unknown, bending: 1.0, common: 1.0, rejected: 0.0 }
    }
}

/// Whether the table in the folder is that of the model as it stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PublicationState {
    /// None was written yet.
    #[default]
    Nothing,
    /// It is, up to what was learned since it was written.
    Current,
    /// It was once; what was measured since does not confirm it, and the model as it stands may not replace it.
    Stale,
    /// None was written, because the model may not be published.
    Withheld,
}

/// The same with the reason; the content of publication.json.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct PublicationStatus {
    /// The state.
    pub state: PublicationState,
    /// How bad the reason is: red where nothing may be commanded by, amber where the table that was written last still may.
    pub level: Option<Level>,
    /// Why the model may not be published: a code of the verdict's.
    pub code: Option<Code>,
    /// The same in a sentence.
    pub reason: Option<String>,
}

/// What `discover` found on the measurements so far.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct DiscoveryStatus {
    /// Whether it is at work now.
    pub running: bool,
    /// `named`, `none` or `unexplained`; empty before the first answer.
    pub verdict: String,
    /// The answer in a sentence.
    pub sentence: String,
    /// The content of discrepancy.json.
    pub details: Option<serde_json::Value>,
    /// The structures that it left open, as the samples since then leave them; the most probable first.
    pub structures: Vec<Followed>,
    /// How probable they are, in a sentence with the latest frame that says so.
    pub followed: Option<String>,
}
