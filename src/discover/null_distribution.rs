//! The null distribution of the search: what the best of all hypotheses gains where there is nothing but noise.
//!
//! Many hypotheses are tried, so the best gains more than one alone would. On noise, the squares that a hypothesis explains are
//! those of the noise's projection on its tangent space. Unit noise is drawn, the largest gain over all hypotheses is taken, and
//! Gumbel's distribution of largest values is fitted to its draws by moments.

use super::tangent_spaces::TangentSpace;
use crate::statistics::null_distribution::NullDistribution;
use nalgebra::DMatrix;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rayon::prelude::*;

/// The share of experiments without any missing effect in which the search may name one.
///
/// Convention: the level of the test.
pub const LEVEL: f64 = 0.01;

/// Draws of noise.
///
/// Derived: the quantile at 1 % that moments give then has a standard error of 0.28 standard deviations of the largest gain.
const DRAWS: usize = 200;

/// The gain in the Bayesian information criterion that the best hypothesis exceeds in a share [`LEVEL`] of experiments of pure
/// noise on these poses and times; 0 where it is negative. The logarithm of the noise's standard deviation is known to within `ln_sd`: of few
/// samples it may have been learned too small, and all gains be as much too large.
pub fn largest_gain_of_noise(spaces: &[TangentSpace], ln_sd: f64) -> f64 {
    let Some(first) = spaces.first() else { return 0.0 };
    let mut random = StdRng::seed_from_u64(2);
    let noise = DMatrix::from_fn(DRAWS, first.columns.nrows(), |_, _| random.sample::<f64, _>(StandardNormal));
    let scales: Vec<f64> = (0..DRAWS).map(|_| (2.0 * ln_sd * random.sample::<f64, _>(StandardNormal)).exp()).collect();
    let projections: Vec<DMatrix<f64>> = spaces.par_iter().map(|space| &noise * space.orthonormal_basis()).collect();
    let largest: Vec<f64> = (0..DRAWS)
        .map(|draw| {
            let gains = projections.iter().zip(spaces);
            let gains =
                gains.map(|(projection, space)| scales[draw] * projection.row(draw).norm_squared() - space.penalty);
            gains.fold(f64::NEG_INFINITY, f64::max)
        })
        .collect();
    NullDistribution::new(largest).gumbel_quantile(1.0 - LEVEL).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Spaces that are single coordinate axes: their gains are independent χ² of one degree of freedom.
    fn axes(count: usize, penalty: f64) -> Vec<TangentSpace> {
        let axis = |k: usize| DMatrix::from_fn(count, 1, |row, _| f64::from(u8::from(row == k)));
        (0..count).map(|k| TangentSpace { physics: None, penalty, columns: axis(k), remaining: axis(k) }).collect()
    }

    #[test]
    fn the_quantile_of_many_independent_hypotheses_is_that_of_the_largest_of_so_many_chi_squares() {
        // P(largest of 50 ≤ x) = P(χ²₁ ≤ x)^50 = 0.99 where P(χ²₁ ≤ x) = 0.999799, x = 13.81.
        let quantile = largest_gain_of_noise(&axes(50, 0.0), 0.0);
        // Moments of 200 draws: ± 0.28 · 2.4, and χ² is not quite Gumbel's at 50.
        assert!((quantile - 13.81).abs() < 2.0, "{quantile}");
        let charged = largest_gain_of_noise(&axes(50, 7.0), 0.0);
        assert!((quantile - 7.0 - charged).abs() < 1e-9);
    }

    #[test]
    fn nothing_is_gained_of_what_costs_more_or_of_no_hypothesis() {
        assert_eq!(largest_gain_of_noise(&axes(5, 100.0), 0.0), 0.0);
        assert_eq!(largest_gain_of_noise(&[], 0.0), 0.0);
    }
}
