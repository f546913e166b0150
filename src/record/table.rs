//! What all CSV files share: a header that names the columns, rows that are checked one by one.
//!
//! A file without the needed columns, or without a single good row, is an error. A bad row is passed over with a
//! [`Warning`] that says where and why, and the other rows are used.

use super::columns::fields_of;
use crate::error::{Error, Result};
use crate::input::{TABLE_BYTES, read_bytes};
use std::collections::HashMap;
use std::fmt;
use std::path::{Path, PathBuf};

/// Something in a file that was passed over, and why. The rest of the file was used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Warning {
    /// The file.
    pub path: PathBuf,
    /// The line, counted from 1.
    pub line: u64,
    /// What was found, and what was done about it.
    pub message: String,
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}: {}", self.path.display(), self.line, self.message)
    }
}

/// What a file held, and what of it had to be passed over.
#[derive(Debug, Clone, PartialEq)]
pub struct Checked<T> {
    /// The good rows, in order of their index.
    pub rows: Vec<T>,
    /// One entry for everything passed over or put right.
    pub warnings: Vec<Warning>,
}

/// One row of a CSV file whose fields are asked for by the names of their columns.
pub(super) struct Row<'a> {
    columns: &'a HashMap<String, usize>,
    fields: csv::StringRecord,
}

/// Why a row cannot be used; the line is known to the caller.
pub(super) type RowResult<T> = std::result::Result<T, String>;

impl Row<'_> {
    /// The text of a field, empty where the file has no such column.
    pub fn text(&self, column: &str) -> &str {
        self.columns.get(column).and_then(|&at| self.fields.get(at)).unwrap_or("")
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
        match text.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(Some(number)),
            _ => Err(format!("{column} is {}, expected a number", quoted(text))),
        }
    }

    /// A finite number.
    pub fn number(&self, column: &str) -> RowResult<f64> {
        self.optional_number(column)?.ok_or_else(|| format!("{column} is empty, expected a number"))
    }

    /// A whole number, not negative; `12.0` is one too, since spreadsheets write it so.
    pub fn index(&self, column: &str) -> RowResult<u64> {
        /// Above this not every whole number has an `f64`.
        ///
        /// Convention: a resource limit.
        const LARGEST: f64 = 9_007_199_254_740_992.0;
        let text = self.text(column);
        if let Ok(index) = text.parse() {
            return Ok(index);
        }
        match text.parse::<f64>() {
            Ok(number) if number.fract() == 0.0 && (0.0..=LARGEST).contains(&number) => Ok(number as u64),
            _ => Err(format!("{column} is {}, expected a whole number from 0 up", quoted(text))),
        }
    }
}

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
pub(super) struct OwnColumns(HashMap<String, usize>);

impl OwnColumns {
    pub fn new<'a>(names: impl IntoIterator<Item = &'a str>) -> Self {
        Self(names.into_iter().enumerate().map(|(at, name)| (name.to_owned(), at)).collect())
    }

    /// One line.
    pub fn row(&self, line: &str) -> RowResult<Row<'_>> {
        let fields = fields_of(line);
        if fields.len() != self.0.len() {
            return Err(format!("{} fields, expected {}", fields.len(), self.0.len()));
        }
        Ok(Row { columns: &self.0, fields })
    }
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

/// [`read`] of a file whose names of columns must also fit otherwise; what does not is an error of the first line.
pub(super) fn read_where<T: Indexed>(
    path: &Path,
    required: &[&str],
    fits: impl Fn(&dyn Fn(&str) -> bool) -> RowResult<()>,
    parse: impl Fn(&Row) -> RowResult<T>,
) -> Result<Checked<T>> {
    let bytes = read_bytes(path, TABLE_BYTES)?;
    parse_table(path, &bytes, required, fits, parse)
}

