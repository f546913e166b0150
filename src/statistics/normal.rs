//! Quantiles of the standard normal distribution.

/// The value that a standard normal variable exceeds with probability p, of 0 to ½:
///
/// ```text
/// t − (c₀ + c₁ t + c₂ t²)/(1 + d₁ t + d₂ t² + d₃ t³),        t = √(−2 ln p)
/// ```
///
/// Within 4.5e-4.
///
/// Source: M. Abramowitz, I. A. Stegun, *Handbook of Mathematical Functions*, National Bureau of Standards 1964, 26.2.23.
pub fn upper_quantile(p: f64) -> f64 {
    let t = (-2.0 * p.ln()).sqrt();
    let above = 2.515_517 + t * (0.802_853 + t * 0.010_328);
    t - above / (1.0 + t * (1.432_788 + t * (0.189_269 + t * 0.001_308)))
}

#[cfg(test)]
mod tests {
    use super::upper_quantile;

    #[test]
    fn quantiles_are_the_tabulated_ones() {
        // Any table of the normal distribution.
        for (p, tabulated) in [(0.5, 0.0), (0.1, 1.281_552), (0.01, 2.326_348), (0.001, 3.090_232), (1e-5, 4.264_891)] {
            assert!((upper_quantile(p) - tabulated).abs() < 4.5e-4, "{p}: {}", upper_quantile(p));
        }
    }
}
