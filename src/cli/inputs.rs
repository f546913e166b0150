//! Reading what several commands are told, with warnings shown.

use super::console::Console;
use crate::Result;
use crate::record::{Checked, read_model};
use crate::robot::Model;
use std::path::Path;

/// The model in a file; without one the paper's, with Table I.
pub fn model_or_paper(path: Option<&Path>) -> Result<Model> {
    path.map_or_else(|| Ok(Model::default()), read_model)
}

/// The rows of a file, once its warnings were shown.
pub fn rows<T>(console: &Console, checked: Checked<T>) -> Vec<T> {
    console.warn(&checked.warnings);
    checked.rows
}
