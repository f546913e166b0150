//! Two cameras around one snake, from rendered frames through the program.

use crate::program::Sandbox;
use crate::scenes::smaller;
use snakeloop::geometry::{Configuration, wrap_degrees};
use snakeloop::observation::{Measurement, Truth};
use snakeloop::simulate::scene::{Scene, Sensor, Viewpoint};
use snakeloop::simulate::{FrameFormat, write_experiment};
use std::path::Path;

/// Where the second camera's image right points. The three backbones look the same when turned by a third, so that the
/// renderer, whose base is the view's own, shows what that camera would see.
const OFFSET_DEG: f64 = 120.0;
const POSES: [(f64, f64); 4] = [(35.0, 90.0), (50.0, 10.0), (30.0, -30.0), (60.0, 160.0)];

fn views(experiment: &Path) -> String {
    let table = |name: &str, offset: f64| {
        let straight = "grid_pitch_mm = 1.0\nstandoff_mm = 25.0";
        format!(
            "[[view]]\nname = \"{name}\"\ncamera = \"{name}/camera.yaml\"\nframes = \"{name}/frames/*.png\"\n\
             straight = \"{name}/straight.png\"\n{straight}\ndelta_offset_deg = {offset}\n"
        )
    };
    let turned = [("side", 0.0), ("front", OFFSET_DEG)];
    for (seed, (name, offset)) in (1..).zip(turned) {
        let scene = Scene {
            sensor: Sensor { rays_per_pixel: 4, blur_px: 0.6, noise: 2.0 },
            view: Viewpoint { pitch_deg: 3.0, ..Scene::default().view },
            ..smaller(Scene::default(), 2)
        };
        let seen = (0..).zip(POSES).map(|(index, (theta, delta))| Truth {
            index,
            configuration: Configuration::from_degrees(theta, delta - offset),
        });
        let seen: Vec<Truth> = seen.collect();
        write_experiment(&experiment.join(name), &scene, &seen, FrameFormat::Png, seed, &|| ()).unwrap();
    }
    turned.map(|(name, offset)| table(name, offset)).concat()
}

fn measure(sandbox: &Sandbox, views: &str) -> Vec<Measurement> {
    sandbox.write("experiment.toml", views);
    sandbox.succeed("measure . -o out --quiet");
    sandbox.measurements("out/measurements.csv")
}

#[test]
fn two_views_are_one_measurement_and_either_answers_for_the_other() {
    let sandbox = Sandbox::new();
    let both = views(sandbox.path());
    let white = image::RgbImage::from_pixel(640, 360, image::Rgb([255; 3]));
    white.save(sandbox.join("front/frames/00003.png")).unwrap();

    let together = measure(&sandbox, &both);
    let names: Vec<_> = together.iter().map(|m| m.view.as_deref().unwrap()).collect();
    assert_eq!(names, ["side+front", "side+front", "side+front", "side"]);
    // Without the azimuth of the second camera the views contradict each other, which is nothing of the encoders'.
    sandbox
        .write("experiment.toml", &both.replace(&format!("= {OFFSET_DEG}"), "= 0.0").replace("*.png", "0000[012].png"));
    let told = sandbox.fail("measure . -o untold --quiet", 1);
    assert!(told.contains("views_disagree") && told.contains("check `delta_offset_deg` of each view"), "{told}");
    let one = both.split("[[view]]").nth(1).map(|table| format!("[[view]]{table}")).unwrap();
    let alone = measure(&sandbox, &one);

    for ((together, alone), (theta, delta)) in together.iter().zip(&alone).zip(POSES) {
        let (angles, single) = (together.measured.unwrap(), alone.measured.unwrap());
        let theta_error = angles.configuration.theta_deg() - theta;
        let delta_error = wrap_degrees(angles.configuration.delta_deg() - delta);
        let told = format!("θ {theta}° δ {delta}°: errors {theta_error:.3}°, {delta_error:.3}°, {angles:?}");
        assert!(theta_error.abs() < 0.2 && delta_error.abs() < 0.6, "{told}");
        assert!(theta_error.abs() < 5.0 * angles.sigma_theta.to_degrees(), "{told}");
        assert!(delta_error.abs() < 5.0 * angles.sigma_delta.to_degrees(), "{told}");
        let area = |c: nalgebra::Matrix2<f64>| c.determinant();
        if together.view.as_deref() == Some("side+front") {
            assert!(area(angles.covariance()) < area(single.covariance()), "{told} {single:?}");
        }
    }
}
