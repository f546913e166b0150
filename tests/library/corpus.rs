//! The files and pictures that fuzzing found worth keeping, replayed; and that they reach what they are for.

#[path = "../fuzz/targets.rs"]
mod targets;

use proptest::prelude::*;
use std::path::Path;
use targets::Outcomes;

/// Replays a target's corpus: nothing panics, each of these readers accepts a file, and each of these faults is found.
fn replay(target: &str, run: fn(&[u8]) -> Outcomes, accepted_by: &[&str], faults: &[&str]) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus").join(target);
    let mut files: Vec<_> = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    let outcomes: Outcomes = files.iter().flat_map(|file| run(&std::fs::read(file).unwrap())).collect();
    for reader in accepted_by {
        assert!(outcomes.contains(&(reader, Ok(()))), "{target}: no file is accepted by the reader of {reader}");
    }
    for fault in faults {
        let found = |result: &Result<(), String>| result.as_ref().is_err_and(|why| why.contains(fault));
        assert!(outcomes.iter().any(|(_, result)| found(result)), "{target}: no file is refused for {fault:?}");
    }
}

#[test]
fn tables() {
    let readers = ["encoders", "truth", "measurements", "friction", "trajectory", "tracker"];
    let faults = ["is missing, expected", "expected a number", "no usable row", "x_mm,y_mm,z_mm, in mm"];
    replay("tables", targets::tables, &readers, &faults);
}

#[test]
fn settings() {
    let faults = [
        "neither rig nor straight",
        "not a scene",
        "expected 0.05 to 100",
        "unknown field",
        "recur",
        "wiring",
        "formula",
    ];
    let readers = ["experiment", "rig", "model", "scene", "effects", "wiring"];
    replay("settings", targets::settings, &readers, &faults);
}

#[test]
fn camera_yaml() {
    let faults =
        ["alias", "nested too deeply", "the keys found are", "expected 0, 4, 5, 8, 12 or 14", "distortion_model"];
    replay("camera_yaml", targets::camera_yaml, &["yaml"], &faults);
}

#[test]
fn camera_xml() {
    let faults = [
        "DTD",
        "expected a camera file with <opencv_storage>",
        "the keys found are",
        "no camera file that can be read (XML",
    ];
    replay("camera_xml", targets::camera_xml, &["xml"], &faults);
}

#[test]
fn recording() {
    let faults = ["no readable recording", "no message; the recording has", "expected cdr"];
    replay("recording", targets::recording, &["joints", "lens", "poses", "pictures"], &faults);
}

#[test]
fn message() {
    let faults = ["is cut short after", "quaternion of length 1", "expected plain CDR"];
    replay("message", targets::message, &["joints", "lens", "poses", "pictures"], &faults);
}

#[test]
fn journal() {
    replay("journal", targets::journal, &["whole", "entry"], &["cannot be read", "torn", "no entry"]);
}

#[test]
fn run_journal() {
    let faults = ["experiment was", "head cannot be read", "no row", "cut off"];
    replay("run_journal", targets::run_journal, &["head", "rows"], &faults);
}

#[test]
fn encoder_lines() {
    let faults =
        ["not a reading in mm", "the header has no", "expected time_s", "expected q_mm", "more than 4096 bytes"];
    replay("encoder_lines", targets::encoder_lines, &["reading", "remark"], &faults);
}

#[test]
fn picture() {
    let faults = ["empty file", "unreadable picture", "cut short", "px a side"];
    replay("picture", targets::picture, &["picture"], &faults);
}

#[test]
fn measure() {
    let faults = ["wrong_size", "occluded", "saturated", "no_snake", "camera_moved", "base_moved"];
    replay("measure", targets::measure, &["eye"], &faults);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn no_pixels_break_the_eye(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        targets::measure(&bytes);
    }
}
