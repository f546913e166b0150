//! The estimator's settings, as `run`, `estimate` and `live` take them.

use crate::estimate::{Options, StemOptions, Weighting};
use serde::{Deserialize, Serialize};

/// The estimator's settings.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, clap::Args)]
#[command(next_help_heading = "Estimator")]
pub struct EstimatorArgs {
    /// Weight all measurements alike, as the paper does (it takes 1°), instead of by their own sigmas
    #[arg(long, value_name = "DEGREES")]
    flat_sigma: Option<f64>,
    /// Forgetting factor: share of all earlier information kept at each measurement; 1 forgets nothing [default: 1; live: 0.9995;
    /// --stem: 0.95]
    #[arg(long, value_name = "SHARE", visible_alias = "keep")]
    #[serde(alias = "keep")]
    forgetting: Option<f64>,
    /// Standard deviations beyond which a measurement is rejected as an outlier
    #[arg(long, value_name = "SDS", default_value_t = Options::default().gate)]
    gate: f64,
    /// Standard deviation of an encoder reading, mm
    #[arg(long, value_name = "MM", default_value_t = Options::default().sd_encoder_mm)]
    encoder_sd: f64,
}

impl EstimatorArgs {
    /// The settings, with the command's own forgetting factor where none was given.
    pub fn options(&self, usual_forgetting: f64) -> Options {
        let weighting = match self.flat_sigma {
            Some(sigma_deg) => Weighting::Flat { sigma_deg },
            None => Weighting::Measured,
        };
        let forgetting = self.forgetting.unwrap_or(usual_forgetting);
        Options { weighting, sd_encoder_mm: self.encoder_sd, forgetting, gate: self.gate }
    }

    /// The same for a flexible stem.
    pub fn stem_options(self) -> StemOptions {
        let usual = StemOptions::default();
        StemOptions { forgetting: self.forgetting.unwrap_or(usual.forgetting), sd_encoder_mm: self.encoder_sd }
    }
}
