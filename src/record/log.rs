//! `[log]` of experiment.toml: which columns of an encoder log mean what, and in which unit; and what it would have to say of a header.

use super::dialect::{Sheet, Unit, text_of, unit_of};
use super::encoders::{columns, displacements, reading_of};
use super::interpolation::{Matched, Stamped};
use super::table::{self, Checked, Renamed, Row};
use crate::error::{Error, Result};
use crate::input::{TABLE_BYTES, read_bytes};
use crate::observation::EncoderReading;
use serde::Deserialize;
use std::f64::consts::{PI, TAU};
use std::fmt;
use std::path::Path;

/// `[log]` of an experiment.toml: what it leaves out is as encoders.csv has it. Where it names a time and no index, rows are matched to frames
/// by time.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogKeys {
    /// The column of the frame's index.
    pub index: Option<String>,
    /// The column of the time.
    pub time: Option<String>,
    /// What the time is counted in.
    pub time_unit: Option<TimeUnit>,
    /// The column of each backbone's reading.
    pub q: Option<Vec<String>>,
    /// What the readings are counted in; mm where it is not said.
    pub unit: Option<ReadingUnit>,
    /// Radius of the drum that an angle winds a backbone on, mm.
    pub drum_radius_mm: Option<f64>,
    /// How many counts of an encoder are one mm, or with a drum one revolution of it.
    pub counts_per_unit: Option<f64>,
}

/// What a time is counted in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TimeUnit {
    /// Seconds.
    S,
    /// Milliseconds.
    Ms,
    /// Microseconds.
    Us,
    /// Nanoseconds.
    Ns,
}

/// What a reading is counted in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ReadingUnit {
    /// Millimetres.
    Mm,
    /// Metres.
    M,
    /// Micrometres.
    Um,
    /// Inches.
    Inch,
    /// Degrees of a drum.
    Deg,
    /// Radians of a drum.
    Rad,
    /// Counts of an encoder.
    Counts,
}

impl TimeUnit {
    /// s.
    pub fn seconds(self) -> f64 {
        match self {
            Self::S => 1.0,
            Self::Ms => 1e-3,
            Self::Us => 1e-6,
            Self::Ns => 1e-9,
        }
    }
}

impl LogKeys {
    /// Whether the rows are matched to frames by time: a column of times is named, and none of indices.
    pub fn is_by_time(&self) -> bool {
        self.time.is_some() && self.index.is_none()
    }

    /// The columns of rows that come without an index, the time's first, and then each backbone's: as the log calls them, and what one unit
    /// of each is, s or mm.
    ///
    /// # Errors
    /// A key that does not fit the robot or another key, in words.
    pub fn columns(&self, backbones: usize) -> std::result::Result<Vec<(String, f64)>, String> {
        let renamed = self.renamed(backbones)?;
        let column = |name: &String| match renamed.iter().find(|column| column.to == *name) {
            Some(Renamed { from, scale, .. }) => (from.clone(), *scale),
            None => (name.clone(), 1.0),
        };
        Ok(columns(backbones)[1..].iter().map(column).collect())
    }

    /// What one unit of a reading is, mm.
    ///
    /// # Errors
    /// A unit that lacks what turns it into mm, a number that is not positive.
    fn scale_mm(&self) -> std::result::Result<f64, String> {
        let positive = |key: &str, value: Option<f64>| match value {
            Some(value) if !(value.is_finite() && value > 0.0) => Err(format!("{key} = {value}, expected more than 0")),
            value => Ok(value),
        };
        let radius_mm = positive("drum_radius_mm", self.drum_radius_mm)?;
        let counts = positive("counts_per_unit", self.counts_per_unit)?;
        let unit = self.unit.unwrap_or(ReadingUnit::Mm);
        let needs = |key: &str| format!("unit needs {key}, which says how many mm a unit of the log is");
        let is_angle = matches!(unit, ReadingUnit::Deg | ReadingUnit::Rad);
        if radius_mm.is_some() && !is_angle && unit != ReadingUnit::Counts {
            return Err("drum_radius_mm belongs to unit = \"deg\", \"rad\" or \"counts\"; remove it, or correct unit"
                .to_owned());
        }
        if counts.is_some() && unit != ReadingUnit::Counts {
            return Err("counts_per_unit belongs to unit = \"counts\"; remove it, or correct unit".to_owned());
        }
        Ok(match unit {
            ReadingUnit::Mm => 1.0,
            ReadingUnit::M => 1e3,
            ReadingUnit::Um => 1e-3,
            ReadingUnit::Inch => 25.4,
            ReadingUnit::Rad => radius_mm.ok_or_else(|| needs("drum_radius_mm"))?,
            ReadingUnit::Deg => radius_mm.ok_or_else(|| needs("drum_radius_mm"))? * PI / 180.0,
            ReadingUnit::Counts => {
                radius_mm.map_or(1.0, |radius_mm| TAU * radius_mm) / counts.ok_or_else(|| needs("counts_per_unit"))?
            }
        })
    }

