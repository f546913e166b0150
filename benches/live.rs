//! `live` against a network camera at 60 frames/s: latency from the camera's sending to the estimate, drops, memory.
//!
//! `LIVE_FRAMES=20000 cargo bench --bench live`. Each frame of the path shows another bend, so that the bend measured tells which frame
//! it was and when it was sent: the figures hold for the whole way through network, decoder and loop.

use nalgebra::Vector2;
use serde_json::Value;
use snakeloop::geometry::Configuration;
use snakeloop::live::Histogram;
use snakeloop::observation::Truth;
use snakeloop::robot::{Estimate, Model};
use snakeloop::simulate::scene::{Scene, Sensor};
use snakeloop::simulate::{FrameFormat, write_experiment};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

const FPS: f64 = 60.0;
/// Frames of the closed path.
const ROUND: usize = 180;
/// Time between two lines of progress, s. Convention: a display choice.
const PROGRESS_EVERY_S: f64 = 30.0;
/// Time after the last frame in which its row must come, s. Convention.
const LAST_ROWS_S: f64 = 2.0;

fn path(frame: usize) -> Configuration {
    let angle = (frame % ROUND) as f64 / ROUND as f64 * std::f64::consts::TAU;
    Configuration::from_bend_vector(Vector2::new(0.55 + 0.35 * angle.cos(), 0.45 * angle.sin()))
}

fn unix_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64()
}

/// Sends frames evenly, and notes when; ends after so many.
fn camera(experiment: &Path, frames: usize, sent: Arc<Mutex<Vec<f64>>>) -> std::net::SocketAddr {
    let read = |index| std::fs::read(experiment.join(format!("frames/{index:05}.jpg"))).unwrap();
    let pictures: Vec<Vec<u8>> = (0..ROUND).map(read).collect();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        stream.set_nodelay(true).unwrap();
        let _ = stream.read(&mut [0; 4096]).unwrap();
        stream
            .write_all(b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n\r\n")
            .unwrap();
        let began = Instant::now();
        for frame in 0..frames {
            let due = began + Duration::from_secs_f64(frame as f64 / FPS);
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
            let picture = &pictures[frame % ROUND];
            let head = format!("--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n", picture.len());
            sent.lock().unwrap().push(unix_s());
            if stream.write_all(&[head.as_bytes(), picture, b"\r\n"].concat()).is_err() {
                return;
            }
        }
    });
    address
}

/// Encoder lines with Unix time, at 200 Hz; they stand still with the frames.
fn encoders(model: Model, sent: Arc<Mutex<Vec<f64>>>) -> std::net::SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let commands: Vec<_> = (0..ROUND).map(|frame| model.command(path(frame))).collect();
    std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        loop {
            let frame = sent.lock().unwrap().len().saturating_sub(1);
            let q = commands[frame % ROUND];
            if writeln!(stream, "{:.5},{:.6},{:.6},{:.6}", unix_s(), q[0], q[1], q[2]).is_err() {
                return;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    });
    address
}

