//! A numbered sequence of pictures: what is written, what survives a kill, who is let in.

use super::fixture::{self, Live, assert_learned, experiment};
use crate::program::{Sandbox, all_said, text};
use snakeloop::geometry::Configuration;
use snakeloop::record::{read_encoders, read_measurements, read_model, write_model};
use snakeloop::robot::{Effect, Model};
use std::collections::BTreeSet;
use std::f64::consts::TAU;
use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// The indices in a journal, which must be in order.
pub fn journaled(output: &std::path::Path) -> Vec<u64> {
    let text = fs::read_to_string(output.join("journal.jsonl")).unwrap();
    let whole = text.split_inclusive('\n').filter(|line| line.ends_with('\n'));
    let entries = whole.map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
    let indices: Vec<u64> = entries.filter_map(|entry| entry["index"].as_u64()).collect();
    assert!(indices.windows(2).all(|pair| pair[0] < pair[1]), "{indices:?}");
    indices
}

#[test]
fn a_killed_run_goes_on_with_all_but_the_frame_in_hand() {
    let sandbox = Sandbox::new();
    let output = sandbox.join("out");
    let mut live = Live::start(&output, &["--rate", "6"]);
    let before = live.until("eight measurements", |state| state["measurements"].as_u64() >= Some(8));
    live.kill();
    let kept = journaled(&output);
    let shown = before["latest"]["index"].as_u64().unwrap();
    assert!(kept.contains(&shown) && kept.len() as u64 >= before["measurements"].as_u64().unwrap());

    // A journal in the way is not overwritten.
    assert!(sandbox.fail(&format!("live {} -o out", text(experiment())), 1).contains("--resume"));

    // What a kill in the middle of a write leaves.
    let mut journal = fs::OpenOptions::new().append(true).open(output.join("journal.jsonl")).unwrap();
    journal.write_all(b"{\"index\":999,\"time_s\":3.").unwrap();
    let live = Live::start(&output, &["--rate", "6", "--resume"]);
    let state = live.until("the end", |state| state["ended"] == true);
    assert_eq!(state["resumed"].as_u64().unwrap(), kept.len() as u64);
    assert_learned(&state);
    let verdict = &state["verdict"];
    assert!(verdict["level"] == "good" || verdict["level"] == "look", "{verdict:#}");
    assert!(live.finish().success());
    let all = journaled(&output);
    assert_eq!(all[..kept.len()], kept);
    assert!(all.len() > kept.len() && all.last() < Some(&fixture::FRAMES));
    let written = read_measurements(&output.join("measurements.csv")).unwrap().rows;
    assert_eq!(written.iter().map(|m| m.index).collect::<Vec<_>>(), all);
    assert_eq!(read_encoders(&output.join("encoders.csv"), 3).unwrap().rows.len(), all.len());
    assert!(read_model(&output.join("model.toml")).unwrap().estimate().is_some());
    assert!(output.join("compensation.json").exists());
}

