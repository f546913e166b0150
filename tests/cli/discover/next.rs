//! `discover --next`: what one experiment cannot tell apart, the proposed one does.

use crate::program::{Sandbox, data};
use serde_json::Value;
use std::fmt::Write;

/// Simulates a robot with a hidden effect along a trajectory, and asks what the model lacks.
fn discover(sandbox: &Sandbox, trajectory: &str, effect: &str, out: &str) -> Value {
    sandbox.simulate(out, &format!("--trajectory {trajectory} --effect {effect}"));
    sandbox.json(&format!("discover {} --next -o {out}", data(out)))
}

/// θ and δ in degrees, a pose every 0.35 s.
fn write_trajectory(sandbox: &Sandbox, name: &str, poses: impl Iterator<Item = (f64, f64)>) {
    let mut text = "index,time_s,theta_deg,delta_deg\n".to_owned();
    for (k, (theta, delta)) in poses.enumerate() {
        writeln!(text, "{k},{:.3},{theta:.4},{delta:.4}", 0.35 * k as f64).unwrap();
    }
    sandbox.write(name, &text);
}

/// Every name that the answer does not rule out.
fn open(found: &Value) -> Vec<&str> {
    let effects = found["effects"].as_array().unwrap().iter();
    effects
        .flat_map(|effect| effect["indistinguishable_from"].as_array().unwrap().iter().chain([&effect["name"]]))
        .map(|name| name.as_str().unwrap())
        .collect()
}

/// The effect is named, alone, and the alternative is ruled out.
fn is_decided(found: &Value, name: &str, alternative: &str) {
    assert_eq!(found["verdict"], "named", "{found:#}");
    assert_eq!(found["effects"].as_array().unwrap().len(), 1, "{found:#}");
    assert_eq!(found["effects"][0]["name"], name, "{found:#}");
    assert!(!open(found).contains(&alternative), "{found:#}");
}

#[test]
fn drag_and_a_late_camera_are_told_apart_where_the_pace_changes() {
    let sandbox = Sandbox::new();
    // Slow turns and no corner: speed and lag are one and the same.
    let even = (0..150).map(|k| (42.0 - 34.0 * (f64::from(k) / 25.0).cos(), 1.5 * f64::from(k)));
    write_trajectory(&sandbox, "even.csv", even);
    for (effect, name, alternative) in [
        ("viscous_drag:drag_n_s_per_mm=2", "viscous_drag", "camera_latency"),
        ("camera_latency:latency_s=0.05", "camera_latency", "viscous_drag"),
    ] {
        let found = discover(&sandbox, "even.csv", effect, "even");
        let names = open(&found);
        assert!(names.contains(&name) && names.contains(&alternative), "{found:#}");
        let words = found["next"]["words"].as_str().unwrap();
        assert!(words.contains("viscous_drag") && words.contains("camera_latency"), "{words}");
        is_decided(&discover(&sandbox, "even/next.csv", effect, "told"), name, alternative);
    }
}

#[test]
fn what_one_plane_hides_more_planes_show() {
    let sandbox = Sandbox::new();
    let plane = (0..150).map(|k| (40.0 - 34.0 * (f64::from(k) / 12.0).cos(), 0.0));
    write_trajectory(&sandbox, "plane.csv", plane);
    // Azimuth errors without a mean are, to first order, a shift of the circle of backbones, as radii are: no trajectory tells them apart.
    for (effect, name) in [
        ("backbone_azimuth:azimuth_error_1_deg=4,azimuth_error_2_deg=-2,azimuth_error_3_deg=2.5", "backbone_azimuth"),
        ("actuator_scale:scale_1=0.03,scale_2=-0.02,scale_3=0.01", "actuator_scale"),
    ] {
        let found = discover(&sandbox, "plane.csv", effect, "plane");
        let remarks = found["remarks"].to_string();
        assert!(remarks.contains("one plane"), "{remarks}");
        assert!(!found["next"].is_null(), "{found:#}");
        is_decided(&discover(&sandbox, "plane/next.csv", effect, "told"), name, "primary_compression");
    }
    let text = sandbox.read("plane/next.csv");
    assert!(text.starts_with("index,time_s,theta_deg,delta_deg,qc1_mm,qc2_mm,qc3_mm\n0,0.0000,"), "{text}");
}
