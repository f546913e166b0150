//! Robust weights of matched edges, and the covariance of what is fitted to them.
//!
//! The covariance of a fit has three parts, see [`FitCovariance`]: independent edges, edges that are correlated along each piece of
//! the body (cluster-robust), and the systematic modes of the noise model. The second counts as many times as the edges scatter more than the noise
//! model says, see [`excess`].

use super::correspondences::Correspondences;
use super::noise_model::noise_model;
use crate::measure::body::Projection;
use crate::statistics::cluster::clustered_covariance;
use crate::statistics::least_squares::covariance;
use crate::statistics::moments::rms;
use crate::statistics::robust::{HUBER_LIMIT, Loss, TUKEY_LIMIT};
use nalgebra::{DMatrix, DVector};

/// An edge is an inlier if the square root of its weight is larger than this.
///
/// Derived: Tukey's biweight is 0.25 there, at 3.3 times the scale, beyond which lies one normal error of a thousand.
const INLIER_ROOT: f64 = 0.5;

/// The least scale of whitened residuals in robust weights: their σ may be too large for a clean picture, and a scale taken from
/// them alone would then call good edges outliers.
///
/// Derived: 1 is the scale of residuals in units of their own σ.
pub(super) const LEAST_SCALE: f64 = 1.0;

/// Which robust loss a fit has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RobustPhase {
    /// Huber's monotone loss, while the model may still be far off: a whole family of edges that disagree must go on pulling.
    Monotone,
    /// Tukey's redescending biweight, once the model is close: what is still far off is not the snake's outline and counts nothing.
    Redescending,
}

impl RobustPhase {
    /// The loss, its limit in units of the residuals' scale.
    pub fn loss(self) -> Loss {
        match self {
            Self::Monotone => Loss::Huber(HUBER_LIMIT),
            Self::Redescending => Loss::Tukey(TUKEY_LIMIT),
        }
    }

    /// Square roots of the weights of residuals in units of their σ, the scale taken from their MAD.
    pub fn roots(self, residuals: &[f64]) -> Vec<f64> {
        self.loss().weights(residuals, LEAST_SCALE).into_iter().map(f64::sqrt).collect()
    }
}

/// How many edges are inliers, and the root mean square of their distances, px.
pub(crate) fn inliers(distances_px: &[f64], roots: &[f64]) -> (usize, f64) {
    let kept = || distances_px.iter().zip(roots).filter(|(_, root)| **root > INLIER_ROOT).map(|(d, _)| *d);
    (kept().count(), rms(kept()))
}

/// By how much the inliers' variance exceeds what the noise model says: the mean square of their distances in units of σ, and no less than 1. `weighted`
/// are these distances times the roots of the edges' weights.
///
/// Edges that scatter more than they may are displaced by something that the model does not know, a mirrored lamp or a wrong border, and that
/// displaces whole pieces and all alike as much more as it does single edges. Clusters cannot tell of what they all share, which fits follow.
///
/// Source: R. T. Birge, "The calculation of errors by the method of least squares", Physical Review 40, 1932: errors are multiplied by the ratio of
/// external to internal consistency.
pub(crate) fn excess<'a>(weighted: impl IntoIterator<Item = &'a f64>, roots: &[f64]) -> f64 {
    let inliers = weighted.into_iter().zip(roots).filter(|(_, root)| **root > INLIER_ROOT);
    rms(inliers.map(|(residual, root)| residual / root)).powi(2).max(1.0)
}

/// What the systematic modes of the noise model add to the covariance of a fit to these edges, whose rows come first in the
/// weighted `jacobian`. `independent` is the fit's covariance for independent edges.
pub(crate) fn systematic_covariance(
    edges: &Correspondences,
    jacobian: &DMatrix<f64>,
    independent: &DMatrix<f64>,
    view: &Projection,
    roots: &[f64],
    scatter_px: f64,
) -> DMatrix<f64> {
    let rows = jacobian.rows(0, edges.len());
    let modes = edges.systematic_modes(view, roots, scatter_px);
    let shifts = modes.iter().map(|mode| independent * rows.tr_mul(mode));
    shifts.fold(DMatrix::zeros(independent.nrows(), independent.ncols()), |sum, shift| sum + &shift * shift.transpose())
}

/// The covariance of a robust fit, in its parts.
pub(super) struct FitCovariance {
    /// (JᵗJ)⁻¹: as if all edges were independent.
    pub independent: DMatrix<f64>,
    /// Cluster-robust: correlated along each piece of the body.
    clustered: DMatrix<f64>,
    /// See [`excess`].
    pub excess: f64,
    /// From the systematic modes.
    systematic: DMatrix<f64>,
}

