//! A table of a run, gone through row by row, each row a message.

use super::recorder::Recorder;
use crate::bag::messages::{self, Definition, JointState};
use crate::error::{Error, Result};
use crate::input::{LINE_BYTES, read_line};
use crate::record::columns::fields_of;
use crate::record::table::{self, OwnColumns, RowResult, Warnings};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// A table, gone through row by row; the next row is at hand.
pub struct Table<'a> {
    name: &'a str,
    pub channel: u16,
    path: &'a Path,
    lines: BufReader<File>,
    line: u64,
    columns: OwnColumns,
    form: Form,
    pub next: Option<Row>,
    pub warnings: Warnings<'a>,
}

/// A row as a message.
pub struct Row {
    pub index: u64,
    pub time_ns: u64,
    pub cdr: Vec<u8>,
}

/// What a table's messages are.
enum Form {
    /// A type of its own, whose fields are these columns.
    Fields(Vec<String>),
    /// `JointState`: these columns, which are in mm, as positions of joints with these names, in m.
    Joints { columns: Vec<String>, names: Vec<String> },
}

impl<'a> Table<'a> {
    pub fn open(name: &'a str, path: &'a Path, recorder: &mut Recorder) -> Result<Self> {
        let file = File::open(path).map_err(Error::io(path, "read"))?;
        let (mut lines, mut warnings) = (BufReader::new(file), Warnings::new(path));
        let header = next_line(path, &mut lines, 1)?.unwrap_or_default();
        let header = fields_of(header.trim_start_matches('\u{feff}'));
        let count = |name: &str| header.iter().filter(|column| *column == name).count();
        for (needed, why) in [("time_s", "a recording is ordered by it"), ("index", "frames belong to rows by it")] {
            if count(needed) == 0 {
                return Err(Error::at_line(path, 1, format!("column {needed} is missing; {why}")));
            }
        }
        if let Some(twice) = header.iter().find(|column| count(column) > 1) {
            return Err(Error::at_line(path, 1, format!("column {twice} is there twice; remove one")));
        }
        let form = Form::of(name, header.iter(), &mut warnings);
        let columns = OwnColumns::new(&header);
        let mut table = Self { name, channel: 0, path, lines, line: 1, columns, form, next: None, warnings };
        table.channel = table.form.record(name, &table.topic().0, recorder)?;
        table.take()?;
        Ok(table)
    }

    /// The topic and its channel.
    pub fn topic(&self) -> (String, u16) {
        (format!("/{}", self.name), self.channel)
    }

    /// When the next row was.
    pub fn time_ns(&self) -> u64 {
        self.next.as_ref().map_or(u64::MAX, |row| row.time_ns)
    }

    /// Takes the row at hand and reads the one after; rows that make no sense are passed over and told.
    pub fn take(&mut self) -> Result<Option<Row>> {
        let taken = self.next.take();
        loop {
            self.line += 1;
            let Some(line) = next_line(self.path, &mut self.lines, self.line)? else { break };
            match self.row(&line) {
                _ if line.trim().is_empty() => {}
                Ok(row) => {
                    self.next = Some(row);
                    break;
                }
                Err(why) => self.warnings.push(self.line, format!("{why}; row left out")),
            }
        }
        Ok(taken)
    }

    fn row(&self, line: &str) -> RowResult<Row> {
        let row = self.columns.row(line)?;
        let time_s = row.optional_number("time_s")?.ok_or("time_s is empty, and a recording is ordered by it")?;
        let time_ns = nanoseconds(time_s)?;
        Ok(Row { index: row.index("index")?, time_ns, cdr: self.form.message(&row, time_ns)? })
    }
}

