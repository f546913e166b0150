//! A gap that no effect explains: it is localised, and a law is proposed where it helps.

use crate::program::{Sandbox, data, json, number};
use serde_json::Value;
use snakeloop::geometry::Configuration;
use snakeloop::record::{encoders_csv, read_encoders, read_model, write_model};
use snakeloop::robot::{Model, PerBackbone};

/// An experiment of 320 samples whose readings are changed, given time and q̃, by what no effect of the library does.
fn experiment(sandbox: &Sandbox, name: &str, seed: u64, change: impl Fn(f64, &mut PerBackbone)) {
    let planes = if seed == 1 { "0,80,160,-110" } else { "40,-60,120,-150" };
    sandbox.simulate(name, &format!("--sweeps={planes} --sweep-poses 34 --round-poses 48 --seed {seed}"));
    let path = sandbox.join(name).join("encoders.csv");
    let mut readings = read_encoders(&path, 3).unwrap().rows;
    for reading in &mut readings {
        change(reading.time_s, &mut reading.q_mm);
    }
    std::fs::write(path, encoders_csv(&readings, 3)).unwrap();
}

/// discrepancy.json, and what is said of it.
fn discover(sandbox: &Sandbox, name: &str) -> (Value, String) {
    let said = sandbox.succeed(&format!("discover {} --correction -o found", data(name)));
    (json(&sandbox.read("found/discrepancy.json")), said)
}

#[test]
fn a_law_proposed_on_one_experiment_helps_on_another_in_every_command() {
    let sandbox = Sandbox::new();
    // One actuator pulls on the next.
    let pull = |_: f64, q: &mut PerBackbone| q[0] += 0.02 * q[1].abs().powi(3);
    experiment(&sandbox, "one", 1, pull);
    experiment(&sandbox, "two", 9, pull);
    let (found, said) = discover(&sandbox, "one");
    assert_eq!(found["verdict"], "unexplained", "{found:#}");
    assert_eq!(found["where"]["backbone"], 1, "{found:#}");
    assert!(said.contains("\nthe gap is in backbone 1 ("), "{said}");
    assert_eq!(found["correction"]["kept"], true, "{found:#}");
    let model = sandbox.read("found/model.toml");
    assert!(model.contains("name = \"proposed_law\"") && model.contains("on_1 * abs(q_2)^3"), "{model}");
    let page = sandbox.read("found/report.html");
    assert!(page.contains("Where the gap is") && page.contains("in backbone 1") && !page.contains("http"));

    // The same model without it.
    let plain = read_model(&sandbox.join("found/model.toml")).unwrap().plain();
    write_model(&sandbox.join("plain.toml"), &plain).unwrap();
    let gap = |model: &str| number(&sandbox.json(&format!("evaluate --model {model} {}", data("two"))), "rms_eps_mm");
    let (before, after) = (gap("plain.toml"), gap("found/model.toml"));
    assert!(after < 0.5 * before, "{before} → {after} mm");

    // The table, against what leads there: the plain command and the pull that it causes.
    let error = |model: &str| {
        sandbox.succeed(&format!("table --model {model} --theta-deg 10:70:10 --delta-deg=-180:180:20 -o table"));
        let mut squares = Vec::new();
        let text = sandbox.read("table/compensation.csv");
        // The law does not go beyond the bends that it was learned from, and the table says so.
        assert_eq!(text.contains("beyond_data"), model != "plain.toml");
        for [theta, delta, qc @ ..] in columns(&text) {
            let mut truth = Model::default().command(Configuration::from_degrees(theta, delta));
            pull(0.0, &mut truth);
            squares.push((PerBackbone::from(qc) - truth).norm_squared());
        }
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    let (before, after) = (error("plain.toml"), error("found/model.toml"));
    assert!(after < 0.5 * before, "table: {before} → {after} mm");

    // Every command takes the model; the law is found again as it is, but for the noise.
    sandbox.simulate("three", "--model found/model.toml");
    sandbox.succeed(&format!("estimate {} --model found/model.toml -o estimated", data("two")));
    sandbox.succeed(&format!("discover {} --model found/model.toml -o again", data("two")));
    let again = sandbox.read("again/model.toml");
    let formula = |model: &str| model.lines().find(|line| line.starts_with("formula")).unwrap().to_owned();
    assert_eq!(formula(&again), formula(&model));
}

/// θ, δ and q̃ of a table's rows.
fn columns(text: &str) -> Vec<[f64; 5]> {
    let mut rows = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let header = rows.next().unwrap();
    let at = ["theta_deg", "delta_deg", "qc1_mm", "qc2_mm", "qc3_mm"]
        .map(|name| header.iter().position(|column| *column == name).unwrap());
    rows.map(|row| at.map(|at| row[at].parse().unwrap())).collect()
}

#[test]
fn where_nothing_is_gained_it_is_said() {
    let sandbox = Sandbox::new();
    experiment(&sandbox, "hum", 1, |time_s, q| q[1] += 0.06 * (2.1 * time_s).sin());
    let (found, _) = discover(&sandbox, "hum");
    assert_eq!(found["verdict"], "unexplained", "{found:#}");
    assert_eq!(found["where"]["backbone"], 2, "{found:#}");
    assert_eq!(found["correction"]["kept"], false, "{found:#}");
    assert!(found["correction"]["words"].as_str().unwrap().contains("no law is proposed"), "{found:#}");
    assert!(!sandbox.read("found/model.toml").contains("proposed_law"));
}

#[test]
fn a_slip_is_told_with_its_time() {
    let sandbox = Sandbox::new();
    experiment(&sandbox, "slip", 1, |time_s, q| *q = q.add_scalar(if time_s > 50.0 { 0.08 } else { 0.0 }));
    let (found, _) = discover(&sandbox, "slip");
    let gap = &found["where"];
    assert_eq!(gap["backbone"], "common", "{found:#}");
    let time_s = gap["step"]["time_s"].as_f64().unwrap();
    assert!((time_s - 50.0).abs() < 3.0, "{found:#}");
    assert!(gap["words"].as_str().unwrap().contains("with a step at about 50 s"), "{gap}");
}
