//! From nothing to an experiment that is fit for a run: `new`, `check`, `print`.

use crate::faults::fixture::{render_short, render_short_seeded};
use crate::program::{Sandbox, all_said, json, number};
use std::fs;

#[test]
fn a_new_folder_is_an_experiment_that_check_says_is_empty() {
    let sandbox = Sandbox::new();
    let made = sandbox.json("new lab --grid-pitch 2 --backbones 4");
    assert_eq!(made["written"].as_array().unwrap().len(), 3);
    assert!(sandbox.read("lab/experiment.toml").contains("grid_pitch_mm = 2.0"));
    let output = sandbox.call("check lab --json");
    assert_eq!(output.status.code(), Some(1), "{}", all_said(&output));
    let found = json(&String::from_utf8(output.stdout).unwrap());
    let reasons = found["verdict"]["reasons"].as_array().unwrap();
    let texts: Vec<&str> = reasons.iter().map(|reason| reason["text"].as_str().unwrap()).collect();
    for missing in
        ["encoders.csv is not there", "camera.yaml is not there", "straight.jpg is not there", "frames/*.jpg"]
    {
        assert!(texts.iter().any(|text| text.contains(missing)), "{missing}: {texts:?}");
    }
    assert!(reasons.iter().all(|reason| reason["code"] == "files" && reason["remedy"].as_str().unwrap().len() > 20));
    assert!(sandbox.fail("new lab", 1).contains("exists already"));
}

/// What a run tells of how well it knows η and λ.
const KNOWN: [&str; 2] = ["sd_eta", "sd_lambda_mm"];

/// The sigmas of η and λ that a check expects, in units of those of a run.
fn expected_of_known(check: &serde_json::Value, run: &serde_json::Value) -> [f64; 2] {
    KNOWN.map(|name| number(&check["expected"], name) / number(run, name))
}

#[test]
fn check_predicts_what_a_run_will_know_and_names_what_does_not_fit() {
    let sandbox = Sandbox::new();
    render_short(&sandbox.join("bending"), 2);
    let run = sandbox.json("run bending -o out");
    let good = sandbox.json("check bending");
    assert_eq!(good["verdict"]["level"], run["verdict"]["level"], "{good:#} {:#}", run["verdict"]);
    // So few poses scatter by chance, and the run's sigmas heed how far.
    let mut ratios = vec![expected_of_known(&good, &run)];
    for seed in 2..=4 {
        render_short_seeded(&sandbox.join("again"), 2, seed);
        ratios.push(expected_of_known(&sandbox.json("check again"), &sandbox.json(&format!("run again -o out{seed}"))));
        fs::remove_dir_all(sandbox.join("again")).unwrap();
    }
    for (k, name) in KNOWN.iter().enumerate() {
        let mean_ln = ratios.iter().map(|ratio| ratio[k].ln()).sum::<f64>() / ratios.len() as f64;
        assert!((0.7..1.5).contains(&mean_ln.exp()), "{name}: {ratios:?} of the runs'");
    }

    // The pictures are small, which is told with its remedy, and is no reason of the verdict.
    let looks: Vec<&str> =
        good["looks"].as_array().unwrap().iter().map(|look| look["text"].as_str().unwrap()).collect();
    assert!(looks.iter().any(|text| text.contains("px long, σ of θ")), "{looks:?}");
    assert!(looks.iter().any(|text| text.contains("bring the camera nearer")), "{looks:?}");

    let log = sandbox.read("bending/encoders.csv");
    let swapped: String = log.replace("q1_mm,q2_mm", "q2_mm,q1_mm");
    sandbox.write("bending/encoders.csv", &swapped);
    assert_eq!(sandbox.json("check bending")["verdict"]["reasons"][0]["code"], "wiring");
    sandbox.write("bending/encoders.csv", &log);
    let text = sandbox.read("bending/experiment.toml").replace("frames/*.png", "frames/*.jpg");
    sandbox.write("bending/experiment.toml", &text);
    let output = sandbox.call("check bending");
    assert!(all_said(&output).contains("there are 8 files *.png"), "{}", all_said(&output));
}

#[test]
fn sheets_are_pdf_files() {
    let sandbox = Sandbox::new();
    for (line, file) in
        [("print grid --paper letter", "grid.pdf"), ("print chessboard --corners 7x5", "chessboard.pdf")]
    {
        assert_eq!(number(&sandbox.json(line), "ruler_mm"), 100.0);
        assert!(fs::read(sandbox.join(file)).unwrap().starts_with(b"%PDF-"), "{file}");
    }
    assert!(sandbox.fail("print grid --pitch 0.1", 2).contains("expected 0.5"));
}
