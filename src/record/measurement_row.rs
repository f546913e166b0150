//! A measurement as one flat row: what measurements.csv, the journal of `live` and tables from Python hold of it, by the same names.

use super::columns::{azimuth, decimals, decimals_or_empty};
use super::table::{Row, RowResult};
use crate::geometry::Configuration;
use crate::observation::{Measured, Measurement, Quality, Shape, Status};
use nalgebra::{Matrix2, Matrix2x6, Vector2};
use serde::de::{Deserializer, Error};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::Value;
use std::collections::HashMap;
use std::ops::Range;

/// The columns that hold numbers, beside `index`, `time_s`, `status` and `view`; what they mean stands where
/// [measurements.csv](super::measurements) is described.
pub const NUMBERS: [&str; 34] = [
    "theta_deg",
    "delta_deg",
    "sigma_theta_deg",
    "sigma_delta_deg",
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

// Where they stand among the numbers. Derived: from their order.
const ANGLES: Range<usize> = 0..4;
const BEND: Range<usize> = 4..6;
const COVARIANCE: Range<usize> = 6..9;
/// Derived: from the order as well.
const CORRELATION: usize = 9;
const FIT: Range<usize> = 10..13;
const MOVED: Range<usize> = 13..15;
const SHAPE: Range<usize> = 15..21;
/// Derived: from the order as well.
const SHAPE_CHI2: usize = 21;
/// In the order of a matrix of two rows, column by column.
const BY_RIG: Range<usize> = 22..34;

/// Lists that journals of earlier versions have in the place of columns, and where their numbers stand now.
const LISTS: [(&str, [Range<usize>; 2]); 5] = [
    ("angles", [ANGLES, CORRELATION..CORRELATION + 1]),
    ("quality", [FIT, 0..0]),
    ("moved_px", [MOVED, 0..0]),
    ("shape", [SHAPE, SHAPE_CHI2..SHAPE_CHI2 + 1]),
    ("by_rig", [BY_RIG, 0..0]),
];

/// A bend vector is that of the angles if it differs by no more, degrees. Convention: a hundred times what their decimals round.
const SAME_BEND_DEG: f64 = 1e-4;
/// The errors of θ and δ are those of the covariance of the bend vector if sigmas and correlation differ by no more than this, of each sigma as a share.
/// Convention: far above the rounding of both; whoever changes a sigma changes it by more.
const SAME_ERRORS: f64 = 0.01;

/// One row: the names of its fields are those of the columns.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MeasurementRow {
    /// The frame's index.
    pub index: u64,
    /// Its time, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_s: Option<f64>,
    /// `ok`, or the reason why it was not measured.
    pub status: String,
    /// The view's name; empty where there is none.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub view: String,
    /// The numbers in the order of [`NUMBERS`], angles in degrees; NaN where a field is empty.
    #[serde(flatten, serialize_with = "write_numbers", deserialize_with = "read_numbers")]
    pub numbers: [f64; NUMBERS.len()],
}

/// The columns of measurements.csv in their order.
pub(super) fn columns() -> impl Iterator<Item = &'static str> {
    in_order("index", "time_s", "status", "view", NUMBERS)
}

/// What a row consists of, in the order of measurements.csv.
fn in_order<T>(index: T, time: T, status: T, view: T, numbers: [T; NUMBERS.len()]) -> impl Iterator<Item = T> {
    let mut numbers = numbers.into_iter();
    let angles: Vec<T> = numbers.by_ref().take(ANGLES.end).collect();
    let of_fit: Vec<T> = numbers.by_ref().take(MOVED.end - ANGLES.end).collect();
    [index, time].into_iter().chain(angles).chain([status]).chain(of_fit).chain([view]).chain(numbers)
}

impl MeasurementRow {
    /// A row of a CSV file.
    pub(super) fn read(row: &Row) -> RowResult<Self> {
        let mut numbers = [f64::NAN; NUMBERS.len()];
        for (number, column) in numbers.iter_mut().zip(NUMBERS) {
            *number = row.optional_number(column)?.unwrap_or(f64::NAN);
        }
        let (status, view) = (row.text("status").to_owned(), row.text("view").to_owned());
        Ok(Self { index: row.index("index")?, time_s: row.optional_time()?, status, view, numbers })
    }

    /// The fields of a line of measurements.csv.
    pub(super) fn fields(self) -> Vec<String> {
        let numbers = std::array::from_fn(|at| field(NUMBERS[at], self.numbers[at]));
        let time = decimals_or_empty(self.time_s, 4);
        in_order(self.index.to_string(), time, self.status, self.view, numbers).collect()
    }

    /// Some of the numbers, from this place on.
    fn numbers_from<const N: usize>(&self, first: usize) -> [f64; N] {
        std::array::from_fn(|k| self.numbers[first + k])
    }

