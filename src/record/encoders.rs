//! encoders.csv: `index,time_s,q1_mm,q2_mm,q3_mm`, what the actuators' encoders read at each frame; a column for each backbone.

use super::columns::{backbone_columns, backbone_decimals, csv_text, decimals};
use super::table::{self, Checked, Indexed};
use crate::error::Result;
use crate::observation::EncoderReading;
use crate::robot::{BACKBONES, PerBackbone};
use std::path::Path;

/// The columns on a robot of so many backbones.
fn columns(backbones: usize) -> Vec<String> {
    ["index", "time_s"].map(str::to_owned).into_iter().chain(backbone_columns("q", "mm", backbones)).collect()
}

impl Indexed for EncoderReading {
    fn index(&self) -> u64 {
        self.index
    }
}

/// Reads the encoders.csv of a robot of so many backbones. The readings come in order of their index, each index once.
///
/// # Errors
/// A file that cannot be read, lacks a column, has a column of a further backbone or no usable row. A bad row is a warning.
pub fn read_encoders(path: &Path, backbones: usize) -> Result<Checked<EncoderReading>> {
    let columns = columns(backbones);
    let required: Vec<&str> = columns.iter().map(String::as_str).collect();
    let fits = |is_there: &dyn Fn(&str) -> bool| {
        let found = backbone_columns("q", "mm", usize::from(u8::MAX)).take_while(|name| is_there(name)).count();
        if found < *BACKBONES.start() || found == backbones {
            return Ok(());
        }
        Err(format!("q1_mm to q{found}_mm, expected q1_mm to q{backbones}_mm: the robot has {backbones} backbones"))
    };
    table::read_where(path, &required, fits, |row| {
        let (index, time_s) = (row.index("index")?, row.number("time_s")?);
        let mut q_mm = PerBackbone::repeat(backbones, 0.0);
        for (q, column) in q_mm.iter_mut().zip(&columns[2..]) {
            *q = row.number(column)?;
        }
        Ok(EncoderReading { index, time_s, q_mm })
    })
}

/// The encoders.csv of a robot of so many backbones as text: time to 0.1 ms, q̃ to 1 nm.
pub fn encoders_csv(readings: &[EncoderReading], backbones: usize) -> String {
    csv_text([columns(backbones)].into_iter().chain(readings.iter().map(|reading| {
        let frame = [reading.index.to_string(), decimals(reading.time_s, 4)];
        frame.into_iter().chain(backbone_decimals(&reading.q_mm, 6)).collect()
    })))
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
        let checked = read_encoders(&path, 3).unwrap();
        let q_mm = PerBackbone::from([-0.14489, 0.33690, 0.36236]);
        assert_eq!(checked.rows, [EncoderReading { index: 0, time_s: 0.25, q_mm }]);
    }

    #[test]
    fn a_log_of_another_robot_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("encoders.csv");
        for (columns, backbones) in [(3, 4), (4, 3), (8, 6)] {
            let reading = EncoderReading { index: 0, time_s: 0.0, q_mm: PerBackbone::repeat(columns, 0.1) };
            write_atomically(&path, encoders_csv(&[reading], columns).as_bytes()).unwrap();
            let said = read_encoders(&path, backbones).unwrap_err().to_string();
            let expected = format!(
                "encoders.csv:1: q1_mm to q{columns}_mm, expected q1_mm to q{backbones}_mm: the robot has {backbones} backbones"
            );
            assert!(said.ends_with(&expected), "{said}");
        }
        write_atomically(&path, b"index,time_s,q1_mm,q2_mm\n0,0,1,2\n").unwrap();
        let said = read_encoders(&path, 3).unwrap_err().to_string();
        assert!(said.contains(":1: column q3_mm is missing"), "{said}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn what_was_written_is_read(
            backbones in BACKBONES,
            values in proptest::collection::vec((0.0..1e5, proptest::array::uniform8(-9.0..9.0)), 1..20)
        ) {
            let readings: Vec<_> = values
                .iter()
                .enumerate()
                .map(|(i, (time_s, q))| {
                    let q_mm = PerBackbone::from_fn(backbones, |i| q[i]);
                    EncoderReading { index: 3 * i as u64, time_s: *time_s, q_mm }
                })
                .collect();
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("encoders.csv");
            write_atomically(&path, encoders_csv(&readings, backbones).as_bytes()).unwrap();
            let checked = read_encoders(&path, backbones).unwrap();
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
