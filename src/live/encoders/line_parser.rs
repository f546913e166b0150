//! One line of encoder readings.
//!
//! A line is `time_s,q1_mm,q2_mm,q3_mm` (a number for each backbone), with or without a header that names these columns in another order
//! (encoders.csv is read as it is), or JSON: `{"time_s": 1.5, "q_measured_mm": [0.1, -0.2, 0.1]}` (or `q_mm`), or with `q1_mm` … `q3_mm`.
//! Where `[log]` of experiment.toml gives the columns other names and units, these stand in place of them.

use super::line_buffer::MAX_LINE;
use crate::robot::PerBackbone;
use csv::{StringRecord, Trim};
use serde_json::{Map, Value};

/// Larger readings are a slip of units or a broken line, mm. Convention: no actuator travels a metre.
const MAX_Q_MM: f64 = 1e3;
/// Characters of a bad line that its message shows. Convention: a display choice.
const SHOWN: usize = 60;

/// Reads lines of encoder readings, CSV or JSON, and remembers the header that it met.
#[derive(Debug)]
pub struct LineParser {
    /// The columns needed: time_s, then q1_mm, q2_mm, … for each backbone.
    names: Vec<String>,
    /// What one unit of each is, s or mm.
    units: Vec<f64>,
    /// The place of each in a line, from the header.
    columns: Option<Vec<usize>>,
    /// What is wrong with the header: nobody knows then which number of a line is which.
    bad_header: Option<String>,
}

/// A time stamp, s, and q̃, mm; `None` for a header, a comment or an empty line; else what is wrong with the line.
pub type Parsed = std::result::Result<Option<(f64, PerBackbone)>, String>;

impl LineParser {
    /// A parser for a robot with so many backbones.
    pub fn new(backbones: usize) -> Self {
        let q = (1..=backbones).map(|i| format!("q{i}_mm"));
        Self::of_columns(["time_s".to_owned()].into_iter().chain(q).map(|name| (name, 1.0)).collect())
    }

    /// A parser for these columns, the time's first, and what one unit of each is, s or mm.
    pub fn of_columns(columns: Vec<(String, f64)>) -> Self {
        let (names, units) = columns.into_iter().unzip();
        Self { names, units, columns: None, bad_header: None }
    }

    /// Forgets the header: the lines of another connection may have another.
    pub fn reset(&mut self) {
        (self.columns, self.bad_header) = (None, None);
    }

    /// Reads a line.
    ///
    /// # Errors
    /// A line that is not a reading: what was expected, with the beginning of the line.
    pub fn parse(&mut self, line: &[u8]) -> Parsed {
        if line.len() > MAX_LINE {
            return Err(format!("more than {MAX_LINE} bytes in a line, expected {}", self.names.join(",")));
        }
        let line = String::from_utf8_lossy(line);
        // Some write a byte order mark before the first line, or before each.
        let line = line.trim_start_matches('\u{feff}').trim();
        if line.is_empty() || line.starts_with('#') {
            return Ok(None);
        }
        let values = if line.starts_with('{') { self.json(line)? } else { self.csv(line)? };
        let Some((time_s, q_mm)) = values else { return Ok(None) };
        if !is_reading(time_s, &q_mm) {
            return Err(format!("{}: not a reading in mm", start_of(line)));
        }
        Ok(Some((time_s, q_mm)))
    }

    fn csv(&mut self, line: &str) -> Parsed {
        let expected = || format!("{}: expected {}", start_of(line), self.names.join(","));
        let fields = fields_of(line).ok_or_else(expected)?;
        if fields.iter().any(|field| self.names.iter().any(|name| name == field)) {
            let header = self.header(&fields);
            (self.columns, self.bad_header) = (header.clone().ok(), header.err());
            return self.bad_header.clone().map_or(Ok(None), Err);
        }
        if let Some(why) = &self.bad_header {
            return Err(why.clone());
        }
        let columns = self.columns.as_deref();
        if columns.is_none() && fields.len() != self.names.len() {
            return Err(expected());
        }
        let field = |i: usize| fields.get(columns.map_or(i, |columns| columns[i]));
        let numbers = (0..self.names.len()).map(|i| Some(field(i)?.parse::<f64>().ok()? * self.units[i]));
        let values: Vec<f64> = numbers.collect::<Option<_>>().ok_or_else(expected)?;
        Ok(PerBackbone::of(&values[1..]).map(|q_mm| (values[0], q_mm)))
    }

