//! Measurements and encoder readings from what a laboratory holds them in: a CSV file, a data frame, or a dict of arrays, the
//! last two with the files' column names.

use crate::arrays::numbers_of;
use crate::error::{raised, wrong};
use numpy::IntoPyArray;
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use snakeloop::observation::{EncoderReading, Measurement};
use snakeloop::record::{Checked, MeasurementRow, NUMBERS, read_encoders, read_measurements};
use snakeloop::robot::{BACKBONES, Model, NEIGHBOURS, Neighbours, PerBackbone};
use std::collections::HashSet;
use std::ffi::CString;
use std::path::PathBuf;

/// The largest index of a table, from which on not every whole number has an `f64`.
///
/// Derived: 2⁵³.
const LARGEST_INDEX: f64 = 9_007_199_254_740_992.0;

/// The columns of tables that hold words. All others hold numbers.
///
/// Convention: those of measurements.csv and estimate.csv.
const OF_WORDS: [&str; 3] = ["status", "reason", "view"];

/// Measurements; see measurements.csv for the columns.
///
/// # Errors
/// What the file's reader says; a missing column, columns of different lengths, an index that is none or is there twice.
pub fn measurements_of(source: &Bound<'_, PyAny>) -> PyResult<Vec<Measurement>> {
    if let Ok(path) = source.extract::<PathBuf>() {
        return rows(source.py(), read_measurements(&path).map_err(raised)?);
    }
    let table = Table::new("measurements", source)?;
    let (times_s, statuses) = (table.times_s()?, table.words("status")?);
    let views = if source.contains("view")? { table.words("view")? } else { Vec::new() };
    let column = |name: &&str| {
        if ["theta_deg", "delta_deg"].contains(name) { table.numbers(name) } else { table.optional_numbers(name) }
    };
    let columns: Vec<Vec<f64>> = NUMBERS.iter().map(column).collect::<PyResult<_>>()?;
    let measurement = |k: usize| {
        let row = MeasurementRow {
            index: table.indices[k],
            time_s: Some(times_s[k]).filter(|time_s| time_s.is_finite()),
            status: statuses[k].clone(),
            view: views.get(k).cloned().unwrap_or_default(),
            numbers: std::array::from_fn(|at| columns[at][k]),
        };
        row.try_into().map_err(|why: String| wrong(format!("measurements: index {}: {why}", table.indices[k])))
    };
    (0..table.indices.len()).map(measurement).collect()
}

/// Encoder readings of a model's robot; see encoders.csv for the columns.
///
/// # Errors
/// As [`measurements_of`]; readings of neighbouring sections are missing that the model's effects follow.
pub fn encoders_of(source: &Bound<'_, PyAny>, model: &Model) -> PyResult<Vec<EncoderReading>> {
    let readings = readings_of(source, model.robot.backbone_count())?;
    let lacking = model.lacking_neighbours(readings.iter().map(|reading| &reading.neighbours));
    lacking.map_or(Ok(readings), |message| Err(wrong(format!("encoders: {message}"))))
}

fn readings_of(source: &Bound<'_, PyAny>, backbones: usize) -> PyResult<Vec<EncoderReading>> {
    if let Ok(path) = source.extract::<PathBuf>() {
        return rows(source.py(), read_encoders(&path, backbones).map_err(raised)?);
    }
    let table = Table::new("encoders", source)?;
    let times_s = table.times_s()?;
    let columns: Vec<Vec<f64>> =
        (1..=backbones).map(|i| table.numbers(&format!("q{i}_mm"))).collect::<PyResult<_>>()?;
    let mut beside: [Vec<Vec<f64>>; NEIGHBOURS] = Default::default();
    for (n, columns) in beside.iter_mut().enumerate() {
        let name = |i: usize| format!("n{}_q{}_mm", n + 1, i + 1);
        while columns.len() < *BACKBONES.end() && table.source.contains(name(columns.len()))? {
            columns.push(table.numbers(&name(columns.len()))?);
        }
    }
    let row = |columns: &[Vec<f64>], k: usize| PerBackbone::from_fn(columns.len(), |i| columns[i][k]);
    let reading = |k: usize| EncoderReading {
        neighbours: Neighbours { q_mm: beside.each_ref().map(|columns| row(columns, k)) },
        ..EncoderReading::new(table.indices[k], times_s[k], row(&columns, k))
    };
    Ok((0..table.indices.len()).map(reading).collect())
}

/// A data frame or a dict of arrays with a column `index`.
pub struct Table<'a, 'py> {
    what: &'static str,
    source: &'a Bound<'py, PyAny>,
    /// Its column `index`.
    pub indices: Vec<u64>,
}

impl<'a, 'py> Table<'a, 'py> {
    /// # Errors
    /// What is no table, a missing `index`, an index that is no whole number or is there twice.
    pub fn new(what: &'static str, source: &'a Bound<'py, PyAny>) -> PyResult<Self> {
        let mut table = Self { what, source, indices: Vec::new() };
        let mut seen = HashSet::new();
        let index = |number: f64| {
            let is_index = number.fract() == 0.0 && (0.0..=LARGEST_INDEX).contains(&number);
            let index = is_index.then_some(number as u64);
            index.ok_or_else(|| wrong(format!("{what}: index is {number}, expected whole numbers from 0 up")))
        };
        let indices = table.column("index")?.into_iter().map(index).collect::<PyResult<Vec<u64>>>()?;
        if let Some(twice) = indices.iter().find(|index| !seen.insert(**index)) {
            return Err(wrong(format!("{what}: index {twice} is there twice")));
        }
        table.indices = indices;
        Ok(table)
    }

