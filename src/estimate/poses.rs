//! Which of the bends that come one after the other are other poses.

use nalgebra::Vector2;
use std::f64::consts::PI;

/// The snake is at another pose once its bend, seen or implied by its encoders, has changed by this, rad. Convention: 2°, many times the noise
/// of either; the errors of two such measurements are taken for independent.
pub(crate) const NEW_POSE: f64 = 2.0 * PI / 180.0;

/// Tells of bends that come one after the other which are other poses than the one told last.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct NewPoses {
    last: Option<Vector2<f64>>,
}

impl NewPoses {
    /// Whether this bend, rad, is another pose.
    pub fn is_new(&mut self, bend: Vector2<f64>) -> bool {
        let is_new = self.last.is_none_or(|last| (bend - last).norm() >= NEW_POSE);
        if is_new {
            self.last = Some(bend);
        }
        is_new
    }
}
