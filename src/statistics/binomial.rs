//! The exact binomial test: whether something happens more often than with a given probability.
//!
//! ```text
//! P(X ≥ k) = Σ_{j ≥ k} C(n, j) pʲ (1 − p)ⁿ⁻ʲ
//! ```
//!
//! With p = ½ it is the sign test of a median (J. Arbuthnot 1710; W. J. Conover, *Practical Nonparametric Statistics*, 3rd ed., Wiley
//! 1999, ch. 3), which no outlier can move.

/// The probability that of `trials` independent events with probability `p` at least `successes` happen.
pub fn at_least(successes: usize, trials: usize, p: f64) -> f64 {
    if successes == 0 || p >= 1.0 {
        return 1.0;
    }
    if successes > trials || p <= 0.0 {
        return 0.0;
    }
    let odds = (p / (1.0 - p)).ln();
    let mut log_term = trials as f64 * (1.0 - p).ln();
    let mut sum = 0.0;
    for j in 0..=trials {
        if j > 0 {
            log_term += ((trials - j + 1) as f64 / j as f64).ln() + odds;
        }
        if j >= successes {
            sum += log_term.exp();
        }
    }
    sum.min(1.0)
}

#[cfg(test)]
mod tests {
    use super::at_least;

    #[test]
    fn tails_are_the_closed_forms_and_published_ones() {
        assert!((at_least(17, 17, 0.5) - 0.5f64.powi(17)).abs() < 1e-18);
        assert!((at_least(1, 20, 0.1) - (1.0 - 0.9f64.powi(20))).abs() < 1e-12);
        // Fisher's lady tasting tea with independent cups, at least 7 of 8: 9/256.
        assert!((at_least(7, 8, 0.5) - 9.0 / 256.0).abs() < 1e-12);
        // Of very many trials it is the normal tail: Φ(−3.0) = 0.00135, with the continuity correction at 50 000 + 474.8.
        assert!((at_least(50_475, 100_000, 0.5) - 0.001_35).abs() < 2e-5);
        assert_eq!((at_least(0, 5, 0.3), at_least(6, 5, 0.3), at_least(1, 5, 0.0)), (1.0, 0.0, 0.0));
    }
}
