//! Reading what several commands are told, with warnings shown.

use super::console::Console;
use super::verdict::subject;
use crate::camera::FrameSource;
use crate::cli::failure::Failure;
use crate::estimate::with_sigmas;
use crate::input::read_text;
use crate::observation::{EncoderReading, Measurement};
use crate::record::{
    Checked, EncoderLog, Experiment, Matched, Provenance, do_not_use_mark, read_encoders_kept, read_joints, read_log,
    read_measurements, read_model, stale_mark, verdict_mark,
};
use crate::robot::data_range::ASKED_FOR;
use crate::robot::{Effect, ForceLimits, Friction, Model, TableRow};
use crate::verdict::{Level, Subject, doubt_of_parameters};
use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// File name extensions, in lower case, of the pictures that are read.
const PICTURE_EXTENSIONS: [&str; 6] = ["bmp", "jpg", "jpeg", "png", "tif", "tiff"];

/// The model in a file; without one the paper's naive one, with Table I, which is told.
pub fn model_or_paper(console: &Console, path: Option<&Path>) -> Result<Model> {
    match path {
        Some(path) => {
            tell_of_marks(console, path);
            read_model(path)
        }
        None => {
            console.say("no --model: the paper's naive model is used (Table I, η = 1, λ = 0)");
            Ok(Model::default())
        }
    }
}

/// Warns of what a model's file says of it: that it is stale, or to be looked at.
fn tell_of_marks(console: &Console, path: &Path) {
    let named = |what: &str, why: String| format!("{}: this model {what}: {why}", path.display());
    console.warn(stale_mark(path).map(|why| named("is marked as stale", why)));
    let amber = verdict_mark(path).filter(|(level, _)| *level == Level::Look.to_string());
    console.warn(amber.and_then(|(_, worst)| worst).map(|why| named("is to be looked at before it is used", why)));
}

/// Warns if the effects of a model in a file, which a command goes on learning from what their sigmas say, were learned from the same data.
///
/// # Errors
/// Data that cannot be read.
pub fn tell_of_data_seen(console: &Console, model: &Model, path: Option<&Path>, data: &Path) -> Result<()> {
    let is_learned = (0..model.effects.len()).any(|k| model.effect_sds(k).iter().any(|sd| *sd > 0.0));
    let Some(path) = path.filter(|_| is_learned) else { return Ok(()) };
    let text = read_text(path)?;
    let own = Provenance::new("").with_inputs([data])?;
    console.warn(own.inputs_shared_with(&text).first().map(|seen| {
        format!(
            "{}: its effects were learned from {seen} already, whose measurements now count twice: the sigmas are too small by up to a \
             factor of √2; estimate from measurements that it was not made from",
            path.display()
        )
    }));
    Ok(())
}

/// What a command that predicts does with a model that must not be used.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct WorthArgs {
    /// Use the model even if it must not be used (its verdict is "do not use", or no robot has its η or λ); everything that is written is
    /// marked
    #[arg(long)]
    even_if_bad: bool,
}

impl WorthArgs {
    /// [`model_or_paper`], and why it must not be used, if that is so and it was asked for all the same.
    pub fn model(self, console: &Console, path: Option<&Path>) -> Result<(Model, Option<String>), Failure> {
        let model = model_or_paper(console, path)?;
        let Some(path) = path else { return Ok((model, None)) };
        let Some(why) = must_not_be_used(path, &model) else {
            // A verdict to look at it has named it, where it was not changed since.
            let is_told = verdict_mark(path).is_some_and(|(level, _)| level == Level::Look.to_string());
            let doubt = doubt_of_parameters(&model).filter(|_| !is_told);
            console.warn(doubt.map(|doubt| format!("{}: {}; {}", path.display(), doubt.text, doubt.remedy)));
            return Ok((model, None));
        };
        let named = format!("{}: this model must not be used: {why}", path.display());
        if !self.even_if_bad {
            return Err(Failure::BadModel(named));
        }
        console.warn([named]);
        Ok((model, Some(why)))
    }
}

/// Why the model in a file must not be used, if that is so: by its verdict, or since no robot has such parameters.
fn must_not_be_used(path: &Path, model: &Model) -> Option<String> {
    do_not_use_mark(path).or_else(|| model.estimate().and_then(|estimate| estimate.implausible()))
}

