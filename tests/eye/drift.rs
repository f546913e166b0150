//! Cameras, bases and grid targets that move after the rig was calibrated, on rendered frames: the angles are right, or there
//! are none.

use crate::scenes::{STRAIGHT, checkered_laboratory, eye, frame, laboratory, rig_options};
use nalgebra::{Translation3, Vector3};
use snakeloop::camera::{Frame, Samples};
use snakeloop::geometry::{Configuration, Pose, wrap_degrees};
use snakeloop::measure::{FrameMeasurement, RigError, RigOptions, calibrate_rig};
use snakeloop::observation::Status;
use snakeloop::simulate::scene::{Pattern, Scene, Viewpoint};

/// The camera moved about the snake's base (degrees about its own axes) and shifted (mm along them).
fn camera_moved(scene: &Scene, turn_deg: [f64; 3], shift_mm: [f64; 3]) -> Scene {
    let turn = Pose::new(Vector3::zeros(), Vector3::from(turn_deg.map(f64::to_radians)));
    let seen = scene.view.camera_from_base();
    let mut moved = seen;
    moved.rotation = turn.rotation * seen.rotation;
    moved.translation.vector += Vector3::from(shift_mm);
    Scene { view: Viewpoint::from_pose(&moved), ..scene.clone() }
}

/// The snake moved along x_b and z_b before the same target and camera.
fn base_moved(scene: &Scene, x_mm: f64, z_mm: f64) -> Scene {
    let mut moved = scene.clone();
    let shift = Translation3::new(x_mm, 0.0, z_mm);
    moved.view = Viewpoint::from_pose(&(scene.view.camera_from_base() * shift));
    moved.paper.origin_mm = [scene.paper.origin_mm[0] - x_mm, scene.paper.origin_mm[1] - z_mm];
    moved
}

fn error_deg(measurement: &FrameMeasurement, psi: Configuration) -> Option<[f64; 2]> {
    let seen = measurement.measured?.configuration;
    Some([seen.theta_deg() - psi.theta_deg(), wrap_degrees(seen.delta_deg() - psi.delta_deg())])
}

#[test]
fn a_camera_that_moved_is_noticed() {
    for scene in [laboratory(), checkered_laboratory()] {
        let eye = eye(&scene);
        let psi = Configuration::from_degrees(45.0, 60.0);
        let moves = [
            ([0.0; 3], [0.03, 0.0, 0.0]),
            ([0.0; 3], [0.0, 0.05, 0.0]),
            ([0.0; 3], [0.0, 0.0, 1.0]),
            // Round the snake, which leaves the holder where it was.
            ([0.0, 0.5, 0.0], [0.0; 3]),
            ([0.4, 0.0, 0.0], [0.0; 3]),
            ([3.0, 4.0, 5.0], [5.0, 3.0, 8.0]),
        ];
        let some = if scene.paper.pattern == laboratory().paper.pattern { 1 } else { 4 };
        for (seed, (turn, shift)) in (20..).zip(moves).step_by(some) {
            let seen = eye.measure(&frame(&camera_moved(&scene, turn, shift), psi, seed));
            let told = format!("turn {turn:?}°, shift {shift:?} mm: {} {:?}", seen.status, seen.quality);
            assert!(seen.measured.is_none(), "{told}");
            assert!([Status::CameraMoved, Status::Occluded, Status::NoSnake].contains(&seen.status), "{told}");
        }
        let still = eye.measure(&frame(&scene, psi, 50));
        assert_eq!(still.status, Status::Ok);
        let quality = still.quality.unwrap();
        assert!(quality.base_moved_px.unwrap() < 0.35 && quality.grid_moved_px.unwrap() < 0.2, "{quality:?}");
    }
}

#[test]
fn a_base_that_moved_is_told_from_a_camera_that_did() {
    let scene = laboratory();
    let eye = eye(&scene);
    for (x_mm, z_mm) in [(0.1, 0.0), (-0.3, 0.2)] {
        let seen = eye.measure(&frame(&base_moved(&scene, x_mm, z_mm), Configuration::from_degrees(30.0, -100.0), 3));
        assert_eq!(seen.status, Status::BaseMoved, "{x_mm} mm, {z_mm} mm: {:?}", seen.quality);
    }
}

