//! Results that are poorer than they look, and files that do not belong together: each is said, or does not come about.

use super::fixture::{run, sandbox};
use crate::program::{Sandbox, all_said, data};
use snakeloop::observation::EncoderReading;
use snakeloop::record::{encoders_csv, read_encoders};
use snakeloop::robot::PerBackbone;
use std::process::{Command, Output};

/// A simulated experiment of 36 poses in `lab`, and its log.
fn experiment(seed: u64) -> (Sandbox, Vec<EncoderReading>) {
    let sandbox = Sandbox::new();
    sandbox.write_hidden_model();
    sandbox.simulate("lab", &format!("--model hidden.toml --seed {seed}"));
    let log = read_encoders(&sandbox.join("lab/encoders.csv"), 3).unwrap().rows;
    (sandbox, log)
}

/// The verdict of `estimate` with another log.
fn verdict(sandbox: &Sandbox, log: &[EncoderReading]) -> serde_json::Value {
    sandbox.write("lab/encoders.csv", &encoders_csv(log, 3));
    sandbox.json(&format!("estimate {} -o out", data("lab")))["verdict"].clone()
}

/// Calls the program where no file may have more than 20 KiB, as on a disk that is nearly full.
fn in_little_room(sandbox: &Sandbox, line: &str) -> Output {
    Command::new("bash")
        .current_dir(sandbox.path())
        .args(["-c", "trap '' XFSZ; ulimit -f 20; exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_snakeloop")])
        .args(line.split_whitespace())
        .output()
        .unwrap()
}

#[test]
fn one_encoder_that_is_off_by_two_per_cent_is_not_called_good() {
    let (sandbox, log) = experiment(5);
    assert_eq!(verdict(&sandbox, &log)["level"], "good");
    for (backbone, scale) in (0..3).flat_map(|backbone| [(backbone, 0.98), (backbone, 1.02)]) {
        let off = |q: PerBackbone| PerBackbone::from_fn(3, |i| if i == backbone { scale * q[i] } else { q[i] });
        let scaled: Vec<_> = log.iter().map(|row| EncoderReading { q_mm: off(row.q_mm), ..*row }).collect();
        let verdict = verdict(&sandbox, &scaled);
        assert_ne!(verdict["level"], "good", "backbone {}, {scale}: {verdict:#}", backbone + 1);
    }
}

#[test]
fn a_log_that_was_cut_says_which_frames_taught_nothing() {
    let (sandbox, log) = experiment(3);
    for (rows, lost) in [(&log[..18], "18 to 35"), (&log[..30], "30 to 35"), (&log[9..], "0 to 8")] {
        let verdict = verdict(&sandbox, rows);
        let first = verdict["reasons"][0]["text"].as_str().unwrap();
        let expected = [format!("{} of 36 measured frames", 36 - rows.len()), format!("frames {lost}")];
        assert!(expected.iter().all(|part| first.contains(part)), "{first}");
        assert_eq!(verdict["level"], "look");
    }
    let hole = [&log[..10], &log[16..]].concat();
    assert!(verdict(&sandbox, &hole).to_string().contains("6 in a row, frames 10 to 15"));
    // A logger that stops a frame early, and one that is slower than the camera, lose nothing that matters.
    assert_eq!(verdict(&sandbox, &log[..35])["level"], "good");
    assert_eq!(verdict(&sandbox, &log.iter().copied().step_by(2).collect::<Vec<_>>())["level"], "good");
}

#[test]
fn a_full_disk_leaves_no_table_beside_another_model() {
    let (sandbox, _) = experiment(3);
    sandbox.succeed(&format!("estimate {} -o out", data("lab")));
    sandbox.succeed("table --model out/model.toml -o out");
    let names = ["model.toml", "estimate.csv", "compensation.csv", "compensation.json"];
    let former = names.map(|name| sandbox.read(&format!("out/{name}")));
    sandbox.write("other.toml", &sandbox.read("hidden.toml").replace("eta = 1.221", "eta = 1.8"));
    sandbox.simulate("other", "--model other.toml --seed 4");
    let output = in_little_room(&sandbox, &format!("estimate {} -o out", data("other")));
    let said = all_said(&output);
    assert!(output.status.code() == Some(1) && said.contains("compensation.csv: cannot write"), "{said}");
    assert_eq!(names.map(|name| sandbox.read(&format!("out/{name}"))), former);
    // With room again, both belong together.
    sandbox.succeed(&format!("estimate {} -o out", data("other")));
    assert!(sandbox.read("out/compensation.csv").lines().next().unwrap().ends_with(",stale"));
}

#[test]
fn a_stale_table_that_cannot_be_marked_on_a_full_disk_is_put_aside() {
    let sandbox = sandbox();
    run(&sandbox, "out", "--overlays none");
    let log = sandbox.read("experiment/encoders.csv");
    sandbox.write("experiment/encoders.csv", &log.replace("q1_mm,q2_mm", "q2_mm,q1_mm"));
    let output = in_little_room(&sandbox, "run experiment -o out --overlays none");
    let said = all_said(&output);
    assert!(output.status.code() == Some(1) && said.contains("it is stale and cannot be marked so"), "{said}");
    for name in ["model.toml", "compensation.csv", "compensation.json"] {
        let (path, aside) = (sandbox.join(&format!("out/{name}")), sandbox.join(&format!("out/{name}.stale")));
        assert!(!path.exists() && aside.exists(), "{name}: {said}");
    }
}

#[test]
fn a_miswired_log_is_told_where_a_stem_is_followed_and_where_a_force_is_sought() {
    let (sandbox, log) = experiment(3);
    sandbox.succeed(&format!("estimate {} -o known", data("lab")));
    let stem = format!("estimate {} --stem --model known/model.toml -o stem", data("lab"));
    let force = format!("force {} --model known/model.toml -o force", data("lab"));
    assert!(!sandbox.succeed(&stem).contains("verdict") && !sandbox.succeed(&force).contains("verdict"));
    let exchanged = |q: PerBackbone| PerBackbone::from([q[0], q[2], q[1]]);
    let miswired: Vec<_> = log.iter().map(|row| EncoderReading { q_mm: exchanged(row.q_mm), ..*row }).collect();
    sandbox.write("lab/encoders.csv", &encoders_csv(&miswired, 3));
    for call in [&stem, &force] {
        let said = sandbox.succeed(call);
        assert!(said.starts_with("verdict: do not use\n") && said.contains("columns"), "{said}");
        assert_eq!(sandbox.json(call)["verdict"]["reasons"][0]["code"], "wiring");
    }
    let said = sandbox.fail("invert --model stem/model.toml --theta-deg 60 --delta-deg 20", 1);
    assert!(said.contains("must not be used"), "{said}");
}

#[test]
fn a_table_that_noise_leaves_open_is_not_called_good() {
    let (sandbox, log) = experiment(3);
    let scaled = |q: PerBackbone| PerBackbone::from([q[0], 1.2 * q[1], q[2]]);
    let scaled: Vec<_> = log.iter().map(|row| EncoderReading { q_mm: scaled(row.q_mm), ..*row }).collect();
    sandbox.write("lab/encoders.csv", &encoders_csv(&scaled, 3));
    // So much noise hides any gap, and the table's own σ says so.
    let judged = sandbox.json(&format!("estimate {} --encoder-sd 0.5 -o out", data("lab")));
    let first = &judged["verdict"]["reasons"][0];
    assert_eq!((&judged["verdict"]["level"], &first["code"]), (&"look".into(), &"workspace_not_covered".into()));
    assert!(first["text"].as_str().unwrap().starts_with("the table is known to ±"), "{first}");
}