/// Force limits as --force-limits gives them: pull and push, N.
pub fn force_limits(text: &str) -> Result<ForceLimits, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[least_n, most_n]) => ForceLimits::new(least_n, most_n).map_err(|error| error.to_string()),
        _ => Err("two numbers with a comma between them are expected, the pull and the push in N".to_owned()),
    }
}

/// What commanded the robot, as `run`, `estimate` and `evaluate` are told it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, clap::Args)]
pub struct CommandedArgs {
    /// Force limits of the table that commanded the robot (`table --force-limits`): the force that its backbones share changes all readings
    /// alike, and is subtracted first, so that it is not taken for λ
    #[arg(long, value_name = "PULL,PUSH", value_parser = force_limits, allow_hyphen_values = true)]
    pub force_limits: Option<ForceLimits>,
}

/// A model with further effects, as they are given on the command line.
pub fn with_effects(console: &Console, mut model: Model, effects: &[Effect]) -> Result<Model, Failure> {
    let backbones = model.robot.backbone_count();
    for effect in effects {
        let name = effect.physics.name;
        let is_there = model.effects.iter().any(|known| known.physics.name == name);
        console.warn(is_there.then(|| {
            format!("--effect {name}: the model has this effect already; both count, one on top of the other")
        }));
        let (given, expected) = (effect.parameters(), effect.physics.parameters_on(backbones));
        if given != expected {
            return Err(Failure::Usage(format!(
                "--effect {}: {} parameters were given, and on a robot of {backbones} backbones it takes {}",
                effect.physics.name,
                given.len(),
                expected.iter().map(|spec| spec.name).collect::<Vec<_>>().join(", ")
            )));
        }
        model.effects.push(effect.clone());
    }
    Ok(model)
}

/// The rows of a file, once its warnings were shown.
pub fn rows<T>(console: &Console, checked: Checked<T>) -> Vec<T> {
    console.warn(&checked.warnings);
    checked.rows
}

/// What `--encoders` names: a table as encoders.csv has it, or an experiment, whose log is read as its `[log]` and `[wiring]` say.
#[derive(Debug)]
pub struct NamedLog {
    path: PathBuf,
    /// The experiment, if it is one.
    pub experiment: Option<Experiment>,
}

impl NamedLog {
    /// What a path names.
    ///
    /// # Errors
    /// An experiment that cannot be read, or names no log.
    pub fn open(path: &Path) -> Result<Self> {
        let is_experiment = path.is_dir() || path.extension().is_some_and(|extension| extension == "toml");
        let experiment = is_experiment.then(|| Experiment::read(path)).transpose()?;
        if let Some(Experiment { path, encoders: None, .. }) = &experiment {
            return Err(Error::content(path, "`encoders` is missing; name the log of the encoders"));
        }
        Ok(Self { path: path.to_owned(), experiment })
    }

    /// The files that are read.
    pub fn files(&self) -> Vec<PathBuf> {
        match &self.experiment {
            None => vec![self.path.clone()],
            Some(experiment) => {
                let log = experiment.encoders.iter().map(|log| log.path().to_owned());
                std::iter::once(experiment.path.clone()).chain(log).collect()
            }
        }
    }

    /// The readings, of the model's robot, that belong to these measurements; of a large log no others are kept.
    pub fn readings(
        &self,
        console: &Console,
        model: &Model,
        measurements: &[Measurement],
    ) -> Result<Vec<EncoderReading>> {
        if let Some(experiment) = &self.experiment {
            return Ok(rows(console, encoders_of(experiment, model)?));
        }
        let near = Near::of(&self.path, || Some(measurements.iter().map(|measurement| measurement.index).collect()));
        let readings = read_encoders_kept(&self.path, model.robot.backbone_count(), |index| near.has(index))?;
        let readings = rows(console, readings);
        require_neighbours(&self.path, model, &readings)?;
        Ok(readings)
    }

    /// What is to be judged of a model by these readings.
    pub fn subject<'a>(&self, model: &'a Model, sd_encoder_mm: f64) -> Result<Subject<'a>> {
        match &self.experiment {
            None => Ok(Subject::new(model, sd_encoder_mm)),
            Some(experiment) => {
                let wiring = experiment.wiring(model.robot.backbone_count())?;
                Ok(subject(model, experiment, wiring, sd_encoder_mm))
            }
        }
    }
}

