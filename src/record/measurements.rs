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
//! | `shape_along_deg`, `shape_across_deg` | departure from the circle in the bend's plane and out of it (see [`Shape`]); with sigmas |
//! | `bend_x_by_rig1_deg` … `bend_y_by_rig6_deg` | the part of the errors that all frames before the rig share: what six independent unit errors of the rig do to θ cos δ and θ sin δ; empty where it is not known. The sigmas hold it |
//! | `shape_chi2` | the departure's square in units of its covariance: 2 on the average for a circle |

use super::columns::{azimuth, csv_line, csv_text, decimals, decimals_or_empty};
use super::table::{self, Checked, Indexed, OwnColumns, Row, RowResult};
use crate::error::{Error, Result};
use crate::geometry::Configuration;
use crate::input::{LINE_BYTES, read_line};
use crate::observation::{Measured, Measurement, Quality, Shape, Status};
use nalgebra::{Matrix2, Matrix2x6, Vector2};
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// The columns that the design fixes.
const FIXED: [&str; 7] = ["index", "time_s", "theta_deg", "delta_deg", "sigma_theta_deg", "sigma_delta_deg", "status"];

/// Those that a file from elsewhere must have.
const REQUIRED: [&str; 5] = ["index", "time_s", "theta_deg", "delta_deg", "status"];

/// The further columns that this program writes.
const FURTHER: [&str; 31] = [
    "bend_x_deg",
    "bend_y_deg",
    "var_xx",
    "var_xy",
    "var_yy",
    "rho_theta_delta",
    "edges",
    "inlier_fraction",
    "rms_px",
    "base_moved_px",
    "grid_moved_px",
    "view",
    "tip_theta_deg",
    "sigma_tip_theta_deg",
    "shape_along_deg",
    "sigma_shape_along_deg",
    "shape_across_deg",
    "sigma_shape_across_deg",
    "shape_chi2",
    "bend_x_by_rig1_deg",
    "bend_y_by_rig1_deg",
    "bend_x_by_rig2_deg",
    "bend_y_by_rig2_deg",
    "bend_x_by_rig3_deg",
    "bend_y_by_rig3_deg",
    "bend_x_by_rig4_deg",
    "bend_y_by_rig4_deg",
    "bend_x_by_rig5_deg",
    "bend_y_by_rig5_deg",
    "bend_x_by_rig6_deg",
    "bend_y_by_rig6_deg",
];
/// Where those by the rig begin among [`FURTHER`]; they are in the order of a matrix of two rows, column by column.
///
/// Derived: they are its last twelve, two for each of six unit errors.
const BY_RIG: usize = FURTHER.len() - 2 * 6;

/// A bend vector is that of the angles if it differs by no more, degrees. Convention: a hundred times what their decimals round.
const SAME_BEND_DEG: f64 = 1e-4;
/// The covariances are compared where the bend is so many of its standard deviations along and across. Derived: from there on that of (θ, δ) is right
/// within 1 %.
const BENT_SDS: f64 = 10.0;
/// The two covariances are one if they differ by no more than this share. Convention: above the rounding of both; a sigma that somebody scaled differs
/// by more.
const SAME_COVARIANCE: f64 = 0.1;
/// They are compared in every direction, in units of their σ there, where the curve of equal θ leaves its tangent within σ across by no more than this share
/// of σ along; else by their size. Derived: it adds the square of half of that to the variance of θ, a hundredth.
const MOST_CURVED: f64 = 0.2;

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
    let status = match row.text("status") {
        "" => return Err("status is empty, expected `ok` or a reason".to_owned()),
        word => word.parse().unwrap_or_else(|never| match never {}),
    };
    let measured = measured_of(row)?;
    if status == Status::Ok && measured.is_none() {
        return Err("status is `ok`, but the angles are empty".to_owned());
    }
    Ok(Measurement {
        index: row.index("index")?,
        time_s: row.optional_time()?,
        status,
        measured,
        quality: quality_of(row)?,
        view: Some(row.text("view")).filter(|name| !name.is_empty()).map(str::to_owned),
    })
}