    /// The columns of the file by the names that they have here.
    fn renamed(&self, backbones: usize) -> std::result::Result<Vec<Renamed>, String> {
        let scale_mm = self.scale_mm()?;
        let columns = columns(backbones);
        let q = self.q.as_deref().unwrap_or(&columns[2..]);
        if q.len() != backbones {
            return Err(format!("q = {q:?}, expected {backbones} columns, one for each backbone"));
        }
        if let Some(twice) = (1..q.len()).find(|&i| q[..i].contains(&q[i])) {
            return Err(format!("q names the column {:?} twice, expected one for each backbone", q[twice]));
        }
        let renamed = |from: &str, to: &str, scale: f64| Renamed { from: from.to_owned(), to: to.to_owned(), scale };
        let seconds = self.time_unit.map_or(1.0, TimeUnit::seconds);
        let time = self.time.as_ref().map(|time| renamed(time, "time_s", seconds));
        let time = time.or(self.time_unit.map(|_| renamed("time_s", "time_s", seconds)));
        let index = self.index.as_ref().map(|index| renamed(index, "index", 1.0));
        let backbones = q.iter().zip(&columns[2..]).map(|(from, to)| renamed(from, to, scale_mm));
        Ok(index.into_iter().chain(time).chain(backbones).collect())
    }
}

/// Reads an encoder log as `[log]` says. Rows without an index are matched by time to `stamps_s`, the time of each frame by its index; of those
/// with an index only some are kept, as in [`read_encoders_kept`](super::read_encoders_kept).
///
/// # Errors
/// As [`read_encoders`](super::read_encoders); a key that does not fit the header or the robot; frames that tell no times where they are needed.
pub fn read_log(
    path: &Path,
    backbones: usize,
    keys: &LogKeys,
    stamps_s: impl FnOnce() -> Result<Vec<(u64, f64)>>,
    is_kept: impl Fn(u64) -> bool,
) -> Result<Checked<EncoderReading>> {
    let names = keys.renamed(backbones).map_err(|why| Error::content(path, format!("[log] {why}")))?;
    let columns = columns(backbones);
    let required: Vec<&str> = columns.iter().map(String::as_str).collect();
    if !keys.is_by_time() {
        let is_kept = |reading: &EncoderReading| is_kept(reading.index);
        let (rows, mut warnings) = table::read_renamed(path, &names, &required, reading_of(&columns), is_kept)?;
        let rows = table::in_order_once(rows, &mut warnings);
        return table::checked(path, rows, warnings);
    }
    let row = |row: &Row| Ok(Stamped { time_s: row.time()?, q: displacements(row, &columns[2..])? });
    let (rows, warnings) = table::read_renamed(path, &names, &required[1..], row, |_| true)?;
    let rows = rows.into_iter().map(|(_, row)| row).collect();
    let Checked { rows, warnings } = table::checked(path, rows, warnings)?;
    let matched = Matched::of(path, "the log", rows, &stamps_s()?);
    Ok(Checked { rows: matched.readings, warnings: warnings.into_iter().chain(matched.warnings).collect() })
}

/// Names of columns, in lower case and without their unit, that usually hold a frame's index.
const INDICES: [&str; 12] =
    ["index", "frame", "frame_index", "frame_id", "frame_no", "frame_number", "img", "image", "idx", "i", "id", "n"];

/// What `[log]` would have to say of a header that is not that of encoders.csv. It is a guess, to be shown and not to be used: a unit that the
/// header does not tell is left for a person to write.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogProposal {
    /// The keys with their values, as TOML.
    keys: Vec<String>,
}

