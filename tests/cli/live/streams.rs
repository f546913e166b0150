//! A network camera, made here, that goes away, is too fast, or holds frames up.

use super::fixture::{self, FRAMES, Live, assert_learned, experiment};
use serde_json::Value;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How long one round of the path takes: slowly enough that neighbouring frames show nearly the same.
pub const ROUND_S: f64 = FRAMES as f64 / 3.0;

/// A server that does its work for each visitor until it is dropped.
pub struct Server {
    pub address: SocketAddr,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    pub fn start(
        address: &str,
        serve: impl Fn(&mut TcpStream, &AtomicBool) -> std::io::Result<()> + Send + Sync + 'static,
    ) -> Self {
        // A port that was just in use may need a moment.
        let deadline = Instant::now() + Duration::from_secs(10);
        let listener = loop {
            match TcpListener::bind(address) {
                Ok(listener) => break listener,
                Err(e) => assert!(Instant::now() < deadline, "{address}: {e}"),
            }
            std::thread::sleep(Duration::from_millis(20));
        };
        listener.set_nonblocking(true).unwrap();
        let address = listener.local_addr().unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let (theirs, serve) = (Arc::clone(&stop), Arc::new(serve));
        let thread = std::thread::spawn(move || {
            let mut visitors: Vec<JoinHandle<()>> = Vec::new();
            while !theirs.load(Ordering::Relaxed) {
                if let Ok((mut stream, _)) = listener.accept() {
                    let (stop, serve) = (Arc::clone(&theirs), Arc::clone(&serve));
                    visitors.push(std::thread::spawn(move || {
                        while !stop.load(Ordering::Relaxed) && serve(&mut stream, &stop).is_ok() {}
                    }));
                }
                std::thread::sleep(Duration::from_millis(2));
            }
            visitors.into_iter().for_each(|visitor| visitor.join().unwrap());
        });
        Self { address, stop, thread: Some(thread) }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let _ = self.thread.take().unwrap().join();
    }
}

/// The share of the path at a moment.
pub fn share(began: Instant) -> f64 {
    began.elapsed().as_secs_f64() / ROUND_S
}

/// Takes a client's request for a network camera's pictures, and begins the answer.
pub fn begin_pictures(stream: &mut TcpStream) -> std::io::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(Duration::from_secs(2)))?;
    let _ = stream.read(&mut [0; 4096])?;
    stream.write_all(b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n\r\n")
}

/// Sends a picture without its length, and the boundary that ends it.
pub fn send_picture(stream: &mut TcpStream, picture: &[u8]) -> std::io::Result<()> {
    stream.write_all(&[&b"Content-Type: image/jpeg\r\n\r\n"[..], picture, b"\r\n--frame\r\n"].concat())
}

/// A network camera: the frame that shows where the snake is, so many times a second. In `held` of the seconds frames wait, and
/// are sent all at once afterwards.
pub fn camera(address: &str, began: Instant, fps: f64, held: fn(f64) -> bool) -> Server {
    let read = |index| std::fs::read(experiment().join(format!("frames/{index:05}.jpg"))).unwrap();
    let pictures: Vec<Vec<u8>> = (0..FRAMES).map(read).collect();
    Server::start(address, move |stream, stop| {
        begin_pictures(stream)?;
        let mut waiting = Vec::new();
        while !stop.load(Ordering::Relaxed) {
            // Where the path's frames lie.
            let picture = &pictures[(share(began) * FRAMES as f64) as usize % FRAMES as usize];
            write!(waiting, "--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n", picture.len())?;
            waiting.extend([picture, &b"\r\n"[..]].concat());
            if !held(began.elapsed().as_secs_f64()) {
                stream.write_all(&waiting)?;
                waiting.clear();
            }
            std::thread::sleep(Duration::from_secs_f64(1.0 / fps));
        }
        Ok(())
    })
}

/// A camera that holds nothing up.
pub fn never(_: f64) -> bool {
    false
}

/// Encoder lines at 100 Hz, by a clock of their own that began 5000 s before the test. The frames stand still between
/// their instants, and so do the readings.
pub fn encoder_lines(began: Instant) -> Server {
    Server::start("127.0.0.1:0", move |stream, _| {
        stream.set_nonblocking(false)?;
        let frame = (share(began) * FRAMES as f64).floor() / FRAMES as f64;
        let q = fixture::encoders(frame);
        writeln!(stream, "{:.4},{:.6},{:.6},{:.6}", 5000.0 + began.elapsed().as_secs_f64(), q[0], q[1], q[2])?;
        std::thread::sleep(Duration::from_millis(10));
        Ok(())
    })
}

