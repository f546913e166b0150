//! What fits to matched edges may believe: robust weights, and covariances that count pieces of the outline, not pixels.

use super::correspondences::Correspondences;
use crate::measure::body::{Piece, Projection};
use crate::measure::image::plane::median;
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;

/// Square roots of the robust weights of residuals in units of their σ, the scale taken from their median.
///
/// While the model is still `settling`, Huber's: a whole family of edges may be far off because the model is, and must
/// go on pulling. Then Tukey's biweight: what is still far off is not the snake's outline and counts nothing.
pub(crate) fn robust_weights(residuals: &[f64], settling: bool) -> Vec<f64> {
    let mut sizes: Vec<f32> = residuals.iter().map(|r| r.abs() as f32).collect();
    let scale = (1.4826 * f64::from(median(&mut sizes))).max(1.0);
    let huber = |r: f64| (1.345 * scale / r.abs().max(1e-12)).min(1.0).sqrt();
    let tukey = |r: f64| (1.0 - (r / (4.685 * scale)).powi(2)).max(0.0);
    residuals.iter().map(|&r| if settling { huber(r) } else { tukey(r) }).collect()
}

/// How many edges count at least half, and their scatter, px.
pub(crate) fn inliers(misfits_px: &[f64], roots: &[f64]) -> (usize, f64) {
    let kept: Vec<f64> = misfits_px.iter().zip(roots).filter(|(_, w)| **w > 0.5).map(|(d, _)| *d).collect();
    let rms = (kept.iter().map(|d| d * d).sum::<f64>() / kept.len().max(1) as f64).sqrt();
    (kept.len(), rms)
}

/// Covariance of a weighted fit that does not believe that errors along one piece of the body are independent: White's
/// sandwich with the pieces as clusters. `jacobian` and `residuals` are in units of σ and already weighted; rows beyond
/// `pieces` (priors) are pieces of their own.
///
/// Source: A. C. Cameron, D. L. Miller, "A Practitioner's Guide to Cluster-Robust Inference", 2015, Eq. 11 with the
/// finite-cluster factor.
pub(crate) fn clustered_covariance(
    jacobian: &DMatrix<f64>,
    residuals: &DVector<f64>,
    pieces: &[Piece],
) -> Option<DMatrix<f64>> {
    let parameters = jacobian.ncols();
    let bread = (jacobian.transpose() * jacobian).cholesky()?.inverse();
    let mut scores: BTreeMap<Result<Piece, usize>, DVector<f64>> = BTreeMap::new();
    for row in 0..jacobian.nrows() {
        let cluster = pieces.get(row).map(|piece| piece.cluster()).ok_or(row);
        let score = scores.entry(cluster).or_insert_with(|| DVector::zeros(parameters));
        score.iter_mut().zip(jacobian.row(row).iter()).for_each(|(sum, slope)| *sum += slope * residuals[row]);
    }
    let clusters = scores.len() as f64;
    if clusters <= parameters as f64 {
        return None;
    }
    let meat = scores.values().fold(DMatrix::zeros(parameters, parameters), |sum, s| sum + s * s.transpose());
    Some(&bread * meat * &bread * (clusters / (clusters - parameters as f64)))
}

/// What [`Correspondences::systematic_modes`] add to the covariance of a fit to these edges, whose rows come first in `jacobian`.
pub(crate) fn systematic_covariance(
    matches: &Correspondences,
    jacobian: &DMatrix<f64>,
    independent: &DMatrix<f64>,
    view: &Projection,
    roots: &[f64],
    scatter_px: f64,
) -> DMatrix<f64> {
    let edges = jacobian.rows(0, matches.len()).transpose();
    let shifts =
        matches.systematic_modes(view, roots, scatter_px).into_iter().map(|pattern| independent * (&edges * pattern));
    shifts.fold(DMatrix::zeros(independent.nrows(), independent.ncols()), |sum, shift| sum + &shift * shift.transpose())
}

