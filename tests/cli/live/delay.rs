//! How soon `live` notices a fault of camera or encoders: what the book states. That nothing confirms a table is part of it.

use super::fixture::{self, FRAMES, Live, experiment};
use super::streams::{ROUND_S, Server, begin_pictures, send_picture};
use serde_json::Value;
use std::fs;
use std::io::{Cursor, Write};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// What goes wrong.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    EncodersFrozen,
    EncodersSilent,
    ColumnNegated,
    ColumnsExchanged,
    InMicrometres,
    OneScale,
    CameraFrozen,
    CameraSilent,
    CameraMoved,
    CameraLate,
    /// Beside those whose delay the book states.
    TimesInMilliseconds,
    Zeros,
    /// The pose that is wanted a second from now, in place of what is read.
    Targets,
}

const FAULTS: [Fault; 10] = [
    Fault::EncodersFrozen,
    Fault::EncodersSilent,
    Fault::ColumnNegated,
    Fault::ColumnsExchanged,
    Fault::InMicrometres,
    Fault::OneScale,
    Fault::CameraFrozen,
    Fault::CameraSilent,
    Fault::CameraMoved,
    Fault::CameraLate,
];

/// A robot on its path, and a fault that may have begun.
struct World {
    began: Instant,
    fault: Fault,
    since: OnceLock<Instant>,
}

impl World {
    /// When the fault began, if this one has.
    fn begun(&self, fault: Fault) -> Option<Instant> {
        self.since.get().copied().filter(|_| self.fault == fault)
    }

    /// The frame that shows the pose at a moment.
    fn frame(&self, at: Instant) -> u64 {
        let share = (at - self.began).as_secs_f64() / ROUND_S;
        (share * FRAMES as f64) as u64 % FRAMES
    }

    /// What the camera shows now, and whether it is moved; nothing of a silent one.
    fn shown(&self) -> Option<(u64, bool)> {
        let now = Instant::now();
        let late = now.checked_sub(Duration::from_millis(450)).filter(|_| self.begun(Fault::CameraLate).is_some());
        let at = self.begun(Fault::CameraFrozen).or(late).unwrap_or(now);
        let is_moved = self.begun(Fault::CameraMoved).is_some();
        self.begun(Fault::CameraSilent).is_none().then(|| (self.frame(at), is_moved))
    }

    /// What the encoders read now.
    fn read(&self) -> Option<[f64; 3]> {
        let ahead = self.begun(Fault::Targets).map(|_| Instant::now() + Duration::from_secs(1));
        let at = self.begun(Fault::EncodersFrozen).or(ahead).unwrap_or_else(Instant::now);
        let q = fixture::encoders(self.frame(at) as f64 / FRAMES as f64);
        let fault = self.since.get().map(|_| self.fault);
        match fault {
            Some(Fault::EncodersSilent) => None,
            Some(Fault::ColumnNegated) => Some([q[0], -q[1], q[2]]),
            Some(Fault::ColumnsExchanged) => Some([q[0], q[2], q[1]]),
            Some(Fault::InMicrometres) => Some([0, 1, 2].map(|i| 1000.0 * q[i])),
            Some(Fault::Zeros) => Some([0.0; 3]),
            Some(Fault::OneScale) => Some([1.2 * q[0], q[1], q[2]]),
            _ => Some([q[0], q[1], q[2]]),
        }
    }
}

/// A camera with eight frames a second, and encoders with a hundred lines.
fn servers(world: &Arc<World>) -> (Server, Server) {
    let read = |index| fs::read(experiment().join(format!("frames/{index:05}.jpg"))).unwrap();
    let pictures: Vec<Vec<u8>> = (0..FRAMES).map(read).collect();
    let moved: Vec<Vec<u8>> = pictures.iter().map(|picture| moved(picture)).collect();
    let (of_camera, of_encoders) = (Arc::clone(world), Arc::clone(world));
    let camera = Server::start("127.0.0.1:0", move |stream, stop| {
        begin_pictures(stream)?;
        stream.write_all(b"--frame\r\n")?;
        while !stop.load(std::sync::atomic::Ordering::Relaxed) {
            if let Some((frame, is_moved)) = of_camera.shown() {
                let picture = &if is_moved { &moved } else { &pictures }[frame as usize];
                send_picture(stream, picture)?;
            }
            std::thread::sleep(Duration::from_millis(125));
        }
        Ok(())
    });
    let encoders = Server::start("127.0.0.1:0", move |stream, _| {
        stream.set_nonblocking(false)?;
        if let Some(q) = of_encoders.read() {
            let per_s = if of_encoders.begun(Fault::TimesInMilliseconds).is_some() { 1000.0 } else { 1.0 };
            let time_s = per_s * of_encoders.began.elapsed().as_secs_f64();
            writeln!(stream, "{time_s:.4},{:.6},{:.6},{:.6}", q[0], q[1], q[2])?;
        }
        std::thread::sleep(Duration::from_millis(10));
        Ok(())
    });
    (camera, encoders)
}

