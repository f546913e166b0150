//! `run`: the main job, from frames and encoders to a compensation table and a report.

use super::console::{Caller, Console};
use super::estimate::Estimated;
use super::flow::{MeasuredFrames, Throughput};
use super::inputs::{encoders_of, files_read, maker, model_of, tell_of_data_seen};
use super::measuring::{self, Count, Measured, MeasuringArgs};
use super::origin::Settings;
use super::overlays::{self, Overlays, closeup, draw, jpeg, pictures};
use super::table::largest_correction_mm;
use super::trackers::open_trackers;
use super::verdict::{VerdictArgs, reasons_of_files, subject, unit_is_stated, verdict_text};
use super::views::{open_views, reasons_of_sheets, rig_picture_name};
use crate::cli::failure::Failure;
use crate::estimate::EtaLambda;
use crate::estimate::gap::{Gap, gap};
use crate::input::read_text;
use crate::observation::{EncoderReading, Measurement};
use crate::quantity::with_sd;
use crate::record::{
    Checked, Experiment, Files, MeasurementRows, OutputFolder, Provenance, Warning, Worth, compensation_files,
    estimates_csv, learned_model_toml, mark_stale, write_together,
};
use crate::report::run_history::RunHistory;
use crate::report::run_page::Report;
use crate::robot::{Model, Robot};
use crate::verdict::{Code, JudgedEstimate, Level, Reason, Verdict};
use crate::{Error, Result};
use clap::Parser;
use serde::Serialize;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tracing::{info, info_span};

/// Do the main job: measure every frame, update η and λ, write the compensation table and a report
///
/// Writes measurements.csv, estimate.csv, model.toml, compensation.csv, compensation.json, overlays/ and report.html
/// into OUT, and prints a summary.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop run fixtures/bending -o out")]
pub struct Args {
    /// The experiment: a folder with an experiment.toml, or that file
    experiment: PathBuf,
    /// The folder to write to; created if it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    #[command(flatten)]
    measuring: MeasuringArgs,
    #[command(flatten)]
    settings: Settings,
    #[command(flatten)]
    verdict: VerdictArgs,
}

/// What a run writes into its folder.
pub const OUTPUTS: [&str; 9] = [
    "measurements.journal",
    "measurements.csv",
    "estimate.csv",
    "model.toml",
    "compensation.csv",
    "compensation.json",
    "overlays",
    "report.html",
    "rig.jpg",
];

/// The result, as it is printed.
#[derive(Serialize)]
pub struct Summary {
    pub verdict: Verdict,
    frames: usize,
    statuses: BTreeMap<String, usize>,
    #[serde(flatten)]
    estimated: Estimated,
    /// What the updated model leaves.
    gap: Gap,
    /// What the naive model (η = 1, λ = 0) leaves.
    naive_gap: Gap,
    /// The compensation table; `None` without an estimate.
    #[serde(flatten)]
    table: Option<Table>,
    #[serde(flatten)]
    throughput: Option<Throughput>,
    output: PathBuf,
    /// The model, with its estimate if there is one.
    #[serde(skip)]
    pub model: Model,
}

/// What became of a call.
enum Outcome {
    /// Every frame is measured, and all files are written.
    Whole(Box<Summary>),
    /// One shard of several is measured.
    Shard(Option<Throughput>),
}

/// Carries out `run EXPERIMENT -o OUT` for a program that calls it, and gives what the command prints.
///
/// # Errors
/// Those of the command, but for the one that it ends with where the measurements give no estimate: the verdict says so.
pub fn run_experiment(experiment: &Path, output: &Path, caller: Arc<Caller>) -> Result<Summary> {
    #[derive(Parser)]
    struct Call {
        #[command(flatten)]
        args: Args,
    }
    // The settings that are not given are the command's own.
    let mut named_output = OsString::from("--output=");
    named_output.push(output);
    let call = [OsString::from("run"), named_output, OsString::from("--"), experiment.into()];
    let call = Call::try_parse_from(call);
    let Call { args } = call.map_err(|e| Error::Unavailable { what: "run".into(), message: e.to_string() })?;
    match args.outcome(&Console::of_caller(caller), &Experiment::read(experiment)?)? {
        Outcome::Whole(summary) => Ok(*summary),
        Outcome::Shard(_) => Err(Error::Ended),
    }
}

