//! `live` that is killed again and again over a network camera and network encoders.

use super::fixture::{Live, experiment};
use super::sequence::journaled;
use super::streams::{camera, encoder_lines, never};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use std::time::{Duration, Instant};

/// Measurements that a kill may cost: the one in hand, and one that was counted and is not written yet.
const IN_HAND: u64 = 2;

#[test]
#[ignore = "takes several minutes: cargo test --test cli fifty_kills -- --ignored --nocapture"]
fn fifty_kills_cost_the_frames_in_hand_and_none_is_there_twice() {
    experiment();
    let began = Instant::now();
    let (camera, encoders) = (camera("127.0.0.1:0", began, 20.0, never), encoder_lines(began));
    let (stream, lines) = (format!("http://{}/", camera.address), format!("tcp://{}", encoders.address));
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("out");
    let mut random = StdRng::seed_from_u64(7);
    let (mut kept, mut lost) = (Vec::new(), 0);
    for kill in 0..50 {
        let mut live = Live::start(&output, &["--source", &stream, "--encoders", &lines, "--resume"]);
        let resumed = kept.len() as u64;
        live.until("measurements", |state| state["measurements"].as_u64() > Some(resumed));
        std::thread::sleep(Duration::from_millis(random.random_range(0..1500)));
        let counted = live.get("/api/state")["measurements"].as_u64().unwrap();
        live.kill();
        // In order, each index once.
        let indices = journaled(&output);
        assert!(indices.starts_with(&kept), "kill {kill}: what was there before is there");
        let missing = counted.saturating_sub(indices.len() as u64);
        assert!(missing <= IN_HAND, "kill {kill}: {counted} measurements were counted, {} are there", indices.len());
        (kept, lost) = (indices, lost + missing);
    }
    println!("{} measurements over 50 kills, {lost} lost", kept.len());
    let live = Live::start(&output, &["--source", &stream, "--encoders", &lines, "--resume"]);
    assert_eq!(live.get("/api/state")["resumed"].as_u64(), Some(kept.len() as u64));
    assert!(live.finish().success());
}
