//! The noise, learned from what no smooth physics can make.
//!
//! What encoders and eye are said to scatter by is a prior, and residuals tell the rest: second differences of successive residuals,
//! in which whatever changes slowly from sample to sample cancels. Residuals that are not correlated from one to the next are noise as
//! a whole, and tell more. The parts of q̃ that bend nothing tell the encoders' noise alone; with it, the bend tells by which factor
//! the measurements' sigmas are wrong.

use super::data::Data;
use super::fit::Fit;
use super::residuals::Problem;
use crate::statistics::correlation::squares_and_products;
use crate::statistics::moments::mean;
use crate::statistics::order::mad_scale;

/// Standard deviation of the logarithm of a standard deviation that is stated, before anything is measured.
///
/// Convention: ln 3; a stated sigma is usually right within a factor of three.
const LN_SD_OF_STATED: f64 = 1.098_612;

/// Variance of the logarithm of the scale of n second differences, times n.
///
/// Derived: 1/(2 · 0.37) for the median absolute deviation's efficiency (Huber and Ronchetti, 2nd ed., 5.1), times 1.94 for
/// neighbours' correlations of −2/3 and 1/6, which count as 1 + 2 (4/9 + 1/36).
const LN_VARIANCE_TIMES_COUNT: f64 = 2.6;

/// Residuals whose successive correlation is above this many standard errors are not noise alone.
///
/// Source: any table of the normal distribution; 1 % on the upper side.
const CORRELATED: f64 = 2.33;

/// The least and the largest factor on a stated sigma.
///
/// Convention: noise below a quarter of what is stated is as good as none, and would make structure of a model's last digits; beyond
/// a hundred times a sigma is no sigma.
const FACTORS: (f64, f64) = (0.25, 100.0);

/// Halvings of the bisection.
///
/// Convention: numerical; ln 400 over 2²⁰.
const HALVINGS: usize = 20;

/// Noise that has shrunk below this share of what it was taken for makes the search start again.
///
/// Convention: five times the standard error of a learned sigma at a few hundred samples.
const FINER: f64 = 0.75;

/// The least standard deviation that the parts of q̃ which bend nothing are weighted with, mm.
///
/// Convention: a numerical guard against an encoder noise of zero.
const LEAST_SD_INTERNAL_MM: f64 = 1e-5;

/// What scatters, and what the model is known to miss besides.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Standard deviation of an encoder reading, mm.
    pub sd_encoder_mm: f64,
    /// Factor of the measurements' stated sigmas.
    pub eye_factor: f64,
    /// Standard deviation of what the model misses of each component of the bend, rad.
    pub discrepancy_rad: f64,
    /// The same of each part of q̃ that bends nothing, mm.
    pub discrepancy_mm: f64,
    /// How many samples at the start weigh nothing, since what moved the snake before the log still holds it there.
    pub unknown_start: usize,
}

impl Noise {
    /// As stated.
    pub fn stated(data: &Data) -> Self {
        Self {
            sd_encoder_mm: data.sd_encoder_mm,
            eye_factor: 1.0,
            discrepancy_rad: 0.0,
            discrepancy_mm: 0.0,
            unknown_start: 0,
        }
    }

    /// The standard deviation of each part of q̃ that bends nothing, without a discrepancy, mm.
    pub fn sd_internal_mm(&self) -> f64 {
        self.sd_encoder_mm.max(LEAST_SD_INTERNAL_MM)
    }

    /// From the residuals of a fit, with what was stated as the prior.
    pub fn learned(problem: &Problem, fit: &Fit) -> Self {
        let data = problem.data;
        let n = data.backbones();
        let internal: Vec<Vec<f64>> = (2..n).map(|c| problem.internal_mm(&fit.residuals, c - 2).collect()).collect();
        let read = mean(internal.iter().map(|values| noise_variance(values))).sqrt();
        let sd_encoder_mm = with_prior(read, data.sd_encoder_mm, data.len() * (n - 2));
        // The variance of the whitened bend falls with the factor; where it is 1 the factor is right.
        let (mut low, mut high) = (FACTORS.0.ln(), FACTORS.1.ln());
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            let noise = Self { sd_encoder_mm, eye_factor: middle.exp(), ..Self::stated(data) };
            let bend = problem.bend_whitened_by(&noise, &fit.residuals);
            let variance = mean(bend.iter().map(|values| noise_variance(values)));
            if variance > 1.0 { low = middle } else { high = middle }
        }
        let eye_factor = with_prior((0.5 * (low + high)).exp(), 1.0, 2 * data.len());
        Self { sd_encoder_mm, eye_factor, ..Self::stated(data) }
    }

    /// Whether it is clearly less than another.
    pub fn is_finer_than(&self, other: &Self) -> bool {
        self.sd_encoder_mm < FINER * other.sd_encoder_mm || self.eye_factor < FINER * other.eye_factor
    }

    /// The less of both, of encoders and eye each.
    pub fn finer_of(&self, other: &Self) -> Self {
        Self {
            sd_encoder_mm: self.sd_encoder_mm.min(other.sd_encoder_mm),
            eye_factor: self.eye_factor.min(other.eye_factor),
            ..*self
        }
    }

    /// The same noise, and as discrepancy what a fit leaves beyond it.
    ///
    /// Of ε, what bends nothing misses at least as much as what bends: where actuators are driven to positions, their redundancy takes up
    /// in forces what friction of each backbone leaves there, and the readings never show it.
    pub fn with_discrepancy(&self, problem: &Problem, fit: &Fit) -> Self {
        let data = problem.data;
        let known = || self.unknown_start..data.len();
        let parts = (data.backbones() - 2) as f64;
        let bend = mean(known().map(|k| problem.bend_gap(&fit.residuals, k).norm_squared())) / 2.0;
        let internal = |part: usize| problem.internal_mm(&fit.residuals, part).skip(self.unknown_start);
        let internal = mean((0..data.backbones() - 2).flat_map(|part| internal(part).map(|r| r * r)));
        let eps = mean(known().map(|k| problem.eps_gap_mm(&fit.residuals, k).norm_squared()));
        let of_bend = (eps - parts * internal) / 2.0;
        let variance = |left: f64, noise: f64| (left - noise).max(0.0);
        Self {
            discrepancy_rad: variance(bend, problem.bend_noise_rad2()).sqrt(),
            discrepancy_mm: variance(internal.max(of_bend), self.sd_encoder_mm.powi(2)).sqrt(),
            ..*self
        }
    }
}

