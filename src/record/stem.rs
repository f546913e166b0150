//! stem.csv: how far the flexible stem was bent at each measurement.
//!
//! | column | meaning |
//! | --- | --- |
//! | `index`, `time_s` | the frame |
//! | `phi_deg`, `sd_phi_deg` | the stem's total bending angle after this measurement, and its standard deviation |
//! | `status` | `used`, or why the measurement was not |

use super::columns::{csv_text, decimals, decimals_or_empty};
use crate::estimate::StemRow;

/// stem.csv as text.
pub fn stems_csv(rows: &[StemRow]) -> String {
    let header = ["index", "time_s", "phi_deg", "sd_phi_deg", "status"].map(str::to_owned);
    csv_text([header].into_iter().chain(rows.iter().map(|row| {
        [
            row.index.to_string(),
            decimals_or_empty(row.time_s, 4),
            decimals(row.phi.to_degrees(), 4),
            decimals(row.sd_phi.to_degrees(), 4),
            row.reason.clone().unwrap_or_else(|| "used".to_owned()),
        ]
    })))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_has_its_angle_in_degrees_and_its_status() {
        let row = StemRow { index: 3, time_s: Some(1.5), phi: 1.0, sd_phi: 0.1, reason: None };
        let skipped = StemRow { index: 4, time_s: None, reason: Some("no_snake".into()), ..row.clone() };
        let text = stems_csv(&[row, skipped]);
        let lines: Vec<_> = text.lines().collect();
        assert_eq!(lines[1..], ["3,1.5000,57.2958,5.7296,used", "4,,57.2958,5.7296,no_snake"]);
    }
}
