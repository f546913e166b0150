//! What a model is worth goes wherever it goes: marks, refusals, the range of the data, and the status of the C lookup.

use crate::program::{Sandbox, all_said, data, json, number};
use snakeloop::record::{encoders_csv, read_encoders};
use snakeloop::robot::PerBackbone;
use std::process::Command;

/// A simulated experiment in `lab` with bends to so many degrees, and what is learned from it in `out`.
fn learned(to_deg: u32) -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.write_hidden_model();
    let range = format!("--sweep-theta 5,{to_deg} --round-theta {to_deg}");
    sandbox.simulate("lab", &format!("--model hidden.toml --seed 3 {range}"));
    sandbox.succeed(&format!("estimate {} -o out", data("lab")));
    sandbox
}

#[test]
fn a_model_that_must_not_be_used_is_refused_and_its_outputs_are_marked() {
    let sandbox = learned(76);
    let log = read_encoders(&sandbox.join("lab/encoders.csv"), 3).unwrap().rows;
    let micrometres = |q: PerBackbone| q.map(|mm| 1000.0 * mm);
    let log: Vec<_> =
        log.iter().map(|row| snakeloop::observation::EncoderReading { q_mm: micrometres(row.q_mm), ..*row }).collect();
    sandbox.write("lab/encoders.csv", &encoders_csv(&log, 3));
    sandbox.succeed(&format!("estimate {} -o bad", data("lab")));
    assert!(sandbox.read("bad/model.toml").starts_with("# verdict: do not use"));
    let good = sandbox.read("out/model.toml");
    sandbox.write("eta.toml", &changed(&good, "eta", "-1.0"));
    sandbox.write("large.toml", &changed(&good, "eta", "126.0"));
    sandbox.write("lambda.toml", &changed(&good, "lambda_mm", "50.0"));
    for model in ["bad/model.toml", "eta.toml", "large.toml", "lambda.toml"] {
        for call in [
            "table -o table".to_owned(),
            "invert --theta-deg 30 --delta-deg 0".to_owned(),
            "simulate -o simulated".to_owned(),
            format!("estimate {} -o again", data("lab")),
        ] {
            let said = sandbox.fail(&format!("{call} --model {model}"), 1);
            assert!(
                said.contains(model) && said.contains("must not be used") && said.contains("--even-if-bad"),
                "{said}"
            );
        }
        assert!(!sandbox.join("table/compensation.csv").exists() && !sandbox.join("simulated/encoders.csv").exists());
    }
    for (key, value) in [("sd_eta", "-0.1"), ("sd_lambda_mm", "-0.1")] {
        sandbox.write("sd.toml", &changed(&good, key, value));
        let said = sandbox.fail("invert --model sd.toml --theta-deg 30 --delta-deg 0", 1);
        assert!(said.contains(&format!("estimate.{key} = -0.1, expected 0 to")), "{said}");
    }
    // All the same, and marked in all that is written.
    sandbox.succeed("table --model bad/model.toml --c-header --even-if-bad -o marked");
    let csv = sandbox.read("marked/compensation.csv");
    assert!(csv.lines().next().unwrap().ends_with(",extrapolated,do_not_use"));
    assert!(csv.lines().skip(1).all(|line| line.ends_with(",1")));
    assert!(json(&sandbox.read("marked/compensation.json"))["do_not_use"].as_str().unwrap().contains("micrometres"));
    assert!(sandbox.read("marked/compensation.h").contains("DO NOT USE: "));
    let answer = sandbox.json("invert --model bad/model.toml --theta-deg 30 --delta-deg 0 --even-if-bad");
    assert!(answer["do_not_use"].is_string());
    let again = sandbox.json(&format!("estimate {} --model bad/model.toml --even-if-bad -o again", data("lab")));
    assert_eq!(again["verdict"]["level"], "do_not_use");
    // The table that `estimate` would not have written is not marked where the model is right.
    sandbox.succeed("table --model out/model.toml -o right");
    assert!(sandbox.read("right/compensation.csv").lines().next().unwrap().ends_with(",extrapolated"));
}

/// A model.toml with another value of a key.
fn changed(text: &str, key: &str, value: &str) -> String {
    let line =
        |line: &str| if line.starts_with(&format!("{key} = ")) { format!("{key} = {value}") } else { line.to_owned() };
    let changed: Vec<String> = text.lines().map(line).collect();
    assert_ne!(changed.join("\n"), text.trim_end(), "{key}");
    changed.join("\n") + "\n"
}

