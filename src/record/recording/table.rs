//! A table of a run, gone through row by row, each row a message.

use super::recorder::Recorder;
use crate::error::{Error, Result};
use crate::input::{LINE_BYTES, read_line};
use crate::record::columns::fields_of;
use crate::record::table::Warnings;
use serde::{Serialize, Serializer};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// The columns that hold words; all others hold numbers.
const WORDS: [&str; 3] = ["status", "reason", "view"];

/// A table, gone through row by row; the next row is at hand.
pub struct Table<'a> {
    name: &'a str,
    pub channel: u16,
    path: &'a Path,
    lines: BufReader<File>,
    line: u64,
    columns: Vec<String>,
    pub next: Option<Row>,
    pub warnings: Warnings<'a>,
}

/// A row as a message.
pub struct Row {
    pub index: Option<u64>,
    pub time_ns: u64,
    pub json: Vec<u8>,
}

impl<'a> Table<'a> {
    pub fn open(name: &'a str, path: &'a Path, recorder: &mut Recorder) -> Result<Self> {
        let file = File::open(path).map_err(Error::io(path, "read"))?;
        let (lines, warnings) = (BufReader::new(file), Warnings::new(path));
        let mut table = Self { name, channel: 0, path, lines, line: 0, columns: Vec::new(), next: None, warnings };
        let header = table.next_line()?.unwrap_or_default();
        table.columns = fields_of(header.trim_start_matches('\u{feff}')).iter().map(str::to_owned).collect();
        let count = |name: &str| table.columns.iter().filter(|column| *column == name).count();
        if count("time_s") == 0 {
            return Err(Error::at_line(path, 1, "column time_s is missing; a recording is ordered by it"));
        }
        if let Some(twice) = table.columns.iter().find(|column| count(column) > 1) {
            return Err(Error::at_line(path, 1, format!("column {twice} is there twice; remove one")));
        }
        let kind = |column: &str| if WORDS.contains(&column) { "string" } else { "number" };
        let properties: Vec<String> = table
            .columns
            .iter()
            .map(|name| format!("{}:{{\"type\":\"{}\"}}", serde_json::Value::from(name.as_str()), kind(name)))
            .collect();
        let title = format!("snakeloop.{name}");
        let schema = format!(r#"{{"title":"{title}","type":"object","properties":{{{}}}}}"#, properties.join(","));
        table.channel = recorder.channel(&table.topic().0, &title, &schema)?;
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
        while let Some(line) = self.next_line()? {
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

    fn next_line(&mut self) -> Result<Option<String>> {
        let mut text = Vec::new();
        self.line += 1;
        let read = read_line(&mut self.lines, LINE_BYTES, &mut text).map_err(Error::io(self.path, "read"))?;
        if read.length > LINE_BYTES as u64 {
            return Err(Error::at_line(self.path, self.line, "the line is too long for a row"));
        }
        Ok((read.length > 0).then(|| String::from_utf8_lossy(&text).into_owned()))
    }

    fn row(&self, line: &str) -> std::result::Result<Row, String> {
        let fields = fields_of(line);
        if fields.len() != self.columns.len() {
            return Err(format!("{} fields, expected {}", fields.len(), self.columns.len()));
        }
        let (mut index, mut time_ns, mut message) = (None, None, Vec::new());
        for (column, text) in self.columns.iter().map(String::as_str).zip(&fields) {
            if text.is_empty() {
                continue;
            }
            let field = if WORDS.contains(&column) { Field::Word(text) } else { Field::number(column, text)? };
            match (column, &field) {
                ("index", Field::Whole(number)) => index = Some(*number),
                ("time_s", field) => time_ns = Some(nanoseconds(field)?),
                _ => {}
            }
            message.push((column, field));
        }
        let time_ns = time_ns.ok_or("time_s is empty, and a recording is ordered by it")?;
        let json = serde_json::to_vec(&Message(message)).map_err(|e| e.to_string())?;
        Ok(Row { index, time_ns, json })
    }
}

/// A field of a message.
#[derive(Serialize)]
#[serde(untagged)]
enum Field<'a> {
    Whole(u64),
    Number(f64),
    Word(&'a str),
}

impl<'a> Field<'a> {
    fn number(column: &str, text: &'a str) -> std::result::Result<Self, String> {
        match (text.parse(), text.parse::<f64>()) {
            (Ok(whole), _) => Ok(Self::Whole(whole)),
            (_, Ok(number)) if number.is_finite() => Ok(Self::Number(number)),
            _ => Err(format!("{column} is {text:?}, expected a number")),
        }
    }
}

/// A time as MCAP has it. To the microsecond, for of today's time since 1970 a double holds no more.
fn nanoseconds(time_s: &Field) -> std::result::Result<u64, String> {
    let seconds = match *time_s {
        Field::Whole(whole) => whole as f64,
        Field::Number(number) => number,
        Field::Word(_) => f64::NAN,
    };
    // 2^64 ns are 584 years.
    if (0.0..1.8e10).contains(&seconds) {
        Ok((seconds * 1e6).round() as u64 * 1000)
    } else {
        Err(format!("time_s is {seconds}, expected 0 to 1.8e10"))
    }
}

/// A JSON object whose fields stand in order.
struct Message<'a>(Vec<(&'a str, Field<'a>)>);

impl Serialize for Message<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(column, field)| (column, field)))
    }
}
