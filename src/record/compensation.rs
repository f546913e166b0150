//! compensation.csv and compensation.json: what to command for every pose of a grid.
//!
//! | column | meaning |
//! | --- | --- |
//! | `theta_deg`, `delta_deg` | the desired pose |
//! | `q1_mm` … `qn_mm` | q: what the snake's backbones are to move |
//! | `qc1_mm` … `qcn_mm` | q̃: what to command |
//! | `sd_qc1_mm` … `sd_qcn_mm` | its standard deviation, from the covariance of η and λ |
//! | `beyond_data` | with an effect that has a domain (a proposed law): 1 where the pose is beyond what it was learned from, else 0 |
//! | `common_n` | with force limits: the mean of the forces that they add to the backbones; with three, what each gets |
//! | `f1_n` … `fn_n` | with force limits: what the actuation unit exerts on each, positive where it pushes |
//! | `within_limits` | with force limits: 1 where all lie within them, else 0 |
//! | `extrapolated` | 1 where the pose is beyond the bends and directions that the model was learned on, else 0 |
//! | `do_not_use` | only in a table of a model that must not be used: 1 in every row |
//! | `stale` | only in a table that is marked so ([`mark_stale`](super::mark_stale)): 1 in every row |
//!
//! The JSON has the same rows under `rows`, the model under `model` with model.toml's keys, under `provenance` what made them,
//! under `verdict` whether `run` or `live` found that they can be relied on, under `do_not_use` why not, if they must not be used, and under
//! `holds_if` what has to be so for a command to lead to its pose, where the model's effects remember how the snake came there or follow
//! neighbouring sections. A C header that stands in the folder is the same table, and is written anew with it.

use super::c_header::compensation_c_header;
use super::columns::{azimuth, backbone_columns, backbone_decimals, csv_text, decimals};
use super::model::ModelFile;
use super::stale::{in_csv, in_header, in_json, in_one_line, marked_header};
use super::write::{Files, write_together};
use crate::error::{Error, Result};
use crate::robot::{Grid, Model, Sharing, TableRow, compensation_table};
use crate::verdict::Verdict;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};
use std::path::Path;

/// The columns of lengths.
const LENGTHS: [&str; 3] = ["q", "qc", "sd_qc"];

/// What is known of a table besides its numbers: the verdict on it, and why it must not be used, if that is so.
#[derive(Debug, Clone, Copy, Default)]
pub struct Worth<'a> {
    /// The verdict, where one was passed.
    pub verdict: Option<&'a Verdict>,
    /// Why the table must not be used.
    pub do_not_use: Option<&'a str>,
    /// Why it is stale: the model that it is made from is marked so.
    pub stale: Option<&'a str>,
}

impl<'a> Worth<'a> {
    /// That of a model that was judged.
    pub fn of(verdict: &'a Verdict) -> Self {
        Self { verdict: Some(verdict), do_not_use: verdict.why_not(), stale: None }
    }
}

/// compensation.csv as text; angles to 1e-6°, lengths to 1 nm, forces to 1 µN.
pub fn compensation_csv(rows: &[TableRow], worth: Worth) -> String {
    let backbones = rows.first().map_or(0, |row| row.q_mm.len());
    let mut columns = vec!["theta_deg".to_owned(), "delta_deg".to_owned()];
    columns.extend(LENGTHS.iter().flat_map(|name| backbone_columns(name, "mm", backbones)));
    if rows.iter().any(|row| row.beyond_data.is_some()) {
        columns.push("beyond_data".to_owned());
    }
    if rows.iter().any(|row| row.sharing.is_some()) {
        columns.push("common_n".to_owned());
        columns.extend(backbone_columns("f", "n", backbones));
        columns.push("within_limits".to_owned());
    }
    columns.push("extrapolated".to_owned());
    columns.extend(worth.do_not_use.map(|_| "do_not_use".to_owned()));
    let flag = |set: bool| u8::from(set).to_string();
    csv_text([columns].into_iter().chain(rows.iter().map(|row| {
        let TableRow { configuration, q_mm, command_mm, sd_command_mm, beyond_data, extrapolated, sharing } = row;
        let mut fields = vec![decimals(configuration.theta_deg(), 6), azimuth(configuration.delta_deg())];
        fields.extend([q_mm, command_mm, sd_command_mm].into_iter().flat_map(|mm| backbone_decimals(mm, 6)));
        fields.extend(beyond_data.map(flag));
        if let Some(sharing) = sharing {
            fields.push(decimals(sharing.common_n, 6));
            fields.extend(backbone_decimals(&sharing.actuation_n, 6));
            fields.push(flag(sharing.within));
        }
        fields.push(flag(*extrapolated));
        fields.extend(worth.do_not_use.map(|_| flag(true)));
        fields
    })))
}

