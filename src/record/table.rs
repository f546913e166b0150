//! What all CSV files share: a header that names the columns, rows that are checked one by one.
//!
//! A file without the needed columns, or without a single good row, is an error. A bad row is passed over with a
//! [`Warning`] that says where and why, and the other rows are used.

mod warnings;

pub(super) use self::warnings::Warnings;
pub use self::warnings::{Fault, Warning};
use super::columns::fields_of;
use super::dialect::{Sheet, Unit, text_of, unit_of};
use super::torn::is_cut_in_a_number;
use crate::camera::number_in_name;
use crate::error::{Error, Result};
use crate::input::{TABLE_BYTES, read_bytes};
use crate::instant::seconds_of;
use std::collections::HashMap;
use std::path::Path;

/// What a file held, and what of it had to be passed over.
#[derive(Debug, Clone, PartialEq)]
pub struct Checked<T> {
    /// The good rows, in order of their index.
    pub rows: Vec<T>,
    /// One entry for everything passed over or put right.
    pub warnings: Vec<Warning>,
}

/// Where a column stands, and what one unit of it is in that of its name.
#[derive(Debug, Clone, Copy)]
struct Column {
    at: usize,
    scale: f64,
}

/// The columns of a file by their names.
type Columns = HashMap<String, Column>;

/// One row of a CSV file whose fields are asked for by the names of their columns.
pub(super) struct Row<'a> {
    columns: &'a Columns,
    fields: csv::StringRecord,
    has_decimal_commas: bool,
}

/// Why a row cannot be used; the line is known to the caller.
pub(super) type RowResult<T> = std::result::Result<T, String>;

impl Row<'_> {
    /// The text of a field, empty where the file has no such column.
    pub fn text(&self, column: &str) -> &str {
        self.columns.get(column).and_then(|column| self.fields.get(column.at)).unwrap_or("")
    }

    /// Whether the file has such a column.
    pub fn has(&self, column: &str) -> bool {
        self.columns.contains_key(column)
    }

    /// A finite number, or `None` where the field is empty.
    pub fn optional_number(&self, column: &str) -> RowResult<Option<f64>> {
        let text = self.text(column);
        if text.is_empty() {
            return Ok(None);
        }
        let scale = self.columns.get(column).map_or(1.0, |column| column.scale);
        match self.parsed(text).filter(|number| number.is_finite()) {
            Some(number) => Ok(Some(number * scale)),
            None => Err(format!("{column} is {}, expected a number", quoted(text))),
        }
    }

    /// A number as this file writes it.
    fn parsed(&self, text: &str) -> Option<f64> {
        let has_comma = self.has_decimal_commas && text.contains(',') && !text.contains('.');
        // Spreadsheets and reports write the minus sign of print.
        let text = text.replace('\u{2212}', "-");
        if has_comma { text.replacen(',', ".", 1).parse().ok() } else { text.parse().ok() }
    }

    /// A finite number.
    pub fn number(&self, column: &str) -> RowResult<f64> {
        self.optional_number(column)?.ok_or_else(|| format!("{column} is empty, expected a number"))
    }

    /// The time of a row, s: a number, or a date and time of day as [`seconds_of`] reads it. `None` where the field is empty.
    pub fn optional_time(&self) -> RowResult<Option<f64>> {
        match seconds_of(self.text(TIME)) {
            Some(seconds) => Ok(Some(seconds)),
            None => {
                self.optional_number(TIME).map_err(|why| format!("{why} or a date such as 2026-11-26 02:35:28.123"))
            }
        }
    }

    /// The time of a row that must have one, s.
    pub fn time(&self) -> RowResult<f64> {
        self.optional_time()?.ok_or_else(|| format!("{TIME} is empty, expected a number"))
    }

    /// A whole number, not negative; `12.0` is one too, since spreadsheets write it so, and the name of a frame's file stands for its number.
    pub fn index(&self, column: &str) -> RowResult<u64> {
        /// Above this not every whole number has an `f64`.
        ///
        /// Convention: a resource limit.
        const LARGEST: f64 = 9_007_199_254_740_992.0;
        let text = self.text(column);
        if let Ok(index) = text.parse() {
            return Ok(index);
        }
        match self.parsed(text) {
            Some(number) if number.fract() == 0.0 && (0.0..=LARGEST).contains(&number) => Ok(number as u64),
            None if is_file_name(text) => number_in_name(Path::new(text))
                .ok_or_else(|| format!("{column} is {}, expected a number in the file's name", quoted(text))),
            _ => Err(format!("{column} is {}, expected a whole number from 0 up", quoted(text))),
        }
    }
}