/// Covariance of the `kept` parameters of a fit: [`clustered_covariance`], widened wherever it says less than independent edges
/// do, for the scores of a few pieces may agree by chance, and what light adds.
pub(crate) fn whole_covariance(
    [clustered, independent, light]: [&DMatrix<f64>; 3],
    kept: &[usize],
) -> Option<DMatrix<f64>> {
    let block = |of: &DMatrix<f64>| DMatrix::from_fn(kept.len(), kept.len(), |r, c| of[(kept[r], kept[c])]);
    let root = block(independent).cholesky()?.l();
    let inverse = root.clone().try_inverse()?;
    let mut ratio = (&inverse * block(clustered) * inverse.transpose()).symmetric_eigen();
    ratio.eigenvalues.iter_mut().for_each(|value| *value = value.max(1.0));
    Some(&root * ratio.recompose() * root.transpose() + block(light))
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use nalgebra::{Matrix2, Vector2};
    use proptest::prelude::*;

    fn covariance_of(a: f64, b: f64, c: f64) -> Matrix2<f64> {
        let root = Matrix2::new(a, 0.0, b, c);
        root * root.transpose()
    }

    /// The whole covariance where light adds nothing.
    fn widened(clustered: &Matrix2<f64>, independent: &Matrix2<f64>) -> Matrix2<f64> {
        let dynamic = |m: &Matrix2<f64>| DMatrix::from_column_slice(2, 2, m.as_slice());
        let parts = [dynamic(clustered), dynamic(independent), DMatrix::zeros(2, 2)];
        whole_covariance(parts.each_ref(), &[0, 1]).unwrap().fixed_view::<2, 2>(0, 0).into_owned()
    }

    proptest! {
        #[test]
        fn what_is_at_least_another_is_no_less_than_either(
            (a, b, c) in (0.01..10.0, -10.0..10.0, 0.01..10.0),
            (d, e, f) in (0.01..10.0, -10.0..10.0, 0.01..10.0),
        ) {
            let (covariance, least) = (covariance_of(a, b, c), covariance_of(d, e, f));
            let widened = widened(&covariance, &least);
            let rounding = 1e-9 * widened.trace().powi(2) / least.determinant().sqrt();
            prop_assert!((widened - covariance).symmetric_eigenvalues().min() > -rounding);
            prop_assert!((widened - least).symmetric_eigenvalues().min() > -rounding);
        }
    }

    #[test]
    fn a_covariance_is_widened_only_where_it_says_less() {
        let covariance = Matrix2::from_diagonal(&Vector2::new(4.0, 0.1));
        let widened = widened(&covariance, &Matrix2::identity());
        assert_relative_eq!(widened, Matrix2::from_diagonal(&Vector2::new(4.0, 1.0)), epsilon = 1e-12);
    }

    #[test]
    fn the_scores_of_one_tubes_side_are_one_witness() {
        // Two edges that pull together lie on rims of two disks, or on one tube.
        let jacobian = DMatrix::from_element(8, 1, 1.0);
        let residuals = DVector::from_column_slice(&[1.0, 1.0, 1.0, -1.0, 0.5, -0.5, 0.5, -0.5]);
        let rims: Vec<Piece> = (0..8).map(|k| Piece::Rim(k, false)).collect();
        let tube: Vec<Piece> =
            (0..8).map(|k| if k < 2 { Piece::Tube(1, 1, k) } else { Piece::Rim(k, false) }).collect();
        let apart = clustered_covariance(&jacobian, &residuals, &rims).unwrap()[(0, 0)];
        let together = clustered_covariance(&jacobian, &residuals, &tube).unwrap()[(0, 0)];
        // Σ s²: 1 + 1 + 1 + 1 + 4 · ¼ of eight witnesses, 4 + 1 + 1 + 4 · ¼ of seven.
        assert_relative_eq!(apart, 5.0 / 64.0 * 8.0 / 7.0, epsilon = 1e-12);
        assert_relative_eq!(together, 7.0 / 64.0 * 7.0 / 6.0, epsilon = 1e-12);
    }
}
