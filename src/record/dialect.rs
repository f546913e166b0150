//! How a table is written: its characters, what separates its fields, where its header stands, which lines are no rows.
//!
//! Read are UTF-8, UTF-16 (as Windows' "Unicode text") and, where a text is neither, Latin-1; fields between commas, semicolons, tabs, bars or
//! blanks, told by the header; numbers with a decimal comma where commas separate nothing; lines that begin with `#`, of which the last may be
//! the header (as NumPy writes it); lines of other things above a header that has all columns; a first line `sep=;`; a row of units below the header; empty fields at the end of header or rows.

use crate::content;
use crate::error::{Error, Result};
use crate::input::text_in;
use std::borrow::Cow;
use std::path::Path;

/// What may separate fields; where several fit a header alike, the first counts.
const SEPARATORS: [char; 5] = [',', ';', '\t', '|', ' '];

/// A table's text, taken apart as far as its header.
pub(super) struct Sheet<'a> {
    text: &'a str,
    /// The columns' names.
    pub header: Vec<String>,
    /// The line of the header, from 1.
    pub header_line: u64,
    /// The first line below it, from 1.
    first_row: u64,
    separator: char,
}

/// The text of a table.
///
/// # Errors
/// A file of another kind, by name.
pub(super) fn text_of<'a>(path: &Path, bytes: &'a [u8]) -> Result<Cow<'a, str>> {
    if let Some(found) = content::name_of(bytes.get(..content::HEAD_BYTES).unwrap_or(bytes)) {
        return Err(Error::content(path, format!("{found}, expected a table as text (CSV); export it as CSV")));
    }
    Ok(text_in(bytes))
}

impl<'a> Sheet<'a> {
    /// A table in which columns of these names are looked for.
    pub fn of(text: &'a str, wanted: &[&str]) -> Self {
        let mut comment = None;
        let mut separator = None;
        for (line, content) in lines(text) {
            if let Some(named) = separator_line(content).filter(|_| separator.is_none()) {
                separator = Some(named);
                continue;
            }
            if let Some(commented) = content.trim_start().strip_prefix('#') {
                comment = Some((line, commented));
                continue;
            }
            let plain = Header::of(content, separator, wanted);
            if plain.found < wanted.len()
                && let Some((at, header)) = below_a_preamble(text, line, separator, wanted)
            {
                return Self::below(text, header, at, at + 1);
            }
            let commented = comment.map(|(at, commented)| (at, Header::of(commented, separator, wanted)));
            return match commented {
                Some((at, header)) if header.found > plain.found => Self::below(text, header, at, line),
                _ => Self::below(text, plain, line, line + 1),
            };
        }
        let header = comment.map(|(_, commented)| Header::of(commented, separator, wanted));
        let header = header.unwrap_or(Header { names: Vec::new(), separator: ',', found: 0 });
        Self::below(text, header, comment.map_or(1, |(at, _)| at), u64::MAX)
    }

    fn below(text: &'a str, header: Header, header_line: u64, first_row: u64) -> Self {
        let Header { names, separator, .. } = header;
        Self { text, header: names, header_line, first_row, separator }
    }

    /// Whether numbers may have a decimal comma.
    pub fn has_decimal_commas(&self) -> bool {
        self.separator != ','
    }

    /// The rows with their lines' numbers, without a row of units below the header (see [`units`](Self::units)).
    pub fn rows(&self) -> impl Iterator<Item = (u64, csv::StringRecord)> {
        let units = self.units().map(|(line, _)| line);
        self.lines_below().filter(move |(line, _)| Some(*line) != units)
    }

    /// The row of units below the header, where there is one: words, and not a single number.
    pub fn units(&self) -> Option<(u64, csv::StringRecord)> {
        let (line, fields) = self.lines_below().next()?;
        let said = || fields.iter().filter(|field| !field.is_empty());
        let is_unit = |field: &str| field.trim_matches(['[', ']', '(', ')']).chars().count() <= LONGEST_UNIT;
        let is_number = |field: &str| field.parse::<f64>().is_ok() || field.starts_with(|c: char| c.is_ascii_digit());
        let are_units = said().count() > 1 && said().all(|field| is_unit(field) && !is_number(field));
        (are_units && said().any(|field| unit_of(field).is_some())).then_some((line, fields))
    }

