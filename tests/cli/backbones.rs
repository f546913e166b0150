//! Robots of more than three backbones, through the program: simulated, estimated, tabled, inverted, searched for effects.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

const ETA: f64 = 1.221;
const LAMBDA_MM: f64 = 0.1765;

fn run(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_snakeloop")).current_dir(folder).args(arguments).output().unwrap()
}

/// Runs a command that must succeed and gives what it prints with --json.
fn json(folder: &Path, arguments: &[&str]) -> serde_json::Value {
    let output = run(folder, &[arguments, &["--json"]].concat());
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Runs a command that must fail and gives what it says.
fn refused(folder: &Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    assert!(!output.status.success(), "{arguments:?}");
    String::from_utf8(output.stderr).unwrap()
}

/// A folder with robot.toml, of so many backbones, and hidden.toml, the same robot with its η and λ.
fn lab(backbones: usize) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let paper = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("calib/robot.toml")).unwrap();
    let robot = paper.replace("\nbackbones = 3 ", &format!("\nbackbones = {backbones} "));
    assert_eq!(robot == paper, backbones == 3);
    fs::write(folder.path().join("robot.toml"), &robot).unwrap();
    let estimate = format!(
        "\n[estimate]\neta = {ETA}\nsd_eta = 0.0\nlambda_mm = {LAMBDA_MM}\nsd_lambda_mm = 0.0\ncorrelation = 0.0\nsamples = 0\n"
    );
    fs::write(folder.path().join("hidden.toml"), robot + &estimate).unwrap();
    folder
}

fn header(path: &Path) -> String {
    fs::read_to_string(path).unwrap().lines().next().unwrap().to_owned()
}

#[test]
fn the_chain_from_simulation_to_table_holds_for_four_five_and_six() {
    for backbones in [4usize, 5, 6] {
        let lab = lab(backbones);
        let folder = lab.path();
        json(folder, &["simulate", "--model", "hidden.toml", "--observe", "-o", "data"]);
        let q = |name: &str| (1..=backbones).map(|i| format!("{name}{i}_mm")).collect::<Vec<_>>().join(",");
        assert_eq!(header(&folder.join("data/encoders.csv")), format!("index,time_s,{}", q("q")));

        let data = ["--measurements", "data/measurements.csv", "--encoders", "data/encoders.csv"];
        let found = json(folder, &[&["estimate", "--model", "robot.toml", "-o", "out"], &data[..]].concat());
        for (name, sd, truth) in [("eta", "sd_eta", ETA), ("lambda_mm", "sd_lambda_mm", LAMBDA_MM)] {
            let (value, sd) = (found[name].as_f64().unwrap(), found[sd].as_f64().unwrap());
            assert!((value - truth).abs() < 3.5 * sd && sd < 0.05, "{backbones}: {name} = {value} ± {sd}");
        }
        assert!(header(&folder.join("out/estimate.csv")).contains(&q("residual")));

        let gap = json(folder, &[&["evaluate", "--model", "out/model.toml"], &data[..]].concat());
        let (rms, floor) = (gap["rms_eps_mm"].as_f64().unwrap(), gap["noise_floor_mm"].as_f64().unwrap());
        assert!(rms < 1.3 * floor && rms > 0.6 * floor, "{backbones}: {rms} of {floor}");

        json(folder, &["table", "--model", "out/model.toml", "--c-header", "-o", "table"]);
        let columns = header(&folder.join("table/compensation.csv"));
        assert_eq!(columns, format!("theta_deg,delta_deg,{},{},{}", q("q"), q("qc"), q("sd_qc")));
        let c = fs::read_to_string(folder.join("table/compensation.h")).unwrap();
        assert!(c.contains(&format!("double q_mm[{backbones}]")), "{c}");

        let wanted = json(folder, &["invert", "--model", "out/model.toml", "--theta-deg", "50", "--delta-deg", "70"]);
        let qc: Vec<String> = (1..=backbones).map(|i| wanted[format!("qc{i}_mm")].to_string()).collect();
        let qc = format!("--qc-mm={}", qc.join(","));
        let reached = json(folder, &["invert", "--model", "out/model.toml", &qc]);
        assert!((reached["theta_deg"].as_f64().unwrap() - 50.0).abs() < 1e-4, "{reached}");
        assert!((reached["delta_deg"].as_f64().unwrap() - 70.0).abs() < 1e-4, "{reached}");
    }
}

