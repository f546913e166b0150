//! Robots of more than three backbones, through the program: simulated, estimated, tabled, inverted, searched for effects.

use crate::program::{ETA, LAMBDA_MM, Sandbox, data, known_estimate, number};
use std::path::Path;

/// A folder with robot.toml, of so many backbones, and hidden.toml, the same robot with its η and λ.
fn robot_of(backbones: usize) -> Sandbox {
    let sandbox = Sandbox::new();
    let paper = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("calib/robot.toml")).unwrap();
    let robot = paper.replace("\nbackbones = 3 ", &format!("\nbackbones = {backbones} "));
    assert_eq!(robot == paper, backbones == 3);
    sandbox.write("robot.toml", &robot);
    sandbox.write("hidden.toml", &format!("{robot}\n{}", known_estimate()));
    sandbox
}

fn header(sandbox: &Sandbox, table: &str) -> String {
    sandbox.read(table).lines().next().unwrap().to_owned()
}

#[test]
fn the_chain_from_simulation_to_table_holds_for_four_five_and_six() {
    for backbones in [4usize, 5, 6] {
        let sandbox = robot_of(backbones);
        sandbox.simulate("ride", "--model hidden.toml");
        let q = |name: &str| (1..=backbones).map(|i| format!("{name}{i}_mm")).collect::<Vec<_>>().join(",");
        assert_eq!(header(&sandbox, "ride/encoders.csv"), format!("index,time_s,{}", q("q")));

        let ride = data("ride");
        let found = sandbox.json(&format!("estimate --model robot.toml {ride} -o out"));
        for (name, truth) in [("eta", ETA), ("lambda_mm", LAMBDA_MM)] {
            let (value, sd) = (number(&found, name), number(&found, &format!("sd_{name}")));
            assert!((value - truth).abs() < 3.5 * sd && sd < 0.05, "{backbones}: {name} = {value} ± {sd}");
        }
        assert!(header(&sandbox, "out/estimate.csv").contains(&q("residual")));

        let gap = sandbox.json(&format!("evaluate --model out/model.toml {ride}"));
        // The noise of 36 bends has 72 components, whose rms scatters by 1/√144 = 8 %: three of that.
        let of_floor = number(&gap, "rms_eps_mm") / number(&gap, "noise_floor_mm");
        assert!((0.75..1.25).contains(&of_floor), "{backbones}: {gap:#}");

        sandbox.succeed("table --model out/model.toml --c-header -o table");
        let columns = header(&sandbox, "table/compensation.csv");
        assert_eq!(columns, format!("theta_deg,delta_deg,{},{},{},extrapolated", q("q"), q("qc"), q("sd_qc")));
        let c = sandbox.read("table/compensation.h");
        assert!(c.contains(&format!("double q_command_mm[{backbones}]")), "{c}");

        let wanted = sandbox.json("invert --model out/model.toml --theta-deg 50 --delta-deg 70");
        let qc: Vec<String> = (1..=backbones).map(|i| wanted[format!("qc{i}_mm")].to_string()).collect();
        let reached = sandbox.json(&format!("invert --model out/model.toml --qc-mm={}", qc.join(",")));
        assert!((number(&reached, "theta_deg") - 50.0).abs() < 1e-6, "{reached}");
        assert!((number(&reached, "delta_deg") - 70.0).abs() < 1e-6, "{reached}");
    }
}

#[test]
fn an_effect_on_a_robot_of_four_is_named() {
    for (effect, name) in [
        ("load_directed_backlash:play_mm=0.09", "load_directed_backlash"),
        ("actuator_scale:scale_1=0.03,scale_2=-0.02,scale_3=0.025,scale_4=-0.03", "actuator_scale"),
    ] {
        let sandbox = robot_of(4);
        let ride = "--sweeps=0,80,160,-110 --sweep-poses 34 --round-poses 48 --jitter 1";
        sandbox.simulate("ride", &format!("--model hidden.toml --effect {effect} {ride}"));
        let found = sandbox.json(&format!("discover --model robot.toml {} -o found", data("ride")));
        assert_eq!(found["verdict"], "named", "{found:#}");
        let effects = found["effects"].as_array().unwrap();
        assert_eq!((effects.len(), &effects[0]["name"]), (1, &name.into()), "{found:#}");
        for given in effect.split_once(':').unwrap().1.split(',') {
            let (parameter, value) = given.split_once('=').unwrap();
            let told = &effects[0]["parameters"][parameter];
            let off = number(told, "value") - value.parse::<f64>().unwrap();
            assert!(off.abs() < 4.0 * number(told, "sd"), "{parameter}: {told}");
        }
        let gap = &found["gap"];
        assert!(number(gap, "after_mm") < 1.2 * number(gap, "noise_floor_mm"), "{gap}");
    }
}

#[test]
fn what_does_not_fit_the_number_of_backbones_is_refused() {
    let sandbox = robot_of(4);
    sandbox.simulate("four", "--model hidden.toml");
    sandbox.simulate("three", "");
    let refused = |line: &str, part: &str| {
        let output = sandbox.call(line);
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && said.contains(part), "{line}: {said}");
    };
    refused(
        &format!("estimate {} -o out --model robot.toml", data("three")),
        "three/encoders.csv:1: q1_mm to q3_mm, expected q1_mm to q4_mm: the robot has 4 backbones",
    );
    refused(
        &format!("estimate {} -o out", data("four")),
        "four/encoders.csv:1: q1_mm to q4_mm, expected q1_mm to q3_mm",
    );
    refused("invert --model robot.toml --qc-mm=0.1,0.2,0.3", "--qc-mm: 3 numbers, expected 4");
    refused(
        "table --effect actuator_offset:offset_1_mm=0.1,offset_2_mm=0.1,offset_3_mm=0.1 -o t",
        "on a robot of 3 backbones it takes offset_1_mm, offset_2_mm",
    );
    for (backbones, expected) in [("2", "robot.backbones = 2, expected 3 to 8"), ("300", ":7: ")] {
        let robot = sandbox.read("robot.toml");
        sandbox.write("wrong.toml", &robot.replace("backbones = 4 ", &format!("backbones = {backbones} ")));
        refused("invert --model wrong.toml --theta-deg 1 --delta-deg 0", expected);
    }
}
