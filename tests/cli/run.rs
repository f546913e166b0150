//! The main job on pictures, from the command line to the report; and what bad input does to it.

use crate::program::{ETA, LAMBDA_MM, Sandbox, json, number};
use std::fs;

/// All frames of the bundled experiment.
const ALL: [u64; 17] = [0, 2, 4, 5, 8, 10, 13, 15, 17, 19, 21, 24, 26, 28, 30, 32, 34];

/// A folder with a copy of the bundled experiment that has these of its frames.
fn bending(frames: &[u64]) -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.copy_bending(frames);
    sandbox
}

/// The `status` of each row of a measurements.csv, by index.
fn statuses(sandbox: &Sandbox, name: &str) -> Vec<(u64, String)> {
    sandbox.measurements(name).into_iter().map(|row| (row.index, row.status.to_string())).collect()
}

#[test]
fn the_bundled_experiment_gives_its_hidden_parameters_back() {
    let sandbox = bending(&ALL);
    let summary = sandbox.json("run bending -o out");
    assert_eq!(summary["statuses"]["ok"], 17);
    assert_eq!(summary["verdict"]["level"], "good", "{summary:#}");
    for (name, truth, most_sd) in [("eta", ETA, 0.003), ("lambda_mm", LAMBDA_MM, 0.0015)] {
        let (value, sd) = (number(&summary, name), number(&summary, &format!("sd_{name}")));
        assert!((value - truth).abs() < 3.0 * sd && sd < most_sd, "{name} = {value} ± {sd}, truth {truth}");
    }

    // About three times the errors that the eye had when this was written: 0.008°, 0.019° and 0.057°.
    let score = sandbox.json("evaluate --measurements out/measurements.csv --truth bending/truth.csv");
    let figure = |angle: &str, name: &str| number(&score["accuracy"][angle], name);
    assert_eq!(score["accuracy"]["measured"], 17);
    assert!(figure("theta", "rms_deg") <= 0.025 && figure("theta", "worst_deg") <= 0.06, "{score}");
    assert!(figure("delta", "rms_deg") <= 0.17, "{score}");

    assert_eq!(sandbox.rows("out/estimate.csv"), 17);
    assert_eq!(sandbox.rows("out/compensation.csv"), 16 * 24, "to 75°, where the data end");
    assert!(json(&sandbox.read("out/compensation.json"))["model"]["estimate"]["eta"].is_f64());
    assert_eq!(fs::read_dir(sandbox.join("out/overlays")).unwrap().count(), 17);
    let report = sandbox.read("out/report.html");
    assert!(!report.contains("http") && report.matches("<svg").count() == 12 && report.matches("<img").count() == 20);
    // What the model was made from stands in both.
    let model: toml::Table = toml::from_str(&sandbox.read("out/model.toml")).unwrap();
    let inputs = model["provenance"]["inputs"].as_table().unwrap();
    assert!(
        ["bending/encoders.csv", "bending/straight.jpg", "measurements.csv"]
            .iter()
            .all(|name| inputs.contains_key(*name))
    );
    assert!(inputs.values().all(|sum| report.contains(sum.as_str().unwrap())), "{inputs}");
    assert!(report.contains("2026-11-26T02:35:28Z"), "the harness's date");
    sandbox.succeed("table --model out/model.toml -o table");
}