    fn measured(&self) -> RowResult<Option<Measured>> {
        let [theta_deg, delta_deg, sigma_theta_deg, sigma_delta_deg] = self.numbers_from(ANGLES.start);
        let [x, y, xx, xy, yy, correlation] = self.numbers_from(BEND.start);
        if theta_deg.is_nan() || delta_deg.is_nan() {
            return Ok(None);
        }
        if !(0.0..=360.0).contains(&theta_deg) {
            return Err(format!("theta_deg is {theta_deg}, expected 0 to 360"));
        }
        if delta_deg.abs() > 360.0 {
            return Err(format!("delta_deg is {delta_deg}, expected −180 to 180"));
        }
        for (column, sigma_deg) in [("sigma_theta_deg", sigma_theta_deg), ("sigma_delta_deg", sigma_delta_deg)] {
            if sigma_deg <= 0.0 {
                return Err(format!("{column} is {sigma_deg}, expected more than 0"));
            }
        }
        if correlation.abs() >= 1.0 {
            return Err(format!("rho_theta_delta is {correlation}, expected between −1 and 1"));
        }
        let configuration = Configuration::from_degrees(theta_deg, delta_deg);
        let [sigma_theta, sigma_delta] = [sigma_theta_deg, sigma_delta_deg].map(f64::to_radians);
        let measured = Measured::independent(configuration, sigma_theta, sigma_delta, or_zero(correlation));
        let is_empty = [x, y, xx, xy, yy].iter().any(|number| number.is_nan());
        let fitted_covariance = if is_empty { None } else { fitted_covariance(&measured, [x, y], [xx, xy, yy])? };
        let by_rig = self.numbers[BY_RIG].iter().map(|number| or_zero(*number).to_radians());
        Ok(Some(Measured { fitted_covariance, by_rig: Matrix2x6::from_iterator(by_rig), ..measured }))
    }

    fn quality(&self) -> RowResult<Option<Quality>> {
        let [edges, inlier_fraction, rms_px, base_moved_px, grid_moved_px] = self.numbers_from(FIT.start);
        if inlier_fraction.is_nan() || rms_px.is_nan() {
            return Ok(None);
        }
        if edges < 0.0 || edges.fract().abs() > 0.0 {
            return Err(format!("edges is {edges}, expected a whole number from 0 up"));
        }
        let [base_moved_px, grid_moved_px] = [base_moved_px, grid_moved_px].map(known);
        let (edges, shape) = (edges as usize, self.shape());
        Ok(Some(Quality { edges, inlier_fraction, rms_px, base_moved_px, grid_moved_px, shape, profile: None }))
    }

    fn shape(&self) -> Option<Shape> {
        let angles_deg: [f64; 6] = self.numbers_from(SHAPE.start);
        let [tip_theta, sigma_tip_theta, along, sigma_along, across, sigma_across] = angles_deg.map(f64::to_radians);
        known(self.numbers[SHAPE_CHI2]).map(|chi2| Shape {
            tip_theta,
            sigma_tip_theta,
            along,
            sigma_along,
            across,
            sigma_across,
            chi2,
        })
    }
}

impl From<&Measurement> for MeasurementRow {
    fn from(measurement: &Measurement) -> Self {
        let mut numbers = [f64::NAN; NUMBERS.len()];
        if let Some(m) = &measurement.measured {
            let angles = [m.configuration.theta, m.configuration.delta, m.sigma_theta, m.sigma_delta];
            numbers[ANGLES].copy_from_slice(&angles.map(f64::to_degrees));
            numbers[BEND].copy_from_slice(&bend_deg(m.configuration));
            numbers[CORRELATION] = m.correlation;
            if let Some(c) = m.fitted_covariance {
                let square_degrees = [c.m11, c.m12, c.m22].map(|part| part * 1f64.to_degrees().powi(2));
                numbers[COVARIANCE].copy_from_slice(&square_degrees);
            }
            if m.by_rig.amax() > 0.0 {
                numbers[BY_RIG].iter_mut().zip(&m.by_rig).for_each(|(number, part)| *number = part.to_degrees());
            }
        }
        if let Some(q) = &measurement.quality {
            numbers[FIT].copy_from_slice(&[q.edges as f64, q.inlier_fraction, q.rms_px]);
            numbers[MOVED].copy_from_slice(&[q.base_moved_px, q.grid_moved_px].map(|px| px.unwrap_or(f64::NAN)));
            if let Some(s) = q.shape {
                let angles = [s.tip_theta, s.sigma_tip_theta, s.along, s.sigma_along, s.across, s.sigma_across];
                numbers[SHAPE].copy_from_slice(&angles.map(f64::to_degrees));
                numbers[SHAPE_CHI2] = s.chi2;
            }
        }
        Self {
            index: measurement.index,
            time_s: measurement.time_s,
            status: measurement.status.to_string(),
            view: measurement.view.clone().unwrap_or_default(),
            numbers,
        }
    }
}

impl TryFrom<MeasurementRow> for Measurement {
    type Error = String;

