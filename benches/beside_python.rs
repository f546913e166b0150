//! The Rust side of `tools/python-bench`, which starts it: for each line on standard input one round of the same work, its CPU time printed as
//! JSON. The folder that it is given holds camera.yaml, rig.toml, model.toml and frames/*.png, as the script wrote them.

use rayon::prelude::*;
use rustix::time::{ClockId, clock_gettime};
use snakeloop::camera::{Lens, read_frame};
use snakeloop::geometry::Configuration;
use snakeloop::measure::{Eye, Rig};
use snakeloop::record::read_model;
use snakeloop::robot::{Mechanics, Model};
use std::hint::black_box;
use std::path::PathBuf;

/// Poses of one call of the command; as in the script.
const POSES: usize = 1_000_000;

fn main() {
    let folder = std::env::args().skip(1).find(|argument| !argument.starts_with("--"));
    let Some(folder) = folder.map(PathBuf::from) else { return eprintln!("tools/python-bench starts this") };
    let eye = Eye::new(
        Lens::read(&folder.join("camera.yaml")).unwrap(),
        Rig::read(&folder.join("rig.toml")).unwrap(),
        Model::default().robot,
    );
    let paths = glob::glob(folder.join("frames/*.png").to_str().unwrap()).unwrap();
    let frames: Vec<_> = paths.map(|path| read_frame(&path.unwrap()).unwrap()).collect();
    let model = read_model(&folder.join("model.toml")).unwrap();
    let k = || (0..POSES).map(|k| k as f64);
    let theta_deg: Vec<f64> = k().map(|k| 90.0 * k / POSES as f64).collect();
    let delta_deg: Vec<f64> = k().map(|k| 37.0 * k % 360.0 - 180.0).collect();
    let width = model.robot.backbone_count();
    let command = || {
        let mechanics = Mechanics::new(&model);
        let mut commands = vec![0.0; width * POSES];
        commands.par_chunks_exact_mut(width).zip(&theta_deg).zip(&delta_deg).for_each(|((command, theta), delta)| {
            let pose = Configuration { theta: theta.to_radians(), delta: delta.to_radians() };
            command.copy_from_slice(&mechanics.command(pose.bend_vector(), None));
        });
        commands
    };
    for _ in std::io::stdin().lines() {
        let measure_s: Vec<f64> = frames.iter().map(|frame| cpu_s(|| eye.measure(frame))).collect();
        println!("{}", serde_json::json!({ "measure_s": measure_s, "command_s": cpu_s(command) }));
    }
}

/// The CPU time that some work takes in all threads, s.
fn cpu_s<T>(work: impl FnOnce() -> T) -> f64 {
    let now = || clock_gettime(ClockId::ProcessCPUTime);
    let began = now();
    drop(black_box(work()));
    let took = now() - began;
    took.tv_sec as f64 + 1e-9 * took.tv_nsec as f64
}
