//! What the estimator says of each measurement: whether it was used, and the estimate after it.

use crate::robot::{Estimate, PerBackbone};
use serde::Serialize;
use std::fmt;

/// What became of a measurement in the estimator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// It moved the estimate.
    Used,
    /// The gate took it for an outlier.
    Rejected,
    /// There was nothing to use: no angles, or no encoder reading.
    Skipped,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Used => "used",
            Self::Rejected => "rejected",
            Self::Skipped => "skipped",
        })
    }
}

/// η and λ with their standard deviations.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct EtaLambda {
    /// η, the scale of the actuation forces.
    pub eta: f64,
    /// Standard deviation of η.
    pub sd_eta: f64,
    /// λ, the backlash, mm.
    pub lambda_mm: f64,
    /// Standard deviation of λ, mm.
    pub sd_lambda_mm: f64,
}

impl From<Estimate> for EtaLambda {
    fn from(estimate: Estimate) -> Self {
        let (sd_eta, sd_lambda_mm) = (estimate.sd_eta(), estimate.sd_lambda_mm());
        Self { eta: estimate.eta, sd_eta, lambda_mm: estimate.lambda_mm, sd_lambda_mm }
    }
}

/// One row of estimate.csv: one measurement and the estimate after it.
#[derive(Debug, Clone, PartialEq)]
pub struct EstimateRow {
    /// The frame's index.
    pub index: u64,
    /// Time, s.
    pub time_s: Option<f64>,
    /// The estimate after this measurement; `None` while there were too few.
    pub estimate: Option<EtaLambda>,
    /// What became of the measurement.
    pub verdict: Verdict,
    /// Why it was not used, in snake_case; empty where it was.
    pub reason: String,
    /// Measured ε less predicted ε per backbone, mm.
    pub residual_mm: Option<PerBackbone>,
    /// The view's name.
    pub view: Option<String>,
}
