//! A user's own effect, given as a formula: hidden, it is named like any of the library, and every command obeys it.

use crate::program::{Sandbox, data, number};

const OWN: &str = r#"
[[effect]]
name = "neighbours_pull"
formula = "share_per_mm * on_1 * q_2 * abs(q_2)"
reading = "one actuator that pulls on the next"
parameters.share_per_mm = { unit = "1/mm", range = [-0.5, 0.5] }

[[effect]]
name = "sheath_grip"
formula = "play * tanh(load / load_n)"
parameters.half_gap_mm = { unit = "mm", range = [0.0, 2.0], start = [0.05, 0.3] }
parameters.load_n = { unit = "N", range = [0.5, 50.0], start = [5.0] }
"#;

const SWEEPS: &str = "--sweeps=0,80,160,-110 --sweep-poses 24 --round-poses 30";

#[test]
fn a_hidden_formula_is_named_fitted_and_obeyed() {
    let sandbox = Sandbox::new();
    sandbox.write("own.toml", OWN);
    let truth = "{ value = 0.03, sd = 0.0, unit = \"1/mm\", range = [-0.5, 0.5] }";
    let hidden = OWN.split("[[effect]]").nth(1).unwrap();
    let hidden: String =
        hidden.lines().filter(|line| !line.starts_with("parameters")).map(|line| format!("{line}\n")).collect();
    sandbox.write("truth.toml", &format!("[[effect]]{hidden}parameters.share_per_mm = {truth}\n"));
    sandbox.simulate("one", &format!("{SWEEPS} --model truth.toml --seed 1"));
    sandbox.simulate("two", &format!("{SWEEPS} --model truth.toml --seed 9"));

    let alone = sandbox.json(&format!("discover {} -o alone", data("one")));
    assert_eq!(alone["verdict"], "unexplained", "{alone:#}");
    let found = sandbox.json(&format!("discover {} --effects own.toml -o found", data("one")));
    assert_eq!(found["verdict"], "named", "{found:#}");
    assert_eq!(found["effects"][0]["name"], "neighbours_pull", "{found:#}");
    let share = &found["effects"][0]["parameters"]["share_per_mm"];
    let (value, sd) = (number(share, "value"), number(share, "sd"));
    assert!((value - 0.03).abs() < 4.0 * sd && sd < 0.002 && share["unit"] == "1/mm", "{share}");
    assert!(sandbox.read("found/report.html").contains("One actuator that pulls on the next"));

    // The model that was written says it all: every command obeys it, and nothing is left to find.
    let again = sandbox.json(&format!("discover {} --model found/model.toml -o again", data("two")));
    assert_eq!(again["verdict"], "none", "{again:#}");
    let evaluated = sandbox.json(&format!("evaluate --model found/model.toml {}", data("two")));
    assert!(number(&evaluated, "rms_eps_mm") < 1.15 * number(&evaluated, "noise_floor_mm"), "{evaluated:#}");
    let table = |model: &str| {
        sandbox.succeed(&format!("table --model {model} --theta-deg 60:60:1 --delta-deg 100:100:1 -o table"));
        sandbox.read("table/compensation.csv")
    };
    assert_ne!(table("found/model.toml"), table("alone/model.toml"));
}

#[test]
fn faults_are_told_with_their_line() {
    let sandbox = Sandbox::new();
    sandbox.simulate(".", "--sweep-poses 10 --round-poses 10");
    for (from, to, words) in [
        ("on_1 * q_2", "on_1 * moon", "own.toml:2: effect neighbours_pull: \"moon\" at character 23"),
        ("tanh(load / load_n)", "tanh(load_n * load / (q - q_1))", "own.toml:8: effect sheath_grip: formula"),
        (
            "[-0.5, 0.5]",
            "[0.5, -0.5]",
            "own.toml:2: effect neighbours_pull: parameter share_per_mm: range = [0.5, -0.5]",
        ),
        ("[0.05, 0.3]", "[0.05, 3.0]", "start = 3 is outside its range"),
        ("neighbours_pull", "creep", "own.toml:2: effect creep: the library has this name"),
        ("sheath_grip", "neighbours_pull", "own.toml:8: effect neighbours_pull: the name stands twice"),
        ("formula = \"play", "formul = \"play", "own.toml:10: unknown field `formul`"),
    ] {
        assert!(OWN.contains(from), "{from}");
        sandbox.write("own.toml", &OWN.replacen(from, to, 1));
        let said = sandbox
            .fail("discover --measurements measurements.csv --encoders encoders.csv --effects own.toml -o out", 1);
        assert!(said.contains(words), "{said}");
    }
}
