//! What goes wrong beside a running `live`: encoders that freeze, a camera that trickles, crowds of clients, folders in use or removed.

use super::fixture::{self, FRAMES, Live, experiment};
use super::streams::{Server, begin_pictures, send_picture, share};
use crate::faults::fixture::copy_folder;
use crate::program::{Sandbox, all_said, text};
use snakeloop::record::read_model;
use std::fs;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// The most that an end may take after it was asked for: two seconds, and what a busy machine adds to it.
const END: Duration = Duration::from_secs(3);

/// Ends a run as Ctrl-C does, which must not take long.
fn end(live: Live) {
    let asked = Instant::now();
    assert!(live.finish().success());
    assert!(asked.elapsed() < END, "it took {:?}", asked.elapsed());
}

/// Lines in a journal.
fn entries(output: &Path) -> usize {
    fs::read_to_string(output.join("journal.jsonl")).unwrap_or_default().lines().count()
}

#[test]
fn a_folder_in_use_crowds_and_a_removed_folder_cost_nothing() {
    let sandbox = Sandbox::new();
    sandbox.copy_bending(&[2]);
    let output = sandbox.join("out");
    let live = Live::start(&output, &["--rate", "2"]);
    live.until("measurements", |state| state["measurements"].as_u64() >= Some(2));

    let again = format!("live {} -o out --resume", text(experiment()));
    assert!(sandbox.fail(&again, 1).contains("another call of snakeloop is working"));

    // One calibration at a time; the others are told to wait.
    let (said, answers) = std::sync::mpsc::channel();
    for _ in 0..6 {
        let (said, address) = (said.clone(), live.address);
        std::thread::spawn(move || {
            let mut stream = TcpStream::connect(address).unwrap();
            write!(stream, "POST /api/command/reference HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
                .unwrap();
            let mut answer = String::new();
            let _ = stream.read_to_string(&mut answer);
            let _ = said.send(answer);
        });
    }
    for _ in 0..5 {
        let answer = answers.recv_timeout(Duration::from_secs(10)).unwrap();
        assert!(answer.starts_with("HTTP/1.1 409") && answer.contains("already; wait for it"), "{answer}");
    }

    // Streams have a bound, and leave room for others.
    let listening = |target: &str| {
        let mut stream = TcpStream::connect(live.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        write!(stream, "GET {target} HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
        let mut head = [0; 12];
        stream.read_exact(&mut head).unwrap();
        (stream, String::from_utf8_lossy(&head).into_owned())
    };
    let crowd: Vec<_> = (0..70).map(|k| listening(if k % 2 == 0 { "/api/events" } else { "/video.mjpg" })).collect();
    assert_eq!(crowd.iter().filter(|(_, head)| head.ends_with("503")).count(), 6);
    assert!(live.get("/api/state")["measurements"].is_u64());
    drop(crowd);

    // Connections that ask for nothing make room for those that do.
    let silent = |_| {
        let mut stream = TcpStream::connect(live.address).unwrap();
        let _ = stream.write_all(b"GET /api");
        stream
    };
    let idle: Vec<TcpStream> = (0..150).map(silent).collect();
    for _ in 0..10 {
        assert!(live.get("/api/state")["measurements"].is_u64());
    }
    drop(idle);

    // The folder is removed: the journal is back within seconds, with all that it had.
    let before = entries(&output);
    fs::remove_dir_all(&output).unwrap();
    let deadline = Instant::now() + Duration::from_secs(5);
    while entries(&output) < before {
        assert!(Instant::now() < deadline, "{} of {before} entries", entries(&output));
        std::thread::sleep(Duration::from_millis(50));
    }
    live.until("the notice", |state| state["notices"].to_string().contains("was removed"));

    // A file stands in its place: that is told once, and the folder is back when it can be.
    let aside = sandbox.join("aside");
    fs::rename(&output, &aside).unwrap();
    fs::write(&output, "").unwrap();
    let state = live.until("the notice", |state| state["notices"].to_string().contains("cannot be written to"));
    std::thread::sleep(Duration::from_millis(2500));
    let told = |state: &serde_json::Value| state["notices"].to_string().matches("cannot be written to").count();
    assert_eq!((told(&state), told(&live.get("/api/state"))), (1, 1));
    fs::remove_file(&output).unwrap();
    let deadline = Instant::now() + Duration::from_secs(5);
    while entries(&output) < before {
        assert!(Instant::now() < deadline, "{} of {before} entries", entries(&output));
        std::thread::sleep(Duration::from_millis(50));
    }
    assert!(sandbox.fail(&again, 1).contains("another call of snakeloop is working"));
    end(live);

    let other = sandbox.fail("live bending -o out --resume", 1);
    assert!(other.contains("journal.jsonl") && other.contains("would mix"), "{other}");
}

/// What happens to camera and encoders.
#[derive(Default)]
struct Faults {
    frozen: AtomicBool,
    trickles: AtomicBool,
}

/// A camera that shows the path, and sends a byte at a time once it trickles; and encoders that stand still once they are frozen.
fn camera_and_encoders(faults: &Arc<Faults>) -> (Server, Server) {
    let began = Instant::now();
    let read = |index| fs::read(experiment().join(format!("frames/{index:05}.jpg"))).unwrap();
    let pictures: Vec<Vec<u8>> = (0..FRAMES).map(read).collect();
    let of_camera = Arc::clone(faults);
    let camera = Server::start("127.0.0.1:0", move |stream, stop| {
        begin_pictures(stream)?;
        stream.write_all(b"--frame\r\n")?;
        while !stop.load(Ordering::Relaxed) {
            if of_camera.trickles.load(Ordering::Relaxed) {
                stream.write_all(b"x")?;
            } else {
                let picture = &pictures[(share(began) * FRAMES as f64) as usize % FRAMES as usize];
                send_picture(stream, picture)?;
            }
            std::thread::sleep(Duration::from_millis(100));
        }
        Ok(())
    });
    let (of_encoders, frozen_at) = (Arc::clone(faults), Mutex::new(None));
    let encoders = Server::start("127.0.0.1:0", move |stream, _| {
        stream.set_nonblocking(false)?;
        let now = share(began);
        let is_frozen = of_encoders.frozen.load(Ordering::Relaxed);
        let at = if is_frozen { *frozen_at.lock().unwrap().get_or_insert(now) } else { now };
        let q = fixture::encoders((at * FRAMES as f64).floor() / FRAMES as f64);
        writeln!(stream, "{:.4},{:.6},{:.6},{:.6}", began.elapsed().as_secs_f64(), q[0], q[1], q[2])?;
        std::thread::sleep(Duration::from_millis(10));
        Ok(())
    });
    (camera, encoders)
}

#[test]
fn frozen_encoders_leave_the_good_table_and_a_trickling_camera_lets_go() {
    experiment();
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("out");
    let faults = Arc::new(Faults::default());
    let (camera, encoders) = camera_and_encoders(&faults);
    let (stream, lines) = (format!("http://{}/", camera.address), format!("tcp://{}", encoders.address));
    let live = Live::start(&output, &["--source", &stream, "--encoders", &lines, "--save-every", "1"]);
    let known = || read_model(&output.join("model.toml")).ok().and_then(|model| model.estimate());
    live.until("a good table", |_| known().is_some_and(|estimate| estimate.sd_eta() < 0.03));
    faults.frozen.store(true, Ordering::Relaxed);
    let state = live.until("stuck", |state| state["publication"]["code"] == "encoder_stuck");
    assert_eq!(state["publication"]["state"], "stale", "{state:#}");
    let table = fs::read(output.join("compensation.csv")).unwrap();
    let told: serde_json::Value = serde_json::from_slice(&fs::read(output.join("publication.json")).unwrap()).unwrap();
    assert_eq!(told["state"], "stale");
    let model = fs::read_to_string(output.join("model.toml")).unwrap();
    // Who says it first, the watch over the readings or the verdict, is a matter of milliseconds.
    let mark = model.lines().next().unwrap();
    assert!(mark.starts_with("# stale: ") && mark.contains("stand still"), "{mark}");
    assert!(String::from_utf8_lossy(&table).lines().next().unwrap().ends_with(",stale"));
    // What stands in the folder is the last good one; nobody is told to command by it while encoders and picture contradict each other.
    let (status, refused) = live.ask("GET", "/api/table?theta=60&delta=0", "", "");
    assert!(status == 409 && refused.contains("stand still"), "{refused}");
    let pose = snakeloop::geometry::Configuration::from_degrees(60.0, 0.0);
    let kept = read_model(&output.join("model.toml")).unwrap().command(pose);
    assert!((kept - fixture::robot().command(pose)).amax() < 0.1, "{kept:?}");
    assert_eq!(live.ask("POST", "/api/command/save", "", "").0, 409);

    faults.trickles.store(true, Ordering::Relaxed);
    live.until("the camera lost", |state| state["source"]["state"] == "lost");
    assert!(fs::read(output.join("compensation.csv")).unwrap() == table);
    assert!(fs::read_to_string(output.join("live.log")).unwrap().contains("stale and stays as it is"));
    end(live);
    assert!(fs::read(output.join("compensation.csv")).unwrap() == table);
}

#[test]
fn without_a_dashboard_notices_are_said_and_a_port_in_use_leaves_nothing_behind() {
    let sandbox = Sandbox::new();
    let experiment = text(experiment());
    let port = TcpListener::bind("127.0.0.1:0").unwrap();
    let taken = format!("live {experiment} -o out --serve {}", port.local_addr().unwrap());
    assert!(sandbox.fail(&taken, 2).contains("--serve"));
    assert!(!sandbox.join("out").exists());

    let said = all_said(&sandbox.call(&format!("live {experiment} -o out --rate 5 --encoders tcp://127.0.0.1:1")));
    let refused = "tcp://127.0.0.1:1: Connection refused";
    assert!(said.contains(&format!("warning: no encoder readings come: {refused}")), "{said}");
    assert!(said.contains(&format!("encoders: {refused}")) && said.contains("(0 readings came"), "{said}");
    assert!(sandbox.read("out/live.log").contains("no encoder readings come"));
}

#[test]
fn what_an_earlier_run_left_is_neither_mixed_with_nor_taken_for_confirmed() {
    let sandbox = Sandbox::new();
    copy_folder(experiment(), &sandbox.join("lab"));
    sandbox.succeed("live lab -o out --rate 20");
    assert!(!sandbox.read("out/model.toml").starts_with("# stale"));
    // No reading comes: nothing confirms the table that stands there.
    fs::remove_file(sandbox.join("out/journal.jsonl")).unwrap();
    sandbox.succeed("live lab -o out --rate 20 --encoders tcp://127.0.0.1:1");
    assert!(sandbox.read("out/model.toml").starts_with("# stale: an earlier run left it"));
    assert!(sandbox.read("out/compensation.csv").lines().next().unwrap().ends_with(",stale"));
    // The columns turn out to be exchanged: what was read before that was written down is not gone on with.
    let settings = sandbox.read("lab/experiment.toml");
    sandbox.write("lab/experiment.toml", &format!("{settings}\n[wiring]\ncolumns = [1, 3, 2]\n"));
    let said = sandbox.fail("live lab -o out --rate 20 --resume", 1);
    assert!(said.contains("would mix") && said.contains("experiment.toml"), "{said}");
}
