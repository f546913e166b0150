//! model.toml: one robot's constants, its friction, and η and λ once they were estimated.
//!
//! ```toml
//! [robot]              # backbones = 4 where there are not three; and [robot.primary], [robot.secondary], [robot.line], [robot.body]: units in the key names
//! [friction]           # mu, static_force_n and how well they are known
//! [estimate]           # absent until something was estimated
//! eta = 1.221
//! sd_eta = 0.004
//! lambda_mm = 0.1765
//! sd_lambda_mm = 0.0006
//! correlation = 0.1    # of the errors of eta and lambda
//! samples = 36
//! [[effect]]           # each effect that was found; see robot::effects
//! name = "load_directed_backlash"
//! found = "discover, 320 samples"
//! form = "..."         # where it is not the first of its name
//! parameters.play_mm = { value = 0.11, sd = 0.0004, unit = "mm" }
//! covariance_of = ["eta", "lambda_mm", "load_directed_backlash.play_mm"]
//! covariance = [[1e-7, 2e-8, 1.6e-7]]
//! ```
//!
//! `covariance` has a row for each parameter of its effect and a column for each of `covariance_of`: η, λ, the parameters of the
//! effects before it and its own, which are the rows. The rows of all effects together are the lower half of one matrix.
//!
//! `robot` and `friction` may be left out: Table I and the fit of Table II stand in. An `[[effect]]` that this version
//! does not know is an error, since a prediction without it would be wrong.

use super::experiment::line_at;
use super::write::write_atomically;
use crate::error::{Error, Result};
use crate::input::read_text;
use crate::robot::effects::ParameterSpec;
use crate::robot::{BACKBONES, Effect, Estimate, Friction, Model, Robot};
use nalgebra::Matrix2;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::Path;
use toml::de::DeTable;

/// The file as it is written.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ModelFile {
    #[serde(default)]
    robot: Robot,
    #[serde(default)]
    friction: Friction,
    #[serde(skip_serializing_if = "Option::is_none")]
    estimate: Option<EstimateTable>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    effect: Vec<toml::Spanned<EffectTable>>,
}

/// An effect as files show it.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct EffectTable {
    name: String,
    /// Which of the forms of this name, where it is not the first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    form: Option<String>,
    /// Where it was found.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    found: String,
    /// The parameters that the columns of `covariance` belong to.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    covariance_of: Vec<String>,
    /// A row for each parameter of this effect.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    covariance: Vec<Vec<f64>>,
    #[serde(default)]
    parameters: BTreeMap<String, ParameterTable>,
}

/// A parameter of an effect.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ParameterTable {
    value: f64,
    #[serde(default)]
    sd: f64,
    unit: String,
}

/// Effect k of a model as its file shows it.
fn effect_table(model: &Model, k: usize) -> EffectTable {
    let effect = &model.effects[k];
    let parameter = |(spec, (&value, &sd)): (&ParameterSpec, (&f64, &f64))| {
        (spec.name.to_owned(), ParameterTable { value, sd, unit: spec.unit.to_owned() })
    };
    let values = effect.values.iter().zip(&effect.sds);
    EffectTable {
        name: effect.physics.name.to_owned(),
        form: Some(effect.physics.form).filter(|form| !form.is_empty()).map(str::to_owned),
        found: effect.found.clone(),
        covariance_of: if effect.covariance.is_empty() { Vec::new() } else { columns(&model.effects[..=k]) },
        covariance: effect.covariance.clone(),
        parameters: effect.parameters().iter().zip(values).map(parameter).collect(),
    }
}

/// What the columns of the last effect's covariance belong to.
fn columns(effects: &[Effect]) -> Vec<String> {
    let estimated = effects.iter().filter(|effect| effect.physics.fitted);
    let of_effects = estimated
        .flat_map(|effect| effect.parameters().iter().map(|spec| format!("{}.{}", effect.physics.name, spec.name)));
    ["eta", "lambda_mm"].map(str::to_owned).into_iter().chain(of_effects).collect()
}