#[test]
fn beyond_the_data_every_output_is_marked_and_sigma_says_what_may_be_missed() {
    let sandbox = learned(35);
    let model =
        json(&serde_json::to_string(&toml::from_str::<toml::Table>(&sandbox.read("out/model.toml")).unwrap()).unwrap());
    let largest = number(&model["learned"], "theta_max_deg");
    assert!((34.0..37.0).contains(&largest), "{model:#}");
    assert_eq!(model["learned"]["delta_deg"].as_array().unwrap().len(), 12);
    // The table ends where the data end, unless it is asked for more.
    sandbox.succeed("table --model out/model.toml -o own");
    assert!(sandbox.read("own/compensation.csv").lines().last().unwrap().starts_with("35.0"));
    let asked = sandbox.call("table --model out/model.toml --theta-deg 0:90:15 --c-header -o asked");
    assert!(asked.status.success() && all_said(&asked).contains("beyond the bends that the model was learned on"));
    for line in sandbox.read("asked/compensation.csv").lines().skip(1) {
        let fields: Vec<f64> = line.split(',').map(|field| field.parse().unwrap()).collect();
        let is_beyond = fields[0] > 36.0;
        assert_eq!(fields[11], f64::from(u8::from(is_beyond)), "{line}");
        let sd = fields[8..11].iter().copied().fold(0.0, f64::max);
        assert!(if is_beyond { sd > 0.01 } else { sd < 0.01 }, "{line}");
    }
    let rows = json(&sandbox.read("asked/compensation.json"));
    assert_eq!((&rows["rows"][0]["extrapolated"], &rows["rows"][100]["extrapolated"]), (&json("0"), &json("1")));
    for (theta, extrapolated) in [(30, 0), (75, 1)] {
        let answer = sandbox.json(&format!("invert --model out/model.toml --theta-deg {theta} --delta-deg 20"));
        assert_eq!(answer["extrapolated"], json(&extrapolated.to_string()));
        let command: Vec<String> = (1..4).map(|i| number(&answer, &format!("qc{i}_mm")).to_string()).collect();
        let back = sandbox.json(&format!("invert --model out/model.toml --qc-mm={}", command.join(",")));
        assert_eq!(back["extrapolated"], json(&extrapolated.to_string()));
        assert_eq!(number(&back, "sd_theta_deg") > 1.0, extrapolated == 1, "{back}");
    }
    assert_eq!(statuses(&sandbox, "asked", &[(10, 0), (30, 50), (32, 0), (60, 50), (91, 0)]), [0, 0, 3, 3, 1]);
}

#[test]
fn the_lookup_in_c_tells_poses_beyond_the_force_limits() {
    let sandbox = learned(76);
    sandbox.call("table --model out/model.toml --force-limits=-20,5 --c-header -o limits");
    let csv = sandbox.read("limits/compensation.csv");
    let column = csv.lines().next().unwrap().split(',').position(|name| name == "within_limits").unwrap();
    let mut seen = [0, 0];
    let poses: Vec<(i32, i32)> =
        (0..75).step_by(5).flat_map(|theta| [-165, 0, 75].map(|delta| (theta, delta))).collect();
    for ((theta, delta), status) in poses.iter().zip(statuses(&sandbox, "limits", &poses)) {
        let start = format!("{theta}.000000,{delta}.000000,");
        let row = csv.lines().find(|line| line.starts_with(&start)).unwrap();
        let within = row.split(',').nth(column).unwrap() == "1";
        assert_eq!(status, if within { 0 } else { 2 }, "{row}");
        seen[usize::from(within)] += 1;
    }
    assert!(seen[0] > 5 && seen[1] > 5, "{seen:?}");
}

/// What the compiled lookup returns at these poses.
fn statuses(sandbox: &Sandbox, table: &str, poses: &[(i32, i32)]) -> Vec<i32> {
    let lookups: String = poses
        .iter()
        .map(|(theta, delta)| format!("    printf(\"%d\\n\", snakeloop_command({theta}.0, {delta}.0, q));\n"))
        .collect();
    let program = format!(
        "#include \"compensation.h\"\n#include <stdio.h>\nint main(void)\n{{\n    double q[3];\n{lookups}    return 0;\n}}\n"
    );
    sandbox.write(&format!("{table}/main.c"), &program);
    let (source, lookup) = (sandbox.join(&format!("{table}/main.c")), sandbox.join(&format!("{table}/lookup")));
    let flags = ["-std=c89", "-pedantic", "-Wall", "-Wextra", "-Werror", "-o"];
    let built = Command::new("cc").args(flags).arg(&lookup).arg(&source).arg("-lm").output().unwrap();
    assert!(built.status.success(), "{}", all_said(&built));
    let said = Command::new(&lookup).output().unwrap();
    String::from_utf8(said.stdout).unwrap().lines().map(|line| line.parse().unwrap()).collect()
}

