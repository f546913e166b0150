//! Whether the sigmas are honest: errors over many rigs, lights and noises, each divided by the covariance that came with it.
//! What is drawn at random is drawn as in `robustness`; none of it is known to the eye.
//!
//! ```sh
//! cargo test --release --no-default-features --test eye uncertainty -- --ignored --nocapture
//! ```
//!
//! measures four bends before each of some 180 rigs, by the straight picture's rig alone and by a refined one, and prints the
//! normalised errors' covariance, how many lie within their 95 % intervals, and beside the errors' rms the Cramér–Rao bound
//! of the picture's noise.

use crate::rigs::{self, Random};
use crate::scenes::{STRAIGHT, eye, eye_with, frame, frame_of, rig, rig_options, smaller};
use image::RgbImage;
use nalgebra::{DMatrix, Matrix2, Rotation2, UnitQuaternion, Vector2, Vector3};
use rand::{SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use snakeloop::camera::{CameraFormat, Frame};
use snakeloop::geometry::{Configuration, Pose};
use snakeloop::measure::{Eye, Rig, RigOptions};
use snakeloop::simulate::render::render;
use snakeloop::simulate::scene::{Scene, Sensor, Viewpoint};
use std::fs;
use std::path::PathBuf;

/// One bend's error.
struct Outcome {
    seed: u64,
    psi: Configuration,
    /// Of the bend vector, rad: along the bend and across it.
    error: Vector2<f64>,
    /// In units of the covariance.
    normalised: Vector2<f64>,
    /// 1σ bounds along and across: the camera's pose known, and unknown but for what the frame itself shows.
    bounds: Option<[Vector2<f64>; 2]>,
}

fn bends(random: &mut Random, count: usize) -> Vec<Configuration> {
    (0..count).map(|_| Configuration::from_degrees(random.between(15.0, 85.0), random.between(-180.0, 180.0))).collect()
}

/// The errors of some bends before one rig, refined by `refining` frames; none if it cannot be calibrated.
fn outcomes(seed: u64, count: usize, refining: usize, with_bounds: bool) -> Vec<Outcome> {
    let mut random = Random::new(seed);
    let mut scene = rigs::varied(&mut random);
    // Fewer rays make an error of their own, 0.1 px an edge, which is no camera's and which the bound does not know.
    scene.sensor.rays_per_pixel = 16;
    let Ok(rig) = rig(&scene, seed) else { return Vec::new() };
    let mut eye = eye_with(&scene, rig);
    if refining > 0 {
        let frames: Vec<Frame> =
            (0..).zip(bends(&mut random, refining)).map(|(k, psi)| frame(&scene, psi, 1000 * seed + 500 + k)).collect();
        eye = eye.refined(frames.into_par_iter());
    }
    let outcome = |(k, psi): (u64, Configuration)| {
        let seen = eye.measure(&frame(&scene, psi, 1000 * seed + k)).bend?;
        let along = Rotation2::new(-psi.delta);
        let error = seen.vector - psi.bend_vector();
        let normalised = seen.covariance.cholesky()?.l().solve_lower_triangular(&error)?;
        let bounds = if with_bounds { bounds(&scene, psi) } else { None };
        Some(Outcome { seed, psi, error: along * error, normalised, bounds })
    };
    (0..).zip(bends(&mut random, count)).filter_map(outcome).collect()
}

/// The Cramér–Rao bounds of the bend, rad along and across it, from the renderer's own derivatives: pixels' noise is known,
/// independent and Gaussian, and so is everything else about the picture but the bend, or but the bend and the camera's pose.
fn bounds(scene: &Scene, psi: Configuration) -> Option<[Vector2<f64>; 2]> {
    let sharp = Scene { sensor: Sensor { rays_per_pixel: 16, noise: 0.0, ..scene.sensor }, ..scene.clone() };
    // Steps that move edges by a fraction of a pixel: rad, rad, mm.
    const STEPS: [f64; 8] = [2e-3, 2e-3, 5e-4, 5e-4, 5e-4, 0.01, 0.01, 0.2];
    let picture = |axis: usize, sign: f64| {
        let mut by = [0.0; 8];
        by[axis] = sign * STEPS[axis];
        let along = Rotation2::new(psi.delta);
        let bend = psi.bend_vector() + along * Vector2::new(by[0], by[1]);
        let seen = scene.view.camera_from_base();
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(by[2], by[3], by[4]));
        let shift = seen.translation.vector + Vector3::new(by[5], by[6], by[7]);
        let view = Viewpoint::from_pose(&Pose::from_parts(shift.into(), turn * seen.rotation));
        render(&Scene { view, ..sharp.clone() }, Configuration::from_bend_vector(bend), 0).into_raw()
    };
    let slopes: Vec<Vec<f32>> = (0..8)
        .map(|axis| {
            let (ahead, behind) = (picture(axis, 1.0), picture(axis, -1.0));
            let slope = |(a, b): (&u8, &u8)| (f32::from(*a) - f32::from(*b)) / (2.0 * STEPS[axis] as f32);
            ahead.iter().zip(&behind).map(slope).collect()
        })
        .collect();
    // Rounding to whole levels adds a twelfth.
    let variance = scene.sensor.noise.powi(2) + 1.0 / 12.0;
    let information = DMatrix::from_fn(8, 8, |r, c| {
        slopes[r].iter().zip(&slopes[c]).map(|(a, b)| f64::from(a * b)).sum::<f64>() / variance
    });
    let sigmas = |covariance: DMatrix<f64>| Vector2::new(covariance[(0, 0)].sqrt(), covariance[(1, 1)].sqrt());
    let known = information.view((0, 0), (2, 2)).into_owned().cholesky()?.inverse();
    Some([sigmas(known), sigmas(information.cholesky()?.inverse())])
}

