//! The compensation table: what to command for every pose of a grid.

use super::PerBackbone;
use super::kinematics::MAX_THETA;
use super::mechanics::Mechanics;
use super::model::Model;
use super::redundancy::{ForceLimits, Sharing};
use crate::error::{ArgumentError, Error, GridError, NoSolution, Result};
use crate::geometry::Configuration;
use std::fmt;
use std::str::FromStr;

/// The most poses of a table. More are a mistyped grid.
///
/// Convention: a resource limit.
const MOST_POSES: usize = 10_000_000;

/// Azimuths that are asked for lie within this, degrees either way.
///
/// Convention: once round; a larger number is in another unit, or of something else.
pub(crate) const MOST_DELTA_DEG: f64 = 360.0;

/// Evenly spaced angles, degrees, written `start:stop:step`. The stop belongs to them where a step falls on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridAxis {
    start_deg: f64,
    stop_deg: f64,
    step_deg: f64,
}

impl GridAxis {
    /// # Errors
    /// [`ArgumentError::Grid`] where a number is not finite, the step is not above 0 or the stop lies below the start.
    pub fn new(start_deg: f64, stop_deg: f64, step_deg: f64) -> Result<Self> {
        let axis = Self { start_deg, stop_deg, step_deg };
        if ![start_deg, stop_deg, step_deg].iter().all(|value| value.is_finite()) || step_deg <= 0.0 {
            return Err(ArgumentError::from(GridError::NotFinite(axis.to_string())).into());
        }
        if stop_deg < start_deg {
            return Err(ArgumentError::from(GridError::Descending(axis.to_string())).into());
        }
        Ok(axis)
    }

    /// The angles, degrees.
    pub fn values_deg(&self) -> impl Iterator<Item = f64> + Clone {
        let Self { start_deg, stop_deg, step_deg } = *self;
        (0..self.len()).map(move |k| (start_deg + k as f64 * step_deg).min(stop_deg))
    }

    /// How many angles there are; saturates for steps too small to count.
    fn len(&self) -> usize {
        // A step that misses the stop only by rounding falls on it.
        let steps = (self.stop_deg - self.start_deg) / self.step_deg * (1.0 + 1e-12) + 1e-9;
        (steps.floor() as usize).saturating_add(1)
    }
}

impl FromStr for GridAxis {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let numbers: std::result::Result<Vec<f64>, _> = text.split(':').map(|part| part.trim().parse()).collect();
        match numbers.as_deref() {
            Ok(&[start, stop, step]) => Self::new(start, stop, step),
            Ok(&[value]) => Self::new(value, value, 1.0),
            _ => Err(ArgumentError::Syntax {
                what: "grid",
                text: text.to_owned(),
                expected: "start:stop:step in degrees, such as 0:90:5, or one angle",
            }
            .into()),
        }
    }
}

impl fmt::Display for GridAxis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}:{}", self.start_deg, self.stop_deg, self.step_deg)
    }
}

/// A grid of poses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// The values of θ.
    pub theta: GridAxis,
    /// The values of δ; one that is once round from the first, and what comes after it, are the same directions again.
    pub delta: GridAxis,
}

impl Grid {
    /// The azimuths of the grid, degrees, each direction once: of −180:180:10 the last, 180°, is left out.
    pub fn azimuths_deg(&self) -> impl Iterator<Item = f64> + Clone {
        let start_deg = self.delta.start_deg;
        let comes_again = move |delta_deg: f64| {
            let turns = (delta_deg - start_deg) / 360.0;
            turns > 0.5 && (turns - turns.round()).abs() < 1e-9
        };
        self.delta.values_deg().take_while(move |&delta_deg| !comes_again(delta_deg))
    }
}

impl Grid {
    /// The default grid, which ends where the bends that a model was learned on end: at the last 5° up to them, and not below 15°, since a
    /// table in C interpolates between four angles.
    pub fn within_data(model: &Model) -> Self {
        let grid = Self::default();
        let Some(range) = &model.learned else { return grid };
        let least_deg = grid.theta.start_deg + 3.0 * grid.theta.step_deg;
        let covered = |theta_deg: &f64| *theta_deg <= least_deg || range.reaches(theta_deg.to_radians());
        let stop_deg = grid.theta.values_deg().take_while(covered).last().unwrap_or(grid.theta.stop_deg);
        Self { theta: GridAxis { stop_deg, ..grid.theta }, ..grid }
    }
}

