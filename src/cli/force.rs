//! `force`: the tip force that explains measured deflections.

use super::console::Console;
use super::inputs::{NamedLog, measurements_and_readings, model_that_may_be_used};
use super::verdict::{VerdictArgs, verdict_text};
use crate::Result;
use crate::cli::failure::Failure;
use crate::estimate::Options;
use crate::quantity::with_sd;
use crate::record::{forces_csv, write_atomically};
use crate::verdict::{JudgedForce, Verdict};
use serde::Serialize;
use std::path::PathBuf;

/// Find the force on the tip that explains measured deflections: writes OUT/force.csv
///
/// A single measurement shows two of three directions of the force, and force.csv has the one that it cannot show. The printed force explains all
/// measurements together.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop force --model out/model.toml --measurements loaded/measurements.csv \
                  --encoders loaded/encoders.csv -o loaded")]
pub struct Args {
    /// The model with the η and λ of the unloaded snake (model.toml)
    #[arg(long, value_name = "MODEL")]
    model: PathBuf,
    /// The measurements (measurements.csv)
    #[arg(long, value_name = "CSV")]
    measurements: PathBuf,
    /// The encoder log (encoders.csv), or the experiment whose log it is, read as its [log] and [wiring] say
    #[arg(long, value_name = "CSV")]
    encoders: PathBuf,
    /// The folder to write to; created if it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Standard deviation of an encoder reading, mm
    #[arg(long, value_name = "MM", default_value_t = Options::default().sd_encoder_mm)]
    encoder_sd: f64,
    #[command(flatten)]
    verdict: VerdictArgs,
}

#[derive(Serialize)]
struct Found {
    /// In {b}; nothing of it lies along the unseen directions.
    force_n: [f64; 3],
    covariance_n2: [[f64; 3]; 3],
    unseen: Vec<[f64; 3]>,
    used: usize,
    output: PathBuf,
    verdict: Verdict,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        let model = model_that_may_be_used(console, &self.model)?;
        let log = NamedLog::open(&self.encoders)?;
        let (measurements, readings) = measurements_and_readings(console, &model, &self.measurements, Some(&log))?;
        let data = (&measurements[..], &readings[..]);
        let JudgedForce { rows, force, verdict } =
            JudgedForce::of(&model, self.encoder_sd, data, |model| log.subject(model, self.encoder_sd))?;
        let output = self.output.join("force.csv");
        write_atomically(&output, forces_csv(&rows).as_bytes())?;
        let found = Found {
            force_n: force.force_n.into(),
            covariance_n2: force.covariance_n2.into(),
            unseen: force.unseen.iter().map(|&direction| direction.into()).collect(),
            used: rows.iter().filter(|row| row.force.is_some()).count(),
            output,
            verdict,
        };
        console.result(&found, || {
            let sd = force.covariance_n2.diagonal().map(|variance| variance.max(0.0).sqrt());
            let part = |name: &str, k: usize| format!("{name}  {} N\n", with_sd(force.force_n[k], sd[k]));
            let unseen = force.unseen.iter().map(|u| format!("unseen along ({:+.2}, {:+.2}, {:+.2})\n", u.x, u.y, u.z));
            verdict_text(&found.verdict)
                + &part("Fx", 0)
                + &part("Fy", 1)
                + &part("Fz", 2)
                + &unseen.collect::<String>()
                + &format!("{} measurements\n{}", found.used, found.output.display())
        });
        self.verdict.check(&found.verdict)
    }
}
