//! The normal equations of a weighted linear least-squares problem.

use nalgebra::{DMatrix, DVector};

/// So many rows are taken at a time.
///
/// Convention: a dozen columns of as many numbers fit the fastest cache of a processor, 32 kB.
const ROWS: usize = 128;
/// Sums of products are formed in so many parts, which the compiler computes side by side.
///
/// Convention: four registers of two numbers, which every x86-64 and ARM64 processor has.
const PARTS: usize = 8;

/// JᵗJ.
pub fn information(jacobian: &DMatrix<f64>) -> DMatrix<f64> {
    let (rows, parameters) = jacobian.shape();
    let column = |k: usize| &jacobian.as_slice()[k * rows..][..rows];
    let mut information = DMatrix::zeros(parameters, parameters);
    for k in 0..parameters {
        (k..parameters).for_each(|other| information[(other, k)] = dot(column(k), column(other)));
    }
    information.fill_upper_triangle_with_lower_triangle();
    information
}

/// JᵗWJ and JᵗWr with W = diag(weights): a step −(JᵗWJ)⁻¹JᵗWr minimises Σ w r² of the linearised residuals.
pub fn normal_equations(
    jacobian: &DMatrix<f64>,
    residuals: &DVector<f64>,
    weights: &DVector<f64>,
) -> (DMatrix<f64>, DVector<f64>) {
    let (rows, parameters) = jacobian.shape();
    let (mut information, mut slope) = (DMatrix::zeros(parameters, parameters), DVector::zeros(parameters));
    let (residuals, weights) = (residuals.as_slice(), weights.as_slice());
    let mut weighted = [0.0; ROWS];
    for first in (0..rows).step_by(ROWS) {
        let part = first..(first + ROWS).min(rows);
        let column = |k: usize| &jacobian.as_slice()[k * rows..][part.clone()];
        let weighted = &mut weighted[..part.len()];
        for k in 0..parameters {
            let factors = column(k).iter().zip(&weights[part.clone()]);
            weighted.iter_mut().zip(factors).for_each(|(product, (slope, weight))| *product = slope * weight);
            slope[k] += dot(weighted, &residuals[part.clone()]);
            for other in k..parameters {
                information[(other, k)] += dot(weighted, column(other));
            }
        }
    }
    information.fill_upper_triangle_with_lower_triangle();
    (information, slope)
}

/// Σ a b.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<PARTS>(), b.as_chunks::<PARTS>());
    let mut sums = [0.0; PARTS];
    for (a, b) in a.iter().zip(b) {
        (0..PARTS).for_each(|k| sums[k] += a[k] * b[k]);
    }
    sums.iter().sum::<f64>() + a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum::<f64>()
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
