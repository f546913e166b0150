//! model.toml: one robot's constants, its friction, and η and λ once they were estimated.
//!
//! ```toml
//! [robot]              # backbones = 4 where there are not three; and [robot.primary], [robot.secondary], [robot.line], [robot.body]: units in the key names
//! [friction]           # mu, static_force_n and how well they are known
//! [learned]            # on which bends, so that what lies beyond is marked in every table
//! theta_max_deg = 76.2
//! delta_deg = [-30.0, 0.0, 30.0]   # the sectors of 30° in which the snake bent, by their middles
//! [covariance]         # of all parameters, where effects were estimated with them
//! of = ["eta", "lambda_mm", "load_directed_backlash.play_mm"]
//! matrix = [[1.6e-5, 2e-7, 1e-7], [2e-7, 3.6e-7, 2e-8], [1e-7, 2e-8, 1.6e-7]]
//! [[effect]]           # each effect that was found; see robot::effects
//! name = "load_directed_backlash"
//! found = "discover, 320 samples"
//! form = "..."         # where it is not the first of its name
//! parameters.play_mm = { value = 0.11, sd = 0.0004, unit = "mm" }
//!                      # a user's own has formula, reading, domain, and parameters with a range: record::effect_table
//! [estimate]           # absent until something was estimated
//! eta = 1.221
//! sd_eta = 0.004
//! lambda_mm = 0.1765
//! sd_lambda_mm = 0.0006
//! correlation = 0.1    # of the errors of eta and lambda
//! samples = 36
//! [provenance]         # program, date, command, options, inputs: the files read with their SHA-256; and the verdict
//! ```
//!
//! The estimate stands below all that it needs, so that a file that was cut short has none, and is refused or predicts by η = 1 and λ = 0; never
//! by the estimate without an effect that it was learned with.
//!
//! The matrix is symmetric, and its diagonal holds the squares of the sds. Files written before there was one matrix have its rows with
//! the effects instead (`covariance_of`, `covariance` in an `[[effect]]`), and are read as well.
//!
//! `robot` and `friction` may be left out: Table I and the fit of Table II stand in. An `[[effect]]` that this version
//! does not know is an error, since a prediction without it would be wrong.

use super::covariance::{CovarianceTable, Known};
use super::effect_table::EffectTable;
use super::experiment::line_at;
use super::provenance::Provenance;
use super::write::write_atomically;
use crate::error::{ArgumentError, Error, Result};
use crate::input::read_text;
use crate::robot::{DataRange, Effect, Estimate, Friction, MAX_THETA, Model, OutOfRange, Robot};
use crate::verdict::Verdict;
use nalgebra::Matrix2;
use serde::{Deserialize, Serialize};
use std::path::Path;
use toml::de::DeTable;

/// The keys of `[provenance]` that hold the verdict and its worst reason.
const VERDICT: &str = "verdict";
const BECAUSE: &str = "because";

/// The file as it is written.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ModelFile {
    #[serde(default)]
    robot: Robot,
    #[serde(default)]
    friction: Friction,
    #[serde(skip_serializing_if = "Option::is_none")]
    learned: Option<LearnedTable>,
    #[serde(skip_serializing_if = "Option::is_none")]
    covariance: Option<toml::Spanned<CovarianceTable>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    effect: Vec<toml::Spanned<EffectTable>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    estimate: Option<EstimateTable>,
    /// What the file was made from, for people; nothing is computed from it.
    #[serde(skip_serializing_if = "Option::is_none")]
    provenance: Option<toml::Table>,
}

/// An estimate as files show it: sds and correlation rather than covariances.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct EstimateTable {
    eta: f64,
    sd_eta: f64,
    lambda_mm: f64,
    sd_lambda_mm: f64,
    correlation: f64,
    samples: usize,
}

/// The bends that η and λ were learned on.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LearnedTable {
    theta_max_deg: f64,
    delta_deg: Vec<f64>,
}

impl From<DataRange> for LearnedTable {
    fn from(range: DataRange) -> Self {
        // Rounded up, so that the largest bend itself lies within.
        let theta_max_deg = (range.theta_max().to_degrees() * 1e6).ceil() / 1e6;
        Self { theta_max_deg, delta_deg: range.directions_deg() }
    }
}

impl From<LearnedTable> for DataRange {
    fn from(table: LearnedTable) -> Self {
        Self::of(table.theta_max_deg.to_radians(), &table.delta_deg)
    }
}

