//! friction.csv: `index,tau_g,tau_limit_g,tau_tilde_g,tau_tilde_limit_g`, the weighings of the friction calibration.

use super::table::{self, Checked, Indexed};
use crate::error::Result;
use crate::robot::FrictionSample;
use std::path::Path;

const COLUMNS: [&str; 5] = ["index", "tau_g", "tau_limit_g", "tau_tilde_g", "tau_tilde_limit_g"];

impl Indexed for FrictionSample {
    fn index(&self) -> u64 {
        self.index
    }
}

/// Reads the weighings of a friction calibration, in order of their index.
///
/// # Errors
/// A file that cannot be read, lacks a column or has no usable row. A bad row is a warning.
pub fn read_friction(path: &Path) -> Result<Checked<FrictionSample>> {
    table::read(path, &COLUMNS, |row| {
        let limit = |column| match row.number(column)? {
            limit if limit >= 0.0 => Ok(limit),
            limit => Err(format!("{column} is {limit}, expected a limit of error that is not negative")),
        };
        Ok(FrictionSample {
            index: row.index("index")?,
            tau_g: row.number("tau_g")?,
            tau_limit_g: limit("tau_limit_g")?,
            tau_tilde_g: row.number("tau_tilde_g")?,
            tau_tilde_limit_g: limit("tau_tilde_limit_g")?,
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::friction::table_ii;

    #[test]
    fn the_calibration_file_holds_table_ii() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("calib/friction.csv");
        let checked = read_friction(&path).unwrap();
        assert!(checked.warnings.is_empty());
        assert_eq!(checked.rows, table_ii());
    }
}
