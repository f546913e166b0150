use super::*;
use proptest::prelude::*;

pub fn estimated() -> Model {
    let covariance = Matrix2::new(1.6e-5, 2e-7, 2e-7, 3.6e-7);
    let estimate = Estimate { eta: 1.221, lambda_mm: 0.1765, covariance, samples: 36 };
    Model::default().with_estimate(estimate)
}

pub fn read_text(text: &str) -> Result<Model> {
    parse(Path::new("lab/model.toml"), text)
}

pub fn message(text: &str) -> String {
    read_text(text).unwrap_err().to_string()
}

#[test]
fn the_calibration_file_is_the_papers_robot() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("calib/robot.toml");
    assert_eq!(read_model(&path).unwrap(), Model::default());
}

#[test]
fn what_is_left_out_is_the_papers() {
    assert_eq!(read_text("").unwrap(), Model::default());
}

#[test]
fn another_robot_is_read_and_one_that_cannot_be_built_is_named_by_its_key() {
    let text = model_toml(&Model::default()).unwrap();
    let other = text
        .replace("length_mm = 26.0", "length_mm = 35.0")
        .replace("backbone_circle_radius_mm = 1.5", "backbone_circle_radius_mm = 2.0")
        .replace("disk_diameter_mm = 4.2", "disk_diameter_mm = 5.4");
    let model = read_text(&other).unwrap();
    // Closed forms of the other robot: q_1 at θ = 90°, and the pose that its command leads back to.
    let psi = crate::geometry::Configuration::from_degrees(90.0, 0.0);
    assert!((model.robot.joint_displacements(psi)[0] + std::f64::consts::PI).abs() < 1e-12);
    let back = model.forward(&model.command(psi)).unwrap().configuration;
    assert!((back.theta - psi.theta).abs() < 1e-9);
    let fat = message(&text.replace("backbone_circle_radius_mm = 1.5", "backbone_circle_radius_mm = 0.6"));
    assert!(fat.contains("robot.backbone_circle_radius_mm = 0.6") && fat.contains("no tube within another"), "{fat}");
    let small = message(&text.replace("disk_diameter_mm = 4.2", "disk_diameter_mm = 3.5"));
    assert!(small.contains("robot.body.disk_diameter_mm = 3.5") && small.contains("all tubes"), "{small}");

    let positions = "spacer_disk_count = 3\ndisk_positions_mm = [3.0, 4.0, 20.0]\n\n[robot.body.tool]\nlength_mm = 5.0\ndiameter_mm = 2.0";
    let text = text.replace("spacer_disk_count = 6", positions);
    let uneven = read_text(&text).unwrap();
    assert_eq!(uneven.robot.spacer_middles_mm(), [3.0, 4.0, 20.0]);
    assert_eq!(uneven.robot.body.tool.map(|tool| tool.length_mm), Some(5.0));
    assert_eq!(read_text(&model_toml(&uneven).unwrap()).unwrap(), uneven);
    let line = 1 + text.lines().position(|line| line.starts_with("disk_positions_mm")).unwrap();
    let within = message(&text.replace("[3.0, 4.0, 20.0]", "[3.0, 3.5, 20.0]"));
    assert!(within.contains(&format!("model.toml:{line}: robot.body.disk_positions_mm[1] = 3.5")), "{within}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn what_was_written_is_read(eta in 0.1..5.0f64, lambda_mm in -1.0..1.0f64, sd in 1e-9..1.0f64, rho in -1.0..1.0f64, length_mm in 10.0..99.0f64) {
        let mut model = estimated();
        model.robot.length_mm = length_mm;
        let covariance = Matrix2::new(sd * sd, rho * sd * 1e-3, rho * sd * 1e-3, 1e-6);
        model = model.with_estimate(Estimate { eta, lambda_mm, covariance, samples: 7 });
        let back = read_text(&model_toml(&model).unwrap()).unwrap();
        prop_assert_eq!(&back.robot, &model.robot);
        prop_assert_eq!(back.friction, model.friction);
        let read = back.estimate().unwrap();
        prop_assert_eq!((read.eta, read.lambda_mm, read.samples), (eta, lambda_mm, 7));
        prop_assert!((read.covariance - covariance).amax() <= 1e-12 * covariance.amax());
    }

    #[test]
    fn no_text_panics(text in "\\PC{0,200}") {
        let _ = read_text(&text);
    }
}