fn get(address: &str, target: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    write!(stream, "GET {target} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer.split_once("\r\n\r\n").unwrap().1.to_owned()
}

/// From the sending of the frame that shows the bend of a row to its estimate, s.
fn latency(row: &Value, sent: &[f64]) -> Option<f64> {
    let seen = Configuration::from_degrees(row["theta_deg"].as_f64()?, row["delta_deg"].as_f64()?).bend_vector();
    let done_s = row["time_s"].as_f64()? + row["latency_ms"].as_f64()? / 1000.0;
    let phase = (0..ROUND).min_by(|&a, &b| {
        let off = |frame| (path(frame).bend_vector() - seen).norm();
        off(a).total_cmp(&off(b))
    })?;
    let last = sent.partition_point(|&at| at <= done_s).checked_sub(1)?;
    let frame = last.checked_sub((last + ROUND - phase) % ROUND)?;
    Some(done_s - sent[frame])
}

/// A running `live` and its address.
fn start_live(experiment: &Path, stream: &str, lines: &str) -> (Child, String) {
    let output = experiment.join("out");
    let mut live = Command::new(env!("CARGO_BIN_EXE_snakeloop"))
        .args(["live", experiment.to_str().unwrap(), "--source", stream, "--encoders", lines])
        .args(["--serve", "127.0.0.1:0", "-o", output.to_str().unwrap()])
        .stdout(Stdio::inherit())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = String::new();
    BufReader::new(live.stderr.take().unwrap()).read_line(&mut said).unwrap();
    (live, said.trim().trim_start_matches("dashboard: http://").trim_end_matches('/').to_owned())
}

/// Counts and memory so far, for whoever watches.
fn print_progress(address: &str, sent: usize) {
    let metrics = get(address, "/metrics");
    let figure = |name: &str| metrics.lines().find_map(|line| line.strip_prefix(name)?.trim().parse::<f64>().ok());
    println!(
        "{sent:>6} sent, {:>6} came, {:>4} dropped, {:.1} MB",
        figure("snakeloop_frames_total ").unwrap_or(0.0),
        figure("snakeloop_frames_dropped_total ").unwrap_or(0.0),
        figure("snakeloop_resident_memory_bytes ").unwrap_or(0.0) / 1e6
    );
}

/// The latencies of all rows until the last frame was sent.
fn latencies_until_the_end(address: &str, frames: usize, sent: &Mutex<Vec<f64>>) -> Histogram {
    let (mut since, mut latencies, mut next_progress_s) = (-1, Histogram::default(), 0.0);
    let began = Instant::now();
    loop {
        std::thread::sleep(Duration::from_millis(500));
        let target = if since < 0 { "/api/measurements".into() } else { format!("/api/measurements?since={since}") };
        let rows: Value = serde_json::from_str(&get(address, &target)).unwrap();
        let sent = sent.lock().unwrap().clone();
        for row in rows["measurements"].as_array().unwrap() {
            since = row["index"].as_i64().unwrap();
            // In the first second the decoder finds out what it was given.
            if since > FPS as i64
                && let Some(seconds) = latency(row, &sent)
            {
                latencies.add(seconds);
            }
        }
        if began.elapsed().as_secs_f64() > next_progress_s {
            print_progress(address, sent.len());
            next_progress_s += PROGRESS_EVERY_S;
        }
        if sent.len() == frames && unix_s() - sent[frames - 1] > LAST_ROWS_S {
            return latencies;
        }
    }
}

fn main() {
    let frames: usize = std::env::var("LIVE_FRAMES").ok().and_then(|text| text.parse().ok()).unwrap_or(1200);
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene { sensor: Sensor { rays_per_pixel: 2, blur_px: 0.5, noise: 1.0 }, ..Scene::default() };
    let truths: Vec<Truth> = (0..ROUND).map(|k| Truth { index: k as u64, configuration: path(k) }).collect();
    write_experiment(folder.path(), &scene, &truths, FrameFormat::Jpeg(88), 1, &|| ()).unwrap();
    let truth = Estimate { eta: 1.221, lambda_mm: 0.1765, covariance: nalgebra::Matrix2::zeros(), samples: 0 };
    let sent = Arc::new(Mutex::new(Vec::new()));
    let stream = format!("http://{}/", camera(folder.path(), frames, Arc::clone(&sent)));
    let lines = format!("tcp://{}", encoders(Model::default().with_estimate(truth), Arc::clone(&sent)));

    let (mut live, address) = start_live(folder.path(), &stream, &lines);
    let latencies = latencies_until_the_end(&address, frames, &sent);
    let state: Value = serde_json::from_str(&get(&address, "/api/state")).unwrap();
    println!("from sending to estimate: {}", serde_json::to_string(&latencies.status(0.0)).unwrap());
    print!("{}", latencies.text());
    println!("the loop's own: {}", state["latency"]);
    println!(
        "{} came, {} dropped, {} measured; {}",
        state["source"]["frames"], state["source"]["dropped"], state["measured"], state["estimate"]
    );
    Command::new("kill").args(["-INT", &live.id().to_string()]).status().unwrap();
    live.wait().unwrap();
}
