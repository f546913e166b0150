use super::*;
use proptest::prelude::*;

#[derive(Debug, PartialEq)]
struct Reading(u64, f64);

impl Indexed for Reading {
    fn index(&self) -> u64 {
        self.0
    }
}

fn parse(text: &[u8]) -> Result<Checked<Reading>> {
    let path = Path::new("a.csv");
    let reading = |row: &Row| Ok(Reading(row.index("index")?, row.number("x_mm")?));
    let (numbered, mut warnings) = parsed_rows(path, text, &[], &["index", "x_mm"], |_| Ok(()), reading, |_| true)?;
    let rows = in_order_once(numbered, &mut warnings);
    checked(path, rows, warnings)
}

fn rows_and_warnings(text: &str) -> (Vec<(u64, f64)>, Vec<String>) {
    let checked = parse(text.as_bytes()).unwrap();
    (checked.rows.iter().map(|r| (r.0, r.1)).collect(), checked.warnings.iter().map(ToString::to_string).collect())
}

#[test]
fn columns_are_found_by_name_in_any_order_and_others_are_ignored() {
    let (rows, warnings) = rows_and_warnings("\u{feff}x_mm, note ,index\r\n1.5,hello, 3\r\n2.5,,4.0\r\n");
    assert_eq!(rows, [(3, 1.5), (4, 2.5)]);
    assert!(warnings.is_empty(), "{warnings:?}");
}

#[test]
fn a_bad_row_is_named_and_the_others_survive() {
    let (rows, warnings) = rows_and_warnings("index,x_mm\n0,1\n1,abc\n2,NaN\n3\n-4,1\n5,inf\n6,\n7,2\n");
    assert_eq!(rows, [(0, 1.0), (7, 2.0)]);
    assert_eq!(
        warnings,
        [
            "a.csv:3: x_mm is \"abc\", expected a number; row skipped",
            "a.csv:4: x_mm is \"NaN\", expected a number; row skipped",
            "a.csv:5: 1 fields, expected 2; row skipped",
            "a.csv:6: index is \"-4\", expected a whole number from 0 up; row skipped",
            "a.csv:7: x_mm is \"inf\", expected a number; row skipped",
            "a.csv:8: x_mm is empty, expected a number; row skipped",
        ]
    );
}

#[test]
fn of_faults_without_end_the_first_are_told_and_the_others_counted() {
    let text = format!("index,x_mm\n0,1\n{}", "7\n".repeat(50_000));
    let (rows, warnings) = rows_and_warnings(&text);
    assert_eq!((rows.len(), warnings.len()), (1, 1001));
    assert_eq!(warnings[999], "a.csv:1002: 1 fields, expected 2; row skipped");
    assert_eq!(warnings[1000], "a.csv:1002: and 49000 more rows with faults");
}

#[test]
fn text_that_is_not_utf8_costs_one_row() {
    let checked = parse(b"index,x_mm\n0,1\n1,\xff\xfe\n2,3\n").unwrap();
    assert_eq!(checked.rows, [Reading(0, 1.0), Reading(2, 3.0)]);
    assert_eq!(checked.warnings[0].line, Some(3));
}

#[test]
fn lines_are_counted_however_they_end() {
    for end in ["\n", "\r\n", "\r"] {
        let text = ["index,x_mm", "0,1", "", "1,abc", "2,3"].join(end);
        let (rows, warnings) = rows_and_warnings(&text);
        assert_eq!(rows, [(0, 1.0), (2, 3.0)]);
        assert_eq!(warnings, ["a.csv:4: x_mm is \"abc\", expected a number; row skipped"], "{end:?}");
    }
}

#[test]
fn a_stray_quote_costs_its_own_row() {
    let (rows, warnings) = rows_and_warnings("\"index\",x_mm\n0,1\n\"1,5\n\"2\", 3\n3,\"4\n4,5\n");
    assert_eq!(rows, [(0, 1.0), (2, 3.0), (3, 4.0), (4, 5.0)]);
    assert_eq!(warnings, ["a.csv:3: 1 fields, expected 2; row skipped"]);
}

#[test]
fn unsorted_rows_are_sorted() {
    let (rows, warnings) = rows_and_warnings("index,x_mm\n2,1\n0,2\n1,3\n");
    assert_eq!(rows, [(0, 2.0), (1, 3.0), (2, 1.0)]);
    assert_eq!(warnings, ["a.csv:3: index 0 follows 2; the rows were put in order of their index"]);
}

#[test]
fn a_repeated_row_counts_once_and_contradicting_rows_not_at_all() {
    let (rows, warnings) = rows_and_warnings("index,x_mm\n0,1\n0,1\n1,5\n2,7\n1,6\n");
    assert_eq!(rows, [(0, 1.0), (2, 7.0)]);
    assert_eq!(
        warnings,
        [
            "a.csv:3: index 0 repeats line 2; row skipped",
            "a.csv:6: index 1 follows 2; the rows were put in order of their index",
            "a.csv:6: index 1 is in line 4 with other values; neither row was used",
        ]
    );
}

#[test]
fn files_of_no_use_say_why() {
    let message = |text: &str| parse(text.as_bytes()).unwrap_err().to_string();
    assert_eq!(message(""), "a.csv: the file is empty, expected a header line index,x_mm");
    let missing = "a.csv:1: column x_mm is missing, expected index,x_mm; the header has index,y";
    assert_eq!(message("index,y\n0,1\n"), missing);
    assert_eq!(message("index,x_mm,x_mm\n0,1,1\n"), "a.csv:1: column x_mm is there twice; remove one");
    assert_eq!(message("index,x_mm\n"), "a.csv: no rows below the header; expected one a frame");
    assert!(message("index,x_mm\n0,a\n").contains("no usable row; the first fault, in line 2"));
}

proptest! {
    #[test]
    fn any_bytes_are_read_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        let _ = parse(&bytes);
    }

    #[test]
    fn any_text_below_a_good_header_is_read_or_refused(text in "([0-9a-z,;\"\\-.\n\r ]|NaN|inf){0,80}") {
        if let Ok(checked) = parse(format!("index,x_mm\n{text}").as_bytes()) {
            prop_assert!(checked.rows.windows(2).all(|pair| pair[0].0 < pair[1].0));
            prop_assert!(checked.rows.iter().all(|row| row.1.is_finite()));
        }
    }
}
