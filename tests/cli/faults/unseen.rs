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
    for call in [&stem, &force] {
        assert!(sandbox.succeed(call).starts_with("verdict: good\n"));
    }
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

/// A log in which readings of a backbone, or of all, are larger by so much from some row on, mm.
fn stepped(log: &[EncoderReading], backbone: Option<usize>, from: usize, mm: f64) -> Vec<EncoderReading> {
    let add =
        |q: PerBackbone| PerBackbone::from_fn(3, |i| q[i] + if backbone.is_none_or(|one| one == i) { mm } else { 0.0 });
    let row = |(k, row): (usize, &EncoderReading)| EncoderReading {
        q_mm: if k >= from { add(row.q_mm) } else { row.q_mm },
        ..*row
    };
    log.iter().enumerate().map(row).collect()
}

/// The first reason's text.
fn first(verdict: &serde_json::Value) -> &str {
    verdict["reasons"][0]["text"].as_str().unwrap_or_default()
}

#[test]
fn a_force_that_explains_nothing_must_not_be_used() {
    let (sandbox, log) = experiment(3);
    sandbox.succeed(&format!("estimate {} -o known", data("lab")));
    sandbox.write("other.toml", &sandbox.read("known/model.toml").replacen("\neta = 1.2", "\neta = 1.8", 1));
    let force = |model: &str, log: &[EncoderReading]| {
        sandbox.write("lab/encoders.csv", &encoders_csv(log, 3));
        sandbox.json(&format!("force {} --model {model} -o force", data("lab")))
    };
    assert_eq!(force("known/model.toml", &log)["verdict"]["level"], "good");
    // Homed anew since the model was learned, a slip of one encoder, another robot's model: each is a force of half a newton or more.
    for (model, log) in [
        ("known/model.toml", stepped(&log, None, 0, 0.3)),
        ("known/model.toml", stepped(&log, Some(0), 0, 0.2)),
        ("other.toml", log.clone()),
    ] {
        let found = force(model, &log);
        assert!(first(&found["verdict"]).starts_with("no one force explains"), "{found:#}");
    }
    sandbox.write("lab/encoders.csv", &encoders_csv(&stepped(&log, None, 0, 0.3), 3));
    let said = sandbox.fail(&format!("force {} --model known/model.toml --strict -o force", data("lab")), 1);
    assert!(said.contains("no one force explains"), "{said}");
    assert!(sandbox.join("force/force.csv").exists());
}

#[test]
fn a_zero_taken_while_the_snake_was_bent_is_no_slip_in_the_middle() {
    let (sandbox, log) = experiment(3);
    let bent = |q: PerBackbone| q - log[0].q_mm;
    let zeroed: Vec<_> = log.iter().map(|row| EncoderReading { q_mm: bent(row.q_mm), ..*row }).collect();
    for log in [stepped(&log, Some(0), 0, 0.3), zeroed] {
        let verdict = verdict(&sandbox, &log);
        assert!(!verdict.to_string().contains("rehomed"), "{verdict:#}");
        assert!(verdict.to_string().contains("all poses are missed by the same"), "{verdict:#}");
    }
    // A small slip of one encoder moves the bends, and what the readings have in common by a third of it.
    for mm in [0.03, 0.2] {
        let verdict = verdict(&sandbox, &stepped(&log, Some(0), 18, mm));
        let slip = verdict["reasons"].as_array().unwrap().iter().find(|reason| reason["code"] == "rehomed");
        assert_eq!(slip.unwrap_or_else(|| panic!("{verdict:#}"))["backbone"], 1, "{verdict:#}");
    }
    // A counter that jumps by 2¹⁶ counts spreads its column, and the others go on as they are.
    let jumped = verdict(&sandbox, &stepped(&log, Some(0), 18, 65.536));
    assert!(!jumped.to_string().contains("still"), "{jumped:#}");
    // A logger that changes to micrometres.
    let micrometres = |(k, row): (usize, &EncoderReading)| EncoderReading {
        q_mm: row.q_mm * if k < 22 { 1.0 } else { 1000.0 },
        ..*row
    };
    let changed = verdict(&sandbox, &log.iter().enumerate().map(micrometres).collect::<Vec<_>>());
    assert!(
        changed.to_string().contains("readings lead to no bend of this robot, the first at frame 2"),
        "{changed:#}"
    );
}