#[test]
fn a_target_that_slid_is_noticed_and_changes_no_angle() {
    let scene = laboratory();
    let eye = eye(&scene);
    let psi = Configuration::from_degrees(50.0, 20.0);
    let mut slid = scene.clone();
    slid.paper.origin_mm = [scene.paper.origin_mm[0] + 0.3, scene.paper.origin_mm[1] - 0.2];
    let seen = eye.measure(&frame(&slid, psi, 4));
    assert_eq!(seen.status, Status::Ok, "{:?}", seen.quality);
    let [theta, delta] = error_deg(&seen, psi).unwrap();
    assert!(theta.abs() < 0.2 && delta.abs() < 0.5, "{theta}° {delta}°");
    // 0.36 mm at 250 mm through 4282 px.
    let moved_px = seen.quality.unwrap().grid_moved_px.unwrap();
    assert!((3.0..6.0).contains(&moved_px), "{moved_px} px");
}

/// A camera that drifts, shakes and is knocked, and a target that slides on the way.
#[test]
fn a_camera_that_moves_is_followed() {
    let scene = laboratory();
    let mut eye = eye(&scene);
    let steps = [
        ([0.0; 3], [0.0; 3], 0.0),
        ([0.3, -0.4, 0.2], [0.3, 0.1, 1.0], 0.0),
        ([0.3, -0.4, 0.2], [0.3, 0.1, 1.0], 0.3),
        // A knock of some 100 px.
        ([-1.0, 1.0, 2.0], [4.0, -3.0, -3.0], 0.3),
        ([-1.0, 1.2, 2.0], [4.1, -3.0, -3.2], 0.3),
    ];
    for (seed, (turn, shift, slide)) in (60..).zip(steps) {
        let psi = Configuration::from_degrees(20.0 + 5.0 * (seed - 60) as f64, 40.0 * (seed - 60) as f64 - 80.0);
        let mut seen = camera_moved(&scene, turn, shift);
        seen.paper.origin_mm[0] += slide;
        let frame = frame(&seen, psi, seed);
        eye = eye.following(&frame).unwrap_or_else(|status| panic!("frame {seed}: {status}"));
        let measurement = eye.measure(&frame);
        let told = format!("frame {seed}: {} {:?}", measurement.status, measurement.quality);
        let [theta, delta] = error_deg(&measurement, psi).unwrap_or_else(|| panic!("{told}"));
        let measured = measurement.measured.unwrap();
        let sigmas = [measured.sigma_theta, measured.sigma_delta].map(f64::to_degrees);
        let told = format!("{told}: errors {theta:.3}° ± {:.3}°, {delta:.3}° ± {:.3}°", sigmas[0], sigmas[1]);
        println!("{told}");
        assert!(theta.abs() < 4.0 * sigmas[0] && delta.abs() < 4.0 * sigmas[1], "{told}");
        assert!(theta.abs() < 0.3 && delta.abs() < 1.0, "{told}");
    }
    // Without grid or holder nobody knows where the camera is.
    let nothing = Frame {
        samples: Samples::Bits8(vec![128; frame(&scene, STRAIGHT, 1).samples.len()]),
        ..frame(&scene, STRAIGHT, 1)
    };
    assert_eq!(eye.following(&nothing).unwrap_err(), Status::GridLost);
}

#[test]
fn a_wrong_grid_pitch_is_an_error_that_names_both_figures() {
    // The pitch that is on the grid target, and the one that is told.
    for (true_mm, told_mm) in [(2.0, 1.0), (0.94, 1.0), (1.0, 2.0)] {
        let mut scene = laboratory();
        let options = RigOptions { grid_pitch_mm: told_mm, ..rig_options(&scene) };
        if let Pattern::GraphPaper { lines } = &mut scene.paper.pattern {
            lines.iter_mut().for_each(|lines| lines.pitch_mm *= true_mm);
        }
        let straight = frame(&scene, STRAIGHT, 7);
        let error = calibrate_rig(&straight, &scene.lens, &scene.robot, &options).map(drop).unwrap_err();
        match error {
            RigError::PitchContradiction { stated_mm, found_mm, .. } => {
                assert_eq!((stated_mm, found_mm), (told_mm, true_mm))
            }
            RigError::ScaleContradiction { agreeing_pitch_mm, .. } => {
                assert!((agreeing_pitch_mm / true_mm - 1.0).abs() < 0.01, "{agreeing_pitch_mm} mm");
            }
            other => panic!("{true_mm} mm, told {told_mm} mm: {other}"),
        }
        let message = error.to_string();
        for part in [format!("grid_pitch_mm = {told_mm}"), "4.2 mm".into(), format!("{true_mm:.2} mm")] {
            assert!(message.contains(&part), "{part}: {message}");
        }
    }
}