impl ModelFile {
    /// The first number out of range that the model itself would not show, because it holds squares: a negative σ, an impossible range.
    fn out_of_range(&self) -> Option<OutOfRange> {
        let mut numbers = Vec::new();
        if let Some(EstimateTable { sd_eta, sd_lambda_mm, .. }) = self.estimate {
            numbers.extend([("estimate.sd_eta", sd_eta, 0.0, 1e6), ("estimate.sd_lambda_mm", sd_lambda_mm, 0.0, 1e3)]);
        }
        if let Some(LearnedTable { theta_max_deg, delta_deg }) = &self.learned {
            numbers.push(("learned.theta_max_deg", *theta_max_deg, 0.0, MAX_THETA.to_degrees() + 1e-6));
            numbers.extend(delta_deg.iter().map(|delta| ("learned.delta_deg", *delta, -360.0, 360.0)));
        }
        let mut wrong = numbers.into_iter().filter(|(_, value, least, most)| !(least..=most).contains(&value));
        wrong.next().map(|(key, value, least, most)| OutOfRange {
            key: key.to_owned(),
            value,
            range: least..=most,
            why: "",
        })
    }
}

impl From<&Model> for ModelFile {
    fn from(model: &Model) -> Self {
        let effect = |k: usize| toml::Spanned::new(0..0, EffectTable::of(model, k));
        Self {
            robot: model.robot.clone(),
            friction: model.friction,
            estimate: model.estimate().map(EstimateTable::from),
            learned: model.learned.filter(|_| model.estimate().is_some()).map(LearnedTable::from),
            effect: (0..model.effects.len()).map(effect).collect(),
            covariance: CovarianceTable::of(model).map(|table| toml::Spanned::new(0..0, table)),
            provenance: None,
        }
    }
}

impl From<Estimate> for EstimateTable {
    fn from(estimate: Estimate) -> Self {
        Self {
            eta: estimate.eta,
            sd_eta: estimate.sd_eta(),
            lambda_mm: estimate.lambda_mm,
            sd_lambda_mm: estimate.sd_lambda_mm(),
            correlation: estimate.correlation(),
            samples: estimate.samples,
        }
    }
}

impl From<EstimateTable> for Estimate {
    fn from(table: EstimateTable) -> Self {
        let cross = table.correlation * table.sd_eta * table.sd_lambda_mm;
        Self {
            eta: table.eta,
            lambda_mm: table.lambda_mm,
            covariance: Matrix2::new(table.sd_eta.powi(2), cross, cross, table.sd_lambda_mm.powi(2)),
            samples: table.samples,
        }
    }
}

/// Reads a model.toml.
///
/// # Errors
/// A file that cannot be read or is not TOML, an unknown or missing key, an effect that this version does not know, a
/// number out of its physical range; each with its line and key.
pub fn read_model(path: &Path) -> Result<Model> {
    let text = read_text(path)?;
    parse(path, &text)
}

/// A model as the text of a model.toml with what it was made from and its verdict, if it has one, which stands as a comment above it as well.
///
/// # Errors
/// Those of [`model_toml`].
pub fn learned_model_toml(model: &Model, verdict: Option<&Verdict>, made_from: &Provenance) -> Result<String> {
    let comment =
        |verdict: &Verdict| verdict.lines().iter().map(|line| format!("# {line}\n")).collect::<String>() + "\n";
    let mut provenance = made_from.table()?;
    if let Some(verdict) = verdict {
        // Programs that change the file and write it again leave comments out.
        provenance.insert(VERDICT.to_owned(), verdict.level.to_string().into());
        provenance.extend(verdict.reasons.first().map(|worst| (BECAUSE.to_owned(), worst.text.clone().into())));
    }
    Ok(verdict.map(comment).unwrap_or_default() + &text_of(model, Some(provenance))?)
}

/// Writes a model.toml, whole or not at all.
///
/// # Errors
/// A file that cannot be written, or a model whose numbers could not be read back.
pub fn write_model(path: &Path, model: &Model) -> Result<()> {
    write_atomically(path, model_toml(model)?.as_bytes())
}

/// A model as the text of a model.toml.
///
/// # Errors
/// A number that is not finite or out of its physical range, by its key.
pub fn model_toml(model: &Model) -> Result<String> {
    text_of(model, None)
}

/// The verdict that a model's file holds among its keys, if it does: its level, and the worst reason in a sentence.
pub(super) fn verdict_in(text: &str) -> Option<(String, Option<String>)> {
    let file: toml::Table = toml::from_str(text).ok()?;
    let text = |key: &str| Some(file.get("provenance")?.get(key)?.as_str()?.to_owned());
    Some((text(VERDICT)?, text(BECAUSE)))
}

