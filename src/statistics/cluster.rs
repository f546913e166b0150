//! Cluster-robust covariance: the covariance of a fit whose errors are alike within groups.
//!
//! With J_g and r_g the rows and residuals of the group g of G, B = (JᵗJ)⁻¹ over all rows, and A_g = J_gᵗJ_g,
//!
//! ```text
//! V = B ( (G − 1)/G Σ_g s_g s_gᵗ + v Σ_p j_p j_pᵗ ) B ,      s_g = (I − A_g B)⁻¹ J_gᵗ r_g ,
//! ```
//!
//! which believes nothing of the errors but that groups are independent of each other. s_g is what leaving the group out would move
//! the fit by (the jackknife, CR3): with few groups, or groups of unequal weight, residuals are smaller than errors, since each group
//! pulls the fit towards itself, and the plain J_gᵗ r_g (CR1) gives a covariance several times too small. Rows that are priors are no
//! group of a sample: what they add is their stated variance v, not the offset that happens to be left of them.
//!
//! Source: R. M. Bell, D. F. McCaffrey, "Bias reduction in standard errors for linear regression with multi-stage samples", Survey
//! Methodology 28, 2002, Eq. 8; J. G. MacKinnon, M. Ø. Nielsen, M. D. Webb, "Cluster-robust inference: a guide to empirical practice",
//! J. Econometrics 232, 2023, section 4, which recommend it.

use super::normal_equations::normal_equations;
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;

