//! `discover` on measurements of real robots, which are not part of the project: REAL_SETS is a folder of sets, each with robot.toml,
//! train/ and val/ (measurements.csv, encoders.csv, which may have neighbouring sections' columns).
//!
//! ```sh
//! REAL_SETS=… cargo test --release --no-default-features --features cli --test library real -- --ignored --nocapture
//! ```

use snakeloop::discover::{Data, discover, propose_law};
use snakeloop::observation::{EncoderReading, Measurement};
use snakeloop::record::{read_encoders, read_measurements, read_model};
use snakeloop::robot::{Mechanics, Model};
use std::collections::HashMap;
use std::path::Path;
use std::time::Instant;

fn rows(folder: &Path, backbones: usize) -> (Vec<Measurement>, Vec<EncoderReading>) {
    let measurements = read_measurements(&folder.join("measurements.csv")).expect("measurements").rows;
    (measurements, read_encoders(&folder.join("encoders.csv"), backbones).expect("encoders").rows)
}

/// The rms of the bend vector that a model misses, degrees.
pub fn missed_deg(model: &Model, (measurements, readings): &(Vec<Measurement>, Vec<EncoderReading>)) -> f64 {
    let mechanics = Mechanics::new(model);
    let times: Vec<f64> = readings.iter().map(|reading| reading.time_s).collect();
    let q: Vec<_> = readings.iter().map(|reading| reading.beside_resting_neighbours(model).q_mm).collect();
    let path = mechanics.solve_path(&times, &q, None, None);
    let place: HashMap<u64, usize> = readings.iter().enumerate().map(|(k, reading)| (reading.index, k)).collect();
    let missed = measurements.iter().filter_map(|measurement| {
        let bend = path[*place.get(&measurement.index)?].solution.bend;
        Some((mechanics.apparent_bend(bend) - measurement.measured?.configuration.bend_vector()).norm_squared())
    });
    let missed: Vec<f64> = missed.collect();
    (missed.iter().sum::<f64>() / missed.len() as f64).sqrt().to_degrees()
}

/// Prints for each set what the model as given, the one found and the one with a law miss of the part that was not fitted.
#[test]
#[ignore = "needs measurements of real robots in the folder REAL_SETS"]
fn real_robots() {
    let sets = std::env::var("REAL_SETS").expect("REAL_SETS is a folder of sets");
    let mut robots: Vec<_> = glob::glob(&format!("{sets}/**/robot.toml")).unwrap().map(Result::unwrap).collect();
    robots.sort();
    assert!(!robots.is_empty(), "no robot.toml in {sets}");
    for robot in robots {
        let folder = robot.parent().unwrap();
        let given = read_model(&robot).expect("a model");
        let [train, val] = ["train", "val"].map(|part| rows(&folder.join(part), given.robot.backbone_count()));
        let began = Instant::now();
        let data = Data::new(&train.0, &train.1, 0.0015).expect("enough samples");
        let found = discover(&given, &data);
        let seconds = began.elapsed().as_secs_f64();
        let law = propose_law(&found, &data);
        println!(
            "{:30} {:11} {:6.2}° → {:.2}° (law: {:.2}°) in {seconds:.1} s",
            folder.strip_prefix(&sets).unwrap().display(),
            found.verdict.word(),
            missed_deg(&given, &val),
            missed_deg(&found.model, &val),
            missed_deg(law.model.as_ref().unwrap_or(&found.model), &val),
        );
        for named in &found.named {
            println!("    {} removes {:.2}, probability {:.2}", named.physics.name, named.removes, named.probability());
        }
        println!("    {}", law.words);
    }
}
