//! `evaluate`: the gap that a model leaves on data, and how far measurements are from a known truth.

use super::console::Console;
use super::inputs::{CommandedArgs, NamedLog, measurements_and_readings, model_or_paper, rows};
use super::verdict::{VerdictArgs, unit_is_stated, verdict_text};
use crate::cli::failure::Failure;
use crate::estimate::Options;
use crate::estimate::accuracy::{Accuracy, AngleScore, accuracy};
use crate::estimate::gap::{Gap, gap};
use crate::record::read_truth;
use crate::verdict::{Code, Level, Reason, Verdict, doubts_of_times, without_shared_force};
use crate::{Error, Result};
use serde::Serialize;
use std::path::PathBuf;

/// Show how well a model explains measurements, or how close measurements are to a known truth
///
/// The model's gap is the rms difference between measured and predicted ε over all backbones (mm), and between the measured θ and δ and
/// those predicted from the encoders (degrees). The rms that the measurements' noise alone would give stands beside it. δ counts if the
/// bend is 15° or more.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop evaluate --model out/model.toml --measurements out/measurements.csv \
                  --encoders fixtures/bending/encoders.csv --json")]
pub struct Args {
    /// The model (model.toml); by default the paper's, with Table I
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    /// The measurements (measurements.csv)
    #[arg(long, value_name = "CSV")]
    measurements: PathBuf,
    /// The encoder log (encoders.csv), or the experiment whose log it is, read as its [log] and [wiring] say
    #[arg(long, value_name = "CSV", required_unless_present = "truth")]
    encoders: Option<PathBuf>,
    /// The true angles of synthetic frames (truth.csv): scores the measurements themselves
    #[arg(long, value_name = "CSV")]
    truth: Option<PathBuf>,
    /// Standard deviation of an encoder reading, mm
    #[arg(long, value_name = "MM", default_value_t = Options::default().sd_encoder_mm)]
    encoder_sd: f64,
    #[command(flatten)]
    commanded: CommandedArgs,
    #[command(flatten)]
    verdict: VerdictArgs,
}

#[derive(Serialize)]
struct Evaluation {
    verdict: Verdict,
    #[serde(flatten)]
    gap: Option<Gap>,
    #[serde(skip_serializing_if = "Option::is_none")]
    accuracy: Option<Accuracy>,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        let model = model_or_paper(console, self.model.as_deref())?;
        let log = self.encoders.as_deref().map(NamedLog::open).transpose()?;
        let (measurements, readings) = measurements_and_readings(console, &model, &self.measurements, log.as_ref())?;
        let (readings, doubt_of_limits) = match &self.commanded.force_limits {
            Some(limits) => without_shared_force(&model, limits, (&measurements, &readings), self.encoder_sd),
            None => (readings, None),
        };
        let gap = match &self.encoders {
            None => None,
            Some(path) => {
                let gap = gap(&model, &measurements, &readings);
                if gap.samples == 0 {
                    let message = "no measurement with angles has an encoder reading of the same index in this file";
                    return Err(Error::content(path, message).into());
                }
                Some(gap)
            }
        };
        let accuracy = match &self.truth {
            None => None,
            Some(path) => {
                let accuracy = accuracy(&measurements, &rows(console, read_truth(path)?));
                if accuracy.frames == 0 {
                    return Err(Error::content(path, "no measurement has the index of a frame in this file").into());
                }
                Some(accuracy)
            }
        };
        let verdict = match &log {
            Some(log) => {
                let subject = log.subject(&model, self.encoder_sd)?;
                let doubts = doubts_of_times(&measurements, &readings, unit_is_stated(log.experiment.as_ref()));
                doubts.into_iter().chain(doubt_of_limits).fold(subject.verdict(&measurements, &readings), Verdict::and)
            }
            None => Verdict::of(vec![Reason::new(
                Code::NothingToJudge,
                Level::Look,
                "no --encoders: the measurements are compared with the truth, and no model is judged",
                "give --encoders to judge a model",
            )]),
        };
        let evaluation = Evaluation { verdict, gap, accuracy };
        console.result(&evaluation, || evaluation.text());
        if evaluation.verdict.has(Code::GapAboveNoise) {
            console.next("snakeloop discover with the same files says what the model lacks");
        }
        self.verdict.check(&evaluation.verdict)
    }
}

impl Evaluation {
    fn text(&self) -> String {
        let mut text = verdict_text(&self.verdict);
        if let Some(gap) = &self.gap {
            text += &format!(
                "samples      {}\nrms of ε     {:.5} mm (noise alone: {:.5} mm)\nrms of θ     {:.3}°\n\
                 rms of δ     {:.3}° ({} samples bent by 15° or more)\n",
                gap.samples,
                gap.rms_eps_mm,
                gap.noise_floor_mm,
                gap.rms_theta_deg,
                gap.rms_delta_deg,
                gap.delta_samples
            );
            if gap.unpredicted > 0 {
                text +=
                    &format!("no prediction for {} samples: their encoders lie outside the model\n", gap.unpredicted);
            }
        }
        if let Some(accuracy) = &self.accuracy {
            text += &format!(
                "against the truth: {} of {} frames measured\n{}{}",
                accuracy.measured,
                accuracy.frames,
                against_truth("θ", &accuracy.theta),
                against_truth("δ", &accuracy.delta)
            );
        }
        text
    }
}

fn against_truth(angle: &str, score: &AngleScore) -> String {
    if score.samples == 0 {
        return format!("error of {angle}   no frame to score\n");
    }
    format!(
        "error of {angle}   rms {:.4}°, mean {:+.4}°, worst {:.4}° (frame {}), {:.1} % within 3σ, reduced χ² {:.2}, {} frames\n",
        score.rms_deg,
        score.mean_deg,
        score.worst_deg,
        score.worst_index.unwrap_or_default(),
        100.0 * score.within_3_sigma,
        score.reduced_chi2,
        score.samples
    )
}
