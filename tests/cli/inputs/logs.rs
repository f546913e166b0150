//! Encoder logs as loggers and spreadsheets write them.

use super::Expected::{Good, Same, Told};
use super::cameras::utf_16;
use super::trackers::ride;
use super::{case, hold};
use crate::program::{Sandbox, number};
use std::fs;

/// The log as `change` writes its text.
fn written(change: impl Fn(&str) -> String + 'static) -> impl Fn(&Sandbox) + 'static {
    move |sandbox| sandbox.write("lab/encoders.csv", &change(&sandbox.read("lab/encoders.csv")))
}

/// The log as bytes.
fn encoded(bytes: impl Fn(&str) -> Vec<u8> + 'static) -> impl Fn(&Sandbox) + 'static {
    move |sandbox| fs::write(sandbox.join("lab/encoders.csv"), bytes(&sandbox.read("lab/encoders.csv"))).unwrap()
}

/// Each field of the log's rows, by its place, as `change` writes it.
fn fields(change: impl Fn(usize, &str) -> String + 'static) -> impl Fn(&Sandbox) + 'static {
    written(move |text| {
        let row =
            |line: &str| line.split(',').enumerate().map(|(k, field)| change(k, field)).collect::<Vec<_>>().join(",");
        let (header, rows) = text.split_once('\n').unwrap();
        format!("{header}\n{}\n", rows.lines().map(row).collect::<Vec<_>>().join("\n"))
    })
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
    let semicolons = |text: &str| text.replace(',', ";").replace('.', ",");
    hold(
        ride,
        vec![
            case("UTF-16", encoded(utf_16), Same),
            case("UTF-8 with its mark", written(|text| format!("\u{feff}{text}")), Same),
            case("tabs", written(|text| text.replace(',', "\t")), Same),
            case(
                "a recorder's lines above the header",
                written(|text| format!("Recorder 7\nRate [Hz],100\n***End_of_Header***\n\n{text}")),
                Same,
            ),
            case("the minus sign of print", written(|text| text.replace(",-", ",\u{2212}")), Same),
            case(
                "plus signs",
                fields(|k, field| if k > 1 && !field.starts_with('-') { format!("+{field}") } else { field.into() }),
                Same,
            ),
            case(
                "frames by their files",
                fields(|k, field| if k == 0 { format!("frames/{field}.jpg") } else { field.into() }),
                Same,
            ),
            case(
                "an index with zeros",
                fields(|k, field| if k == 0 { format!("{field:0>6}") } else { field.into() }),
                Same,
            ),
            case(
                "an index with decimals",
                fields(|k, field| if k == 0 { format!("{field}.0") } else { field.into() }),
                Same,
            ),
            case(
                "dates of one zone",
                fields(|k, field| match k {
                    1 => {
                        let since_s = field.parse::<f64>().unwrap() - 1.7e9;
                        // 1.7e9 s are 2023-11-14 22:13:20.
                        let minutes = (since_s + 20.0).div_euclid(60.0);
                        format!("2023-11-14T22:{:02.0}:{:06.3}Z", 13.0 + minutes, since_s + 20.0 - 60.0 * minutes)
                    }
                    _ => field.into(),
                }),
                Same,
            ),
            case(
                "a column without a name, as pandas writes it",
                written(|text| {
                    text.lines()
                        .enumerate()
                        .map(|(k, line)| if k == 0 { format!(",{line}\n") } else { format!("{k},{line}\n") })
                        .collect()
                }),
                Same,
            ),
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
            case(
                "JSON",
                written(|_| "{\"index\": 0, \"time_s\": 0.1, \"q1_mm\": 0}\n".into()),
                Told(&["encoders.csv:1: JSON where the header should be"]),
            ),
            case(
                "no header",
                written(|text| text.split_once('\n').unwrap().1.to_owned()),
                Told(&["encoders.csv:1: a row of numbers where the header should be", "write index,time_s"]),
            ),
            case(
                "one column named twice",
                logged("index,time_s,a,b,c", "q = [\"a\", \"a\", \"c\"]", |f| {
                    format!("{},{},{},{},{}", f[0], f[1], f[2], f[3], f[4])
                }),
                Told(&["[log] q names the column \\\"a\\\" twice"]),
            ),
            case(
                "dates of another order",
                fields(|k, field| if k == 1 { format!("26.11.2026 12:00:{field}") } else { field.into() }),
                Told(&["or a date such as 2026-11-26"]),
            ),
            case(
                "exponents of Fortran",
                fields(|k, field| if k > 1 { format!("{field}D+00") } else { field.into() }),
                Told(&["q1_mm is", "D+00", "expected a number"]),
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
                Told(&["every index is there more than once with other values", "two logs are in one file"]),
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

#[test]
fn commands_on_tables_read_the_log_of_an_experiment_as_it_says() {
    let sandbox = Sandbox::new();
    sandbox.write_hidden_model();
    sandbox.simulate("lab", "--model hidden.toml");
    let turned = |line: &str| match line.split(',').collect::<Vec<_>>()[..] {
        ["index", ..] => "frame,t,m1,m2,m3\n".to_owned(),
        [index, time_s, q1, q2, q3] => {
            let [q1, q2, q3] = [q1, q2, q3].map(|q| q.parse::<f64>().unwrap() / 8.0);
            format!("{index},{time_s},{q1:.12},{q3:.12},{q2:.12}\n")
        }
        _ => panic!("{line}"),
    };
    sandbox.write("lab/run7.csv", &sandbox.read("lab/encoders.csv").lines().map(turned).collect::<String>());
    sandbox.write(
        "lab/experiment.toml",
        "encoders = \"run7.csv\"\n[log]\nindex = \"frame\"\ntime = \"t\"\nq = [\"m1\", \"m2\", \"m3\"]\nunit = \"rad\"\ndrum_radius_mm = 8.0\n\
         [wiring]\ncolumns = [1, 3, 2]\n[[tracker]]\nname = \"em\"\nposes = \"tip.csv\"\nstraight = 0\n",
    );
    let by = |log: &str| sandbox.json(&format!("estimate --measurements lab/measurements.csv --encoders {log} -o out"));
    let (table, folder) = (by("lab/encoders.csv"), by("lab"));
    assert_eq!(
        (&table["verdict"]["level"], &folder["verdict"]["level"]),
        (&"good".into(), &"good".into()),
        "{folder:#}"
    );
    assert!((number(&table, "eta") - number(&folder, "eta")).abs() < 1e-6);
    let judged = sandbox
        .json("evaluate --model out/model.toml --measurements lab/measurements.csv --encoders lab/experiment.toml");
    assert_eq!(judged["verdict"]["level"], "good", "{judged:#}");
    let said = sandbox.fail("estimate --measurements lab/measurements.csv --encoders lab/run7.csv -o out", 1);
    assert!(
        said.contains("write into experiment.toml, which commands take in place of the log as well: [log]"),
        "{said}"
    );
}
