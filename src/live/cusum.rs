//! Page's cumulative sum test (CUSUM): whether a series of values has begun to follow another distribution, and whether it has
//! stopped to.
//!
//! With ℓₙ the logarithm of the n-th value's probability after the change over that before it, the sum
//!
//! ```text
//! S₀ = 0,   Sₙ = max(0, Sₙ₋₁ + ℓₙ)
//! ```
//!
//! passes a limit h soon after the change and seldom before (E. S. Page, Continuous inspection schemes, Biometrika 41, 1954,
//! 100–115). After that the same sum of −ℓₙ looks for the way back.
//!
//! **Limit.** h = ln γ makes the mean number of values between two false alarms at least γ, whatever the two distributions are
//! (G. Lorden, Procedures for reacting to a change in distribution, Annals of Mathematical Statistics 42, 1971, 1897–1908).
//! **Delay.** After the change an alarm takes about (h + overshoot) / I values, with I the mean of ℓₙ then, the Kullback–Leibler
//! divergence.

/// A test for a change and its end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cusum {
    limit: f64,
    sum: f64,
    changed: bool,
}

impl Cusum {
    /// A test that gives a false alarm at most once in so many independent values, in the mean; and as seldom takes a change for over.
    pub fn new(values_between_false_alarms: f64) -> Self {
        Self { limit: values_between_false_alarms.ln(), sum: 0.0, changed: false }
    }

    /// Takes the log-likelihood ratio of the next value: changed over unchanged.
    pub fn add(&mut self, log_likelihood_ratio: f64) {
        let towards_other = if self.changed { -log_likelihood_ratio } else { log_likelihood_ratio };
        self.sum = (self.sum + towards_other).max(0.0);
        if self.sum > self.limit {
            self.changed = !self.changed;
            self.sum = 0.0;
        }
    }

    /// Whether the values follow the other distribution.
    pub fn is_changed(&self) -> bool {
        self.changed
    }
}

/// ln p₁/p₀ of a sum of `degrees_of_freedom` squared normal values: variance `ratio` after the change, 1 before.
pub fn variance_log_ratio(sum_of_squares: f64, degrees_of_freedom: f64, ratio: f64) -> f64 {
    0.5 * (sum_of_squares * (1.0 - 1.0 / ratio) - degrees_of_freedom * ratio.ln())
}