/// The covariance of a (weighted) fit whose errors come in clusters.
///
/// `jacobian` and `residuals` are in units of σ and already multiplied by the roots of their weights; `independent` is (JᵗJ)⁻¹. `clusters` names the cluster of
/// each row; rows beyond it are priors, whose residuals have the variance `prior_variance`. `None` where there are no more clusters than
/// parameters, or the rows do not determine the parameters without one of the clusters.
pub fn clustered_covariance<K: Ord>(
    jacobian: &DMatrix<f64>,
    residuals: &DVector<f64>,
    independent: &DMatrix<f64>,
    clusters: impl IntoIterator<Item = K>,
    prior_variance: f64,
) -> Option<DMatrix<f64>> {
    let parameters = jacobian.ncols();
    let mut groups: BTreeMap<K, Vec<usize>> = BTreeMap::new();
    for (row, name) in clusters.into_iter().take(jacobian.nrows()).enumerate() {
        groups.entry(name).or_default().push(row);
    }
    if groups.len() <= parameters {
        return None;
    }
    let normal = |rows: &[usize]| {
        let weights = DVector::from_element(rows.len(), 1.0);
        normal_equations(&jacobian.select_rows(rows), &residuals.select_rows(rows), &weights)
    };
    let mut meat = DMatrix::zeros(parameters, parameters);
    for rows in groups.values() {
        let (information, score) = normal(rows);
        let without = DMatrix::identity(parameters, parameters) - information * independent;
        let score = without.lu().solve(&score)?;
        meat.ger(1.0, &score, &score, 1.0);
    }
    let first_prior = groups.values().map(Vec::len).sum();
    let (priors, _) = normal(&(first_prior..jacobian.nrows()).collect::<Vec<_>>());
    let priors = priors * prior_variance;
    let count = groups.len() as f64;
    let clustered = independent * (meat * ((count - 1.0) / count) + priors) * independent;
    clustered.iter().all(|value| value.is_finite()).then_some(clustered)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::least_squares::covariance;
    use crate::statistics::moments::{mean, standard_deviation};
    use approx::assert_relative_eq;
    use rand::SeedableRng;
    use rand::rngs::StdRng;
    use rand_distr::{Distribution, StandardNormal};

    fn clustered<K: Ord>(
        jacobian: &DMatrix<f64>,
        residuals: &DVector<f64>,
        clusters: impl IntoIterator<Item = K>,
        prior_variance: f64,
    ) -> Option<DMatrix<f64>> {
        clustered_covariance(jacobian, residuals, &covariance(jacobian)?, clusters, prior_variance)
    }

    #[test]
    fn a_mean_over_clusters_has_the_closed_form() {
        let jacobian = DMatrix::from_element(8, 1, 1.0);
        let residuals = DVector::from_column_slice(&[1.0, 1.0, 1.0, -1.0, 0.5, -0.5, 0.5, -0.5]);
        let apart = clustered(&jacobian, &residuals, 0..8, 1.0).unwrap()[(0, 0)];
        let together = clustered(&jacobian, &residuals, [1, 1, 2, 3, 4, 5, 6, 7], 1.0).unwrap()[(0, 0)];
        // (G − 1)/G Σ (s_g/(1 − n_g/8))²/64: Σ s² is 1 + 1 + 1 + 1 + 4 · ¼ of eight clusters; of seven it is 4 and 1 + 1 + 4 · ¼.
        assert_relative_eq!(apart, 7.0 / 8.0 * 5.0 * (8.0_f64 / 7.0).powi(2) / 64.0, epsilon = 1e-12);
        let scores = 4.0 * (8.0_f64 / 6.0).powi(2) + 3.0 * (8.0_f64 / 7.0).powi(2);
        assert_relative_eq!(together, 6.0 / 7.0 * scores / 64.0, epsilon = 1e-12);
    }

    #[test]
    fn it_is_the_jackknife_over_the_clusters() {
        let mut random = StdRng::seed_from_u64(1);
        let jacobian = DMatrix::from_fn(30, 3, |_, _| StandardNormal.sample(&mut random));
        let residuals = DVector::from_fn(30, |_, _| StandardNormal.sample(&mut random));
        let fit = |kept: &dyn Fn(usize) -> bool| {
            let rows: Vec<usize> = (0..30).filter(|&row| kept(row)).collect();
            let (j, r) = (jacobian.select_rows(&rows), residuals.select_rows(&rows));
            j.tr_mul(&j).cholesky().unwrap().solve(&j.tr_mul(&r))
        };
        let whole = fit(&|_| true);
        let left = &residuals - &jacobian * &whole;
        let cluster = |row: usize| row / 5;
        let moves = (0..6).map(|g| fit(&|row| cluster(row) != g) - &whole);
        let jackknife = moves.fold(DMatrix::zeros(3, 3), |sum, by| sum + &by * by.transpose()) * (5.0 / 6.0);
        let covariance = clustered(&jacobian, &left, (0..30).map(cluster), 1.0).unwrap();
        assert_relative_eq!(covariance, jackknife, epsilon = 1e-10);
    }

    #[test]
    fn a_prior_that_decides_alone_leaves_its_own_variance() {
        // One parameter that rows of four clusters hardly tell, and a prior of σ = 0.1 whose offset happens to be nothing.
        let jacobian = DMatrix::from_column_slice(5, 1, &[1e-3, 1e-3, 1e-3, 1e-3, 10.0]);
        let residuals = DVector::from_column_slice(&[1.0, -1.0, 1.0, -1.0, 0.0]);
        let covariance = clustered(&jacobian, &residuals, 0..4, 1.0).unwrap();
        assert_relative_eq!(covariance[(0, 0)], 0.01, max_relative = 1e-6);
    }

    #[test]
    fn too_few_clusters_say_nothing() {
        let jacobian = DMatrix::from_element(4, 1, 1.0);
        let residuals = DVector::from_column_slice(&[1.0, -1.0, 2.0, -2.0]);
        assert!(clustered(&jacobian, &residuals, [0; 4], 1.0).is_none());
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
            let covariance = clustered(&jacobian, &residuals, (0..400).map(|r| r / 10), 1.0).unwrap();
            slopes.push(found[1]);
            told.push(covariance[(1, 1)]);
        }
        let ratio = mean(told) / standard_deviation(&slopes).powi(2);
        // 1500 variances scatter by 3.7 %; the estimate's own bias at forty clusters is a few per cent.
        assert!((ratio - 1.0).abs() < 0.12, "{ratio}");
    }
}
