//! `discover` from the outside: a hidden effect is named, added, obeyed, and not found again.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

fn snakeloop(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_snakeloop")).current_dir(folder).args(arguments).output().unwrap()
}

fn json(output: &Output) -> Value {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn simulate(folder: &Path, out: &str, seed: &str) {
    let arguments = ["simulate", "--observe", "--sweeps=0,80,160,-110", "--sweep-poses", "30", "--round-poses", "40"];
    let effect = ["--effect", "load_directed_backlash:play_mm=0.08", "--seed", seed, "-o", out, "--json"];
    json(&snakeloop(folder, &[&arguments[..], &effect[..]].concat()));
}

#[test]
fn the_hidden_effect_is_named_added_and_not_found_again() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    simulate(folder, "one", "1");
    simulate(folder, "two", "9");
    let data = |name: &str| [format!("{name}/measurements.csv"), format!("{name}/encoders.csv")];
    let discover = |name: &str, model: &[&str], out: &str| {
        let [measurements, encoders] = data(name);
        let arguments = ["discover", "--measurements", &measurements, "--encoders", &encoders, "-o", out, "--json"];
        json(&snakeloop(folder, &[&arguments[..], model].concat()))
    };

    let found = discover("one", &[], "found");
    assert_eq!(found["verdict"], "named", "{found:#}");
    assert_eq!(found["effects"][0]["name"], "load_directed_backlash");
    let play = &found["effects"][0]["parameters"]["play_mm"];
    let (value, sd) = (play["value"].as_f64().unwrap(), play["sd"].as_f64().unwrap());
    assert!((value - 0.08).abs() < 4.0 * sd && sd < 0.002 && play["unit"] == "mm", "{play}");
    let gap = |key: &str| found["gap"][key].as_f64().unwrap();
    assert!(gap("after_mm") < 1.15 * gap("noise_floor_mm") && gap("before_mm") > 2.0 * gap("noise_floor_mm"));
    assert_eq!(
        serde_json::from_slice::<Value>(&std::fs::read(folder.join("found/discrepancy.json")).unwrap()).unwrap(),
        found
    );
    assert!(std::fs::read_to_string(folder.join("found/report.html")).unwrap().contains("play in the actuators"));

    let again = discover("two", &["--model", "found/model.toml"], "again");
    assert_eq!(again["verdict"], "none", "{again:#}");
    let [measurements, encoders] = data("two");
    let evaluated =
        ["evaluate", "--model", "found/model.toml", "--measurements", &measurements, "--encoders", &encoders];
    let evaluated = json(&snakeloop(folder, &[&evaluated[..], &["--json"]].concat()));
    let ratio = evaluated["rms_eps_mm"].as_f64().unwrap() / evaluated["noise_floor_mm"].as_f64().unwrap();
    assert!(ratio < 1.15, "{evaluated:#}");
}

#[test]
fn what_cannot_be_decided_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    json(&snakeloop(
        folder,
        &["simulate", "--observe", "--sweep-poses", "3", "--round-poses", "0", "-o", "few", "--json"],
    ));
    let few = ["discover", "--measurements", "few/measurements.csv", "--encoders", "few/encoders.csv", "-o", "out"];
    let output = snakeloop(folder, &few);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("12 usable samples"), "{output:?}");
    let output = snakeloop(folder, &["simulate", "--effect", "gremlins:size=1", "-o", "out"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("load_directed_backlash"), "{output:?}");
}
