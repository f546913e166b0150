//! What the numbers of a robot can be: physical ranges, checked where numbers come in.

use super::model::{ETA, LAMBDA};
use super::{BACKBONES, Body, Estimate, Friction, Model, Robot};
use std::fmt;
use std::ops::RangeInclusive;

/// A number outside what the physics allows.
#[derive(Debug, Clone, PartialEq)]
pub struct OutOfRange {
    /// Its key in model.toml, joined by dots.
    pub key: String,
    /// The number.
    pub value: f64,
    /// What it can be.
    pub range: RangeInclusive<f64>,
    /// What else there is to say, where the range alone does not say it.
    pub why: &'static str,
}

impl fmt::Display for OutOfRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} = {}, expected {} to {}{}", self.key, self.value, self.range.start(), self.range.end(), self.why)
    }
}

impl std::error::Error for OutOfRange {}

/// The first number that is out of its range, or not a number.
#[derive(Default)]
struct Check(Option<OutOfRange>);

impl Check {
    fn that(&mut self, key: &str, value: f64, range: RangeInclusive<f64>, why: &'static str) {
        if self.0.is_none() && !range.contains(&value) {
            self.0 = Some(OutOfRange { key: key.to_owned(), value, range, why });
        }
    }
}

impl Robot {
    /// The robot, where such a one can be built.
    ///
    /// # Errors
    /// The first number that is not finite or out of its physical range.
    ///
    /// ```
    /// use snakeloop::robot::Robot;
    /// let error = Robot { backbones: 2, ..Robot::default() }.checked().unwrap_err();
    /// assert_eq!((error.key.as_str(), error.value), ("robot.backbones", 2.0));
    /// ```
    pub fn checked(self) -> Result<Self, OutOfRange> {
        let mut check = Check::default();
        self.check(&mut check);
        check.0.map_or(Ok(self), Err)
    }

    fn check(&self, check: &mut Check) {
        let Self { length_mm, backbone_circle_radius_mm, backbones, primary, secondary, line, body } = self;
        check.that("robot.length_mm", *length_mm, 1.0..=1000.0, "");
        let (least, most) = BACKBONES.into_inner();
        let range = least as f64..=most as f64;
        check.that("robot.backbones", f64::from(*backbones), range, " (evenly spaced on the circle)");
        // Tubes that touch cannot slide; a quarter of the length keeps every L_i positive up to the largest bend.
        let to_primary_mm = 0.5 * (primary.outer_diameter_mm + secondary.outer_diameter_mm);
        let to_each_other_mm = 0.5 * secondary.outer_diameter_mm / (0.5 * self.beta()).sin();
        let touching_mm = to_primary_mm.max(to_each_other_mm);
        check.that(
            "robot.backbone_circle_radius_mm",
            *backbone_circle_radius_mm,
            touching_mm.max(0.05)..=(length_mm / 4.0),
            " (no tube within another, a quarter of the length at most)",
        );
        for (name, tube) in [("primary", primary), ("secondary", secondary)] {
            let key = |field: &str| format!("robot.{name}.{field}");
            let inner = 0.0..=(0.999 * tube.outer_diameter_mm);
            check.that(&key("outer_diameter_mm"), tube.outer_diameter_mm, 0.01..=20.0, "");
            check.that(&key("inner_diameter_mm"), tube.inner_diameter_mm, inner, " (less than the outer diameter)");
            check.that(&key("youngs_modulus_gpa"), tube.youngs_modulus_gpa, 0.01..=1000.0, "");
        }
        check.that("robot.line.holder_length_mm", line.holder_length_mm, 0.0..=10_000.0, "");
        check.that("robot.line.cone_bend_radius_mm", line.cone_bend_radius_mm, 0.1..=1000.0, "");
        check.that("robot.line.cone_bend_angle_deg", line.cone_bend_angle_deg, 0.1..=720.0, "");
        check.that("robot.line.cone_straight_mm", line.cone_straight_mm, 0.0..=10_000.0, "");
        let tubes_mm = 2.0 * backbone_circle_radius_mm + secondary.outer_diameter_mm;
        let disk = tubes_mm..=200.0;
        check.that("robot.body.disk_diameter_mm", body.disk_diameter_mm, disk, " (all tubes within the disk)");
        check.that("robot.body.disk_thickness_mm", body.disk_thickness_mm, 0.001..=*length_mm, "");
        body.check_disk_positions(*length_mm, check);
        if let Some(tool) = &body.tool {
            check.that("robot.body.tool.length_mm", tool.length_mm, 0.01..=500.0, "");
            check.that("robot.body.tool.diameter_mm", tool.diameter_mm, 0.01..=200.0, "");
        }
    }
}

impl Body {
    /// Disks that are not evenly spaced are as many as were said, one after the other, and none within another or the end disk.
    fn check_disk_positions(&self, length_mm: f64, check: &mut Check) {
        let Some(positions_mm) = &self.disk_positions_mm else { return };
        let count = positions_mm.len() as f64;
        let why = " (as many as disk_positions_mm has)";
        check.that("robot.body.spacer_disk_count", f64::from(self.spacer_disk_count), count..=count, why);
        let thickness_mm = self.disk_thickness_mm;
        let furthest_mm = length_mm - 1.5 * thickness_mm;
        let mut nearest_mm = 0.5 * thickness_mm;
        for (k, &middle_mm) in positions_mm.iter().enumerate() {
            let why = " (from base to tip, no disk within another, all before the end disk)";
            check.that(&format!("robot.body.disk_positions_mm[{k}]"), middle_mm, nearest_mm..=furthest_mm, why);
            nearest_mm = middle_mm + thickness_mm;
        }
    }
}