impl FitCovariance {
    /// From the weighted Jacobian and residuals of a fit, in units of σ: first a row for each edge, then the priors. `roots` are the
    /// roots of the edges' weights. `None` where the edges do not determine the parameters.
    pub fn new(
        edges: &Correspondences,
        jacobian: &DMatrix<f64>,
        residuals: &DVector<f64>,
        view: &Projection,
        roots: &[f64],
        scatter_px: f64,
    ) -> Option<Self> {
        let independent = covariance(jacobian)?;
        let design_effect = noise_model().design_effect;
        let clustered = clustered_covariance(jacobian, residuals, &independent, edges.clusters(), design_effect)?;
        let systematic = systematic_covariance(edges, jacobian, &independent, view, roots, scatter_px);
        Some(Self { independent, clustered, excess: excess(residuals, roots), systematic })
    }

    /// The covariance of the parameters with the indices `kept`: the clustered one, widened in each direction in which it is less
    /// than the independent one (the scores of a few clusters may agree by chance), of which a share ([`NoiseModel::own_variance`](super::noise_model::NoiseModel::own_variance)) is the frame's own, plus the
    /// systematic one. After it comes what the [`excess`] of the edges' variance adds.
    pub fn total(&self, kept: &[usize]) -> Option<[DMatrix<f64>; 2]> {
        let block = |of: &DMatrix<f64>| DMatrix::from_fn(kept.len(), kept.len(), |r, c| of[(kept[r], kept[c])]);
        let own = at_least(&block(&self.clustered), &block(&self.independent))? * noise_model().own_variance;
        let scatter = &own * (self.excess - 1.0);
        Some([own + block(&self.systematic), scatter])
    }
}

/// A covariance widened to `least` in each direction in which it is less: in the coordinates in which `least` is the identity, its
/// eigenvalues are raised to 1. `None` if `least` is not positive definite.
fn at_least(covariance: &DMatrix<f64>, least: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let root = least.clone().cholesky()?.l();
    let inverse = root.clone().try_inverse()?;
    let mut ratio = (&inverse * covariance * inverse.transpose()).symmetric_eigen();
    ratio.eigenvalues.iter_mut().for_each(|value| *value = value.max(1.0));
    Some(&root * ratio.recompose() * root.transpose())
}

