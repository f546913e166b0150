//! A file that was cut in the middle of its last line: by a full disk, a pulled plug, a copy that broke off.

/// Rows before the last by which its last number is judged. Convention: fewer may have as many digits by chance.
const LEAST_ROWS: usize = 5;

/// Whether a text ends without a line end, within a number: its last number has fewer decimals than that of every other row, and they all have as
/// many. Where programs leave zeros out at the end, nothing tells.
pub(super) fn is_cut_in_a_number(text: &str) -> bool {
    if text.ends_with(['\n', '\r']) {
        return false;
    }
    let mut rows = text.split(['\n', '\r']).filter(|line| !line.trim().is_empty()).rev().map(decimals);
    let Some(Some(last)) = rows.next() else { return false };
    let before: Vec<Option<usize>> = rows.take(LEAST_ROWS).collect();
    let Some(&Some(usual)) = before.first() else { return false };
    before.len() == LEAST_ROWS && before.iter().all(|decimals| *decimals == Some(usual)) && last < usual
}

/// Digits behind the decimal point of a line's last number; 0 without a point, `None` where the line ends in something else.
fn decimals(line: &str) -> Option<usize> {
    let number = line.trim_end().rsplit([',', ';', '\t', ' ']).next()?;
    let (whole, fraction) = number.split_once('.').unwrap_or((number, ""));
    let is_number = whole.trim_start_matches(['-', '+']).chars().chain(fraction.chars()).all(|c| c.is_ascii_digit());
    (is_number && !number.is_empty()).then_some(fraction.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_that_was_cut_is_told_from_a_missing_line_end() {
        let rows: String = (0..9).map(|k| format!("{k},0.1,{k}.250000\n")).collect();
        for (last, is_cut) in [
            ("9,0.1,1.2", true),
            ("9,0.1,-", true),
            ("9,0.1,1", true),
            ("9,0.1,1.250000", false),
            ("9,0.1,1.2\n", false),
            ("9,0.1,\"", false),
            ("9,0.1,ok", false),
        ] {
            assert_eq!(is_cut_in_a_number(&format!("{rows}{last}")), is_cut, "{last}");
        }
        // Rows whose numbers have as many digits as they need.
        assert!(!is_cut_in_a_number("0,1.25\n1,1.2\n2,3\n3,1.75\n4,1.5\n5,2.25\n6,1"));
        assert!(!is_cut_in_a_number("") && !is_cut_in_a_number("q1_mm\n1.25\n1"));
    }
}
