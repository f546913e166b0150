//! How probable structures are that were compared by their held-out densities.
//!
//! A sum of few log densities is uncertain: had other stretches been measured, it would be another. The weights are therefore a mean over a
//! Bayesian bootstrap of the stretches.
//!
//! Source: Yao, Vehtari, Simpson and Gelman 2018, Using stacking to average Bayesian predictive distributions, Bayesian Analysis 13:917,
//! section 3.4 (pseudo-BMA+).

use super::predictive_density::STRETCHES;
use crate::robot::Physics;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::Exp1;

/// Bootstrap resamples of the stretches.
///
/// Derived: a share of 0.9 then has a standard error of 0.02.
pub const RESAMPLES: usize = 200;

/// A structure that was compared.
#[derive(Debug, Clone)]
pub struct Weighed {
    /// Its effects beyond those of the model as given.
    pub effects: Vec<&'static Physics>,
    /// The logarithm of the density of each stretch.
    pub stretches: [f64; STRETCHES],
    /// The logarithm of what physics expects beforehand.
    pub log_prior: f64,
}

impl Weighed {
    /// Whether it has an effect of this name.
    pub fn has(&self, name: &str) -> bool {
        self.effects.iter().any(|physics| physics.name == name)
    }

    /// Whether it has effects of the same names.
    pub fn is_same(&self, other: &Self) -> bool {
        self.effects.len() == other.effects.len() && other.effects.iter().all(|physics| self.has(physics.name))
    }

    /// The sum over all stretches, and the prior.
    pub fn score(&self) -> f64 {
        self.stretches.iter().sum::<f64>() + self.log_prior
    }
}

/// The weight of each structure; their sum is 1. Of structures with the same effects the best alone counts.
pub fn weights(all: &[&Weighed]) -> Vec<f64> {
    let is_best = |k: usize| {
        let better = |(j, other): (usize, &&Weighed)| {
            all[k].is_same(other) && (other.score() > all[k].score() || other.score() == all[k].score() && j < k)
        };
        !all.iter().enumerate().any(better)
    };
    let counted: Vec<usize> = (0..all.len()).filter(|&k| is_best(k)).collect();
    weights_of(all, &counted)
}

/// The probability that a structure is better than another, of the two; they may be forms of the same effects.
pub fn probability_over(one: &Weighed, other: &Weighed) -> f64 {
    weights_of(&[one, other], &[0, 1])[0]
}

/// The weight of each structure, of which some alone are counted.
fn weights_of(all: &[&Weighed], counted: &[usize]) -> Vec<f64> {
    let mut random = StdRng::seed_from_u64(5);
    let mut weights = vec![0.0; all.len()];
    for _ in 0..RESAMPLES {
        let drawn: [f64; STRETCHES] = std::array::from_fn(|_| random.sample(Exp1));
        let unit = STRETCHES as f64 / drawn.iter().sum::<f64>();
        let score = |k: usize| -> f64 {
            let own = all[k].stretches.iter().zip(&drawn).map(|(density, weight)| density * weight * unit);
            own.sum::<f64>() + all[k].log_prior
        };
        let most = counted.iter().map(|&k| score(k)).fold(f64::NEG_INFINITY, f64::max);
        let total: f64 = counted.iter().map(|&k| (score(k) - most).exp()).sum();
        counted.iter().for_each(|&k| weights[k] += (score(k) - most).exp() / (total * RESAMPLES as f64));
    }
    weights
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::effects::physics;

    fn weights_in(all: &[Weighed]) -> Vec<f64> {
        weights(&all.iter().collect::<Vec<_>>())
    }

    fn of(effect: usize, stretches: [f64; STRETCHES], log_prior: f64) -> Weighed {
        let effects = physics(["creep", "rest_bend"][effect]).into_iter().collect();
        Weighed { effects, stretches, log_prior }
    }

    #[test]
    fn differences_that_all_stretches_share_count_as_they_are_and_others_less() {
        // ln 3 in all, evenly: three to one in every resampling.
        let even = weights_in(&[of(0, [3f64.ln() / 6.0; 6], 0.0), of(1, [0.0; 6], 0.0)]);
        assert!((even[0] - 0.75).abs() < 1e-12 && (even.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{even:?}");
        // The same prior odds.
        assert!((weights_in(&[of(0, [0.0; 6], 3f64.ln()), of(1, [0.0; 6], 0.0)])[0] - 0.75).abs() < 1e-12);
        // Ten in one stretch and minus eight in another: e² = 7.4 to one would be 0.88.
        let uneven = weights_in(&[of(0, [10.0, -8.0, 0.0, 0.0, 0.0, 0.0], 0.0), of(1, [0.0; 6], 0.0)]);
        assert!((0.45..0.75).contains(&uneven[0]), "{uneven:?}");
    }

    #[test]
    fn the_same_effects_fitted_twice_count_once() {
        let twice = weights_in(&[of(0, [0.0; 6], 0.0), of(0, [-1.0; 6], 0.0), of(1, [0.0; 6], 0.0)]);
        assert!((twice[0] - 0.5).abs() < 1e-12 && twice[1] == 0.0, "{twice:?}");
        // Forms of the same effects are compared with each other all the same.
        let even = of(0, [0.0; 6], 0.0);
        assert!((probability_over(&even, &even) - 0.5).abs() < 1e-12);
    }
}
