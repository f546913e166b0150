//! The program as a user meets it: commands in, files and exit codes out.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn snakeloop(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_snakeloop")).args(arguments).output().unwrap()
}

/// Runs a command that must succeed and gives its standard output.
fn succeed(arguments: &[&str]) -> String {
    let output = snakeloop(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Runs a command that must fail with this exit code, and gives what it says about it.
fn fail(arguments: &[&str], exit_code: i32) -> String {
    let output = snakeloop(arguments);
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(exit_code), "{arguments:?}: {message}");
    assert!(output.stdout.is_empty());
    message
}

fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A folder with the encoders, truth and measurements of a robot with hidden η = 1.221, λ = 0.1765 mm.
fn simulated() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().to_owned();
    let model = path.join("hidden.toml");
    let estimate = "[estimate]\neta = 1.221\nsd_eta = 0.0\nlambda_mm = 0.1765\nsd_lambda_mm = 0.0\ncorrelation = 0.0\nsamples = 0\n";
    fs::write(&model, estimate).unwrap();
    succeed(&["simulate", "--model", text(&model), "--observe", "-o", text(&path)]);
    (folder, path)
}

#[test]
fn help_shows_an_example_and_wrong_usage_is_exit_code_2() {
    assert!(succeed(&["--help"]).contains("Example:\n  snakeloop run "));
    assert!(succeed(&["calibrate", "friction", "--help"]).contains("Example:"));
    assert!(fail(&["invert", "--theta-deg", "30"], 2).contains("--delta-deg"));
    assert!(fail(&["no-such-command"], 2).contains("no-such-command"));
}

#[test]
fn friction_is_table_ii() {
    let fit = json(&succeed(&["calibrate", "friction", "calib/friction.csv", "--json"]));
    let near = |key: &str, expected: f64, tolerance: f64| {
        let value = fit[key].as_f64().unwrap();
        assert!((value - expected).abs() <= tolerance, "{key}: {value}, expected {expected}");
    };
    near("mu", 0.1727, 0.00005);
    near("static_force_n", 1.921, 0.0005);
    near("static_force_n_at_g10", 1.959, 0.0005);
    let text = succeed(&["calibrate", "friction"]);
    assert!(text.contains("1.921 ± 0.130 N") && text.contains("1.959 ± 0.133 N"), "{text}");
}

#[test]
fn estimate_finds_the_hidden_model_and_evaluate_sees_it_explain_the_data() {
    let (_folder, path) = simulated();
    let (measurements, encoders) = (path.join("measurements.csv"), path.join("encoders.csv"));
    let out = path.join("out");
    let data = ["--measurements", text(&measurements), "--encoders", text(&encoders)];
    let estimate = [&["estimate"], &data[..], &["-o", text(&out), "--json"]].concat();
    let found = json(&succeed(&estimate));
    for (name, hidden) in [("eta", 1.221), ("lambda_mm", 0.1765)] {
        let (value, sd) = (found[name].as_f64().unwrap(), found[format!("sd_{name}")].as_f64().unwrap());
        assert!((value - hidden).abs() < 3.0 * sd, "{name} = {value} ± {sd}, hidden {hidden}");
    }
    let rows = fs::read_to_string(out.join("estimate.csv")).unwrap();
    assert_eq!(rows.lines().count(), 1 + 36, "one row a measurement");

    let model = out.join("model.toml");
    let evaluate = |more: &[&str]| json(&succeed(&[&["evaluate"], &data[..], more, &["--json"]].concat()));
    let truth = path.join("truth.csv");
    let learned = evaluate(&["--model", text(&model), "--truth", text(&truth)]);
    let naive = evaluate(&[]);
    let figure = |value: &serde_json::Value, key: &str| value[key].as_f64().unwrap();
    assert_eq!(learned["samples"], 36);
    assert!(figure(&learned, "rms_eps_mm") < 1.3 * figure(&learned, "noise_floor_mm"));
    assert!(figure(&learned, "rms_theta_deg") < 0.3 && figure(&naive, "rms_theta_deg") > 1.0);
    assert!(figure(&learned["accuracy"]["theta"], "rms_deg") < 0.25);
}

#[test]
fn invert_goes_both_ways() {
    let there = json(&succeed(&["invert", "--theta-deg", "40", "--delta-deg", "-100", "--json"]));
    let q = ["qc1_mm", "qc2_mm", "qc3_mm"].map(|name| there[name].to_string());
    let back = json(&succeed(&["invert", "--qc-mm", &q.join(","), "--json"]));
    assert!((back["theta_deg"].as_f64().unwrap() - 40.0).abs() < 1e-6);
    assert!((back["delta_deg"].as_f64().unwrap() + 100.0).abs() < 1e-6);
    assert!(fail(&["invert", "--theta-deg", "150", "--delta-deg", "0"], 1).contains("outside the workspace"));
    assert!(fail(&["invert", "--qc-mm", "1,2"], 2).contains("expected 3"));
}

