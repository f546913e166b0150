//! One command at a time: what it prints, what it writes, and how it refuses.

use crate::program::{ETA, LAMBDA_MM, Sandbox, all_said, data, json, number};
use std::fs;
use std::path::Path;

/// A folder with hidden.toml and the tables of an experiment that obeys it, in `ride`.
fn simulated() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.write_hidden_model();
    sandbox.simulate("ride", "--model hidden.toml");
    sandbox
}

/// A file of the repository.
fn bundled(name: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).unwrap()
}

#[test]
fn help_shows_an_example_and_wrong_usage_is_exit_code_2() {
    let sandbox = Sandbox::new();
    assert!(sandbox.succeed("--help").contains("Example:\n  snakeloop run "));
    assert!(sandbox.succeed("calibrate friction --help").contains("Example:"));
    assert!(sandbox.fail("invert --theta-deg 30", 2).contains("--delta-deg"));
    assert!(sandbox.fail("no-such-command", 2).contains("no-such-command"));
}

#[test]
fn friction_is_table_ii() {
    let sandbox = Sandbox::new();
    sandbox.write("friction.csv", &bundled("calib/friction.csv"));
    let fit = sandbox.json("calibrate friction friction.csv");
    let near = |key: &str, expected: f64, tolerance: f64| {
        let value = number(&fit, key);
        assert!((value - expected).abs() <= tolerance, "{key}: {value}, expected {expected}");
    };
    near("mu", 0.1727, 0.00005);
    near("static_force_n", 1.921, 0.0005);
    near("static_force_n_at_g10", 1.959, 0.0005);
    let text = sandbox.succeed("calibrate friction");
    assert!(text.contains("1.921 ± 0.130 N") && text.contains("1.959 ± 0.133 N"), "{text}");
}

#[test]
fn estimate_finds_the_hidden_model_and_evaluate_sees_it_explain_the_data() {
    let sandbox = simulated();
    let ride = data("ride");
    let found = sandbox.json(&format!("estimate {ride} -o out"));
    for (name, hidden) in [("eta", ETA), ("lambda_mm", LAMBDA_MM)] {
        let (value, sd) = (number(&found, name), number(&found, &format!("sd_{name}")));
        assert!((value - hidden).abs() < 3.0 * sd, "{name} = {value} ± {sd}, hidden {hidden}");
    }
    assert_eq!(sandbox.rows("out/estimate.csv"), 36, "one row a measurement");

    let learned = sandbox.json(&format!("evaluate {ride} --model out/model.toml --truth ride/truth.csv"));
    let naive = sandbox.json(&format!("evaluate {ride}"));
    assert_eq!(learned["samples"], 36);
    // The noise of 36 bends has 72 components, whose rms scatters by 1/√144 = 8 %: three of that.
    let of_floor = number(&learned, "rms_eps_mm") / number(&learned, "noise_floor_mm");
    assert!((0.75..1.25).contains(&of_floor), "{learned:#}");
    assert!(number(&naive, "rms_eps_mm") > 3.0 * number(&naive, "noise_floor_mm"), "{naive:#}");
    // The measurements' own noise is 0.2° in θ (the plant's default eye), and is all that is left.
    let seen = number(&learned["accuracy"]["theta"], "rms_deg");
    assert!((number(&learned, "rms_theta_deg") / seen - 1.0).abs() < 0.2, "{learned:#}");
    assert!(number(&naive, "rms_theta_deg") > 1.0, "{naive:#}");
}

#[test]
fn measurements_that_a_models_effects_were_learned_from_already_are_told() {
    let sandbox = simulated();
    sandbox.simulate("other", "--model hidden.toml --seed 2");
    let [ride, other] = ["ride", "other"].map(data);
    sandbox.succeed(&format!("estimate {ride} -o out"));
    // As a discovery from the same measurements would have left it.
    let effect = |sd: &str| {
        format!(
            "[[effect]]\nname = \"creep\"\nparameters.share = {{ value = 0.05{sd}, unit = \"1\" }}\n\
                 parameters.time_constant_s = {{ value = 4.0, unit = \"s\" }}\n\n[estimate]"
        )
    };
    let model = sandbox.read("out/model.toml");
    sandbox.write("learned.toml", &model.replace("[estimate]", &effect(", sd = 0.01")));
    sandbox.write("given.toml", &model.replace("[estimate]", &effect("")));
    let said = |model: &str, data: &str| all_said(&sandbox.call(&format!("estimate {data} --model {model} -o again")));
    assert!(said("learned.toml", &ride).contains("measurements.csv already, whose measurements now count twice"));
    assert!(!said("learned.toml", &other).contains("count twice"));
    assert!(!said("given.toml", &ride).contains("count twice"));
}

