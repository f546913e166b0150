//! How far this snake departs from an arc, learned from the frames of a sequence (empirical Bayes).
//!
//! Fits under a prior for any snake leave of every frame the modes a_k of its [`BendProfile`](crate::robot::BendProfile) with a covariance.
//! Each component of a_k is taken to be normal about zero with one standard deviation σ_k for the sequence, so that what was fitted
//! has the variance σ_k² + P. A snake that is an arc then gets a narrow prior, and its angles keep the precision that an arc has;
//! another one keeps the freedom that it needs.
//!
//! With few frames σ_k is not well known, and its most likely value is often zero. The mean of σ_k² over its posterior, with a
//! uniform prior of σ_k, is used instead: it stays above zero by as much as the frames leave open.
//!
//! Source: A. Gelman, "Prior distributions for variance parameters in hierarchical models", Bayesian Analysis 1, 2006, for the uniform
//! prior of a standard deviation.

use super::bend::BendFit;
use crate::robot::MODES;
use nalgebra::Matrix6;

/// Standard deviations of the modes before any frame was seen, rad.
///
/// Convention: 0.3° of a_1, half and a quarter of that of the others: far more than the 0.05° to which a picture in good view tells a_1, so
/// that frames of any snake show what it needs; and little enough that a snake is nearly an arc where the picture tells nothing, at small
/// bends and along the line of sight.
pub const UNKNOWN_SHAPE_RAD: [f64; MODES] = [0.005, 0.0025, 0.00125];
/// Steps in which σ_k is tried, in units of the one before, ...
///
/// Convention: numerical; the likelihood changes little over a tenth.
const STEP: f64 = 1.1;
/// ... and the least, rad.
///
/// Convention: numerical; no picture tells a mode of a thousandth of a degree from none.
const LEAST_RAD: f64 = 2e-5;

/// The largest σ_k that is tried, in units of that before any frame was seen.
///
/// Convention: 6° of a_1, a curvature that varies by 40 % along a snake bent by 60°.
pub(super) const LARGEST_SHAPE: f64 = 20.0;

/// σ_k of each mode, rad, from fits under the prior [`UNKNOWN_SHAPE_RAD`] in frames of one sequence, whose rig has a pose of this
/// covariance.
pub(crate) fn learned_mode_sigmas(fits: &[BendFit], pose_covariance: &Matrix6<f64>) -> [f64; MODES] {
    let of_fit = |fit: &BendFit| {
        let covariance = fit.covariance + fit.by_pose * pose_covariance * fit.by_pose.transpose();
        let modes = fit.profile.to_array();
        move |number: usize| (modes[number], covariance[(number, number)])
    };
    std::array::from_fn(|k| {
        let components = fits.iter().map(of_fit).flat_map(|of| [2 + 2 * k, 3 + 2 * k].map(of));
        posterior_sigma(&components.collect::<Vec<_>>(), UNKNOWN_SHAPE_RAD[k])
    })
}

/// The root of the posterior mean of σ² for values that are normal with the variance σ² + P, given as pairs (value, P); σ lies
/// between [`LEAST_RAD`] and twenty times the `prior`.
fn posterior_sigma(values: &[(f64, f64)], prior: f64) -> f64 {
    let sigmas: Vec<f64> = std::iter::successors(Some(LEAST_RAD), |sigma| Some(sigma * STEP))
        .take_while(|s| *s <= LARGEST_SHAPE * prior)
        .collect();
    let log_likelihood = |sigma: f64| -> f64 {
        let of_value = |&(value, variance): &(f64, f64)| {
            let total = sigma * sigma + variance;
            -0.5 * (total.ln() + value * value / total)
        };
        values.iter().map(of_value).sum()
    };
    let logs: Vec<f64> = sigmas.iter().map(|&sigma| log_likelihood(sigma)).collect();
    let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    // A uniform density of σ gives each of the geometric steps a weight in proportion to σ.
    let weights: Vec<f64> = logs.iter().zip(&sigmas).map(|(log, sigma)| sigma * (log - most).exp()).collect();
    let mean = weights.iter().zip(&sigmas).map(|(weight, sigma)| weight * sigma * sigma).sum::<f64>();
    (mean / weights.iter().sum::<f64>()).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, Normal};

    fn drawn(sigma: f64, error: f64, count: usize, seed: u64) -> Vec<(f64, f64)> {
        let mut random = StdRng::seed_from_u64(seed);
        let noise = Normal::new(0.0, sigma.hypot(error)).unwrap();
        (0..count).map(|_| (noise.sample(&mut random), error * error)).collect()
    }

    #[test]
    fn what_is_well_measured_gives_its_own_scatter() {
        let values = drawn(0.01, 1e-4, 400, 1);
        let rms = (values.iter().map(|(value, _)| value * value).sum::<f64>() / 400.0).sqrt();
        // Of n normal values the posterior mean of σ² is n/(n − 3) times their mean square.
        let expected = rms * (400.0 / 397.0_f64).sqrt();
        assert!((posterior_sigma(&values, 0.05) / expected - 1.0).abs() < 1e-3);
    }

    #[test]
    fn an_arc_gets_a_prior_narrower_than_what_one_frame_tells_and_never_none() {
        for (count, most) in [(10, 1.6), (48, 0.9)] {
            for seed in 0..20 {
                let sigma = posterior_sigma(&drawn(0.0, 1e-3, count, seed), 0.05);
                assert!((1e-4..most * 1e-3).contains(&sigma), "{count} values: {sigma}");
            }
        }
    }

    #[test]
    fn the_prior_holds_whatever_the_snake() {
        // The mean of σ̂² over sequences is not below σ².
        for sigma in [3e-4, 1e-3, 1e-2] {
            let squares = (0..200).map(|seed| posterior_sigma(&drawn(sigma, 1e-3, 16, seed), 0.05).powi(2));
            let mean = squares.sum::<f64>() / 200.0;
            assert!(mean > sigma * sigma, "{sigma}: {}", mean.sqrt());
        }
    }
}