/// An estimate as files show it: sds and correlation rather than covariances.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct EstimateTable {
    eta: f64,
    sd_eta: f64,
    lambda_mm: f64,
    sd_lambda_mm: f64,
    correlation: f64,
    samples: usize,
}

impl From<&Model> for ModelFile {
    fn from(model: &Model) -> Self {
        let effect = |k: usize| toml::Spanned::new(0..0, effect_table(model, k));
        Self {
            robot: model.robot.clone(),
            friction: model.friction,
            estimate: model.estimate.map(EstimateTable::from),
            effect: (0..model.effects.len()).map(effect).collect(),
        }
    }
}

impl From<Estimate> for EstimateTable {
    fn from(estimate: Estimate) -> Self {
        Self {
            eta: estimate.eta,
            sd_eta: estimate.sd_eta(),
            lambda_mm: estimate.lambda_mm,
            sd_lambda_mm: estimate.sd_lambda_mm(),
            correlation: estimate.correlation(),
            samples: estimate.samples,
        }
    }
}

impl From<EstimateTable> for Estimate {
    fn from(table: EstimateTable) -> Self {
        let cross = table.correlation * table.sd_eta * table.sd_lambda_mm;
        Self {
            eta: table.eta,
            lambda_mm: table.lambda_mm,
            covariance: Matrix2::new(table.sd_eta.powi(2), cross, cross, table.sd_lambda_mm.powi(2)),
            samples: table.samples,
        }
    }
}

/// Reads a model.toml.
///
/// # Errors
/// A file that cannot be read or is not TOML, an unknown or missing key, an effect that this version does not know, a
/// number out of its physical range; each with its line and key.
pub fn read_model(path: &Path) -> Result<Model> {
    let text = read_text(path)?;
    parse(path, &text)
}

/// Writes a model.toml, whole or not at all.
///
/// # Errors
/// A file that cannot be written, or a model whose numbers could not be read back.
pub fn write_model(path: &Path, model: &Model) -> Result<()> {
    write_atomically(path, model_toml(model)?.as_bytes())
}

/// A model as the text of a model.toml.
///
/// # Errors
/// A number that is not finite or out of its physical range, by its key.
pub fn model_toml(model: &Model) -> Result<String> {
    if let Some(fault) = first_fault(model) {
        return Err(Error::Domain(format!("cannot write the model: {fault}")));
    }
    toml::to_string(&ModelFile::from(model)).map_err(|e| Error::Domain(format!("cannot write the model: {e}")))
}

/// A model as JSON with model.toml's keys.
///
/// # Errors
/// As [`model_toml`].
pub fn model_json(model: &Model) -> Result<serde_json::Value> {
    if let Some(fault) = first_fault(model) {
        return Err(Error::Domain(format!("cannot write the model: {fault}")));
    }
    serde_json::to_value(ModelFile::from(model)).map_err(|e| Error::Domain(format!("cannot write the model: {e}")))
}

fn parse(path: &Path, text: &str) -> Result<Model> {
    let at_span = |e: toml::de::Error| match e.span() {
        Some(span) => Error::at_line(path, line_at(text, span.start), e.message()),
        None => Error::content(path, e.message()),
    };
    let document = DeTable::parse(text).map_err(at_span)?;
    let file: ModelFile = toml::from_str(text).map_err(at_span)?;
    let mut effects = Vec::new();
    for table in file.effect {
        let line = line_at(text, table.span().start);
        let at = |why: Error| Error::at_line(path, line, why.to_string());
        let (covariance_of, table) = (table.get_ref().covariance_of.clone(), table.into_inner());
        effects.push(effect(table, file.robot.backbone_count()).map_err(at)?);
        check_covariance(&effects, &covariance_of).map_err(at)?;
    }
    let estimate = file.estimate.map(Estimate::from);
    let model = Model { robot: file.robot, friction: file.friction, estimate, effects };
    match first_fault(&model) {
        None => Ok(model),
        Some(fault) => {
            let line = line_of_key(document.get_ref(), &fault.key).map(|byte| line_at(text, byte));
            Err(Error::Content { path: path.to_owned(), line, message: fault.to_string() })
        }
    }
}