#[test]
fn readings_from_a_file_are_matched_by_time_and_the_machine_interface_tells() {
    let folder = tempfile::tempdir().unwrap();
    let lines = folder.path().join("readings.jsonl");
    let rate = 6.0;
    let reading = |k: u32| {
        let time_s = f64::from(k) / 50.0;
        let q = fixture::encoders(time_s * rate / fixture::FRAMES as f64);
        format!("{{\"time_s\":{time_s},\"q_mm\":[{},{},{}]}}\n", q[0], q[1], q[2])
    };
    fs::write(&lines, (0..500).map(reading).collect::<String>()).unwrap();
    let out = folder.path().join("out");
    let live = Live::start(&out, &["--rate", "6", "--save-every", "1", "--encoders", lines.to_str().unwrap()]);
    live.until("measurements", |state| state["measurements"].as_u64() >= Some(3));

    let (status, _) = live.ask("POST", "/api/command/pause", "Origin: http://localhost\r\n", "");
    assert_eq!((status, &live.get("/api/state")["paused"]), (200, &true.into()));
    let paused = live.get("/api/state")["measurements"].clone();
    std::thread::sleep(Duration::from_millis(600));
    let later = live.get("/api/state")["measurements"].clone();
    assert!(later.as_u64().unwrap() <= paused.as_u64().unwrap() + 1, "paused");
    live.ask("POST", "/api/command/continue", "", "");

    let state = live.until("the end", |state| state["ended"] == true);
    assert_learned(&state);
    // All lines were there before the first frame, and say nothing of the clock.
    assert_eq!((&state["encoders"]["offset_s"], state["encoders"]["clock"] == "foreign"), (&0.0.into(), false));
    assert_eq!(state["encoders"]["readings"], 500);
    let all = live.get("/api/measurements");
    let rows = all["measurements"].as_array().unwrap();
    assert_eq!(rows.len() as u64, state["measurements"].as_u64().unwrap());
    let third = rows[2]["index"].as_u64().unwrap();
    let rest = live.get(&format!("/api/measurements?since={third}"));
    assert_eq!(rest["measurements"].as_array().unwrap().len(), rows.len() - 3);
    for row in rows {
        let (seen, expected) = (&row["theta_deg"], &row["expected_theta_deg"]);
        assert_eq!(row["status"], "ok");
        assert!(row["verdict"] != "used" || seen.is_number() && expected.is_number(), "{row}");
    }
    let model = live.get("/api/model");
    // Where the last measurements did not confirm the model, on a machine too busy to measure all, it is the one before them.
    assert!(model["stale"].is_string() || model["estimate"]["eta"] == state["estimate"]["eta"], "{model:#} {state:#}");
    let table = live.get("/api/table?theta=30&delta=-15");
    let truth = fixture::robot().command(snakeloop::geometry::Configuration::from_degrees(30.0, -15.0));
    for (k, truth) in truth.iter().enumerate() {
        assert!((table["qc_mm"][k].as_f64().unwrap() - truth).abs() < 0.05, "{table}");
    }
    // As far as `table` goes.
    assert_eq!(live.get("/api/table?theta=120&delta=0")["theta_deg"].as_f64().map(f64::round), Some(120.0));
    assert_eq!(live.ask("GET", "/api/table?theta=120.1&delta=0", "", "").0, 400);
    // What a client asks for and the program does not know is not passed over.
    for asked in [
        "theta=30&delta=0&units=rad",
        "theta=30,5&delta=0",
        "theta=30",
        "theta=30&delta=1e18",
        "theta_deg=30&delta_deg=0",
    ] {
        let (status, body) = live.ask("GET", &format!("/api/table?{asked}"), "", "");
        assert!(status == 400 && body.contains("expected") && body.contains("degrees"), "{asked}: {status} {body}");
    }
    assert_a_picture_comes_with_the_head_behind_it(&live);
    let (status, metrics) = live.ask("GET", "/metrics", "", "");
    assert_eq!(status, 200);
    for line in metrics.lines().filter(|line| !line.starts_with('#')) {
        let (name, value) = line.rsplit_once(' ').unwrap();
        assert!(name.starts_with("snakeloop_") && value.parse::<f64>().is_ok(), "{line}");
    }
    assert!(metrics.contains(&format!("snakeloop_latency_seconds_count {}", rows.len())));
    assert!(live.finish().success());
}