impl Default for Grid {
    /// θ 0 to 90° by 5°, δ once round by 15°.
    fn default() -> Self {
        Self {
            theta: GridAxis { start_deg: 0.0, stop_deg: 90.0, step_deg: 5.0 },
            delta: GridAxis { start_deg: -165.0, stop_deg: 180.0, step_deg: 15.0 },
        }
    }
}

/// One pose of a compensation table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TableRow {
    /// The desired pose.
    pub configuration: Configuration,
    /// q, what the snake's backbones are to move, mm.
    pub q_mm: PerBackbone,
    /// q̃, what to command, mm.
    pub command_mm: PerBackbone,
    /// Standard deviation of q̃ from the covariance of all of the model's parameters, mm.
    pub sd_command_mm: PerBackbone,
    /// Whether the pose is beyond what an effect of the model was learned from, which then goes on straight from the end of its domain;
    /// none where no effect has a domain.
    pub beyond_data: Option<bool>,
    /// Whether the pose is beyond the bends that η and λ were learned on; false where nobody says which those are.
    pub extrapolated: bool,
    /// How the backbones share the load, where the actuation unit's limits were given; q̃ then has it in.
    pub sharing: Option<Sharing>,
}

impl TableRow {
    /// The row of one pose.
    pub fn new(model: &Model, configuration: Configuration) -> Self {
        Self {
            configuration,
            q_mm: model.robot.joint_displacements(configuration),
            command_mm: model.command(configuration),
            sd_command_mm: model.command_sds(configuration),
            beyond_data: Mechanics::new(model).is_beyond_data(configuration.bend_vector()),
            extrapolated: model.learned.is_some_and(|range| !range.covers(configuration)),
            sharing: None,
        }
    }

    /// The row of a pose that is asked for in degrees.
    ///
    /// # Errors
    /// [`NoSolution::OutsideWorkspace`] for a θ outside 0 to 120° and a δ outside ±360°, as in a table.
    pub fn asked(model: &Model, theta_deg: f64, delta_deg: f64) -> Result<Self> {
        let most_deg = MAX_THETA.to_degrees();
        if !((0.0..=most_deg + 1e-9).contains(&theta_deg) && (-MOST_DELTA_DEG..=MOST_DELTA_DEG).contains(&delta_deg)) {
            return Err(NoSolution::OutsideWorkspace { theta_deg, delta_deg, most_deg }.into());
        }
        Ok(Self::new(model, Configuration::from_degrees(theta_deg, delta_deg)))
    }

    /// By how much the bend that the model predicts for the command differs from the pose, rad; infinite where it predicts none within its range. A
    /// pose that is missed is one of several bends that agree with one command.
    pub fn missed_by(&self, model: &Model) -> f64 {
        let bend = |psi: Configuration| psi.bend_vector();
        model
            .forward(&self.command_mm)
            .map_or(f64::INFINITY, |response| (bend(response.configuration) - bend(self.configuration)).norm())
    }

    /// The same pose with forces within limits.
    pub fn within(mut self, model: &Model, limits: &ForceLimits) -> Self {
        let sharing = model.sharing(self.configuration, limits);
        self.command_mm += sharing.shift_mm;
        Self { sharing: Some(sharing), ..self }
    }
}

