//! Snakes that are not bent to a circle, on rendered frames: the departure that was put in comes out, and a circle is one.

use crate::scenes::{eye, frame, laboratory};
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
