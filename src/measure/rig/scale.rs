//! Checks the stated scale against the snake's size and the lines' distance.

use super::base_fit::StraightPicture;
use super::error::RigError;
use super::parameters::{Rig, RigOptions};
use crate::measure::target::{Grid, GridPattern, GridPhaseMonitor, PatternKind};
use crate::robot::Robot;
use nalgebra::{Point3, Vector3};

/// Strength of a wave twice as long as stated, and of one half as long, from which on it is the lines', in units of the stated one's.
///
/// Fitted: by hand on the project's renders (tests/eye/robustness): narrow lines' overtones are about as strong as their wave, and heavier lines among
/// them add little to longer ones; not judged elsewhere.
const LONGER: f64 = 0.8;
const SHORTER: f64 = 1.8;

/// What to say if the snake is not a standoff before the target but elsewhere: the snake's size puts it at a depth, and the
/// grid, if it is as large as was stated, puts the target at another one than a standoff behind it. The rig may have been calibrated with
/// another pitch than the stated one.
pub fn contradiction(robot: &Robot, options: &RigOptions, rig: &Rig) -> RigError {
    let base = rig.camera_from_base * Point3::origin();
    let depth_mm = (rig.camera_from_grid * Vector3::z()).dot(&base.coords);
    let target_mm = (depth_mm + rig.standoff_mm()) * options.grid_pitch_mm / rig.grid_pitch_mm;
    let scale = target_mm / (depth_mm + options.standoff_mm);
    let (diameter_mm, length_mm) = (robot.body.disk_diameter_mm, robot.length_mm);
    RigError::ScaleContradiction {
        grid_pitch_mm: options.grid_pitch_mm,
        standoff_mm: options.standoff_mm,
        apparent_diameter_mm: scale * diameter_mm,
        apparent_length_mm: scale * length_mm,
        diameter_mm,
        length_mm,
        agreeing_pitch_mm: options.grid_pitch_mm / scale,
        agreeing_standoff_mm: (target_mm - depth_mm).max(0.0),
    }
}

/// What is printed on the target, and the colours in which it shows.
///
/// # Errors
///
/// If the lines are not as far apart as was stated: every other one is missing, or there are as many between them.
/// The scale is right all the same, since the snake's size says which overtone of the pattern was found; but not what was stated.
pub fn pattern_of(picture: StraightPicture, grid: &Grid) -> Result<GridPattern, RigError> {
    let StraightPicture { frame, lens, robot, options } = picture;
    let pattern = GridPattern::dark(grid.kind);
    let monitor = |pitch_mm: f64, pattern: &GridPattern| {
        GridPhaseMonitor::new(lens, &grid.camera_from_grid, options.standoff_mm, pitch_mm, pattern)
    };
    let stated_mm = options.grid_pitch_mm;
    let Some(as_stated) = monitor(stated_mm, &pattern) else { return Ok(pattern) };
    let pattern = GridPattern { weights: as_stated.weights_in(frame), ..pattern };
    let strength = |pitch_mm: f64| monitor(pitch_mm, &pattern).map_or(0.0, |monitor| monitor.strength(frame));
    let stated = strength(stated_mm);
    for (found_mm, ratio) in [(2.0 * stated_mm, LONGER), (stated_mm / 2.0, SHORTER)] {
        if grid.kind == PatternKind::Lines && strength(found_mm) > ratio * stated {
            return Err(RigError::PitchContradiction { stated_mm, found_mm, diameter_mm: robot.body.disk_diameter_mm });
        }
    }
    Ok(pattern)
}

#[cfg(test)]
mod tests {
    use super::super::parameters::tests::rig;
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn either_figure_that_the_message_names_would_agree_with_the_snakes_size() {
        let robot = Robot::default();
        let options = RigOptions { grid_pitch_mm: 1.0, standoff_mm: 40.0, delta_offset: 0.0 };
        let RigError::ScaleContradiction { agreeing_pitch_mm, agreeing_standoff_mm, apparent_diameter_mm, .. } =
            contradiction(&robot, &options, &rig())
        else {
            panic!("expected a contradiction of scale")
        };
        // The base is seen at a depth by its size, 25 mm before a target of 1 mm pitch.
        assert_relative_eq!(agreeing_standoff_mm, 25.0, epsilon = 1e-9);
        // With lines so much further apart the target is that much further away, and 40 mm behind the base.
        let depth_mm = (rig().camera_from_grid * Vector3::z()).dot(&rig().camera_from_base.translation.vector);
        assert_relative_eq!((depth_mm + 25.0) * agreeing_pitch_mm, depth_mm + 40.0, epsilon = 1e-9);
        assert_relative_eq!(apparent_diameter_mm * agreeing_pitch_mm, robot.body.disk_diameter_mm, epsilon = 1e-9);
    }

    #[test]
    fn a_rig_of_another_pitch_is_never_given_back_the_figures_that_were_stated() {
        let robot = Robot::default();
        let found = Rig { grid_pitch_mm: 0.5, ..rig() };
        let options = RigOptions { grid_pitch_mm: 1.0, standoff_mm: found.standoff_mm(), delta_offset: 0.0 };
        let RigError::ScaleContradiction { agreeing_pitch_mm, agreeing_standoff_mm, apparent_diameter_mm, .. } =
            contradiction(&robot, &options, &found)
        else {
            panic!("expected a contradiction of scale")
        };
        // Lines twice as far apart as they are would put all of it at twice the distance, and make it twice as large.
        assert_relative_eq!(agreeing_pitch_mm, 0.5, epsilon = 1e-9);
        assert_relative_eq!(apparent_diameter_mm, 2.0 * robot.body.disk_diameter_mm, epsilon = 1e-9);
        assert!(agreeing_standoff_mm > 2.0 * options.standoff_mm, "{agreeing_standoff_mm}");
    }
}
