//! encoders.csv: `index,time_s,q1_mm,q2_mm,q3_mm`, what the actuators' encoders read at each frame.

use super::measurement::EncoderReading;
use super::table::{self, Checked, Indexed, decimals};
use crate::error::Result;
use nalgebra::Vector3;
use std::path::Path;

const COLUMNS: [&str; 5] = ["index", "time_s", "q1_mm", "q2_mm", "q3_mm"];

impl Indexed for EncoderReading {
    fn index(&self) -> u64 {
        self.index
    }
}

/// Reads encoders.csv. The readings come in order of their index, each index once.
///
/// # Errors
/// A file that cannot be read, lacks a column or has no usable row. A bad row is a warning.
pub fn read_encoders(path: &Path) -> Result<Checked<EncoderReading>> {
    table::read(path, &COLUMNS, |row| {
        Ok(EncoderReading {
            index: row.index("index")?,
            time_s: row.number("time_s")?,
            q_mm: Vector3::new(row.number("q1_mm")?, row.number("q2_mm")?, row.number("q3_mm")?),
        })
    })
}

/// encoders.csv as text: time to 0.1 ms, q̃ to 1 nm.
pub fn encoders_csv(readings: &[EncoderReading]) -> String {
    let mut text = COLUMNS.join(",") + "\n";
    for reading in readings {
        let q = reading.q_mm.map(|q| decimals(q, 6));
        text += &format!("{},{},{},{},{}\n", reading.index, decimals(reading.time_s, 4), q.x, q.y, q.z);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::write_atomically;
    use proptest::prelude::*;

    #[test]
    fn reads_what_the_design_promises() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("encoders.csv");
        write_atomically(&path, b"index,time_s,q1_mm,q2_mm,q3_mm\n0,0.25,-0.14489,0.33690,0.36236\n").unwrap();
        let checked = read_encoders(&path).unwrap();
        let q_mm = Vector3::new(-0.14489, 0.33690, 0.36236);
        assert_eq!(checked.rows, [EncoderReading { index: 0, time_s: 0.25, q_mm }]);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn what_was_written_is_read(values in proptest::collection::vec((0.0..1e5, -9.0..9.0, -9.0..9.0, -9.0..9.0), 1..20)) {
            let readings: Vec<_> = values
                .iter()
                .enumerate()
                .map(|(i, &(time_s, a, b, c))| EncoderReading { index: 3 * i as u64, time_s, q_mm: Vector3::new(a, b, c) })
                .collect();
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("encoders.csv");
            write_atomically(&path, encoders_csv(&readings).as_bytes()).unwrap();
            let checked = read_encoders(&path).unwrap();
            prop_assert!(checked.warnings.is_empty());
            prop_assert_eq!(checked.rows.len(), readings.len());
            for (read, written) in checked.rows.iter().zip(&readings) {
                prop_assert_eq!(read.index, written.index);
                prop_assert!((read.time_s - written.time_s).abs() <= 0.51e-4);
                prop_assert!((read.q_mm - written.q_mm).amax() <= 0.51e-6);
            }
        }
    }
}
