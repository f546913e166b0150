//! A network camera that speaks RTSP: GStreamer's server, from Debian's packages, on the loopback.

use super::fixture::{Live, experiment};
use super::streams::ROUND_S;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::SystemTime;

/// rtsp.py with these arguments, by the system's Python, which has the packages.
fn script(arguments: &[&str]) -> Command {
    let mut command = Command::new("/usr/bin/python3");
    command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cli/live/rtsp.py")).args(arguments);
    command
}

/// The server, ended when dropped.
struct Camera(Child);

impl Drop for Camera {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// `cargo test --test cli rtsp -- --ignored`
#[test]
#[ignore = "needs OpenCV and GStreamer's RTSP server; tools/test runs it where they are"]
fn an_rtsp_camera_is_measured() {
    if cfg!(not(feature = "opencv")) || !script(&["--check"]).status().is_ok_and(|status| status.success()) {
        println!("NOT CHECKED: an RTSP camera; it needs a build with OpenCV, and the packages that rtsp.py names");
        return;
    }
    let began_s = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_secs_f64();
    let frames = experiment().join("frames");
    let arguments = [frames.to_str().unwrap(), &began_s.to_string(), &ROUND_S.to_string()];
    let mut camera = Camera(script(&arguments).stdout(Stdio::piped()).spawn().unwrap());
    let mut port = String::new();
    BufReader::new(camera.0.stdout.take().unwrap()).read_line(&mut port).unwrap();
    let stream = format!("rtsp://127.0.0.1:{}/snake", port.trim());
    let folder = tempfile::tempdir().unwrap();
    let live = Live::start(&folder.path().join("out"), &["--source", &stream]);
    let state = live.until("measurements", |state| state["measured"].as_u64() >= Some(30));
    let share = state["measured"].as_f64().unwrap() / state["measurements"].as_f64().unwrap();
    assert!(share > 0.9, "{share} of the frames are measured: {state:#}");
    assert_eq!(state["latest"]["status"], "ok", "{state:#}");
    let rate = state["source"]["rate_fps"].as_f64().unwrap();
    assert!((8.0..25.0).contains(&rate), "{rate} frames/s");
    drop(camera);
    live.until("the loss", |state| state["source"]["state"] == "lost");
    assert!(live.finish().success());
}