impl LogProposal {
    /// As the table of an experiment.toml.
    pub fn toml(&self) -> String {
        format!("[log]\n{}\n", self.keys.join("\n"))
    }

    /// Of a header; `None` where it shows no columns for so many backbones.
    pub fn of(header: &[String], backbones: usize) -> Option<Self> {
        let q = alike(header, backbones)?;
        let others: Vec<Named> = header.iter().filter(|name| !q.contains(name)).map(|name| Named::of(name)).collect();
        let index = others.iter().find(|column| INDICES.contains(&column.stem.as_str()));
        let is_time = |column: &&Named| {
            let stem = &column.stem;
            stem == "t" || ["time", "stamp", "clock", "elapsed"].iter().any(|word| stem.contains(word))
        };
        let time = others.iter().find(is_time);
        let mut keys = Vec::new();
        keys.extend(index.map(|column| format!("index = {:?}", column.name)));
        keys.extend(time.map(|column| format!("time = {:?}", column.name)));
        if let Some(Unit::Seconds(seconds)) = time.and_then(|column| column.unit) {
            let units = [(1.0, "s"), (1e-3, "ms"), (1e-6, "us"), (1e-9, "ns")];
            let unit = units.into_iter().find(|(size, _)| *size == seconds);
            keys.extend(unit.map(|(_, unit)| format!("time_unit = {unit:?}")));
        }
        keys.push(format!("q = {q:?}"));
        let (unit, of_a_drum) = match Named::of(&q[0]).unit {
            Some(Unit::Radians(1.0)) => ("rad", true),
            Some(Unit::Radians(_)) => ("deg", true),
            Some(Unit::Millimetres(1e3)) => ("m", false),
            Some(Unit::Millimetres(1e-3)) => ("um", false),
            Some(Unit::Millimetres(25.4)) => ("inch", false),
            Some(Unit::Millimetres(_)) => ("mm", false),
            Some(Unit::Seconds(_)) | None => ("UNIT", false),
        };
        keys.push(format!("unit = {unit:?}"));
        keys.extend(of_a_drum.then(|| "drum_radius_mm = 0.0".to_owned()));
        Some(Self { keys })
    }

    /// Of a file whose header is not that of encoders.csv.
    pub fn of_file(path: &Path, backbones: usize) -> Option<Self> {
        let bytes = read_bytes(path, TABLE_BYTES).ok()?;
        let text = text_of(path, &bytes).ok()?;
        let columns = columns(backbones);
        let required: Vec<&str> = columns.iter().map(String::as_str).collect();
        let header = Sheet::of(&text, &required).header;
        if required.iter().all(|name| header.iter().any(|known| known == name)) {
            None
        } else {
            Self::of(&header, backbones)
        }
    }
}

impl fmt::Display for LogProposal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "[log] with {} (unit: mm, m, um, inch, deg or rad of a drum, counts)", self.keys.join(", "))
    }
}

/// A column's name without the unit at its end.
struct Named {
    name: String,
    stem: String,
    unit: Option<Unit>,
}

impl Named {
    fn of(name: &str) -> Self {
        let lower = name.to_lowercase();
        let parts = lower.trim_end_matches([')', ']']).rsplit_once(['_', ' ', '(', '[', '/']);
        let found = parts
            .and_then(|(stem, unit)| Some((stem.trim_end_matches([' ', '_', '(', '[']).to_owned(), unit_of(unit)?)));
        let (stem, unit) = found.map_or((lower.clone(), None), |(stem, unit)| (stem, Some(unit)));
        Self { name: name.to_owned(), stem: stem.replace([' ', '-'], "_"), unit }
    }
}