impl Form {
    /// What becomes of a table's columns; those that a message cannot hold are told.
    fn of<'a>(table: &str, columns: impl Iterator<Item = &'a str>, warnings: &mut Warnings) -> Self {
        if table == "encoders" {
            let told = columns.filter(|column| !["index", "time_s"].contains(column));
            let columns = kept(told, |column| column.ends_with("_mm"), "no reading in mm", warnings);
            let names = columns.iter().filter_map(|column| column.strip_suffix("_mm")).map(str::to_owned).collect();
            Self::Joints { columns, names }
        } else {
            Self::Fields(kept(columns, is_field_name, "no name of a field in ROS (a-z, 0-9, single _)", warnings))
        }
    }

    /// Adds the channel of these messages.
    fn record(&self, table: &str, topic: &str, recorder: &mut Recorder) -> Result<u16> {
        match self {
            Self::Joints { .. } => recorder.channel(topic, JointState::DEFINITION),
            Self::Fields(columns) => {
                let kind = format!("snakeloop_msgs/{}{}", table[..1].to_uppercase(), &table[1..]);
                let fields: String = columns.iter().map(|column| format!("{} {column}\n", type_of(column))).collect();
                recorder.channel(topic, Definition { kind: &kind, fields: &fields })
            }
        }
    }

    /// A row's message.
    fn message(&self, row: &table::Row, time_ns: u64) -> RowResult<Vec<u8>> {
        match self {
            Self::Joints { columns, names } => {
                let positions_m: RowResult<Vec<f64>> =
                    columns.iter().map(|column| Ok(row.number(column)? / 1000.0)).collect();
                Ok(JointState::encoded(time_ns, names, &positions_m?))
            }
            Self::Fields(columns) => {
                let mut cdr = messages::begun(time_ns, "");
                for column in columns {
                    match type_of(column) {
                        "uint64" => cdr.u64(row.index(column)?),
                        "string" => cdr.text(row.text(column)),
                        _ => cdr.f64(row.optional_number(column)?.unwrap_or(f64::NAN)),
                    }
                }
                Ok(cdr.into_bytes())
            }
        }
    }
}

/// The columns that a message can hold.
fn kept<'a>(
    columns: impl Iterator<Item = &'a str>,
    fits: impl Fn(&str) -> bool,
    fault: &str,
    warnings: &mut Warnings,
) -> Vec<String> {
    let (kept, others): (Vec<_>, Vec<_>) = columns.partition(|column| fits(column));
    for column in others {
        warnings.push(1, format!("column {column:?} is {fault}; left out"));
    }
    kept.into_iter().map(str::to_owned).collect()
}

/// Source: ROS 2's package rosidl_adapter, `VALID_FIELD_NAME_PATTERN`. The header is there already.
fn is_field_name(column: &str) -> bool {
    let is_plain = column.bytes().all(|byte| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'_'));
    is_plain
        && column.starts_with(|first: char| first.is_ascii_lowercase())
        && !column.ends_with('_')
        && !column.contains("__")
        && column != "header"
}

/// A field's type in ROS, by its column's name.
fn type_of(column: &str) -> &'static str {
    match column {
        "index" => "uint64",
        "status" | "reason" | "view" => "string",
        _ => "float64",
    }
}

/// A line of the file; `None` behind the last.
fn next_line(path: &Path, lines: &mut BufReader<File>, number: u64) -> Result<Option<String>> {
    let mut text = Vec::new();
    let read = read_line(lines, LINE_BYTES, &mut text).map_err(Error::io(path, "read"))?;
    if read.length > LINE_BYTES as u64 {
        return Err(Error::at_line(path, number, "the line is too long for a row"));
    }
    Ok((read.length > 0).then(|| String::from_utf8_lossy(&text).into_owned()))
}

/// A time as ROS has it. To the microsecond, for of today's time since 1970 a double holds no more.
fn nanoseconds(time_s: f64) -> RowResult<u64> {
    // The seconds of a stamp have 31 bits.
    if (0.0..2_147_483_647.5).contains(&time_s) {
        Ok((time_s * 1e6).round() as u64 * 1000)
    } else {
        Err(format!("time_s is {time_s}, expected 0 to 2147483647 (the stamps of ROS end in 2038)"))
    }
}
