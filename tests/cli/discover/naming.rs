//! `discover` from the outside: a hidden effect is named, added, obeyed, and not found again.

use crate::program::{Sandbox, data, json, number};

#[test]
fn the_hidden_effect_is_named_added_and_not_found_again() {
    let sandbox = Sandbox::new();
    let hidden =
        "--sweeps=0,80,160,-110 --sweep-poses 30 --round-poses 40 --effect load_directed_backlash:play_mm=0.08";
    sandbox.simulate("one", &format!("{hidden} --seed 1"));
    sandbox.simulate("two", &format!("{hidden} --seed 9"));

    let found = sandbox.json(&format!("discover {} -o found", data("one")));
    assert_eq!(found["verdict"], "named", "{found:#}");
    assert_eq!(found["effects"][0]["name"], "load_directed_backlash");
    let play = &found["effects"][0]["parameters"]["play_mm"];
    let (value, sd) = (number(play, "value"), number(play, "sd"));
    assert!((value - 0.08).abs() < 4.0 * sd && sd < 0.002 && play["unit"] == "mm", "{play}");
    let gap = |key: &str| number(&found["gap"], key);
    assert!(gap("after_mm") < 1.15 * gap("noise_floor_mm") && gap("before_mm") > 2.0 * gap("noise_floor_mm"));
    assert_eq!(json(&sandbox.read("found/discrepancy.json")), found);
    assert!(sandbox.read("found/report.html").contains("play in the actuators"));

    let again = sandbox.json(&format!("discover {} --model found/model.toml -o again", data("two")));
    assert_eq!(again["verdict"], "none", "{again:#}");
    let evaluated = sandbox.json(&format!("evaluate --model found/model.toml {}", data("two")));
    let ratio = number(&evaluated, "rms_eps_mm") / number(&evaluated, "noise_floor_mm");
    assert!(ratio < 1.15, "{evaluated:#}");
}

#[test]
fn what_cannot_be_decided_is_said() {
    let sandbox = Sandbox::new();
    sandbox.simulate("few", "--sweep-poses 2 --round-poses 0");
    let message = sandbox.fail(&format!("discover {} -o out", data("few")), 1);
    assert!(message.contains("8 usable samples"), "{message}");
    let message = sandbox.fail("simulate --effect gremlins:size=1 -o out", 2);
    assert!(message.contains("load_directed_backlash"), "{message}");
}