#[cfg(test)]
mod tests {
    use super::super::linearised::{Linearised, REWEIGHTING_TOLERANCE, robust_step};
    use super::super::state::{EdgeBias, FramePrior, State};
    use super::*;
    use crate::measure::body::{Outline, Piece};
    use crate::measure::fixture::Scene;
    use crate::robot::{BendProfile, MODES};
    use crate::statistics::moments::mean;
    use approx::assert_relative_eq;
    use nalgebra::{Vector2, Vector3};
    use proptest::prelude::*;
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, Normal};
    use std::collections::BTreeMap;

    const SIGMA_PX: f64 = 0.2;

    fn covariance_of(a: f64, b: f64, c: f64) -> DMatrix<f64> {
        let root = DMatrix::from_row_slice(2, 2, &[a, 0.0, b, c]);
        &root * root.transpose()
    }

    proptest! {
        #[test]
        fn a_widened_covariance_is_no_less_than_either(
            (a, b, c) in (0.01..10.0, -10.0..10.0, 0.01..10.0),
            (d, e, f) in (0.01..10.0, -10.0..10.0, 0.01..10.0),
        ) {
            let (covariance, least) = (covariance_of(a, b, c), covariance_of(d, e, f));
            let widened = at_least(&covariance, &least).unwrap();
            let rounding = 1e-9 * widened.trace().powi(2) / least.determinant().sqrt();
            prop_assert!((&widened - covariance).symmetric_eigenvalues().min() > -rounding);
            prop_assert!((&widened - least).symmetric_eigenvalues().min() > -rounding);
        }
    }

    #[test]
    fn a_covariance_is_widened_only_where_it_says_less() {
        let covariance = DMatrix::from_diagonal(&DVector::from_column_slice(&[4.0, 0.1]));
        let widened = at_least(&covariance, &DMatrix::identity(2, 2)).unwrap();
        assert_relative_eq!(widened, DMatrix::from_diagonal(&DVector::from_column_slice(&[4.0, 1.0])), epsilon = 1e-12);
    }

    #[test]
    fn outliers_go_on_pulling_in_the_monotone_phase_only() {
        // Residuals of ±1, whose scale is 1.48, and one far off.
        let mut residuals: Vec<f64> = (0..20).map(|k| if k % 2 == 0 { 1.0 } else { -1.0 }).collect();
        residuals.push(50.0);
        let (monotone, redescending) =
            (RobustPhase::Monotone.roots(&residuals), RobustPhase::Redescending.roots(&residuals));
        assert_relative_eq!(monotone[20].powi(2), 1.345 * 1.482_602 / 50.0, max_relative = 1e-6);
        assert_eq!(redescending[20], 0.0);
        assert_eq!(monotone[0], 1.0);
        assert_relative_eq!(redescending[0], 1.0 - (1.0 / (4.685 * 1.482_602_f64)).powi(2), max_relative = 1e-6);
        assert_eq!(inliers(&residuals, &redescending), (20, 1.0));
    }

    #[test]
    fn what_scatters_more_than_it_may_is_told_by_its_mean_square_and_the_rest_is_taken_at_its_word() {
        let weighted = |distance: f64, root: f64| vec![distance * root; 6];
        assert_relative_eq!(excess(&weighted(2.0, 0.8), &[0.8; 6]), 4.0, epsilon = 1e-12);
        assert_eq!(excess(&weighted(0.3, 0.8), &[0.8; 6]), 1.0);
        // An outlier tells nothing.
        assert_relative_eq!(excess(&[2.0, -2.0, 9.0], &[1.0, 1.0, 0.1]), 4.0, epsilon = 1e-12);
        let mut random = StdRng::seed_from_u64(3);
        let noise = Normal::new(0.0, 3.0).unwrap();
        let drawn: Vec<f64> = (0..2000).map(|_| noise.sample(&mut random)).collect();
        let roots = RobustPhase::Redescending.roots(&drawn);
        let weighted: Vec<f64> = drawn.iter().zip(&roots).map(|(r, root)| r * root).collect();
        // A variance of nine; the few of a normal distribution that are no inliers lie beyond 3.3 σ, and a variance of 2000 scatters by 3 %.
        assert!((excess(&weighted, &roots) / 9.0 - 1.0).abs() < 0.1);
    }

    /// Fits to edges that are displaced by what `draw` gives for an outline: for each of 200 fits the squared errors of the bend in
    /// units of the independent and of the clustered covariance, whose means are 2 if these are the errors' covariances.
    fn squared_normalised_errors(mut draw: impl FnMut(&Outline) -> Vec<f64>) -> [f64; 2] {
        let scene = Scene::new(Vector3::new(0.05, -0.1, 0.0));
        let view = scene.view();
        let state = State { profile: BendProfile::arc(Vector2::new(0.6, 0.4)), bias: EdgeBias::default() };
        let outline = Outline::spaced(&view, state.profile, 4.0);
        // Of a snake that is an arc for certain, as the one that is drawn.
        let prior = FramePrior { mode_sigma_rad: [1e-7; MODES], ..FramePrior::FIXTURE };
        let squares: Vec<[f64; 2]> = (0..200)
            .map(|_| {
                let edges = Correspondences::displaced(&outline, &draw(&outline), SIGMA_PX);
                let (step, roots) =
                    robust_step(&edges, &view, &state, &prior, RobustPhase::Redescending, REWEIGHTING_TOLERANCE)
                        .unwrap();
                let fitted = state.moved(&step);
                let linear = Linearised::new(&edges, &view, &fitted, &roots, Some(&prior));
                let (jacobian, residuals) = (&linear.by_state, &linear.residuals);
                let covariance = FitCovariance::new(&edges, jacobian, residuals, &view, &roots, SIGMA_PX).unwrap();
                let error = fitted.profile.tip - state.profile.tip;
                [covariance.independent, covariance.clustered].map(|covariance| {
                    let of_bend = covariance.fixed_view::<2, 2>(0, 0).into_owned();
                    error.dot(&(of_bend.try_inverse().unwrap() * error))
                })
            })
            .collect();
        [0, 1].map(|k| mean(squares.iter().map(|square| square[k])))
    }

    #[test]
    fn fits_to_independent_edges_scatter_as_the_independent_covariance_says() {
        let mut random = StdRng::seed_from_u64(1);
        let noise = Normal::new(0.0, SIGMA_PX).unwrap();
        let [independent, _] =
            squared_normalised_errors(|outline| outline.points.iter().map(|_| noise.sample(&mut random)).collect());
        // The mean of 200 χ² of two degrees of freedom scatters by 0.14. Tukey's weights are less than 1, 0.91 in the mean of normal
        // errors, but the estimate loses only 5 % of the information: 1.9 is expected.
        assert!((1.5..2.4).contains(&independent), "{independent}");
    }

    #[test]
    fn edges_that_err_alike_along_each_piece_are_described_better_by_the_clustered_covariance() {
        let mut random = StdRng::seed_from_u64(2);
        let noise = Normal::new(0.0, SIGMA_PX / 2.0_f64.sqrt()).unwrap();
        let [independent, clustered] = squared_normalised_errors(|outline| {
            let mut shared: BTreeMap<Piece, f64> = BTreeMap::new();
            let of_point = |piece: Piece| {
                let shared = *shared.entry(piece.cluster()).or_insert_with(|| noise.sample(&mut random));
                shared + noise.sample(&mut random)
            };
            outline.points.iter().map(|point| point.piece).map(of_point).collect()
        });
        assert!(independent > 6.0, "{independent}");
        // 2 is the mean for a known covariance; one estimated from some thirty clusters of unequal weight has heavier tails, 3.3 here.
        assert!((1.4..3.8).contains(&clustered), "{clustered}");
    }
}