#[test]
fn bad_frames_have_their_rows_and_the_rest_of_the_run_survives() {
    let sandbox = bending(&[2, 5, 8, 17]);
    let frame = |name: &str| sandbox.join("bending/frames").join(name);
    let whole = fs::read(frame("00002.jpg")).unwrap();
    fs::write(frame("00003.jpg"), &whole[..whole.len() / 2]).unwrap();
    fs::write(frame("00004.jpg"), b"not a picture").unwrap();
    image::RgbImage::from_pixel(1280, 720, image::Rgb([180, 180, 178])).save(frame("00006.jpg")).unwrap();
    image::RgbImage::new(64, 48).save(frame("00007.jpg")).unwrap();

    let said = sandbox.succeed("run bending -o out");
    let found = statuses(&sandbox, "out/measurements.csv");
    let expected = [
        (2, "ok"),
        (3, "unreadable"),
        (4, "unreadable"),
        (5, "ok"),
        (6, "no_snake"),
        (7, "wrong_size"),
        (8, "ok"),
        (17, "ok"),
    ];
    assert_eq!(found, expected.map(|(index, status)| (index, status.to_owned())));
    assert!(said.contains("4 of 8") && said.contains("2 unreadable"), "{said}");
    assert!(sandbox.read("out/report.html").contains("<td>3 (side)</td><td>unreadable</td>"));
}

#[test]
fn measuring_needs_no_encoders_and_estimating_says_that_it_does() {
    let sandbox = bending(&[2]);
    let settings = sandbox.read("bending/experiment.toml");
    sandbox.write("bending/experiment.toml", &settings.replace("encoders = \"encoders.csv\"", ""));
    assert!(sandbox.fail("run bending -o out", 1).contains("encoders is missing"));
    sandbox.succeed("measure bending -o out --quiet");
    assert_eq!(statuses(&sandbox, "out/measurements.csv"), [(2, "ok".to_owned())]);
}

#[test]
fn input_that_cannot_work_is_refused_in_words() {
    let sandbox = bending(&[]);
    let run = || sandbox.fail("run bending -o out", 1);
    assert!(run().contains("no file here matches `frames/*.jpg`"));
    sandbox.copy_bending(&[2]);

    let good = sandbox.read("bending/camera.yaml");
    sandbox.write("bending/camera.yaml", &good.replace("1280", "640").replace("720", "360"));
    let message = run();
    assert!(message.contains("straight.jpg") && message.contains("1280×720"), "{message}");
    sandbox.write("bending/camera.yaml", &good);

    let message = run();
    assert!(message.contains("1 measurements give no estimate"), "{message}");
    assert!(!sandbox.join("out/model.toml").exists(), "a model without an estimate must not pass for one");
    let report = sandbox.read("out/report.html");
    assert!(report.contains("verdict") && report.contains("none: η and λ are not known"), "the report says why");
    assert!(sandbox.fail("run nowhere -o elsewhere", 1).contains("nowhere: cannot read"));
    assert!(!sandbox.join("elsewhere/report.html").exists());
}

#[test]
fn a_frame_is_explained_stage_by_stage() {
    let sandbox = bending(&[4, 5]);
    image::RgbImage::new(640, 360).save(sandbox.join("bending/frames/00005.jpg")).unwrap();
    let explain = |frame: u64| sandbox.json(&format!("measure bending -o out --explain {frame}"));
    let files = |folder: &str| {
        let entries = fs::read_dir(sandbox.join(folder)).unwrap();
        let mut files: Vec<_> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        files.sort();
        files
    };

    let said = explain(4);
    assert_eq!(said[0]["status"], "ok");
    let stages = ["1-frame.png", "2-discriminant.png", "3-grid.png", "4-search.png", "5-edges.png", "6-model.png"];
    assert_eq!(files("out/explain-00004-side")[..6], stages);
    let page = sandbox.read(said[0]["page"].as_str().unwrap());
    assert!(stages.iter().all(|stage| page.contains(stage)) && page.contains("share of the outline"), "{page}");

    // A picture in which nothing is found has the stages before that.
    assert_eq!(explain(5)[0]["status"], "wrong_size");
    assert!(!files("out/explain-00005-side").contains(&"5-edges.png".to_owned()));
    assert!(!sandbox.join("out/measurements.csv").exists());

    let message = sandbox.fail("measure bending -o out --explain 9", 1);
    assert!(message.contains("no view has a frame 9"), "{message}");
}
