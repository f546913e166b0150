//! Checks the stated scale against the snake's size and the lines' distance.

use super::base_fit::StraightPicture;
use super::error::RigError;
use super::parameters::{Rig, RigOptions};
use crate::measure::target::{Grid, GridPattern, GridPhaseMonitor};
use crate::robot::Robot;
use nalgebra::{Point3, Vector3};

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
pub fn pattern_of(picture: StraightPicture, grid: &Grid) -> GridPattern {
    let StraightPicture { frame, lens, options, .. } = picture;
    let pattern = GridPattern::dark(grid.kind);
    match GridPhaseMonitor::new(lens, &grid.sheet, options.standoff_mm, options.grid_pitch_mm, &pattern) {
        Some(monitor) => GridPattern { weights: monitor.weights_in(frame), ..pattern },
        None => pattern,
    }
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
