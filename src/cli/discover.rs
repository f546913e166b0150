//! `discover`: which effect the model lacks.

use super::console::Console;
use super::flow::Flow;
use super::inputs::{NamedLog, encoders_of, files_read, model_of, model_or_paper, rows};
use super::measuring::Count;
use super::shard::Shard;
use super::trackers::open_trackers;
use super::verdict::unit_is_stated;
use super::views::open_views;
use crate::cli::failure::Failure;
use crate::discover::{
    Data, Discovery, LEAST_SAMPLES, Localisation, NextExperiment, ProposedLaw, Verdict as Found, discover_in_frames,
    discover_telling, next_experiment, nothing_named, propose_law,
};
use crate::estimate::gap::{Gap, gap};
use crate::estimate::{Options, Verdict as GateVerdict, estimate};
use crate::observation::{EncoderReading, Measurement};
use crate::record::{
    Checked, Experiment, OutputFolder, Provenance, learned_model_toml, measurements_csv, read_effects,
    read_measurements, read_model, tables_marked_stale, trajectory_csv, write_atomically, write_together,
};
use crate::report::discovery::{Page, lines};
use crate::report::verdict::verdict_page;
use crate::robot::{DataRange, Model};
use crate::verdict::{Code, Level, Reason, Subject, Verdict, doubts_of_times};
use crate::{Error, Result};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Find the effect that the model lacks, name it and add it: writes discrepancy.json, model.toml and report.html
///
/// Compares what the model predicts with what was measured. The verdict is `named`, `partly` (the effects help on held-out sweeps, and
/// more than noise is left), `none` (the gap is noise) or `unexplained` (there is a gap, and no known effect accounts for it).
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop discover --measurements out/measurements.csv \
                  --encoders fixtures/bending/encoders.csv -o found")]
pub struct Args {
    /// The experiment: a folder with an experiment.toml, or that file; its frames are measured first
    #[arg(required_unless_present = "measurements", conflicts_with_all = ["measurements", "encoders"])]
    experiment: Option<PathBuf>,
    /// The measurements (measurements.csv)
    #[arg(long, value_name = "CSV", requires = "encoders")]
    measurements: Option<PathBuf>,
    /// The encoder log (encoders.csv), or the experiment whose log it is, read as its [log] and [wiring] say
    #[arg(long, value_name = "CSV", requires = "measurements")]
    encoders: Option<PathBuf>,
    /// The model to start from (model.toml); its effects stay. Without it the experiment's, or the paper's with Table I
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    /// Your own effects, each an `[[effect]]` with a formula, its parameters, their units and ranges; they are looked for beside those of
    /// the library
    #[arg(long, value_name = "TOML")]
    effects: Option<PathBuf>,
    /// The folder to write to; created if it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Standard deviation of an encoder reading, mm
    #[arg(long, value_name = "MM", default_value_t = Options::default().sd_encoder_mm)]
    encoder_sd: f64,
    /// Also propose the experiment that would decide what these data leave open: writes OUT/next.csv, a trajectory that
    /// `simulate --trajectory` takes (index,time_s,theta_deg,delta_deg) with the q̃ to command (qc1_mm,qc2_mm,qc3_mm)
    #[arg(long)]
    next: bool,
    /// Largest number of poses of that experiment; at least 10, the number that a search needs
    #[arg(long, value_name = "N", requires = "next")]
    poses: Option<usize>,
    /// If the verdict is `unexplained` or `partly`, propose a law: a short formula of bend, load, direction, play, speed and time that
    /// removes more of the gap on held-out sweeps; it is added to model.toml as `proposed_law`
    #[arg(long)]
    correction: bool,
}

/// The angles that were measured in an experiment's frames.
const MEASUREMENTS: &str = "measurements.csv";
/// The trajectory that --next writes.
const NEXT: &str = "next.csv";

/// What is searched.
struct Inputs {
    model: Model,
    measurements: Vec<Measurement>,
    readings: Vec<EncoderReading>,
    /// What is odd about the times.
    doubt: Option<Reason>,
}

impl Inputs {
    fn new(
        model: Model,
        measurements: Vec<Measurement>,
        readings: Vec<EncoderReading>,
        experiment: Option<&Experiment>,
    ) -> Self {
        let doubt = doubts_of_times(&measurements, &readings, unit_is_stated(experiment));
        Self { model, measurements, readings, doubt }
    }