/// That a log has the readings of the neighbouring sections that the model's effects follow.
fn require_neighbours(path: &Path, model: &Model, log: &[EncoderReading]) -> Result<()> {
    let lacking = model.lacking_neighbours(log.iter().map(|reading| &reading.neighbours));
    lacking.map_or(Ok(()), |message| Err(Error::content(path, message)))
}

/// Warns of a model whose answers nothing bounds: nothing was learned, or it is not known on which bends.
pub fn tell_of_learning(console: &Console, model: &Model) {
    console.warn(match (&model.estimate(), &model.learned) {
        (None, _) => Some("nothing was learned yet: the answer is the naive model's (η = 1, λ = 0)"),
        (Some(_), None) => Some(
            "the model has no [learned], which says on which bends it was learned: nothing is marked as extrapolated",
        ),
        (Some(_), Some(_)) => None,
    });
}

/// Warns of poses whose commands lead elsewhere by the model's own prediction.
pub fn tell_of_missed_poses(console: &Console, model: &Model, rows: &[TableRow]) {
    let missed: Vec<_> = rows.iter().map(|row| (row, row.missed_by(model))).filter(|(_, by)| *by > ASKED_FOR).collect();
    console.warn(missed.first().map(|(row, by)| {
        let to = if by.is_finite() { format!("{:.1}° away", by.to_degrees()) } else { "beyond 120°".to_owned() };
        format!(
            "{} of {} poses, the first at θ = {:.0}°, δ = {:.0}°, are not where the model itself predicts that their commands lead (there: {to}): more \
             than one bend agrees with one command, so that the snake may be elsewhere; avoid these poses",
            missed.len(),
            rows.len(),
            row.configuration.theta_deg(),
            row.configuration.delta_deg()
        )
    }));
}

/// Measurements and, where there is a file, encoder readings of the model's robot; measurements without sigmas are given those that they show.
pub fn measurements_and_readings(
    console: &Console,
    model: &Model,
    measurements: &Path,
    encoders: Option<&NamedLog>,
) -> Result<(Vec<Measurement>, Vec<EncoderReading>)> {
    let measurements = rows(console, read_measurements(measurements)?);
    let readings = match encoders {
        Some(log) => log.readings(console, model, &measurements)?,
        None => Vec::new(),
    };
    let (measurements, remark) = with_sigmas(&measurements, &readings);
    console.warn(remark);
    Ok((measurements, readings))
}

/// The model in a file, to start from.
///
/// # Errors
/// A file that cannot be read, or a model that must not be used: what is learned from there on would be worth no more.
pub fn model_that_may_be_used(console: &Console, path: &Path) -> Result<Model> {
    tell_of_marks(console, path);
    let model = read_model(path)?;
    match must_not_be_used(path, &model) {
        None => Ok(model),
        Some(why) => {
            let remedy =
                "name one that can be used; where it is only a start to learn from, take `model` (or --model) out";
            Err(Error::content(path, format!("this model must not be used: {why}; {remedy}")))
        }
    }
}

/// An experiment's model: its `model`, with the constants of its `robot` where that is given; the paper's without.
///
/// # Errors
/// A file that cannot be read, or a model that must not be used: what is learned from there on would be worth no more.
pub fn model_of(console: &Console, experiment: &Experiment) -> Result<Model> {
    let mut model = match &experiment.model {
        Some(path) => model_that_may_be_used(console, path)?,
        None => Model::default(),
    };
    if let Some(path) = &experiment.robot {
        let Model { robot, friction, .. } = read_model(path)?;
        let (of_model, of_robot) = (model.robot.backbone_count(), robot.backbone_count());
        if experiment.model.is_some() && of_model != of_robot {
            let message = format!("`model` is of a robot of {of_model} backbones, and `robot` has {of_robot}");
            return Err(Error::content(&experiment.path, message));
        }
        model.robot = robot;
        if experiment.model.is_none() {
            model.friction = friction;
        } else if friction != Friction::default() && friction != model.friction {
            let message = format!(
                "`robot` gives μ = {} and f_s = {} N, and `model` was learned with {} and {} N; give `model` alone, or learn it anew",
                friction.mu, friction.static_force_n, model.friction.mu, model.friction.static_force_n
            );
            return Err(Error::content(&experiment.path, message));
        }
    }
    Ok(model)
}

/// A command on an experiment, as the record of an output folder names it.
pub fn maker(command: &str, experiment: &Experiment) -> String {
    let folder = experiment.folder();
    let here = if folder == Path::new("") { Path::new(".") } else { folder };
    format!("{command} {}", here.canonicalize().as_deref().unwrap_or(here).display())
}