/// compensation.json as text. `source` says where the model comes from: a file's name, or "built in".
///
/// # Errors
/// [`Error::Encode`] for a number that JSON cannot hold.
pub fn compensation_json(model: &Model, source: &str, grid: &Grid, rows: &[TableRow], worth: Worth) -> Result<String> {
    let file = CompensationFile {
        verdict: worth.verdict,
        do_not_use: worth.do_not_use,
        holds_if: model.conditions_of_single_poses(),
        provenance: Provenance {
            program: "snakeloop",
            version: env!("CARGO_PKG_VERSION"),
            model_source: source,
            theta_grid_deg: grid.theta.to_string(),
            delta_grid_deg: grid.delta.to_string(),
        },
        model: ModelFile::from(model),
        rows: rows.iter().map(JsonRow).collect(),
    };
    let text = serde_json::to_string_pretty(&file);
    text.map(|text| text + "\n").map_err(Error::encode("the table"))
}

/// compensation.csv and compensation.json of a folder, over the grid that ends where the model's data end, and the rows; to be written together with
/// the model. `source` says where the model comes from.
///
/// # Errors
/// A number that JSON cannot hold.
pub fn compensation_files(folder: &Path, model: &Model, source: &str, worth: Worth) -> Result<(Files, Vec<TableRow>)> {
    let grid = Grid::within_data(model);
    let rows = compensation_table(model, &grid)?;
    Ok((files(folder, (model, source), &grid, &rows, worth, false)?, rows))
}

/// Writes those of a grid of one's own, whose rows were computed already, and compensation.h as well if that is asked for.
///
/// # Errors
/// A number that JSON cannot hold, a file that cannot be written, a header that is asked for of a grid that it cannot have.
pub fn write_compensation_rows(
    folder: &Path,
    model: (&Model, &str),
    grid: &Grid,
    rows: &[TableRow],
    worth: Worth,
    c_header: bool,
) -> Result<()> {
    write_together(&files(folder, model, grid, rows, worth, c_header)?)
}

/// The files of a table. A header that stands in the folder is made anew, so that no two files of a folder command differently; it is marked as stale
/// if a header cannot have the grid.
fn files(
    folder: &Path,
    (model, source): (&Model, &str),
    grid: &Grid,
    rows: &[TableRow],
    worth: Worth,
    c_header: bool,
) -> Result<Files> {
    let path = folder.join("compensation.h");
    let header = || compensation_c_header(model, grid, rows, source, worth.do_not_use);
    let header = match (c_header, path.exists()) {
        (true, _) => Some(header()?),
        (false, true) => header().ok(),
        (false, false) => None,
    };
    let stale = worth.stale.map(in_one_line);
    let stale = stale.as_deref();
    let csv = in_csv(&compensation_csv(rows, worth), stale.is_some());
    let json = in_json(&compensation_json(model, source, grid, rows, worth)?, stale);
    let header = match header {
        Some(header) => Some((path, in_header(&header, stale))),
        None => marked_header(
            folder,
            Some("compensation.csv beside it was written anew, over a grid that a header cannot have"),
        )?,
    };
    let tables = [(folder.join("compensation.csv"), csv), (folder.join("compensation.json"), json)];
    Ok(tables.into_iter().chain(header).collect())
}