fn measured_of(row: &Row) -> RowResult<Option<Measured>> {
    let (Some(theta_deg), Some(delta_deg)) = (row.optional_number("theta_deg")?, row.optional_number("delta_deg")?)
    else {
        return Ok(None);
    };
    if !(0.0..=360.0).contains(&theta_deg) {
        return Err(format!("theta_deg is {theta_deg}, expected 0 to 360"));
    }
    if delta_deg.abs() > 360.0 {
        return Err(format!("delta_deg is {delta_deg}, expected −180 to 180"));
    }
    let sigma = |column| match row.optional_number(column)? {
        None => Ok(f64::NAN),
        Some(sigma_deg) if sigma_deg > 0.0 => Ok(f64::to_radians(sigma_deg)),
        Some(sigma_deg) => Err(format!("{column} is {sigma_deg}, expected more than 0")),
    };
    let correlation = row.optional_number("rho_theta_delta")?.unwrap_or(0.0);
    if correlation.abs() >= 1.0 {
        return Err(format!("rho_theta_delta is {correlation}, expected between −1 and 1"));
    }
    let configuration = Configuration::from_degrees(theta_deg, delta_deg);
    let (sigma_theta, sigma_delta) = (sigma("sigma_theta_deg")?, sigma("sigma_delta_deg")?);
    let measured = Measured::independent(configuration, sigma_theta, sigma_delta, correlation);
    let fitted_covariance = fitted_covariance_of(row, &measured)?;
    Ok(Some(Measured { fitted_covariance, by_rig: by_rig_of(row)?, ..measured }))
}

/// The covariance of the bend vector, where the row has one, rad². The angles and their sigmas are what counts: beside others than those that it
/// was written with, as where somebody changed them, it is left out.
fn fitted_covariance_of(row: &Row, measured: &Measured) -> RowResult<Option<Matrix2<f64>>> {
    let number = |column| row.optional_number(column);
    let bend = (number("bend_x_deg")?, number("bend_y_deg")?);
    match (bend, number("var_xx")?, number("var_xy")?, number("var_yy")?) {
        ((Some(x), Some(y)), Some(xx), Some(xy), Some(yy)) => fitted_covariance(measured, [x, y], [xx, xy, yy]),
        _ => Ok(None),
    }
}

/// The covariance of the bend vector that `var_xx`, `var_xy` and `var_yy` say of a measurement whose sigmas are known, rad²; `None` beside angles or
/// sigmas that are not those of `bend_x_deg`, `bend_y_deg` and the covariance.
///
/// # Errors
/// In words, numbers that are no covariance.
pub fn fitted_covariance(
    measured: &Measured,
    [x, y]: [f64; 2],
    [xx, xy, yy]: [f64; 3],
) -> Result<Option<Matrix2<f64>>, String> {
    if !(xx > 0.0 && yy > 0.0 && xx * yy > xy * xy) {
        return Err(format!("var_xx, var_xy, var_yy are {xx}, {xy}, {yy}, which is no covariance"));
    }
    let Measured { configuration, sigma_theta, sigma_delta, .. } = measured;
    let is_same_bend = (Vector2::new(x, y) - configuration.bend_vector().map(f64::to_degrees)).norm() <= SAME_BEND_DEG;
    let covariance = Matrix2::new(xx, xy, xy, yy) * 1f64.to_radians().powi(2);
    let polar = measured.bend_covariance(*configuration);
    let is_compared = configuration.theta > BENT_SDS * sigma_theta && *sigma_delta < BENT_SDS.recip();
    let is_straight = configuration.theta * sigma_delta.powi(2) <= MOST_CURVED * sigma_theta;
    let whitener = polar.cholesky().filter(|_| is_straight).and_then(|root| root.l().try_inverse());
    let differ_by = match whitener {
        Some(whitener) => (whitener * covariance * whitener.transpose() - Matrix2::identity()).norm(),
        None => (covariance - polar).norm() / polar.norm(),
    };
    let is_same = !is_compared || differ_by <= SAME_COVARIANCE;
    Ok(Some(covariance).filter(|_| is_same_bend && is_same))
}

fn by_rig_of(row: &Row) -> RowResult<Matrix2x6<f64>> {
    let mut by_rig = Matrix2x6::zeros();
    for (value, column) in by_rig.iter_mut().zip(&FURTHER[BY_RIG..]) {
        *value = row.optional_number(column)?.unwrap_or(0.0).to_radians();
    }
    Ok(by_rig)
}

fn quality_of(row: &Row) -> RowResult<Option<Quality>> {
    let (Some(inlier_fraction), Some(rms_px)) =
        (row.optional_number("inlier_fraction")?, row.optional_number("rms_px")?)
    else {
        return Ok(None);
    };
    Ok(Some(Quality {
        edges: row.index("edges")? as usize,
        inlier_fraction,
        rms_px,
        base_moved_px: row.optional_number("base_moved_px")?,
        grid_moved_px: row.optional_number("grid_moved_px")?,
        shape: shape_of(row)?,
        profile: None,
    }))
}

