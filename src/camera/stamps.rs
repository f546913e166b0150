//! Times in the names of picture files: `frame_1738133057.457880.png`, `1738133057457880001.png`, `cam_20261126-023528-457.png`.

use crate::instant::days_since_1970;
use std::path::Path;

/// Unix times that a name may hold, s: from 2001 to 2128.
///
/// Convention: numbers of ten digits, with all that a camera's clock may show; a count of frames is smaller.
const UNIX_S: std::ops::Range<f64> = 1e9..5e9;

/// The time in a file's name.
#[derive(Debug, Clone, PartialEq)]
struct Stamp {
    /// Whole seconds.
    seconds: f64,
    /// The digits behind them.
    fraction: String,
    /// Whether fraction and seconds are one number of the name, with a point between them.
    is_decimal: bool,
}

/// The times, s, of files all of whose names hold one; and whether these times alone order them, since no whole number in the names does.
pub fn stamps_of(files: &[&Path]) -> Option<(Vec<f64>, bool)> {
    let stamps: Vec<Stamp> =
        files.iter().map(|path| stamp(&path.file_stem()?.to_string_lossy())).collect::<Option<_>>()?;
    let longest = stamps.iter().map(|stamp| stamp.fraction.len()).max()?;
    // A decimal fraction that lost its last digits lost zeros; a count of nano-, micro- or milliseconds lost its first.
    let is_count = |stamp: &Stamp| stamp.fraction.len() < longest && stamp.fraction.ends_with('0');
    let counts = stamps.iter().any(is_count).then(|| [3, 6, 9].into_iter().find(|digits| *digits >= longest)).flatten();
    let seconds = |stamp: &Stamp| {
        let digits = counts.unwrap_or(stamp.fraction.len());
        let fraction = stamp.fraction.parse::<f64>().unwrap_or(0.0) / 10f64.powi(digits as i32);
        stamp.seconds + fraction
    };
    Some((stamps.iter().map(seconds).collect(), stamps.iter().any(|stamp| stamp.is_decimal)))
}

fn stamp(name: &str) -> Option<Stamp> {
    unix_time(name).or_else(|| date_and_time(name))
}

/// A Unix time at the end of a name: seconds with a fraction behind a point or `_`, or one number of milli-, micro- or nanoseconds.
fn unix_time(name: &str) -> Option<Stamp> {
    let last = name.rfind(|c: char| !c.is_ascii_digit()).map_or(0, |at| at + 1);
    let (head, digits) = name.split_at(last);
    let seconds = |text: &str| text.parse::<f64>().ok().filter(|seconds| UNIX_S.contains(seconds));
    if matches!(digits.len(), 13 | 16 | 19) {
        let (whole, fraction) = digits.split_at(10);
        return Some(Stamp { seconds: seconds(whole)?, fraction: fraction.to_owned(), is_decimal: false });
    }
    let head = head.strip_suffix(['.', '_', '-'])?;
    let start = head.rfind(|c: char| !c.is_ascii_digit()).map_or(0, |at| at + 1);
    let is_fraction = (1..=9).contains(&digits.len());
    let seconds = seconds(&head[start..]).filter(|_| is_fraction && head.len() - start == 10)?;
    Some(Stamp { seconds, fraction: digits.to_owned(), is_decimal: true })
}

/// A date and a time of day at the end of a name, with anything but digits between their parts, and a fraction of a second behind.
fn date_and_time(name: &str) -> Option<Stamp> {
    /// Derived: of year, month, day, hours, minutes and seconds.
    const DIGITS: usize = 14;
    let start = name.find("20").or_else(|| name.find("19"))?;
    let mut digits = String::new();
    let mut rest = name[start..].chars();
    while digits.len() < DIGITS {
        let next = rest.next()?;
        match next {
            '0'..='9' => digits.push(next),
            '-' | '_' | '.' | ':' | 'T' | ' ' | 'h' | 'm' if digits.len() >= 4 && digits.len().is_multiple_of(2) => {}
            _ => return None,
        }
    }
    let fraction: String = rest.as_str().trim_start_matches(['.', '_', '-', ',', 's']).to_owned();
    let part = |range: std::ops::Range<usize>| digits[range].parse::<f64>().ok();
    let (hours, minutes, seconds) = (part(8..10)?, part(10..12)?, part(12..14)?);
    let is_time = hours < 24.0 && minutes < 60.0 && seconds < 61.0 && fraction.bytes().all(|b| b.is_ascii_digit());
    let day = days_since_1970(&digits[..8]).filter(|_| is_time && fraction.len() <= 9)?;
    let seconds = day * 86_400.0 + hours * 3_600.0 + minutes * 60.0 + seconds;
    Some(Stamp { seconds, fraction, is_decimal: false })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(names: &[&str]) -> Option<Vec<f64>> {
        let paths: Vec<&Path> = names.iter().map(|name| Path::new(*name)).collect();
        stamps_of(&paths).map(|(times, _)| times)
    }

    #[test]
    fn times_are_read_out_of_names() {
        for (name, time_s) in [
            ("frame_1738133057.457880.png", 1_738_133_057.457_88),
            ("img1738133057_25.jpg", 1_738_133_057.25),
            ("1738133057457.png", 1_738_133_057.457),
            ("1738133057457880001.png", 1_738_133_057.457_88),
            ("cam2_20261126-023528-457.tif", 1_795_660_528.457),
            ("2026-11-26T02-35-28.png", 1_795_660_528.0),
            ("IMG_20261126_023528.jpg", 1_795_660_528.0),
        ] {
            let found = times(&[name]).unwrap_or_else(|| panic!("{name}"));
            assert!((found[0] - time_s).abs() < 1e-6, "{name}: {found:?}");
        }
        for name in ["00012.png", "cam1.0012.png", "run2026_0001.png", "20261399_000000.png", "take20_3.png"] {
            assert_eq!(times(&[name]), None, "{name}");
        }
    }

    #[test]
    fn nanoseconds_without_their_zeros_are_told_from_fractions() {
        let found = times(&["f_1738133057.45788000.png", "f_1738133057.145788000.png"]).unwrap();
        assert!((found[0] - 1_738_133_057.045_788).abs() < 1e-6 && found[0] < found[1], "{found:?}");
        let found = times(&["f_1738133057.5.png", "f_1738133057.45.png"]).unwrap();
        assert!(found[1] < found[0], "{found:?}");
    }
}
