//! What the snake looks like: its body as disks and tubes, projected, and the border that a picture shows of it.

mod outline;

pub use outline::{BodyPoint, Outline, OutlinePoint, Piece, PredictedEdge, Projection};
