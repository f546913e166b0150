//! A sealed experiment end to end: nothing but pictures and encoders go in, and the hidden effect's name comes out.
//!
//! `SEALED_FRAMES=3 cargo test --release --test cli sealed_frames -- --nocapture` runs every effect with so many seeds.

use crate::program::{Sandbox, number};
use crate::scenes::smaller;
use serde_json::Value;
use snakeloop::record::{encoders_csv, write_atomically};
use snakeloop::robot::{LIBRARY, Physics};
use snakeloop::simulate::scene::{Scene, Sensor};
use snakeloop::simulate::{FrameFormat, Sealed, write_experiment};
use std::path::Path;

/// A sharp picture with some noise, of half the usual width and height.
fn scene() -> Scene {
    Scene { sensor: Sensor { rays_per_pixel: 8, blur_px: 0.5, noise: 1.0 }, ..smaller(Scene::default(), 2) }
}

/// Renders a sealed experiment, takes the truth out of the folder and asks `discover`. What it answers, and what was hidden.
fn discover(hidden: &'static Physics, seed: u64, sweep: usize, round: usize) -> (Value, Vec<f64>) {
    let sealed = Sealed::of_poses(&[hidden], seed, sweep, round).unwrap();
    let sandbox = Sandbox::new();
    let experiment = sandbox.join("experiment");
    write_atomically(&experiment.join("encoders.csv"), encoders_csv(&sealed.readings, 3).as_bytes()).unwrap();
    write_experiment(&experiment, &scene(), &sealed.shown, FrameFormat::Jpeg(92), seed, &|| ()).unwrap();
    for told in ["truth.csv", "rig_truth.json", "scene.toml"] {
        std::fs::remove_file(experiment.join(told)).unwrap();
    }
    assert_eq!(names(&experiment), ["camera.yaml", "encoders.csv", "experiment.toml", "frames", "straight.jpg"]);
    (sandbox.json("discover experiment -o out --quiet"), sealed.truth.effects[0].values.clone())
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn pictures_and_encoders_alone_name_what_is_hidden() {
    let seeds: u64 = std::env::var("SEALED_FRAMES").ok().and_then(|text| text.parse().ok()).unwrap_or(0);
    if seeds > 0 {
        return every_effect(seeds);
    }
    let hidden = snakeloop::robot::effects::physics("load_directed_backlash").unwrap();
    let (found, truth) = discover(hidden, 3, 3, 8);
    assert_eq!(found["verdict"], "named", "{found:#}");
    assert_eq!(found["effects"].as_array().unwrap().len(), 1, "{found:#}");
    assert_eq!(found["effects"][0]["name"], hidden.name, "{found:#}");
    let play = &found["effects"][0]["parameters"]["play_mm"];
    assert!((number(play, "value") - truth[0]).abs() < 0.005, "{play}, truth {}", truth[0]);
}

fn every_effect(seeds: u64) {
    let mut right = 0;
    for hidden in LIBRARY {
        for seed in 0..seeds {
            let (found, truth) = discover(hidden, 300 + seed, 8, 16);
            let effects = found["effects"].as_array().unwrap();
            let names: Vec<&str> = effects.iter().filter_map(|effect| effect["name"].as_str()).collect();
            right += usize::from(names == [hidden.name]);
            let open = effects.iter().map(|effect| effect["indistinguishable_from"].to_string()).collect::<String>();
            println!("{:26} {truth:.4?}: {} {} open {open}", hidden.name, found["verdict"], names.join(" + "));
        }
    }
    println!("right {right} of {}", LIBRARY.len() as u64 * seeds);
}
