//! A scale that contradicts the snake's size.

use crate::measure::rig::calibrate::{Rig, RigOptions};
use crate::measure::rig::refusal::{Refusal, Step};
use crate::robot::Robot;
use nalgebra::{Point3, Vector3};

/// What to say if the snake is not a standoff before the paper but elsewhere: the snake's size puts it at a depth, and the
/// grid, if it is as large as was said, puts the paper at another one than a standoff behind it.
pub(crate) fn contradiction(robot: &Robot, options: &RigOptions, rig: &Rig) -> Refusal {
    let base = rig.camera_from_base * Point3::origin();
    let depth_mm = (rig.camera_from_grid * Vector3::z()).dot(&base.coords);
    let (said_mm, stands_off_mm) = (rig.grid_pitch_mm, rig.standoff_mm());
    let scale = (depth_mm + stands_off_mm) / (depth_mm + options.standoff_mm);
    let (diameter_mm, length_mm) = (robot.body.disk_diameter_mm, robot.length_mm);
    let message = format!(
        "the scale contradicts the snake's size: with grid_pitch_mm = {} and standoff_mm = {} it would be {:.2} mm thick and \
         {:.1} mm long, but the robot is {diameter_mm} mm and {length_mm} mm; a pitch of {:.2} mm or a standoff of {:.0} mm \
         would agree. Measure the paper and correct what is wrong; or the camera file is, or the snake is not unbent",
        options.grid_pitch_mm,
        options.standoff_mm,
        scale * diameter_mm,
        scale * length_mm,
        said_mm / scale,
        stands_off_mm.max(0.0),
    );
    Refusal { step: Step::Scale, message }
}