#[test]
fn a_table_says_where_its_commands_hold_if_the_line_remembers() {
    let (sandbox, _) = experiment(3);
    let told = |effect: &str| {
        all_said(&sandbox.call(&format!("table --model hidden.toml --effect {effect} --c-header -o table")))
    };
    let play = told("motion_directed_backlash:half_gap_mm=0.1");
    assert!(play.contains("motion_directed_backlash: a command holds where"), "{play}");
    assert!(play.contains("motion_directed_backlash makes commands jump"), "{play}");
    let said = told("creep:share=0.2,time_constant_s=30");
    let condition = "creep: a command holds where the bend is come to from straight";
    assert!(said.contains(condition), "{said}");
    assert!(sandbox.read("table/compensation.json").contains(condition));
    assert!(sandbox.read("table/compensation.h").contains(&format!("HOLDS IF: {condition}")));
    let plain = all_said(&sandbox.call("table --model hidden.toml -o plain"));
    assert!(!plain.contains("commands lead"), "{plain}");
    // A stiffness that falls with the bend: beyond some bend the snake would not stay where the command is for.
    let said = all_said(&sandbox.call(
        "invert --model hidden.toml --effect superelastic_softening:softening_per_rad2=0.3 --theta-deg 90 --delta-deg 0",
    ));
    assert!(said.contains("are not where the model itself predicts that their commands lead"), "{said}");
    assert!(!sandbox.read("plain/compensation.json").contains("holds_if"));
}

#[test]
fn an_eta_that_somebody_wrote_by_hand_is_told_where_a_robot_is_commanded() {
    let (sandbox, _) = experiment(3);
    sandbox.succeed(&format!("estimate {} -o known", data("lab")));
    let model = sandbox.read("known/model.toml");
    let eta = model.lines().find(|line| line.starts_with("eta = ")).unwrap();
    sandbox.write("large.toml", &model.replace(eta, "eta = 8.0"));
    let call = |model: &str| all_said(&sandbox.call(&format!("invert --model {model} --theta-deg 40 --delta-deg 10")));
    assert!(call("large.toml").contains("such robots have one third to three"), "{}", call("large.toml"));
    assert!(!call("known/model.toml").contains("warning"), "{}", call("known/model.toml"));
}

#[test]
fn files_that_count_twice_or_contradict_each_other_are_refused() {
    let sandbox = sandbox();
    // A row that somebody copied over another.
    run(&sandbox, "part1", "--shard 1/2 --overlays none");
    run(&sandbox, "part2", "--shard 2/2 --overlays none");
    let rows = sandbox.read("part2/measurements.csv");
    let lines: Vec<&str> = rows.lines().collect();
    let doubled = [&lines[..2], &[lines[1]], &lines[3..]].concat().join("\n") + "\n";
    sandbox.write("part2/measurements.csv", &doubled);
    let said = sandbox.fail("merge part1 part2 -o merged", 1);
    assert!(said.contains("part2/measurements.csv") && said.contains("stands twice or out of order"), "{said}");
    // One camera's pictures as those of two.
    let settings = sandbox.read("experiment/experiment.toml");
    let (top, view) = settings.split_once("[[view]]").unwrap();
    let second = view.replacen("name = \"", "name = \"second-", 1);
    sandbox.write("experiment/experiment.toml", &format!("{top}[[view]]{view}\n[[view]]{second}"));
    let said = sandbox.fail("run experiment -o out", 1);
    assert!(said.contains("begin with the same picture"), "{said}");
    // Pictures that an output would be read as.
    sandbox.write("experiment/experiment.toml", &settings.replace("*.png", "*.jpg"));
    let said = sandbox.fail("run experiment -o experiment/frames", 1);
    assert!(said.contains("rig.jpg") && said.contains("would be read as one of these"), "{said}");
    // Friction that the model was not learned with.
    sandbox.write_hidden_model();
    std::fs::rename(sandbox.join("hidden.toml"), sandbox.join("experiment/model.toml")).unwrap();
    sandbox.write(
        "experiment/robot.toml",
        "[friction]\nmu = 0.5\nstatic_force_n = 1.0\nsd_mu = 0.01\nsd_static_force_n = 0.1\ncorrelation = 0.0\n",
    );
    sandbox.write("experiment/experiment.toml", &format!("robot = \"robot.toml\"\nmodel = \"model.toml\"\n{settings}"));
    let said = sandbox.fail("run experiment -o out", 1);
    assert!(said.contains("μ = 0.5") && said.contains("was learned with"), "{said}");
}
