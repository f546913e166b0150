//! What `live` says at its end.

use crate::cli::verdict::verdict_text;
use crate::live::{EncoderStatus, Histogram, PublicationState, PublicationStatus, State, StemStatus};
use crate::verdict::Verdict;
use serde::Serialize;
use std::path::PathBuf;

/// The run in short.
#[derive(Serialize)]
pub(super) struct Summary {
    /// The last verdict.
    pub verdict: Verdict,
    frames: u64,
    dropped: u64,
    measurements: u64,
    measured: u64,
    eta: Option<f64>,
    lambda_mm: Option<f64>,
    #[serde(flatten)]
    stem: Option<StemStatus>,
    latency_p50_ms: f64,
    latency_p99_ms: f64,
    publication: PublicationStatus,
    /// What is wrong with frames and encoders at the end.
    troubles: Vec<String>,
    output: PathBuf,
    #[serde(skip)]
    histogram: String,
}

/// What is wrong with frames and encoders, in words.
fn troubles(state: &State) -> Vec<String> {
    let of_frames = state.source.trouble.as_ref().map(|trouble| format!("{}: {trouble}", state.source_name));
    let of_encoders = state.encoders.trouble.as_ref().map(|trouble| {
        let EncoderStatus { readings, bad_lines, .. } = state.encoders;
        format!("encoders: {trouble} ({readings} readings came, {bad_lines} lines could not be read)")
    });
    let of_lines =
        state.encoders.last_bad.as_ref().map(|bad| format!("encoders: the last line that could not be read: {bad}"));
    of_frames.into_iter().chain(of_encoders).chain(of_lines).collect()
}

impl Summary {
    /// Of a run that ended in this state.
    pub fn new(state: &State, latencies: &Histogram, output: PathBuf) -> Self {
        Self {
            verdict: state.verdict.clone(),
            frames: state.source.frames,
            dropped: state.source.dropped,
            measurements: state.measurements,
            measured: state.measured,
            eta: state.estimate.map(|estimate| estimate.parameters.eta),
            lambda_mm: state.estimate.map(|estimate| estimate.parameters.lambda_mm),
            stem: state.stem,
            latency_p50_ms: state.latency.p50_ms,
            latency_p99_ms: state.latency.p99_ms,
            publication: state.publication.clone(),
            troubles: troubles(state),
            output,
            histogram: latencies.text(),
        }
    }

    /// In lines.
    pub fn text(&self) -> String {
        let estimate = match (self.eta, self.lambda_mm) {
            (Some(eta), Some(lambda_mm)) => format!("η {eta:.4}, λ {lambda_mm:.4} mm"),
            _ => "η and λ are not known yet".to_owned(),
        };
        let stem =
            self.stem.map(|stem| format!(", Φ {:.1} ± {:.1}°", stem.phi_deg, stem.sd_phi_deg)).unwrap_or_default();
        let mut told: String = self.troubles.iter().map(|trouble| format!("{trouble}\n")).collect();
        if let Some(reason) = &self.publication.reason {
            told += &match self.publication.state {
                PublicationState::Stale => format!("the table is stale, the last one published stays: {reason}\n"),
                _ => format!("no table was written: {reason}\n"),
            };
        }
        verdict_text(&self.verdict)
            + &format!(
                "{told}{} frames, {} dropped; {} measured of {}\n{estimate}{stem}\nlatency p50 {:.1} ms, p99 {:.1} ms\n{}{}",
                self.frames,
                self.dropped,
                self.measured,
                self.measurements,
                self.latency_p50_ms,
                self.latency_p99_ms,
                self.histogram,
                self.output.display()
            )
    }
}
