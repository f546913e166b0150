//! The eye: pictures of the snake before a grid target to θ and δ, with their uncertainty.
//!
//! A rig is calibrated once from a picture of the unbent snake ([`calibrate_rig`]); an [`Eye`] then measures frames. Its rooms, each of
//! which uses only those above it:
//!
//! 1. `image`: pictures of one channel, in which the snake is 1 and the target 0 (Fisher's discriminant of the colours).
//! 2. `body`: the snake's disks and tubes, projected, and the border of their silhouette.
//! 3. `fit`: sub-pixel edges near that border, the robust fit of bend and edge bias to them, its covariance, and the selection among
//!    its local minima.
//! 4. `target`: the grid's lines and its pose.
//! 5. `rig`: where camera, target and base are, and whether they stay there.
//!
//! Poses of a tracker take the place of pictures: [`measure_poses`].
//!
//! Frames of bent snakes tell more about the rig than the straight picture does: [`Eye::refined`].

mod body;
mod explain;
mod eye;
mod fit;
mod fitter;
#[cfg(test)]
mod fixture;
mod image;
mod measurement;
mod minima;
mod rig;
mod selection;
mod sequence;
mod several;
mod straight;
mod target;
mod tracker;

pub use body::{BodyPoint, Outline, OutlinePoint, Piece, Projection};
pub use explain::{Explanation, SearchedPoint, WeightedEdge};
pub use eye::Eye;
pub use fit::{EdgeBias, UNKNOWN_SHAPE_RAD};
pub use image::appearance::Appearance;
pub use measurement::{Bend, FrameMeasurement};
pub use rig::{CalibrationStep, Rig, RigError, RigOptions, RigSketch, STRAIGHT, SnakePart};
pub use several::fused;
pub use straight::{calibrate_rig, sketched_rig};
pub use target::{GridPattern, PatternKind, PrintProfile, SheetShape};
pub use tracker::{TrackedPoses, TrackerError, TrackerOptions, measure_poses};