/// Chromium shows a picture once it has seen the head of the part behind it: that comes with the picture, and not with the next one, which
/// never comes once the recording is over.
fn assert_a_picture_comes_with_the_head_behind_it(live: &Live) {
    let mut stream = TcpStream::connect(live.address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    write!(stream, "GET /video.mjpg HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
    let mut seen = Vec::new();
    let head = b"--picture\r\nContent-Type: image/jpeg\r\n\r\n";
    let heads = |seen: &[u8]| seen.windows(head.len()).filter(|bytes| bytes == head).count();
    while heads(&seen) < 2 {
        let mut piece = [0; 4096];
        let read = stream.read(&mut piece).expect("the head behind the picture does not come");
        assert!(read > 0, "the stream ended");
        seen.extend_from_slice(&piece[..read]);
    }
    assert_eq!(seen.windows(2).filter(|bytes| bytes == b"\xff\xd9").count(), 1, "one JPEG");
}

#[test]
fn idle_and_slow_clients_hold_up_nobody_and_strangers_are_refused() {
    let sandbox = Sandbox::new();
    let live = Live::start(&sandbox.join("out"), &["--rate", "2"]);
    let mut guests = Vec::new();
    for k in 0..50 {
        let mut stream = TcpStream::connect(live.address).unwrap();
        // Silent ones, half a request, and streams that are asked for and never read.
        let said = match k % 4 {
            0 => "",
            1 => "GET / HTTP/1.1\r\nHost: local",
            2 => "GET /api/events HTTP/1.1\r\nHost: localhost\r\n\r\n",
            _ => "GET /video.mjpg HTTP/1.1\r\nHost: localhost\r\n\r\n",
        };
        stream.write_all(said.as_bytes()).unwrap();
        guests.push(stream);
    }
    let first = live.get("/api/state")["measurements"].as_u64();
    let mut slowest = Duration::ZERO;
    let mut seen = BTreeSet::new();
    for _ in 0..20 {
        let asked = Instant::now();
        seen.insert(live.get("/api/state")["measurements"].as_u64());
        slowest = slowest.max(asked.elapsed());
        std::thread::sleep(Duration::from_millis(150));
    }
    assert!(slowest < Duration::from_secs(2), "an answer took {slowest:?}");
    assert!(seen.last().unwrap() > &first, "measuring goes on: {seen:?}");

    let status = |method: &str, target: &str, headers: &str, body: &str| live.ask(method, target, headers, body).0;
    assert_eq!(status("GET", "/", "Host: evil.example\r\n", ""), 403);
    assert_eq!(status("POST", "/api/command/reset", "Origin: http://evil.example\r\n", ""), 403);
    assert_eq!(status("POST", "/api/command/dance", "", ""), 404);
    assert_eq!(status("GET", "/api/command/reset", "", ""), 405);
    assert_eq!(status("GET", "/nowhere", "", ""), 404);
    let long = format!("X-Long: {}\r\n", "a".repeat(100_000));
    assert!((400..500).contains(&status("GET", "/", &long, "")));

    // Beyond loopback a token is needed, and nothing is done before that is settled.
    let open = format!("live {} -o nowhere --serve 0.0.0.0:0", text(experiment()));
    assert!(sandbox.fail(&open, 2).contains("--token-file"));
}

#[test]
fn an_effect_that_the_model_lacks_raises_an_alarm_and_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let (experiment, output) = (folder.path().join("experiment"), folder.path().join("out"));
    fs::create_dir(&experiment).unwrap();
    let hidden = Effect::parse("load_directed_backlash:play_mm=0.15").unwrap();
    let robot = Model { effects: vec![hidden], ..fixture::robot() };
    // Round and round, and meanwhile out and back.
    let bend = |k: usize| {
        let (turn, out) = (k as f64 / 20.0 * TAU, k as f64 / 33.0 * TAU);
        Configuration::new(0.75 - 0.5 * out.cos(), turn)
    };
    fixture::write(&experiment, &robot, &(0..64).map(bend).collect::<Vec<_>>());
    let live = Live::start_on(&experiment, &output, &["--rate", "6"]);
    let state = live.until("the gap", |state| state["gap"]["state"] == "above");
    assert!(state["notices"].to_string().contains("has left the noise"), "{state:#}");
    let state = live.until("a name", |state| state["discovery"]["verdict"] == "named");
    let found = &state["discovery"];
    assert_eq!(found["details"]["effects"][0]["name"], "load_directed_backlash", "{found:#}");
    assert!(found["sentence"].as_str().unwrap().contains("load_directed_backlash"), "{found:#}");
    let play = found["details"]["effects"][0]["parameters"]["play_mm"]["value"].as_f64().unwrap();
    assert!((play - 0.15).abs() < 0.05, "{found:#}");
    // What is named beside it, such as the 0.08° by which the eye itself errs in pictures as small as these, takes hardly anything of the gap away.
    let others = found["details"]["effects"].as_array().unwrap()[1..].iter();
    assert!(others.clone().all(|effect| effect["removes"].as_f64().unwrap() < 0.01), "{found:#}");
    // The model with it is offered as a file.
    let model = read_model(&output.join("discovered.toml")).unwrap();
    assert_eq!(model.effects.len(), 1 + others.len());
    assert_eq!(model.effects[0].physics.name, "load_directed_backlash");
}

#[test]
fn a_flexible_stem_is_followed_with_eta_and_lambda_as_they_are() {
    const PHI_DEG: f64 = 160.0;
    let folder = tempfile::tempdir().unwrap();
    let (experiment, output) = (folder.path().join("experiment"), folder.path().join("out"));
    fs::create_dir(&experiment).unwrap();
    let mut bent = fixture::robot();
    bent.robot.line = bent.robot.line.bent_through(PHI_DEG.to_radians());
    let bends: Vec<Configuration> =
        (0..fixture::FRAMES).map(|k| fixture::path(k as f64 / fixture::FRAMES as f64)).collect();
    fixture::write(&experiment, &bent, &bends);
    let known = folder.path().join("known.toml");
    write_model(&known, &fixture::robot()).unwrap();

    let live = Live::start_on(&experiment, &output, &["--rate", "6", "--stem", "--model", known.to_str().unwrap()]);
    let state = live.until("the end", |state| state["ended"] == true);
    let (phi, sd) = (state["stem"]["phi_deg"].as_f64().unwrap(), state["stem"]["sd_phi_deg"].as_f64().unwrap());
    assert!((phi - PHI_DEG).abs() < 4.0 * sd && sd < 20.0, "{phi} ± {sd}, it is {PHI_DEG}°");
    assert_eq!(state["estimate"]["eta"], fixture::ETA, "η is not touched");
    let rows = live.get("/api/measurements");
    let rows = rows["measurements"].as_array().unwrap();
    assert_eq!(rows.last().unwrap()["stem"], state["stem"]);
    assert!(live.ask("GET", "/metrics", "", "").1.contains("snakeloop_stem_degrees "));
    assert!(live.finish().success());

    let written = fs::read_to_string(output.join("stem.csv")).unwrap();
    assert_eq!(written.lines().count(), 1 + rows.len());
    let last: Vec<&str> = written.lines().last().unwrap().split(',').collect();
    assert!((last[2].parse::<f64>().unwrap() - phi).abs() < 1e-3, "{written}");
    let line = read_model(&output.join("model.toml")).unwrap().robot.line;
    assert!((line.total_angle().to_degrees() - phi).abs() < 1e-6);
}

/// The picture stored on its side, with a mark (EXIF) that asks to turn it back.
fn on_its_side(jpeg: &[u8]) -> Vec<u8> {
    let turned = image::load_from_memory(jpeg).unwrap().rotate270();
    let mut stored = std::io::Cursor::new(Vec::new());
    turned.write_with_encoder(image::codecs::jpeg::JpegEncoder::new_with_quality(&mut stored, 95)).unwrap();
    let mark = b"\xff\xe1\0\x22Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
    let stored = stored.into_inner();
    [&stored[..2], mark, &stored[2..]].concat()
}

#[test]
fn files_are_played_and_lines_read_by_the_rules_of_run() {
    let sandbox = Sandbox::new();
    sandbox.copy_bending(&[0, 8, 17, 26]);
    for index in [0, 8, 17] {
        let path = sandbox.join(&format!("bending/frames/{index:05}.jpg"));
        fs::write(&path, on_its_side(&fs::read(&path).unwrap())).unwrap();
    }
    let cut = sandbox.join("bending/frames/00026.jpg");
    let bytes = fs::read(&cut).unwrap();
    fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    let log = "[log]\ntime = \"t_ms\"\ntime_unit = \"ms\"\nq = [\"m1\", \"m2\", \"m3\"]\nunit = \"rad\"\ndrum_radius_mm = 8.0\n";
    let settings = sandbox.read("bending/experiment.toml");
    sandbox.write("bending/experiment.toml", &settings.replacen("[[view]]", &format!("{log}[[view]]"), 1));
    let lines: String = (0..200).map(|k| format!("{k},{},0.1,-0.2,0.3\n", 10 * k)).collect();
    sandbox.write("lines.csv", &format!("n,t_ms,m1,m2,m3\n{lines}"));

    let output = sandbox.call("live bending -o out --rate 10 --encoders lines.csv --encoder-offset 0");
    let said = all_said(&output);
    let measured: Vec<String> =
        sandbox.measurements("out/measurements.csv").iter().map(|m| m.status.to_string()).collect();
    assert_eq!(measured, ["ok", "ok", "ok", "unreadable"], "{said}");
    for words in ["a mark that asks to turn them; they are turned so", "00026.jpg: the JPEG file is cut short"] {
        assert!(said.contains(words), "{said}");
    }
    for reading in read_encoders(&sandbox.join("out/encoders.csv"), 3).unwrap().rows {
        assert!((reading.q_mm - snakeloop::robot::PerBackbone::from([0.8, -1.6, 2.4])).norm() < 1e-6, "{reading:?}");
    }

    // Frames of another size, and no readings: neither is blamed on the other.
    sandbox.write("bending/experiment.toml", &settings);
    image::open(sandbox.join("bending/straight.jpg"))
        .unwrap()
        .thumbnail(640, 360)
        .save(sandbox.join("small_0.png"))
        .unwrap();
    let said = all_said(&sandbox.call("live bending -o small --source small_%d.png"));
    assert!(said.contains("0 measured of 1") && said.contains("wrong_size: the picture has another size"), "{said}");
    let said = all_said(&sandbox.call("live bending -o blind --rate 10 --encoders nothing.csv"));
    assert!(said.contains("3 frames were measured, and none has an encoder reading"), "{said}");
}
