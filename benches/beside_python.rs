//! The Rust side of `tools/python-bench`: the same work that it does through the Python package, printed as JSON.
//!
//! `cargo bench --no-default-features --bench beside_python -- FOLDER [ROUNDS]`; FOLDER is `fixtures/bending`.

use nalgebra::Matrix2;
use rayon::prelude::*;
use snakeloop::camera::{Lens, read_frame};
use snakeloop::geometry::Configuration;
use snakeloop::measure::{Eye, RigOptions, calibrate_rig};
use snakeloop::robot::{Estimate, Mechanics, Model};
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

/// Poses of one call of the command; as in the script.
const POSES: usize = 1_000_000;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let folder = Path::new(arguments.first().map_or("fixtures/bending", String::as_str));
    let rounds: usize = arguments.get(1).map_or(5, |rounds| rounds.parse().expect("ROUNDS is a number"));

    let lens = Lens::read(&folder.join("camera.yaml")).unwrap();
    let robot = Model::default().robot;
    let options = RigOptions { grid_pitch_mm: 1.0, standoff_mm: 25.0, delta_offset: 0.0 };
    let rig = calibrate_rig(&read_frame(&folder.join("straight.jpg")).unwrap(), &lens, &robot, &options).unwrap();
    let eye = Eye::new(lens, rig, robot);
    let pattern = folder.join("frames/*.jpg");
    let paths = glob::glob(pattern.to_str().unwrap()).unwrap();
    let frames: Vec<_> = paths.map(|path| read_frame(&path.unwrap()).unwrap()).collect();
    let measure_ms: Vec<f64> = frames.iter().map(|frame| 1e3 * least(rounds, || eye.measure(frame))).collect();

    let estimate = Estimate { eta: 1.221, lambda_mm: 0.1765, covariance: Matrix2::zeros(), samples: 17 };
    let model = Model { estimate: Some(estimate), ..Model::default() };
    let poses: Vec<Configuration> = (0..POSES)
        .map(|k| Configuration::from_degrees(90.0 * k as f64 / POSES as f64, 37.0 * k as f64 % 360.0 - 180.0))
        .collect();
    let command = || {
        let mechanics = Mechanics::new(&model);
        let mut commands = vec![0.0; 3 * POSES];
        commands.par_chunks_exact_mut(3).zip(&poses).for_each(|(command, pose)| {
            command.copy_from_slice(&mechanics.command(pose.bend_vector(), None));
        });
        commands
    };
    let command_ns = 1e9 * least(rounds, command) / POSES as f64;
    println!("{}", serde_json::json!({ "measure_ms": measure_ms, "command_ns": command_ns }));
}

/// The least time of so many calls, s: other work on the machine can only add to it.
fn least<T>(calls: usize, mut work: impl FnMut() -> T) -> f64 {
    let time = |work: &mut dyn FnMut() -> T| {
        let began = Instant::now();
        drop(black_box(work()));
        began.elapsed().as_secs_f64()
    };
    (0..calls).map(|_| time(&mut work)).fold(f64::INFINITY, f64::min)
}
