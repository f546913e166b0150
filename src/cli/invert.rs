//! `invert`: the compensation for one pose, either way round.

use super::console::Console;
use super::inputs::{WorthArgs, tell_of_learning, tell_of_missed_poses, with_effects};
use crate::Result;
use crate::cli::failure::Failure;
use crate::quantity::{decimal, with_sd};
use crate::record::stale_mark;
use crate::robot::{Effect, MAX_THETA, Model, PerBackbone, TableRow};
use crate::verdict::MOST_LAMBDA_MM;
use nalgebra::Vector2;
use serde_json::{Map, Value};
use std::f64::consts::PI;
use std::path::PathBuf;

/// Answer one pose: what to command for θ and δ, or what θ and δ a command leads to
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop invert --model out/model.toml --theta-deg 30 --delta-deg 45\n  \
                  snakeloop invert --model out/model.toml --qc-mm=-0.72,0.61,0.68")]
pub struct Args {
    /// The model (model.toml); by default the paper's, with Table I
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    /// An effect in addition to those of the model, such as tip_load:fx_n=0.2,fy_n=0,fz_n=0; may be repeated
    #[arg(long, value_name = "NAME:PARAMETER=VALUE,...", value_parser = Effect::parse)]
    effect: Vec<Effect>,
    /// The wanted bend from straight, degrees
    #[arg(long, value_name = "DEGREES", required_unless_present = "qc_mm", requires = "delta_deg")]
    theta_deg: Option<f64>,
    /// The wanted azimuth of the bend, degrees
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true, requires = "theta_deg")]
    delta_deg: Option<f64>,
    /// The other way round: the commands q̃ in mm, one for each backbone, separated by commas
    #[arg(
        long,
        value_name = "Q1,Q2,...",
        value_delimiter = ',',
        allow_hyphen_values = true,
        conflicts_with_all = ["theta_deg", "delta_deg"]
    )]
    qc_mm: Option<Vec<f64>>,
    #[command(flatten)]
    worth: WorthArgs,
}

/// A part of q̃ that bends nothing is shown from here on, mm. Convention: what encoders resolve.
const SHOWN_MM: f64 = 0.01;

/// One row of the compensation table, or its inverse.
struct Pose {
    theta_deg: f64,
    delta_deg: f64,
    q_mm: PerBackbone,
    qc_mm: PerBackbone,
    sd: Option<Sd>,
    /// What of a command bends nothing, where one was given.
    internal: Option<Internal>,
    /// Whether the pose is beyond the bends that the model was learned on.
    extrapolated: bool,
    /// Why the answer must not be used.
    do_not_use: Option<String>,
    /// Why the model is stale.
    stale: Option<String>,
}

/// A part of q̃ that bends nothing, beyond what the model explains: the backbones press against each other and the base.
struct Internal {
    /// Of each backbone, mm.
    mm: PerBackbone,
    /// The force that goes with it in each, N; positive compresses.
    force_n: PerBackbone,
}

impl Internal {
    /// A warning where the part is larger than a play can be: nobody who wanted the bend would have commanded it.
    fn warning(&self) -> Option<String> {
        let (mm, force_n) = (self.mm.amax(), self.force_n.amax());
        (mm > MOST_LAMBDA_MM).then(|| {
            format!(
                "up to {mm:.3} mm of these commands bend nothing: they press the backbones against each other and the base with {force_n:.0} N each. \
                 Commands for a bend come from --theta-deg and --delta-deg; of readings, see that the encoders read 0 \
                 where the snake is straight and its lines are slack"
            )
        })
    }
}

/// What the uncertainty of η and λ does to the answer; nothing is known of it where nothing was estimated.
enum Sd {
    /// To q̃, where the pose was given.
    CommandMm(PerBackbone),
    /// To θ and δ, where q̃ was given.
    PoseDeg(Vector2<f64>),
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        let (model, do_not_use) = self.worth.model(console, self.model.as_deref())?;
        let model = with_effects(console, model, &self.effect)?;
        console.warn(model.conditions_of_single_poses());
        if self.model.is_some() {
            tell_of_learning(console, &model);
        }
        let pose = match (&self.qc_mm, self.theta_deg, self.delta_deg) {
            (Some(qc_mm), _, _) => {
                let backbones = model.robot.backbone_count();
                let fitting = PerBackbone::of(qc_mm).filter(|qc_mm| qc_mm.len() == backbones);
                let qc_mm = fitting.ok_or_else(|| {
                    Failure::Usage(format!(
                        "--qc-mm: {} numbers, expected {backbones}, one for each backbone",
                        qc_mm.len()
                    ))
                })?;
                let pose = Pose::reached(&model, qc_mm)?;
                console.warn(pose.internal.as_ref().and_then(Internal::warning));
                pose
            }
            (None, Some(theta_deg), Some(delta_deg)) => {
                console.warn(looks_like_radians(theta_deg, delta_deg));
                let row = TableRow::asked(&model, theta_deg, delta_deg)?;
                tell_of_missed_poses(console, &model, std::slice::from_ref(&row));
                Pose::wanted(&model, row)
            }
            _ => return Err(Failure::Usage("give --theta-deg and --delta-deg, or --qc-mm".to_owned())),
        };
        let stale = self.model.as_deref().and_then(stale_mark);
        let pose = Pose { do_not_use, stale, ..pose };
        console.result(&pose.json(), || pose.text());
        Ok(())
    }
}

