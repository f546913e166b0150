//! Ratios and scaling of one run: measuring beside decoding, `run` beside decoding alone, time and memory over the number of frames.
//! `tools/bench` calls it and says how busy the machine was.
//!
//! `BENCH_FRAMES="100 1000" cargo bench --no-default-features --features cli --bench end_to_end`; `BENCH_JSON=FILE` writes the figures,
//! `BENCH_AGAINST=FILE` prints them beside those of another run.

use nalgebra::Matrix2;
use rayon::prelude::*;
use rustix::time::{ClockId, clock_gettime};
use snakeloop::camera::{Frame, Lens, Samples, read_frame};
use snakeloop::estimate::{Estimator, Options};
use snakeloop::geometry::Configuration;
use snakeloop::measure::{Eye, RigOptions, calibrate_rig};
use snakeloop::observation::EncoderReading;
use snakeloop::record::{encoders_csv, read_encoders, read_measurements};
use snakeloop::robot::table::{Grid, compensation_table};
use snakeloop::robot::{Estimate, Model};
use std::collections::BTreeMap;
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

/// Seconds of CPU that this thread has had.
fn thread_cpu_s() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// How often the steps of a frame are timed, each time one after the other, so that whatever else the machine does meets all of them alike, and of
/// the next of the seventeen bundled frames.
const REPETITIONS: usize = 51;

/// The median of some times and the quartiles beside it, ms.
#[derive(Clone, Copy)]
struct Timed {
    quartile_ms: f64,
    median_ms: f64,
    upper_quartile_ms: f64,
}

impl Timed {
    fn of(mut seconds: Vec<f64>) -> Self {
        seconds.sort_by(f64::total_cmp);
        let at = |share: f64| 1e3 * seconds[(share * (seconds.len() - 1) as f64) as usize];
        Self { quartile_ms: at(0.25), median_ms: at(0.5), upper_quartile_ms: at(0.75) }
    }
}

/// The figures of one run of the benchmark by their names.
type Figures = BTreeMap<String, f64>;

/// A step's name, whether its CPU time is told, and the step, for the frame of a number.
type Step<'a> = (&'static str, bool, Box<dyn FnMut(usize) + Send + 'a>);

/// The steps of a frame beside what reading and decoding it costs. What one thread computes is told in CPU time, what all of them do
/// together in time on the clock.
fn frame_steps(eye: &Eye, paths: &[PathBuf], figures: &mut Figures) {
    let bytes: Vec<Vec<u8>> = paths.iter().map(|path| std::fs::read(path).unwrap()).collect();
    let frames: Vec<Frame> = paths.iter().map(|path| read_frame(path).unwrap()).collect();
    // As far away as what the frame before it or an encoder reading would make expect.
    let last: Vec<_> = frames.iter().map(|frame| eye.measure(frame).bend.unwrap().vector * 0.97).collect();
    let samples = |k: usize| match &frames[k].samples {
        Samples::Bits8(samples) => samples,
        Samples::Bits16(_) => unreachable!("the bundled frames have 8 bits"),
    };
    let mut copy = samples(0).clone();
    let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();

    let mut steps: Vec<Step> = vec![
        (
            "byte_sum_ms",
            true,
            Box::new(|k| {
                black_box(black_box(samples(k)).iter().map(|&v| u32::from(v)).sum::<u32>());
            }),
        ),
        ("memcpy_ms", true, Box::new(|k| black_box(&mut copy).copy_from_slice(black_box(samples(k))))),
        (
            "decode_jpeg_ms",
            true,
            Box::new(|k| {
                black_box(image::load_from_memory(black_box(&bytes[k])).unwrap());
            }),
        ),
        ("measure_cpu_ms", true, Box::new(|k| drop(black_box(eye.measure(&frames[k]))))),
        ("expected_cpu_ms", true, Box::new(|k| drop(black_box(eye.measure_expected(&frames[k], last[k]))))),
        ("track_cpu_ms", true, Box::new(|k| drop(black_box(eye.track(&frames[k], last[k]))))),
        ("measure_wall_ms", false, Box::new(|k| drop(black_box(eye.measure(&frames[k]))))),
        ("track_wall_ms", false, Box::new(|k| drop(black_box(eye.track(&frames[k], last[k]))))),
    ];
    let mut times = vec![Vec::new(); steps.len()];
    for repetition in 0..REPETITIONS {
        let k = repetition % frames.len();
        for ((_, by_cpu, step), times) in steps.iter_mut().zip(&mut times) {
            times.push(if *by_cpu {
                alone.install(|| {
                    let before = thread_cpu_s();
                    step(k);
                    thread_cpu_s() - before
                })
            } else {
                let started = Instant::now();
                step(k);
                started.elapsed().as_secs_f64()
            });
        }
    }
    let timed: Vec<(&str, Timed)> =
        steps.iter().map(|(name, ..)| *name).zip(times.into_iter().map(Timed::of)).collect();
    let of = |wanted: &str| timed.iter().find(|(name, _)| *name == wanted).unwrap().1.median_ms;
    let (sum_ms, copy_ms, decode_ms) = (of("byte_sum_ms"), of("memcpy_ms"), of("decode_jpeg_ms"));
    println!("{:<18} {:>9} {:>19} {:>10} {:>8} {:>9}", "", "median", "quartiles", "byte sums", "memcpys", "decodings");
    for (name, Timed { quartile_ms, median_ms, upper_quartile_ms }) in &timed {
        println!(
            "{name:<18} {median_ms:>9.3} {quartile_ms:>9.3} {upper_quartile_ms:>9.3} {:>10.1} {:>8.1} {:>9.2}",
            median_ms / sum_ms,
            median_ms / copy_ms,
            median_ms / decode_ms
        );
        figures.insert((*name).to_owned(), *median_ms);
        figures.insert(name.replace("_ms", "_quartile_ms"), *quartile_ms);
        figures.insert(name.replace("_ms", "_upper_quartile_ms"), *upper_quartile_ms);
    }
}

