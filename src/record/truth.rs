//! truth.csv: `index,theta_deg,delta_deg`, what synthetic frames show. Only tests and scoring read it.

use super::columns::{azimuth, csv_text, decimals};
use super::table::{self, Checked, Indexed};
use crate::error::Result;
use crate::geometry::Configuration;
use crate::observation::Truth;
use std::path::Path;

const COLUMNS: [&str; 3] = ["index", "theta_deg", "delta_deg"];

impl Indexed for Truth {
    fn index(&self) -> u64 {
        self.index
    }
}

/// Reads truth.csv, in order of the index.
///
/// # Errors
/// A file that cannot be read, lacks a column or has no usable row. A bad row is a warning.
pub fn read_truth(path: &Path) -> Result<Checked<Truth>> {
    table::read(path, &COLUMNS, |row| {
        Ok(Truth {
            index: row.index("index")?,
            configuration: Configuration::from_degrees(row.number("theta_deg")?, row.number("delta_deg")?),
        })
    })
}

/// truth.csv as text, to 1e-6 degrees.
pub fn truth_csv(truths: &[Truth]) -> String {
    let header = COLUMNS.map(str::to_owned);
    csv_text([header].into_iter().chain(truths.iter().map(|truth| {
        let psi = truth.configuration;
        [truth.index.to_string(), decimals(psi.theta_deg(), 6), azimuth(psi.delta_deg())]
    })))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_azimuth_of_a_full_turn_is_wrapped_and_written_within_half_a_turn() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("truth.csv");
        std::fs::write(&path, "index,theta_deg,delta_deg\n30,28.688914,188.243172\n31,5,-180\n").unwrap();
        let checked = read_truth(&path).unwrap();
        assert_eq!(
            truth_csv(&checked.rows),
            "index,theta_deg,delta_deg\n30,28.688914,-171.756828\n31,5.000000,180.000000\n"
        );
    }
}
