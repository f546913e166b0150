//! `estimate`: measurements to model.toml and estimate.csv.

use super::console::Console;
use super::estimator::EstimatorArgs;
use super::inputs::{CommandedArgs, NamedLog, WorthArgs, measurements_and_readings, tell_of_data_seen, with_effects};
use super::verdict::{VerdictArgs, unit_is_stated, verdict_text};
use crate::cli::failure::Failure;
use crate::estimate::{EstimateRow, EtaLambda, Verdict as RowVerdict};
use crate::observation::{EncoderReading, Measurement, commonest_status};
use crate::quantity::with_sd;
use crate::record::{
    Files, OutputFolder, Provenance, estimates_csv, learned_model_toml, stems_csv, tables_marked_stale, write_together,
};
use crate::robot::{Effect, Estimate, Model};
use crate::verdict::{Code, JudgedEstimate, JudgedStem, Level, Reason, Verdict};
use crate::{Error, Result};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Update η and λ from measurements and encoder readings: writes OUT/model.toml and OUT/estimate.csv
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop estimate --measurements out/measurements.csv \
                  --encoders fixtures/bending/encoders.csv -o out")]
pub struct Args {
    /// The measurements (measurements.csv)
    #[arg(long, value_name = "CSV")]
    measurements: PathBuf,
    /// The encoder log (encoders.csv), or the experiment whose log it is, read as its [log] and [wiring] say
    #[arg(long, value_name = "CSV")]
    encoders: PathBuf,
    /// The model that gives robot and friction (model.toml); by default the paper's, with Table I
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    /// An effect in addition to those of the model, such as tip_load:fx_n=0.2,fy_n=0,fz_n=0; may be repeated
    #[arg(long, value_name = "NAME:PARAMETER=VALUE,...", value_parser = Effect::parse)]
    effect: Vec<Effect>,
    /// The folder to write to; created if it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    #[command(flatten)]
    commanded: CommandedArgs,
    /// Follow the total bending angle of a flexible stem instead, with η and λ of --model known: writes OUT/stem.csv, and
    /// OUT/model.toml with the stem's last angle
    #[arg(long, requires = "model", conflicts_with_all = ["flat_sigma", "gate", "force_limits"])]
    stem: bool,
    #[command(flatten)]
    estimator: EstimatorArgs,
    #[command(flatten)]
    verdict: VerdictArgs,
    #[command(flatten)]
    worth: WorthArgs,
}

/// The stem's angle as results are printed.
#[derive(Debug, Serialize)]
struct Followed {
    phi_deg: f64,
    sd_phi_deg: f64,
    used: usize,
    skipped: usize,
    output: PathBuf,
    verdict: Verdict,
}

/// The verdict and the result below it.
#[derive(Debug, Serialize)]
struct Summary {
    verdict: Verdict,
    #[serde(flatten)]
    estimated: Estimated,
}

/// η and λ as results are printed, and what became of the measurements.
#[derive(Debug, Serialize)]
pub struct Estimated {
    /// `None` where the measurements do not pin them.
    #[serde(flatten)]
    pub parameters: Option<EtaLambda>,
    pub used: usize,
    pub rejected: usize,
    pub skipped: usize,
    /// How often each reason for not using a measurement came up.
    pub reasons: BTreeMap<String, usize>,
    /// The first frames whose measurement was rejected.
    pub rejected_frames: Vec<u64>,
}

impl Args {
    /// The files that are read.
    fn files(&self, log: &NamedLog) -> Vec<PathBuf> {
        let others = [Some(&self.measurements), self.model.as_ref()].into_iter().flatten().cloned();
        others.chain(log.files()).collect()
    }

