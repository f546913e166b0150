//! Encoder logs as loggers and spreadsheets write them.

use super::Expected::{Good, Same, Told};
use super::trackers::ride;
use super::{case, hold};
use crate::program::Sandbox;
use std::fs;

/// The log as `change` writes its text.
fn written(change: impl Fn(&str) -> String + 'static) -> impl Fn(&Sandbox) + 'static {
    move |sandbox| sandbox.write("lab/encoders.csv", &change(&sandbox.read("lab/encoders.csv")))
}

/// The log as bytes.
fn encoded(bytes: impl Fn(&str) -> Vec<u8> + 'static) -> impl Fn(&Sandbox) + 'static {
    move |sandbox| fs::write(sandbox.join("lab/encoders.csv"), bytes(&sandbox.read("lab/encoders.csv"))).unwrap()
}

/// The log's rows, field by field, below another header; and `[log]` with these keys.
fn logged(
    header: &'static str,
    keys: &'static str,
    row: impl Fn(&[f64]) -> String + 'static,
) -> impl Fn(&Sandbox) + 'static {
    move |sandbox| {
        let table = sandbox.read("lab/encoders.csv");
        let numbers = |line: &str| line.split(',').map(|field| field.parse().unwrap()).collect::<Vec<f64>>();
        let rows: String = table.lines().skip(1).map(|line| row(&numbers(line)) + "\n").collect();
        sandbox.write("lab/encoders.csv", &format!("{header}\n{rows}"));
        let settings = sandbox.read("lab/experiment.toml");
        sandbox
            .write("lab/experiment.toml", &settings.replacen("[[tracker]]", &format!("[log]\n{keys}\n[[tracker]]"), 1));
    }
}

/// The times of every table in another unit.
fn in_unit(per_second: f64, digits: usize) -> impl Fn(&Sandbox) + 'static {
    move |sandbox| {
        for name in ["lab/encoders.csv", "lab/tip.csv"] {
            let row = |(k, line): (usize, &str)| {
                let fields: Vec<&str> = line.splitn(3, ',').collect();
                match k {
                    0 => format!("{line}\n"),
                    _ => format!(
                        "{},{:.digits$},{}\n",
                        fields[0],
                        fields[1].parse::<f64>().unwrap() * per_second,
                        fields[2]
                    ),
                }
            };
            let table: String = sandbox.read(name).lines().enumerate().map(row).collect();
            sandbox.write(name, &table);
        }
    }
}

#[test]
fn a_log_is_read_however_it_is_written() {
    let utf_16 = |text: &str| format!("\u{feff}{text}").encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>();
    let semicolons = |text: &str| text.replace(',', ";").replace('.', ",");
    hold(
        ride,
        vec![
            case("UTF-16", encoded(utf_16), Same),
            case("UTF-8 with its mark", written(|text| format!("\u{feff}{text}")), Same),
            case("tabs", written(|text| text.replace(',', "\t")), Same),
            case("blanks", written(|text| text.replace(',', "  ")), Same),
            case("semicolons and decimal commas", written(semicolons), Same),
            case("a line sep=;", written(move |text| format!("sep=;\n{}", semicolons(text))), Same),
            case(
                "lines of comment",
                written(|text| format!("# logger 2.1\n{}# end, of the run\n", text.replacen('\n', "\n# rows\n", 1))),
                Same,
            ),
            case("a header behind #, as NumPy writes it", written(|text| format!("# {text}")), Same),
            case("a row of units", written(|text| text.replacen('\n', "\n[-],[s],[mm],[mm],[mm]\n", 1)), Same),
            case("a comma after each row", written(|text| text.replace('\n', ",\n").replacen(",\n", "\n", 1)), Same),
            case("a comma after each line", written(|text| text.replace('\n', ",\n")), Same),
            case("Windows' ends of lines and blank lines", written(|text| text.replace('\n', "\r\n\r\n")), Same),
            case(
                "quotes",
                written(|text| text.lines().map(|line| format!("\"{}\"\n", line.replace(',', "\",\""))).collect()),
                Same,
            ),
            case(
                "Latin-1 in a column that nobody asked for",
                encoded(|text| {
                    let line = |line: &str| [line.as_bytes(), b",5 \xb5m\n"].concat();
                    text.lines().flat_map(line).collect()
                }),
                Same,
            ),
            case(
                "milliseconds in a column of that name",
                written(|text| {
                    let row = |line: &str| {
                        let fields: Vec<&str> = line.splitn(3, ',').collect();
                        match fields[1].parse::<f64>() {
                            Ok(time_s) => format!("{},{:.1},{}\n", fields[0], 1e3 * time_s, fields[2]),
                            Err(_) => format!("{}\n", line.replace("time_s", "time_ms")),
                        }
                    };
                    text.lines().map(row).collect()
                }),
                Same,
            ),
            case(
                "columns by their names",
                logged("t;frame;grip;a;b;c", "index = \"frame\"\ntime = \"t\"\nq = [\"a\", \"b\", \"c\"]", |f| {
                    format!("{};{};closed;{};{};{}", f[1], f[0], f[2], f[3], f[4])
                }),
                Same,
            ),
            case(
                "radians of a drum of 8 mm and milliseconds",
                logged(
                    "frame,timestamp_ms,m1,m2,m3",
                    "index = \"frame\"\ntime = \"timestamp_ms\"\ntime_unit = \"ms\"\nq = [\"m1\", \"m2\", \"m3\"]\nunit = \"rad\"\ndrum_radius_mm = 8.0",
                    |f| format!("{},{:.3},{:.12},{:.12},{:.12}", f[0], 1e3 * f[1], f[2] / 8.0, f[3] / 8.0, f[4] / 8.0),
                ),
                Good("48 of 48 frames and poses have a reading"),
            ),
            case(
                "metres",
                logged("index,time_s,q1,q2,q3", "q = [\"q1\", \"q2\", \"q3\"]\nunit = \"m\"", |f| {
                    format!("{},{},{:.12},{:.12},{:.12}", f[0], f[1], 1e-3 * f[2], 1e-3 * f[3], 1e-3 * f[4])
                }),
                Good("48 of 48 frames and poses have a reading"),
            ),
            case(
                "counts",
                logged(
                    "index,time_s,c1,c2,c3",
                    "q = [\"c1\", \"c2\", \"c3\"]\nunit = \"counts\"\ncounts_per_unit = 4000",
                    |f| format!("{},{},{:.0},{:.0},{:.0}", f[0], f[1], 4e3 * f[2], 4e3 * f[3], 4e3 * f[4]),
                ),
                Good("48 of 48 frames and poses have a reading"),
            ),
            case(
                "rows matched by time",
                logged("n,t,q1_mm,q2_mm,q3_mm", "time = \"t\"", |f| {
                    format!("{},{},{},{},{}", 1000.0 + f[0], f[1], f[2], f[3], f[4])
                }),
                Good("48 of 48 frames and poses have a reading"),
            ),
            case(
                "seconds that are said to be seconds",
                |sandbox: &Sandbox| {
                    in_unit(1e3, 1)(sandbox);
                    let settings = sandbox.read("lab/experiment.toml").replacen(
                        "[[tracker]]",
                        "[log]\ntime_unit = \"s\"\n[[tracker]]",
                        1,
                    );
                    sandbox.write("lab/experiment.toml", &settings);
                },
                Good("48 of 48 frames and poses have a reading"),
            ),
        ],
    );
}

