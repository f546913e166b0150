//! force.csv: the tip force that explains each measurement.
//!
//! | column | meaning |
//! | --- | --- |
//! | `index`, `time_s` | the frame |
//! | `fx_n`, `fy_n`, `fz_n` | the force on the tip, in {b}, without any part along the unseen direction |
//! | `sd_fx_n` … `sd_fz_n` | its standard deviations, within the directions that are seen |
//! | `unseen_x` … `unseen_z` | the direction, a unit vector, along which a force moves nothing |
//! | `status` | `used`, or why the measurement was not |

use super::columns::{csv_text, decimals, decimals_or_empty};
use crate::estimate::ForceRow;
use nalgebra::Vector3;

const COLUMNS: [&str; 12] = [
    "index", "time_s", "fx_n", "fy_n", "fz_n", "sd_fx_n", "sd_fy_n", "sd_fz_n", "unseen_x", "unseen_y", "unseen_z",
    "status",
];

/// force.csv as text.
pub fn forces_csv(rows: &[ForceRow]) -> String {
    let numbers = |vector: Option<Vector3<f64>>| -> [String; 3] {
        vector.map_or_else(Default::default, |v| [v.x, v.y, v.z].map(|value| decimals(value, 5)))
    };
    let header = COLUMNS.map(str::to_owned).to_vec();
    csv_text([header].into_iter().chain(rows.iter().map(|row| {
        [
            &[row.index.to_string(), decimals_or_empty(row.time_s, 4)],
            &numbers(row.force.map(|found| found.force_n))[..],
            &numbers(row.force.map(|found| found.sd_n)),
            &numbers(row.force.and_then(|found| found.unseen)),
            &[row.reason.clone().unwrap_or_else(|| "used".to_owned())],
        ]
        .concat()
    })))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::MeasuredForce;

    #[test]
    fn every_row_has_all_columns() {
        let seen = MeasuredForce {
            force_n: Vector3::new(0.1, 0.2, 0.3),
            sd_n: Vector3::repeat(0.01),
            unseen: Some(Vector3::z()),
        };
        let row = ForceRow { index: 1, time_s: Some(0.5), force: Some(seen), reason: None };
        let failed = ForceRow { force: None, reason: Some("no_snake".into()), ..row.clone() };
        let text = forces_csv(&[row, failed]);
        assert!(text.lines().all(|line| line.matches(',').count() == 11), "{text}");
        assert!(text.contains("0.10000,0.20000,0.30000") && text.ends_with("no_snake\n"));
    }
}