impl Friction {
    /// The friction, where a cone can have it.
    ///
    /// # Errors
    /// The first number that is not finite or out of its physical range.
    pub fn checked(self) -> Result<Self, OutOfRange> {
        let mut check = Check::default();
        self.check(&mut check);
        check.0.map_or(Ok(self), Err)
    }

    fn check(&self, check: &mut Check) {
        check.that("friction.mu", self.mu, 0.0..=2.0, "");
        check.that("friction.static_force_n", self.static_force_n, 0.0..=1000.0, "");
        check.that("friction.sd_mu", self.sd_mu, 0.0..=2.0, "");
        check.that("friction.sd_static_force_n", self.sd_static_force_n, 0.0..=1000.0, "");
        check.that("friction.correlation", self.correlation, -1.0..=1.0, "");
    }
}

impl Estimate {
    /// Why no robot can have these numbers, if none can: a line that yields against its load or hundreds of times too far, a play of
    /// millimetres. `None` says that they are possible, not that they are right.
    pub fn implausible(&self) -> Option<String> {
        let Self { eta, lambda_mm, .. } = *self;
        let text = if !(ETA.range.0..=ETA.range.1).contains(&eta) {
            format!("η = {eta:.3}, and every robot's lies between {} and {}", ETA.range.0, ETA.range.1)
        } else if !(LAMBDA.range.0..=LAMBDA.range.1).contains(&lambda_mm) {
            format!("λ = {lambda_mm:.3} mm, and every robot's lies within {} mm of 0", LAMBDA.range.1)
        } else {
            return None;
        };
        Some(text.replace('-', "−"))
    }

    fn check(&self, check: &mut Check) {
        // As wide as a log in a wrong unit can make them: whether they are plausible is the verdict's business.
        check.that("estimate.eta", self.eta, -1e6..=1e6, "");
        check.that("estimate.sd_eta", self.sd_eta(), 0.0..=1e6, "");
        check.that("estimate.lambda_mm", self.lambda_mm, -1e3..=1e3, "");
        check.that("estimate.sd_lambda_mm", self.sd_lambda_mm(), 0.0..=1e3, "");
        // A rounding above 1 is no fault of the file's.
        check.that("estimate.correlation", self.correlation(), -1.000001..=1.000001, "");
    }
}

impl Model {
    /// The first number that is not finite or not within what such a robot can have. Effects are checked when they are made.
    pub fn out_of_range(&self) -> Option<OutOfRange> {
        let mut check = Check::default();
        self.robot.check(&mut check);
        self.friction.check(&mut check);
        if let Some(estimate) = self.estimate() {
            estimate.check(&mut check);
        }
        check.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Tool;

    #[test]
    fn what_cannot_be_built_is_an_error_with_its_number() {
        assert_eq!(Robot::default().checked(), Ok(Robot::default()));
        for (robot, key, value) in [
            (Robot { backbones: 2, ..Robot::default() }, "robot.backbones", 2.0),
            (Robot { backbones: 9, ..Robot::default() }, "robot.backbones", 9.0),
            (Robot { length_mm: -1.0, ..Robot::default() }, "robot.length_mm", -1.0),
            (Robot { backbone_circle_radius_mm: 0.6, ..Robot::default() }, "robot.backbone_circle_radius_mm", 0.6),
        ] {
            let error = robot.checked().unwrap_err();
            assert_eq!((error.key.as_str(), error.value), (key, value), "{error}");
        }
        let with = |disk_positions_mm: &[f64], tool: Option<Tool>| {
            let mut robot = Robot::default();
            robot.body.spacer_disk_count = 3;
            (robot.body.disk_positions_mm, robot.body.tool) = (Some(disk_positions_mm.to_vec()), tool);
            robot
        };
        let tool = |length_mm: f64, diameter_mm: f64| Some(Tool { length_mm, diameter_mm });
        assert!(with(&[3.0, 4.0, 20.0], tool(5.0, 2.0)).checked().is_ok());
        for (robot, key, value) in [
            (with(&[3.0, 20.0], None), "robot.body.spacer_disk_count", 3.0),
            (with(&[-1.0, 4.0, 20.0], None), "robot.body.disk_positions_mm[0]", -1.0),
            (with(&[3.0, 3.5, 20.0], None), "robot.body.disk_positions_mm[1]", 3.5),
            (with(&[3.0, 4.0, 25.5], None), "robot.body.disk_positions_mm[2]", 25.5),
            (with(&[3.0, 20.0, 10.0], None), "robot.body.disk_positions_mm[2]", 10.0),
            (with(&[3.0, 4.0, 20.0], tool(-5.0, 2.0)), "robot.body.tool.length_mm", -5.0),
            (with(&[3.0, 4.0, 20.0], tool(5.0, 0.0)), "robot.body.tool.diameter_mm", 0.0),
        ] {
            let error = robot.checked().unwrap_err();
            assert_eq!((error.key.as_str(), error.value), (key, value), "{error}");
        }
        let error = Friction { mu: f64::NAN, ..Friction::default() }.checked().unwrap_err();
        assert!(error.key == "friction.mu" && error.to_string().contains("expected 0 to 2"), "{error}");
    }

    #[test]
    fn a_robot_that_nobody_checked_predicts_without_a_panic() {
        for backbones in [0, 1, 2, 9, 255] {
            let model = Model { robot: Robot { backbones, ..Robot::default() }, ..Model::default() };
            let psi = crate::geometry::Configuration::from_degrees(40.0, 10.0);
            assert!(model.forward(&model.command(psi)).is_ok());
        }
    }
}