/// What the normalised errors say: the eigenvalues of their covariance, and the share within 95 % intervals.
struct Honesty {
    count: usize,
    eigenvalues: Vector2<f64>,
    within: f64,
}

impl Honesty {
    /// The mean square of honest normalised errors is 1. On these renders it is less: σ are as large as photo-real frames ask for. The limits
    /// are a factor of 1.5 from what was seen on both sides, so that where this passes it would fail with every σ 1.5 times as large, or as
    /// small: that changes the mean square by 2.25.
    fn assert_as_seen(&self, mean_square: f64) {
        let Self { count, eigenvalues, within } = self;
        assert!(*count >= 41, "{count} bends measured");
        let is_as_seen = (mean_square / 1.5..mean_square * 1.5).contains(&eigenvalues.mean());
        assert!(is_as_seen, "mean square {:.2}, within 95 % {within}", eigenvalues.mean());
    }
}

fn honesty(outcomes: &[Outcome]) -> Honesty {
    let count = outcomes.len();
    let second: Matrix2<f64> = outcomes.iter().map(|o| o.normalised * o.normalised.transpose()).sum();
    let inside: usize = outcomes.iter().flat_map(|o| o.normalised.iter()).filter(|z| z.abs() < 1.96).count();
    Honesty {
        count,
        eigenvalues: (second / count.max(1) as f64).symmetric_eigenvalues(),
        within: inside as f64 / (2 * count).max(1) as f64,
    }
}

fn survey(seeds: impl Iterator<Item = u64>, count: usize, refining: usize, with_bounds: usize) -> Honesty {
    let all: Vec<Outcome> = seeds
        .enumerate()
        .collect::<Vec<_>>()
        .into_par_iter()
        .flat_map_iter(|(k, seed)| outcomes(seed, count, refining, k < with_bounds))
        .collect();
    let honesty = honesty(&all);
    println!(
        "{} bends, rig refined by {refining} frames: eigenvalues of the normalised covariance {:.2} and {:.2}, {:.1} % within 95 %",
        honesty.count,
        honesty.eigenvalues.min(),
        honesty.eigenvalues.max(),
        100.0 * honesty.within
    );
    let rms_deg = |errors: &[Vector2<f64>]| {
        let sum = errors.iter().fold(Vector2::zeros(), |sum, e| sum + e.component_mul(e));
        (sum / errors.len().max(1) as f64).map(|v| v.sqrt().to_degrees())
    };
    let errors: Vec<_> = all.iter().map(|o| o.error).collect();
    println!(
        "  rms error along the bend {:.4}°, across {:.4}°; the furthest off:",
        rms_deg(&errors).x,
        rms_deg(&errors).y
    );
    let mut furthest: Vec<&Outcome> = all.iter().collect();
    furthest.sort_by(|a, b| b.normalised.norm().total_cmp(&a.normalised.norm()));
    for o in furthest.iter().take(10) {
        println!(
            "  rig {}: {:.1}σ, {:.3}° along and {:.3}° across, at θ {:.1}°, δ {:.1}°",
            o.seed,
            o.normalised.norm(),
            o.error.x.to_degrees(),
            o.error.y.to_degrees(),
            o.psi.theta.to_degrees(),
            o.psi.delta.to_degrees()
        );
    }
    let bounded: Vec<(&Outcome, [Vector2<f64>; 2])> = all.iter().filter_map(|o| Some((o, o.bounds?))).collect();
    if !bounded.is_empty() {
        let seen = rms_deg(&bounded.iter().map(|(o, _)| o.error).collect::<Vec<_>>());
        for (k, what) in ["camera's pose known", "camera's pose from this frame alone"].into_iter().enumerate() {
            let bound = rms_deg(&bounded.iter().map(|(_, bounds)| bounds[k]).collect::<Vec<_>>());
            println!(
                "  Cramér–Rao bound of {} of them, {what}: {:.4}° and {:.4}°; rms error {:.4}° ({:.1} times) and {:.4}° ({:.1} times)",
                bounded.len(),
                bound.x,
                bound.y,
                seen.x,
                seen.x / bound.x,
                seen.y,
                seen.y / bound.y
            );
        }
    }
    honesty
}