/// One `[[effect]]` as a model.
fn effect(table: EffectTable, backbones: usize) -> Result<Effect> {
    let values: Vec<(String, f64)> = table.parameters.iter().map(|(name, p)| (name.clone(), p.value)).collect();
    let mut effect = Effect::new(&table.name, table.form.as_deref(), &values, backbones)?;
    for (spec, sd) in effect.parameters().iter().zip(&mut effect.sds) {
        let Some(parameter) = table.parameters.get(spec.name) else { continue };
        if parameter.unit != spec.unit || !(parameter.sd >= 0.0 && parameter.sd.is_finite()) {
            return Err(Error::Usage(format!(
                "effect {}: {} has sd = {} and unit = {:?}, expected an sd of 0 or more and {:?}",
                table.name, spec.name, parameter.sd, parameter.unit, spec.unit
            )));
        }
        *sd = parameter.sd;
    }
    effect.found = table.found;
    effect.covariance = table.covariance;
    Ok(effect)
}

/// Checks the covariance of the last effect: as many rows and columns as it must have, finite, its own part symmetric, with the
/// sds' squares on its diagonal and no correlation above 1.
fn check_covariance(effects: &[Effect], covariance_of: &[String]) -> Result<()> {
    let Some(effect) = effects.last() else { return Ok(()) };
    let (name, rows, expected) = (effect.physics.name, &effect.covariance, columns(effects));
    if rows.is_empty() && covariance_of.is_empty() {
        return Ok(());
    }
    let n = effect.values.len();
    let wrong = |what: String| Err(Error::Usage(format!("effect {name}: covariance: {what}")));
    if covariance_of != expected {
        return wrong(format!("covariance_of is {covariance_of:?}, expected {expected:?}"));
    }
    if rows.len() != n || rows.iter().any(|row| row.len() != expected.len()) {
        return wrong(format!("expected {n} rows of {} numbers", expected.len()));
    }
    let own = |a: usize, b: usize| rows[a][expected.len() - n + b];
    for (a, row) in rows.iter().enumerate() {
        if !(own(a, a) >= 0.0 && (own(a, a).sqrt() - effect.sds[a]).abs() <= 1e-6 * effect.sds[a]) {
            return wrong(format!("the variance in row {} is {}, expected the square of its sd", a + 1, own(a, a)));
        }
        for b in 0..n {
            let limit = (1.0 + 1e-6) * effect.sds[a] * effect.sds[b];
            // Written so that what is not finite fails.
            if !(own(a, b).abs() <= limit && (own(a, b) - own(b, a)).abs() <= 1e-6 * limit) {
                return wrong(format!(
                    "{} in row {}, expected a symmetric matrix without correlations above 1",
                    own(a, b),
                    a + 1
                ));
            }
        }
        if row.iter().any(|value| !value.is_finite()) {
            return wrong(format!("row {} has a number that is not finite", a + 1));
        }
    }
    Ok(())
}

/// A number outside what the physics allows.
struct Fault {
    /// The key's path, joined by dots.
    key: String,
    value: f64,
    range: RangeInclusive<f64>,
    /// What else is wrong with it, where the range alone does not say it.
    why: &'static str,
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} = {}, expected {} to {}{}", self.key, self.value, self.range.start(), self.range.end(), self.why)
    }
}

