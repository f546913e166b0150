//! Calibrates a rig from the straight picture, and asks the eye whether the snake in it is straight.
//!
//! The fit of the base knows only the straight snake. A bent one may agree with it over holder and first disks, and in a small picture
//! with edges of other things over the rest; the eye, which knows all bends, then sees the snake where it is.

use super::eye::Eye;
use super::rig::{Rig, RigError, RigOptions, RigSketch, StraightPicture, find_rig};
use crate::camera::{Frame, Lens};
use crate::robot::Robot;
use nalgebra::Vector2;

/// A snake that is bent by more than this in the straight picture, degrees, and this many of its σ, is not straight.
///
/// Convention: what "unbent" leaves to a hand and a clamp; 3 σ of an error in 400.
const MOST_BEND_DEG: f64 = 5.0;
const BENT_SIGMAS: f64 = 3.0;

/// Calibrates a rig from a picture of the straight snake before the grid target, in the three steps of `find_rig`.
///
/// # Errors
///
/// Why the try that came furthest ended, with the values that tell; or that the snake is bent, by how much.
pub fn calibrate_rig(frame: &Frame, lens: &Lens, robot: &Robot, options: &RigOptions) -> Result<Rig, RigError> {
    sketched_rig(frame, lens, robot, options).0
}

/// The same, with what was seen in the picture, whether it was refused or not.
pub fn sketched_rig(
    frame: &Frame,
    lens: &Lens,
    robot: &Robot,
    options: &RigOptions,
) -> (Result<Rig, RigError>, RigSketch) {
    let mut sketch = RigSketch::default();
    let rig = find_rig(StraightPicture { frame, lens, robot, options }, &mut sketch);
    (rig.and_then(|rig| unbent(frame, lens, robot, rig)), sketch)
}

/// The rig, unless the eye sees a bent snake through it.
fn unbent(frame: &Frame, lens: &Lens, robot: &Robot, rig: Rig) -> Result<Rig, RigError> {
    let seen = Eye::new(lens.clone(), rig.clone(), robot.clone()).track(frame, Vector2::zeros()).measured;
    if let Some(bend) = seen {
        let (theta_deg, sigma_deg) = (bend.configuration.theta_deg(), bend.sigma_theta.to_degrees());
        if theta_deg > MOST_BEND_DEG.max(BENT_SIGMAS * sigma_deg) {
            return Err(RigError::Bent { theta_deg, sigma_deg });
        }
    }
    Ok(rig)
}
