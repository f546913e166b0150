//! The normal equations of a weighted linear least-squares problem.

use nalgebra::{DMatrix, DVector};

/// JᵗWJ and JᵗWr with W = diag(weights): a step −(JᵗWJ)⁻¹JᵗWr minimises Σ w r² of the linearised residuals.
pub fn normal_equations(
    jacobian: &DMatrix<f64>,
    residuals: &DVector<f64>,
    weights: &DVector<f64>,
) -> (DMatrix<f64>, DVector<f64>) {
    let parameters = jacobian.ncols();
    let (mut information, mut slope) = (DMatrix::zeros(parameters, parameters), DVector::zeros(parameters));
    for k in 0..parameters {
        let weighted = jacobian.column(k).component_mul(weights);
        slope[k] = weighted.dot(residuals);
        // The other triangle is the same.
        for other in k..parameters {
            let sum = jacobian.column(other).dot(&weighted);
            (information[(other, k)], information[(k, other)]) = (sum, sum);
        }
    }
    (information, slope)
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
