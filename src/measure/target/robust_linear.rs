//! A linear model with normal priors, fitted robustly, and the covariance of the fit.

use crate::statistics::normal_equations::normal_equations;
use crate::statistics::robust::{HUBER_LIMIT, Irls, Loss, TUKEY_LIMIT};
use nalgebra::{DMatrix, DVector};

/// The most rounds of reweighting, and the step (in units of the parameters) that ends them sooner.
///
/// Convention: reweighting converges linearly; both are far beyond what the residuals' noise leaves of a parameter.
const ROUNDS: usize = 30;
const TOLERANCE: f64 = 1e-6;
/// Residuals with at least this weight agree with the fit.
///
/// Convention: the biweight of a residual 3.3 σ off.
const AGREEING_WEIGHT: f64 = 0.25;

/// The solution of a robust linear least-squares problem.
pub struct RobustLinear {
    /// x̂.
    pub parameters: DVector<f64>,
    /// Its covariance, residuals taken for independent, and for as uncertain as they scatter where that is more than their σ.
    pub covariance: DMatrix<f64>,
    /// How many rows agree with it.
    pub agreeing: usize,
}

impl RobustLinear {
    /// Fits x to `seen` = `design` x, both in units of σ, with independent priors of mean zero and these standard deviations.
    ///
    /// Huber's loss finds a start whatever the outliers; where `is_redescending`, Tukey's biweight then takes them out altogether.
    /// `None` where the rows do not determine x.
    pub fn fit(design: &DMatrix<f64>, seen: &DVector<f64>, prior_sd: &[f64], is_redescending: bool) -> Option<Self> {
        let (rows, parameters) = design.shape();
        let mut with_priors = design.clone().insert_rows(rows, parameters, 0.0);
        prior_sd.iter().enumerate().for_each(|(k, sd)| with_priors[(rows + k, k)] = 1.0 / sd);
        let offset = (-seen).insert_rows(rows, parameters, 0.0);
        let irls = |loss| Irls { loss, least_scale: 1.0, rounds: ROUNDS, tolerance: TOLERANCE };
        let start = irls(Loss::Huber(HUBER_LIMIT)).fit(&with_priors, &offset, rows)?;
        let (parameters, weights) = if is_redescending {
            let residuals = &offset + &with_priors * &start.parameters;
            let step = irls(Loss::Tukey(TUKEY_LIMIT)).fit(&with_priors, &residuals, rows)?;
            (start.parameters + step.parameters, step.weights)
        } else {
            (start.parameters, start.weights)
        };
        let residuals = design * &parameters - seen;
        let weight = weights.rows(0, rows);
        let sum: f64 = residuals.iter().zip(weight.iter()).map(|(r, w)| w * r * r).sum();
        let freedom = (weight.sum() - prior_sd.len() as f64).max(1.0);
        let (information, _) = normal_equations(&with_priors, &offset, &weights);
        let covariance = information.cholesky()?.inverse() * (sum / freedom).max(1.0);
        let agreeing = weight.iter().filter(|weight| **weight > AGREEING_WEIGHT).count();
        Some(Self { parameters, covariance, agreeing })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, Normal};

    #[test]
    fn exact_rows_and_a_prior_give_the_mean_of_the_posterior() {
        // Two numbers, one measured ten times as 3, the other not at all: 10/(10 + 1/4) of it, and the prior.
        let design = DMatrix::from_fn(10, 2, |_, c| f64::from(c == 0));
        let fit = RobustLinear::fit(&design, &DVector::from_element(10, 3.0), &[2.0, 5.0], false).unwrap();
        assert_relative_eq!(fit.parameters[0], 3.0 * 10.0 / 10.25, epsilon = 1e-7);
        assert_eq!(fit.parameters[1], 0.0);
        assert_relative_eq!(fit.covariance[(0, 0)], 1.0 / 10.25, epsilon = 1e-9);
        assert_relative_eq!(fit.covariance[(1, 1)], 25.0, epsilon = 1e-9);
    }

    #[test]
    fn a_sixth_of_wrong_rows_leaves_the_line_where_it_is_and_the_sigmas_are_those_of_the_scatter() {
        let noise = Normal::new(0.0, 1.0).unwrap();
        let design = DMatrix::from_fn(60, 2, |r, c| if c == 0 { 1.0 } else { r as f64 / 30.0 - 1.0 });
        let truth = DVector::from_column_slice(&[1.5, -4.0]);
        let draws = 400;
        let mut squares = DVector::zeros(2);
        for seed in 0..draws {
            let mut random = StdRng::seed_from_u64(seed);
            let mut seen = &design * &truth + DVector::from_fn(60, |_, _| noise.sample(&mut random));
            seen.iter_mut().step_by(6).for_each(|value| *value += 40.0);
            let fit = RobustLinear::fit(&design, &seen, &[100.0, 100.0], true).unwrap();
            assert!((44..=50).contains(&fit.agreeing), "{}", fit.agreeing);
            let normalised = (fit.parameters - &truth).component_div(&fit.covariance.diagonal().map(f64::sqrt));
            squares += normalised.component_mul(&normalised);
        }
        // The biweight is 95 % efficient, and its weights count a good row for a little less than one.
        let mean = squares / draws as f64;
        assert!(mean.iter().all(|square| (0.7..1.3).contains(square)), "{mean}");
    }
}