    /// A model that was learned on these measurements: with the range of bends that they and their readings show.
    fn with_range(&self, model: &Model) -> Model {
        let mut range = DataRange::default();
        let has_reading = |index: u64| self.readings.binary_search_by_key(&index, |reading| reading.index).is_ok();
        for measurement in self.measurements.iter().filter(|measurement| has_reading(measurement.index)) {
            if let Some(measured) = &measurement.measured {
                range.add(measured.configuration, measured.sigma_theta, measured.sigma_delta);
            }
        }
        Model { learned: Some(range), ..model.clone() }
    }
}

/// What came of the search.
struct Answer<'a> {
    found: Discovery,
    /// The law, where it was asked for.
    correction: Option<ProposedLaw>,
    /// Where the gap is, where there is one.
    localised: Option<Localisation>,
    /// Measurements that contradict what is left.
    outliers: Vec<&'a Measurement>,
    /// The next experiment, where it was asked for and something is open.
    next: Option<NextExperiment>,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        if !(self.encoder_sd > 0.0 && self.encoder_sd <= 1.0) {
            return Err(Failure::Usage(format!("--encoder-sd {}: expected more than 0, to 1 mm", self.encoder_sd)));
        }
        if let Some(poses) = self.poses.filter(|&poses| poses < LEAST_SAMPLES) {
            return Err(Failure::Usage(format!(
                "--poses {poses}: expected {LEAST_SAMPLES} or more, which a search needs"
            )));
        }
        let _out = self.claim()?;
        let inputs = self.inputs(console)?;
        let data = Data::new(&inputs.measurements, &inputs.readings, self.encoder_sd)?;
        match self.wiring_mistake(&inputs) {
            Some(mistake) => Ok(self.name_nothing(console, &inputs, mistake, &data.remarks)?),
            None => self.search(console, &inputs, data),
        }
    }

    /// What keeps physics from being named: a log that is wired otherwise than it is read, or times in another unit.
    fn wiring_mistake(&self, inputs: &Inputs) -> Option<Reason> {
        let Inputs { model, measurements, readings, .. } = inputs;
        let mistake = Subject::new(model, self.encoder_sd).wiring_mistake(measurements, readings);
        mistake.or_else(|| inputs.doubt.clone())
    }

    fn search(&self, console: &Console, inputs: &Inputs, mut data: Data) -> Result<(), Failure> {
        if let Some(path) = &self.effects {
            data.library.extend(read_effects(path)?);
        }
        let from_frames = inputs.measurements.iter().any(|measurement| measurement.quality.is_some());
        let (found, correction) = console.in_stages(|tell| {
            let found = match from_frames {
                true => discover_in_frames(inputs.model.clone(), &data, tell),
                false => discover_telling(&inputs.model, &data, tell),
            };
            let correction = self.correction.then(|| {
                tell("looking for a law");
                propose_law(&found, &data)
            });
            (found, correction)
        });
        let answer = Answer {
            correction,
            localised: Localisation::new(&found, &data),
            outliers: self.outliers(&found, inputs)?,
            next: if self.next { self.propose(&found, &data)? } else { None },
            found,
        };
        let json = self.write_answer(&answer, inputs, &data)?;
        console.warn(&answer.found.remarks);
        console.result(&json, || self.in_words(&answer, inputs));
        console.next(self.next_step(answer.found.verdict));
        Ok(())
    }

    /// Writes the files of a search, and gives discrepancy.json.
    fn write_answer(&self, answer: &Answer, inputs: &Inputs, data: &Data) -> Result<Value> {
        let Answer { found, correction, localised, outliers, next } = answer;
        let mut json = found.json();
        json["outliers"] = outliers.iter().map(|measurement| measurement.index).collect::<Vec<_>>().into();
        json["where"] = localised.as_ref().map(Localisation::json).into();
        if let Some(correction) = correction {
            json["correction"] = correction.json();
        }
        if self.next {
            json["next"] = next.as_ref().map(|next| next.json(NEXT)).into();
        }
        let corrected = correction.as_ref().and_then(|correction| correction.model.as_ref());
        let made_from = self.made_from()?;
        let page = Page {
            found,
            data,
            gap: localised.as_ref(),
            correction: correction.as_ref(),
            next: next.as_ref(),
            made_from: &made_from,
        };
        let model = inputs.with_range(corrected.unwrap_or(&found.model));
        self.write_all(&json, (&model, worth(found.verdict)), &page.html(), &made_from)?;
        Ok(json)
    }

    fn in_words(&self, answer: &Answer, inputs: &Inputs) -> String {
        let Answer { found, correction, localised, outliers, next } = answer;
        lines(found)
            + &without(outliers, found, inputs)
            + &localised.as_ref().map(|gap| format!("\nthe gap is {}", gap.words())).unwrap_or_default()
            + &correction.as_ref().map(|ProposedLaw { words, .. }| format!("\n{words}")).unwrap_or_default()
            + &self.next_in_words(next.as_ref())
    }

    /// Where what is left is called noise: measurements that contradict it, as the estimator's gate tells them. They decide nothing, and the
    /// gap's figures have them.
    fn outliers<'a>(&self, found: &Discovery, inputs: &'a Inputs) -> Result<Vec<&'a Measurement>> {
        if matches!(found.verdict, Found::Unexplained | Found::Partly) {
            return Ok(Vec::new());
        }
        let options = Options { sd_encoder_mm: self.encoder_sd, ..Options::default() };
        let (rows, _) = estimate(&found.model, options, &inputs.measurements, &inputs.readings)?;
        let rejected = inputs.measurements.iter().zip(rows).filter(|(_, row)| row.verdict == GateVerdict::Rejected);
        Ok(rejected.map(|(measurement, _)| measurement).collect())
    }

    /// No physics is named of a log that is wired otherwise than it is read.
    fn name_nothing(&self, console: &Console, inputs: &Inputs, mistake: Reason, remarks: &[String]) -> Result<()> {
        let Inputs { model, measurements, readings, .. } = inputs;
        let verdict = Verdict::of(vec![mistake]);
        let json = nothing_named(&gap(model, measurements, readings), &verdict, remarks);
        let made_from = self.made_from()?;
        let page = verdict_page("snakeloop: discover", &verdict, &made_from);
        self.write_all(&json, (model, Some(verdict.clone())), &page, &made_from)?;
        console.warn(remarks);
        console.result(&json, || {
            format!("unexplained: no effect is named from these data\n{}", verdict.lines().join("\n"))
        });
        Ok(())
    }

    /// The three files that every answer has: the model with what speaks against it, if something does.
    fn write_all(
        &self,
        json: &Value,
        (model, verdict): (&Model, Option<Verdict>),
        page: &str,
        made_from: &Provenance,
    ) -> Result<()> {
        let mut files = tables_marked_stale(
            &self.output,
            "`discover` has written model.toml beside it anew; `table` makes it of that model",
        )?;
        let texts = [
            ("discrepancy.json", format!("{json:#}\n")),
            ("model.toml", learned_model_toml(model, verdict.as_ref(), made_from)?),
            ("report.html", page.to_owned()),
        ];
        files.extend(texts.map(|(name, text)| (self.output.join(name), text)));
        write_together(&files)
    }

    /// The files that the call names.
    fn named(&self) -> [Option<&PathBuf>; 4] {
        [self.measurements.as_ref(), self.encoders.as_ref(), self.model.as_ref(), self.effects.as_ref()]
    }

    fn made_from(&self) -> Result<Provenance> {
        let options = [("encoder_sd_mm", self.encoder_sd)];
        let made_from = Provenance::new("discover").with_options(&BTreeMap::from(options))?;
        let made_from = match &self.experiment {
            Some(experiment) => made_from
                .with_inputs(Experiment::read(experiment)?.files())?
                .with_input(MEASUREMENTS, &self.output.join(MEASUREMENTS))?,
            None => made_from,
        };
        made_from.with_inputs(self.named().into_iter().flatten())
    }

    /// What to do next.
    fn next_step(&self, verdict: Found) -> String {
        let model = self.output.join("model.toml");
        match verdict {
            Found::Named | Found::Partly => format!("snakeloop table --model {} -o table", model.display()),
            Found::None => "command by the model as it is: nothing is missing".to_owned(),
            Found::Unexplained => {
                "add --correction for a law, or --next for the experiment that would tell more".to_owned()
            }
        }
    }

    /// Takes the folder to write to.
    fn claim(&self) -> Result<OutputFolder> {
        const OUTPUTS: [&str; 6] = [MEASUREMENTS, "discrepancy.json", NEXT, "model.toml", "report.html", "rig.jpg"];
        let (inputs, outputs) = match &self.experiment {
            Some(experiment) => (files_read(&Experiment::read(experiment)?, &self.named()), &OUTPUTS[..]),
            None => (self.named().into_iter().flatten().cloned().collect(), &OUTPUTS[1..]),
        };
        let mut out = OutputFolder::claim(&self.output, outputs, &inputs)?;
        out.made_by("discover", outputs)?;
        Ok(out)
    }

    fn propose(&self, found: &Discovery, data: &Data) -> Result<Option<NextExperiment>> {
        let next = next_experiment(found, data, self.poses);
        if let Some(next) = &next {
            self.write(NEXT, &trajectory_csv(&next.waypoints, &next.commands_mm))?;
        }
        Ok(next)
    }

    fn next_in_words(&self, next: Option<&NextExperiment>) -> String {
        match next {
            None if !self.next => String::new(),
            None => "\nnone of the trajectories tried would decide what is still open".to_owned(),
            Some(next) => format!("\n{}\n{}", next.sentence(), self.output.join(NEXT).display()),
        }
    }

    fn inputs(&self, console: &Console) -> Result<Inputs, Failure> {
        match (&self.experiment, &self.measurements, &self.encoders) {
            (Some(folder), _, _) => {
                let experiment = Experiment::read(folder)?;
                if experiment.encoders.is_none() {
                    let message = "encoders is missing; `discover` needs an encoder log";
                    return Err(Error::content(&experiment.path, message).into());
                }
                let model = match &self.model {
                    Some(path) => read_model(path)?,
                    None => model_of(console, &experiment)?,
                };
                let Checked { rows: readings, warnings } = encoders_of(&experiment, &model)?;
                console.warn(&warnings);
                let views = open_views(console, &experiment, &model.robot, &self.output)?;
                let trackers = open_trackers(console, &experiment, &model.robot, &readings)?;
                let flow = Flow {
                    views: &views,
                    trackers: &trackers,
                    encoders: &readings,
                    model: &model,
                    follow: false,
                    shard: Shard::WHOLE,
                    after: None,
                };
                let mut measurements = Vec::new();
                flow.run(
                    console,
                    |_| Ok(()),
                    |measurement| {
                        measurements.push(measurement);
                        Ok(())
                    },
                )?;
                self.write(MEASUREMENTS, &measurements_csv(&measurements))?;
                Count::of_file(&self.output.join(MEASUREMENTS))?.require_some_measured(&experiment)?;
                Ok(Inputs::new(model, measurements, readings, Some(&experiment)))
            }
            (None, Some(measurements), Some(encoders)) => {
                let model = model_or_paper(console, self.model.as_deref())?;
                let log = NamedLog::open(encoders)?;
                let measurements = rows(console, read_measurements(measurements)?);
                let readings = log.readings(console, &model, &measurements)?;
                Ok(Inputs::new(model, measurements, readings, log.experiment.as_ref()))
            }
            _ => Err(Failure::Usage("give an experiment, or --measurements and --encoders".to_owned())),
        }
    }

    fn write(&self, name: &str, text: &str) -> Result<()> {
        write_atomically(&self.output.join(name), text.as_bytes())
    }
}

