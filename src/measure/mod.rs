//! The eye: pictures of the snake before a grid to θ and δ, with their uncertainty.
//!
//! A rig is calibrated once from a picture of the unbent snake ([`calibrate_rig`]); an [`Eye`] then measures frames:
//!
//! 1. `appearance`: colours become one plane in which the snake stands out and the print does not.
//! 2. `search`: every bend's outline is tried at low resolution; the best few are starts.
//! 3. `outline`, `edges`: the model's outline is projected and the picture's edges near it are placed to a fraction of a
//!    pixel.
//! 4. `matches`, `fit`: bend and edge bias are adjusted until outline and edges agree, what disagrees losing its weight.
//! 5. `certainty`: the covariance counts pieces of the outline, not pixels, as evidence.
//!
//! Frames of bent snakes tell more about the rig than the straight picture does: [`Eye::refined`].

mod body;
mod explain;
mod eye;
mod fit;
mod follow;
mod image;
mod refine;
mod rig;
mod several;
mod target;

pub use body::{BodyPoint, Outline, OutlinePoint, Piece, Projection};
pub use explain::{Explanation, Place};
pub use eye::{Bend, Eye, FrameMeasurement};
pub use fit::EdgeBias;
pub use image::appearance::Appearance;
pub use rig::calibrate::{Rig, RigOptions, calibrate_rig};
pub use rig::drift::Print;
pub use several::fused;
pub use target::grid::Pattern;