/// The first columns, one for each backbone, whose names differ by a number alone that counts up.
fn alike(header: &[String], backbones: usize) -> Option<Vec<String>> {
    let pattern = |name: &str| -> Option<(String, u32)> {
        let start = name.find(|c: char| c.is_ascii_digit())?;
        let digits: String = name[start..].chars().take_while(char::is_ascii_digit).collect();
        Some((format!("{}\0{}", &name[..start], &name[start + digits.len()..]), digits.parse().ok()?))
    };
    let numbered: Vec<(&String, (String, u32))> =
        header.iter().filter_map(|name| Some((name, pattern(name)?))).collect();
    numbered.iter().find_map(|(_, (stem, first))| {
        let of_stem = (0..backbones as u32).map(|k| {
            numbered
                .iter()
                .find(|(_, (other, number))| other == stem && *number == first + k)
                .map(|(name, _)| (*name).clone())
        });
        of_stem.collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys(text: &str) -> LogKeys {
        toml::from_str(text).unwrap()
    }

    fn read(keys_text: &str, table: &str) -> Result<Checked<EncoderReading>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.csv");
        std::fs::write(&path, table).unwrap();
        read_log(&path, 3, &keys(keys_text), || Ok(vec![(0, 0.1), (1, 0.25)]), |_| true)
    }

    #[test]
    fn columns_and_units_are_read_as_they_are_named() {
        let text = "index = \"frame\"\ntime = \"timestamp_ms\"\ntime_unit = \"ms\"\nq = [\"m1\", \"m2\", \"m3\"]\nunit = \"rad\"\ndrum_radius_mm = 8.0";
        let found = read(text, "frame;timestamp_ms;m1;note;m2;m3\n4;250;0,5;x;-0,25;1\n").unwrap().rows;
        assert_eq!((found[0].index, found[0].time_s), (4, 0.25));
        assert_eq!(found[0].q_mm, crate::robot::PerBackbone::from([4.0, -2.0, 8.0]));
    }

    #[test]
    fn every_unit_is_so_many_millimetres() {
        for (text, mm) in [
            ("", 1.0),
            ("unit = \"m\"", 1000.0),
            ("unit = \"um\"", 0.001),
            ("unit = \"inch\"", 25.4),
            ("unit = \"rad\"\ndrum_radius_mm = 5", 5.0),
            ("unit = \"deg\"\ndrum_radius_mm = 180.0", PI),
            ("unit = \"counts\"\ncounts_per_unit = 400", 0.0025),
            ("unit = \"counts\"\ncounts_per_unit = 2000\ndrum_radius_mm = 10", PI / 100.0),
        ] {
            assert!((keys(text).scale_mm().unwrap() - mm).abs() < 1e-12, "{text}");
        }
        for text in
            ["unit = \"rad\"", "unit = \"counts\"", "drum_radius_mm = 8", "unit = \"rad\"\ndrum_radius_mm = 0.0"]
        {
            assert!(keys(text).scale_mm().is_err(), "{text}");
        }
    }

    #[test]
    fn rows_without_an_index_are_matched_by_time() {
        let rows: String = (0..9).map(|k| format!("{},{k},0,0\n", 50 * k)).collect();
        let found =
            read("time = \"t\"\ntime_unit = \"ms\"\nq = [\"a1\", \"a2\", \"a3\"]", &format!("t,a1,a2,a3\n{rows}"))
                .unwrap();
        let found: Vec<(u64, f64)> = found.rows.iter().map(|row| (row.index, row.q_mm[0])).collect();
        assert!(found.len() == 2 && found[0] == (0, 2.0) && (found[1].1 - 5.0).abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn a_key_that_does_not_fit_is_told_with_the_header() {
        let said = read("index = \"no\"", "nr,time_s,q1_mm,q2_mm,q3_mm\n0,0,1,2,3\n").unwrap_err().to_string();
        assert!(said.contains("log.csv:1: [log] names the column \"no\", and the header has nr, time_s"), "{said}");
        let said = read("q = [\"a\", \"b\"]", "index,time_s,a,b\n0,0,1,2\n").unwrap_err().to_string();
        assert!(said.contains("expected 3 columns, one for each backbone"), "{said}");
    }

    #[test]
    fn a_laboratory_s_header_is_proposed_as_log() {
        let header = |text: &str| -> Vec<String> { text.split(',').map(str::to_owned).collect() };
        let proposal = |text: &str| LogProposal::of(&header(text), 3).map(|found| found.to_string());
        let found = proposal("frame,timestamp_ms,m1,m2,m3,note").unwrap();
        assert!(found.starts_with("[log] with index = \"frame\", time = \"timestamp_ms\", time_unit = \"ms\", q = [\"m1\", \"m2\", \"m3\"]"), "{found}");
        let found = proposal("Time [s],motor1_rad,motor2_rad,motor3_rad").unwrap();
        assert!(
            found.contains("time = \"Time [s]\", time_unit = \"s\"") && found.contains("unit = \"rad\""),
            "{found}"
        );
        assert_eq!(proposal("a,b,c"), None);
    }
}
