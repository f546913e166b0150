//! Calibration through OpenCV: against truth, against mrcal, and over many repetitions.

use super::fit::{Fit, parameters};
use super::halves::halves;
use super::tests::lens;
use super::{calibrate_camera, rms};
use crate::camera::{Board, Lens, opencv};
use crate::geometry::Pose;
use image::{GrayImage, Luma};
use nalgebra::{Point2, Point3, Rotation3, SVector, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::{RngExt, SeedableRng, rngs::StdRng};
use rand_distr::StandardNormal;
use rayon::prelude::*;
use std::path::PathBuf;

fn board() -> Board {
    Board::new(9, 6, 25.0).unwrap()
}

/// Twelve boards, tilted every way, that together fill the picture.
fn poses() -> Vec<Pose> {
    let middle = Translation3::new(-100.0, -62.5, 0.0);
    let pose = |k: usize| {
        let around = k as f64 / 12.0 * std::f64::consts::TAU;
        let tilt = Rotation3::from_scaled_axis(Vector3::new(0.5 * around.cos(), 0.5 * around.sin(), 0.1));
        let place = Translation3::new(
            70.0 * (3.0 * around).cos() - 20.0,
            50.0 * (2.0 * around).sin(),
            330.0 + 15.0 * (k % 4) as f64,
        );
        Pose::from_parts(place, UnitQuaternion::from(tilt)) * middle
    };
    (0..12).map(pose).collect()
}

fn corners_seen(lens: &Lens, noise_px: f64, seed: u64) -> Vec<Vec<Point2<f64>>> {
    let mut random = StdRng::seed_from_u64(seed);
    let mut noise = || noise_px * random.sample::<f64, _>(StandardNormal);
    let mut seen = |pose: Pose| {
        board().corners().iter().map(|c| lens.project(&(pose * c)) + Vector2::new(noise(), noise())).collect()
    };
    poses().into_iter().map(&mut seen).collect()
}

fn fit(seen: &[Vec<Point2<f64>>]) -> Fit {
    let views: Vec<&[Point2<f64>]> = seen.iter().map(Vec::as_slice).collect();
    Fit::of(&board(), &views, (640, 480)).unwrap()
}

#[test]
fn a_perfect_world_is_recovered() {
    let fit = fit(&corners_seen(&lens(), 0.0, 0));
    let difference = parameters(&fit.lens) - parameters(&lens());
    assert!(difference.rows(0, 4).amax() < 1e-3 && difference.rows(4, 5).amax() < 1e-4, "{difference}");
    assert!(rms(fit.residuals.iter().flatten()) < 1e-4);
}

/// The lens that Debian's `mrcal`, a program of its own with its own projection and solver, makes of the same
/// corners: no regularisation, no outliers dropped, the board flat, as here.
fn by_mrcal(seen: &[Vec<Point2<f64>>]) -> SVector<f64, 9> {
    let folder = tempfile::tempdir().unwrap();
    let corners = folder.path().join("corners.vnl");
    let line = |k: usize, c: &Point2<f64>| format!("board{k:02}.png {} {} 0\n", c.x, c.y);
    let lines = seen.iter().enumerate().flat_map(|(k, view)| view.iter().map(move |c| line(k, c)));
    std::fs::write(&corners, format!("# filename x y level\n{}", lines.collect::<String>())).unwrap();
    let output = std::process::Command::new("mrcal-calibrate-cameras")
        .arg("--corners-cache")
        .arg(&corners)
        .arg("--outdir")
        .arg(folder.path())
        .args(["--lensmodel", "LENSMODEL_OPENCV5", "--focal", "500", "--imagersize", "640", "480"])
        .args(["--object-spacing", "0.025", "--object-width-n", "9", "--object-height-n", "6"])
        .args(["--skip-regularization", "--skip-outlier-rejection", "--skip-calobject-warp-solve"])
        .arg("board*.png")
        .output()
        .expect("mrcal-calibrate-cameras runs");
    assert!(output.status.success(), "mrcal: {}", String::from_utf8_lossy(&output.stderr));
    let model = std::fs::read_to_string(folder.path().join("camera-0.cameramodel")).unwrap();
    let (_, rest) = model.split_once("'intrinsics': [").unwrap();
    let values = rest.split_once(']').unwrap().0.split(',').filter_map(|v| v.trim().parse().ok());
    SVector::from_vec(values.collect())
}

#[test]
#[ignore = "needs mrcal (Debian: apt install mrcal): cargo test --lib mrcal -- --ignored"]
fn mrcal_finds_the_same_lens() {
    let seen = corners_seen(&lens(), 0.2, 3);
    let theirs = by_mrcal(&seen);
    let fit = fit(&seen);
    let difference = (parameters(&fit.lens) - theirs).component_div(&fit.covariance.diagonal().map(f64::sqrt));
    println!("ours − mrcal's, in sigmas: {difference:.5}");
    assert!(difference.amax() < 0.01, "ours − mrcal's, in sigmas: {difference}");
}

/// Mean square of (estimate − truth) / sigma over many repetitions, for each parameter: 1 if the sigmas are right.
#[test]
fn sigmas_are_the_scatter_and_opencv_s_are_too_large() {
    let truth = parameters(&lens());
    let trials = 80;
    let squares: Vec<[SVector<f64, 9>; 2]> = (0..trials)
        .into_par_iter()
        .map(|seed| {
            let seen = corners_seen(&lens(), 0.2, seed);
            let fit = fit(&seen);
            let error = parameters(&fit.lens) - truth;
            let ours = error.component_div(&fit.covariance.diagonal().map(f64::sqrt));
            let theirs = error.component_div(&opencv::own_sigmas(&board(), &seen, (640, 480)));
            [ours, theirs].map(|ratio| ratio.component_mul(&ratio))
        })
        .collect();
    let mean = |which: usize| squares.iter().map(|s| s[which]).sum::<SVector<f64, 9>>() / trials as f64;
    println!("mean square of error / sigma\nours {:.2}\nOpenCV's {:.2}", mean(0).transpose(), mean(1).transpose());
    // A mean of 80 squares of normal numbers has σ = 0.16.
    assert!(mean(0).iter().all(|&m| (0.5..1.7).contains(&m)), "ours: {}", mean(0));
    assert!((mean(0).mean() - 1.0).abs() < 0.2, "ours: {}", mean(0));
    assert!((mean(1).mean() - 0.5).abs() < 0.1, "OpenCV's: {}", mean(1));
}

#[test]
fn halves_agree_unless_something_is_wrong() {
    let halves_of = |seen: &[Vec<Point2<f64>>]| {
        let views: Vec<&[Point2<f64>]> = seen.iter().map(Vec::as_slice).collect();
        halves(&board(), &views, (640, 480)).unwrap()
    };
    let ratios: Vec<f64> = (0..20)
        .into_par_iter()
        .map(|seed| halves_of(&corners_seen(&lens(), 0.2, 1000 + seed)))
        .map(|halves| halves.rms_deg / halves.expected_deg)
        .collect();
    println!("rms / expected {ratios:.2?}");
    let mean_square = ratios.iter().map(|r| r * r).sum::<f64>() / 20.0;
    assert!((0.6..1.5).contains(&mean_square), "{mean_square}");
    assert!(ratios.iter().filter(|&&r| r > 2.0).count() <= 2, "{ratios:?}");

    // The lens was moved between one picture and the next.
    let other = Lens { focal_px: Vector2::new(533.0, 536.0), ..lens() };
    let (mut mixed, moved) = (corners_seen(&lens(), 0.05, 1), corners_seen(&other, 0.05, 2));
    for k in (1..12).step_by(2) {
        mixed[k].clone_from(&moved[k]);
    }
    let halves = halves_of(&mixed);
    assert!(halves.disagree(), "{halves:?}");
}

/// A picture of the board, black and white squares on a white sheet; `warp` shifts its pattern like a bent board.
fn picture(lens: &Lens, pose: &Pose, warp: f64, seed: u64) -> GrayImage {
    let board_from_camera = pose.inverse();
    let origin = board_from_camera * Point3::origin();
    let light = |u: f64, v: f64| {
        let ray = board_from_camera * lens.ray(&Point2::new(u, v));
        let at = origin - ray * (origin.z / ray.z);
        let (x, y) = (at.x / 25.0, at.y / 25.0);
        let x = x + warp * (x - 4.0) * (x - 4.0);
        let on_squares = (-1.0..9.0).contains(&x) && (-1.0..6.0).contains(&y);
        if on_squares && (x.floor() + y.floor()).rem_euclid(2.0) < 1.0 { 40.0 } else { 210.0 }
    };
    let sharp = GrayImage::from_fn(640, 480, |x, y| {
        let samples = (0..16).map(|k| {
            let offset = |i: i32| (f64::from(i) + 0.5) / 4.0 - 0.5;
            light(f64::from(x) + offset(k % 4), f64::from(y) + offset(k / 4))
        });
        Luma([(samples.sum::<f64>() / 16.0).round() as u8])
    });
    let mut random = StdRng::seed_from_u64(seed);
    let mut blurred = image::imageops::blur(&sharp, 0.8);
    for level in blurred.iter_mut() {
        *level = (f64::from(*level) + 2.0 * random.sample::<f64, _>(StandardNormal)).round() as u8;
    }
    blurred
}

#[test]
fn pictures_of_boards_give_the_lens_and_name_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let mut paths: Vec<PathBuf> = (0..14).map(|k| folder.path().join(format!("{k:02}.png"))).collect();
    poses().par_iter().enumerate().for_each(|(k, pose)| {
        let warp = if k == 7 { 0.002 } else { 0.0 };
        picture(&lens(), pose, warp, k as u64).save(&paths[k]).unwrap();
    });
    GrayImage::from_pixel(640, 480, Luma([128])).save(&paths[12]).unwrap();
    std::fs::write(&paths[13], "no picture").unwrap();

    let result = calibrate_camera(&paths, &board()).unwrap();
    let names = |paths: Vec<&PathBuf>| -> Vec<String> {
        paths.iter().map(|p| p.file_stem().unwrap().to_string_lossy().into_owned()).collect()
    };
    assert_eq!(names(result.skipped.iter().map(|(path, _)| path).collect()), ["12", "13"]);
    assert_eq!(names(result.views.iter().filter(|v| v.outlier).map(|v| &v.path).collect()), ["07"]);
    assert!(result.coverage > 0.6, "{}", result.coverage);

    paths.truncate(12);
    paths.remove(7);
    let clean = calibrate_camera(&paths, &board()).unwrap();
    assert!(clean.rms_px < 0.15, "{}", clean.rms_px);
    for ((name, value, sigma), truth) in clean.parameters().into_iter().zip(&parameters(&lens())) {
        assert!((value - truth).abs() < 4.0 * sigma, "{name}: {value} ± {sigma}, truth {truth}");
    }
    assert!((0.001..0.1).contains(&clean.sigma_deg), "{}", clean.sigma_deg);
}

#[test]
fn pictures_of_two_sizes_are_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let paths = ["a.png", "b.png"].map(|name| folder.path().join(name));
    let whole = picture(&lens(), &poses()[0], 0.0, 0);
    whole.save(&paths[0]).unwrap();
    image::imageops::crop_imm(&whole, 0, 0, 639, 480).to_image().save(&paths[1]).unwrap();
    let message = calibrate_camera(&paths, &board()).unwrap_err().to_string();
    assert!(message.contains("639×480 px, but") && message.contains("640×480"), "{message}");
}
