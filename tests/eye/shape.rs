//! Snakes that are not bent to a circle, on rendered frames: the departure that was put in comes out, and a circle is one.

use crate::scenes::{eye, frame, laboratory};
use rayon::prelude::*;
use snakeloop::geometry::Configuration;
use snakeloop::observation::{Shape, Status};
use snakeloop::simulate::scene::Scene;

#[test]
fn a_departure_from_the_circle_is_found_and_a_circle_is_one() {
    let scene = laboratory();
    let eye = eye(&scene);

    let shape = |theta_deg, delta_deg, departure_deg: [f64; 2], seed| -> Shape {
        let bent = Scene { departure_deg, ..scene.clone() };
        let psi = Configuration::from_degrees(theta_deg, delta_deg);
        let seen = eye.measure(&frame(&bent, psi, seed));
        assert_eq!(seen.status, Status::Ok, "{departure_deg:?}: {:?}", seen.quality);
        let shape = seen.quality.and_then(|quality| quality.shape).unwrap();
        let told =
            [shape.tip_theta, shape.sigma_tip_theta, shape.along, shape.sigma_along, shape.across, shape.sigma_across];
        let told = told.map(|v| format!("{:.3}", v.to_degrees()));
        println!("θ {theta_deg} δ {delta_deg} departure {departure_deg:?}: {told:?} χ² {:.2}", shape.chi2);
        let off = [
            (shape.tip_theta.to_degrees() - theta_deg) / shape.sigma_tip_theta.to_degrees(),
            (shape.along.to_degrees() - departure_deg[0]) / shape.sigma_along.to_degrees(),
            (shape.across.to_degrees() - departure_deg[1]) / shape.sigma_across.to_degrees(),
        ];
        assert!(off.iter().all(|off| off.abs() < 4.0), "{departure_deg:?}: off by {off:.2?} σ: {told:?}");
        shape
    };

    let mut sum = 0.0;
    let circles = [(20.0, 0.0), (40.0, 80.0), (60.0, -150.0), (30.0, -60.0), (75.0, 20.0), (50.0, 140.0)];
    for (seed, (theta_deg, delta_deg)) in (10..).zip(circles) {
        sum += shape(theta_deg, delta_deg, [0.0, 0.0], seed).chi2;
    }
    // χ² of two degrees of freedom: 2 on the average, 12 in six draws, above 26 once in a hundred times.
    assert!(sum < 26.0, "Σ χ² {sum:.1}");

    for (seed, departure_deg) in (20..).zip([[3.0, 0.0], [-2.0, 2.5], [0.0, -4.0]]) {
        let shape = shape(50.0, 30.0, departure_deg, seed);
        assert!(shape.chi2 > 20.0, "{departure_deg:?}: χ² {:.1}", shape.chi2);
    }
}

/// Snakes as a laboratory has them: curvature that varies linearly by a share of the bend, S-shaped ones, and ones that leave their
/// plane. a is a_1 = a θ/4 of a [`BendProfile`](snakeloop::robot::BendProfile).
#[test]
fn the_tips_angles_are_measured_whatever_the_shape() {
    const POSES: [(f64, f64); 4] = [(20.0, 10.0), (50.0, -170.0), (75.0, -60.0), (35.0, 110.0)];
    let varying = |share: f64, theta_deg: f64| [[share * theta_deg / 4.0, 0.0], [0.0; 2], [0.0; 2]];
    type Modes = [[f64; 2]; 3];
    let shapes: [(&str, &dyn Fn(f64) -> Modes); 4] = [
        ("curvature varying by −10 %", &|theta| varying(-0.1, theta)),
        ("by 25 %", &|theta| varying(0.25, theta)),
        ("an S of 3°", &|_| [[0.0; 2], [3.0, 0.0], [0.0; 2]]),
        ("3° out of its plane", &|_| [[0.0, 3.0], [0.0; 2], [0.0; 2]]),
    ];
    let scene = laboratory();
    let straight = eye(&scene);
    for (name, modes_deg) in shapes {
        let frames: Vec<_> = (30..)
            .zip(POSES)
            .map(|(seed, (theta_deg, delta_deg))| {
                let bent = Scene { modes_deg: modes_deg(theta_deg), ..scene.clone() };
                frame(&bent, Configuration::from_degrees(theta_deg, delta_deg), seed)
            })
            .collect();
        let eye = straight.clone().refined(frames.clone().into_par_iter());
        let (mut theta, mut delta, mut chi2) = (0.0, 0.0, 0.0);
        for (frame, (theta_deg, delta_deg)) in frames.iter().zip(POSES) {
            let seen = eye.measure(frame);
            let Some(measured) = seen.measured else { panic!("{name}, θ {theta_deg}°: {:?}", seen.status) };
            let off_theta = measured.configuration.theta_deg() - theta_deg;
            let off_delta = (measured.configuration.delta_deg() - delta_deg + 180.0).rem_euclid(360.0) - 180.0;
            theta += off_theta.powi(2) / POSES.len() as f64;
            delta += off_delta.powi(2) / POSES.len() as f64;
            let of = |off_deg: f64, sigma: f64| (off_deg / sigma.to_degrees()).powi(2) / (2 * POSES.len()) as f64;
            chi2 += of(off_theta, measured.sigma_theta) + of(off_delta, measured.sigma_delta);
        }
        let (theta, delta) = (f64::sqrt(theta), f64::sqrt(delta));
        println!("{name}: θ {theta:.3}°, δ {delta:.3}° rms, χ² {chi2:.2}");
        assert!(theta < 0.13 && delta < 0.3 && chi2 < 2.0, "{name}: θ {theta:.3}°, δ {delta:.3}° rms, χ² {chi2:.2}");
    }
}