/// Puts the force that backbones share within limits into a log, as a table made for them commands the robot.
fn command_within(sandbox: &Sandbox, log: &str, model: &str, (pull_n, push_n): (f64, f64)) {
    let rows = read_encoders(&sandbox.join(log), 3).unwrap().rows;
    let model = snakeloop::record::read_model(&sandbox.join(model)).unwrap();
    let limits = snakeloop::robot::ForceLimits::new(pull_n, push_n).unwrap();
    let shared = |row: &snakeloop::observation::EncoderReading| {
        let pose = model.forward(&row.q_mm).unwrap().configuration;
        snakeloop::observation::EncoderReading { q_mm: row.q_mm + model.sharing(pose, &limits).shift_mm, ..*row }
    };
    sandbox.write(log, &encoders_csv(&rows.iter().map(shared).collect::<Vec<_>>(), 3));
}

#[test]
fn evaluate_and_run_know_the_shared_force_once_they_are_told_of_it() {
    let sandbox = learned(76);
    command_within(&sandbox, "lab/encoders.csv", "out/model.toml", (-60.0, 15.0));
    let evaluate = format!("evaluate --model out/model.toml {}", data("lab"));
    let [told, untold] = ["--force-limits=-60,15", ""].map(|limits| sandbox.json(&format!("{evaluate} {limits}")));
    assert_eq!(told["verdict"]["level"], "good", "{told:#}");
    // The floor is that of the noise of 36 bends, whose rms scatters by 8 %.
    assert!(number(&told, "rms_eps_mm") < 1.25 * number(&told, "noise_floor_mm"), "{told:#}");
    assert!(number(&untold, "rms_eps_mm") > 2.0 * number(&told, "rms_eps_mm"), "{untold:#}");

    let sandbox = super::fixture::sandbox();
    let run = |more: &str| sandbox.json(&format!("run experiment -o out --overlays none {more}"));
    let plain = run("");
    command_within(&sandbox, "experiment/encoders.csv", "out/model.toml", (-20.0, 5.0));
    let (untold, told) = (run(""), run("--force-limits=-20,5"));
    let (lambda, sd) = (number(&plain, "lambda_mm"), number(&plain, "sd_lambda_mm"));
    assert!((number(&told, "lambda_mm") - lambda).abs() < sd && told["verdict"]["level"] == plain["verdict"]["level"]);
    assert!((number(&untold, "lambda_mm") - lambda).abs() > 2.0 * sd, "{untold:#}");
    assert!(sandbox.read("out/model.toml").contains("force_limits"), "what it was made from");
}

#[test]
fn the_play_is_found_behind_force_limits_once_they_are_told() {
    let sandbox = learned(76);
    command_within(&sandbox, "lab/encoders.csv", "out/model.toml", (-60.0, 15.0));
    let told = sandbox.json(&format!("estimate {} --force-limits=-60,15 -o told", data("lab")));
    let (lambda, sd) = (number(&told, "lambda_mm"), number(&told, "sd_lambda_mm"));
    assert!((lambda - 0.1765).abs() < 2.0 * sd && sd < 0.01, "{told:#}");
    assert_eq!(told["verdict"]["level"], "good", "{told:#}");
    // Told where none acted: the bends are right, and λ is doubted by name.
    sandbox.simulate("lab", "--model hidden.toml --seed 3 --sweep-theta 5,76 --round-theta 76");
    let none = sandbox.json(&format!("estimate {} --force-limits=-60,15 -o none", data("lab")));
    let first = &none["verdict"]["reasons"][0];
    assert_eq!((&none["verdict"]["level"], &first["code"]), (&"look".into(), &"force_limits".into()), "{none:#}");
    assert!(first["text"].as_str().unwrap().starts_with("the log reads as if no force limits had acted"), "{first}");
}
