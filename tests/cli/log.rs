//! What `-v` and SNAKELOOP_LOG show on standard error.

use crate::program::{Sandbox, all_said, data, json};
use std::process::Output;

const VARIABLE: &str = "SNAKELOOP_LOG";

fn bending() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.copy_bending(&[0, 4, 8]);
    sandbox
}

/// Standard error of a call that must succeed.
fn shown(output: &Output) -> String {
    assert!(output.status.success(), "{}", all_said(output));
    String::from_utf8(output.stderr.clone()).unwrap()
}

#[test]
fn a_run_shows_its_stages_where_that_is_asked_for_and_nothing_otherwise() {
    let sandbox = bending();
    let call = |line: &str, variable: Option<&str>| {
        let mut command = sandbox.command(line);
        command.env_remove(VARIABLE);
        variable.map(|level| command.env(VARIABLE, level));
        command.output().unwrap()
    };
    let silent = shown(&call("run bending -o silent", None));
    assert!(!silent.contains("INFO"), "{silent}");

    let output = call("run bending -o stages -v --json", None);
    let stages = shown(&output);
    // A stage is named when it ends, with its time.
    for stage in ["calibrate_rig", "refine_rig", "measure", "learn"] {
        let ended = |line: &str| line.contains(stage) && line.contains("close time.busy=");
        assert!(stages.lines().any(ended), "{stage}: {stages}");
    }
    assert!(stages.contains("the rig was found") && stages.contains("judged"), "{stages}");
    assert!(!stages.contains("DEBUG"), "{stages}");
    json(&String::from_utf8(output.stdout).unwrap());

    let frames = shown(&call("run bending -o frames", Some("debug")));
    let of_frames = frames.lines().filter(|line| line.contains("DEBUG") && line.contains("status=ok")).count();
    assert_eq!(of_frames, 3, "{frames}");
    // To be shown changes nothing of what is written.
    for name in ["measurements.csv", "estimate.csv"] {
        assert_eq!(sandbox.read(&format!("silent/{name}")), sandbox.read(&format!("frames/{name}")), "{name}");
    }
}

#[test]
fn discover_shows_its_stages_and_its_answer() {
    let sandbox = Sandbox::new();
    sandbox.simulate("ride", "--effect load_directed_backlash:play_mm=0.08");
    let shown = shown(&sandbox.call(&format!("discover {} -o found -v", data("ride"))));
    assert!(shown.contains("learning the noise") && shown.contains("comparing effects"), "{shown}");
    let answer = shown.lines().find(|line| line.contains("answered")).unwrap_or_else(|| panic!("{shown}"));
    assert!(answer.contains("load_directed_backlash"), "{answer}");
}

#[test]
fn a_level_that_is_none_is_wrong_usage() {
    let sandbox = Sandbox::new();
    let output =
        sandbox.command("invert --theta-deg 30 --delta-deg 0").env(VARIABLE, "snakeloop=loud").output().unwrap();
    let message = all_said(&output);
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(message.contains("SNAKELOOP_LOG") && message.contains("info"), "{message}");
    assert!(sandbox.fail("invert --theta-deg 30 --delta-deg 0 -v --quiet", 2).contains("--quiet"));
}