/// Whether a text is a file's name: its ending begins with a letter.
fn is_file_name(text: &str) -> bool {
    let ending = Path::new(text).extension().unwrap_or_default().to_string_lossy();
    ending.starts_with(|c: char| c.is_ascii_alphabetic())
}

/// The column of times.
const TIME: &str = "time_s";

/// Names that stand for [`TIME`], each with its unit, s.
///
/// Derived: the units that the names say.
const OTHER_TIMES: [(&str, f64); 3] = [("time_ms", 1e-3), ("time_us", 1e-6), ("time_ns", 1e-9)];

/// A field as it is shown in a message: quoted, and cut where it is long.
fn quoted(text: &str) -> String {
    /// Convention: a resource limit.
    const LONGEST: usize = 40;
    if text.chars().count() > LONGEST {
        format!("{:?}…", text.chars().take(LONGEST).collect::<String>())
    } else {
        format!("{text:?}")
    }
}

/// A row that came from a file and says which frame it is about.
pub(super) trait Indexed: PartialEq {
    /// The frame's index.
    fn index(&self) -> u64;
    /// What else tells rows of one index apart; rows that differ here are not duplicates.
    fn view(&self) -> Option<&str> {
        None
    }
}

/// The columns of a file that this program wrote itself, in their order.
#[derive(Debug)]
pub(super) struct OwnColumns(Columns);

impl OwnColumns {
    pub fn new<'a>(names: impl IntoIterator<Item = &'a str>) -> Self {
        Self(names.into_iter().enumerate().map(|(at, name)| (name.to_owned(), Column { at, scale: 1.0 })).collect())
    }

    /// One line.
    pub fn row(&self, line: &str) -> RowResult<Row<'_>> {
        let fields = fields_of(line);
        if fields.len() != self.0.len() {
            return Err(format!("{} fields, expected {}", fields.len(), self.0.len()));
        }
        Ok(Row { columns: &self.0, fields, has_decimal_commas: false })
    }
}

/// What a file calls a column, by what it is called here, and what one unit of it is in that of its name here.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Renamed {
    /// As the file has it.
    pub from: String,
    /// As it is asked for.
    pub to: String,
    /// What one unit is.
    pub scale: f64,
}

/// Reads a CSV file: `required` columns must be there, `parse` turns a row into a value or says why it cannot.
///
/// The rows come back in order of (index, view), each of them once. Two rows of the same index that agree are one;
/// where they differ, nobody can know which is right, and neither is used.
pub(super) fn read<T: Indexed>(
    path: &Path,
    required: &[&str],
    parse: impl Fn(&Row) -> RowResult<T>,
) -> Result<Checked<T>> {
    read_where(path, required, |_| Ok(()), parse)
}

/// [`read`] of a file whose names of columns must also fit otherwise; what does not is an error of the header's line.
pub(super) fn read_where<T: Indexed>(
    path: &Path,
    required: &[&str],
    fits: impl Fn(&[String]) -> RowResult<()>,
    parse: impl Fn(&Row) -> RowResult<T>,
) -> Result<Checked<T>> {
    read_kept(path, required, fits, parse, |_| true)
}

/// [`read_where`], of which only some rows are kept; memory grows with these alone. The first row and the last are kept all the same, so that it
/// can be said what the file holds.
pub(super) fn read_kept<T: Indexed>(
    path: &Path,
    required: &[&str],
    fits: impl Fn(&[String]) -> RowResult<()>,
    parse: impl Fn(&Row) -> RowResult<T>,
    is_kept: impl Fn(&T) -> bool,
) -> Result<Checked<T>> {
    let bytes = read_bytes(path, TABLE_BYTES)?;
    let (numbered, mut warnings) = parsed_rows(path, &bytes, &[], required, fits, parse, is_kept)?;
    let rows = in_order_once(numbered, &mut warnings);
    checked(path, rows, warnings)
}

