//! What the snake looks like: its body as disks and tubes, projected, and the border that a picture shows of it.
//!
//! `parts` (points and pieces of the body) → `projection` → `section` (one cross-section in the camera's frame) → `surfaces`
//! (rims and limbs) → `silhouette` (their union, as a raster) → `outline` (what of them is on its border).

mod outline;
mod parts;
mod projection;
mod section;
mod silhouette;
mod surfaces;

pub use outline::{Outline, OutlinePoint, PredictedEdge};
pub use parts::{BodyPoint, Piece};
pub use projection::Projection;
