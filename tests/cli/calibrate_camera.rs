//! `calibrate camera` as a user meets it, on drawn pictures of a chessboard before a pinhole camera.

use crate::program::{Sandbox, number};
use image::{GrayImage, Luma};
use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};
use snakeloop::camera::Lens;

const FOCAL_PX: f64 = 500.0;
const CENTRE_PX: [f64; 2] = [322.0, 237.0];

/// A board of 9×6 inner corners, 25 mm apart, in pose k. `bow` bends its pattern out of place.
fn board(k: u32, bow: f64) -> GrayImage {
    let around = f64::from(k) / 8.0 * std::f64::consts::TAU;
    let turn = Rotation3::from_scaled_axis(Vector3::new(0.5 * around.cos(), 0.5 * around.sin(), 0.1));
    let middle = Vector3::new(60.0 * (3.0 * around).cos(), 40.0 * (2.0 * around).sin(), 330.0);
    let corner = middle - turn * Vector3::new(100.0, 62.5, 0.0);
    // Pixel to board: the inverse of the homography of the board's plane.
    let plane = Matrix3::from_columns(&[turn * Vector3::x(), turn * Vector3::y(), corner]);
    let camera = Matrix3::new(FOCAL_PX, 0.0, CENTRE_PX[0], 0.0, FOCAL_PX, CENTRE_PX[1], 0.0, 0.0, 1.0);
    let board_from_pixel = (camera * plane).try_inverse().unwrap();
    let level = |u: f64, v: f64| {
        let at = board_from_pixel * Vector3::new(u, v, 1.0);
        let (x, y) = (at.x / at.z / 25.0, at.y / at.z / 25.0);
        let x = x + bow * (x - 4.0) * (x - 4.0);
        let on_squares = (-1.0..9.0).contains(&x) && (-1.0..6.0).contains(&y);
        if on_squares && (x.floor() + y.floor()).rem_euclid(2.0) < 1.0 { 40.0 } else { 210.0 }
    };
    let sharp = GrayImage::from_fn(640, 480, |x, y| {
        let sub = |i: i32| (f64::from(i) + 0.5) / 4.0 - 0.5;
        let samples = (0..16).map(|i| level(f64::from(x) + sub(i % 4), f64::from(y) + sub(i / 4)));
        Luma([(samples.sum::<f64>() / 16.0).round() as u8])
    });
    image::imageops::blur(&sharp, 0.8)
}

/// A folder with eight pictures, the sixth of a bent board, and one without any board.
fn pictures() -> Sandbox {
    let sandbox = Sandbox::new();
    for k in 0..8 {
        board(k, if k == 5 { 0.004 } else { 0.0 }).save(sandbox.join(&format!("{k}.png"))).unwrap();
    }
    GrayImage::from_pixel(640, 480, Luma([128])).save(sandbox.join("8.png")).unwrap();
    sandbox
}

const ALL: &str = "calibrate camera 0.png 1.png 2.png 3.png 4.png 5.png 6.png 7.png 8.png --corners 9x6";
const FLAT: &str = "calibrate camera 0.png 1.png 2.png 3.png 4.png 6.png 7.png 8.png --corners 9x6";

#[test]
fn everything_that_was_found_out_is_said() {
    let pictures = pictures();
    let said = pictures.json(ALL);
    assert_eq!((&said["image_width"], &said["image_height"]), (&640.into(), &480.into()));
    let names: Vec<&str> = said["parameters"].as_array().unwrap().iter().map(|p| p["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3"]);
    assert!(said["parameters"].as_array().unwrap().iter().all(|p| p["sd"].as_f64().unwrap() > 0.0));
    assert!((0.3..1.0).contains(&said["coverage"].as_f64().unwrap()), "{}", said["coverage"]);
    let views = said["pictures"].as_array().unwrap();
    let outliers: Vec<bool> = views.iter().map(|view| view["outlier"].as_bool().unwrap()).collect();
    assert_eq!(outliers, [false, false, false, false, false, true, false, false]);
    for view in views {
        assert!(number(view, "rms_px") > 0.0 && number(view, "worst_px") > number(view, "rms_px"), "{view}");
        assert!((25.0..33.0).contains(&number(view, "tilt_deg")), "{view}");
    }
    assert!(said["skipped"][0]["path"].as_str().unwrap().ends_with("8.png"));
    assert!(number(&said, "sigma_deg") > 0.0 && number(&said, "rms_px") > 0.0);
    // The bent board is in one half only: they must differ by more than twice what the sigmas predict.
    let halves = &said["halves"];
    assert!(number(halves, "rms_deg") > 2.0 * number(halves, "expected_deg"), "{halves}");
    assert_eq!(halves["disagree"], true);

    let output = pictures.call(ALL);
    let [told, warned] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    for part in ["corners in", "fx_px", "±", "an angle on the snake", "two halves differ", "worst px", "is an outlier"]
    {
        assert!(told.contains(part), "{part}: {told}");
    }
    for part in ["8.png: not used", "5.png: rms", "two halves of the pictures differ"] {
        assert!(warned.contains(part), "{part}: {warned}");
    }
}

#[test]
fn the_camera_file_is_of_the_kind_that_was_asked_for() {
    let pictures = pictures();
    let write = |name: &str, more: &str| {
        pictures.succeed(&format!("{FLAT} -o {name} {more}"));
        (Lens::read(&pictures.join(name)).unwrap(), pictures.read(name))
    };
    let (yaml, written) = write("camera.yaml", "");
    assert!(written.starts_with("%YAML:1.0"), "{written}");
    assert!((yaml.focal_px - Vector2::repeat(FOCAL_PX)).amax() < 1.0, "{yaml:?}");
    assert!((yaml.centre_px.coords - Vector2::from(CENTRE_PX)).amax() < 1.0, "{yaml:?}");
    let (xml, written) = write("camera.xml", "");
    assert!(written.starts_with("<?xml"), "{written}");
    let (ros, written) = write("camera_info.yaml", "--ros");
    assert!(written.contains("distortion_model: plumb_bob"), "{written}");
    assert!(yaml == xml && yaml == ros);

    assert!(pictures.fail(&format!("{FLAT} --ros -o other.xml"), 2).contains("--ros writes YAML"));
    pictures.fail(&format!("{FLAT} --ros"), 2);
}