fn shape_of(row: &Row) -> RowResult<Option<Shape>> {
    let Some(chi2) = row.optional_number("shape_chi2")? else { return Ok(None) };
    let angle = |column| Ok::<_, String>(row.optional_number(column)?.unwrap_or(f64::NAN).to_radians());
    Ok(Some(Shape {
        tip_theta: angle("tip_theta_deg")?,
        sigma_tip_theta: angle("sigma_tip_theta_deg")?,
        along: angle("shape_along_deg")?,
        sigma_along: angle("sigma_shape_along_deg")?,
        across: angle("shape_across_deg")?,
        sigma_across: angle("sigma_shape_across_deg")?,
        chi2,
    }))
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
    csv_text([header].into_iter().chain(measurements.iter().map(fields)))
}

/// The first line of measurements.csv, without its end.
pub fn measurements_header() -> String {
    csv_line(columns())
}

/// One line of measurements.csv, without its end.
pub fn measurement_line(measurement: &Measurement) -> String {
    csv_line(fields(measurement))
}

fn columns() -> impl Iterator<Item = &'static str> {
    FIXED.into_iter().chain(FURTHER)
}

fn fields(row: &Measurement) -> Vec<String> {
    let angles = match &row.measured {
        Some(m) => [
            decimals(m.configuration.theta_deg(), 6),
            azimuth(m.configuration.delta_deg()),
            sigma_deg(m.sigma_theta),
            sigma_deg(m.sigma_delta),
        ],
        None => Default::default(),
    };
    let bend: [String; 2] = row.measured.map(|m| bend_fields(m.configuration)).unwrap_or_default();
    let covariance: [String; 3] = match row.measured.and_then(|m| m.fitted_covariance) {
        Some(c) => [c.m11, c.m12, c.m22].map(|part| format!("{:.9e}", part * 1f64.to_degrees().powi(2))),
        None => Default::default(),
    };
    let by_rig: [String; 12] = match &row.measured {
        Some(m) if m.by_rig.amax() > 0.0 => std::array::from_fn(|k| decimals(m.by_rig[k].to_degrees(), 6)),
        _ => Default::default(),
    };
    let quality = match &row.quality {
        Some(q) => [
            q.edges.to_string(),
            decimals(q.inlier_fraction, 4),
            decimals(q.rms_px, 4),
            decimals_or_empty(q.base_moved_px, 3),
            decimals_or_empty(q.grid_moved_px, 3),
        ],
        None => Default::default(),
    };
    let shape = match row.quality.and_then(|q| q.shape) {
        Some(s) => [
            decimals(s.tip_theta.to_degrees(), 6),
            sigma_deg(s.sigma_tip_theta),
            decimals(s.along.to_degrees(), 6),
            sigma_deg(s.sigma_along),
            decimals(s.across.to_degrees(), 6),
            sigma_deg(s.sigma_across),
            decimals(s.chi2, 3),
        ],
        None => Default::default(),
    };
    [
        &[row.index.to_string(), decimals_or_empty(row.time_s, 4)],
        &angles[..],
        &[row.status.to_string()],
        &bend[..],
        &covariance[..],
        &[decimals_or_empty(row.measured.map(|m| m.correlation.clamp(-0.9999, 0.9999)), 4)],
        &quality[..],
        &[row.view.clone().unwrap_or_default()],
        &shape[..],
        &by_rig[..],
    ]
    .concat()
}

/// The bend vector of the angles as their six decimals say them, so that what is read is written as it was.
fn bend_fields(configuration: Configuration) -> [String; 2] {
    let as_written = |angle_deg: f64| (angle_deg * 1e6).round() / 1e6;
    let [theta_deg, delta_deg] = [configuration.theta_deg(), configuration.delta_deg()].map(as_written);
    let bend = Configuration::from_degrees(theta_deg, delta_deg).bend_vector();
    bend.map(|part| decimals(part.to_degrees(), 6)).into()
}

/// A sigma in degrees that stays above zero when rounded, and finite, or it could not be read back.
fn sigma_deg(sigma: f64) -> String {
    decimals(sigma.to_degrees().clamp(1e-6, 1e6), 6)
}

#[cfg(test)]
mod tests;
