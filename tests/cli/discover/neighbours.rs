//! A section beside a neighbour: from a trajectory with the neighbour's readings to the commands that obey the coupling, and to those that cannot.

use crate::program::{Sandbox, data, number};

/// Sweeps in four planes, while a neighbouring section goes its own way.
fn trajectory() -> String {
    let mut text = "index,time_s,theta_deg,delta_deg,n1_q1_mm,n1_q2_mm,n1_q3_mm\n".to_owned();
    for k in 0..200 {
        let time_s = 0.35 * f64::from(k);
        let theta_deg = 5.0 + 70.0 * (std::f64::consts::PI * f64::from(k % 50) / 50.0).sin();
        let (x, y) = ((time_s / 3.7).sin(), (time_s / 5.3).cos());
        let line = |azimuth_deg: f64| -(x * azimuth_deg.to_radians().cos() + y * azimuth_deg.to_radians().sin());
        let delta_deg = 90 * (k / 50) + 20;
        let row = [line(0.0), line(-120.0), line(-240.0)].map(|q| format!("{q:.6}")).join(",");
        text += &format!("{k},{time_s:.2},{theta_deg:.3},{delta_deg},{row}\n");
    }
    text
}

#[test]
fn a_neighbours_pull_is_simulated_found_and_obeyed_and_asked_for_where_it_is_missing() {
    let sandbox = Sandbox::new();
    sandbox.write("ride.csv", &trajectory());
    let effect = "--effect section_coupling:n1_along=0.12,n1_across=-0.05";
    sandbox.succeed(&format!("simulate {effect} --trajectory ride.csv --observe -o ride"));
    let encoders = sandbox.read("ride/encoders.csv");
    assert!(encoders.starts_with("index,time_s,q1_mm,q2_mm,q3_mm,n1_q1_mm,n1_q2_mm,n1_q3_mm\n"), "{encoders:.100}");

    let found = sandbox.json(&format!("discover {} -o found", data("ride")));
    assert_eq!((&found["verdict"], &found["effects"][0]["name"]), (&"named".into(), &"section_coupling".into()));
    let along = &found["effects"][0]["parameters"]["n1_along"];
    assert!((number(along, "value") - 0.12).abs() < 4.0 * number(along, "sd"), "{along}");

    let ratio = |model: &str, data: &str| {
        let gap = sandbox.json(&format!("evaluate {model} {data}"));
        number(&gap, "rms_eps_mm") / number(&gap, "noise_floor_mm")
    };
    assert!(ratio("--model found/model.toml", &data("ride")) < 1.15);
    let estimated = sandbox.json(&format!("estimate --model found/model.toml {} -o again", data("ride")));
    assert!((number(&estimated, "eta") - 1.0).abs() < 0.05, "{estimated}");
    assert!(ratio("--model again/model.toml", &data("ride")) < 1.15);

    // A log without the neighbour's columns.
    let without: String =
        encoders.lines().map(|line| line.split(',').take(5).collect::<Vec<_>>().join(",") + "\n").collect();
    sandbox.write("ride/alone.csv", &without);
    let alone = data("ride").replace("encoders.csv", "alone.csv");
    for command in ["estimate -o a", "discover -o b", "evaluate"] {
        let said = sandbox.fail(&format!("{command} --model found/model.toml {alone}"), 1);
        assert!(
            said.contains(
                "alone.csv: no readings of neighbouring section 1, which the model's section_coupling follows"
            ),
            "{said}"
        );
    }
    let at_rest = "the neighbouring sections are taken to be at rest";
    for command in ["table -o table", "invert --theta-deg 30 --delta-deg 10"] {
        let output = sandbox.call(&format!("{command} --model found/model.toml"));
        assert!(crate::program::all_said(&output).contains(at_rest), "{command}");
    }
    sandbox.copy_bending(&[0]);
    let said = sandbox.fail("live bending --model found/model.toml -o live", 2);
    assert!(said.contains("`live` reads no neighbouring section's encoders"), "{said}");
}
