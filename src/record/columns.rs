//! How rows are written: numbers with a fixed count of decimals, a column for each backbone, quotes where a field needs them.

use crate::error::{Error, Result};
use crate::robot::PerBackbone;
use serde::Serialize;

/// The text of a CSV file: its records, the header first.
pub(super) fn csv_text<Record, Field>(records: impl IntoIterator<Item = Record>) -> String
where
    Record: IntoIterator<Item = Field>,
    Field: AsRef<str>,
{
    let mut text = Vec::new();
    let mut writer = csv::WriterBuilder::new().flexible(true).from_writer(&mut text);
    for record in records {
        // Nothing can fail in memory.
        let _ = writer.write_record(record.into_iter().map(|field| field.as_ref().as_bytes().to_owned()));
    }
    drop(writer);
    String::from_utf8(text).unwrap_or_default()
}

/// One record of a CSV file, without the end of its line.
pub(super) fn csv_line<Field: AsRef<str>>(fields: impl IntoIterator<Item = Field>) -> String {
    let mut line = csv_text([fields]);
    line.pop();
    line
}

/// The fields of one line of a CSV file, without the spaces around them.
pub(super) fn fields_of(line: &str) -> csv::StringRecord {
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(csv::Trim::All)
        .buffer_capacity(line.len().max(1))
        .from_reader(line.as_bytes());
    let mut fields = csv::StringRecord::new();
    // Any text is a record; of an empty one there are no fields.
    let _ = reader.read_record(&mut fields);
    fields
}

/// Rows as CSV, the columns named after the fields; a field that is `None` is empty.
///
/// # Errors
/// [`Error::Encode`] for a row whose fields are not single values.
pub fn csv_of<T: Serialize>(rows: &[T]) -> Result<String> {
    let mut text = Vec::new();
    let mut writer = csv::Writer::from_writer(&mut text);
    rows.iter().try_for_each(|row| writer.serialize(row)).map_err(Error::encode("the rows"))?;
    drop(writer);
    String::from_utf8(text).map_err(Error::encode("the rows"))
}

/// The names of columns that there are one of for each backbone, such as q1_mm, q2_mm, q3_mm.
pub(super) fn backbone_columns(name: &str, unit: &str, backbones: usize) -> impl Iterator<Item = String> {
    (1..=backbones).map(move |i| format!("{name}{i}_{unit}"))
}

/// The numbers of the backbones with a fixed count of decimals.
pub(super) fn backbone_decimals(values: &PerBackbone, places: usize) -> impl Iterator<Item = String> {
    values.iter().map(move |&value| decimals(value, places))
}

/// A number with a fixed count of decimals, never "-0.000".
pub(super) fn decimals(value: f64, places: usize) -> String {
    let text = format!("{value:.places$}");
    if text.starts_with('-') && text.bytes().all(|b| matches!(b, b'-' | b'0' | b'.')) {
        text[1..].to_owned()
    } else {
        text
    }
}

/// [`decimals`], or nothing.
pub(super) fn decimals_or_empty(value: Option<f64>, places: usize) -> String {
    value.map(|value| decimals(value, places)).unwrap_or_default()
}

/// An azimuth as files hold it: degrees in (−180, 180], six decimals.
pub(super) fn azimuth(angle_deg: f64) -> String {
    let text = decimals(angle_deg, 6);
    if text == "-180.000000" { "180.000000".to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn written_numbers_have_no_negative_zero() {
        assert_eq!(decimals(-1e-9, 3), "0.000");
        assert_eq!(decimals(-0.001, 3), "-0.001");
        assert_eq!(azimuth(-179.99999999), "180.000000");
    }

    proptest! {
        #[test]
        fn fields_come_back_whatever_they_hold(
            fields in proptest::collection::vec("[a-z0-9,;\" .-]{0,12}", 1..8)
        ) {
            let line = csv_line(&fields);
            let trimmed: Vec<&str> = fields.iter().map(|field| field.trim()).collect();
            let found = fields_of(&line);
            prop_assert_eq!(found.iter().collect::<Vec<_>>(), trimmed);
        }
    }
}