#[derive(Serialize)]
struct Table {
    /// Its poses.
    poses: usize,
    /// The largest correction |q̃ − q| in it, mm.
    largest_correction_mm: f64,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        self.measuring.start_threads()?;
        let experiment = Experiment::read(&self.experiment)?;
        match self.outcome(console, &experiment)? {
            Outcome::Shard(throughput) => {
                let summary = measuring::Summary::of(&self.output, throughput)?;
                console.result(&summary, || summary.text());
                console.next(format_args!("when all shards are done, snakeloop merge with all of their folders"));
            }
            Outcome::Whole(summary) => {
                summary.tell(console, &experiment);
                summary.require_table(&experiment)?;
                self.verdict.check(&summary.verdict)?;
            }
        }
        Ok(())
    }

    /// Does the work, and writes all files.
    fn outcome(&self, console: &Console, experiment: &Experiment) -> Result<Outcome> {
        let mut out = OutputFolder::claim(&self.output, &OUTPUTS, &files_read(experiment, &[]))?;
        out.made_by(&maker("run", experiment), &OUTPUTS)?;
        let inputs = Inputs::read(console, experiment)?;
        let views = open_views(console, experiment, &inputs.start.robot, &self.output)?;

        let trackers = open_trackers(console, experiment, &inputs.start.robot, &inputs.encoders)?;
        let (encoders, start) = (&inputs.encoders[..], &inputs.start);
        let sources = (self.experiment.as_path(), experiment, &views[..], &trackers[..], encoders, start);
        let folder = self.output.join("overlays");
        if !self.measuring.resume {
            overlays::remove_former(&folder)?;
        }
        let draw = |measured: &MeasuredFrames| draw(self.settings.overlays, &folder, measured);
        Ok(match self.measuring.measure(console, sources, Some(self.settings), &self.output, draw)? {
            Measured::Shard(throughput) => Outcome::Shard(throughput),
            Measured::Whole(journal, throughput) => {
                let sheets = reasons_of_sheets(&views).collect();
                let summary = finish(experiment, &inputs, sheets, self.settings, &self.output, Some(throughput))?;
                journal.remove()?;
                Outcome::Whole(Box::new(summary))
            }
        })
    }
}

/// What an experiment gives besides its frames.
pub struct Inputs {
    start: Model,
    encoders: Vec<EncoderReading>,
    warnings: Vec<Warning>,
}

impl Inputs {
    /// The robot.
    pub fn robot(&self) -> &Robot {
        &self.start.robot
    }

    /// Reads starting model and encoder log, and shows what was passed over in the log.
    pub fn read(console: &Console, experiment: &Experiment) -> Result<Self> {
        let Some(log) = &experiment.encoders else {
            let message = "encoders is missing; `run` needs an encoder log, `measure` does without";
            return Err(Error::content(&experiment.path, message));
        };
        let start = model_of(console, experiment)?;
        tell_of_data_seen(console, &start, experiment.model.as_deref(), log.path())?;
        let Checked { rows: encoders, warnings } = encoders_of(experiment, &start)?;
        console.warn(&warnings);
        Ok(Self { start, encoders, warnings })
    }
}

/// All that a run makes of the measurements.csv in its folder: estimate, model, table and report. `sheets` are what the views' sheets say
/// against it.
pub fn finish(
    experiment: &Experiment,
    inputs: &Inputs,
    sheets: Vec<Reason>,
    settings: Settings,
    output: &Path,
    throughput: Option<Throughput>,
) -> Result<Summary> {
    let _stage = info_span!("learn").entered();
    let Inputs { start, encoders, warnings } = inputs;
    let measurements: Vec<Measurement> =
        MeasurementRows::open(&output.join("measurements.csv"))?.collect::<Result<_>>()?;
    let (options, backbones) = (settings.estimator.options(1.0), start.robot.backbone_count());
    let wiring = experiment.wiring(backbones)?;
    let is_stated = unit_is_stated(Some(experiment));
    let limits = settings.commanded.force_limits;
    let JudgedEstimate { rows, model, readings, verdict } =
        JudgedEstimate::of(start, options, limits.as_ref(), (&measurements, encoders), is_stated, |model| {
            Ok(subject(model, experiment, wiring, options.sd_encoder_mm))
        })?;
    let doubts = reasons_of_files(experiment, warnings)?.into_iter().chain(sheets);
    let verdict = beside_former(output, doubts.fold(verdict, Verdict::and))?;
    let estimated = Estimated::of(&rows, model.estimate());
    info!(used = estimated.used, rejected = estimated.rejected, skipped = estimated.skipped, verdict = %verdict.level, "judged");
    let made_from = provenance(experiment, settings, output)?;
    let (mut files, table) = model_and_tables(output, &model, &verdict, &made_from)?;
    let naive = model.without_estimate();
    let count = Count::of(&measurements);
    let summary = Summary {
        frames: count.frames,
        statuses: count.statuses,
        estimated,
        gap: gap(&model, &measurements, &readings),
        naive_gap: gap(&naive, &measurements, &readings),
        table,
        throughput,
        output: output.to_owned(),
        verdict,
        model,
    };
    let history = RunHistory::of(&measurements, &rows);
    let page = page(experiment, &summary, &readings, &history, (settings, warnings, &made_from))?;
    files.push((output.join("report.html"), page));
    // The rows of the estimate stand beside the model that they led to, and not beside an earlier one.
    if summary.table.is_some() || !output.join("model.toml").exists() {
        files.push((output.join("estimate.csv"), estimates_csv(&rows, backbones)));
    }
    write_together(&files)?;
    info!(output = %output.display(), "written");
    Ok(summary)
}

