//! A gap that no effect explains: where it lives is said, and a smooth correction is learned where it helps.

use serde_json::Value;
use snakeloop::geometry::Configuration;
use snakeloop::record::{encoders_csv, read_encoders};
use snakeloop::robot::{Model, PerBackbone};
use std::path::Path;
use std::process::Command;

fn snakeloop(folder: &Path, arguments: &[&str]) -> Value {
    let output = Command::new(env!("CARGO_BIN_EXE_snakeloop")).current_dir(folder).args(arguments).output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// An experiment of 320 samples whose readings (time, q̃) no library knows.
fn experiment(folder: &Path, name: &str, seed: &str, change: impl Fn(f64, &mut PerBackbone)) {
    let planes = if seed == "1" { "--sweeps=0,80,160,-110" } else { "--sweeps=40,-60,120,-150" };
    let arguments = ["simulate", "--observe", planes, "--sweep-poses", "34", "--round-poses", "48", "--seed", seed];
    snakeloop(folder, &[&arguments[..], &["-o", name, "--json"]].concat());
    let path = folder.join(name).join("encoders.csv");
    let mut readings = read_encoders(&path, 3).unwrap().rows;
    for reading in &mut readings {
        change(reading.time_s, &mut reading.q_mm);
    }
    std::fs::write(path, encoders_csv(&readings, 3)).unwrap();
}

fn discover(folder: &Path, name: &str, out: &str) -> Value {
    let (measurements, encoders) = (format!("{name}/measurements.csv"), format!("{name}/encoders.csv"));
    let data = ["discover", "--measurements", &measurements, "--encoders", &encoders];
    snakeloop(folder, &[&data[..], &["--correction", "-o", out, "--json"]].concat())
}

#[test]
fn a_correction_learned_on_one_experiment_helps_on_another_in_every_command() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // One actuator pulls on the next.
    let pull = |_: f64, q: &mut PerBackbone| q[0] += 0.02 * q[1].abs().powi(3);
    experiment(folder, "one", "1", pull);
    experiment(folder, "two", "9", pull);
    let found = discover(folder, "one", "found");
    assert_eq!(found["verdict"], "unexplained", "{found:#}");
    assert_eq!(found["where"]["backbone"], 1, "{found:#}");
    assert_eq!(found["correction"]["kept"], true, "{found:#}");
    let model = std::fs::read_to_string(folder.join("found/model.toml")).unwrap();
    assert!(model.contains("name = \"learned_correction\"") && model.contains("backbone_1_x2_mm_per_rad2"), "{model}");
    let page = std::fs::read_to_string(folder.join("found/report.html")).unwrap();
    assert!(page.contains("Where the gap is") && page.contains("in backbone 1") && !page.contains("http"));

    // The same model without it.
    let plain = &model[..model.find("[[effect]]").unwrap()];
    std::fs::write(folder.join("plain.toml"), plain).unwrap();
    let gap = |model: &str| {
        let data = ["--measurements", "two/measurements.csv", "--encoders", "two/encoders.csv", "--json"];
        snakeloop(folder, &[&["evaluate", "--model", model], &data[..]].concat())["rms_eps_mm"].as_f64().unwrap()
    };
    let (before, after) = (gap("plain.toml"), gap("found/model.toml"));
    assert!(after < 0.5 * before, "{before} → {after} mm");

    // The table, against what leads there: the plain command and the pull that it causes.
    let error = |model: &str| {
        let grid = ["--theta-deg", "10:70:10", "--delta-deg=-180:180:20", "-o", "table", "--json"];
        snakeloop(folder, &[&["table", "--model", model], &grid[..]].concat());
        let mut squares = Vec::new();
        for [theta, delta, qc @ ..] in columns(&folder.join("table/compensation.csv")) {
            let mut truth = Model::default().command(Configuration::from_degrees(theta, delta));
            pull(0.0, &mut truth);
            squares.push((PerBackbone::from(qc) - truth).norm_squared());
        }
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    let (before, after) = (error("plain.toml"), error("found/model.toml"));
    assert!(after < 0.6 * before, "table: {before} → {after} mm");

    // Every command takes the model; a fit leaves the correction as it is.
    snakeloop(folder, &["simulate", "--model", "found/model.toml", "--observe", "-o", "three", "--json"]);
    let data = ["--measurements", "two/measurements.csv", "--encoders", "two/encoders.csv"];
    let with = ["--model", "found/model.toml", "-o"];
    snakeloop(folder, &[&["estimate"], &data[..], &with[..], &["estimated", "--json"]].concat());
    snakeloop(folder, &[&["discover"], &data[..], &with[..], &["again", "--json"]].concat());
    let again = std::fs::read_to_string(folder.join("again/model.toml")).unwrap();
    let effect = |model: &str| {
        model[model.find("learned_correction").unwrap()..].lines().take(20).map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(effect(&again), effect(&model));
}

/// θ, δ and q̃ of a table's rows.
fn columns(path: &Path) -> Vec<[f64; 5]> {
    let text = std::fs::read_to_string(path).unwrap();
    let mut rows = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let header = rows.next().unwrap();
    let at = ["theta_deg", "delta_deg", "qc1_mm", "qc2_mm", "qc3_mm"]
        .map(|name| header.iter().position(|column| *column == name).unwrap());
    rows.map(|row| at.map(|at| row[at].parse().unwrap())).collect()
}

#[test]
fn where_nothing_is_gained_it_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    experiment(folder, "hum", "1", |time_s, q| q[1] += 0.06 * (2.1 * time_s).sin());
    let found = discover(folder, "hum", "found");
    assert_eq!(found["verdict"], "unexplained", "{found:#}");
    assert_eq!(found["where"]["backbone"], 2, "{found:#}");
    assert_eq!(found["correction"]["kept"], false, "{found:#}");
    assert!(found["correction"]["words"].as_str().unwrap().contains("no correction was kept"), "{found:#}");
    assert!(!std::fs::read_to_string(folder.join("found/model.toml")).unwrap().contains("learned_correction"));
}

#[test]
fn a_slip_is_told_with_its_time() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    experiment(folder, "slip", "1", |time_s, q| *q = q.add_scalar(if time_s > 50.0 { 0.08 } else { 0.0 }));
    let found = discover(folder, "slip", "found");
    let gap = &found["where"];
    assert_eq!(gap["backbone"], "common", "{found:#}");
    let time_s = gap["step"]["time_s"].as_f64().unwrap();
    assert!((time_s - 50.0).abs() < 3.0, "{found:#}");
    assert!(gap["words"].as_str().unwrap().contains("with a step at about 50 s"), "{gap}");
}
