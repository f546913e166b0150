//! A network camera and a video file, both made here.

use super::lab::{self, FRAMES, Live, assert_learned, experiment};
use opencv::core::{Mat, Size, Vec3b};
use opencv::videoio::{VideoWriter, VideoWriterTrait};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

const FPS: f64 = 30.0;
/// How long one round of the path takes: slowly enough that neighbouring frames show nearly the same.
const ROUND_S: f64 = FRAMES as f64 / 3.0;

/// A server that does its work for each visitor until it is dropped.
struct Server {
    address: SocketAddr,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    fn start(
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
fn share(began: Instant) -> f64 {
    began.elapsed().as_secs_f64() / ROUND_S
}

/// A network camera: the frame that shows where the snake is, 30 times a second.
fn camera(address: &str, began: Instant) -> Server {
    let read = |index| std::fs::read(experiment().join(format!("frames/{index:05}.jpg"))).unwrap();
    let pictures: Vec<Vec<u8>> = (0..FRAMES).map(read).collect();
    Server::start(address, move |stream, stop| {
        stream.set_nonblocking(false)?;
        stream.set_read_timeout(Some(Duration::from_secs(2)))?;
        let _ = stream.read(&mut [0; 4096])?;
        stream.write_all(b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n\r\n")?;
        while !stop.load(Ordering::Relaxed) {
            // Where the path's frames lie.
            let picture = &pictures[(share(began) * FRAMES as f64) as usize % FRAMES as usize];
            write!(stream, "--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n", picture.len())?;
            stream.write_all(picture)?;
            stream.write_all(b"\r\n")?;
            std::thread::sleep(Duration::from_secs_f64(1.0 / FPS));
        }
        Ok(())
    })
}

/// Encoder lines at 100 Hz, by a clock of their own that began 5000 s before the test. The frames stand still between
/// their instants, and so do the readings.
fn encoder_lines(began: Instant) -> Server {
    Server::start("127.0.0.1:0", move |stream, _| {
        stream.set_nonblocking(false)?;
        let frame = (share(began) * FRAMES as f64).floor() / FRAMES as f64;
        let q = lab::encoders(frame);
        writeln!(stream, "{:.4},{:.6},{:.6},{:.6}", 5000.0 + began.elapsed().as_secs_f64(), q.x, q.y, q.z)?;
        std::thread::sleep(Duration::from_millis(10));
        Ok(())
    })
}

#[test]
fn a_network_camera_that_goes_away_is_met_again() {
    experiment();
    let began = Instant::now();
    let first = camera("127.0.0.1:0", began);
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
    let again = camera(&address.to_string(), began);
    let state = live.until("the return", |state| state["source"]["state"] == "running");
    let took = returned.elapsed();
    println!("frames came again after {:.2} s", took.as_secs_f64());
    assert!(took < Duration::from_secs(2), "{took:?}");
    assert_eq!(state["source"]["reconnects"], 1);
    live.until("more frames", |state| state["source"]["frames"].as_u64() > frames.as_u64());
    drop((again, encoders));
    assert!(live.finish().success());
}

#[test]
fn a_video_file_is_played_to_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let video = folder.path().join("ride.avi");
    let fourcc = VideoWriter::fourcc('M', 'J', 'P', 'G').unwrap();
    let mut writer = VideoWriter::new(video.to_str().unwrap(), fourcc, 4.0, Size::new(640, 360), true).unwrap();
    for index in 0..FRAMES {
        let picture = image::open(experiment().join(format!("frames/{index:05}.jpg"))).unwrap().to_rgb8();
        let bgr: Vec<Vec3b> = picture.pixels().map(|pixel| Vec3b::from([pixel[2], pixel[1], pixel[0]])).collect();
        writer.write(&Mat::new_rows_cols_with_data(360, 640, &bgr).unwrap()).unwrap();
    }
    writer.release().unwrap();
    // The experiment's log is by index, and so is a video.
    let live = Live::start(&folder.path().join("out"), &["--source", video.to_str().unwrap()]);
    let state = live.until("the end", |state| state["ended"] == true);
    assert_eq!(state["source"]["frames"], FRAMES);
    assert_learned(&state);
    assert!(live.finish().success());
}
