//! One line of encoder readings.
//!
//! A line is `time_s,q1_mm,q2_mm,q3_mm` (a number for each backbone), with or without a header that names these columns in another order
//! (encoders.csv is read as it is), or JSON: `{"time_s": 1.5, "q_measured_mm": [0.1, -0.2, 0.1]}` (or `q_mm`), or with `q1_mm` … `q3_mm`.

use super::line_buffer::MAX_LINE;
use crate::robot::PerBackbone;
use csv::{StringRecord, Trim};
use serde::Deserialize;
use serde_json::Value;
use std::collections::HashMap;

/// Larger readings are a slip of units or a broken line, mm. Convention: no actuator travels a metre.
const MAX_Q_MM: f64 = 1e3;
/// Characters of a bad line that its message shows. Convention: a display choice.
const SHOWN: usize = 60;

/// Reads lines of encoder readings, CSV or JSON, and remembers the header that it met.
#[derive(Debug)]
pub struct LineParser {
    /// The columns needed: time_s, then q1_mm, q2_mm, … for each backbone.
    names: Vec<String>,
    /// The place of each in a line, from the header.
    columns: Option<Vec<usize>>,
}

/// A time stamp, s, and q̃, mm; `None` for a header, a comment or an empty line; else what is wrong with the line.
pub type Parsed = std::result::Result<Option<(f64, PerBackbone)>, String>;

#[derive(Deserialize)]
struct JsonReading {
    time_s: f64,
    #[serde(alias = "q_measured_mm")]
    q_mm: Option<PerBackbone>,
    /// q1_mm, q2_mm, … among others.
    #[serde(flatten)]
    others: HashMap<String, Value>,
}

impl LineParser {
    /// A parser for a robot with so many backbones.
    pub fn new(backbones: usize) -> Self {
        let q = (1..=backbones).map(|i| format!("q{i}_mm"));
        Self { names: ["time_s".to_owned()].into_iter().chain(q).collect(), columns: None }
    }

    /// Forgets the header: the lines of another connection may have another.
    pub fn reset(&mut self) {
        self.columns = None;
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
        let line = line.trim();
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
        let mut reader = csv::ReaderBuilder::new().has_headers(false).trim(Trim::All).from_reader(line.as_bytes());
        let expected = || format!("{}: expected {}", start_of(line), self.names.join(","));
        let fields = reader.records().next().and_then(std::result::Result::ok).ok_or_else(expected)?;
        if fields.iter().any(|field| self.names.iter().any(|name| name == field)) {
            self.columns = Some(self.header(&fields)?);
            return Ok(None);
        }
        let columns = self.columns.as_deref();
        if columns.is_none() && fields.len() != self.names.len() {
            return Err(expected());
        }
        let field = |i: usize| fields.get(columns.map_or(i, |columns| columns[i]));
        let numbers = (0..self.names.len()).map(|i| field(i)?.parse::<f64>().ok());
        let values: Vec<f64> = numbers.collect::<Option<_>>().ok_or_else(expected)?;
        Ok(PerBackbone::of(&values[1..]).map(|q_mm| (values[0], q_mm)))
    }

    /// The places of the columns in a header.
    fn header(&self, fields: &StringRecord) -> std::result::Result<Vec<usize>, String> {
        let further = format!("q{}_mm", self.names.len());
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
        let JsonReading { time_s, q_mm, others } = serde_json::from_str(line).map_err(|e| wrong(e.to_string()))?;
        let backbones = self.names.len() - 1;
        let single = || -> Option<PerBackbone> {
            let numbers: Option<Vec<f64>> = self.names[1..].iter().map(|name| others.get(name)?.as_f64()).collect();
            PerBackbone::of(&numbers?)
        };
        let q_mm = q_mm.or_else(single).filter(|q_mm| q_mm.len() == backbones);
        let further = format!("q{}_mm", backbones + 1);
        match q_mm {
            Some(q_mm) if !others.contains_key(&further) => Ok(Some((time_s, q_mm))),
            _ => Err(wrong(format!("expected q_mm of {backbones} numbers, or q1_mm to q{backbones}_mm"))),
        }
    }
}

/// Whether numbers can be a reading: a time, s, and positions, mm.
pub fn is_reading(time_s: f64, q_mm: &PerBackbone) -> bool {
    // NaN fails both comparisons.
    time_s.is_finite() && q_mm.iter().all(|q| q.abs() <= MAX_Q_MM)
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