    /// The error says in words what cannot be right.
    fn try_from(row: MeasurementRow) -> RowResult<Self> {
        if row.status.is_empty() {
            return Err("status is empty, expected `ok` or a reason".to_owned());
        }
        let status = row.status.parse().unwrap_or_else(|never| match never {});
        let measured = row.measured()?;
        if status == Status::Ok && measured.is_none() {
            return Err("status is `ok`, but the angles are empty".to_owned());
        }
        let quality = row.quality()?;
        let view = Some(row.view).filter(|name| !name.is_empty());
        Ok(Self { index: row.index, time_s: row.time_s, status, measured, quality, view })
    }
}

fn known(number: f64) -> Option<f64> {
    Some(number).filter(|number| !number.is_nan())
}

fn or_zero(number: f64) -> f64 {
    known(number).unwrap_or(0.0)
}

/// The covariance of the bend vector that `var_xx`, `var_xy` and `var_yy` say of a measurement whose sigmas are known, rad²; `None` beside angles or
/// sigmas that are not those of `bend_x_deg`, `bend_y_deg` and the covariance.
///
/// # Errors
/// In words, numbers that are no covariance.
fn fitted_covariance(measured: &Measured, [x, y]: [f64; 2], [xx, xy, yy]: [f64; 3]) -> RowResult<Option<Matrix2<f64>>> {
    if !(xx > 0.0 && yy > 0.0 && xx * yy > xy * xy) {
        return Err(format!("var_xx, var_xy, var_yy are {xx}, {xy}, {yy}, which is no covariance"));
    }
    let bend = measured.configuration.bend_vector();
    let is_same_bend = (Vector2::new(x, y) - bend.map(f64::to_degrees)).norm() <= SAME_BEND_DEG;
    if !is_same_bend {
        return Ok(None);
    }
    let covariance = Matrix2::new(xx, xy, xy, yy) * 1f64.to_radians().powi(2);
    let of_fit = Measured::of_bend(bend, &covariance);
    let differs = [
        measured.sigma_theta / of_fit.sigma_theta - 1.0,
        measured.sigma_delta / of_fit.sigma_delta - 1.0,
        measured.correlation - of_fit.correlation,
    ];
    let is_changed = differs.iter().any(|by| by.abs() > SAME_ERRORS);
    Ok(Some(covariance).filter(|_| !is_changed))
}

/// The bend vector, degrees, of the angles as their six decimals say them, so that what is read is written as it was.
fn bend_deg(configuration: Configuration) -> [f64; 2] {
    let as_written = |angle_deg: f64| (angle_deg * 1e6).round() / 1e6;
    let [theta_deg, delta_deg] = [configuration.theta_deg(), configuration.delta_deg()].map(as_written);
    Configuration::from_degrees(theta_deg, delta_deg).bend_vector().map(f64::to_degrees).into()
}

/// A number as measurements.csv has it. A sigma stays above zero when it is rounded, and finite, or it could not be read back; so does a correlation
/// within its bounds.
fn field(column: &str, number: f64) -> String {
    match column {
        _ if number.is_nan() => String::new(),
        "delta_deg" => azimuth(number),
        "edges" => decimals(number, 0),
        "var_xx" | "var_xy" | "var_yy" => format!("{number:.9e}"),
        "rho_theta_delta" => decimals(number.clamp(-0.9999, 0.9999), 4),
        "inlier_fraction" | "rms_px" => decimals(number, 4),
        "base_moved_px" | "grid_moved_px" | "shape_chi2" => decimals(number, 3),
        sigma if sigma.starts_with("sigma_") => decimals(number.clamp(1e-6, 1e6), 6),
        _ => decimals(number, 6),
    }
}

/// The numbers that there are, by their columns.
fn write_numbers<S: Serializer>(numbers: &[f64; NUMBERS.len()], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(NUMBERS.iter().zip(numbers).filter(|(_, number)| number.is_finite()))
}

/// Numbers by their columns, or in the [lists](LISTS) of earlier versions.
fn read_numbers<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; NUMBERS.len()], D::Error> {
    let fields = HashMap::<String, Value>::deserialize(deserializer)?;
    let mut numbers = [f64::NAN; NUMBERS.len()];
    for (name, [first, then]) in LISTS {
        let mut of_list = Vec::new();
        flatten(fields.get(name).unwrap_or(&Value::Null), &mut of_list);
        for (at, value) in first.chain(then).zip(of_list) {
            numbers[at] = number_of(value)?;
        }
    }
    for (number, column) in numbers.iter_mut().zip(NUMBERS) {
        if let Some(value) = fields.get(column) {
            *number = number_of(value)?;
        }
    }
    Ok(numbers)
}

fn flatten<'a>(value: &'a Value, into: &mut Vec<&'a Value>) {
    match value {
        Value::Array(values) => values.iter().for_each(|value| flatten(value, into)),
        value => into.push(value),
    }
}

fn number_of<E: Error>(value: &Value) -> Result<f64, E> {
    match value {
        Value::Null => Ok(f64::NAN),
        value => value.as_f64().ok_or_else(|| E::custom(format!("{value}, expected a number"))),
    }
}
