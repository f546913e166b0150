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
    /// What was seen and where, in words: the sheet, its lines, and what is likeliest the snake.
    pub fn text(&self) -> String {
        let boxed = |corners: &[Point2<f64>]| {
            let first = corners.first()?;
            let (low, high) = corners.iter().fold((*first, *first), |(low, high), p| (low.inf(p), high.sup(p)));
            Some(format!("from ({:.0}, {:.0}) to ({:.0}, {:.0}) px", low.x, low.y, high.x, high.y))
        };
        let sheet = boxed(&self.sheet).map(|place| format!("a sheet {place}"));
        let lines = self.lines_px.map(|[across, along]| {
            format!("lines {:.1} px apart across and {:.1} px along", across.norm(), along.norm())
        });
        let body = self.bodies.first().and_then(|body| boxed(body)).map(|place| format!("the likeliest snake {place}"));
        [sheet, lines, body].into_iter().flatten().collect::<Vec<_>>().join(", ")
    }

    /// Notes what may be the snake before a ruling.
    pub(super) fn see_snake(&mut self, lines_px: [Vector2<f64>; 2], bodies: Vec<[Point2<f64>; 4]>) {
        self.lines_px = Some(lines_px);
        self.bodies = bodies;
    }
}
