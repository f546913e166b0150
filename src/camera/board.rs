//! The chessboard whose pictures a lens is calibrated from.

use crate::error::{ArgumentError, Result};
use nalgebra::Point3;

/// A plain chessboard.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Board {
    pub(super) columns: usize,
    pub(super) rows: usize,
    pub(super) square_mm: f64,
}

impl Board {
    /// A board of so many inner corners along a row and along a column, with squares of `square_mm`. The squares' side sets the
    /// scale of the boards' distances only; the lens does not depend on it.
    ///
    /// # Errors
    /// Fewer than three corners either way, from which no lens can be told, or a side that is not above 0.
    pub fn new(columns: usize, rows: usize, square_mm: f64) -> Result<Self> {
        if columns < 3 || rows < 3 || !(square_mm > 0.0 && square_mm.is_finite()) {
            return Err(ArgumentError::Board { columns, rows, square_mm }.into());
        }
        Ok(Self { columns, rows, square_mm })
    }

    /// The inner corners on the board, mm, row by row; z is away from the camera.
    pub(super) fn corners(&self) -> Vec<Point3<f64>> {
        let corner = |k: usize| Point3::new((k % self.columns) as f64, (k / self.columns) as f64, 0.0) * self.square_mm;
        (0..self.columns * self.rows).map(corner).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boards_that_tell_no_lens_are_refused() {
        for (columns, rows, square_mm) in [(2, 6, 25.0), (9, 0, 25.0), (9, 6, 0.0), (9, 6, f64::NAN)] {
            assert!(Board::new(columns, rows, square_mm).is_err(), "{columns}×{rows}, {square_mm} mm");
        }
        let corners = Board::new(9, 6, 25.0).unwrap().corners();
        assert_eq!((corners.len(), corners[10]), (54, Point3::new(25.0, 25.0, 0.0)));
    }
}