/// The rigs that the size of what light does was chosen on: errors are rigs', so that it takes many of them to tell.
fn rigs_of_the_survey() -> impl Iterator<Item = u64> {
    (5000..5070).chain(5200..5240).chain(5300..5340).chain(5400..5440)
}

/// Of the straight picture's rig alone. As last run the eigenvalues were 0.38 and 0.56, and 98.3 % lay within 95 %.
#[test]
#[ignore = "takes minutes: cargo test --release --test eye two_hundred_renders -- --ignored; a later test is a slice of it"]
fn over_two_hundred_renders_the_sigmas_are_those_of_the_errors() {
    survey(rigs_of_the_survey(), 4, 0, 2).assert_as_seen(0.36);
}

/// The same with the rigs that a sequence leads to: errors are smaller then. As last run the eigenvalues were 0.48 and 0.59, and 98.7 % lay
/// within 95 %.
#[test]
#[ignore = "takes minutes: cargo test --release --test eye with_refined_rigs -- --ignored"]
fn with_refined_rigs_the_sigmas_are_those_of_the_errors() {
    survey(rigs_of_the_survey(), 4, 8, 0).assert_as_seen(0.5);
}

/// Draws rigs with six bends each as experiments, with a truth.csv, for `tools/fit-noise`.
#[test]
#[ignore = "draws 24 rigs into a folder: tools/fit-noise --draw FOLDER"]
fn rigs_are_drawn() {
    const SEEDS: std::ops::Range<u64> = 15000..15024;
    let folder =
        PathBuf::from(std::env::var_os("SNAKELOOP_DRAW").expect("SNAKELOOP_DRAW names the folder to draw into"));
    SEEDS.into_par_iter().for_each(|seed| {
        let mut random = Random::new(seed);
        let mut scene = rigs::varied(&mut random);
        scene.sensor.rays_per_pixel = 16;
        let own = folder.join(format!("own{seed}"));
        fs::create_dir_all(own.join("frames")).unwrap();
        let RigOptions { grid_pitch_mm, standoff_mm, .. } = rig_options(&scene);
        let view = format!(
            "[[view]]\nname = \"side\"\ncamera = \"camera.yaml\"\nframes = \"frames/*.png\"\nstraight = \"straight.png\"\n\
             grid_pitch_mm = {grid_pitch_mm}\nstandoff_mm = {standoff_mm}\n"
        );
        fs::write(own.join("experiment.toml"), view).unwrap();
        fs::write(own.join("camera.yaml"), scene.lens.to_file(CameraFormat::OpenCvYaml)).unwrap();
        render(&scene, STRAIGHT, seed).save(own.join("straight.png")).unwrap();
        let mut truth = "index,theta_deg,delta_deg\n".to_owned();
        for (k, psi) in (0..).zip(bends(&mut random, 6)) {
            render(&scene, psi, 1000 * seed + k).save(own.join(format!("frames/{k:05}.png"))).unwrap();
            truth += &format!("{k},{},{}\n", psi.theta_deg(), psi.delta_deg());
        }
        fs::write(own.join("truth.csv"), truth).unwrap();
    });
}

/// Rigs that nothing was chosen on, with small pictures.
fn rigs_of_the_slice() -> impl Iterator<Item = u64> {
    (5500..).filter(|&seed| rigs::varied(&mut Random::new(seed)).lens.width == 640).take(12)
}

