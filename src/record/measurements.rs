//! measurements.csv: one row a frame, whether it could be measured or not.
//!
//! | column | meaning |
//! | --- | --- |
//! | `index`, `time_s` | the frame; the time is empty where nobody knows it |
//! | `theta_deg`, `delta_deg` | bend from straight θ = θ_0 − θ_L and azimuth δ in (−180, 180]; empty where not measured |
//! | `sigma_theta_deg`, `sigma_delta_deg` | their standard deviations (1σ); empty or left out where nobody says |
//! | `status` | `ok`, or the reason why not |
//! | `bend_x_deg`, `bend_y_deg` | the bend vector θ (cos δ, sin δ), which has a meaning near straight as well |
//! | `var_xx`, `var_xy`, `var_yy` | its covariance as the fit gave it, square degrees; empty where only the errors of θ and δ are known |
//! | `rho_theta_delta` | correlation of the errors of θ and δ |
//! | `edges`, `inlier_fraction`, `rms_px` | the fit's quality: edge points used, their share, their rms distance |
//! | `base_moved_px`, `grid_moved_px` | how far holder and grid were seen from where the rig says (the grid up to whole pitches); empty where unseen |
//! | `view` | the view's name in experiment.toml |
//! | `tip_theta_deg` | the tip tangent's angle, where the snake need not be a circle; with its sigma |
//! | `shape_along_deg`, `shape_across_deg` | departure from the circle in the bend's plane and out of it (see [`Shape`](crate::observation::Shape)); with sigmas |
//! | `bend_x_by_rig1_deg` … `bend_y_by_rig6_deg` | the part of the errors that all frames before the rig share: what six independent unit errors of the rig do to θ cos δ and θ sin δ; empty where it is not known. The sigmas hold it |
//! | `shape_chi2` | the departure's square in units of its covariance: 2 on the average for a circle |

use super::columns::{csv_line, csv_text};
use super::measurement_row::{MeasurementRow, columns};
use super::table::{self, Checked, Indexed, OwnColumns, Row, RowResult};
use crate::error::{Error, Result};
use crate::input::{LINE_BYTES, read_line};
use crate::observation::Measurement;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// The columns that a file from elsewhere must have.
const REQUIRED: [&str; 5] = ["index", "time_s", "theta_deg", "delta_deg", "status"];

impl Indexed for Measurement {
    fn index(&self) -> u64 {
        self.index
    }

    fn view(&self) -> Option<&str> {
        self.view.as_deref()
    }
}

/// Reads measurements.csv. The rows come in order of their index, each index (of each view) once.
///
/// # Errors
/// A file that cannot be read, lacks a column or has no usable row. A bad row is a warning.
pub fn read_measurements(path: &Path) -> Result<Checked<Measurement>> {
    table::read(path, &REQUIRED, measurement_of)
}

fn measurement_of(row: &Row) -> RowResult<Measurement> {
    MeasurementRow::read(row)?.try_into()
}

/// A measurements.csv of this program, row by row: what is in memory does not grow with the file.
#[derive(Debug)]
pub struct MeasurementRows {
    path: PathBuf,
    lines: BufReader<File>,
    line: u64,
    reader: RowReader,
}

impl MeasurementRows {
    /// Opens a file that was written as [`measurements_csv`] writes it.
    ///
    /// # Errors
    /// A file that cannot be read or has another header.
    pub fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(Error::io(path, "read"))?;
        let mut rows =
            Self { path: path.to_owned(), lines: BufReader::new(file), line: 0, reader: RowReader::default() };
        let header = measurements_header();
        match rows.next_line()? {
            Some(line) if line == header => Ok(rows),
            _ => Err(Error::at_line(path, 1, format!("not a header of this version's, which is {header}"))),
        }
    }

    fn next_line(&mut self) -> Result<Option<String>> {
        let mut text = Vec::new();
        self.line += 1;
        let read = read_line(&mut self.lines, LINE_BYTES, &mut text).map_err(Error::io(&self.path, "read"))?;
        if read.length == 0 {
            return Ok(None);
        }
        let wrong = |why| Error::at_line(&self.path, self.line, why);
        if read.ended && text.pop() != Some(b'\n') {
            return Err(wrong("the line is too long for a row"));
        }
        String::from_utf8(text).map(Some).map_err(|_| wrong("not UTF-8 text, as this file must be"))
    }
}

impl Iterator for MeasurementRows {
    type Item = Result<Measurement>;

    fn next(&mut self) -> Option<Result<Measurement>> {
        let line = match self.next_line() {
            Ok(line) => line?,
            Err(e) => return Some(Err(e)),
        };
        Some(self.reader.read(&line).map_err(|why| Error::at_line(&self.path, self.line, why)))
    }
}

/// Takes single lines apart that [`measurement_line`] made.
#[derive(Debug)]
pub(super) struct RowReader(OwnColumns);

impl Default for RowReader {
    fn default() -> Self {
        Self(OwnColumns::new(columns()))
    }
}

impl RowReader {
    pub fn read(&self, line: &str) -> RowResult<Measurement> {
        measurement_of(&self.0.row(line)?)
    }
}

/// measurements.csv as text; angles and sigmas to 1e-6 degrees.
pub fn measurements_csv(measurements: &[Measurement]) -> String {
    let header = columns().map(str::to_owned).collect();
    csv_text([header].into_iter().chain(measurements.iter().map(|one| MeasurementRow::from(one).fields())))
}

/// The first line of measurements.csv, without its end.
pub fn measurements_header() -> String {
    csv_line(columns())
}

/// One line of measurements.csv, without its end.
pub fn measurement_line(measurement: &Measurement) -> String {
    csv_line(MeasurementRow::from(measurement).fields())
}

#[cfg(test)]
mod tests;