/// The rows of a file under other names of columns, as they stand in it, each with its line; of which only some are kept, as in [`read_kept`].
pub(super) fn read_renamed<'a, T>(
    path: &'a Path,
    names: &[Renamed],
    required: &[&str],
    parse: impl Fn(&Row) -> RowResult<T>,
    is_kept: impl Fn(&T) -> bool,
) -> Result<(Vec<(u64, T)>, Warnings<'a>)> {
    parsed_rows(path, &read_bytes(path, TABLE_BYTES)?, names, required, |_| Ok(()), parse, is_kept)
}

/// What can be used of a file's rows.
///
/// # Errors
/// None.
pub(super) fn checked<T>(path: &Path, rows: Vec<T>, warnings: Warnings) -> Result<Checked<T>> {
    let warnings = warnings.in_order();
    if rows.is_empty() {
        // One more warning says that the rows are not in order.
        let contradicted = warnings.iter().find(|warning| warning.fault == Fault::Contradiction);
        let others = warnings.iter().filter(|warning| warning.fault != Fault::Contradiction).count();
        let message = match contradicted.filter(|_| others <= 1).or(warnings.first()) {
            Some(first) if first.fault == Fault::Contradiction => format!(
                "every index is there more than once with other values, as when two logs are in one file; keep one of them (line {}: {})",
                first.line.unwrap_or_default(),
                first.message
            ),
            Some(first) => {
                format!("no usable row; the first fault, in line {}: {}", first.line.unwrap_or_default(), first.message)
            }
            None => "no rows below the header; expected one a frame".to_owned(),
        };
        return Err(Error::content(path, message));
    }
    Ok(Checked { rows, warnings })
}

fn parsed_rows<'a, T>(
    path: &'a Path,
    bytes: &[u8],
    names: &[Renamed],
    required: &[&str],
    fits: impl Fn(&[String]) -> RowResult<()>,
    parse: impl Fn(&Row) -> RowResult<T>,
    is_kept: impl Fn(&T) -> bool,
) -> Result<(Vec<(u64, T)>, Warnings<'a>)> {
    let text = text_of(path, bytes)?;
    let renamed: Vec<&str> = names.iter().map(|name| name.from.as_str()).collect();
    let sheet = Sheet::of(&text, if names.is_empty() { required } else { &renamed });
    fits(&sheet.header).map_err(|why| Error::at_line(path, sheet.header_line, why))?;
    let columns = columns_of(path, &sheet, names, required)?;
    let mut numbered = Vec::new();
    let mut warnings = Warnings::new(path);
    let mut passed_over = None;
    let cut_line = is_cut_in_a_number(&text).then(|| text.lines().count() as u64);
    for (number, fields) in sheet.rows() {
        if Some(number) == cut_line {
            let why = "the file was cut in the middle of this line: it has no line end, and its last number fewer digits than all others";
            warnings.push(number, format!("{why}; row skipped"));
            continue;
        }
        let row = usable_row(&columns, &sheet, fields);
        match row.and_then(|row| parse(&row)) {
            Ok(value) if numbered.is_empty() || is_kept(&value) => {
                passed_over = None;
                numbered.push((number, value));
            }
            Ok(value) => passed_over = Some((number, value)),
            Err(why) => warnings.push(number, format!("{why}; row skipped")),
        }
    }
    numbered.extend(passed_over);
    Ok((numbered, warnings))
}

