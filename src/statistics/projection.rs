//! What columns have beyond the span of a basis: M C with the residual maker M = I − J (JᵗJ)⁻¹ Jᵗ.
//!
//! The coefficients of C in a least-squares fit beside J are those of M C alone (R. Frisch, F. V. Waugh, "Partial Time Regressions as
//! Compared with Individual Trends", Econometrica 1, 1933).

use nalgebra::{Cholesky, DMatrix, Dyn};

/// The ridge that keeps a projection solvable, relative and absolute.
///
/// Convention: a numerical guard.
const RIDGE: f64 = 1e-12;

/// The complement of the span of a basis.
#[derive(Debug, Clone)]
pub struct Complement {
    basis: DMatrix<f64>,
    /// Of JᵗJ; none where it is singular.
    factor: Option<Cholesky<f64, Dyn>>,
}

impl Complement {
    /// Of the columns of J.
    pub fn new(basis: DMatrix<f64>) -> Self {
        let mut information = basis.tr_mul(&basis);
        for j in 0..information.nrows() {
            information[(j, j)] = information[(j, j)] * (1.0 + RIDGE) + RIDGE;
        }
        Self { factor: information.cholesky(), basis }
    }

    /// M C; C itself where the basis is singular.
    pub fn of(&self, columns: &DMatrix<f64>) -> DMatrix<f64> {
        match &self.factor {
            Some(factor) => columns - &self.basis * factor.solve(&self.basis.tr_mul(columns)),
            None => columns.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_remains_is_at_right_angles_to_the_basis_and_nothing_of_its_span_is_left() {
        let basis = DMatrix::from_fn(20, 2, |row, c| (row as f64 + 1.0).powi(c as i32));
        let columns = DMatrix::from_fn(20, 2, |row, c| if c == 0 { 3.0 - row as f64 } else { (row as f64).sin() });
        let remaining = Complement::new(basis.clone()).of(&columns);
        assert!((basis.transpose() * &remaining).amax() < 1e-7);
        assert!(remaining.column(0).norm() < 1e-8 && remaining.column(1).norm() > 1.0);
    }
}
