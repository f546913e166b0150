//! compensation.csv and compensation.json: what to command for every pose of a grid.
//!
//! | column | meaning |
//! | --- | --- |
//! | `theta_deg`, `delta_deg` | the desired pose |
//! | `q1_mm` … `q3_mm` | q: what the snake's backbones are to move |
//! | `qc1_mm` … `qc3_mm` | q̃: what to command |
//! | `sd_qc1_mm` … `sd_qc3_mm` | its standard deviation, from the covariance of η and λ |
//! | `common_n` | with force limits: the force common to all backbones that they ask for |
//! | `f1_n` … `f3_n` | with force limits: what the actuation unit exerts on each, positive where it pushes |
//! | `within_limits` | with force limits: 1 where all three lie within them, else 0 |
//!
//! The JSON has the same rows under `rows`, the model under `model` with model.toml's keys, and under `provenance` what
//! made them.

use super::model::ModelFile;
use super::table::{azimuth, decimals};
use super::write::write_atomically;
use crate::error::{Error, Result};
use crate::robot::{Grid, Model, Sharing, TableRow, compensation_table};
use nalgebra::Vector3;
use serde::Serialize;
use std::path::Path;

const COLUMNS: &str = "theta_deg,delta_deg,q1_mm,q2_mm,q3_mm,qc1_mm,qc2_mm,qc3_mm,sd_qc1_mm,sd_qc2_mm,sd_qc3_mm";

const SHARING_COLUMNS: &str = ",common_n,f1_n,f2_n,f3_n,within_limits";

/// compensation.csv as text; angles to 1e-6°, lengths to 1 nm, forces to 1 µN.
pub fn compensation_csv(rows: &[TableRow]) -> String {
    let shared = rows.iter().any(|row| row.sharing.is_some());
    let mut text = format!("{COLUMNS}{}\n", if shared { SHARING_COLUMNS } else { "" });
    for TableRow { configuration, q_mm, command_mm, sd_command_mm, sharing } in rows {
        let angles = [decimals(configuration.theta_deg(), 6), azimuth(configuration.delta_deg())];
        let lengths = [q_mm, command_mm, sd_command_mm].into_iter().flatten().map(|&mm| decimals(mm, 6));
        let forces = sharing.iter().flat_map(|sharing| {
            let [a, b, c] = sharing.actuation_n.into();
            let forces = [sharing.common_n, a, b, c].map(|force| decimals(force, 6));
            forces.into_iter().chain([u8::from(sharing.within).to_string()])
        });
        text += &(angles.into_iter().chain(lengths).chain(forces).collect::<Vec<_>>().join(",") + "\n");
    }
    text
}

/// compensation.json as text. `source` says where the model comes from: a file's name, or "built in".
///
/// # Errors
/// [`Error::Domain`] for a number that JSON cannot hold.
pub fn compensation_json(model: &Model, source: &str, grid: &Grid, rows: &[TableRow]) -> Result<String> {
    let file = CompensationFile {
        provenance: Provenance {
            program: "snakeloop",
            version: env!("CARGO_PKG_VERSION"),
            model_source: source,
            theta_grid_deg: grid.theta.to_string(),
            delta_grid_deg: grid.delta.to_string(),
        },
        model: ModelFile::from(model),
        rows: rows.iter().map(JsonRow::from).collect(),
    };
    let text = serde_json::to_string_pretty(&file);
    text.map(|text| text + "\n").map_err(|e| Error::Domain(format!("cannot write the table: {e}")))
}

/// Writes compensation.csv and compensation.json into a folder, and gives the rows. `source` says where the model comes from.
///
/// # Errors
/// A grid of too many poses, a number that JSON cannot hold, a file that cannot be written.
pub fn write_compensation(folder: &Path, model: &Model, source: &str, grid: &Grid) -> Result<Vec<TableRow>> {
    let rows = compensation_table(model, grid)?;
    write_compensation_rows(folder, model, source, grid, &rows)?;
    Ok(rows)
}

/// The same for rows that were computed already.
///
/// # Errors
/// A number that JSON cannot hold, a file that cannot be written.
pub fn write_compensation_rows(
    folder: &Path,
    model: &Model,
    source: &str,
    grid: &Grid,
    rows: &[TableRow],
) -> Result<()> {
    write_atomically(&folder.join("compensation.csv"), compensation_csv(rows).as_bytes())?;
    let json = compensation_json(model, source, grid, rows)?;
    write_atomically(&folder.join("compensation.json"), json.as_bytes())
}

#[derive(Serialize)]
struct CompensationFile<'a> {
    provenance: Provenance<'a>,
    model: ModelFile,
    rows: Vec<JsonRow>,
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

#[derive(Serialize)]
struct JsonRow {
    theta_deg: f64,
    delta_deg: f64,
    q1_mm: f64,
    q2_mm: f64,
    q3_mm: f64,
    qc1_mm: f64,
    qc2_mm: f64,
    qc3_mm: f64,
    sd_qc1_mm: f64,
    sd_qc2_mm: f64,
    sd_qc3_mm: f64,
    #[serde(flatten)]
    sharing: Option<JsonSharing>,
}

#[derive(Serialize)]
struct JsonSharing {
    common_n: f64,
    f1_n: f64,
    f2_n: f64,
    f3_n: f64,
    within_limits: bool,
}

impl From<&Sharing> for JsonSharing {
    fn from(sharing: &Sharing) -> Self {
        let [f1_n, f2_n, f3_n] = sharing.actuation_n.into();
        Self { common_n: sharing.common_n, f1_n, f2_n, f3_n, within_limits: sharing.within }
    }
}

impl From<&TableRow> for JsonRow {
    fn from(row: &TableRow) -> Self {
        let rounded = |vector: &Vector3<f64>| -> [f64; 3] { vector.map(|mm| (mm * 1e9).round() / 1e9).into() };
        let [q1_mm, q2_mm, q3_mm] = rounded(&row.q_mm);
        let [qc1_mm, qc2_mm, qc3_mm] = rounded(&row.command_mm);
        let [sd_qc1_mm, sd_qc2_mm, sd_qc3_mm] = rounded(&row.sd_command_mm);
        let degrees = |angle: f64| (angle * 1e9).round() / 1e9;
        Self {
            theta_deg: degrees(row.configuration.theta_deg()),
            delta_deg: degrees(row.configuration.delta_deg()),
            q1_mm,
            q2_mm,
            q3_mm,
            qc1_mm,
            qc2_mm,
            qc3_mm,
            sd_qc1_mm,
            sd_qc2_mm,
            sd_qc3_mm,
            sharing: row.sharing.as_ref().map(JsonSharing::from),
        }
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
        Model { estimate: Some(estimate), ..Model::default() }
    }

    #[test]
    fn both_files_hold_the_same_rows() {
        let grid = Grid { theta: "0:90:45".parse().unwrap(), delta: "0:345:120".parse().unwrap() };
        let rows = compensation_table(&model(), &grid).unwrap();
        let csv = compensation_csv(&rows);
        let json: serde_json::Value =
            serde_json::from_str(&compensation_json(&model(), "out/model.toml", &grid, &rows).unwrap()).unwrap();
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
            "0.000000,0.000000,0.000000,0.000000,0.000000,{0:.6},{0:.6},{0:.6},0.002000,0.002000,0.002000",
            expected
        );
        assert_eq!(compensation_csv(&rows).lines().nth(1).unwrap(), line);
    }
}
