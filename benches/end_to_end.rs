//! Ratios and scaling of one run: `run` beside decoding alone, measuring beside reading the pixels, time and memory over the number of
//! frames. `tools/bench` calls it and says how busy the machine was.
//!
//! `BENCH_FRAMES="100 1000" cargo bench --no-default-features --features cli --bench end_to_end`

use nalgebra::Matrix2;
use rayon::prelude::*;
use snakeloop::camera::{Frame, Lens, Samples, read_frame};
use snakeloop::estimate::{Estimator, Options};
use snakeloop::geometry::Configuration;
use snakeloop::measure::{Eye, RigOptions, calibrate_rig};
use snakeloop::observation::EncoderReading;
use snakeloop::record::{encoders_csv, read_encoders, read_measurements};
use snakeloop::robot::table::{Grid, compensation_table};
use snakeloop::robot::{Estimate, Model};
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

fn bundled(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/bending").join(name)
}

/// Least time of a call, s, over two seconds: other work on the machine can only add to it.
fn least<T>(mut work: impl FnMut() -> T) -> f64 {
    // What takes less than the clock can tell is called many times over.
    let mut calls = 1;
    let mut time = |calls: u32| {
        let started = Instant::now();
        (0..calls).for_each(|_| drop(black_box(work())));
        started.elapsed().as_secs_f64() / f64::from(calls)
    };
    while time(calls) * f64::from(calls) < 20e-6 {
        calls *= 2;
    }
    let (began, mut least) = (Instant::now(), f64::INFINITY);
    while began.elapsed() < Duration::from_secs(2) {
        least = least.min(time(calls));
    }
    least
}

fn show(what: &str, seconds: f64, asked: &str) {
    let value = match seconds {
        s if s < 1e-3 => format!("{:.2} µs", 1e6 * s),
        s => format!("{:.2} ms", 1e3 * s),
    };
    println!("{what:<44} {value:>12}  {asked}");
}

fn steps(frame: &Path) {
    let lens = Lens::read(&bundled("camera.yaml")).unwrap();
    let robot = Model::default().robot;
    let options = RigOptions { grid_pitch_mm: 1.0, standoff_mm: 25.0, delta_offset: 0.0 };
    let rig = calibrate_rig(&read_frame(&bundled("straight.jpg")).unwrap(), &lens, &robot, &options).unwrap();
    let eye = Eye::new(lens, rig, robot);
    let frame: Frame = read_frame(frame).unwrap();
    let last = eye.measure(&frame).bend.unwrap().vector * 0.97;
    let Samples::Bits8(samples) = &frame.samples else { unreachable!("the bundled frames have 8 bits") };
    let pass = least(|| black_box(samples).iter().map(|&v| f32::from(v)).sum::<f32>());
    let measure = least(|| eye.measure(&frame));
    let track = least(|| eye.track(&frame, last));
    show("one pass over a decoded frame's pixels", pass, "");
    show("measuring a decoded frame", measure, &format!("{:.1} passes (asked: at most 10)", measure / pass));
    show("tracking a decoded frame", track, &format!("{:.1} passes (asked: at most 3)", track / pass));

    let covariance = Matrix2::from_diagonal_element(1e-6);
    let estimate = Estimate { eta: 1.221, lambda_mm: 0.1765, covariance, samples: 17 };
    let model = Model { estimate: Some(estimate), ..Model::default() };
    let psi = Configuration::from_degrees(60.0, 35.0);
    let q_tilde_mm = model.command(psi);
    show("the forward problem", least(|| model.forward(black_box(&q_tilde_mm)).unwrap()), "(asked: at most 20 µs)");
    let grid = Grid { theta: "0:90:0.5".parse().unwrap(), delta: "-180:180:1".parse().unwrap() };
    let table = compensation_table(&model, &grid).unwrap().len();
    assert_eq!(table, 181 * 361);
    show("a table of 181 × 361 poses", least(|| compensation_table(&model, &grid)), "(asked: at most 30 ms)");
}

/// How long an update of η and λ takes, s, over the rows of a run; what the first votes cost is shared out among them.
fn update(out: &Path, encoders: &Path) -> f64 {
    let measurements = read_measurements(&out.join("measurements.csv")).unwrap().rows;
    let readings = read_encoders(encoders, 3).unwrap().rows;
    let rows: Vec<_> = measurements.iter().zip(&readings).collect();
    let seconds = least(|| {
        let mut estimator = Estimator::new(&Model::default(), Options::default()).unwrap();
        for (measurement, reading) in &rows {
            estimator.update(measurement, Some(reading));
        }
        estimator
    });
    seconds / rows.len() as f64
}

