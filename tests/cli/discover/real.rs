//! Measurements of a real robot (fixtures/README.md): what `discover` names there, as the book shows, holds on directions that it has not
//! seen.

use crate::program::{Sandbox, number};

#[test]
fn the_bend_at_rest_of_a_real_robot_is_named_and_holds_in_other_directions() {
    let sandbox = Sandbox::new();
    let real = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/real");
    let data =
        |part: &str| format!("--measurements {real}/{part}/measurements.csv --encoders {real}/{part}/encoders.csv");
    let found = sandbox.json(&format!("discover {} --model {real}/robot.toml -o found", data("train")));
    assert_eq!(found["verdict"], "partly", "{found:#}");
    assert_eq!(found["effects"][0]["name"], "rest_bend", "{found:#}");
    // Its makers' own fit of all three sections has about 15° (opencr's README: −9.4, 11.7).
    let size = |name: &str| number(&found["effects"][0]["parameters"][name], "value");
    let bend_deg = size("x_deg").hypot(size("y_deg"));
    assert!((12.0..19.0).contains(&bend_deg), "{bend_deg}°");
    let rms =
        |model: &str| number(&sandbox.json(&format!("evaluate --model {model} {}", data("val"))), "rms_theta_deg");
    let (before, after) = (rms(&format!("{real}/robot.toml")), rms("found/model.toml"));
    assert!(after < 0.25 * before, "{before}° → {after}°");
    let summary = sandbox.read("found/report.html");
    let told = ["Rest bend, ", "° towards −9", "% of the gap"];
    assert!(told.iter().all(|words| summary.contains(words)), "{}", &summary[..2000]);
}