    /// The places of the columns in a header.
    fn header(&self, fields: &StringRecord) -> std::result::Result<Vec<usize>, String> {
        let further = self.further();
        let place = |name: &str| fields.iter().position(|field| field == name);
        let columns = self.names.iter().map(|name| place(name).ok_or_else(|| format!("the header has no {name}")));
        let columns = columns.collect::<std::result::Result<_, _>>()?;
        match place(&further) {
            Some(_) => Err(format!("the header has {further}, expected {}", self.names.join(","))),
            None => Ok(columns),
        }
    }

    fn json(&self, line: &str) -> Parsed {
        let wrong = |why: String| format!("{}: {why}", start_of(line));
        let members: Map<String, Value> = serde_json::from_str(line).map_err(|e| wrong(e.to_string()))?;
        let backbones = self.names.len() - 1;
        let single = |i: usize| Some(members.get(&self.names[i])?.as_f64()? * self.units[i]);
        let all_of = |list: &Value| list.as_array()?.iter().map(Value::as_f64).collect::<Option<Vec<f64>>>();
        let list = members.get("q_measured_mm").or_else(|| members.get("q_mm")).and_then(all_of);
        let q_mm = list.or_else(|| (1..=backbones).map(single).collect());
        let q_mm = q_mm.filter(|q_mm| q_mm.len() == backbones && !members.contains_key(&self.further()));
        // What is called time_s is in seconds, whatever [log] says of others.
        let time_s = members.get("time_s").filter(|_| self.names[0] != "time_s").and_then(Value::as_f64);
        match (time_s.or_else(|| single(0)), q_mm.and_then(|q_mm| PerBackbone::of(&q_mm))) {
            (None, _) => Err(wrong(format!("{} is no number", self.names[0]))),
            (Some(time_s), Some(q_mm)) => Ok(Some((time_s, q_mm))),
            (_, None) => {
                let (first, last) = (&self.names[1], &self.names[backbones]);
                Err(wrong(format!("expected q_mm of {backbones} numbers, or {first} to {last}")))
            }
        }
    }

    /// The column that a robot with one more backbone would have.
    fn further(&self) -> String {
        format!("q{}_mm", self.names.len())
    }
}

/// Whether numbers can be a reading: a time, s, and positions, mm.
pub fn is_reading(time_s: f64, q_mm: &PerBackbone) -> bool {
    // NaN fails both comparisons.
    time_s.is_finite() && q_mm.iter().all(|q| q.abs() <= MAX_Q_MM)
}

/// The fields of a line without the spaces around them.
fn fields_of(line: &str) -> Option<StringRecord> {
    if !line.contains('"') {
        return Some(line.split(',').map(str::trim).collect());
    }
    let mut reader = csv::ReaderBuilder::new().has_headers(false).trim(Trim::All).from_reader(line.as_bytes());
    reader.records().next()?.ok()
}

