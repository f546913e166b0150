//! Files and lines read into memory, none larger than such a thing can be: what is larger is a mistake or an attack, and
//! must not take the machine's memory.

use crate::error::{Error, Result};
use std::borrow::Cow;
use std::fs::File;
use std::io::{BufRead, Read};
use std::path::Path;

/// The largest file of settings (TOML, YAML, XML), bytes. The program's own have some kilobytes.
///
/// Convention: a resource limit.
pub const SETTINGS_BYTES: u64 = 16 << 20;
/// The largest table (CSV), bytes: some ten million rows.
///
/// Convention: a resource limit.
pub const TABLE_BYTES: u64 = 1 << 30;
/// The largest file of a picture, bytes: a hundred megapixels of 16 bits, not compressed.
///
/// Convention: a resource limit.
pub const PICTURE_BYTES: u64 = 1 << 30;

/// The longest line of a file of rows that this program itself wrote, bytes.
///
/// Convention: a resource limit.
pub const LINE_BYTES: usize = 16 << 10;

/// The whole of a file.
///
/// # Errors
/// A file that cannot be read or has more than `most` bytes.
pub fn read_bytes(path: &Path, most: u64) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(Error::io(path, "read"))?;
    // Read and not asked for: a device or a pipe does not know its length.
    file.take(most + 1).read_to_end(&mut bytes).map_err(Error::io(path, "read"))?;
    if bytes.len() as u64 > most {
        let found = std::fs::metadata(path).map_or(0, |about| about.len()).max(most + 1);
        return Err(Error::content(
            path,
            format!("{found} bytes or more, expected at most {most}; is it the right file?"),
        ));
    }
    Ok(bytes)
}

/// The whole text of a file of settings.
///
/// # Errors
/// A file that cannot be read, has more than [`SETTINGS_BYTES`], or is not UTF-8; then with its line.
pub fn read_text(path: &Path) -> Result<String> {
    String::from_utf8(read_bytes(path, SETTINGS_BYTES)?).map_err(|e| {
        let whole = &e.as_bytes()[..e.utf8_error().valid_up_to()];
        let line = 1 + whole.iter().filter(|&&byte| byte == b'\n').count();
        Error::at_line(path, line as u64, "not UTF-8 text, as this file must be")
    })
}

/// The text of a file that other programs write: UTF-8, UTF-16 or, where it is neither, Latin-1; without its mark.
pub fn text_in(bytes: &[u8]) -> Cow<'_, str> {
    if let Some(text) = bytes.strip_prefix(b"\xff\xfe") {
        return utf_16(text, u16::from_le_bytes).into();
    }
    if let Some(text) = bytes.strip_prefix(b"\xfe\xff") {
        return utf_16(text, u16::from_be_bytes).into();
    }
    // UTF-16 without its mark: every other byte of a table's letters and digits is zero, and no text in one byte a letter has any.
    match bytes {
        [first, 0, second, 0, ..] if *first != 0 && *second != 0 => return utf_16(bytes, u16::from_le_bytes).into(),
        [0, first, 0, second, ..] if *first != 0 && *second != 0 => return utf_16(bytes, u16::from_be_bytes).into(),
        _ => {}
    }
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    // Latin-1 has the same letters under the same numbers as Unicode.
    std::str::from_utf8(bytes).map_or_else(|_| bytes.iter().map(|&byte| char::from(byte)).collect(), Cow::from)
}

fn utf_16(bytes: &[u8], unit: fn([u8; 2]) -> u16) -> String {
    let units: Vec<u16> = bytes.as_chunks().0.iter().map(|pair| unit(*pair)).collect();
    String::from_utf16_lossy(&units)
}

/// A line as [`read_line`] met it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LineRead {
    /// Its bytes, with the end of line and with those that were not kept.
    pub length: u64,
    /// Whether an end of line was there.
    pub ended: bool,
}

/// Reads a line into `line`, which keeps no more than its first `most` bytes; at the end a line of length 0.
///
/// # Errors
/// Those of the source.
pub fn read_line(from: &mut impl BufRead, most: usize, line: &mut Vec<u8>) -> std::io::Result<LineRead> {
    line.clear();
    let mut read = LineRead { length: 0, ended: false };
    while !read.ended {
        let available = match from.fill_buf() {
            Err(e) if e.kind() == std::io::ErrorKind::Interrupted => continue,
            available => available?,
        };
        if available.is_empty() {
            break;
        }
        let end = available.iter().position(|&byte| byte == b'\n');
        let taken = end.map_or(available.len(), |at| at + 1);
        line.extend_from_slice(&available[..taken.min(most - line.len())]);
        from.consume(taken);
        read = LineRead { length: read.length + taken as u64, ended: end.is_some() };
    }
    Ok(read)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_may_be_as_large_as_its_limit_and_no_larger() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        std::fs::write(&path, b"12345").unwrap();
        assert_eq!(read_bytes(&path, 5).unwrap(), b"12345");
        let message = read_bytes(&path, 4).unwrap_err().to_string();
        assert!(message.contains("a.csv: 5 bytes") && message.contains("at most 4"), "{message}");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn what_never_ends_is_refused() {
        let message = read_text(Path::new("/dev/zero")).unwrap_err().to_string();
        assert!(message.contains("16777217 bytes or more, expected at most 16777216"), "{message}");
    }

    #[test]
    fn text_that_is_none_is_named_by_its_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.toml");
        std::fs::write(&path, b"a = 1\nb = \"\xff\"\n").unwrap();
        assert!(read_text(&path).unwrap_err().to_string().contains("model.toml:2: not UTF-8"));
    }

    #[test]
    fn a_line_without_end_takes_no_more_memory_than_it_may() {
        let text = [&b"short\n"[..], &[b'x'; 100_000], b"\nlast"].concat();
        let (mut from, mut line) = (std::io::BufReader::with_capacity(64, &text[..]), Vec::with_capacity(16));
        let mut next = || {
            let read = read_line(&mut from, 10, &mut line).unwrap();
            (read.length, read.ended, line.clone())
        };
        assert_eq!(next(), (6, true, b"short\n".to_vec()));
        assert_eq!(next(), (100_001, true, vec![b'x'; 10]));
        assert_eq!(next(), (4, false, b"last".to_vec()));
        assert_eq!(next(), (0, false, Vec::new()));
    }
}
