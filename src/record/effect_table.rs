//! An `[[effect]]` of model.toml.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// An effect as files show it.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct EffectTable {
    pub(super) name: String,
    /// Which of the forms of this name, where it is not the first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) form: Option<String>,
    /// Where it was found.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub(super) found: String,
    /// In older files: η, λ, the parameters of the effects before this one, and its own, which the columns of `covariance` belong to.
    #[serde(default, skip_serializing)]
    pub(super) covariance_of: Vec<String>,
    /// In older files: a row for each parameter of this effect.
    #[serde(default, skip_serializing)]
    pub(super) covariance: Vec<Vec<f64>>,
    #[serde(default)]
    pub(super) parameters: BTreeMap<String, ParameterTable>,
}

/// A parameter of an effect.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ParameterTable {
    pub(super) value: f64,
    #[serde(default)]
    pub(super) sd: f64,
    pub(super) unit: String,
}
