//! Cluster-robust covariance: the covariance of a fit whose errors are alike within groups.
//!
//! With J_g and r_g the rows and residuals of the group g of G, and n parameters,
//!
//! ```text
//! V = G/(G − n) · (JᵗJ)⁻¹ (Σ_g J_gᵗ r_g r_gᵗ J_g) (JᵗJ)⁻¹ ,
//! ```
//!
//! which believes nothing of the errors but that groups are independent of each other.
//!
//! Source: A. C. Cameron, D. L. Miller, "A Practitioner's Guide to Cluster-Robust Inference", J. Human Resources 50, 2015, Eq. 11,
//! with the finite-cluster factor G/(G − n) in place of its G/(G − 1).

use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;

/// The covariance of a (weighted) fit whose errors come in clusters.
///
/// `jacobian` and `residuals` are in units of σ and already multiplied by the roots of their weights. `clusters` names the cluster of
/// each row; rows beyond it (priors) are clusters of their own. `None` where there are no more clusters than parameters, or the rows
/// do not determine the parameters.
pub fn clustered_covariance<K: Ord>(
    jacobian: &DMatrix<f64>,
    residuals: &DVector<f64>,
    clusters: impl IntoIterator<Item = K>,
) -> Option<DMatrix<f64>> {
    let parameters = jacobian.ncols();
    let bread = jacobian.tr_mul(jacobian).cholesky()?.inverse();
    let mut scores: BTreeMap<Result<K, usize>, DVector<f64>> = BTreeMap::new();
    let mut names = clusters.into_iter();
    for row in 0..jacobian.nrows() {
        let score = scores.entry(names.next().ok_or(row)).or_insert_with(|| DVector::zeros(parameters));
        score.iter_mut().zip(jacobian.row(row).iter()).for_each(|(sum, slope)| *sum += slope * residuals[row]);
    }
    let count = scores.len() as f64;
    if count <= parameters as f64 {
        return None;
    }
    let meat = scores.values().fold(DMatrix::zeros(parameters, parameters), |sum, s| sum + s * s.transpose());
    Some(&bread * meat * &bread * (count / (count - parameters as f64)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::moments::{mean, standard_deviation};
    use approx::assert_relative_eq;
    use rand::SeedableRng;
    use rand::rngs::StdRng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn a_mean_over_clusters_has_the_closed_form() {
        let jacobian = DMatrix::from_element(8, 1, 1.0);
        let residuals = DVector::from_column_slice(&[1.0, 1.0, 1.0, -1.0, 0.5, -0.5, 0.5, -0.5]);
        let apart = clustered_covariance(&jacobian, &residuals, 0..8).unwrap()[(0, 0)];
        let together = clustered_covariance(&jacobian, &residuals, [1, 1, 2, 3, 4, 5, 6, 7]).unwrap()[(0, 0)];
        // Σ s²: 1 + 1 + 1 + 1 + 4 · ¼ of eight clusters, 4 + 1 + 1 + 4 · ¼ of seven.
        assert_relative_eq!(apart, 5.0 / 64.0 * 8.0 / 7.0, epsilon = 1e-12);
        assert_relative_eq!(together, 7.0 / 64.0 * 7.0 / 6.0, epsilon = 1e-12);
    }

    #[test]
    fn rows_without_a_cluster_stand_alone_and_too_few_clusters_say_nothing() {
        let jacobian = DMatrix::from_element(4, 1, 1.0);
        let residuals = DVector::from_column_slice(&[1.0, -1.0, 2.0, -2.0]);
        let named = clustered_covariance(&jacobian, &residuals, [0, 0, 2, 3]).unwrap();
        assert_eq!(named, clustered_covariance(&jacobian, &residuals, [0, 0]).unwrap());
        assert!(clustered_covariance(&jacobian, &residuals, [0; 4]).is_none());
    }

    #[test]
    fn a_line_through_errors_that_clusters_share_scatters_as_it_says() {
        // Each of forty clusters of ten has an error of its own (σ 1) beside independent ones (σ 0.5).
        let mut random = StdRng::seed_from_u64(3);
        let jacobian = DMatrix::from_fn(400, 2, |r, c| if c == 0 { 1.0 } else { (r / 10) as f64 / 20.0 - 1.0 });
        let bread = jacobian.tr_mul(&jacobian).cholesky().unwrap().inverse();
        let (mut slopes, mut told) = (Vec::new(), Vec::new());
        for _ in 0..1500 {
            let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
            let shared: Vec<f64> = (0..40).map(|_| normal()).collect();
            let errors = DVector::from_fn(400, |r, _| shared[r / 10] + 0.5 * normal());
            let found = &bread * jacobian.tr_mul(&errors);
            let residuals = &errors - &jacobian * &found;
            let covariance = clustered_covariance(&jacobian, &residuals, (0..400).map(|r| r / 10)).unwrap();
            slopes.push(found[1]);
            told.push(covariance[(1, 1)]);
        }
        let ratio = mean(told) / standard_deviation(&slopes).powi(2);
        // 1500 variances scatter by 3.7 %; the estimate's own bias at forty clusters is a few per cent.
        assert!((ratio - 1.0).abs() < 0.12, "{ratio}");
    }
}