#[test]
fn invert_goes_both_ways() {
    let sandbox = Sandbox::new();
    let there = sandbox.json("invert --theta-deg 40 --delta-deg -100");
    let q = ["qc1_mm", "qc2_mm", "qc3_mm"].map(|name| there[name].to_string());
    let back = sandbox.json(&format!("invert --qc-mm {}", q.join(",")));
    assert!((number(&back, "theta_deg") - 40.0).abs() < 1e-6);
    assert!((number(&back, "delta_deg") + 100.0).abs() < 1e-6);
    assert!(sandbox.fail("invert --theta-deg 150 --delta-deg 0", 1).contains("outside the workspace"));
    assert!(sandbox.fail("invert --qc-mm 1,2", 2).contains("expected 3"));
}

#[test]
fn the_table_is_the_paper_model_on_the_grid_that_was_asked_for() {
    let sandbox = Sandbox::new();
    sandbox.succeed("table --theta-deg 0:60:30 --delta-deg=-90:90:90 -o .");
    // The golden file was written by this program; its figures were compared with Eq. 18 by the model's own tests.
    assert_eq!(sandbox.read("compensation.csv"), bundled("tests/golden/compensation.csv"));
    let table = json(&sandbox.read("compensation.json"));
    assert_eq!(table["rows"].as_array().unwrap().len(), 9);
    assert!(sandbox.fail("table --theta-deg 0:150:10 -o .", 2).contains("0 to 120"));
    assert!(sandbox.fail("table --theta-deg 0:x:10 -o .", 2).contains("start:stop:step"));
}

#[test]
fn one_bad_row_costs_one_measurement_and_is_named() {
    let sandbox = simulated();
    let good = sandbox.read("ride/encoders.csv");
    let bad: Vec<&str> = good.lines().map(|line| if line.starts_with("7,") { "7,abc,NaN,," } else { line }).collect();
    sandbox.write("ride/encoders.csv", &bad.join("\n"));
    let output = sandbox.call(&format!("estimate {} -o out --json", data("ride")));
    assert!(output.status.success());
    let warning = String::from_utf8(output.stderr).unwrap();
    assert!(warning.contains("encoders.csv:9: time_s is \"abc\", expected a number"), "{warning}");
    let counts = json(&String::from_utf8(output.stdout).unwrap());
    assert_eq!((&counts["used"], &counts["skipped"]), (&35.into(), &1.into()));
    assert_eq!(counts["reasons"]["no_encoder_reading"], 1);
}

#[test]
fn quiet_says_nothing() {
    let sandbox = simulated();
    assert_eq!(sandbox.succeed(&format!("estimate --quiet {} -o out", data("ride"))), "");
}

#[test]
fn rendered_frames_are_an_experiment() {
    let sandbox = Sandbox::new();
    sandbox.write("poses.csv", "index,theta_deg,delta_deg\n3,40,30\n");
    sandbox.succeed("render --poses poses.csv -o made --quiet");
    for name in ["frames/00003.png", "straight.png", "camera.yaml", "scene.toml"] {
        assert!(sandbox.join("made").join(name).is_file(), "{name}");
    }
    let experiment = snakeloop::record::Experiment::read(&sandbox.join("made")).unwrap();
    assert_eq!((experiment.views.len(), experiment.encoders), (1, None));
}

#[test]
fn reproduce_sets_the_papers_figures_beside_its_own() {
    let sandbox = Sandbox::new();
    let result = sandbox.json("reproduce -o .");
    let mu = result["comparisons"].as_array().unwrap().iter().find(|c| c["quantity"] == "μ by least squares").unwrap();
    assert_eq!(mu["paper"], 0.1727);
    assert!((number(mu, "ours") - 0.1727).abs() < 5e-5);
    for name in ["report.html", "comparisons.csv", "figure_10.csv", "table_iii.csv", "equation_26.csv"] {
        assert!(sandbox.join(name).is_file(), "{name}");
    }
}

