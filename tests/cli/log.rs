//! What `-v` and SNAKELOOP_LOG show on standard error.

use crate::program::{Sandbox, all_said, data, json};
use std::process::Output;

const VARIABLE: &str = "SNAKELOOP_LOG";
const FRAMES: [u64; 2] = [4, 8];

fn bending() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.copy_bending(&FRAMES);
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
    let call = |line: &str| sandbox.command(line).env_remove(VARIABLE).output().unwrap();
    let silent = shown(&call("run bending -o silent"));
    assert!(!silent.contains("INFO"), "{silent}");

    let output = call("run bending -o shown -vv --json");
    let stages = shown(&output);
    // A stage is named when it ends, with its time.
    for stage in ["calibrate_rig", "refine_rig", "measure", "learn"] {
        let ended = |line: &str| line.contains(stage) && line.contains("close time.busy=");
        assert!(stages.lines().any(ended), "{stage}: {stages}");
    }
    assert!(stages.contains("the rig was found") && stages.contains("judged"), "{stages}");
    let of_frames = stages.lines().filter(|line| line.contains("DEBUG") && line.contains("status=ok")).count();
    assert_eq!(of_frames, FRAMES.len(), "{stages}");
    json(&String::from_utf8(output.stdout).unwrap());
    // To be shown changes nothing of what is written.
    for name in ["measurements.csv", "estimate.csv"] {
        assert_eq!(sandbox.read(&format!("silent/{name}")), sandbox.read(&format!("shown/{name}")), "{name}");
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
fn the_variable_asks_as_the_flag_does_and_a_level_that_is_none_is_wrong_usage() {
    let sandbox = Sandbox::new();
    let invert = "invert --theta-deg 30 --delta-deg 0";
    let call = |level: &str| sandbox.command(invert).env(VARIABLE, level).output().unwrap();
    assert!(shown(&call("info")).contains("INFO") && !shown(&call("off")).contains("INFO"));
    let output = call("snakeloop=loud");
    let message = all_said(&output);
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(message.contains("SNAKELOOP_LOG") && message.contains("info"), "{message}");
    assert!(sandbox.fail(&format!("{invert} -v --quiet"), 2).contains("--quiet"));
}