fn steps(frames: &[PathBuf], figures: &mut Figures) {
    let lens = Lens::read(&bundled("camera.yaml")).unwrap();
    let robot = Model::default().robot;
    let options = RigOptions { grid_pitch_mm: 1.0, standoff_mm: 25.0, delta_offset: 0.0 };
    let rig = calibrate_rig(&read_frame(&bundled("straight.jpg")).unwrap(), &lens, &robot, &options).unwrap();
    // As in `run`.
    let sample = frames.par_iter().map(|path| read_frame(path).unwrap());
    frame_steps(&Eye::new(lens, rig, robot).refined(sample), frames, figures);

    let covariance = Matrix2::from_diagonal_element(1e-6);
    let estimate = Estimate { eta: 1.221, lambda_mm: 0.1765, covariance, samples: 17 };
    let model = Model::default().with_estimate(estimate);
    let psi = Configuration::from_degrees(60.0, 35.0);
    let q_tilde_mm = model.command(psi);
    show("the forward problem", least(|| model.forward(black_box(&q_tilde_mm)).unwrap()), "(asked: at most 20 µs)");
    let grid = Grid { theta: "0:90:0.5".parse().unwrap(), delta: "-180:179:1".parse().unwrap() };
    let table = compensation_table(&model, &grid).unwrap().len();
    assert_eq!(table, 181 * 360);
    show("a table of 181 × 360 poses", least(|| compensation_table(&model, &grid)), "(asked: at most 30 ms)");
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

/// How often `run` and decoding alone are timed in turn; medians are compared.
const ROUNDS: usize = 5;

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

    let mut figures = Figures::new();
    println!("\n== steps of a frame of 1280×720 in turn, ms: CPU time of one thread, and time on the clock with all");
    steps(&jpeg, &mut figures);
    println!("\n== `run` beside decoding alone, {} cores (asked: at least 0.8)", rayon::current_num_threads());
    for (kind, pictures) in [("JPEG", &jpeg), ("PNG", &png)] {
        let folder = lab.path().join(kind);
        let frames = experiment(&folder, pictures, counts[0]);
        let round = |round: usize| (decode(&frames), run(&folder, &folder.join(format!("out{round}"))).0);
        let rates: (Vec<f64>, Vec<f64>) = (0..ROUNDS).map(round).unzip();
        let [alone, whole] = <[Vec<f64>; 2]>::from(rates).map(|mut rates| {
            rates.sort_by(f64::total_cmp);
            rates[ROUNDS / 2]
        });
        println!("{kind:<5} run {whole:>6.1} frames/s, decoding alone {alone:>6.1} frames/s: {:.2}", whole / alone);
        figures.insert(format!("run_{}_over_decode", kind.to_lowercase()), whole / alone);
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
        figures.insert("update_us".to_owned(), update_us);
        let peak_mb = figures.entry("peak_mb".to_owned()).or_default();
        *peak_mb = peak_mb.max(most_mb);
        std::fs::remove_dir_all(&folder).unwrap();
    }
    if let Ok(path) = std::env::var("BENCH_AGAINST") {
        compare(&figures, Path::new(&path));
    }
    if let Ok(path) = std::env::var("BENCH_JSON") {
        std::fs::write(path, serde_json::to_string_pretty(&figures).unwrap()).unwrap();
    }
}

/// Prints the figures beside those of another run, and the ratio of both.
fn compare(figures: &Figures, other: &Path) {
    let text = std::fs::read_to_string(other).unwrap_or_else(|e| panic!("{}: {e}", other.display()));
    let before: Figures = serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", other.display()));
    println!("\n== against {}", other.display());
    for (name, now) in figures {
        if let Some(then) = before.get(name) {
            println!("{name:<30} {now:>10.3}, was {then:>10.3}: {:.2}", now / then);
        }
    }
}