#[test]
fn an_effect_on_a_robot_of_four_is_named() {
    for (effect, name) in [
        ("load_directed_backlash:play_mm=0.09", "load_directed_backlash"),
        ("actuator_scale:scale_1=0.03,scale_2=-0.02,scale_3=0.025,scale_4=-0.03", "actuator_scale"),
    ] {
        let lab = lab(4);
        let ride = ["--sweeps=0,80,160,-110", "--sweep-poses", "34", "--round-poses", "48", "--jitter", "1"];
        let simulate = ["simulate", "--model", "hidden.toml", "--effect", effect, "--observe", "-o", "data"];
        json(lab.path(), &[&simulate[..], &ride[..]].concat());
        let data = ["--measurements", "data/measurements.csv", "--encoders", "data/encoders.csv"];
        let found = json(lab.path(), &[&["discover", "--model", "robot.toml", "-o", "found"], &data[..]].concat());
        assert_eq!(found["verdict"], "named", "{found:#}");
        let effects = found["effects"].as_array().unwrap();
        assert_eq!((effects.len(), &effects[0]["name"]), (1, &name.into()), "{found:#}");
        for given in effect.split_once(':').unwrap().1.split(',') {
            let (parameter, value) = given.split_once('=').unwrap();
            let told = &effects[0]["parameters"][parameter];
            let off = told["value"].as_f64().unwrap() - value.parse::<f64>().unwrap();
            assert!(off.abs() < 4.0 * told["sd"].as_f64().unwrap(), "{parameter}: {told}");
        }
        let gap = &found["gap"];
        assert!(gap["after_mm"].as_f64().unwrap() < 1.2 * gap["noise_floor_mm"].as_f64().unwrap(), "{gap}");
    }
}

#[test]
fn what_does_not_fit_the_number_of_backbones_is_refused() {
    let lab = lab(4);
    let folder = lab.path();
    json(folder, &["simulate", "--model", "hidden.toml", "--observe", "-o", "four"]);
    json(folder, &["simulate", "--observe", "-o", "three"]);
    let estimate = |data: &str, model: &[&str]| {
        let [m, e] = ["measurements", "encoders"].map(|name| format!("{data}/{name}.csv"));
        refused(folder, &[&["estimate", "--measurements", &m, "--encoders", &e, "-o", "out"], model].concat())
    };
    let said = estimate("three", &["--model", "robot.toml"]);
    let expected = "three/encoders.csv:1: q1_mm to q3_mm, expected q1_mm to q4_mm: the robot has 4 backbones";
    assert!(said.contains(expected), "{said}");
    let said = estimate("four", &[]);
    assert!(said.contains("four/encoders.csv:1: q1_mm to q4_mm, expected q1_mm to q3_mm"), "{said}");
    let said = refused(folder, &["invert", "--model", "robot.toml", "--qc-mm=0.1,0.2,0.3"]);
    assert!(said.contains("--qc-mm: 3 numbers, expected 4"), "{said}");
    let said = refused(
        folder,
        &["table", "--effect", "actuator_offset:offset_1_mm=0.1,offset_2_mm=0.1,offset_3_mm=0.1", "-o", "t"],
    );
    assert!(said.contains("on a robot of 3 backbones it takes offset_1_mm, offset_2_mm"), "{said}");
    for (backbones, expected) in [("2", "robot.backbones = 2, expected 3 to 8"), ("300", "robot.toml:7: ")] {
        let robot = fs::read_to_string(folder.join("robot.toml")).unwrap();
        fs::write(folder.join("wrong.toml"), robot.replace("backbones = 4 ", &format!("backbones = {backbones} ")))
            .unwrap();
        let said = refused(folder, &["invert", "--model", "wrong.toml", "--theta-deg", "1", "--delta-deg", "0"]);
        assert!(said.contains(expected.trim_start_matches("robot.toml")), "{said}");
    }
}
