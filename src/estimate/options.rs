//! How the estimator works: its settings, and what they may be.

use super::Weighting;
use crate::error::{ArgumentError, Result};

/// The largest standard deviation of an encoder reading that is taken for one, mm.
///
/// Convention: a slip of units (µm for mm) shows as an error instead of as an estimate that nothing can move.
const MOST_SD_ENCODER_MM: f64 = 10.0;

/// How the estimator works.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// How measurements are weighted.
    pub weighting: Weighting,
    /// Standard deviation of an encoder reading, mm.
    pub sd_encoder_mm: f64,
    /// Forgetting factor: the share of all earlier information that is kept at each measurement, in (0, 1]; 1 forgets nothing.
    pub forgetting: f64,
    /// Standard deviations beyond which a measurement is an outlier; infinity accepts all.
    pub gate: f64,
}

impl Default for Options {
    /// Each measurement's own sigmas, encoders good to 1.5 µm, nothing forgotten, a gate at 4.5 standard deviations.
    fn default() -> Self {
        Self {
            weighting: Weighting::Measured,
            sd_encoder_mm: DEFAULT_SD_ENCODER_MM,
            forgetting: 1.0,
            gate: DEFAULT_GATE_SD,
        }
    }
}

/// The standard deviation of an encoder reading where none is given, mm.
///
/// Convention: a default that `--encoder-sd` replaces; it is that of the project's simulated robots.
pub(super) const DEFAULT_SD_ENCODER_MM: f64 = 0.0015;
/// The gate where none is given, in standard deviations.
///
/// Derived: the two numbers of a bend's residual are beyond 4.5 σ with probability e^(−4.5²/2) = 4·10⁻⁵, the common part with 7·10⁻⁶, so
/// that noise alone rejects one measurement in 20,000.
pub(super) const DEFAULT_GATE_SD: f64 = 4.5;

impl Options {
    /// # Errors
    /// [`ArgumentError::OutOfRange`] for an option out of its range.
    pub(super) fn check(&self) -> Result<()> {
        check_sd_encoder(self.sd_encoder_mm)?;
        check_forgetting(self.forgetting)?;
        if self.gate.is_nan() || self.gate < 1.0 {
            return wrong("the gate", self.gate, " standard deviations", "1 or more");
        }
        match self.weighting {
            Weighting::Flat { sigma_deg } if !(sigma_deg > 0.0 && sigma_deg <= 90.0) => {
                wrong("the flat sigma", sigma_deg, "°", "above 0 and at most 90")
            }
            _ => Ok(()),
        }
    }
}

fn wrong(quantity: &str, value: f64, unit: &'static str, expected: &str) -> Result<()> {
    Err(ArgumentError::out_of_range(quantity, value, unit, expected).into())
}

/// # Errors
/// [`ArgumentError::OutOfRange`] for encoder noise (mm) that is not above 0 and at most 10.
pub(super) fn check_sd_encoder(sd_mm: f64) -> Result<()> {
    if sd_mm > 0.0 && sd_mm <= MOST_SD_ENCODER_MM {
        return Ok(());
    }
    wrong("encoder noise", sd_mm, " mm", &format!("above 0 and at most {MOST_SD_ENCODER_MM}"))
}

/// # Errors
/// [`ArgumentError::OutOfRange`] for a forgetting factor that is not in (0, 1].
pub(super) fn check_forgetting(factor: f64) -> Result<()> {
    if factor > 0.0 && factor <= 1.0 {
        return Ok(());
    }
    wrong("the forgetting factor", factor, "", "above 0 and at most 1 (1 forgets nothing)")
}
