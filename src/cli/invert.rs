//! `invert`: the compensation for one pose, either way round.

use super::console::Console;
use super::inputs::model_or_paper;
use crate::geometry::Configuration;
use crate::robot::{MAX_THETA, Model};
use crate::{Error, Result};
use nalgebra::Vector3;
use serde::Serialize;
use std::path::PathBuf;

/// Answer one pose: what to command for θ and δ, or what θ and δ a command leads to
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop invert --model out/model.toml --theta-deg 30 --delta-deg 45\n  \
                  snakeloop invert --model out/model.toml --qc-mm=-0.72,0.61,0.68")]
pub struct Args {
    /// The model (model.toml); without it the paper's, with Table I
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    /// The wanted bend from straight, degrees
    #[arg(long, value_name = "DEGREES", required_unless_present = "qc_mm", requires = "delta_deg")]
    theta_deg: Option<f64>,
    /// The wanted azimuth of the bend, degrees
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true, requires = "theta_deg")]
    delta_deg: Option<f64>,
    /// The other way round: the three commands q̃ in mm, separated by commas
    #[arg(
        long,
        value_name = "Q1,Q2,Q3",
        value_delimiter = ',',
        allow_hyphen_values = true,
        conflicts_with_all = ["theta_deg", "delta_deg"]
    )]
    qc_mm: Option<Vec<f64>>,
}

/// One row of the compensation table, or its inverse; names as in compensation.csv.
#[derive(Serialize)]
struct Pose {
    theta_deg: f64,
    delta_deg: f64,
    q_mm: [f64; 3],
    qc_mm: [f64; 3],
    /// What the uncertainty of η and λ does to the answer: to q̃ where the pose was given, to the pose where q̃ was.
    /// Absent where nothing was estimated.
    #[serde(skip_serializing_if = "Option::is_none")]
    sd_qc_mm: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    sd_theta_deg: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    sd_delta_deg: Option<f64>,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<()> {
        let model = model_or_paper(self.model.as_deref())?;
        let pose = match (&self.qc_mm, self.theta_deg, self.delta_deg) {
            (Some(qc_mm), _, _) => {
                let &[a, b, c] = &qc_mm[..] else {
                    return Err(Error::Usage(format!("--qc-mm: {} numbers, expected 3", qc_mm.len())));
                };
                Pose::reached(&model, Vector3::new(a, b, c))?
            }
            (None, Some(theta_deg), Some(delta_deg)) => Pose::wanted(&model, theta_deg, delta_deg)?,
            _ => return Err(Error::Usage("give --theta-deg and --delta-deg, or --qc-mm".to_owned())),
        };
        console.result(&pose, || pose.text());
        Ok(())
    }
}

impl Pose {
    fn wanted(model: &Model, theta_deg: f64, delta_deg: f64) -> Result<Self> {
        let most = MAX_THETA.to_degrees();
        if !(0.0..=most).contains(&theta_deg) || !delta_deg.is_finite() {
            return Err(Error::Domain(format!(
                "θ = {theta_deg}°, δ = {delta_deg}° is outside the workspace, expected θ from 0 to {most:.0}°"
            )));
        }
        let psi = Configuration::from_degrees(theta_deg, delta_deg);
        let sd = model.command_covariance(psi).diagonal().map(|variance| variance.max(0.0).sqrt());
        let estimated = model.estimate.is_some();
        Ok(Self {
            theta_deg: psi.theta_deg(),
            delta_deg: psi.delta_deg(),
            q_mm: model.robot.joint_displacements(psi).into(),
            qc_mm: model.command(psi).into(),
            sd_qc_mm: estimated.then(|| sd.into()),
            sd_theta_deg: None,
            sd_delta_deg: None,
        })
    }

    fn reached(model: &Model, qc_mm: Vector3<f64>) -> Result<Self> {
        let psi = model.forward(&qc_mm)?.configuration;
        // Exactly straight, δ means nothing and has no sd.
        let covariance = model.estimate.and_then(|_| model.response_covariance(psi).ok());
        let sd = covariance.map(|c| c.diagonal().map(|variance| variance.max(0.0).sqrt().to_degrees()));
        Ok(Self {
            theta_deg: psi.theta_deg(),
            delta_deg: psi.delta_deg(),
            q_mm: model.robot.joint_displacements(psi).into(),
            qc_mm: qc_mm.into(),
            sd_qc_mm: None,
            sd_theta_deg: sd.map(|sd| sd.x),
            sd_delta_deg: sd.map(|sd| sd.y),
        })
    }

    fn text(&self) -> String {
        let with_sd = |value: f64, sd: Option<f64>, places: usize| match sd {
            Some(sd) => format!("{value:.places$} ± {sd:.places$}"),
            None => format!("{value:.places$}"),
        };
        let mut text = format!(
            "theta    {}°\ndelta    {}°\n\nbackbone   desired q (mm)   command q̃ (mm)\n",
            with_sd(self.theta_deg, self.sd_theta_deg, 3),
            with_sd(self.delta_deg, self.sd_delta_deg, 3)
        );
        for i in 0..3 {
            let command = with_sd(self.qc_mm[i], self.sd_qc_mm.map(|sd| sd[i]), 5);
            text += &format!("{:>8}   {:>14.5}   {command}\n", i + 1, self.q_mm[i]);
        }
        text
    }
}