#[test]
fn the_table_is_the_paper_model_on_the_grid_that_was_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path();
    succeed(&["table", "--theta-deg", "0:60:30", "--delta-deg=-90:90:90", "-o", text(out)]);
    let csv = fs::read_to_string(out.join("compensation.csv")).unwrap();
    // The golden file was written by this program; its figures were compared with Eq. 18 by the model's own tests.
    assert_eq!(csv, fs::read_to_string("tests/golden/compensation.csv").unwrap());
    let json = json(&fs::read_to_string(out.join("compensation.json")).unwrap());
    assert_eq!(json["rows"].as_array().unwrap().len(), 9);
    assert!(fail(&["table", "--theta-deg", "0:150:10", "-o", text(out)], 2).contains("0 to 120"));
    assert!(fail(&["table", "--theta-deg", "0:x:10", "-o", text(out)], 2).contains("start:stop:step"));
}

#[test]
fn one_bad_row_costs_one_measurement_and_is_named() {
    let (_folder, path) = simulated();
    let encoders = path.join("encoders.csv");
    let good = fs::read_to_string(&encoders).unwrap();
    let bad: Vec<String> = good
        .lines()
        .map(|line| if line.starts_with("7,") { "7,abc,NaN,,".to_owned() } else { line.to_owned() })
        .collect();
    fs::write(&encoders, bad.join("\n")).unwrap();
    let measurements = path.join("measurements.csv");
    let arguments =
        ["estimate", "--measurements", text(&measurements), "--encoders", text(&encoders), "-o", text(&path), "--json"];
    let output = snakeloop(&arguments);
    assert!(output.status.success());
    let warning = String::from_utf8(output.stderr).unwrap();
    assert!(warning.contains("encoders.csv:9: time_s is \"abc\", expected a number; row skipped"), "{warning}");
    let counts = json(&String::from_utf8(output.stdout).unwrap());
    assert_eq!((&counts["used"], &counts["skipped"]), (&35.into(), &1.into()));
    assert_eq!(counts["reasons"]["no_encoder_reading"], 1);
}

#[test]
fn quiet_says_nothing() {
    let (_folder, path) = simulated();
    let measurements = path.join("measurements.csv");
    let encoders = path.join("encoders.csv");
    let arguments = [
        "estimate",
        "--quiet",
        "--measurements",
        text(&measurements),
        "--encoders",
        text(&encoders),
        "-o",
        text(&path),
    ];
    assert_eq!(succeed(&arguments), "");
}

#[test]
fn rendered_frames_are_an_experiment() {
    let folder = tempfile::tempdir().unwrap();
    let (made, poses) = (folder.path().join("made"), folder.path().join("poses.csv"));
    fs::write(&poses, "index,theta_deg,delta_deg\n3,40,30\n").unwrap();
    succeed(&["render", "--poses", text(&poses), "-o", text(&made), "--quiet"]);
    for name in ["frames/00003.png", "straight.png", "camera.yaml", "scene.toml"] {
        assert!(made.join(name).is_file(), "{name}");
    }
    let experiment = snakeloop::record::Experiment::read(&made).unwrap();
    assert_eq!((experiment.views.len(), experiment.encoders), (1, None));
}

#[test]
fn reproduce_sets_the_papers_figures_beside_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let result = json(&succeed(&["reproduce", "-o", text(folder.path()), "--json"]));
    let mu = result["comparisons"].as_array().unwrap().iter().find(|c| c["quantity"] == "μ by least squares").unwrap();
    assert_eq!(mu["paper"], 0.1727);
    assert!((mu["ours"].as_f64().unwrap() - 0.1727).abs() < 5e-5);
    for name in ["report.html", "comparisons.csv", "figure_10.csv", "table_iii.csv", "equation_26.csv"] {
        assert!(folder.path().join(name).is_file(), "{name}");
    }
}

#[test]
fn estimate_follows_a_stem() {
    let (_folder, path) = simulated();
    let [measurements, encoders, out] = ["measurements.csv", "encoders.csv", "out"].map(|name| path.join(name));
    let data = ["--measurements", text(&measurements), "--encoders", text(&encoders), "-o", text(&out), "--json"];
    succeed(&[&["estimate"], &data[..]].concat());
    let model = out.join("model.toml");
    let stem = json(&succeed(&[&["estimate", "--stem", "--model", text(&model)], &data[..]].concat()));
    let (phi, sd) = (stem["phi_deg"].as_f64().unwrap(), stem["sd_phi_deg"].as_f64().unwrap());
    assert!((phi - 82.0).abs() < 3.0 * sd && sd < 20.0, "{phi} ± {sd}, the cone's is 82°");
    assert_eq!(fs::read_to_string(out.join("stem.csv")).unwrap().lines().count(), 1 + 36);
    assert!(fail(&[&["estimate", "--stem"], &data[..6]].concat(), 2).contains("--model"));
}

