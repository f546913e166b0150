//! encoders.csv: `index,time_s,q1_mm,q2_mm,q3_mm`, what the actuators' encoders read at each frame; a column for each backbone. Of a robot of
//! several sections the readings of up to two neighbours may follow: `n1_q1_mm,n1_q2_mm,n1_q3_mm`, then `n2_q1_mm` and so on.

use super::columns::{backbone_columns, backbone_decimals, csv_text, decimals};
use super::log::LogProposal;
use super::table::{self, Checked, Indexed, Row, RowResult};
use crate::error::Result;
use crate::observation::EncoderReading;
use crate::robot::{BACKBONES, NEIGHBOURS, Neighbours, PerBackbone};
use std::path::Path;

/// The columns on a robot of so many backbones.
pub(super) fn columns(backbones: usize) -> Vec<String> {
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
    read_encoders_kept(path, backbones, |_| true)
}

/// [`read_encoders`], of which only readings with some indices are kept: memory grows with these alone.
///
/// # Errors
/// Those of [`read_encoders`].
pub fn read_encoders_kept(
    path: &Path,
    backbones: usize,
    is_kept: impl Fn(u64) -> bool,
) -> Result<Checked<EncoderReading>> {
    let columns = columns(backbones);
    let required: Vec<&str> = columns.iter().map(String::as_str).collect();
    let fits = |header: &[String]| fits(header, backbones);
    table::read_kept(path, &required, fits, reading_of(&columns), |reading| is_kept(reading.index))
}

/// A row whose columns are these: index, time and the backbones'.
pub(super) fn reading_of(columns: &[String]) -> impl Fn(&Row) -> RowResult<EncoderReading> {
    |row| {
        let (index, time_s) = (row.index("index")?, row.time()?);
        Ok(EncoderReading { index, time_s, q_mm: displacements(row, &columns[2..])?, neighbours: neighbours_of(row)? })
    }
}

/// The numbers of the backbones' columns.
pub(super) fn displacements(row: &Row, columns: &[String]) -> RowResult<PerBackbone> {
    let mut q_mm = PerBackbone::repeat(columns.len(), 0.0);
    for (q, column) in q_mm.iter_mut().zip(columns) {
        *q = row.number(column)?;
    }
    Ok(q_mm)
}

/// Whether a header can be that of a robot of so many backbones; of one that has none of the columns, how `[log]` would read it.
fn fits(header: &[String], backbones: usize) -> RowResult<()> {
    let is_there = |name: &str| header.iter().any(|known| known == name);
    let found = backbone_columns("q", "mm", usize::from(u8::MAX)).take_while(|name| is_there(name)).count();
    if found == 0
        && let Some(proposal) = LogProposal::of(header, backbones)
    {
        let header = header.join(",");
        return Err(format!(
            "the header has {header}, expected {}; if these are the readings, write into experiment.toml, which commands take in place of the log as well: {proposal}",
            columns(backbones).join(",")
        ));
    }
    if found < *BACKBONES.start() || found == backbones {
        return neighbours_fit(header);
    }
    Err(format!("q1_mm to q{found}_mm, expected q1_mm to q{backbones}_mm: the robot has {backbones} backbones"))
}

/// The columns of a neighbour of so many backbones; neighbours count from 0.
fn neighbour_columns(neighbour: usize, backbones: usize) -> impl Iterator<Item = String> {
    backbone_columns("q", "mm", backbones).map(move |column| format!("n{}_{column}", neighbour + 1))
}

/// What a row says of the neighbours; a file without their columns says nothing.
pub(super) fn neighbours_of(row: &Row) -> RowResult<Neighbours> {
    let mut neighbours = Neighbours::default();
    for (k, q_mm) in neighbours.q_mm.iter_mut().enumerate() {
        let columns: Vec<String> = neighbour_columns(k, *BACKBONES.end()).take_while(|name| row.has(name)).collect();
        *q_mm = PerBackbone::repeat(columns.len(), 0.0);
        for (q, column) in q_mm.iter_mut().zip(&columns) {
            *q = row.number(column)?;
        }
    }
    Ok(neighbours)
}

