//! Order statistics: median, MAD and quantiles.

use std::cmp::Ordering;

/// The standard deviation of a normal variable over its median absolute deviation, 1/Φ⁻¹(¾).
///
/// Derived: Φ⁻¹(0.75) = 0.674 490.
pub const SD_BY_MAD: f64 = 1.482_602_218_505_602;

/// A number that can be put in order: `f32` and `f64`.
pub trait Ordered: Copy + Default {
    /// The total order of IEEE 754, in which NaN has a place too.
    fn order(&self, other: &Self) -> Ordering;
}

impl Ordered for f32 {
    fn order(&self, other: &Self) -> Ordering {
        self.total_cmp(other)
    }
}

impl Ordered for f64 {
    fn order(&self, other: &Self) -> Ordering {
        self.total_cmp(other)
    }
}

/// The median of some values, which it reorders; 0 of nothing. Of an even number of values it is the upper of the two in the
/// middle, so that it always is one of the values.
pub fn median<T: Ordered>(values: &mut [T]) -> T {
    let middle = values.len() / 2;
    if values.is_empty() { T::default() } else { *values.select_nth_unstable_by(middle, T::order).1 }
}

/// The value that a share `level` (0 to 1) of the values lie below, by linear interpolation between neighbours; reorders the
/// values. 0 of nothing.
///
/// Source: R. J. Hyndman, Y. Fan, "Sample Quantiles in Statistical Packages", The American Statistician 50, 1996, definition 7
/// (that of R and NumPy).
pub fn quantile(values: &mut [f64], level: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    values.sort_unstable_by(f64::total_cmp);
    let place = level.clamp(0.0, 1.0) * (values.len() - 1) as f64;
    let (below, share) = (place.floor() as usize, place.fract());
    let above = (below + 1).min(values.len() - 1);
    values[below] + share * (values[above] - values[below])
}

/// The standard deviation that the median absolute value of centred errors implies, [`SD_BY_MAD`] · median |x|: half of the
/// values may be anything without spoiling it.
///
/// Source: P. J. Rousseeuw, C. Croux, "Alternatives to the Median Absolute Deviation", J. Am. Stat. Assoc. 88, 1993, Eq. 1.1.
pub fn mad_scale(errors: impl IntoIterator<Item = f64>) -> f64 {
    let mut sizes: Vec<f64> = errors.into_iter().map(f64::abs).collect();
    SD_BY_MAD * median(&mut sizes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn the_median_is_the_middle_and_of_an_even_number_the_upper() {
        assert_eq!(median(&mut [5.0, 1.0, 3.0]), 3.0);
        assert_eq!(median(&mut [4.0f32, 1.0, 3.0, 2.0]), 3.0);
        assert_eq!(median::<f64>(&mut []), 0.0);
        assert_eq!(median(&mut [f64::NAN, 2.0, 1.0]), 2.0, "NaN lies beyond all numbers");
    }

    #[test]
    fn quantiles_are_those_of_hyndman_and_fans_seventh_definition() {
        // R: quantile(c(1, 2, 4, 8, 16), c(0, 0.1, 0.5, 0.9, 1), type = 7).
        let mut values = [16.0, 1.0, 4.0, 2.0, 8.0];
        for (level, expected) in [(0.0, 1.0), (0.1, 1.4), (0.5, 4.0), (0.9, 12.8), (1.0, 16.0)] {
            assert!((quantile(&mut values, level) - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn the_scale_by_the_mad_is_the_standard_deviation_of_normal_errors_and_outliers_hardly_move_it() {
        let mut random = rand::rngs::StdRng::seed_from_u64(1);
        let mut errors: Vec<f64> =
            (0..40_000).map(|_| 3.0 * Distribution::<f64>::sample(&StandardNormal, &mut random)).collect();
        // Its standard error is 1.17 σ/√n (Rousseeuw and Croux), 0.6 % of σ here.
        assert!((mad_scale(errors.iter().copied()) / 3.0 - 1.0).abs() < 0.02);
        errors.iter_mut().take(4000).for_each(|error| *error = 1e6);
        // With a tenth of outliers it is the 5/9 quantile of |x|, 0.7647 σ: 1.134 σ.
        assert!((mad_scale(errors) / 3.0 - 1.134).abs() < 0.025);
    }
}
