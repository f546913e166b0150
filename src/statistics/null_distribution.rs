//! The distribution of a statistic where the null hypothesis holds, from simulated draws, and its quantiles.
//!
//! A statistic that is the best of many has no table of quantiles; it is drawn on noise alone, and a threshold that noise exceeds
//! with a given probability is read off the draws.

use super::moments::{mean, standard_deviation};
use super::order::quantile;
use std::f64::consts::PI;

/// The Euler–Mascheroni constant, the mean of the standard Gumbel distribution.
///
/// Source: Gumbel 1958, ch. 5.
const EULER_GAMMA: f64 = 0.577_215_664_901_532_9;

/// A statistic drawn under the null hypothesis.
#[derive(Debug, Clone, PartialEq)]
pub struct NullDistribution {
    draws: Vec<f64>,
}

impl NullDistribution {
    /// Of these draws.
    pub fn new(draws: Vec<f64>) -> Self {
        Self { draws }
    }

    /// The value that a share `level` of the draws lie below. Good for levels with at least ten draws beyond them.
    pub fn quantile(&self, level: f64) -> f64 {
        quantile(&mut self.draws.clone(), level)
    }

    /// The same for a statistic that is the largest of many, and for levels that the draws do not reach: that of Gumbel's
    /// distribution with the draws' mean m and standard deviation s,
    ///
    /// ```text
    /// m − γ b − b ln(−ln level),        b = s √6/π.
    /// ```
    ///
    /// Source: E. J. Gumbel, *Statistics of Extremes*, Columbia University Press 1958, ch. 5 and 6 (estimation by moments).
    pub fn gumbel_quantile(&self, level: f64) -> f64 {
        let scale = standard_deviation(&self.draws) * 6f64.sqrt() / PI;
        mean(self.draws.iter().copied()) - scale * (EULER_GAMMA + (-level.ln()).ln())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    /// The largest of n exponential variables: P(x) = (1 − e⁻ˣ)ⁿ, so the quantile is −ln(1 − level^{1/n}).
    fn largest_of(count: usize, draws: usize) -> NullDistribution {
        let mut random = StdRng::seed_from_u64(5);
        let mut exponential = || -(1.0 - random.random::<f64>()).ln();
        NullDistribution::new((0..draws).map(|_| (0..count).map(|_| exponential()).fold(0.0, f64::max)).collect())
    }

    #[test]
    fn quantiles_of_the_largest_of_many_are_the_closed_form() {
        let drawn = largest_of(200, 4000);
        let exact = |level: f64| -(1.0 - level.powf(1.0 / 200.0)).ln();
        for level in [0.5, 0.9, 0.99] {
            assert!((drawn.quantile(level) - exact(level)).abs() < 0.25, "{level}");
            assert!((drawn.gumbel_quantile(level) - exact(level)).abs() < 0.25, "{level}");
        }
        // Two hundred draws do not reach one in a thousand; Gumbel's tail does.
        let few = largest_of(200, 200);
        assert!((few.gumbel_quantile(0.999) - exact(0.999)).abs() < 1.2, "{}", few.gumbel_quantile(0.999));
    }
}