/// An experiment of so many frames: the same pictures under other numbers.
fn experiment(folder: &Path, pictures: &[PathBuf], count: usize) -> Vec<PathBuf> {
    let readings = read_encoders(&bundled("encoders.csv"), 3).unwrap().rows;
    std::fs::create_dir_all(folder.join("frames")).unwrap();
    let suffix = pictures[0].extension().unwrap().to_str().unwrap();
    for name in ["camera.yaml", "straight.jpg"] {
        std::fs::copy(bundled(name), folder.join(name)).unwrap();
    }
    let settings =
        std::fs::read_to_string(bundled("experiment.toml")).unwrap().replace("*.jpg", &format!("*.{suffix}"));
    std::fs::write(folder.join("experiment.toml"), settings).unwrap();
    let of = |index: usize| EncoderReading {
        index: index as u64,
        time_s: 0.1 * index as f64,
        ..readings[index % pictures.len()]
    };
    let log: Vec<EncoderReading> = (0..count).map(of).collect();
    std::fs::write(folder.join("encoders.csv"), encoders_csv(&log, 3)).unwrap();
    let frames: Vec<PathBuf> = (0..count).map(|index| folder.join(format!("frames/{index:06}.{suffix}"))).collect();
    for (index, frame) in frames.iter().enumerate() {
        std::fs::hard_link(&pictures[index % pictures.len()], frame).unwrap();
    }
    frames
}

/// Frames/s of `run`, its peak memory in MB, and the seconds it took in all.
fn run(experiment: &Path, out: &Path) -> (f64, f64, f64) {
    let began = Instant::now();
    let arguments = ["--json", "--quiet", "run", experiment.to_str().unwrap(), "-o", out.to_str().unwrap()];
    let mut child = Command::new(env!("CARGO_BIN_EXE_snakeloop"))
        .args(arguments)
        .args(["--overlays", "none"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let status = format!("/proc/{}/status", child.id());
    let mut most_kb = 0.0_f64;
    while child.try_wait().unwrap().is_none() {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or_default();
        most_kb = most_kb.max(line.trim_end_matches("kB").trim().parse().unwrap_or(0.0));
        std::thread::sleep(Duration::from_millis(20));
    }
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    (summary["frames_per_second"].as_f64().unwrap(), most_kb / 1000.0, began.elapsed().as_secs_f64())
}

/// Frames/s of reading and decoding alone, on all cores.
fn decode(frames: &[PathBuf]) -> f64 {
    let began = Instant::now();
    frames.par_iter().for_each(|frame| {
        black_box(read_frame(frame).unwrap());
    });
    frames.len() as f64 / began.elapsed().as_secs_f64()
}

fn main() {
    let counts = std::env::var("BENCH_FRAMES").unwrap_or_else(|_| "100 1000".into());
    let counts: Vec<usize> = counts.split_whitespace().map(|count| count.parse().unwrap()).collect();
    let lab = tempfile::tempdir().unwrap();
    let jpeg: Vec<PathBuf> = read_encoders(&bundled("encoders.csv"), 3)
        .unwrap()
        .rows
        .iter()
        .map(|row| {
            let (from, to) =
                (bundled(&format!("frames/{:05}.jpg", row.index)), lab.path().join(format!("{}.jpg", row.index)));
            std::fs::copy(from, &to).unwrap();
            to
        })
        .collect();
    let png: Vec<PathBuf> = jpeg
        .iter()
        .map(|path| {
            let to = path.with_extension("png");
            image::open(path).unwrap().to_rgb8().save(&to).unwrap();
            to
        })
        .collect();

    println!("\n== steps, 1280×720, the least of two seconds");
    steps(&jpeg[2]);
    println!("\n== `run` beside decoding alone, {} cores (asked: at least 0.8)", rayon::current_num_threads());
    for (kind, pictures) in [("JPEG", &jpeg), ("PNG", &png)] {
        let folder = lab.path().join(kind);
        let frames = experiment(&folder, pictures, counts[0]);
        let (before, (whole, ..), after) = (decode(&frames), run(&folder, &folder.join("out")), decode(&frames));
        let alone = before.max(after);
        println!("{kind:<5} run {whole:>6.1} frames/s, decoding alone {alone:>6.1} frames/s: {:.2}", whole / alone);
    }
    println!("\n== scaling of `run`, JPEG, and of one update of η and λ (asked: at most 2 µs)");
    for count in counts {
        let folder = lab.path().join(count.to_string());
        experiment(&folder, &jpeg, count);
        let (rate, most_mb, seconds) = run(&folder, &folder.join("out"));
        let update_us = 1e6 * update(&folder.join("out"), &folder.join("encoders.csv"));
        println!(
            "{count:>6} frames  {seconds:>8.1} s  {:>6.2} ms a frame  peak {most_mb:>6.1} MB  an update {update_us:>5.2} µs",
            1000.0 / rate
        );
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