/// Whether the columns of neighbours can be theirs: as many as a section can have backbones, the first neighbour's where there is a second.
pub(super) fn neighbours_fit(header: &[String]) -> RowResult<()> {
    let is_there = |name: &str| header.iter().any(|known| known == name);
    let counts: Vec<usize> = (0..NEIGHBOURS)
        .map(|k| neighbour_columns(k, usize::from(u8::MAX)).take_while(|name| is_there(name)).count())
        .collect();
    for (k, &count) in counts.iter().enumerate() {
        let n = k + 1;
        if count > 0 && !BACKBONES.contains(&count) {
            let (least, most) = (BACKBONES.start(), BACKBONES.end());
            return Err(format!(
                "n{n}_q1_mm to n{n}_q{count}_mm, expected {least} to {most} columns for a neighbour's backbones"
            ));
        }
        if k > 0 && count > 0 && counts[k - 1] == 0 {
            return Err(format!(
                "n{n}_q1_mm without n{k}_q1_mm: name the columns of the only neighbour n1_q1_mm and so on"
            ));
        }
    }
    Ok(())
}

/// The encoders.csv of a robot of so many backbones as text: time to 0.1 ms, q̃ to 1 nm. It has the neighbours that the first reading has.
pub fn encoders_csv(readings: &[EncoderReading], backbones: usize) -> String {
    let mut header = columns(backbones);
    for (k, q_mm) in readings.first().iter().flat_map(|first| first.neighbours.q_mm.iter().enumerate()) {
        header.extend(neighbour_columns(k, q_mm.len()));
    }
    csv_text([header].into_iter().chain(readings.iter().map(|reading| {
        let frame = [reading.index.to_string(), decimals(reading.time_s, 4)];
        let all = [reading.q_mm].into_iter().chain(reading.neighbours.q_mm);
        frame.into_iter().chain(all.flat_map(|q_mm| backbone_decimals(&q_mm, 6).collect::<Vec<_>>())).collect()
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
        assert_eq!(checked.rows, [EncoderReading::new(0, 0.25, q_mm)]);
    }

    #[test]
    fn a_log_of_another_robot_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("encoders.csv");
        for (columns, backbones) in [(3, 4), (4, 3), (8, 6)] {
            let reading = EncoderReading::new(0, 0.0, PerBackbone::repeat(columns, 0.1));
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

    #[test]
    fn columns_of_neighbours_are_read_where_they_are_there_and_refused_where_they_cannot_be_theirs() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("encoders.csv");
        let head = "index,time_s,q1_mm,q2_mm,q3_mm";
        let read = |columns: &str, row: &str| {
            write_atomically(&path, format!("{head},{columns}\n0,0,1,2,3,{row}\n1,1,1,2,3,{row}\n").as_bytes())
                .unwrap();
            read_encoders(&path, 3)
        };
        let (four, three) = (PerBackbone::from([4.0, 5.0, 6.0, 7.0]), PerBackbone::from([8.0, 9.0, 10.0]));
        let both = read("n1_q1_mm,n1_q2_mm,n1_q3_mm,n1_q4_mm,n2_q1_mm,n2_q2_mm,n2_q3_mm", "4,5,6,7,8,9,10").unwrap();
        assert_eq!(both.rows[1].neighbours, Neighbours { q_mm: [four, three] });
        let none = read("note", "x").unwrap();
        assert_eq!(none.rows[0].neighbours, Neighbours::default());
        let said = |columns: &str, row: &str| read(columns, row).unwrap_err().to_string();
        let two = said("n1_q1_mm,n1_q2_mm", "4,5");
        assert!(
            two.ends_with(":1: n1_q1_mm to n1_q2_mm, expected 3 to 8 columns for a neighbour's backbones"),
            "{two}"
        );
        let second = said("n2_q1_mm,n2_q2_mm,n2_q3_mm", "4,5,6");
        assert!(second.contains("n2_q1_mm without n1_q1_mm"), "{second}");
        let empty = read("n1_q1_mm,n1_q2_mm,n1_q3_mm", "4,,6").unwrap_err().to_string();
        assert!(empty.contains("n1_q2_mm is empty"), "{empty}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn what_was_written_is_read(
            backbones in BACKBONES,
            neighbours in (0..=2usize, BACKBONES),
            values in proptest::collection::vec((0.0..1e5, proptest::array::uniform8(-9.0..9.0)), 1..20)
        ) {
            let readings: Vec<_> = values
                .iter()
                .enumerate()
                .map(|(i, (time_s, q))| {
                    let q_mm = PerBackbone::from_fn(backbones, |i| q[i]);
                    let beside = |k: usize| PerBackbone::from_fn(if k < neighbours.0 { neighbours.1 } else { 0 }, |i| q[(i + k) % 8]);
                    let neighbours = Neighbours { q_mm: [beside(0), beside(1)] };
                    EncoderReading { index: 3 * i as u64, time_s: *time_s, q_mm, neighbours }
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
                for (read, written) in read.neighbours.q_mm.iter().zip(&written.neighbours.q_mm) {
                    prop_assert!(read.len() == written.len() && (*read - *written).amax() <= 0.51e-6);
                }
            }
        }
    }
}