/// ln p₁/p₀ of an event that happens with probability `p1` after the change and `p0` before.
pub fn event_log_ratio(happened: bool, p0: f64, p1: f64) -> f64 {
    if happened { (p1 / p0).ln() } else { ((1.0 - p1) / (1.0 - p0)).ln() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};
    use rand_distr::{Distribution, StandardNormal};

    const RATIO: f64 = 2.5;

    /// Mean number of values until the sum passes its limit, by Monte-Carlo, with its standard error.
    fn simulated(limit: f64, runs: u32, mut log_ratio: impl FnMut(&mut StdRng) -> f64) -> (f64, f64) {
        let mut random = StdRng::seed_from_u64(7);
        let lengths: Vec<f64> = (0..runs)
            .map(|_| {
                let mut cusum = Cusum { limit, sum: 0.0, changed: false };
                let mut length = 0.0;
                while !cusum.is_changed() {
                    cusum.add(log_ratio(&mut random));
                    length += 1.0;
                }
                length
            })
            .collect();
        let mean = lengths.iter().sum::<f64>() / f64::from(runs);
        let variance = lengths.iter().map(|length| (length - mean).powi(2)).sum::<f64>() / f64::from(runs - 1);
        (mean, (variance / f64::from(runs)).sqrt())
    }

    /// Squares of `N` normal values of a variance, as their log-likelihood ratio.
    fn squares<const N: usize>(variance: f64) -> impl FnMut(&mut StdRng) -> f64 {
        move |random| {
            let normal = |random: &mut StdRng| -> f64 { StandardNormal.sample(random) };
            let squares: f64 = (0..N).map(|_| variance * normal(random).powi(2)).sum();
            variance_log_ratio(squares, N as f64, RATIO)
        }
    }

    /// The same mean by the Markov chain of Brook and Evans (Biometrika 59, 1972, 539–549), for two degrees of freedom, where the
    /// squares are exponentially distributed.
    fn by_markov_chain(limit: f64, variance: f64) -> f64 {
        const STATES: usize = 400;
        let width = 2.0 * limit / (2 * STATES - 1) as f64;
        // Probability that ℓ is at most this.
        let below = |log_ratio: f64| {
            let squares = (2.0 * log_ratio + 2.0 * RATIO.ln()) / (1.0 - 1.0 / RATIO);
            1.0 - (-squares.max(0.0) / (2.0 * variance)).exp()
        };
        let chain = DMatrix::from_fn(STATES, STATES, |from, to| {
            let step = to as f64 - from as f64;
            let least = if to == 0 { 0.0 } else { below((step - 0.5) * width) };
            below((step + 0.5) * width) - least
        });
        let lengths = (DMatrix::identity(STATES, STATES) - chain).lu().solve(&DVector::repeat(STATES, 1.0)).unwrap();
        lengths[0]
    }

    #[test]
    fn false_alarms_are_no_more_frequent_than_was_asked_and_as_frequent_as_the_markov_chain_says() {
        for between in [30.0_f64, 300.0] {
            let limit = between.ln();
            let (mean, se) = simulated(limit, 2000, squares::<2>(1.0));
            let expected = by_markov_chain(limit, 1.0);
            assert!((mean - expected).abs() < 4.0 * se, "{mean} ± {se}, expected {expected}");
            assert!(mean > between, "Lorden's bound: {mean} for {between}");
            let (mean, _) = simulated(limit, 2000, squares::<1>(1.0));
            assert!(mean > between, "{mean} for {between}");
            let rejected = |random: &mut StdRng| event_log_ratio(random.random_bool(0.1), 0.1, 0.3);
            let (mean, _) = simulated(limit, 2000, rejected);
            assert!(mean > between, "{mean} for {between}");
            let back = |random: &mut StdRng| -squares::<2>(RATIO)(random);
            let (mean, _) = simulated(limit, 2000, back);
            assert!(mean > between, "way back: {mean} for {between}");
        }
    }

    #[test]
    fn the_delay_is_what_the_divergence_and_the_markov_chain_say() {
        let limit = 1e6_f64.ln();
        let (mean, se) = simulated(limit, 2000, squares::<2>(RATIO));
        let expected = by_markov_chain(limit, RATIO);
        assert!((mean - expected).abs() < 4.0 * se, "{mean} ± {se}, expected {expected}");
        // The sum begins at 0 and cannot fall below, and it overshoots: together a few values.
        let divergence = RATIO - 1.0 - RATIO.ln();
        assert!((mean - limit / divergence).abs() < 5.0, "{mean}, {}", limit / divergence);
        assert!(by_markov_chain(limit, 1.0) > 1e7);
    }

    /// The figures that gap_monitor.rs states of its three tests.
    #[test]
    fn the_design_figures_are_those_that_are_stated() {
        let limit = 1e6_f64.ln();
        let rejections = |random: &mut StdRng| event_log_ratio(random.random_bool(0.3), 0.1, 0.3);
        let back = |random: &mut StdRng| -squares::<2>(1.0)(random);
        let back_of_one = |random: &mut StdRng| -squares::<1>(1.0)(random);
        for (stated, (mean, se)) in [
            (25.0, simulated(limit, 2000, squares::<2>(2.5))),
            (49.0, simulated(limit, 2000, squares::<1>(2.5))),
            (88.0, simulated(limit, 2000, rejections)),
            (11.0, simulated(limit, 2000, squares::<2>(4.0))),
            (43.0, simulated(limit, 2000, back)),
            (86.0, simulated(limit, 2000, back_of_one)),
        ] {
            assert!((mean - stated).abs() < 4.0 * se + 0.5, "{mean} ± {se}, stated {stated}");
        }
    }

    #[test]
    fn a_change_and_its_end_are_both_found() {
        let mut random = StdRng::seed_from_u64(3);
        let mut cusum = Cusum::new(1e6);
        let mut after = |variance: f64, values: usize| {
            (0..values).for_each(|_| cusum.add(squares::<2>(variance)(&mut random)));
            cusum.is_changed()
        };
        assert!(!after(1.0, 2000));
        assert!(after(RATIO, 200));
        assert!(after(RATIO, 2000));
        assert!(!after(1.0, 300));
    }
}
