//! What a calibration saw in the straight picture, for a person to look at: also, and above all, where it was refused.

use nalgebra::{Point2, Vector2};

/// What was seen in a picture of the straight snake before the grid target.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RigSketch {
    /// The border of the sheet, px; empty where no sheet was found.
    pub sheet: Vec<Point2<f64>>,
    /// The ruling that was tried last: the vectors in the picture from one line to the next, px, across and along.
    pub lines_px: Option<[Vector2<f64>; 2]>,
    /// What may be the snake: the corners of its box, px, holder left and right, tip right and left; the likeliest first.
    pub bodies: Vec<[Point2<f64>; 4]>,
}

impl RigSketch {
    /// Notes what may be the snake before a ruling.
    pub(super) fn see_snake(&mut self, lines_px: [Vector2<f64>; 2], bodies: Vec<[Point2<f64>; 4]>) {
        self.lines_px = Some(lines_px);
        self.bodies = bodies;
    }
}