fn text_of(model: &Model, provenance: Option<toml::Table>) -> Result<String> {
    if let Some(fault) = model.out_of_range() {
        return Err(Error::encode("the model")(fault));
    }
    toml::to_string(&ModelFile { provenance, ..ModelFile::from(model) }).map_err(Error::encode("the model"))
}

/// A model as JSON with model.toml's keys.
///
/// # Errors
/// As [`model_toml`].
pub fn model_json(model: &Model) -> Result<serde_json::Value> {
    if let Some(fault) = model.out_of_range() {
        return Err(Error::encode("the model")(fault));
    }
    serde_json::to_value(ModelFile::from(model)).map_err(Error::encode("the model"))
}

/// A robot from constants under the keys of `[robot]`, as JSON; what is left out is the paper's.
///
/// # Errors
/// [`ArgumentError::Robot`] for an unknown key, with the known ones; for a value that is no number or out of its physical range.
pub fn robot_of(constants: serde_json::Value) -> Result<Robot> {
    let wrong = |why: String| Error::from(ArgumentError::Robot(why));
    let mut all = serde_json::to_value(Robot::default()).map_err(|e| wrong(e.to_string()))?;
    replace(&mut all, constants);
    let robot: Robot = serde_json::from_value(all).map_err(|e| wrong(e.to_string()))?;
    let model = Model { robot, ..Model::default() };
    model.out_of_range().map_or(Ok(model.robot), |fault| Err(wrong(fault.to_string())))
}

/// Puts values in place of those under the same keys, table by table.
fn replace(old: &mut serde_json::Value, new: serde_json::Value) {
    match (old, new) {
        (serde_json::Value::Object(old), serde_json::Value::Object(new)) => {
            for (key, value) in new {
                replace(old.entry(key).or_insert(serde_json::Value::Null), value);
            }
        }
        (old, new) => *old = new,
    }
}

fn parse(path: &Path, text: &str) -> Result<Model> {
    let at_span = |e: toml::de::Error| match e.span() {
        Some(span) => Error::at_line(path, line_at(text, span.start), e.message()),
        None => Error::content(path, e.message()),
    };
    let document = DeTable::parse(text).map_err(at_span)?;
    let file: ModelFile = toml::from_str(text).map_err(at_span)?;
    let out_of_range = |fault: OutOfRange| {
        let line = line_of_key(document.get_ref(), &fault.key).map(|byte| line_at(text, byte));
        Error::Content { path: path.to_owned(), line, message: fault.to_string() }
    };
    if let Some(fault) = file.out_of_range() {
        return Err(out_of_range(fault));
    }
    if file.learned.is_some() && file.estimate.is_none() {
        let message = "[learned] without [estimate]: the file was cut short; copy it again, or take [learned] out";
        return Err(Error::content(path, message));
    }
    let mut model = Model {
        learned: file.learned.map(DataRange::from),
        robot: file.robot,
        friction: file.friction,
        ..Model::default()
    };
    if let Some(estimate) = file.estimate {
        model = model.with_estimate(estimate.into());
    }
    let mut known = Known::of(&model);
    for table in file.effect {
        let line = line_at(text, table.span().start);
        let at = |why: String| Error::at_line(path, line, why);
        let table = table.into_inner();
        let effect = table.effect(model.robot.backbone_count()).map_err(at)?;
        let is_same =
            |other: &Effect| (other.physics.name, other.physics.form) == (effect.physics.name, effect.physics.form);
        if model.effects.iter().any(is_same) {
            let name = effect.physics.name;
            return Err(at(format!("effect {name} stands twice, and would act twice; take one of the two out")));
        }
        model.effects.push(effect);
        known.add(&model, &table).map_err(at)?;
    }
    let covariance = match file.covariance {
        None => known.matrix(),
        Some(table) => {
            let line = line_at(text, table.span().start);
            let matrix = table.get_ref().matrix(&model, &known.sds);
            matrix.map_err(|why| Error::at_line(path, line, why))?
        }
    };
    model.covariance = covariance;
    model.out_of_range().map_or(Ok(model), |fault| Err(out_of_range(fault)))
}

/// The position in the text of the key with a dotted path; `None` if the key is left out.
fn line_of_key(table: &DeTable, path: &str) -> Option<usize> {
    let (first, rest) = path.split_once('.').map_or((path, None), |(first, rest)| (first, Some(rest)));
    // A number of a list stands where the list does.
    let name = first.split_once('[').map_or(first, |(name, _)| name);
    let (key, value) = table.get_key_value(name)?;
    match rest {
        None => Some(key.span().start),
        Some(rest) => line_of_key(value.get_ref().as_table()?, rest),
    }
}

#[cfg(test)]
pub(super) mod tests;