/// [`read_where`] on bytes; `path` is for the messages.
pub(super) fn parse_table<T: Indexed>(
    path: &Path,
    bytes: &[u8],
    required: &[&str],
    fits: impl Fn(&dyn Fn(&str) -> bool) -> RowResult<()>,
    parse: impl Fn(&Row) -> RowResult<T>,
) -> Result<Checked<T>> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let mut lines = lines(bytes);
    let header = lines.next().map(|(_, line)| fields_of_bytes(line)).unwrap_or_default();
    let is_there = |name: &str| header.iter().any(|field| field == name.as_bytes());
    fits(&is_there).map_err(|why| Error::at_line(path, 1, why))?;
    let columns = columns_of(path, &header, required)?;

    let mut numbered = Vec::new();
    let mut warnings = Warnings::new(path);
    for (number, line) in lines {
        match usable_row(&columns, header.len(), fields_of_bytes(line)).and_then(|row| parse(&row)) {
            Ok(value) => numbered.push((number, value)),
            Err(why) => warnings.push(number, format!("{why}; row skipped")),
        }
    }
    let rows = in_order_once(numbered, &mut warnings);
    let warnings = warnings.in_order();
    if rows.is_empty() {
        let message = match warnings.first() {
            Some(first) => format!("no usable row; the first fault, in line {}: {}", first.line, first.message),
            None => "no rows below the header; expected one a frame".to_owned(),
        };
        return Err(Error::content(path, message));
    }
    Ok(Checked { rows, warnings })
}

fn columns_of(path: &Path, header: &csv::ByteRecord, required: &[&str]) -> Result<HashMap<String, usize>> {
    let expected = required.join(",");
    if header.iter().all(|name| name.is_empty()) {
        return Err(Error::content(path, format!("the file is empty, expected a header line {expected}")));
    }
    let mut columns = HashMap::new();
    for (at, name) in header.iter().enumerate() {
        let name = String::from_utf8_lossy(name).into_owned();
        if columns.insert(name.clone(), at).is_some() && required.contains(&name.as_str()) {
            return Err(Error::at_line(path, 1, format!("column {name} is there twice; remove one")));
        }
    }
    let missing: Vec<&str> = required.iter().copied().filter(|name| !columns.contains_key(*name)).collect();
    if missing.is_empty() {
        return Ok(columns);
    }
    let hint = if columns.keys().any(|name| name.contains(';')) {
        "; the columns seem to be separated by semicolons, use commas"
    } else {
        ""
    };
    Err(Error::at_line(path, 1, format!("column {} is missing, expected {expected}{hint}", missing.join(", "))))
}

fn usable_row(columns: &HashMap<String, usize>, width: usize, record: csv::ByteRecord) -> RowResult<Row<'_>> {
    if record.len() != width {
        return Err(format!("{} fields, expected {width}", record.len()));
    }
    let fields = csv::StringRecord::from_byte_record(record).map_err(|_| "not UTF-8 text".to_owned())?;
    Ok(Row { columns, fields })
}

/// The lines of a file that are not blank, each with its number, counted from 1; they may end in \n, \r\n or \r.
fn lines(bytes: &[u8]) -> impl Iterator<Item = (u64, &[u8])> {
    let mut rest = Some(bytes);
    let each = std::iter::from_fn(move || {
        let bytes = rest?;
        let Some(end) = bytes.iter().position(|byte| matches!(byte, b'\n' | b'\r')) else { return rest.take() };
        let ended_by = if bytes[end..].starts_with(b"\r\n") { 2 } else { 1 };
        rest = Some(&bytes[end + ended_by..]);
        Some(&bytes[..end])
    });
    (1..).zip(each).filter(|(_, line)| !line.trim_ascii().is_empty())
}

/// The fields of one line, without the spaces around them. A quote that is not closed ends with its line: a field of these tables has
/// no line break in it, and the rows that follow a stray quote must not be taken for its text.
fn fields_of_bytes(line: &[u8]) -> csv::ByteRecord {
    if !line.contains(&b'"') {
        return line.split(|&byte| byte == b',').map(<[u8]>::trim_ascii).collect();
    }
    let reader = csv::ReaderBuilder::new().has_headers(false).flexible(true).trim(csv::Trim::All).from_reader(line);
    // Any bytes are a record.
    reader.into_byte_records().next().and_then(Result::ok).unwrap_or_default()
}

/// The warnings about one file, of which only so many are kept: a file of nothing but faults is soon known for what it is.
pub(super) struct Warnings<'a> {
    path: &'a Path,
    first: Vec<Warning>,
    others: u64,
}