/// The variance of what does not hang together from one value to the next.
fn noise_variance(values: &[f64]) -> f64 {
    let [squares, products] = squares_and_products(values);
    if products <= CORRELATED * squares / (values.len() as f64).sqrt() {
        return mad_scale(values.iter().copied()).powi(2);
    }
    mad_scale(values.windows(3).map(|v| (v[0] - 2.0 * v[1] + v[2]) / 6f64.sqrt())).powi(2)
}

/// The mean of two logarithms of a standard deviation, measured and stated, weighted by what each is known to.
fn with_prior(measured: f64, stated: f64, count: usize) -> f64 {
    let measured = measured.clamp(FACTORS.0 * stated, FACTORS.1 * stated);
    let (of_data, of_prior) = (count as f64 / LN_VARIANCE_TIMES_COUNT, LN_SD_OF_STATED.powi(-2));
    ((of_data * measured.ln() + of_prior * stated.ln()) / (of_data + of_prior)).exp()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::discover::fixture::{experiment, truth};
    use crate::observation::Measured;
    use crate::robot::PerBackbone;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;

    #[test]
    fn wrong_sigmas_are_put_right() {
        // Encoders of 8 µm said to have 1.5, and an eye that says half and twice its sigma.
        for (seed, factor) in [(1, 0.5), (2, 2.0)] {
            let mut data = experiment(seed);
            let mut random = StdRng::seed_from_u64(seed);
            for q in &mut data.log.q_mm {
                *q += PerBackbone::from_fn(3, |_| 0.008 * random.sample::<f64, _>(StandardNormal));
            }
            for Measured { sigma_theta, sigma_delta, .. } in &mut data.measured {
                *sigma_theta *= factor;
                *sigma_delta *= factor;
            }
            let problem = Problem::new(&data, &Noise::stated(&data), &truth());
            let noise = Noise::learned(&problem, &problem.fit(&truth(), None, None));
            // About 200 samples: a standard error of 11 % for the encoders, a little less for the eye.
            assert!((noise.sd_encoder_mm / 0.0081).ln().abs() < 0.35, "{noise:?}");
            assert!((noise.eye_factor * factor).ln().abs() < 0.35, "{noise:?}");
        }
    }

    #[test]
    fn of_epsilon_what_bends_nothing_misses_as_much_as_each_part_that_bends() {
        let mut data = experiment(1);
        // A camera that is turned by 6° moves the bend alone.
        let mut turned_mm2 = Vec::new();
        for measured in &mut data.measured {
            let before = truth().command(measured.configuration);
            measured.configuration.delta += 0.1;
            turned_mm2.push((truth().command(measured.configuration) - before).norm_squared());
        }
        let problem = Problem::new(&data, &Noise::stated(&data), &truth());
        let noise = problem.noise.with_discrepancy(&problem, &problem.evaluated(&truth(), None));
        let expected_mm = (mean(turned_mm2) / 2.0).sqrt();
        assert!((noise.discrepancy_mm / expected_mm - 1.0).abs() < 0.1, "{noise:?} {expected_mm}");
    }

    #[test]
    fn what_changes_slowly_is_no_noise() {
        let mut random = StdRng::seed_from_u64(5);
        let values: Vec<f64> =
            (0..500).map(|k| 20.0 * (0.05 * f64::from(k)).sin() + random.sample::<f64, _>(StandardNormal)).collect();
        assert!((noise_variance(&values).sqrt() - 1.0).abs() < 0.2, "{}", noise_variance(&values));
    }

    #[test]
    fn few_samples_leave_what_was_stated() {
        assert!((with_prior(5.0, 1.0, 0) - 1.0).abs() < 1e-12);
        assert!((with_prior(5.0, 1.0, 10_000) - 5.0).abs() < 0.01);
    }
}