#[test]
fn force_finds_the_load_that_the_snake_carried() {
    let (_folder, path) = simulated();
    let [hidden, loaded, measurements, encoders] =
        ["hidden.toml", "loaded", "loaded/measurements.csv", "loaded/encoders.csv"].map(|name| path.join(name));
    let load = ["--effect", "tip_load:fx_n=0.3,fy_n=-0.2,fz_n=0.1"];
    succeed(&[&["simulate", "--model", text(&hidden), "--observe", "-o", text(&loaded)], &load[..]].concat());
    let data = ["--measurements", text(&measurements), "--encoders", text(&encoders), "-o", text(&loaded), "--json"];
    let found = json(&succeed(&[&["force", "--model", text(&hidden)], &data[..]].concat()));
    for (k, truth) in [0.3, -0.2, 0.1].into_iter().enumerate() {
        let (value, variance) = (found["force_n"][k].as_f64().unwrap(), found["covariance_n2"][k][k].as_f64().unwrap());
        assert!((value - truth).abs() < 4.0 * variance.sqrt() && variance.sqrt() < 0.2, "{found}");
    }
    assert_eq!(found["unseen"].as_array().unwrap().len(), 0);
    assert_eq!(fs::read_to_string(loaded.join("force.csv")).unwrap().lines().count(), 1 + 36);
    // A load that the table knows of changes what it commands.
    let angles = ["invert", "--theta-deg", "40", "--delta-deg", "10", "--json"];
    assert_ne!(succeed(&angles), succeed(&[&angles[..], &load[..]].concat()));
}

#[test]
fn the_table_shares_the_load_within_limits_and_speaks_c() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path();
    succeed(&["table", "--force-limits=-90,20", "--c-header", "-o", text(out)]);
    let csv = fs::read_to_string(out.join("compensation.csv")).unwrap();
    let mut reader = csv::Reader::from_reader(csv.as_bytes());
    let header = reader.headers().unwrap().clone();
    let column = |name: &str| header.iter().position(|column| column == name).unwrap();
    let columns = ["f1_n", "f2_n", "f3_n", "within_limits"].map(column);
    for row in reader.records() {
        let row = row.unwrap();
        let [a, b, c, within] = columns.map(|column| row[column].parse::<f64>().unwrap());
        assert!(within == 1.0 && [a, b, c].iter().all(|force| (-90.0..=20.0 + 1e-6).contains(force)), "{row:?}");
    }
    assert!(fs::read_to_string(out.join("compensation.h")).unwrap().contains("snakeloop_command"));
    assert!(fail(&["table", "--force-limits=20,-90", "-o", text(out)], 2).contains("largest pull"));
}

#[test]
fn shells_and_man_know_every_command() {
    for shell in ["bash", "zsh", "fish"] {
        let script = succeed(&["completions", shell]);
        assert!(script.contains("reproduce") && script.contains("grid-pitch"), "{shell}");
    }
    let folder = tempfile::tempdir().unwrap();
    succeed(&["manual", "-o", text(folder.path())]);
    for page in ["snakeloop.1", "snakeloop-run.1", "snakeloop-calibrate-rig.1"] {
        let page = fs::read_to_string(folder.path().join(page)).unwrap();
        assert!(page.contains(".TH") && page.contains("Example"), "{page}");
    }
}

#[test]
fn a_run_is_exported_as_a_recording() {
    let (_keep, folder) = simulated();
    let [measurements, encoders, recording] =
        ["measurements.csv", "encoders.csv", "run.mcap"].map(|name| folder.join(name));
    succeed(&["estimate", "--measurements", text(&measurements), "--encoders", text(&encoders), "-o", text(&folder)]);
    let recorded = json(&succeed(&["export", text(&folder), "-o", text(&recording), "--json"]));
    for (topic, table) in
        [("/measurement", &measurements), ("/encoders", &encoders), ("/estimate", &folder.join("estimate.csv"))]
    {
        let rows = fs::read_to_string(table).unwrap().lines().count() - 1;
        assert_eq!(recorded["messages"][topic], rows, "{topic}");
    }
    assert!(fs::read(&recording).unwrap().starts_with(b"\x89MCAP0"));
    assert!(
        fail(&["export", text(&folder.join("nowhere")), "-o", text(&recording)], 1)
            .contains("measurements.csv: cannot read")
    );
}
