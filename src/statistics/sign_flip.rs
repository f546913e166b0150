//! The sign-flip test: whether paired differences of blocks have a mean above zero.
//!
//! Where nothing was gained, each block's gain may as well have the other sign. The p-value is the share of random assignments of
//! signs whose mean is at least the observed one, the observed one among them.
//!
//! Source: R. A. Fisher, *The Design of Experiments*, Oliver & Boyd 1935, section 21; B. Phipson, G. K. Smyth, "Permutation P-values
//! should never be zero", Stat. Appl. Genet. Mol. Biol. 9, 2010, for the count of the observed assignment.

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Random assignments of signs.
///
/// Derived: a p-value of 0.01 then has a standard error of 0.001.
const DRAWS: usize = 10_000;

/// The one-sided p-value of gains, seeded.
pub fn sign_flip_test(gains: &[f64], seed: u64) -> f64 {
    let observed: f64 = gains.iter().sum();
    let mut random = StdRng::seed_from_u64(seed);
    let mut flipped = || gains.iter().map(|gain| if random.random_bool(0.5) { *gain } else { -gain }).sum::<f64>();
    let as_large = (0..DRAWS).filter(|_| flipped() >= observed).count();
    (as_large + 1) as f64 / (DRAWS + 1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gains_all_of_one_sign_have_the_p_value_of_one_assignment_in_two_to_the_n() {
        let p = sign_flip_test(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], 1);
        // Of 64 assignments one is as large; its standard error is √(1/64 · 63/64 / 10 000) = 0.0012.
        assert!((p - 1.0 / 64.0).abs() < 0.005, "{p}");
        assert!(sign_flip_test(&[-1.0, -2.0, -3.0], 1) > 0.99);
        assert_eq!(sign_flip_test(&[0.0; 4], 1), 1.0);
        assert_eq!(sign_flip_test(&[], 1), 1.0);
    }

    #[test]
    fn darwins_plants_have_the_published_p_value() {
        // Fisher 1935, section 21: Darwin's 15 pairs of maize, in eighths of an inch; 863 of 2¹⁵ assignments of signs have a sum of
        // 314 or more, so that p = 0.02634.
        let darwin = [49.0, -67.0, 8.0, 16.0, 6.0, 23.0, 28.0, 41.0, 14.0, 29.0, 56.0, 24.0, 75.0, 60.0, -48.0];
        let p = sign_flip_test(&darwin, 2);
        assert!((p - 863.0 / 32768.0).abs() < 0.006, "{p}");
    }
}