#[test]
fn a_network_camera_that_goes_away_is_met_again() {
    experiment();
    let began = Instant::now();
    let first = camera("127.0.0.1:0", began, 30.0, never);
    let address = first.address;
    let encoders = encoder_lines(began);
    let folder = tempfile::tempdir().unwrap();
    let stream = format!("http://{address}/stream.mjpg");
    let lines = format!("tcp://{}", encoders.address);
    let live = Live::start(&folder.path().join("out"), &["--source", &stream, "--encoders", &lines]);
    let state = live.until("an estimate", |state| state["estimate"]["samples"].as_u64() >= Some(16));
    assert_learned(&state);
    assert_eq!(state["encoders"]["clock"], "foreign");
    let unix_s = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_secs_f64();
    let offset_s = unix_s - began.elapsed().as_secs_f64() - 5000.0;
    assert!((state["encoders"]["offset_s"].as_f64().unwrap() - offset_s).abs() < 0.05, "{state:#}");
    let rate = state["source"]["rate_fps"].as_f64().unwrap();
    assert!((15.0..45.0).contains(&rate), "{rate} frames/s");

    drop(first);
    let state = live.until("the loss", |state| state["source"]["state"] == "lost");
    assert!(state["source"]["trouble"].is_string());
    let frames = state["source"]["frames"].clone();
    let returned = Instant::now();
    let again = camera(&address.to_string(), began, 30.0, never);
    let state = live.until("the return", |state| state["source"]["state"] == "running");
    let took = returned.elapsed();
    println!("frames came again after {:.2} s", took.as_secs_f64());
    assert!(took < Duration::from_secs(2), "{took:?}");
    assert_eq!(state["source"]["reconnects"], 1);
    live.until("more frames", |state| state["source"]["frames"].as_u64() > frames.as_u64());
    drop((again, encoders));
    assert!(live.finish().success());
}

/// `live` on a camera and encoders.
pub fn start(output: &std::path::Path, camera: &Server, encoders: &Server) -> Live {
    let stream = format!("http://{}/stream.mjpg", camera.address);
    let lines = format!("tcp://{}", encoders.address);
    Live::start(output, &["--source", &stream, "--encoders", &lines])
}

#[test]
fn frames_faster_than_they_can_be_measured_are_noticed_and_what_is_learned_is_right() {
    experiment();
    let began = Instant::now();
    let (camera, encoders) = (camera("127.0.0.1:0", began, 400.0, never), encoder_lines(began));
    let folder = tempfile::tempdir().unwrap();
    let live = start(&folder.path().join("out"), &camera, &encoders);
    let state = live.until("being behind", |state| state["pace"]["state"] == "behind");
    let sentence = state["pace"]["sentence"].as_str().unwrap();
    assert!(sentence.contains("ms old when they are measured"), "{sentence}");
    assert!(state["notices"].to_string().contains("ms old when they are measured"), "{state:#}");
    live.until("frames that are dropped or old", |state| {
        state["pace"]["dropped"].as_f64() > Some(0.1) || state["pace"]["age_ms"].as_f64() > Some(100.0)
    });
    // Most of the path: bends of all sizes to one side and the other.
    let state = live.until("most of a round", |state| state["elapsed_s"].as_f64() > Some(0.7 * ROUND_S));
    assert_learned(&state);
    assert!(live.ask("GET", "/metrics", "", "").1.contains("snakeloop_pace{state=\"behind\"} "));
    drop((camera, encoders));
}

#[test]
fn nothing_is_learned_from_frames_that_were_held_up() {
    experiment();
    let began = Instant::now();
    // At the rate at which the pictures change.
    let (camera, encoders) = (camera("127.0.0.1:0", began, 20.0, |s| s % 3.0 > 2.2), encoder_lines(began));
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("out");
    let live = start(&output, &camera, &encoders);
    let state = live.until("late frames", |state| state["pace"]["state"] == "late");
    assert!(state["pace"]["sentence"].as_str().unwrap().contains("after they are due"), "{state:#}");
    let state = live.until("most of a round", |state| state["elapsed_s"].as_f64() > Some(0.7 * ROUND_S));
    assert_learned(&state);
    // A busy machine drops most of what was held up, and counts few.
    assert!(state["pace"]["late"].as_u64() > Some(0), "{state:#}");
    let rows = live.get("/api/measurements");
    let late: Vec<&Value> = rows["measurements"].as_array().unwrap().iter().filter(|row| is_late(row)).collect();
    assert!(!late.is_empty() && late.iter().all(|row| row["verdict"] == "skipped" && row["q_mm"].is_null()));
    drop((camera, encoders));
    assert!(live.finish().success());
}

fn is_late(row: &Value) -> bool {
    row["reason"].as_str().unwrap().contains("its time is not certain")
}