fn columns_of(path: &Path, sheet: &Sheet, names: &[Renamed], required: &[&str]) -> Result<Columns> {
    let expected = required.join(",");
    let (header, line) = (&sheet.header, sheet.header_line);
    if header.iter().all(|name| name.is_empty()) {
        return Err(Error::content(path, format!("the file is empty, expected a header line {expected}")));
    }
    let mut columns = Columns::new();
    for (at, name) in header.iter().enumerate() {
        let twice = columns.insert(name.clone(), Column { at, scale: 1.0 }).is_some();
        let is_asked_for = required.contains(&name.as_str()) || names.iter().any(|renamed| renamed.from == *name);
        if twice && is_asked_for {
            return Err(Error::at_line(path, line, format!("column {name} is there twice; remove one")));
        }
    }
    for Renamed { from, to, scale } in names {
        let Some(column) = columns.get(from).copied() else {
            let message = format!("[log] names the column {from:?}, and the header has {}", header.join(", "));
            return Err(Error::at_line(path, line, message));
        };
        columns.insert(to.clone(), Column { scale: *scale, ..column });
    }
    let other_time = OTHER_TIMES.iter().find_map(|(name, scale)| Some((*columns.get(*name)?, *scale)));
    if let (false, Some((column, scale))) = (columns.contains_key(TIME), other_time) {
        columns.insert(TIME.to_owned(), Column { scale, ..column });
    }
    let missing: Vec<&str> = required.iter().copied().filter(|name| !columns.contains_key(*name)).collect();
    if missing.is_empty() {
        check_units(path, sheet, &columns, required)?;
        return Ok(columns);
    }
    let is_number = |name: &String| name.parse::<f64>().is_ok();
    if header.iter().all(is_number) || header[0].starts_with(['{', '[']) {
        let kind = if is_number(&header[0]) { "a row of numbers" } else { "JSON" };
        let message =
            format!("{kind} where the header should be; write {expected} above the rows, separated by commas");
        return Err(Error::at_line(path, line, message));
    }
    let found = header.join(",");
    let message = format!("column {} is missing, expected {expected}; the header has {found}", missing.join(", "));
    Err(Error::at_line(path, line, message))
}

/// That a row of units says of the columns that are asked for what their names say.
fn check_units(path: &Path, sheet: &Sheet, columns: &Columns, required: &[&str]) -> Result<()> {
    let Some((line, units)) = sheet.units() else { return Ok(()) };
    for (name, column) in required.iter().filter_map(|name| Some((*name, columns.get(*name)?))) {
        let said = units.get(column.at).unwrap_or("");
        let contradicts = match unit_of(said) {
            Some(Unit::Seconds(seconds)) => !name.ends_with("_s") || (seconds / column.scale - 1.0).abs() > 1e-9,
            Some(Unit::Millimetres(mm)) => !name.ends_with("_mm") || (mm / column.scale - 1.0).abs() > 1e-9,
            Some(Unit::Radians(_)) => name.ends_with("_s") || (name.ends_with("_mm") && column.scale == 1.0),
            None => false,
        };
        if contradicts {
            let message = format!(
                "{name} is in {said} by this row of units; say so under [log] of experiment.toml (time_unit, unit), or correct the row"
            );
            return Err(Error::at_line(path, line, message));
        }
    }
    Ok(())
}

/// A row with as many fields as the header has columns; empty ones at the end of either do not count.
fn usable_row<'a>(columns: &'a Columns, sheet: &Sheet, fields: csv::StringRecord) -> RowResult<Row<'a>> {
    let (found, width) = (fields.len(), sheet.header.len());
    let is_empty = |field: &str| field.is_empty();
    if !fields.iter().skip(width).all(is_empty) || !sheet.header.iter().skip(found).all(|name| is_empty(name)) {
        return Err(format!("{found} fields, expected {width}"));
    }
    Ok(Row { columns, fields, has_decimal_commas: sheet.has_decimal_commas() })
}

pub(super) fn in_order_once<T: Indexed>(mut numbered: Vec<(u64, T)>, warnings: &mut Warnings) -> Vec<T> {
    if let Some(pair) = numbered.windows(2).find(|pair| pair[1].1.index() < pair[0].1.index()) {
        let (line, before, after) = (pair[1].0, pair[0].1.index(), pair[1].1.index());
        warnings.push(line, format!("index {after} follows {before}; the rows were put in order of their index"));
    }
    numbered.sort_by(|(_, a), (_, b)| (a.index(), a.view()).cmp(&(b.index(), b.view())));

    let mut rows: Vec<T> = Vec::new();
    let mut rest = numbered.into_iter().peekable();
    while let Some((line, row)) = rest.next() {
        let mut contradicted = false;
        while let Some((again, twin)) = rest.next_if(|(_, b)| (b.index(), b.view()) == (row.index(), row.view())) {
            let index = row.index();
            if twin == row {
                warnings.push(again, format!("index {index} repeats line {line}; row skipped"));
            } else {
                contradicted = true;
                let message = format!("index {index} is in line {line} with other values; neither row was used");
                warnings.told(again, message, Fault::Contradiction);
            }
        }
        if !contradicted {
            rows.push(row);
        }
    }
    rows
}

#[cfg(test)]
mod tests;
