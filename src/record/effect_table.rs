//! An `[[effect]]` of model.toml, and of a file with a user's own effects.
//!
//! ```toml
//! [[effect]]
//! name = "sheath_creep"                         # small letters, digits, underscores; not a name of the library
//! formula = "a_mm * tanh(tau / w_n) * on_1"     # what it adds to ε_i, mm; the variables: effects::Variable
//! reading = "a sheath that gives way"           # may be left out
//! parameters.a_mm = { unit = "mm", range = [-1.0, 1.0] }
//! parameters.w_n = { unit = "N", range = [0.05, 5.0], start = [0.2, 1.0] }
//! domain.theta = [0.0, 1.2]                     # may be left out: beyond it the formula goes on straight
//! ```
//!
//! In a model.toml each parameter has its `value` and `sd` besides.

use super::experiment::line_at;
use crate::error::{Error, Result};
use crate::input::read_text;
use crate::robot::effects::{Changes, Defined, Definition, ParameterSpec, physics};
use crate::robot::{Effect, Model, Physics};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// An effect as files show it.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct EffectTable {
    pub(super) name: String,
    /// Which of the forms of this name, where it is not the first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) form: Option<String>,
    /// What a user's own effect adds to ε_i, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) formula: Option<String>,
    /// What a user's own effect means.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub(super) reading: String,
    /// Where it was found.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub(super) found: String,
    /// In older files: η, λ, the parameters of the effects before this one, and its own, which the columns of `covariance` belong to.
    #[serde(default, skip_serializing)]
    pub(super) covariance_of: Vec<String>,
    /// In older files: a row for each parameter of this effect.
    #[serde(default, skip_serializing)]
    pub(super) covariance: Vec<Vec<f64>>,
    /// Within which values of its variables a user's own effect holds.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub(super) domain: BTreeMap<String, [f64; 2]>,
    #[serde(default)]
    pub(super) parameters: BTreeMap<String, ParameterTable>,
}

/// A parameter of an effect.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ParameterTable {
    /// Not there where the effect is only to be looked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) value: Option<f64>,
    #[serde(default)]
    pub(super) sd: f64,
    pub(super) unit: String,
    /// Of a user's own effect: its least and its largest value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    range: Option<[f64; 2]>,
    /// Of a user's own effect: where a search starts.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    start: Vec<f64>,
}

impl EffectTable {
    /// Effect k of a model as its file shows it.
    pub(super) fn of(model: &Model, k: usize) -> Self {
        let effect = &model.effects[k];
        let definition = match effect.physics.changes {
            Changes::Formula(formula) => Some(&formula.definition),
            _ => None,
        };
        let parameter = |(spec, (&value, sd)): (&ParameterSpec, (&f64, f64))| {
            let defined = definition.and_then(|definition| definition.parameters.get(spec.name));
            let table = ParameterTable {
                value: Some(value),
                sd,
                unit: spec.unit.to_owned(),
                range: defined.map(|defined| defined.range),
                start: defined.map(|defined| defined.starts.clone()).unwrap_or_default(),
            };
            (spec.name.to_owned(), table)
        };
        let values = effect.values.iter().zip(model.effect_sds(k));
        Self {
            name: effect.physics.name.to_owned(),
            form: Some(effect.physics.form).filter(|form| !form.is_empty()).map(str::to_owned),
            formula: definition.map(|definition| definition.formula.clone()),
            reading: definition.map(|definition| definition.reading.clone()).unwrap_or_default(),
            found: effect.found.clone(),
            covariance_of: Vec::new(),
            covariance: Vec::new(),
            domain: definition.map(|definition| definition.domain.clone()).unwrap_or_default(),
            parameters: effect.parameters().iter().zip(values).map(parameter).collect(),
        }
    }

    /// The effect, with the values of its parameters.
    pub(super) fn effect(&self, backbones: usize) -> Result<Effect, String> {
        let value = |(name, table): (&String, &ParameterTable)| {
            let value = table.value.ok_or_else(|| format!("effect {}: {name} has no value", self.name))?;
            Ok((name.clone(), value))
        };
        let values: Vec<(String, f64)> = self.parameters.iter().map(value).collect::<Result<_, String>>()?;
        let effect = match &self.formula {
            None => Effect::new(&self.name, self.form.as_deref(), &values, backbones),
            Some(formula) => Effect::with_parameters(self.defined(formula)?, &values, backbones),
        };
        let effect = effect.map_err(|why| why.to_string())?;
        for spec in effect.parameters() {
            let Some(parameter) = self.parameters.get(spec.name) else { continue };
            if parameter.unit != spec.unit || !(parameter.sd >= 0.0 && parameter.sd.is_finite()) {
                return Err(format!(
                    "effect {}: {} has sd = {} and unit = {:?}, expected an sd of 0 or more and {:?}",
                    self.name, spec.name, parameter.sd, parameter.unit, spec.unit
                ));
            }
        }
        Ok(Effect { found: self.found.clone(), ..effect })
    }

    /// The user's own effect of this formula.
    fn defined(&self, formula: &str) -> Result<&'static Physics, String> {
        if physics(&self.name).is_some() {
            return Err(format!("effect {}: the library has this name, and a formula needs one of its own", self.name));
        }
        let defined = |(name, table): (&String, &ParameterTable)| {
            let range = table.range.ok_or_else(|| format!("effect {}: {name} has no range", self.name))?;
            Ok((name.clone(), Defined { unit: table.unit.clone(), range, starts: table.start.clone() }))
        };
        let definition = Definition {
            name: self.name.clone(),
            formula: formula.to_owned(),
            reading: self.reading.clone(),
            parameters: self.parameters.iter().map(defined).collect::<Result<_, String>>()?,
            domain: self.domain.clone(),
        };
        definition.physics().map_err(|why| why.to_string())
    }
}

/// A file with a user's own effects.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct EffectsFile {
    effect: Vec<toml::Spanned<EffectTable>>,
}

/// Reads a user's own effects, each an `[[effect]]` with a formula.
///
/// # Errors
/// A file that cannot be read or is not TOML, or a definition with a fault, with its line.
pub fn read_effects(path: &Path) -> Result<Vec<&'static Physics>> {
    let text = read_text(path)?;
    let file: EffectsFile = toml::from_str(&text).map_err(|e| match e.span() {
        Some(span) => Error::at_line(path, line_at(&text, span.start), e.message()),
        None => Error::content(path, e.message()),
    })?;
    let mut effects: Vec<&'static Physics> = Vec::new();
    for table in file.effect {
        let line = line_at(&text, table.span().start);
        let table = table.into_inner();
        let formula = table.formula.as_deref().ok_or_else(|| format!("effect {}: formula is missing", table.name));
        let physics = formula.and_then(|formula| table.defined(formula));
        let physics = physics.map_err(|why| Error::at_line(path, line, why))?;
        if effects.iter().any(|other| other.name == physics.name) {
            return Err(Error::at_line(path, line, format!("effect {}: the name stands twice", physics.name)));
        }
        effects.push(physics);
    }
    Ok(effects)
}