    fn lines_below(&self) -> impl Iterator<Item = (u64, csv::StringRecord)> {
        let rows = lines(self.text).skip_while(|(line, _)| *line < self.first_row);
        let rows = rows.filter(|(_, content)| !content.trim_start().starts_with('#'));
        rows.map(|(line, content)| (line, fields_of(content, self.separator)))
    }
}

/// The longest name of a unit, letters.
///
/// Convention: `seconds` and `counts` have as many.
const LONGEST_UNIT: usize = 12;

/// What a column is counted in, as a row of units or a name's end says it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Unit {
    /// So many seconds.
    Seconds(f64),
    /// So many millimetres.
    Millimetres(f64),
    /// So many radians.
    Radians(f64),
}

/// The unit of a word, in brackets or without; `None` for other words.
pub(super) fn unit_of(word: &str) -> Option<Unit> {
    Some(match word.trim_matches(['[', ']', '(', ')']).to_lowercase().as_str() {
        "s" | "sec" | "seconds" => Unit::Seconds(1.0),
        "ms" | "msec" | "millis" | "milliseconds" => Unit::Seconds(1e-3),
        "us" | "µs" | "μs" | "usec" | "micros" | "microseconds" => Unit::Seconds(1e-6),
        "ns" | "nsec" | "nanos" | "nanoseconds" => Unit::Seconds(1e-9),
        "mm" => Unit::Millimetres(1.0),
        "m" | "meter" | "metre" => Unit::Millimetres(1e3),
        "um" | "µm" | "μm" => Unit::Millimetres(1e-3),
        "in" | "inch" => Unit::Millimetres(25.4),
        "rad" => Unit::Radians(1.0),
        "deg" | "°" => Unit::Radians(std::f64::consts::PI / 180.0),
        _ => return None,
    })
}

/// A line taken for a header.
struct Header {
    names: Vec<String>,
    separator: char,
    /// How many of the wanted columns it has.
    found: usize,
}

impl Header {
    fn of(line: &str, separator: Option<char>, wanted: &[&str]) -> Self {
        let by = |separator: char| {
            let names: Vec<String> = fields_of(line, separator).iter().map(str::to_owned).collect();
            let found = wanted.iter().filter(|name| names.iter().any(|known| known == *name)).count();
            Self { names, separator, found }
        };
        let candidates = SEPARATORS.iter().filter(|known| separator.is_none_or(|named| named == **known));
        // Blanks stand in the names of a header that something else separates.
        let rank =
            |header: &Self| (header.found, header.separator != ' ' && header.names.len() > 1, header.names.len());
        let best = candidates
            .map(|&separator| by(separator))
            .reduce(|best, next| if rank(&next) > rank(&best) { next } else { best });
        best.unwrap_or_else(|| by(separator.unwrap_or(',')))
    }
}

/// The header below lines of other things, such as a recorder's name and settings, where it is complete: the first that has all wanted columns.
fn below_a_preamble(text: &str, from: u64, separator: Option<char>, wanted: &[&str]) -> Option<(u64, Header)> {
    /// Lines that stand above a header at the most. Convention: a resource limit; LabVIEW writes some twenty.
    const LONGEST: usize = 100;
    let below = lines(text).skip_while(|(line, _)| *line <= from).take(LONGEST);
    let header = |(line, content)| (line, Header::of(content, separator, wanted));
    below.map(header).find(|(_, header)| header.found == wanted.len())
}

/// The separator that a line `sep=;` names, as Excel takes it.
fn separator_line(line: &str) -> Option<char> {
    let named = line.trim_matches('"').strip_prefix("sep=")?;
    named.chars().next().filter(|_| named.chars().count() == 1)
}

/// The lines of a text that are not blank, each with its number, counted from 1; they may end in \n, \r\n or \r.
fn lines(text: &str) -> impl Iterator<Item = (u64, &str)> {
    let mut rest = Some(text);
    let each = std::iter::from_fn(move || {
        let text = rest?;
        let Some(end) = text.find(['\n', '\r']) else { return rest.take() };
        let ended_by = if text[end..].starts_with("\r\n") { 2 } else { 1 };
        rest = Some(&text[end + ended_by..]);
        Some(&text[..end])
    });
    (1..).zip(each).filter(|(_, line)| !line.trim().is_empty())
}

