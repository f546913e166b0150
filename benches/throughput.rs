//! How long each step takes, on the bundled experiment: `cargo bench --no-default-features`.

use divan::Bencher;
use nalgebra::Matrix2;
use snakeloop::camera::{Frame, Lens, Samples, read_frame};
use snakeloop::estimate::{Estimator, Options, Verdict};
use snakeloop::geometry::Configuration;
use snakeloop::measure::{Eye, RigOptions, calibrate_rig};
use snakeloop::observation::{Measured, Measurement, Status};
use snakeloop::record::{read_encoders, read_truth};
use snakeloop::robot::table::{Grid, compensation_table};
use snakeloop::robot::{Estimate, Model};
use std::path::{Path, PathBuf};

fn main() {
    divan::main();
}

fn bundled(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/bending").join(name)
}

fn frame() -> PathBuf {
    bundled("frames/00004.jpg")
}

/// The paper's robot with the bundled experiment's η and λ.
fn model() -> Model {
    let covariance = Matrix2::from_diagonal_element(1e-6);
    Model::default().with_estimate(Estimate { eta: 1.221, lambda_mm: 0.1765, covariance, samples: 17 })
}

#[divan::bench(max_time = 5)]
fn decode_a_frame() -> Frame {
    read_frame(&frame()).unwrap()
}

/// One pass of reading a decoded frame's pixels: what the measurement is compared with.
#[divan::bench(max_time = 2)]
fn read_every_pixel(bencher: Bencher) {
    let frame = read_frame(&frame()).unwrap();
    let Samples::Bits8(samples) = frame.samples else { unreachable!("the bundled frames have 8 bits") };
    bencher.bench_local(|| divan::black_box(&samples).iter().map(|&v| f32::from(v)).sum::<f32>());
}

#[divan::bench(max_time = 15)]
fn measure_a_decoded_frame(bencher: Bencher) {
    let (eye, frame) = eye_and_frame();
    bencher.bench_local(|| eye.measure(&frame));
}

/// As `live` does: the frame before, 1.5° away, is known.
#[divan::bench(max_time = 15)]
fn track_a_decoded_frame(bencher: Bencher) {
    let (eye, frame) = eye_and_frame();
    let last = eye.measure(&frame).bend.unwrap().vector * 0.97;
    bencher.bench_local(|| eye.track(&frame, last));
}

fn eye_and_frame() -> (Eye, Frame) {
    let lens = Lens::read(&bundled("camera.yaml")).unwrap();
    let robot = Model::default().robot;
    let options = RigOptions { grid_pitch_mm: 1.0, standoff_mm: 25.0, delta_offset: 0.0 };
    let rig = calibrate_rig(&read_frame(&bundled("straight.jpg")).unwrap(), &lens, &robot, &options).unwrap();
    let eye = Eye::new(lens, rig, robot);
    let frame = read_frame(&frame()).unwrap();
    assert_eq!(eye.measure(&frame).status, Status::Ok);
    (eye, frame)
}

#[divan::bench(max_time = 2)]
fn solve_the_forward_problem(bencher: Bencher) {
    let model = model();
    let q_tilde_mm = model.command(Configuration::from_degrees(60.0, 35.0));
    bencher.bench_local(|| model.forward(divan::black_box(&q_tilde_mm)).unwrap());
}

/// The last measurement of the bundled experiment, after all the others.
#[divan::bench(max_time = 2)]
fn update_the_estimate(bencher: Bencher) {
    let encoders = read_encoders(&bundled("encoders.csv"), 3).unwrap().rows;
    let sigma = 0.1_f64.to_radians();
    let measurements = read_truth(&bundled("truth.csv")).unwrap().rows.into_iter().map(|truth| Measurement {
        index: truth.index,
        time_s: None,
        status: Status::Ok,
        measured: Some(Measured::independent(truth.configuration, sigma, sigma, 0.0)),
        quality: None,
        view: None,
    });
    let mut rows: Vec<_> = measurements.zip(encoders).collect();
    let (last, reading) = rows.pop().unwrap();
    let mut estimator = Estimator::new(&Model::default(), Options::default()).unwrap();
    for (measurement, reading) in &rows {
        estimator.update(measurement, Some(reading));
    }
    assert_eq!(estimator.clone().update(&last, Some(&reading)).verdict, Verdict::Used);
    bencher
        .with_inputs(|| estimator.clone())
        .bench_local_values(|mut estimator| estimator.update(&last, Some(&reading)));
}

/// The default grid: 19 bends by 24 azimuths.
#[divan::bench(max_time = 2)]
fn make_a_compensation_table(bencher: Bencher) {
    let (model, grid) = (model(), Grid::default());
    bencher.bench_local(|| compensation_table(&model, &grid).unwrap());
}