    fn made_from(&self, log: &NamedLog) -> Result<Provenance> {
        Provenance::new("estimate")
            .with_options(&self.estimator)?
            .with_options(&self.commanded)?
            .with_inputs(self.files(log))
    }

    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        const OUTPUTS: [&str; 3] = ["model.toml", "estimate.csv", "stem.csv"];
        let log = NamedLog::open(&self.encoders)?;
        let _out = OutputFolder::claim(&self.output, &OUTPUTS, &self.files(&log))?;
        let (model, do_not_use) = self.worth.model(console, self.model.as_deref())?;
        tell_of_data_seen(console, &model, self.model.as_deref(), &self.measurements)?;
        let model = with_effects(console, model, &self.effect)?;
        let (measurements, encoders) = measurements_and_readings(console, &model, &self.measurements, Some(&log))?;
        if self.stem {
            return self.follow_stem(console, (&model, do_not_use.as_deref()), &log, (&measurements, &encoders));
        }
        let options = self.estimator.options(1.0);
        let (limits, is_stated) = (self.commanded.force_limits, unit_is_stated(log.experiment.as_ref()));
        let JudgedEstimate { rows, model, verdict, .. } =
            JudgedEstimate::of(&model, options, limits.as_ref(), (&measurements, &encoders), is_stated, |model| {
                log.subject(model, options.sd_encoder_mm)
            })?;
        let estimated = Estimated::of(&rows, model.estimate());
        let verdict = do_not_use.as_deref().map(bad_start).into_iter().fold(verdict, Verdict::and);
        let mut files = Vec::new();
        if model.estimate().is_some() {
            files = self.beside_model(learned_model_toml(&model, Some(&verdict), &self.made_from(&log)?)?)?;
        }
        // The rows stand beside the model that they led to, and not beside an earlier one.
        if model.estimate().is_some() || !self.output.join("model.toml").exists() {
            files.push((self.output.join("estimate.csv"), estimates_csv(&rows, model.robot.backbone_count())));
        }
        write_together(&files)?;
        let summary = Summary { verdict, estimated };
        console.result(&summary, || verdict_text(&summary.verdict) + &summary.estimated.text());
        console.next(match summary.verdict.level {
            Level::DoNotUse => "follow the remedy of the first reason, then estimate again".to_owned(),
            _ if summary.verdict.has(Code::GapAboveNoise) => {
                "snakeloop discover with the same files says what the model lacks".to_owned()
            }
            Level::Good | Level::Look => {
                format!("snakeloop table --model {} -o table", self.output.join("model.toml").display())
            }
        });
        summary.estimated.require_parameters(&self.measurements)?;
        self.verdict.check(&summary.verdict)
    }

    /// model.toml, and the tables of an earlier call as they are marked beside it.
    fn beside_model(&self, text: String) -> Result<Files> {
        let mut files = tables_marked_stale(&self.output, OTHER_MODEL)?;
        files.push((self.output.join("model.toml"), text));
        Ok(files)
    }

    fn follow_stem(
        &self,
        console: &Console,
        (start, do_not_use): (&Model, Option<&str>),
        log: &NamedLog,
        data: (&[Measurement], &[EncoderReading]),
    ) -> Result<(), Failure> {
        let (options, made_from) = (self.estimator.stem_options(), self.made_from(log)?);
        let JudgedStem { rows, model, verdict } =
            JudgedStem::of(start, options, data, |model| log.subject(model, options.sd_encoder_mm))?;
        let verdict = do_not_use.map(bad_start).into_iter().fold(verdict, Verdict::and);
        let used = rows.iter().filter(|row| row.reason.is_none()).count();
        let Some(last) = rows.last().filter(|_| used > 0) else {
            let message = "no measurement could be used; angles with status ok and encoder readings are needed";
            return Err(Error::content(&self.measurements, message).into());
        };
        let output = self.output.join("stem.csv");
        let mut files = self.beside_model(learned_model_toml(&model, Some(&verdict), &made_from)?)?;
        files.push((output.clone(), stems_csv(&rows)));
        write_together(&files)?;
        let followed = Followed {
            phi_deg: last.phi.to_degrees(),
            sd_phi_deg: last.sd_phi.to_degrees(),
            used,
            skipped: rows.len() - used,
            output,
            verdict,
        };
        console.result(&followed, || {
            format!(
                "{}Φ at the end  {}°\nmeasurements  {used} used, {} skipped\n{}",
                verdict_text(&followed.verdict),
                with_sd(followed.phi_deg, followed.sd_phi_deg),
                followed.skipped,
                followed.output.display()
            )
        });
        self.verdict.check(&followed.verdict)
    }
}