/// A warning where both angles are such as radians would be: within their range, and not whole numbers.
fn looks_like_radians(theta_deg: f64, delta_deg: f64) -> Option<String> {
    let within = theta_deg > 0.0 && theta_deg <= MAX_THETA && delta_deg.abs() <= PI;
    (within && (theta_deg.fract() != 0.0 || delta_deg.fract() != 0.0)).then(|| {
        format!(
            "theta {theta_deg} and delta {delta_deg} are taken as degrees; if they are radians, give --theta-deg {:.3} --delta-deg {:.3}",
            theta_deg.to_degrees(),
            delta_deg.to_degrees()
        )
    })
}

impl Pose {
    fn wanted(model: &Model, row: TableRow) -> Self {
        Self {
            theta_deg: row.configuration.theta_deg(),
            delta_deg: row.configuration.delta_deg(),
            q_mm: row.q_mm,
            qc_mm: row.command_mm,
            sd: model.estimate().map(|_| Sd::CommandMm(row.sd_command_mm)),
            internal: None,
            extrapolated: row.extrapolated,
            do_not_use: None,
            stale: None,
        }
    }

    fn reached(model: &Model, qc_mm: PerBackbone) -> Result<Self> {
        let response = model.forward(&qc_mm)?;
        let psi = response.configuration;
        let force_n = response.residual_mm.map(|mm| mm / model.line_compliance_mm_per_n());
        // Exactly straight, δ means nothing and has no sd.
        let covariance = model.estimate().and_then(|_| model.response_covariance(psi).ok());
        let sd = covariance.map(|c| Sd::PoseDeg(c.diagonal().map(|variance| variance.max(0.0).sqrt().to_degrees())));
        Ok(Self {
            theta_deg: psi.theta_deg(),
            delta_deg: psi.delta_deg(),
            q_mm: model.robot.joint_displacements(psi),
            qc_mm,
            sd,
            internal: Some(Internal { mm: response.residual_mm, force_n }),
            extrapolated: model.learned.is_some_and(|range| !range.covers(psi)),
            do_not_use: None,
            stale: None,
        })
    }

    /// Names as in compensation.csv.
    fn json(&self) -> Map<String, Value> {
        let mut fields = vec![("theta_deg".to_owned(), self.theta_deg), ("delta_deg".to_owned(), self.delta_deg)];
        let mut backbones = |name: &str, values: &PerBackbone| {
            fields.extend((1..).zip(values).map(|(i, &value)| (format!("{name}{i}_mm"), value)));
        };
        backbones("q", &self.q_mm);
        backbones("qc", &self.qc_mm);
        if let Some(internal) = &self.internal {
            backbones("internal", &internal.mm);
        }
        match &self.sd {
            Some(Sd::CommandMm(sd)) => backbones("sd_qc", sd),
            Some(Sd::PoseDeg(sd)) => {
                fields.extend([("sd_theta_deg".to_owned(), sd.x), ("sd_delta_deg".to_owned(), sd.y)])
            }
            None => {}
        }
        let rounded = |value: f64| Value::from((value * 1e9).round() / 1e9);
        let mut json: Map<_, _> = fields.into_iter().map(|(name, value)| (name, rounded(value))).collect();
        json.insert("extrapolated".to_owned(), u8::from(self.extrapolated).into());
        let marks = [("do_not_use", &self.do_not_use), ("stale", &self.stale)];
        json.extend(marks.into_iter().filter_map(|(name, why)| Some((name.to_owned(), why.clone()?.into()))));
        json
    }

    fn text(&self) -> String {
        let shown = |value: f64, sd: Option<f64>, places: usize| match sd {
            Some(sd) => with_sd(value, sd),
            None => decimal(value, places),
        };
        let (sd_command, sd_pose) = match &self.sd {
            Some(Sd::CommandMm(sd)) => (Some(sd), None),
            Some(Sd::PoseDeg(sd)) => (None, Some(sd)),
            None => (None, None),
        };
        let mut text = format!(
            "theta    {}°\ndelta    {}°\n\nbackbone   desired q (mm)   command q̃ (mm)\n",
            shown(self.theta_deg, sd_pose.map(|sd| sd.x), 3),
            shown(self.delta_deg, sd_pose.map(|sd| sd.y), 3)
        );
        for i in 0..self.q_mm.len() {
            let command = shown(self.qc_mm[i], sd_command.map(|sd| sd[i]), 5);
            text += &format!("{:>8}   {:>14.5}   {command}\n", i + 1, self.q_mm[i]);
        }
        if let Some(internal) = self.internal.as_ref().filter(|internal| internal.mm.amax() >= SHOWN_MM) {
            let of_each: Vec<String> = internal.mm.iter().map(|&mm| decimal(mm, 3)).collect();
            text += &format!(
                "bends nothing: {} mm of q̃, up to {:.1} N in a backbone\n",
                of_each.join(", "),
                internal.force_n.amax()
            );
        }
        if self.extrapolated {
            text += "extrapolated: beyond the bends that the model was learned on\n";
        }
        text += &self.do_not_use.as_ref().map_or(String::new(), |why| format!("do not use: {why}\n"));
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_that_may_be_radians_are_told_and_others_are_not() {
        assert!(looks_like_radians(0.52, 0.8).unwrap().contains("--theta-deg 29.794 --delta-deg 45.837"));
        for (theta_deg, delta_deg) in [(30.0, 0.5), (1.0, 0.0), (0.0, 0.3), (1.5, 45.0)] {
            assert_eq!(looks_like_radians(theta_deg, delta_deg), None, "{theta_deg}, {delta_deg}");
        }
    }
}
