//! What all frames of one experiment share: the error of its rig calibration.

use super::physics::{Changes, LINEAR, ParameterSpec, Physics};
use nalgebra::{Rotation2, Vector2};

const fn angle(name: &'static str, most_deg: f64) -> ParameterSpec {
    ParameterSpec::size(name, "deg", most_deg, 0.1)
}

/// The base is not quite where the straight picture put it. Each frame's sigma holds this error, but it is the same in all of
/// them, so that many frames would make an effect of it. `discover` leaves it free, within what a rig calibration can miss by,
/// where measurements come from frames; it belongs to the experiment and not to the robot, and stands in no model.
pub static RIG_ERROR: Physics = Physics {
    name: "rig_error",
    equation: "measured b = R(a) b + c",
    reading: "a base whose pose differs a little from the rig calibration",
    parameters: |_| const { &[angle("tilt_x_deg", 0.5), angle("tilt_y_deg", 0.5), angle("turn_deg", 0.3)] },
    changes: Changes::Eye(|bend, p| {
        Rotation2::new(p[2].to_radians()) * bend + Vector2::new(p[0], p[1]).map(f64::to_radians)
    }),
    ..LINEAR
};
