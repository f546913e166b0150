//! Numbers as people read them on pages and in the terminal.

/// The most decimals that a number is given. Convention: a display choice.
const MOST_PLACES: f64 = 9.0;

/// A number with so many decimals: its sign is a minus (−), and zero has none.
pub fn decimal(value: f64, places: usize) -> String {
    let text = format!("{value:.places$}");
    match text.strip_prefix('-') {
        Some(size) if size.chars().all(|c| c == '0' || c == '.') => size.to_owned(),
        Some(size) => format!("−{size}"),
        None => text,
    }
}

/// A value with its standard deviation, which has two digits, as in `1.2208 ± 0.0013`. One that is known exactly has four decimals.
pub fn with_sd(value: f64, sd: f64) -> String {
    if !(sd > 0.0 && sd.is_finite()) {
        return decimal(value, 4);
    }
    // The power of ten of the first digit, once the number is rounded to two.
    let exponent: f64 = format!("{sd:.1e}").split('e').nth(1).and_then(|power| power.parse().ok()).unwrap_or(0.0);
    let places = (1.0 - exponent).clamp(0.0, MOST_PLACES) as usize;
    format!("{} ± {sd:.places$}", decimal(value, places))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_has_no_sign_and_a_standard_deviation_two_digits() {
        assert_eq!(
            (decimal(-0.0004, 3), decimal(-1.25, 1), decimal(2.0, 0)),
            ("0.000".into(), "−1.2".into(), "2".into())
        );
        for (value, sd, text) in [
            (1.22076, 0.001253, "1.2208 ± 0.0013"),
            (-1e-5, 2e-6, "−0.0000100 ± 0.0000020"),
            (3.0, 0.0996, "3.00 ± 0.10"),
            (41.0, 120.0, "41 ± 120"),
            (1.0, 0.0, "1.0000"),
            (1.0, f64::NAN, "1.0000"),
        ] {
            assert_eq!(with_sd(value, sd), text);
        }
    }
}