/// Why tables of an earlier call in the same folder are stale.
const OTHER_MODEL: &str = "`estimate` has learned model.toml beside it anew; `table` makes it of that model";

/// The reason that a start with a model that must not be used makes.
fn bad_start(why: &str) -> Reason {
    let text = format!("the starting model must not be used: {why}");
    Reason::new(Code::Files, Level::DoNotUse, text, "start with a model that can be used (--model)")
}

/// Rejected frames that are named. Convention: a display choice; estimate.csv has all.
const NAMED: usize = 5;

impl Estimated {
    /// What became of the rows.
    pub fn of(rows: &[EstimateRow], estimate: Option<Estimate>) -> Self {
        let count = |verdict| rows.iter().filter(|row| row.verdict == verdict).count();
        let rejected = rows.iter().filter(|row| row.verdict == RowVerdict::Rejected);
        let mut reasons = BTreeMap::new();
        for row in rows.iter().filter(|row| row.verdict != RowVerdict::Used) {
            *reasons.entry(row.reason.clone()).or_default() += 1;
        }
        Self {
            parameters: estimate.map(EtaLambda::from),
            used: count(RowVerdict::Used),
            rejected: count(RowVerdict::Rejected),
            skipped: count(RowVerdict::Skipped),
            reasons,
            rejected_frames: rejected.map(|row| row.index).take(NAMED).collect(),
        }
    }

    /// An error where the measurements pinned no estimate. `source` is named in it.
    pub fn require_parameters(&self, source: &Path) -> Result<()> {
        if self.parameters.is_some() {
            return Ok(());
        }
        let why: Vec<_> = self.reasons.iter().map(|(reason, count)| format!("{reason} {count}")).collect();
        let message = format!(
            "{} measurements give no estimate of η and λ; at least two that differ in bend and have encoder readings are needed \
             (not used: {}){}",
            self.used + self.rejected + self.skipped,
            if why.is_empty() { "none".to_owned() } else { why.join(", ") },
            commonest_status(&self.reasons).map(|told| format!("; {told}")).unwrap_or_default()
        );
        Err(Error::content(source, message))
    }

    /// Lines for people.
    pub fn text(&self) -> String {
        let lines = self.parameters.map(|EtaLambda { eta, sd_eta, lambda_mm, sd_lambda_mm }| {
            format!("η             {}\nλ             {} mm\n", with_sd(eta, sd_eta), with_sd(lambda_mm, sd_lambda_mm))
        });
        format!("{}measurements  {}\n", lines.unwrap_or_default(), self.counts())
    }

    /// "34 used, 1 rejected, 1 skipped (bend_outlier 1, no_snake 1, frames rejected: 17)".
    pub fn counts(&self) -> String {
        let mut reasons: Vec<_> = self.reasons.iter().map(|(reason, count)| format!("{reason} {count}")).collect();
        let named: Vec<_> = self.rejected_frames.iter().map(u64::to_string).collect();
        let more = if self.rejected > named.len() { " and others" } else { "" };
        reasons.extend((!named.is_empty()).then(|| format!("frames rejected: {}{more}", named.join(", "))));
        let why = if reasons.is_empty() { String::new() } else { format!(" ({})", reasons.join(", ")) };
        format!("{} used, {} rejected, {} skipped{why}", self.used, self.rejected, self.skipped)
    }
}