/// All that a call on an experiment reads: the files it names, its frames, and `others`.
pub fn files_read(experiment: &Experiment, others: &[Option<&PathBuf>]) -> Vec<PathBuf> {
    let others = others.iter().flatten().map(|path| (*path).clone());
    experiment.files().into_iter().chain(experiment.frames()).chain(others).collect()
}

/// An experiment's encoder log for the model's robot, read by the experiment's wiring; empty if the experiment names no log.
pub fn encoders_of(experiment: &Experiment, model: &Model) -> Result<Checked<EncoderReading>> {
    let backbones = model.robot.backbone_count();
    let wiring = experiment.wiring(backbones)?;
    match &experiment.encoders {
        Some(EncoderLog::File(path)) => {
            let near = Near::of(path, || frame_indices(experiment));
            let Checked { rows, warnings } = match &experiment.log {
                Some(keys) => read_log(path, backbones, keys, || experiment.stamps_s(), |index| near.has(index))?,
                None => read_encoders_kept(path, backbones, |index| near.has(index))?,
            };
            require_neighbours(path, model, &rows)?;
            let wired = wiring.readings(&rows);
            match rows.len() {
                all if all > 0 && wired.is_empty() => {
                    let shift = wiring.index_shift;
                    let message = format!(
                        "index_shift = {shift} under [wiring] leaves none of the log's {all} rows; it is the number of rows by which the log is ahead"
                    );
                    Err(Error::content(&experiment.path, message))
                }
                _ => Ok(Checked { rows: wired, warnings }),
            }
        }
        Some(EncoderLog::Joints(joints)) => {
            let Matched { readings, warnings } = read_joints(joints, &experiment.stamps_s()?, backbones)?;
            require_neighbours(&experiment.path, model, &readings)?;
            Ok(Checked { rows: wiring.readings(&readings), warnings })
        }
        None => Ok(Checked { rows: Vec::new(), warnings: Vec::new() }),
    }
}

/// A log above this size is not kept whole, bytes. Convention: a resource limit, about a million rows.
const LARGE_LOG_BYTES: u64 = 32 << 20;
/// How far from a frame's index rows of a large log are kept. Derived: a multiple of the few rows that the check of the wiring looks at.
const KEPT_AROUND: u64 = 64;

/// Which rows of a log are kept: of a large one those near frames, so that memory does not grow with the rest.
struct Near(Option<BTreeSet<u64>>);

impl Near {
    /// Of a log, near the frames of these indices; all of its rows if it is not large, or the indices are not known.
    fn of(log: &Path, indices: impl FnOnce() -> Option<BTreeSet<u64>>) -> Self {
        let is_large = std::fs::metadata(log).is_ok_and(|file| file.len() > LARGE_LOG_BYTES);
        Self(is_large.then(indices).flatten())
    }

    fn has(&self, index: u64) -> bool {
        let (from, to) = (index.saturating_sub(KEPT_AROUND), index.saturating_add(KEPT_AROUND));
        self.0.as_ref().is_none_or(|indices| indices.range(from..=to).next().is_some())
    }
}

/// The indices of an experiment's frames; `None` where only reading them would tell, or where poses of trackers have indices of their own.
fn frame_indices(experiment: &Experiment) -> Option<BTreeSet<u64>> {
    let mut indices = BTreeSet::new();
    for view in &experiment.views {
        match view.open_frames(experiment.folder()).ok()? {
            FrameSource::Pictures(files) => indices.extend(files.iter().map(|file| file.index)),
            source => indices.extend(0..source.count().ok()?? as u64),
        }
    }
    (experiment.trackers.is_empty() && !indices.is_empty()).then_some(indices)
}

/// The extension that most pictures of a folder have, as it is written there, and how many have it.
pub fn commonest_picture(folder: &Path) -> Option<(String, usize)> {
    let mut extensions = BTreeMap::<String, usize>::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        if entry.file_name().to_string_lossy().starts_with('.') {
            continue;
        }
        let extension = entry.path().extension().unwrap_or_default().to_string_lossy().into_owned();
        if PICTURE_EXTENSIONS.contains(&extension.to_lowercase().as_str()) {
            *extensions.entry(extension).or_default() += 1;
        }
    }
    extensions.into_iter().max_by_key(|(_, count)| *count)
}
