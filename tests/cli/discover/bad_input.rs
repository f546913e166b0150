//! Bad input to `discover`, through the program: used as far as it goes, what cannot be decided is said, and nothing gets a false
//! name.

use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn snakeloop(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_snakeloop")).current_dir(folder).args(arguments).output().unwrap()
}

/// An experiment with nothing hidden.
fn simulate(folder: &Path, more: &[&str]) {
    let output = snakeloop(folder, &[&["simulate", "--observe", "-o", ".", "--quiet"], more].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

const SWEEPS: [&str; 5] = ["--sweeps=0,80,160,-110", "--sweep-poses", "20", "--round-poses", "30"];

/// Rewrites a file's rows: the row's number and its fields by column.
fn rewrite(folder: &Path, file: &str, change: impl Fn(usize, &mut Vec<String>)) {
    let path = folder.join(file);
    let text = fs::read_to_string(&path).unwrap();
    let mut lines = text.lines().map(str::to_owned);
    let mut out = lines.next().unwrap() + "\n";
    for (k, line) in lines.enumerate() {
        let mut fields: Vec<String> = line.split(',').map(str::to_owned).collect();
        change(k, &mut fields);
        out += &(fields.join(",") + "\n");
    }
    fs::write(path, out).unwrap();
}

fn discover(folder: &Path) -> Output {
    let data = ["discover", "--measurements", "measurements.csv", "--encoders", "encoders.csv", "-o", "out"];
    snakeloop(folder, &[&data[..], &["--next", "--correction", "--json"]].concat())
}

/// What comes of it, and everything that was said.
fn answer(folder: &Path) -> (Value, String) {
    let output = discover(folder);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && !said.contains("panicked"), "{said}");
    assert!(fs::read_to_string(folder.join("out/report.html")).unwrap().ends_with("</html>\n"));
    (serde_json::from_slice(&output.stdout).unwrap(), said)
}

fn refusal(folder: &Path) -> String {
    let output = discover(folder);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(!said.contains("panicked"), "{said}");
    said
}

fn with_experiment(more: &[&str], check: impl FnOnce(&Path)) {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), more);
    check(folder.path());
}

#[test]
fn too_few_samples_or_no_motion_are_refused() {
    with_experiment(&["--sweep-poses", "4", "--round-poses", "4"], |folder| {
        assert!(refusal(folder).contains("20 usable samples, and 24"));
    });
    with_experiment(&SWEEPS, |folder| {
        rewrite(folder, "encoders.csv", |_, row| {
            row.splice(2.., ["0.1", "0.2", "0.3"].map(str::to_owned)).for_each(drop)
        });
        assert!(refusal(folder).contains("encoders hardly move"));
        rewrite(folder, "measurements.csv", |_, row| row[6] = "no_snake".into());
        assert!(refusal(folder).contains("measurements.csv") || refusal(folder).contains("0 usable samples"));
    });
}

#[test]
fn one_plane_and_small_bends_are_told_and_nothing_is_named() {
    with_experiment(&["--sweeps=30,30", "--sweep-poses", "40", "--round-poses", "0"], |folder| {
        let (found, said) = answer(folder);
        assert_eq!(found["verdict"], "none", "{found:#}");
        assert!(said.contains("one plane"), "{said}");
        assert!(found["next"]["because"].to_string().contains("one plane"), "{found:#}");
    });
    let small = ["--sweep-theta", "0,3", "--round-theta", "2", "--jitter", "0.2"];
    with_experiment(&[&SWEEPS[..], &small].concat(), |folder| {
        let (found, said) = answer(folder);
        assert_eq!(found["verdict"], "none", "{found:#}");
        assert!(said.contains("no bend is above"), "{said}");
    });
}

#[test]
fn a_stuck_encoder_or_camera_gets_no_false_name() {
    with_experiment(&SWEEPS, |folder| {
        rewrite(folder, "encoders.csv", |_, row| row[4] = "0.25".into());
        let (found, said) = answer(folder);
        assert_eq!(found["verdict"], "unexplained", "{found:#}");
        assert!(said.contains("q3_mm is the same"), "{said}");
    });
    with_experiment(&SWEEPS, |folder| {
        rewrite(folder, "measurements.csv", |_, row| (row[2], row[3]) = ("30".into(), "40".into()));
        assert_eq!(answer(folder).0["verdict"], "unexplained");
    });
}

#[test]
fn a_clock_that_fails_is_told_and_nothing_is_named() {
    type Clock = fn(usize, f64) -> f64;
    let clocks: [(Clock, &str); 3] = [
        (|k, t| if k > 100 { t + 5000.0 } else { t }, "time jumps by 5000"),
        (|k, t| if k % 3 == 1 { t.floor() } else { t.floor() + 0.2 }, "times do not rise"),
        (|k, t| if k > 100 { t - 40.0 } else { t }, "times do not rise"),
    ];
    for (clock, words) in clocks {
        with_experiment(&SWEEPS, |folder| {
            for file in ["encoders.csv", "measurements.csv"] {
                rewrite(folder, file, |k, row| row[1] = clock(k, row[1].parse().unwrap()).to_string());
            }
            let (found, said) = answer(folder);
            assert_eq!(found["verdict"], "none", "{words}: {found:#}");
            assert!(said.contains(words), "{said}");
        });
    }
}

#[test]
fn rows_with_a_status_or_without_numbers_are_passed_over() {
    with_experiment(&SWEEPS, |folder| {
        rewrite(folder, "measurements.csv", |k, row| match k % 10 {
            3 => {
                row[6] = "occluded".into();
                row[2..6].fill(String::new());
            }
            5 => row[2] = "NaN".into(),
            _ => {}
        });
        rewrite(folder, "encoders.csv", |k, row| {
            if k % 10 == 7 {
                row[3] = "inf".into();
            }
        });
        let (found, said) = answer(folder);
        assert_eq!(found["verdict"], "none", "{found:#}");
        assert_eq!(found["samples"], 190 * 7 / 10, "{found:#}");
        assert!(said.contains("theta_deg is \"NaN\"") && said.contains("q2_mm is \"inf\""), "{said}");
    });
}
