//! Bad input to `discover`, through the program: what is usable is used, what cannot be decided is said, and no effect is named
//! that is not there.

use crate::program::{Sandbox, json};
use serde_json::Value;

const SWEEPS: &str = "--sweeps=0,80,160,-110 --sweep-poses 20 --round-poses 30";
/// Half as many poses of the same motion.
const SHORT: &str = "--sweeps=0,80,160,-110 --sweep-poses 10 --round-poses 15";

/// Rewrites a file's rows: the row's number and its fields by column.
fn rewrite(sandbox: &Sandbox, file: &str, change: impl Fn(usize, &mut Vec<String>)) {
    let text = sandbox.read(file);
    let mut lines = text.lines().map(str::to_owned);
    let mut out = lines.next().unwrap() + "\n";
    for (k, line) in lines.enumerate() {
        let mut fields: Vec<String> = line.split(',').map(str::to_owned).collect();
        change(k, &mut fields);
        out += &(fields.join(",") + "\n");
    }
    sandbox.write(file, &out);
}

const DISCOVER: &str =
    "discover --measurements measurements.csv --encoders encoders.csv -o out --next --correction --json";

/// What comes of it, and what is said besides.
fn answer(sandbox: &Sandbox) -> (Value, String) {
    let output = sandbox.call(DISCOVER);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && !said.contains("panicked"), "{said}");
    assert!(sandbox.read("out/report.html").trim_end().ends_with("</html>"));
    (json(&String::from_utf8(output.stdout).unwrap()), said)
}

fn refusal(sandbox: &Sandbox) -> String {
    sandbox.fail(DISCOVER, 1)
}

/// An experiment with nothing hidden, and what is checked of it.
fn with_experiment(more: &str, check: impl FnOnce(&Sandbox)) {
    let sandbox = Sandbox::new();
    sandbox.simulate(".", more);
    check(&sandbox);
}

#[test]
fn twenty_samples_are_searched_as_all_others_and_five_are_refused() {
    with_experiment("--sweep-poses 4 --round-poses 4", |sandbox| {
        let (found, _) = answer(sandbox);
        assert_eq!((&found["verdict"], &found["samples"]), (&json("\"none\""), &json("20")), "{found:#}");
        // The plant is the starting model itself, so that η is 1, and what is left is the noise of 20 samples.
        let number = |value: &Value| value.as_f64().unwrap();
        assert!((0.99..1.01).contains(&number(&found["eta"])), "{found:#}");
        let gap = &found["gap"];
        assert!((0.6..1.5).contains(&(number(&gap["after_mm"]) / number(&gap["noise_floor_mm"]))), "{found:#}");
        assert!(sandbox.read("out/model.toml").contains("[estimate]"));
        // What to measure next is proposed from few samples as well, within what is asked.
        let bounded =
            sandbox.json("discover --measurements measurements.csv --encoders encoders.csv -o next --next --poses 16");
        assert!(bounded["next"]["poses"].as_u64().is_some_and(|poses| poses <= 16), "{bounded:#}");
        // Five samples say nothing.
        rewrite(sandbox, "measurements.csv", |k, row| {
            if k >= 5 {
                row[6] = "no_snake".into();
            }
        });
        assert!(refusal(sandbox).contains("5 usable samples, and 10"));
    });
    // A gap is told, and no effect is named that is not there.
    with_experiment("--sweep-poses 4 --round-poses 4 --effect bend_offset:angle_deg=2", |sandbox| {
        let (found, _) = answer(sandbox);
        let named = found["effects"].as_array().unwrap().iter().all(|effect| effect["name"] == "bend_offset");
        assert!(found["verdict"] != "none" && named, "{found:#}");
    });
}

