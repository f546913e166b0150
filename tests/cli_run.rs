//! The main job on real frames, from the command line to the report; and what bad input does to it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::Duration;

const BENDING: &str = "fixtures/bending";

fn snakeloop(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_snakeloop")).args(arguments).output().unwrap()
}

fn succeed(arguments: &[&str]) -> String {
    let output = snakeloop(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn fail(arguments: &[&str]) -> String {
    let output = snakeloop(arguments);
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {message}");
    message
}

fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A copy of the bundled experiment with these frames only.
fn copy_of_bending(frames: &[u64]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join("bending");
    fs::create_dir_all(copy.join("frames")).unwrap();
    let names = ["experiment.toml", "camera.yaml", "encoders.csv", "straight.jpg"].map(str::to_owned);
    for name in names.into_iter().chain(frames.iter().map(|index| format!("frames/{index:05}.jpg"))) {
        fs::copy(Path::new(BENDING).join(&name), copy.join(&name)).unwrap();
    }
    (folder, copy)
}

/// The `status` of each row of a measurements.csv, by index.
fn statuses(path: &Path) -> Vec<(u64, String)> {
    let table = snakeloop::record::read_measurements(path).unwrap();
    assert!(table.warnings.is_empty());
    table.rows.into_iter().map(|row| (row.index, row.status.to_string())).collect()
}

#[test]
fn the_bundled_experiment_gives_its_hidden_parameters_back() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path();
    let summary = json(&succeed(&["run", BENDING, "-o", text(out), "--json"]));
    assert_eq!(summary["statuses"]["ok"], 17);
    for (name, truth, tolerance) in [("eta", 1.221, 0.03 * 1.221), ("lambda_mm", 0.1765, 0.01)] {
        let (value, sd) = (summary[name].as_f64().unwrap(), summary[format!("sd_{name}")].as_f64().unwrap());
        assert!((value - truth).abs() < tolerance, "{name} = {value}, truth {truth}");
        assert!((value - truth).abs() < 3.0 * sd, "{name} = {value} ± {sd}, truth {truth}");
    }

    let measurements = out.join("measurements.csv");
    let truth = format!("{BENDING}/truth.csv");
    let score = json(&succeed(&["evaluate", "--measurements", text(&measurements), "--truth", &truth, "--json"]));
    let figure = |angle: &str, name: &str| score["accuracy"][angle][name].as_f64().unwrap();
    assert_eq!(score["accuracy"]["measured"], 17);
    assert!(figure("theta", "rms_deg") <= 0.5 && figure("theta", "worst_deg") <= 1.5, "{score}");
    assert!(figure("delta", "rms_deg") <= 3.0, "{score}");

    assert_eq!(fs::read_to_string(out.join("estimate.csv")).unwrap().lines().count(), 1 + 17);
    assert!(fs::read_to_string(out.join("compensation.csv")).unwrap().lines().count() > 100);
    assert!(json(&fs::read_to_string(out.join("compensation.json")).unwrap())["model"]["estimate"]["eta"].is_f64());
    assert_eq!(fs::read_dir(out.join("overlays")).unwrap().count(), 17);
    let report = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(!report.contains("http") && report.matches("<svg").count() == 5 && report.matches("<img").count() == 17);
    let model = out.join("model.toml");
    succeed(&["table", "--model", text(&model), "-o", text(out)]);
}

#[test]
fn bad_frames_have_their_rows_and_the_rest_of_the_run_survives() {
    let (_folder, experiment) = copy_of_bending(&[2, 5, 8, 17]);
    let frames = experiment.join("frames");
    let whole = fs::read(frames.join("00002.jpg")).unwrap();
    fs::write(frames.join("00003.jpg"), &whole[..whole.len() / 2]).unwrap();
    fs::write(frames.join("00004.jpg"), b"not a picture").unwrap();
    let paper = image::RgbImage::from_pixel(1280, 720, image::Rgb([180, 180, 178]));
    paper.save(frames.join("00006.jpg")).unwrap();
    image::RgbImage::new(64, 48).save(frames.join("00007.jpg")).unwrap();

    let out = experiment.join("out");
    let said = succeed(&["run", text(&experiment), "-o", text(&out)]);
    let expected =
        [(2, "ok"), (3, "unreadable"), (4, "unreadable"), (5, "ok"), (7, "wrong_size"), (8, "ok"), (17, "ok")];
    let found = statuses(&out.join("measurements.csv"));
    for (index, status) in expected {
        assert!(found.contains(&(index, status.to_owned())), "{index} {status}: {found:?}");
    }
    let blank = &found.iter().find(|(index, _)| *index == 6).unwrap().1;
    assert_ne!(blank, "ok", "a frame without a snake was measured");
    assert!(said.contains("4 of 8") && said.contains("2 unreadable"), "{said}");
    let report = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(report.contains("<td>3 (side)</td><td>unreadable</td>"));
}

#[test]
fn measuring_needs_no_encoders_and_estimating_says_that_it_does() {
    let (_folder, experiment) = copy_of_bending(&[2]);
    let file = experiment.join("experiment.toml");
    let without = fs::read_to_string(&file).unwrap().replace("encoders = \"encoders.csv\"", "");
    fs::write(&file, without).unwrap();
    let out = experiment.join("out");
    assert!(fail(&["run", text(&experiment), "-o", text(&out)]).contains("encoders is missing"));
    succeed(&["measure", text(&experiment), "-o", text(&out), "--quiet"]);
    assert_eq!(statuses(&out.join("measurements.csv")), [(2, "ok".to_owned())]);
}

#[test]
fn input_that_cannot_work_is_refused_in_words() {
    let (_folder, experiment) = copy_of_bending(&[]);
    let out = experiment.join("out");
    let run = |experiment: &Path| fail(&["run", text(experiment), "-o", text(&out)]);
    assert!(run(&experiment).contains("no file here matches `frames/*.jpg`"));
    fs::copy(format!("{BENDING}/frames/00002.jpg"), experiment.join("frames/00002.jpg")).unwrap();

    let camera = experiment.join("camera.yaml");
    let good = fs::read_to_string(&camera).unwrap();
    fs::write(&camera, good.replace("1280", "640").replace("720", "360")).unwrap();
    let message = run(&experiment);
    assert!(message.contains("straight.jpg") && message.contains("1280×720"), "{message}");
    fs::write(&camera, good).unwrap();

    let message = run(&experiment);
    assert!(message.contains("1 measurements give no estimate"), "{message}");
    assert!(!out.join("model.toml").exists(), "a model without an estimate must not pass for one");
    assert!(run(&experiment.join("nowhere")).contains("nowhere: cannot read"));
    assert!(!out.join("report.html").exists());
}

#[test]
fn a_run_that_is_killed_leaves_whole_files_or_none() {
    let (_folder, experiment) = copy_of_bending(&[2, 5, 8]);
    for milliseconds in [300, 1500, 3000, 5000] {
        let out = experiment.join(format!("out-{milliseconds}"));
        let mut child = Command::new(env!("CARGO_BIN_EXE_snakeloop"))
            .args(["run", text(&experiment), "-o", text(&out), "--quiet"])
            .spawn()
            .unwrap();
        std::thread::sleep(Duration::from_millis(milliseconds));
        child.kill().unwrap();
        child.wait().unwrap();
        if let Ok(measurements) = fs::read_to_string(out.join("measurements.csv")) {
            assert_eq!(measurements.lines().count(), 1 + 3);
        }
        if let Ok(report) = fs::read_to_string(out.join("report.html")) {
            assert!(report.ends_with("</html>\n"));
        }
    }
}

#[test]
fn a_frame_is_explained_stage_by_stage() {
    let (folder, experiment) = copy_of_bending(&[4, 5]);
    image::RgbImage::new(640, 360).save(experiment.join("frames/00005.jpg")).unwrap();
    let out = folder.path().join("out");
    let explain =
        |frame: &str| json(&succeed(&["measure", text(&experiment), "-o", text(&out), "--explain", frame, "--json"]));
    let files = |name: &str| {
        let mut files: Vec<_> = fs::read_dir(out.join(name)).unwrap().map(|f| f.unwrap().file_name()).collect();
        files.sort();
        files.into_iter().map(|f| f.into_string().unwrap()).collect::<Vec<_>>()
    };

    let said = explain("4");
    assert_eq!(said[0]["status"], "ok");
    let stages = ["1-frame.png", "2-snakeness.png", "3-grid.png", "4-search.png", "5-edges.png", "6-model.png"];
    assert_eq!(files("explain-00004-side")[..6], stages);
    let page = fs::read_to_string(said[0]["page"].as_str().unwrap()).unwrap();
    assert!(stages.iter().all(|stage| page.contains(stage)) && page.contains("share of the outline"), "{page}");

    // A picture in which nothing is found has the stages before that.
    let said = explain("5");
    assert!(["saturated", "wrong_size"].contains(&said[0]["status"].as_str().unwrap()), "{said}");
    assert!(!files("explain-00005-side").contains(&"5-edges.png".to_owned()));
    assert!(!out.join("measurements.csv").exists());

    let message = fail(&["measure", text(&experiment), "-o", text(&out), "--explain", "9"]);
    assert!(message.contains("no view has a frame 9"), "{message}");
}