#[test]
fn a_file_is_written_and_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.toml");
    write_model(&path, &estimated()).unwrap();
    assert_eq!(read_model(&path).unwrap().estimate().unwrap().samples, 36);
}

#[test]
fn an_unknown_key_is_named_with_its_line() {
    let text =
        "[friction]\nmu = 0.2\nstatic_force_n = 1.9\nsd_mu = 0\nsd_static_force_n = 0\ncorrelation = 0\nmuu = 1\n";
    let message = message(text);
    assert!(message.contains("lab/model.toml:7") && message.contains("muu"), "{message}");
}

#[test]
fn an_implausible_number_is_named_with_its_line() {
    let good = model_toml(&estimated()).unwrap();
    for (from, to, key) in [
        ("length_mm = 26.0", "length_mm = -26.0", "robot.length_mm"),
        ("cone_bend_angle_deg = 41.0", "cone_bend_angle_deg = nan", "robot.line.cone_bend_angle_deg"),
        ("inner_diameter_mm = 0.5", "inner_diameter_mm = 0.66", "robot.primary.inner_diameter_mm"),
        ("eta = 1.221", "eta = inf", "estimate.eta"),
        ("mu = 0.1727", "mu = 17.27", "friction.mu"),
    ] {
        assert!(good.contains(from), "{good}");
        let bad = good.replacen(from, to, 1);
        let line = 1 + bad.lines().position(|line| line == to).unwrap();
        let message = message(&bad);
        assert!(message.contains(&format!("model.toml:{line}: {key} =")), "{message}");
    }
}

#[test]
fn text_in_place_of_a_number_is_an_error_with_its_line() {
    let text = model_toml(&estimated()).unwrap().replacen("eta = 1.221", "eta = \"much\"", 1);
    assert!(message(&text).contains("expected f64"), "{}", message(&text));
}

#[test]
fn an_effect_that_is_not_known_is_named() {
    let message = message("\n\n[[effect]]\nname = \"moon_phase\"\n");
    assert!(message.contains("model.toml:3") && message.contains("moon_phase"), "{message}");
}

#[test]
fn a_robot_of_some_constants_has_the_papers_for_the_others() {
    use serde_json::json;
    let constants = json!({"length_mm": 35, "secondary": {"youngs_modulus_gpa": 60.0}, "body": {"tool": {"length_mm": 5, "diameter_mm": 2}}});
    let robot = robot_of(constants).unwrap();
    let mut expected = Robot { length_mm: 35.0, ..Robot::default() };
    expected.secondary.youngs_modulus_gpa = 60.0;
    expected.body.tool = Some(crate::robot::Tool { length_mm: 5.0, diameter_mm: 2.0 });
    assert_eq!(robot, expected);
    for (wrong, parts) in [
        (json!({"lenght_mm": 35.0}), ["lenght_mm", "length_mm, "]),
        (json!({"line": {"cone_mm": 1.0}}), ["cone_mm", "cone_straight_mm"]),
        (json!({"length_mm": "long"}), ["long", "f64"]),
        (json!({"length_mm": -26.0}), ["robot.length_mm = -26", "robot: "]),
    ] {
        let message = robot_of(wrong).unwrap_err().to_string().replace('`', "");
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
    }
}

#[test]
fn a_model_that_could_not_be_read_back_is_not_written() {
    let mut model = estimated();
    model.eta = f64::NAN;
    assert!(model_toml(&model).unwrap_err().to_string().contains("estimate.eta"));
}