#[test]
fn no_motion_and_no_sample_are_refused() {
    with_experiment(SWEEPS, |sandbox| {
        rewrite(sandbox, "encoders.csv", |_, row| {
            row.splice(2.., ["0.1", "0.2", "0.3"].map(str::to_owned)).for_each(drop)
        });
        assert!(refusal(sandbox).contains("encoders hardly move"));
        rewrite(sandbox, "measurements.csv", |_, row| row[6] = "no_snake".into());
        assert!(refusal(sandbox).contains("measurements.csv") || refusal(sandbox).contains("0 usable samples"));
    });
}

#[test]
fn one_plane_and_small_bends_are_told_and_nothing_is_named() {
    with_experiment("--sweeps=30,30 --sweep-poses 40 --round-poses 0", |sandbox| {
        let (found, said) = answer(sandbox);
        assert_eq!(found["verdict"], "none", "{found:#}");
        assert!(said.contains("one plane"), "{said}");
        assert!(found["next"]["because"].to_string().contains("one plane"), "{found:#}");
    });
    let small = "--sweep-theta 0,3 --round-theta 2 --jitter 0.2";
    with_experiment(&format!("{SWEEPS} {small}"), |sandbox| {
        let (found, said) = answer(sandbox);
        assert_eq!(found["verdict"], "none", "{found:#}");
        assert!(said.contains("no bend is above"), "{said}");
    });
}

#[test]
fn one_measurement_that_is_far_off_is_told_beside_the_gap_that_it_makes() {
    with_experiment(SHORT, |sandbox| {
        rewrite(sandbox, "measurements.csv", |k, row| {
            if k == 30 {
                row[2] = (row[2].parse::<f64>().unwrap() + 30.0).to_string();
            }
        });
        let (found, _) = answer(sandbox);
        assert_eq!((&found["verdict"], &found["outliers"]), (&json("\"none\""), &json("[30]")), "{found:#}");
        let told = sandbox.succeed(&DISCOVER.replace(" --json", ""));
        assert!(told.contains("1 of 95 measurements contradict the others (the first is 30)"), "{told}");
        let gap = told.split("Without them the gap is ").nth(1).unwrap().split(' ').next().unwrap();
        assert!(gap.parse::<f64>().unwrap() < 0.02, "{told}");
    });
}

#[test]
fn a_stuck_encoder_or_camera_gets_no_false_name() {
    with_experiment(SHORT, |sandbox| {
        rewrite(sandbox, "encoders.csv", |_, row| row[4] = "0.25".into());
        let (found, said) = answer(sandbox);
        assert_eq!(found["verdict"], "unexplained", "{found:#}");
        assert!(said.contains("q3_mm is the same"), "{said}");
    });
    with_experiment(SHORT, |sandbox| {
        rewrite(sandbox, "measurements.csv", |_, row| (row[2], row[3]) = ("30".into(), "40".into()));
        assert_eq!(answer(sandbox).0["verdict"], "unexplained");
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
        with_experiment(SWEEPS, |sandbox| {
            for file in ["encoders.csv", "measurements.csv"] {
                rewrite(sandbox, file, |k, row| row[1] = clock(k, row[1].parse().unwrap()).to_string());
            }
            let (found, said) = answer(sandbox);
            assert_eq!(found["verdict"], "none", "{words}: {found:#}");
            assert!(said.contains(words), "{said}");
        });
    }
}

#[test]
fn rows_with_a_status_or_without_numbers_are_passed_over() {
    with_experiment(SWEEPS, |sandbox| {
        rewrite(sandbox, "measurements.csv", |k, row| match k % 10 {
            3 => {
                row[6] = "occluded".into();
                row[2..6].fill(String::new());
            }
            5 => row[2] = "NaN".into(),
            _ => {}
        });
        rewrite(sandbox, "encoders.csv", |k, row| {
            if k % 10 == 7 {
                row[3] = "inf".into();
            }
        });
        let (found, said) = answer(sandbox);
        assert_eq!(found["verdict"], "none", "{found:#}");
        assert_eq!(found["samples"], 190 * 7 / 10, "{found:#}");
        assert!(said.contains("theta_deg is \"NaN\"") && said.contains("q2_mm is \"inf\""), "{said}");
    });
}