/// What speaks against a model that leaves more than noise.
fn worth(found: Found) -> Option<Verdict> {
    let left = match found {
        Found::Named | Found::None => return None,
        Found::Partly => "the effects in this model explain a part of the gap, and more than noise is left",
        Found::Unexplained => "no effect explains the gap that this model leaves",
    };
    let remedy = "`discover --next` proposes the experiment that would tell more";
    Some(Verdict::of(vec![Reason::new(Code::GapAboveNoise, Level::Look, left, remedy)]))
}

/// The gap without the outliers, in words; empty without outliers.
fn without(outliers: &[&Measurement], found: &Discovery, Inputs { measurements, readings, .. }: &Inputs) -> String {
    let Some(first) = outliers.first() else { return String::new() };
    let rest: Vec<Measurement> = measurements.iter().filter(|m| outliers.iter().all(|o| *o != *m)).cloned().collect();
    let Gap { rms_eps_mm, rms_theta_deg, rms_delta_deg, .. } = gap(&found.model, &rest, readings);
    let (count, all, index) = (outliers.len(), measurements.len(), first.index);
    format!(
        "\n{count} of {all} measurements contradict the others (the first is {index}): look at those frames. Without them the gap is \
         {rms_eps_mm:.4} mm, {rms_theta_deg:.3}° and {rms_delta_deg:.3}°"
    )
}