/// The compensation table over a grid, δ running fastest; each direction once.
///
/// # Errors
/// [`ArgumentError::Grid`] for a grid with a θ outside 0 to 120°, a δ outside ±360°, or more poses than anyone needs.
pub fn compensation_table(model: &Model, grid: &Grid) -> Result<Vec<TableRow>> {
    let Grid { theta, delta } = grid;
    let most_deg = MAX_THETA.to_degrees();
    if theta.start_deg < 0.0 || theta.stop_deg > most_deg + 1e-9 {
        return Err(ArgumentError::from(GridError::Theta { grid: theta.to_string(), most_deg }).into());
    }
    if delta.start_deg < -MOST_DELTA_DEG || delta.stop_deg > MOST_DELTA_DEG {
        return Err(ArgumentError::from(GridError::Delta(delta.to_string())).into());
    }
    let poses = theta.len().saturating_mul(delta.len());
    if poses > MOST_POSES {
        let (theta, delta) = (theta.to_string(), delta.to_string());
        return Err(ArgumentError::from(GridError::TooManyPoses { theta, delta, poses, most: MOST_POSES }).into());
    }
    let row = |(theta_deg, delta_deg)| TableRow::new(model, Configuration::from_degrees(theta_deg, delta_deg));
    Ok(theta.values_deg().flat_map(|theta| grid.azimuths_deg().map(move |delta| (theta, delta))).map(row).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Estimate;
    use nalgebra::Matrix2;
    use proptest::prelude::*;

    fn grid(theta: &str, delta: &str) -> Grid {
        Grid { theta: theta.parse().unwrap(), delta: delta.parse().unwrap() }
    }

    #[test]
    fn a_grid_holds_its_ends_whatever_the_rounding() {
        let values = |text: &str| text.parse::<GridAxis>().unwrap().values_deg().collect::<Vec<_>>();
        assert_eq!(values("0:90:30"), [0.0, 30.0, 60.0, 90.0]);
        assert_eq!(values("0:1:0.1").len(), 11);
        assert!((values("0:120:0.7").last().unwrap() - 119.7).abs() < 1e-9);
        assert_eq!(values("-180:180:360"), [-180.0, 180.0]);
        assert_eq!(values("45"), [45.0]);
        assert!(values("0:90:0.01").len() == 9001 && *values("0:90:0.01").last().unwrap() == 90.0);
    }

    #[test]
    fn a_direction_that_is_named_twice_has_one_row() {
        for (delta, directions) in [("-180:180:10", 36), ("0:360:15", 24), ("-360:360:90", 4), ("-170:180:10", 36)] {
            let rows = compensation_table(&Model::default(), &grid("0:90:2", delta)).unwrap();
            assert_eq!(rows.len(), 46 * directions, "{delta}");
            let key = |row: &TableRow| {
                [row.configuration.theta_deg(), row.configuration.delta_deg()].map(|a| a.round() as i64)
            };
            let distinct: std::collections::HashSet<_> = rows.iter().map(key).collect();
            assert_eq!(distinct.len(), rows.len(), "{delta}");
        }
        // Twice round by a step that does not fall on the start again.
        assert_eq!(grid("0", "-360:360:100").azimuths_deg().count(), 8);
        assert_eq!(grid("0", "0:360:7.2").azimuths_deg().count(), 50);
    }

    #[test]
    fn a_grid_that_makes_no_sense_is_a_usage_error() {
        for bad in ["", "a:b:c", "0:90", "0:90:0", "0:90:-5", "90:0:5", "0:nan:1", "0:inf:1", "0:1:2:3"] {
            assert!(matches!(bad.parse::<GridAxis>(), Err(Error::Argument(_))), "{bad}");
        }
        for (theta, delta) in [("0:121:1", "0"), ("-5:90:5", "0"), ("0:90:5", "0:3600:15"), ("0:90:1e-300", "0")] {
            let error = compensation_table(&Model::default(), &grid(theta, delta)).unwrap_err();
            assert!(matches!(error, Error::Argument(ArgumentError::Grid(_))), "{error}");
        }
    }

    #[test]
    fn rows_are_the_models_commands_and_the_forward_problem_undoes_them() {
        let covariance = Matrix2::new(1e-4, 0.0, 0.0, 4e-6);
        let estimate = Estimate { eta: 1.221, lambda_mm: 0.1765, covariance, samples: 10 };
        let model = Model::default().with_estimate(estimate);
        let rows = compensation_table(&model, &Grid::default()).unwrap();
        assert_eq!(rows.len(), 19 * 24);
        for row in &rows {
            let back = model.forward(&row.command_mm).unwrap();
            assert!((back.configuration.bend_vector() - row.configuration.bend_vector()).norm() < 1e-11);
            assert!(back.common_mm.abs() < 1e-11);
            // λ alone makes 2 µm; the share of η grows with the bend.
            assert!(row.sd_command_mm.iter().all(|sd| *sd >= 0.002 - 1e-12));
        }
        let straight = &rows[0];
        assert!(straight.sd_command_mm.iter().all(|sd| (sd - 0.002).abs() < 1e-12));
    }

    proptest! {
        #[test]
        fn no_text_panics(text in "[-0-9.:e ]{0,20}") {
            if let Ok(axis) = text.parse::<GridAxis>() {
                let _ = compensation_table(&Model::default(), &Grid { theta: axis, delta: "0:0:1".parse().unwrap() });
            }
        }
    }
}