/// The picture of a camera that was pushed by 6 px.
fn moved(picture: &[u8]) -> Vec<u8> {
    let picture = image::load_from_memory(picture).unwrap().to_rgb8();
    let from = |x: u32, y: u32| *picture.get_pixel(x.saturating_sub(6), y);
    let mut bytes = Cursor::new(Vec::new());
    let pushed = image::RgbImage::from_fn(picture.width(), picture.height(), from);
    pushed.write_to(&mut bytes, image::ImageFormat::Jpeg).unwrap();
    bytes.into_inner()
}

/// What a state says of a fault: why the table is not written.
fn said(state: &Value) -> Option<String> {
    let publication = &state["publication"];
    (publication["state"] != "current").then(|| format!("{}: {}", publication["code"], publication["reason"]))
}

/// Lets a fault begin once a table is published; how long until it is noticed, and what is said.
fn delay(fault: Fault) -> (f64, String) {
    let folder = tempfile::tempdir().unwrap();
    let world = Arc::new(World { began: Instant::now(), fault, since: OnceLock::new() });
    let (camera, encoders) = servers(&world);
    let (stream, lines) = (format!("http://{}/", camera.address), format!("tcp://{}", encoders.address));
    let arguments = ["--source", &stream, "--encoders", &lines, "--save-every", "1"];
    let live = Live::start(&folder.path().join("out"), &arguments);
    live.until("a table", |state| state["publication"]["state"] == "current");
    std::thread::sleep(Duration::from_secs(5));
    live.until("a table that stands", |state| said(state).is_none());
    let began = *world.since.get_or_init(Instant::now);
    loop {
        if let Some(words) = said(&live.get("/api/state")) {
            return (began.elapsed().as_secs_f64(), words);
        }
        assert!(began.elapsed() < Duration::from_secs(60), "{fault:?} is not noticed in a minute");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_pushed_camera_makes_the_table_stale_within_seconds() {
    experiment();
    let (delay_s, words) = delay(Fault::CameraMoved);
    assert!(delay_s < 10.0 && words.contains("rig_drift") && words.contains("camera_moved"), "{delay_s:.1} s: {words}");
}

#[test]
fn nothing_is_commanded_by_under_faults_from_the_start_and_each_is_named() {
    experiment();
    for (fault, named) in [
        (Fault::TimesInMilliseconds, "runs in milliseconds, expected seconds"),
        (Fault::Zeros, "the encoders stand still while the snake moves"),
        // By its size, by what it leaves beyond noise, or by another mistake that looks alike: whichever is told first.
        (Fault::Targets, "no table is written: the "),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let began = Instant::now();
        let world = Arc::new(World { began, fault, since: OnceLock::from(began) });
        let (camera, encoders) = servers(&world);
        let (stream, lines) = (format!("http://{}/", camera.address), format!("tcp://{}", encoders.address));
        let live =
            Live::start(&folder.path().join("out"), &["--source", &stream, "--encoders", &lines, "--save-every", "1"]);
        let mut is_named = false;
        while began.elapsed() < Duration::from_secs(if is_named { 15 } else { 60 }) {
            let (status, answer) = live.ask("GET", "/api/table?theta=60&delta=20", "", "");
            assert_eq!(status, 409, "{fault:?} after {:.1} s: {answer}", began.elapsed().as_secs_f64());
            is_named |= live.get("/api/state")["notices"].to_string().contains(named);
            std::thread::sleep(Duration::from_millis(100));
        }
        assert!(is_named, "{fault:?}: {:#}", live.get("/api/state"));
        assert!(!folder.path().join("out/compensation.csv").exists(), "{fault:?}");
    }
}

#[test]
#[ignore = "takes four minutes: cargo test --release --test cli how_soon_ten_faults -- --ignored --nocapture"]
fn how_soon_ten_faults_are_noticed() {
    experiment();
    for fault in FAULTS {
        let (delay_s, words) = delay(fault);
        println!("{fault:?}: {delay_s:.1} s: {words}");
        assert!(delay_s < 30.0, "{fault:?} is noticed after {delay_s:.0} s");
    }
}