/// The verdict on a run, with what it means for the files of an earlier run in the same folder, which are marked as stale where they stay.
fn beside_former(output: &Path, verdict: Verdict) -> Result<Verdict> {
    let verdict = former_to_keep(output, &verdict).into_iter().fold(verdict, Verdict::and);
    if verdict.has(Code::Stale) {
        let worst = verdict.reasons.first().map_or("", |reason| &reason.text);
        mark_stale(output, &format!("a later run on the same folder ended in \"do not use\": {worst}"))?;
    }
    Ok(verdict)
}

/// report.html of a run.
fn page(
    experiment: &Experiment,
    summary: &Summary,
    readings: &[EncoderReading],
    history: &RunHistory,
    (settings, warnings, made_from): (Settings, &[Warning], &Provenance),
) -> Result<String> {
    let drawn = summary.output.join("overlays");
    let (pictures, closeup) = match settings.overlays {
        Overlays::None => (Vec::new(), None),
        Overlays::All | Overlays::Sample => {
            (pictures(experiment, &drawn, &history.pictured)?, closeup(experiment, &drawn, &history.pictured)?)
        }
    };
    let report = Report {
        title: format!("snakeloop: {}", name_of(experiment)),
        verdict: summary.verdict.clone(),
        summary: summary.lines(),
        model: Some(&summary.model).filter(|model| model.estimate().is_some()),
        readings,
        history,
        rigs: rig_pictures(experiment, &summary.output)?,
        closeup,
        pictures,
        warnings: warnings.iter().map(ToString::to_string).collect(),
        made_from: made_from.clone(),
    };
    Ok(report.html())
}

/// Longer side of the straight picture in the report, px. Convention: a display choice.
const RIG_PICTURE_PX: u32 = 1000;
/// Its quality as a JPEG. Convention: a display choice.
const RIG_PICTURE_QUALITY: u8 = 80;

/// What the calibration of each view's rig saw, with the view's name.
fn rig_pictures(experiment: &Experiment, output: &Path) -> Result<Vec<(String, Vec<u8>)>> {
    let drawn = experiment.views.iter().map(|view| (view, output.join(rig_picture_name(view, experiment))));
    drawn
        .filter(|(_, path)| path.is_file())
        .map(|(view, path)| {
            let picture = image::open(&path).map_err(|error| Error::content(&path, error.to_string()))?;
            let small = picture.thumbnail(RIG_PICTURE_PX, RIG_PICTURE_PX).to_rgb8();
            Ok((format!("View {}", view.name), jpeg(&small, RIG_PICTURE_QUALITY)?))
        })
        .collect()
}

/// The files of the model and its table, unless there is no estimate or an earlier run's are to stay.
fn model_and_tables(
    output: &Path,
    model: &Model,
    verdict: &Verdict,
    made_from: &Provenance,
) -> Result<(Files, Option<Table>)> {
    if model.estimate().is_none() || verdict.has(Code::Stale) {
        return Ok((Vec::new(), None));
    }
    let (mut files, table) = compensation_files(output, model, "model.toml", Worth::of(verdict))?;
    files.push((output.join("model.toml"), learned_model_toml(model, Some(verdict), made_from)?));
    Ok((files, Some(Table { poses: table.len(), largest_correction_mm: largest_correction_mm(&table) })))
}

/// Where an earlier run left a model that could be used, and this one's must not be: the reason to keep the former.
fn former_to_keep(output: &Path, verdict: &Verdict) -> Option<Reason> {
    let table = read_text(&output.join("compensation.json")).ok()?;
    let table: serde_json::Value = serde_json::from_str(&table).ok()?;
    let was_usable = matches!(table["verdict"]["level"].as_str()?, "good" | "look");
    (was_usable && verdict.level == Level::DoNotUse && output.join("model.toml").exists()).then(|| {
        let text = "model.toml and the tables of an earlier run stay and are marked as stale, because those of this run must not be used";
        Reason::new(Code::Stale, Level::Look, text, "correct what is named above, or write to another folder")
    })
}

