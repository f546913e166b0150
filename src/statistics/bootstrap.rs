//! The bootstrap over blocks: what a statistic would have been if other blocks had been drawn.
//!
//! Blocks of data that are independent of each other (sweeps, rigs, sequences) are drawn with replacement, as many as there are. Errors
//! that last within a block stay together.
//!
//! Source: B. Efron, R. J. Tibshirani, *An Introduction to the Bootstrap*, Chapman & Hall 1993, ch. 6 and 8.6.

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// How often each of `blocks` blocks counts, in each of `draws` resamplings with a seed.
pub fn block_counts(blocks: usize, draws: usize, seed: u64) -> impl Iterator<Item = Vec<f64>> {
    let mut random = StdRng::seed_from_u64(seed);
    (0..draws).map(move |_| {
        let mut counts = vec![0.0; blocks];
        for _ in 0..blocks {
            counts[random.random_range(0..blocks)] += 1.0;
        }
        counts
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::moments::standard_deviation;

    #[test]
    fn the_bootstrap_of_a_mean_has_the_plug_in_standard_error() {
        // Efron and Tibshirani, table 2.1, the nine control mice: the mean's standard error √(Σ(x − x̄)²/(n(n − 1))) is 14.14 (printed);
        // the bootstrap's has n² in place of n(n − 1).
        let mice = [52.0, 104.0, 146.0, 10.0, 50.0, 31.0, 40.0, 27.0, 46.0];
        let means: Vec<f64> = block_counts(9, 20_000, 4)
            .map(|counts| counts.iter().zip(mice).map(|(count, value)| count * value).sum::<f64>() / 9.0)
            .collect();
        let expected = standard_deviation(&mice) / 3.0;
        assert!((expected * (9.0f64 / 8.0).sqrt() - 14.14).abs() < 0.01, "{expected}");
        assert!((standard_deviation(&means) / expected - 1.0).abs() < 0.02);
    }

    #[test]
    fn each_resampling_has_as_many_blocks_and_a_seed_repeats_it() {
        let drawn: Vec<_> = block_counts(7, 50, 1).collect();
        assert!(drawn.iter().all(|counts| counts.iter().sum::<f64>() == 7.0));
        assert_eq!(drawn, block_counts(7, 50, 1).collect::<Vec<_>>());
        assert_ne!(drawn, block_counts(7, 50, 2).collect::<Vec<_>>());
    }
}
