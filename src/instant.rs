//! Dates and times of day as programs write them into tables and names, as seconds.

/// Seconds of a day.
///
/// Derived: 24 hours.
const DAY_S: f64 = 86_400.0;
/// Seconds of an hour.
///
/// Derived: 60 minutes.
const HOUR_S: f64 = 3_600.0;
/// Seconds of a minute.
///
/// Derived: 60 seconds.
const MINUTE_S: f64 = 60.0;

/// The seconds that a text with a time of day tells: `HH:MM:SS` with a fraction, by itself from midnight on; behind a date `YYYY-MM-DD` (or with
/// `/` or nothing between) and a blank, `T` or `_` Unix time, in UTC unless an offset such as `Z` or `+02:00` follows; behind a number of days
/// (`0 days`, as pandas writes spans) from zero on. `None` for any other text, plain numbers among them.
pub fn seconds_of(text: &str) -> Option<f64> {
    let text = text.trim();
    if !text.is_ascii() || !text.contains(':') {
        return None;
    }
    let Some(date_ends) = text.find(['T', 't', ' ', '_']) else { return time_of_day_s(text) };
    let (day, rest) = (&text[..date_ends], text[date_ends + 1..].trim_start());
    if let Some(rest) = rest.strip_prefix("days").or(rest.strip_prefix("day")) {
        return Some(day.parse::<f64>().ok()? * DAY_S + time_of_day_s(rest.trim_start().trim_start_matches('+'))?);
    }
    let (time, offset_s) = without_offset(rest)?;
    Some(days_since_1970(day)? * DAY_S + time_of_day_s(time.trim_end())? - offset_s)
}

/// The time of day, and by how much its clock is ahead of UTC, s.
fn without_offset(text: &str) -> Option<(&str, f64)> {
    if let Some(time) = text.strip_suffix(['Z', 'z']).or(text.strip_suffix(" UTC")) {
        return Some((time, 0.0));
    }
    let Some(at) = text.rfind(['+', '-']) else { return Some((text, 0.0)) };
    let sign = if text[at..].starts_with('-') { -1.0 } else { 1.0 };
    let digits: String = text[at + 1..].chars().filter(|c| *c != ':').collect();
    let number: f64 = digits.parse().ok().filter(|_| digits.len() == 2 || digits.len() == 4)?;
    let (hours, minutes) = if digits.len() == 2 { (number, 0.0) } else { ((number / 100.0).floor(), number % 100.0) };
    Some((&text[..at], sign * (hours * HOUR_S + minutes * MINUTE_S)))
}

/// `HH:MM:SS` with a fraction, s.
fn time_of_day_s(text: &str) -> Option<f64> {
    let mut parts = text.split(':');
    let (hours, minutes, seconds) = (parts.next()?, parts.next()?, parts.next()?.replace(',', "."));
    let is_plain = |part: &str| !part.is_empty() && part.bytes().all(|b| b.is_ascii_digit() || b == b'.');
    if parts.next().is_some() || ![hours, minutes, &seconds].into_iter().all(is_plain) {
        return None;
    }
    let (hours, minutes, seconds): (f64, f64, f64) =
        (hours.parse().ok()?, minutes.parse().ok()?, seconds.parse().ok()?);
    (minutes < 60.0 && seconds < 61.0).then_some(hours * HOUR_S + minutes * MINUTE_S + seconds)
}

/// Days from 1970-01-01 to a date of the Gregorian calendar.
///
/// Source: H. Hinnant, "chrono-Compatible Low-Level Date Algorithms", `days_from_civil`.
pub fn days_since_1970(date: &str) -> Option<f64> {
    let digits: String = date.chars().filter(|c| !matches!(c, '-' | '/')).collect();
    if digits.len() != 8 || !digits.bytes().all(|b| b.is_ascii_digit()) {
        return None;
    }
    let part = |range: std::ops::Range<usize>| digits[range].parse::<i64>().ok();
    let (year, month, day) = (part(0..4)?, part(4..6)?, part(6..8)?);
    if !(1..=12).contains(&month) || !(1..=31).contains(&day) {
        return None;
    }
    let year = if month <= 2 { year - 1 } else { year };
    let (era, of_era) = (year.div_euclid(400), year.rem_euclid(400));
    let of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    let of_era = of_era * 365 + of_era / 4 - of_era / 100 + of_year;
    Some((era * 146_097 + of_era - 719_468) as f64)
}

/// A Unix time as date and time of day in UTC, such as `2026-11-26T02:35:28Z`.
///
/// Source: H. Hinnant, "chrono-Compatible Low-Level Date Algorithms", `civil_from_days`.
pub fn utc(unix_s: u64) -> String {
    let (days, of_day) = (unix_s / 86_400 + 719_468, unix_s % 86_400);
    let (era, of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (of_era - of_era / 1_460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let from_march = (5 * of_year + 2) / 153;
    let day = of_year - (153 * from_march + 2) / 5 + 1;
    let month = (from_march + 2) % 12 + 1;
    let year = year_of_era + 400 * era + u64::from(month <= 2);
    let (hour, minute, second) = (of_day / 3_600, of_day / 60 % 60, of_day % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}Z")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unix_time_is_a_date_and_back() {
        for (unix_s, date) in [
            (0, "1970-01-01T00:00:00Z"),
            (951_782_400, "2000-02-29T00:00:00Z"),
            (1_795_660_528, "2026-11-26T02:35:28Z"),
        ] {
            assert_eq!(utc(unix_s), date);
            assert_eq!(seconds_of(date), Some(unix_s as f64));
        }
    }

    #[test]
    fn dates_and_spans_are_seconds() {
        // The Unix times are those of `date -u -d … +%s.%N`.
        for (text, seconds) in [
            ("2026-11-26 02:35:28.123", 1_795_660_528.123),
            ("2026-11-26T02:35:28.123456789Z", 1_795_660_528.123_456_8),
            ("2026-11-26T04:35:28+02:00", 1_795_660_528.0),
            ("2026/11/26 02:35:28,5", 1_795_660_528.5),
            ("20261126_02:35:28", 1_795_660_528.0),
            ("1970-01-01 00:00:00", 0.0),
            ("2000-02-29 12:00:00-0530", 951_845_400.0),
            ("0 days 00:00:00.350000", 0.35),
            ("1 day 00:01:00", 86_460.0),
            ("23:59:59.5", 86_399.5),
        ] {
            let found = seconds_of(text).unwrap_or(f64::NAN);
            assert!((found - seconds).abs() < 1e-6, "{text}: {found}");
        }
        for text in ["", "12.5", "1e3", "12:30", "2026-11-26", "2026-13-01 00:00:00", "a:b:c", "10:61:00", "1:2:3:4"] {
            assert_eq!(seconds_of(text), None, "{text}");
        }
    }
}