#[test]
fn estimate_follows_a_stem() {
    let sandbox = simulated();
    let ride = data("ride");
    sandbox.succeed(&format!("estimate {ride} -o out"));
    let stem = sandbox.json(&format!("estimate --stem --model out/model.toml {ride} -o stem"));
    let (phi, sd) = (number(&stem, "phi_deg"), number(&stem, "sd_phi_deg"));
    assert!((phi - 82.0).abs() < 3.0 * sd && sd < 20.0, "{phi} ± {sd}, the cone's is 82°");
    assert_eq!(sandbox.rows("stem/stem.csv"), 36);
    assert!(sandbox.fail(&format!("estimate --stem {ride} -o out"), 2).contains("--model"));
}

#[test]
fn force_finds_the_load_that_the_snake_carried() {
    let sandbox = simulated();
    let load = "--effect tip_load:fx_n=0.3,fy_n=-0.2,fz_n=0.1";
    sandbox.simulate("loaded", &format!("--model hidden.toml {load}"));
    let found = sandbox.json(&format!("force --model hidden.toml {} -o loaded", data("loaded")));
    for (k, truth) in [0.3, -0.2, 0.1].into_iter().enumerate() {
        let (value, variance) = (found["force_n"][k].as_f64().unwrap(), found["covariance_n2"][k][k].as_f64().unwrap());
        assert!((value - truth).abs() < 4.0 * variance.sqrt() && variance.sqrt() < 0.2, "{found}");
    }
    assert_eq!(found["unseen"].as_array().unwrap().len(), 0);
    assert_eq!(sandbox.rows("loaded/force.csv"), 36);
    // A load that the table knows of changes what it commands.
    let unloaded = "invert --theta-deg 40 --delta-deg 10";
    assert_ne!(sandbox.json(unloaded), sandbox.json(&format!("{unloaded} {load}")));
}

#[test]
fn the_table_shares_the_load_within_limits_and_speaks_c() {
    let sandbox = Sandbox::new();
    sandbox.succeed("table --force-limits=-90,20 --c-header -o .");
    let mut reader = csv::Reader::from_path(sandbox.join("compensation.csv")).unwrap();
    let header = reader.headers().unwrap().clone();
    let column = |name: &str| header.iter().position(|column| column == name).unwrap();
    let columns = ["f1_n", "f2_n", "f3_n", "within_limits"].map(column);
    let mut rows = 0;
    for row in reader.records() {
        let row = row.unwrap();
        let [a, b, c, within] = columns.map(|column| row[column].parse::<f64>().unwrap());
        assert!(within == 1.0 && [a, b, c].iter().all(|force| (-90.0..=20.0 + 1e-6).contains(force)), "{row:?}");
        rows += 1;
    }
    assert_eq!(rows, 19 * 24, "the default grid");
    assert!(sandbox.read("compensation.h").contains("snakeloop_command"));
    assert!(sandbox.fail("table --force-limits=20,-90 -o .", 2).contains("largest pull"));
}

#[test]
fn shells_and_man_know_every_command() {
    let sandbox = Sandbox::new();
    for shell in ["bash", "zsh", "fish"] {
        let script = sandbox.succeed(&format!("completions {shell}"));
        assert!(script.contains("reproduce") && script.contains("grid-pitch"), "{shell}");
    }
    sandbox.succeed("manual -o .");
    for page in ["snakeloop.1", "snakeloop-run.1", "snakeloop-calibrate-rig.1"] {
        let page = sandbox.read(page);
        assert!(page.contains(".TH") && page.contains("Example"), "{page}");
    }
}

#[test]
fn a_run_is_exported_as_a_recording() {
    let sandbox = simulated();
    sandbox.succeed(&format!("estimate {} -o ride", data("ride")));
    let recorded = sandbox.json("export ride -o run.mcap");
    for (topic, table) in [("/measurement", "measurements"), ("/encoders", "encoders"), ("/estimate", "estimate")] {
        assert_eq!(recorded["messages"][topic], sandbox.rows(&format!("ride/{table}.csv")), "{topic}");
    }
    assert!(fs::read(sandbox.join("run.mcap")).unwrap().starts_with(b"\x89MCAP0"));
    assert!(sandbox.fail("export nowhere -o run.mcap", 1).contains("measurements.csv: cannot read"));
}