#[test]
fn a_log_that_cannot_be_meant_is_told() {
    hold(
        ride,
        vec![
            case(
                "a workbook",
                encoded(|_| b"PK\x03\x04\x14\0\x06\0".to_vec()),
                Told(&["encoders.csv: a zip archive, such as an Excel workbook", "export it as CSV"]),
            ),
            case("nothing", written(|_| String::new()), Told(&["the file is empty"])),
            case(
                "a header alone",
                written(|text| text.lines().next().unwrap().to_owned()),
                Told(&["no rows below the header"]),
            ),
            case(
                "another header",
                written(|text| text.replacen("index,time_s,q1_mm,q2_mm,q3_mm", "frame,timestamp_ms,m1,m2,m3", 1)),
                Told(&["index = \\\"frame\\\"", "time_unit = \\\"ms\\\"", "m3"]),
            ),
            case(
                "a row of other units",
                written(|text| text.replacen('\n', "\n-,ms,mm,mm,mm\n", 1)),
                Told(&["encoders.csv:2", "time_s is in ms by this row of units", "[log]"]),
            ),
            case(
                "[log] with a column that is not there",
                logged("index,time_s,a,b,c", "q = [\"a\", \"b\", \"d\"]", |f| {
                    format!("{},{},{},{},{}", f[0], f[1], f[2], f[3], f[4])
                }),
                Told(&["[log] names the column \\\"d\\\"", "a, b, c"]),
            ),
            case(
                "radians of no drum",
                logged("index,time_s,q1_mm,q2_mm,q3_mm", "unit = \"rad\"", |f| {
                    format!("{},{},{},{},{}", f[0], f[1], f[2], f[3], f[4])
                }),
                Told(&["unit needs drum_radius_mm"]),
            ),
            case(
                "a unit that is none",
                logged("index,time_s,q1_mm,q2_mm,q3_mm", "unit = \"UNIT\"", |f| {
                    format!("{},{},{},{},{}", f[0], f[1], f[2], f[3], f[4])
                }),
                Told(&["unknown variant `UNIT`"]),
            ),
            case("milliseconds", in_unit(1e3, 1), Told(&["time_unit", "milliseconds", "time_unit = \\\"ms\\\""])),
            case("nanoseconds", in_unit(1e9, 0), Told(&["time_unit", "nanoseconds"])),
            case(
                "two rows of each index that differ",
                written(|text| {
                    let other: String = text
                        .lines()
                        .skip(1)
                        .map(|line| format!("{},0,0,0\n", line.splitn(3, ',').take(2).collect::<Vec<_>>().join(",")))
                        .collect();
                    format!("{text}{other}")
                }),
                Told(&["no usable row"]),
            ),
            case(
                "three indices twice with other values",
                written(|text| format!("{text}5,1.5,9,9,9\n6,1.6,9,9,9\n7,1.7,9,9,9\n")),
                Told(&["contradictory_readings", "index 5 is in line"]),
            ),
            case(
                "rows matched by another clock",
                logged("t,q1_mm,q2_mm,q3_mm", "time = \"t\"", |f| {
                    format!("{},{},{},{}", f[1] - 1.7e9, f[2], f[3], f[4])
                }),
                Told(&["nothing_to_judge", "they come from two clocks", "clock"]),
            ),
            case(
                "a log of other frames",
                written(|text| {
                    text.lines()
                        .enumerate()
                        .map(|(k, line)| if k == 0 { format!("{line}\n") } else { format!("9{line}\n") })
                        .collect()
                }),
                Told(&["nothing tells which way the base's x axis points"]),
            ),
        ],
    );
}