    /// A column of numbers.
    ///
    /// # Errors
    /// It is missing, no column of numbers, or not as long as the table.
    pub fn numbers(&self, name: &str) -> PyResult<Vec<f64>> {
        let numbers = self.column(name)?;
        self.check_length(name, numbers.len())?;
        Ok(numbers)
    }

    /// The column of times, s. Dates and spans (`datetime64`, `timedelta64`) are seconds by their own unit: dates since 1970.
    ///
    /// # Errors
    /// As [`numbers`](Self::numbers).
    pub fn times_s(&self) -> PyResult<Vec<f64>> {
        /// What NumPy's "not a time" is as a number.
        const NOT_A_TIME: f64 = i64::MIN as f64;
        let column = self.source.py().import("numpy")?.call_method1("asarray", (self.get("time_s")?,))?;
        let unit = match column.getattr("dtype")?.getattr("kind")?.extract::<String>()?.as_str() {
            "M" => "datetime64[ns]",
            "m" => "timedelta64[ns]",
            _ => return self.numbers("time_s"),
        };
        let counts = column.call_method1("astype", (unit,))?.call_method1("astype", ("int64",))?;
        let counts = numbers_of(&counts).map_err(|e| wrong(format!("{}: time_s: {e}", self.what)))?;
        self.check_length("time_s", counts.len())?;
        Ok(counts.into_iter().map(|count| if count == NOT_A_TIME { f64::NAN } else { 1e-9 * count }).collect())
    }

    fn column(&self, name: &str) -> PyResult<Vec<f64>> {
        let numbers = numbers_of(&self.get(name)?);
        Ok(numbers.map_err(|e| wrong(format!("{}: {name}: {e}", self.what)))?.into_iter().collect())
    }

    /// A column of numbers; NaN where the table has none.
    fn optional_numbers(&self, name: &str) -> PyResult<Vec<f64>> {
        if self.source.contains(name)? { self.numbers(name) } else { Ok(vec![f64::NAN; self.indices.len()]) }
    }

    /// A column of words.
    fn words(&self, name: &str) -> PyResult<Vec<String>> {
        let words = self.get(name)?.try_iter()?.map(|word| word?.extract::<String>()).collect::<PyResult<Vec<_>>>();
        let words = words.map_err(|e| wrong(format!("{}: {name}: {e}", self.what)))?;
        self.check_length(name, words.len())?;
        Ok(words)
    }

    fn get(&self, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let missing = |_| {
            wrong(format!(
                "{}: no column {name}; expected a CSV file, a data frame or a dict of arrays with the file's columns",
                self.what
            ))
        };
        self.source.get_item(name).map_err(missing)
    }

    fn check_length(&self, name: &str, length: usize) -> PyResult<()> {
        let expected = self.indices.len();
        if length == expected {
            return Ok(());
        }
        Err(wrong(format!("{}: column {name} has {length} rows, index has {expected}", self.what)))
    }
}

/// A CSV file of the library's as a dict of arrays; an empty field of a column of numbers is NaN.
///
/// # Errors
/// What is no such file.
pub fn columns_of_csv<'py>(py: Python<'py>, text: &str) -> PyResult<Bound<'py, PyDict>> {
    let broken = |e: &dyn std::fmt::Display| wrong(format!("a table that cannot be read: {e}"));
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let header = reader.headers().map_err(|e| broken(&e))?.clone();
    let rows: Vec<csv::StringRecord> = reader.records().collect::<Result<_, _>>().map_err(|e| broken(&e))?;
    let array = py.import("numpy")?.getattr("array")?;
    let columns = PyDict::new(py);
    for (at, name) in header.iter().enumerate() {
        let fields = rows.iter().map(|row| &row[at]);
        if OF_WORDS.contains(&name) {
            columns.set_item(name, array.call1((PyList::new(py, fields)?, "str"))?)?;
        } else if name == "index" {
            let numbers = fields.map(str::parse).collect::<Result<Vec<u64>, _>>().map_err(|e| broken(&e))?;
            columns.set_item(name, numbers.into_pyarray(py))?;
        } else {
            let number = |field: &str| if field.is_empty() { Ok(f64::NAN) } else { field.parse() };
            let numbers = fields.map(number).collect::<Result<Vec<f64>, _>>().map_err(|e| broken(&e))?;
            columns.set_item(name, numbers.into_pyarray(py))?;
        }
    }
    Ok(columns)
}

/// The rows of a file, its warnings given as Python's.
fn rows<T>(py: Python<'_>, Checked { rows, warnings }: Checked<T>) -> PyResult<Vec<T>> {
    for warning in warnings {
        warn(py, &warning.to_string())?;
    }
    Ok(rows)
}

/// Warns a caller.
///
/// # Errors
/// The warning, where warnings are errors.
pub fn warn(py: Python<'_>, text: &str) -> PyResult<()> {
    let text = CString::new(text.replace('\0', " "))?;
    PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 1)
}