#[derive(Serialize)]
struct CompensationFile<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    verdict: Option<&'a Verdict>,
    #[serde(skip_serializing_if = "Option::is_none")]
    do_not_use: Option<&'a str>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    holds_if: Vec<String>,
    provenance: Provenance<'a>,
    model: ModelFile,
    rows: Vec<JsonRow<'a>>,
}

#[derive(Serialize)]
struct Provenance<'a> {
    program: &'static str,
    version: &'static str,
    model_source: &'a str,
    /// start:stop:step
    theta_grid_deg: String,
    delta_grid_deg: String,
}

/// A row under the names of the CSV's columns, in their order.
struct JsonRow<'a>(&'a TableRow);

impl Serialize for JsonRow<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        let TableRow { configuration, q_mm, command_mm, sd_command_mm, beyond_data, extrapolated, sharing } = self.0;
        let rounded = |value: f64| (value * 1e9).round() / 1e9;
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("theta_deg", &rounded(configuration.theta_deg()))?;
        map.serialize_entry("delta_deg", &rounded(configuration.delta_deg()))?;
        for (name, lengths) in LENGTHS.iter().zip([q_mm, command_mm, sd_command_mm]) {
            for (column, &mm) in backbone_columns(name, "mm", lengths.len()).zip(lengths) {
                map.serialize_entry(&column, &rounded(mm))?;
            }
        }
        if let Some(beyond) = beyond_data {
            map.serialize_entry("beyond_data", beyond)?;
        }
        if let Some(Sharing { common_n, actuation_n, within, .. }) = sharing {
            map.serialize_entry("common_n", common_n)?;
            for (column, force_n) in backbone_columns("f", "n", actuation_n.len()).zip(actuation_n) {
                map.serialize_entry(&column, force_n)?;
            }
            map.serialize_entry("within_limits", within)?;
        }
        map.serialize_entry("extrapolated", &u8::from(*extrapolated))?;
        map.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{Estimate, compensation_table};
    use nalgebra::Matrix2;

    fn model() -> Model {
        let covariance = Matrix2::new(1e-4, 0.0, 0.0, 4e-6);
        let estimate = Estimate { eta: 1.221, lambda_mm: 0.1765, covariance, samples: 10 };
        Model::default().with_estimate(estimate)
    }

    #[test]
    fn both_files_hold_the_same_rows() {
        let grid = Grid { theta: "0:90:45".parse().unwrap(), delta: "0:345:120".parse().unwrap() };
        let rows = compensation_table(&model(), &grid).unwrap();
        let csv = compensation_csv(&rows, Worth::default());
        let json: serde_json::Value = serde_json::from_str(
            &compensation_json(&model(), "out/model.toml", &grid, &rows, Worth::default()).unwrap(),
        )
        .unwrap();
        assert_eq!(json["model"]["estimate"]["eta"], 1.221);
        assert_eq!(json["model"]["robot"]["length_mm"], 26.0);
        assert_eq!(json["provenance"]["model_source"], "out/model.toml");
        let mut lines = csv.lines();
        let names: Vec<&str> = lines.next().unwrap().split(',').collect();
        assert_eq!(lines.clone().count(), 9);
        for (k, line) in lines.enumerate() {
            for (name, field) in names.iter().zip(line.split(',')) {
                let (in_csv, in_json) = (field.parse::<f64>().unwrap(), json["rows"][k][*name].as_f64().unwrap());
                assert!((in_csv - in_json).abs() < 1e-6, "{name}: {in_csv} {in_json}");
            }
        }
        // δ = 240° is written as −120°.
        assert_eq!(json["rows"][8]["delta_deg"], -120.0);
    }

    #[test]
    fn a_straight_snake_needs_friction_and_backlash_only() {
        let grid = Grid { theta: "0".parse().unwrap(), delta: "0".parse().unwrap() };
        let rows = compensation_table(&model(), &grid).unwrap();
        let expected = model().static_friction_mm() + 0.1765;
        let line = format!(
            "0.000000,0.000000,0.000000,0.000000,0.000000,{0:.6},{0:.6},{0:.6},0.002000,0.002000,0.002000,0",
            expected
        );
        assert_eq!(compensation_csv(&rows, Worth::default()).lines().nth(1).unwrap(), line);
    }
}