/// The fields of one line, without the spaces around them. A quote that is not closed ends with its line: a field of these tables has
/// no line break in it, and the rows that follow a stray quote must not be taken for its text.
fn fields_of(line: &str, separator: char) -> csv::StringRecord {
    if separator == ' ' {
        return line.split_whitespace().collect();
    }
    if !line.contains('"') {
        return line.split(separator).map(str::trim).collect();
    }
    let mut builder = csv::ReaderBuilder::new();
    // Each separator is one byte.
    let delimiter = u8::try_from(separator).unwrap_or(b',');
    builder.has_headers(false).flexible(true).trim(csv::Trim::All).delimiter(delimiter);
    // Any text is a record.
    builder.from_reader(line.as_bytes()).into_records().next().and_then(std::result::Result::ok).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> (Vec<String>, Vec<(u64, Vec<String>)>) {
        let text = text_of(Path::new("a.csv"), bytes).unwrap();
        let sheet = Sheet::of(&text, &["index", "x_mm"]);
        let rows = sheet.rows().map(|(line, row)| (line, row.iter().map(str::to_owned).collect())).collect();
        (sheet.header.clone(), rows)
    }

    #[test]
    fn one_table_is_read_alike_however_it_is_written() {
        let plain = read(b"index,x_mm\n0,1.5\n1,2.5\n").1.into_iter().map(|(_, row)| row).collect::<Vec<_>>();
        let utf_16 = |text: &str, order: fn(u16) -> [u8; 2]| text.encode_utf16().flat_map(order).collect::<Vec<u8>>();
        let table = "index;x_mm\r\n0;1.5\r\n1;2.5\r\n";
        for bytes in [
            utf_16(&format!("\u{feff}{table}"), u16::to_le_bytes),
            utf_16(&format!("\u{feff}{table}"), u16::to_be_bytes),
            utf_16(table, u16::to_le_bytes),
            utf_16(table, u16::to_be_bytes),
            b"\xef\xbb\xbfindex\tx_mm\n0\t1.5\n1\t2.5".to_vec(),
            b"sep=|\nindex|x_mm\n0|1.5\n1|2.5\n".to_vec(),
            b"# made by a logger\n# index x_mm\n0 1.5\n  1   2.5\n".to_vec(),
            b"# a comment, with a comma\nindex,x_mm\n# another\n[-],[mm]\n0,1.5\n1,2.5\n".to_vec(),
            b"\"index\";\"x_mm\"\n\"0\";\"1.5\"\n1;2.5\n".to_vec(),
            b"Recorder 7, serial 12\nRate [Hz]\t100\n\nindex\tx_mm\n0\t1.5\n1\t2.5\n".to_vec(),
        ] {
            let (header, rows) = read(&bytes);
            assert_eq!(header, ["index", "x_mm"], "{}", String::from_utf8_lossy(&bytes));
            assert_eq!(rows.into_iter().map(|(_, row)| row).collect::<Vec<_>>(), plain);
        }
    }

    #[test]
    fn a_row_of_words_is_one_of_units_only_where_it_names_some() {
        assert_eq!(read(b"index,x_mm\nnone,mm\n0,1\n").1.len(), 1);
        assert_eq!(read(b"index,x_mm\nzero,one\n0,1\n").1.len(), 2);
        assert_eq!(unit_of("[ms]"), Some(Unit::Seconds(1e-3)));
    }

    #[test]
    fn letters_of_latin_1_cost_nothing() {
        assert_eq!(read(b"index,x_mm,note\n0,1,\xb5m\n").1[0].1, ["0", "1", "\u{b5}m"]);
    }

    #[test]
    fn another_kind_of_file_is_named() {
        let said = text_of(Path::new("log.csv"), b"PK\x03\x04\x14\0").unwrap_err().to_string();
        assert!(
            said.contains("log.csv: a zip archive, such as an Excel workbook") && said.contains("export it as CSV"),
            "{said}"
        );
    }
}