/// A survey in small, with rigs and shapes learned from six frames, as `run` does. The mean square was 0.53 when this was written.
#[test]
fn a_slice_of_them_has_the_sigmas_that_it_had() {
    survey(rigs_of_the_slice(), 4, 6, 0).assert_as_seen(0.53);
}

/// The last disk of this snake is seen edge-on: a fit that starts on the wrong side ends in a local minimum in which the disk tilts the other way,
/// 2.3° off in the bend's direction away from the camera. The edges do not decide between both, so that the answer lies between them, and σ says so.
#[test]
fn a_last_disk_seen_edge_on_is_not_tilted_the_other_way_for_certain() {
    const SEED: u64 = 5412;
    let mut random = Random::new(SEED);
    let mut scene = rigs::varied(&mut random);
    scene.sensor.rays_per_pixel = 16;
    let eye = eye_with(&scene, rig(&scene, SEED).unwrap());
    let psi = bends(&mut random, 12)[10];
    let bend = eye.measure(&frame(&scene, psi, 1000 * SEED + 2)).bend.unwrap();
    let off = bend.vector - psi.bend_vector();
    assert!(off.norm().to_degrees() < 2.0, "{:?}°", off.map(f64::to_degrees));
    let chi2 = off.dot(&(bend.covariance.try_inverse().unwrap() * off));
    assert!(chi2 < 4.0, "χ² {chi2}");
}

/// Adds a camera's noise to a picture.
fn with_noise(picture: &RgbImage, sigma: f64, seed: u64) -> RgbImage {
    let mut random = StdRng::seed_from_u64(seed);
    let mut noisy = picture.clone();
    for level in noisy.iter_mut() {
        let noise: f64 = StandardNormal.sample(&mut random);
        *level = (f64::from(*level) + sigma * noise).round().clamp(0.0, 255.0) as u8;
    }
    noisy
}

/// No unbiased estimator scatters less than the Cramér–Rao bound. The bound knows the camera's pose, the light and the shadow, and uses
/// every pixel; the eye looks at edges only, and scattered by 8 and 10 times the bound when this was written. The σ that it reports must
/// cover this scatter, since the noise is a part of them. The picture is the same but for its noise.
#[test]
fn noise_alone_scatters_the_bend_by_no_less_than_the_bound_and_no_more_than_sigma() {
    const DRAWS: u64 = 60;
    let mut scene = smaller(Scene::default(), 2);
    scene.sensor = Sensor { rays_per_pixel: 16, blur_px: 0.5, noise: 3.0 };
    // The bound knows that the snake is an arc, and so does this eye.
    let rig = Rig { mode_sigma_rad: [1e-6; 3], ..eye(&scene).rig().clone() };
    let eye = Eye::new(scene.lens.clone(), rig, scene.robot.clone());
    let psi = Configuration::from_degrees(40.0, 20.0);
    let [bound, _] = bounds(&scene, psi).unwrap();
    let clean = render(&Scene { sensor: Sensor { noise: 0.0, ..scene.sensor }, ..scene.clone() }, psi, 0);
    let along = Rotation2::new(-psi.delta);
    let seen: Vec<_> = (0..DRAWS)
        .into_par_iter()
        .map(|seed| eye.measure(&frame_of(with_noise(&clean, scene.sensor.noise, seed))).bend.unwrap())
        .collect();
    let bends: Vec<Vector2<f64>> = seen.iter().map(|bend| along * bend.vector).collect();
    let mean = bends.iter().sum::<Vector2<f64>>() / DRAWS as f64;
    let squares = bends.iter().map(|bend| (bend - mean).component_mul(&(bend - mean))).sum::<Vector2<f64>>();
    let scatter = (squares / (DRAWS - 1) as f64).map(f64::sqrt);
    let ratio = scatter.component_div(&bound);
    // The scatter of sixty draws is known to 9 %: three of that below the bound.
    assert!(ratio.iter().all(|ratio| (0.73..15.0).contains(ratio)), "{ratio:.2} times the bound {bound:.2e}");
    let covariance = along.matrix() * seen[0].covariance * along.matrix().transpose();
    let sigma = covariance.diagonal().map(f64::sqrt);
    assert!(scatter.x < sigma.x && scatter.y < sigma.y, "scatter {scatter:.2e}, σ {sigma:.2e}");
}