/// The name of the experiment's folder.
fn name_of(experiment: &Experiment) -> String {
    let folder = experiment.folder();
    let full = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    full.file_name().map_or_else(|| full.display().to_string(), |name| name.to_string_lossy().into_owned())
}

/// What a run was made from: the files of the experiment, and the measurements that its frames gave.
fn provenance(experiment: &Experiment, settings: Settings, output: &Path) -> Result<Provenance> {
    let made_from = Provenance::new("run").with_options(&settings)?.with_inputs(experiment.files())?;
    made_from.with_input("measurements.csv", &output.join("measurements.csv"))
}

impl Summary {
    /// The figures that matter, by name; the same whenever the run is made again.
    fn lines(&self) -> Vec<(String, String)> {
        let measured = self.statuses.get("ok").copied().unwrap_or(0);
        let failed: Vec<_> = self
            .statuses
            .iter()
            .filter(|(status, _)| *status != "ok")
            .map(|(status, count)| format!("{count} {status}"))
            .collect();
        let failed = if failed.is_empty() { String::new() } else { format!(" ({})", failed.join(", ")) };
        let (gap, naive, estimated) = (&self.gap, &self.naive_gap, &self.estimated);
        let mut lines = vec![
            ("frames measured", format!("{measured} of {}{failed}", self.frames)),
            ("measurements", estimated.counts()),
        ];
        if let Some(EtaLambda { eta, sd_eta, lambda_mm, sd_lambda_mm }) = estimated.parameters {
            lines.push(("force scale η", with_sd(eta, sd_eta)));
            lines.push(("backlash λ", format!("{} mm", with_sd(lambda_mm, sd_lambda_mm))));
        }
        if gap.samples > 0 {
            lines.push((
                "ε missed (rms)",
                format!("{:.4} mm, noise alone {:.4} mm", gap.rms_eps_mm, gap.noise_floor_mm),
            ));
            lines.push((
                "θ missed (rms)",
                format!("{:.3}°, before learning {:.3}°", gap.rms_theta_deg, naive.rms_theta_deg),
            ));
            lines.push((
                "δ missed (rms)",
                format!("{:.3}°, before learning {:.3}°", gap.rms_delta_deg, naive.rms_delta_deg),
            ));
        }
        lines.push(match &self.table {
            Some(Table { poses, largest_correction_mm }) => {
                ("compensation", format!("{poses} poses, largest correction {largest_correction_mm:.3} mm"))
            }
            None => ("compensation", "none: η and λ are not known".to_owned()),
        });
        lines.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
    }

    /// An error where there is no table, since the measurements gave no estimate.
    pub fn require_table(&self, experiment: &Experiment) -> Result<()> {
        if !self.statuses.contains_key("ok") {
            Count { frames: self.frames, statuses: self.statuses.clone() }.require_some_measured(experiment)?;
        }
        self.estimated.require_parameters(&experiment.path)
    }

    /// Prints the result, and what to do next.
    pub fn tell(&self, console: &Console, experiment: &Experiment) {
        console.warn(self.model.conditions_of_single_poses());
        console.result(self, || self.text());
        console.next(self.next(experiment));
    }

    /// What to do next.
    fn next(&self, experiment: &Experiment) -> String {
        let out = self.output.display();
        match self.verdict.level {
            Level::DoNotUse => "follow the remedy of the first reason, then run again".to_owned(),
            _ if self.verdict.has(Code::GapAboveNoise) => {
                format!("snakeloop discover {} -o found says what the model lacks", experiment.folder().display())
            }
            Level::Good | Level::Look => format!(
                "command from {out}/compensation.csv; snakeloop invert --model {out}/model.toml --theta-deg 30 --delta-deg 45 answers one pose"
            ),
        }
    }

    /// Lines for people.
    pub fn text(&self) -> String {
        // A tracker's poses are no frames, and take no time.
        let timed = self.throughput.filter(|throughput| throughput.frames_per_second > 0.0);
        let speed = timed.map(|Throughput { frames_per_second, decoding_share, .. }| {
            ("speed", format!("{frames_per_second:.1} frames/s, {:.0} % of it decoding", 100.0 * decoding_share))
        });
        let written = ("written", self.output.join("report.html").display().to_string());
        let last = speed.into_iter().chain([written]).map(|(name, value)| (name.to_owned(), value));
        let lines = self.lines().into_iter().chain(last).map(|(name, value)| format!("{name:<16} {value}\n"));
        verdict_text(&self.verdict) + &lines.collect::<String>()
    }
}