/// The beginning of a line, quoted.
fn start_of(line: &str) -> String {
    format!("{:?}", line.chars().take(SHOWN).collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parsed(lines: &[&str]) -> Vec<Parsed> {
        let mut parser = LineParser::new(3);
        lines.iter().map(|line| parser.parse(line.as_bytes())).collect()
    }

    #[test]
    fn lines_of_every_kind_are_understood() {
        let expected = Ok(Some((1.5, PerBackbone::from([0.1, -0.2, 0.3]))));
        for lines in [
            &["1.5,0.1,-0.2,0.3"][..],
            &["time_s,q1_mm,q2_mm,q3_mm", "1.5, 0.1, -0.2, 0.3"],
            &["index,time_s,q1_mm,q2_mm,q3_mm", "7,1.5,0.1,-0.2,0.3"],
            &["q3_mm,q2_mm,q1_mm,time_s", "# a remark", "", "0.3,-0.2,0.1,1.5"],
            &[r#"{"time_s":1.5,"q_mm":[0.1,-0.2,0.3],"more":true}"#],
            &[r#"{"time_s":1.5,"q_measured_mm":[0.1,-0.2,0.3]}"#],
            &[r#"{"time_s":1.5,"q1_mm":0.1,"q2_mm":-0.2,"q3_mm":0.3}"#],
        ] {
            assert_eq!(parsed(lines).last().unwrap(), &expected, "{lines:?}");
        }
        for line in ["1.5,0.1", "a,b,c,d", "1.5,0.1,nan,0.3", "1.5,0.1,5000,0.3", "{\"time_s\":1}", "{", "1;2;3;4"] {
            assert!(parsed(&[line])[0].is_err(), "{line}");
        }
    }

    #[test]
    fn other_names_and_units_are_read_as_log_tells_them() {
        let columns = [("t_ms", 1e-3), ("m1", 8.0), ("m2", 8.0), ("m3", 8.0)];
        let read = |lines: &[&str]| {
            let mut parser = LineParser::of_columns(columns.map(|(name, unit)| (name.to_owned(), unit)).into());
            lines.iter().map(|line| parser.parse(line.as_bytes())).last().unwrap()
        };
        let (right_s, right_mm) = (1.5, PerBackbone::from([0.8, -1.6, 2.4]));
        for lines in [
            &["1500,0.1,-0.2,0.3"][..],
            &["frame,t_ms,m1,m3,m2", "7,1500,0.1,0.3,-0.2"],
            &[r#"{"t_ms":1500,"m1":0.1,"m2":-0.2,"m3":0.3}"#],
            &[r#"{"time_s":1.5,"m1":0.1,"m2":-0.2,"m3":0.3}"#],
        ] {
            let Ok(Some((time_s, q_mm))) = read(lines) else { panic!("{lines:?}") };
            assert!((time_s - right_s).abs() < 1e-12 && (q_mm - right_mm).norm() < 1e-12, "{lines:?}");
        }
    }

    #[test]
    fn lines_of_another_robot_are_refused() {
        let said = |backbones: usize, line: &str| LineParser::new(backbones).parse(line.as_bytes());
        let four = Ok(Some((1.5, PerBackbone::from([0.1, -0.2, 0.3, 0.4]))));
        assert_eq!(said(4, "1.5,0.1,-0.2,0.3,0.4"), four);
        assert_eq!(said(4, r#"{"time_s":1.5,"q_mm":[0.1,-0.2,0.3,0.4]}"#), four);
        assert_eq!(said(4, r#"{"time_s":1.5,"q1_mm":0.1,"q2_mm":-0.2,"q3_mm":0.3,"q4_mm":0.4}"#), four);
        for (backbones, line, expected) in [
            (4, "1.5,0.1,-0.2,0.3", "expected time_s,q1_mm,q2_mm,q3_mm,q4_mm"),
            (3, "1.5,0.1,-0.2,0.3,0.4", "expected time_s,q1_mm,q2_mm,q3_mm"),
            (4, "time_s,q1_mm,q2_mm,q3_mm", "the header has no q4_mm"),
            (3, "time_s,q1_mm,q2_mm,q3_mm,q4_mm", "the header has q4_mm"),
            (4, r#"{"time_s":1.5,"q_mm":[0.1,-0.2,0.3]}"#, "expected q_mm of 4 numbers"),
            (3, r#"{"time_s":1.5,"q1_mm":0.1,"q2_mm":-0.2,"q3_mm":0.3,"q4_mm":0.4}"#, "q1_mm to q3_mm"),
        ] {
            let said = said(backbones, line).unwrap_err();
            assert!(said.contains(expected), "{line}: {said}");
        }
    }

    proptest! {
        #[test]
        fn any_line_is_read_or_refused(lines in proptest::collection::vec(".{0,60}|[-0-9.,eE{}\":a-z_]{0,60}", 0..6)) {
            let mut parser = LineParser::new(3);
            for line in lines {
                if let Ok(Some((time_s, q))) = parser.parse(line.as_bytes()) {
                    prop_assert!(time_s.is_finite() && q.iter().all(|q| q.is_finite()));
                }
            }
        }
    }
}