/// The first number of the model that is not finite or not within what such a robot can have.
fn first_fault(model: &Model) -> Option<Fault> {
    let Robot { length_mm, backbone_circle_radius_mm, backbones, primary, secondary, line, body } = &model.robot;
    let friction = &model.friction;
    let mut checks: Vec<(String, f64, RangeInclusive<f64>, &'static str)> = Vec::new();
    let mut check = |key: &str, value: f64, range: RangeInclusive<f64>, why| {
        checks.push((key.to_owned(), value, range, why));
    };
    check("robot.length_mm", *length_mm, 1.0..=1000.0, "");
    let (least, most) = BACKBONES.into_inner();
    check("robot.backbones", f64::from(*backbones), least as f64..=most as f64, " (evenly spaced on the circle)");
    // Tubes that touch cannot slide; a quarter of the length keeps every L_i positive up to the largest bend.
    let to_primary_mm = 0.5 * (primary.outer_diameter_mm + secondary.outer_diameter_mm);
    let to_each_other_mm = 0.5 * secondary.outer_diameter_mm / (0.5 * model.robot.beta()).sin();
    let touching_mm = to_primary_mm.max(to_each_other_mm);
    check(
        "robot.backbone_circle_radius_mm",
        *backbone_circle_radius_mm,
        touching_mm.max(0.05)..=(length_mm / 4.0),
        " (no tube within another, a quarter of the length at most)",
    );
    for (name, tube) in [("primary", primary), ("secondary", secondary)] {
        let key = |field: &str| format!("robot.{name}.{field}");
        check(&key("outer_diameter_mm"), tube.outer_diameter_mm, 0.01..=20.0, "");
        check(
            &key("inner_diameter_mm"),
            tube.inner_diameter_mm,
            0.0..=(0.999 * tube.outer_diameter_mm),
            " (less than the outer diameter)",
        );
        check(&key("youngs_modulus_gpa"), tube.youngs_modulus_gpa, 0.01..=1000.0, "");
    }
    check("robot.line.holder_length_mm", line.holder_length_mm, 0.0..=10_000.0, "");
    check("robot.line.cone_bend_radius_mm", line.cone_bend_radius_mm, 0.1..=1000.0, "");
    check("robot.line.cone_bend_angle_deg", line.cone_bend_angle_deg, 0.1..=720.0, "");
    check("robot.line.cone_straight_mm", line.cone_straight_mm, 0.0..=10_000.0, "");
    let tubes_mm = 2.0 * backbone_circle_radius_mm + secondary.outer_diameter_mm;
    check("robot.body.disk_diameter_mm", body.disk_diameter_mm, tubes_mm..=200.0, " (all tubes within the disk)");
    check("robot.body.disk_thickness_mm", body.disk_thickness_mm, 0.001..=*length_mm, "");
    check("robot.body.spacer_disk_count", f64::from(body.spacer_disk_count), 0.0..=255.0, "");
    check("friction.mu", friction.mu, 0.0..=2.0, "");
    check("friction.static_force_n", friction.static_force_n, 0.0..=1000.0, "");
    check("friction.sd_mu", friction.sd_mu, 0.0..=2.0, "");
    check("friction.sd_static_force_n", friction.sd_static_force_n, 0.0..=1000.0, "");
    check("friction.correlation", friction.correlation, -1.0..=1.0, "");
    if let Some(estimate) = &model.estimate {
        check("estimate.eta", estimate.eta, 0.01..=100.0, "");
        check("estimate.sd_eta", estimate.sd_eta(), 0.0..=100.0, "");
        check("estimate.lambda_mm", estimate.lambda_mm, -10.0..=10.0, "");
        check("estimate.sd_lambda_mm", estimate.sd_lambda_mm(), 0.0..=10.0, "");
        // A rounding above 1 is no fault of the file's.
        check("estimate.correlation", estimate.correlation(), -1.000001..=1.000001, "");
    }
    let (key, value, range, why) = checks.into_iter().find(|(_, value, range, _)| !range.contains(value))?;
    Some(Fault { key, value, range, why })
}

/// Where in the text the key of a dotted path stands; `None` where a default stands in for it.
fn line_of_key(table: &DeTable, path: &str) -> Option<usize> {
    let (first, rest) = path.split_once('.').map_or((path, None), |(first, rest)| (first, Some(rest)));
    let (key, value) = table.get_key_value(first)?;
    match rest {
        None => Some(key.span().start),
        Some(rest) => line_of_key(value.get_ref().as_table()?, rest),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn estimated() -> Model {
        let covariance = Matrix2::new(1.6e-5, 2e-7, 2e-7, 3.6e-7);
        let estimate = Estimate { eta: 1.221, lambda_mm: 0.1765, covariance, samples: 36 };
        Model { estimate: Some(estimate), ..Model::default() }
    }

    fn read_text(text: &str) -> Result<Model> {
        parse(Path::new("lab/model.toml"), text)
    }

    fn message(text: &str) -> String {
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
        assert!(
            fat.contains("robot.backbone_circle_radius_mm = 0.6") && fat.contains("no tube within another"),
            "{fat}"
        );
        let small = message(&text.replace("disk_diameter_mm = 4.2", "disk_diameter_mm = 3.5"));
        assert!(small.contains("robot.body.disk_diameter_mm = 3.5") && small.contains("all tubes"), "{small}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn what_was_written_is_read(eta in 0.1..5.0f64, lambda_mm in -1.0..1.0f64, sd in 1e-9..1.0f64, rho in -1.0..1.0f64, length_mm in 10.0..99.0f64) {
            let mut model = estimated();
            model.robot.length_mm = length_mm;
            let covariance = Matrix2::new(sd * sd, rho * sd * 1e-3, rho * sd * 1e-3, 1e-6);
            model.estimate = Some(Estimate { eta, lambda_mm, covariance, samples: 7 });
            let back = read_text(&model_toml(&model).unwrap()).unwrap();
            prop_assert_eq!(&back.robot, &model.robot);
            prop_assert_eq!(back.friction, model.friction);
            let read = back.estimate.unwrap();
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
        assert_eq!(read_model(&path).unwrap().estimate.unwrap().samples, 36);
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
    fn effects_come_back_as_they_were_written() {
        let mut model = estimated();
        let mut creep = Effect::parse("creep:share=0.1,time_constant_s=4").unwrap();
        (creep.sds, creep.found) = (vec![0.01, 0.3], "a test".to_owned());
        model.effects = vec![creep, Effect::parse("load_directed_backlash:play_mm=-0.08").unwrap()];
        let text = model_toml(&model).unwrap();
        assert_eq!(parse(Path::new("model.toml"), &text).unwrap().effects, model.effects, "{text}");
        let wrong = text.replace("unit = \"s\"", "unit = \"min\"");
        let error = parse(Path::new("model.toml"), &wrong).unwrap_err().to_string();
        assert!(error.contains("time_constant_s") && error.contains("expected an sd"), "{error}");
    }

    #[test]
    fn forms_and_covariances_come_back_and_are_checked() {
        let mut model = estimated();
        let values = [("drag_n_s_per_mm".to_owned(), 0.4)];
        let mut drag = Effect::new("viscous_drag", Some("speed since the sample before"), &values, 3).unwrap();
        (drag.sds, drag.covariance) = (vec![0.1], vec![vec![1e-4, -2e-5, 0.01]]);
        let mut creep = Effect::parse("creep:share=0.1,time_constant_s=4").unwrap();
        creep.sds = vec![0.01, 0.3];
        creep.covariance = vec![vec![0.0, 1e-6, 2e-4, 1e-4, 1e-3], vec![0.25, 0.0, 3e-3, 1e-3, 0.09]];
        model.effects = vec![drag, creep];
        let text = model_toml(&model).unwrap();
        assert_eq!(read_text(&text).unwrap().effects, model.effects, "{text}");
        for (from, to, what) in [
            ("form = \"speed since the sample before\"", "form = \"sideways\"", "form \"sideways\""),
            ("\"creep.share\", ", "", "covariance_of is"),
            ("0.09]", "0.08]", "expected the square of its sd"),
            ("0.0001, 0.001]", "0.0001, 0.002]", "expected a symmetric matrix"),
            ("[0.25, ", "[inf, ", "not finite"),
        ] {
            assert!(text.contains(from), "{from}: {text}");
            let message = message(&text.replacen(from, to, 1));
            assert!(message.contains(what), "{message}");
        }
    }

    #[test]
    fn a_model_that_could_not_be_read_back_is_not_written() {
        let mut model = estimated();
        model.estimate.as_mut().unwrap().eta = f64::NAN;
        assert!(model_toml(&model).unwrap_err().to_string().contains("estimate.eta"));
    }
}