impl<'a> Warnings<'a> {
    /// Convention: a resource limit.
    const MOST: usize = 1000;

    pub fn new(path: &'a Path) -> Self {
        Self { path, first: Vec::new(), others: 0 }
    }

    pub fn push(&mut self, line: u64, message: String) {
        if self.first.len() < Self::MOST {
            self.first.push(Warning { path: self.path.to_owned(), line, message });
        } else {
            self.others += 1;
        }
    }

    /// In order of their lines; the last tells how many more there were.
    pub fn in_order(mut self) -> Vec<Warning> {
        self.first.sort_by_key(|warning| warning.line);
        if let (true, Some(last)) = (self.others > 0, self.first.last()) {
            let message = format!("and {} more rows with faults", self.others);
            self.first.push(Warning { message, ..last.clone() });
        }
        self.first
    }
}

fn in_order_once<T: Indexed>(mut numbered: Vec<(u64, T)>, warnings: &mut Warnings) -> Vec<T> {
    let mut warn = |line, message| warnings.push(line, message);
    if let Some(pair) = numbered.windows(2).find(|pair| pair[1].1.index() < pair[0].1.index()) {
        let (line, before, after) = (pair[1].0, pair[0].1.index(), pair[1].1.index());
        warn(line, format!("index {after} follows {before}; the rows were put in order of their index"));
    }
    numbered.sort_by(|(_, a), (_, b)| (a.index(), a.view()).cmp(&(b.index(), b.view())));

    let mut rows: Vec<T> = Vec::new();
    let mut rest = numbered.into_iter().peekable();
    while let Some((line, row)) = rest.next() {
        let mut contradicted = false;
        while let Some((again, twin)) = rest.next_if(|(_, b)| (b.index(), b.view()) == (row.index(), row.view())) {
            let index = row.index();
            if twin == row {
                warn(again, format!("index {index} repeats line {line}; row skipped"));
            } else {
                contradicted = true;
                warn(again, format!("index {index} is in line {line} with other values; neither row was used"));
            }
        }
        if !contradicted {
            rows.push(row);
        }
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(Debug, PartialEq)]
    struct Reading(u64, f64);

    impl Indexed for Reading {
        fn index(&self) -> u64 {
            self.0
        }
    }

    fn parse(text: &[u8]) -> Result<Checked<Reading>> {
        parse_table(
            Path::new("a.csv"),
            text,
            &["index", "x_mm"],
            |_| Ok(()),
            |row| Ok(Reading(row.index("index")?, row.number("x_mm")?)),
        )
    }

    fn rows_and_warnings(text: &str) -> (Vec<(u64, f64)>, Vec<String>) {
        let checked = parse(text.as_bytes()).unwrap();
        (checked.rows.iter().map(|r| (r.0, r.1)).collect(), checked.warnings.iter().map(ToString::to_string).collect())
    }

    #[test]
    fn columns_are_found_by_name_in_any_order_and_others_are_ignored() {
        let (rows, warnings) = rows_and_warnings("\u{feff}x_mm, note ,index\r\n1.5,hello, 3\r\n2.5,,4.0\r\n");
        assert_eq!(rows, [(3, 1.5), (4, 2.5)]);
        assert!(warnings.is_empty(), "{warnings:?}");
    }

    #[test]
    fn a_bad_row_is_named_and_the_others_survive() {
        let (rows, warnings) = rows_and_warnings("index,x_mm\n0,1\n1,abc\n2,NaN\n3\n-4,1\n5,inf\n6,\n7,2\n");
        assert_eq!(rows, [(0, 1.0), (7, 2.0)]);
        assert_eq!(
            warnings,
            [
                "a.csv:3: x_mm is \"abc\", expected a number; row skipped",
                "a.csv:4: x_mm is \"NaN\", expected a number; row skipped",
                "a.csv:5: 1 fields, expected 2; row skipped",
                "a.csv:6: index is \"-4\", expected a whole number from 0 up; row skipped",
                "a.csv:7: x_mm is \"inf\", expected a number; row skipped",
                "a.csv:8: x_mm is empty, expected a number; row skipped",
            ]
        );
    }

    #[test]
    fn of_faults_without_end_the_first_are_told_and_the_others_counted() {
        let text = format!("index,x_mm\n0,1\n{}", "7\n".repeat(50_000));
        let (rows, warnings) = rows_and_warnings(&text);
        assert_eq!((rows.len(), warnings.len()), (1, 1001));
        assert_eq!(warnings[999], "a.csv:1002: 1 fields, expected 2; row skipped");
        assert_eq!(warnings[1000], "a.csv:1002: and 49000 more rows with faults");
    }

    #[test]
    fn text_that_is_not_utf8_costs_one_row() {
        let checked = parse(b"index,x_mm\n0,1\n1,\xff\xfe\n2,3\n").unwrap();
        assert_eq!(checked.rows, [Reading(0, 1.0), Reading(2, 3.0)]);
        assert_eq!(checked.warnings[0].line, 3);
    }

    #[test]
    fn lines_are_counted_however_they_end() {
        for end in ["\n", "\r\n", "\r"] {
            let text = ["index,x_mm", "0,1", "", "1,abc", "2,3"].join(end);
            let (rows, warnings) = rows_and_warnings(&text);
            assert_eq!(rows, [(0, 1.0), (2, 3.0)]);
            assert_eq!(warnings, ["a.csv:4: x_mm is \"abc\", expected a number; row skipped"], "{end:?}");
        }
    }

    #[test]
    fn a_stray_quote_costs_its_own_row() {
        let (rows, warnings) = rows_and_warnings("\"index\",x_mm\n0,1\n\"1,5\n\"2\", 3\n3,\"4\n4,5\n");
        assert_eq!(rows, [(0, 1.0), (2, 3.0), (3, 4.0), (4, 5.0)]);
        assert_eq!(warnings, ["a.csv:3: 1 fields, expected 2; row skipped"]);
    }

    #[test]
    fn unsorted_rows_are_sorted() {
        let (rows, warnings) = rows_and_warnings("index,x_mm\n2,1\n0,2\n1,3\n");
        assert_eq!(rows, [(0, 2.0), (1, 3.0), (2, 1.0)]);
        assert_eq!(warnings, ["a.csv:3: index 0 follows 2; the rows were put in order of their index"]);
    }

    #[test]
    fn a_repeated_row_counts_once_and_contradicting_rows_not_at_all() {
        let (rows, warnings) = rows_and_warnings("index,x_mm\n0,1\n0,1\n1,5\n2,7\n1,6\n");
        assert_eq!(rows, [(0, 1.0), (2, 7.0)]);
        assert_eq!(
            warnings,
            [
                "a.csv:3: index 0 repeats line 2; row skipped",
                "a.csv:6: index 1 follows 2; the rows were put in order of their index",
                "a.csv:6: index 1 is in line 4 with other values; neither row was used",
            ]
        );
    }

    #[test]
    fn files_of_no_use_say_why() {
        let message = |text: &str| parse(text.as_bytes()).unwrap_err().to_string();
        assert_eq!(message(""), "a.csv: the file is empty, expected a header line index,x_mm");
        assert_eq!(message("index,y\n0,1\n"), "a.csv:1: column x_mm is missing, expected index,x_mm");
        assert!(message("index;x_mm\n0;1\n").contains("use commas"));
        assert_eq!(message("index,x_mm,x_mm\n0,1,1\n"), "a.csv:1: column x_mm is there twice; remove one");
        assert_eq!(message("index,x_mm\n"), "a.csv: no rows below the header; expected one a frame");
        assert!(message("index,x_mm\n0,a\n").contains("no usable row; the first fault, in line 2"));
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = parse(&bytes);
        }

        #[test]
        fn any_text_below_a_good_header_is_read_or_refused(text in "([0-9a-z,;\"\\-.\n\r ]|NaN|inf){0,80}") {
            if let Ok(checked) = parse(format!("index,x_mm\n{text}").as_bytes()) {
                prop_assert!(checked.rows.windows(2).all(|pair| pair[0].0 < pair[1].0));
                prop_assert!(checked.rows.iter().all(|row| row.1.is_finite()));
            }
        }
    }
}
