//! The normal equations of a weighted linear least-squares problem.

use nalgebra::{DMatrix, DVector};

/// JᵗWJ and JᵗWr with W = diag(weights): a step −(JᵗWJ)⁻¹JᵗWr minimises Σ w r² of the linearised residuals.
pub fn normal_equations(
    jacobian: &DMatrix<f64>,
    residuals: &DVector<f64>,
    weights: &DVector<f64>,
) -> (DMatrix<f64>, DVector<f64>) {
    let mut weighted = jacobian.clone();
    for mut column in weighted.column_iter_mut() {
        column.component_mul_assign(weights);
    }
    (jacobian.tr_mul(&weighted), weighted.tr_mul(residuals))
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn their_solution_is_the_weighted_mean() {
        let jacobian = DMatrix::from_element(3, 1, 1.0);
        let (residuals, weights) =
            (DVector::from_column_slice(&[1.0, 4.0, 7.0]), DVector::from_column_slice(&[1.0, 2.0, 1.0]));
        let (information, slope) = normal_equations(&jacobian, &residuals, &weights);
        assert_relative_eq!(slope[0] / information[(0, 0)], 4.0, epsilon = 1e-12);
    }
}
