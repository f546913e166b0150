//! Which effects are confounded with η and λ on these poses: what they do, η and λ could do as well.

use super::fit::Fit;
use super::hypotheses::{Hypothesis, hypotheses};
use super::predictive_density::Beside;
use super::residuals::Problem;
use crate::robot::Physics;
use crate::statistics::projection::Complement;
use nalgebra::DMatrix;
use rayon::prelude::*;

/// The size at which an effect must be distinguishable from η and λ, as the rms of its change of the residuals.
///
/// Convention: ten standard deviations of the noise of a sample, between 0.015 mm for the encoders and 0.1 mm for the eye.
const RMS_IN_SIGMAS: f64 = 10.0;

/// What the criterion must gain by an effect, beyond what it is charged for its parameters.
///
/// Source: Kass and Raftery 1995, Bayes Factors, J. Am. Stat. Assoc. 90:773: 2 ln B above 10 is very strong evidence.
const LEAST_GAIN: f64 = 10.0;

/// The samples are thinned evenly until no more residuals than these are left.
///
/// Convention: a bound on memory and computing time.
const MOST_ROWS: usize = 3000;

/// The effects beyond those of a fitted model of which some combination of parameters could not be named at that size.
pub fn confounded(problem: &Problem, fit: &Fit) -> Vec<&'static Physics> {
    let thinned = |rows: &DMatrix<f64>| thinned(problem, rows);
    let beyond_fit = Complement::new(thinned(&fit.jacobian));
    let path = problem.linearised(&fit.model, &fit.path);
    let is_confounded = |hypothesis: Hypothesis| {
        let own = fit.parameter_count()..hypothesis.start.parameter_specs().len();
        let columns = thinned(&problem.near(&path, &hypothesis.start, own).1);
        let remaining = beyond_fit.of(&columns);
        is_hidden((&columns, &remaining), problem.data.residual_count()).then_some(hypothesis.physics)
    };
    let all = hypotheses(problem, fit, (Beside::Noise, 0.0), |physics| !physics.is_periodic());
    let mut found: Vec<&'static Physics> = Vec::new();
    for physics in all.into_par_iter().filter_map(is_confounded).collect::<Vec<_>>() {
        if !found.contains(&physics) {
            found.push(physics);
        }
    }
    found
}

/// Whether an effect with these columns, of which this remains beside the fit, could not be named at that size.
fn is_hidden((columns, remaining): (&DMatrix<f64>, &DMatrix<f64>), rows: usize) -> bool {
    let squares = RMS_IN_SIGMAS.powi(2) * columns.nrows() as f64;
    squares * least_share(columns, remaining) < columns.ncols() as f64 * (rows as f64).ln() + LEAST_GAIN
}

/// The rows of so many samples, evenly spaced, that no more than [`MOST_ROWS`] are left.
fn thinned(problem: &Problem, rows: &DMatrix<f64>) -> DMatrix<f64> {
    let (n, samples) = (problem.data.backbones(), problem.data.len());
    let stride = problem.data.residual_count().div_ceil(MOST_ROWS);
    DMatrix::from_fn(n * samples.div_ceil(stride), rows.ncols(), |r, c| rows[(n * (r / n * stride) + r % n, c)])
}

/// The least share of an effect's squares that η and λ leave, over all combinations of its parameters: the smallest eigenvalue of
/// RᵗR relative to CᵗC, which is one less the largest squared canonical correlation of C with η and λ.
fn least_share(columns: &DMatrix<f64>, remaining: &DMatrix<f64>) -> f64 {
    let root = (columns.transpose() * columns).cholesky().and_then(|factor| factor.l().try_inverse());
    let Some(root) = root else { return 0.0 };
    (&root * (remaining.transpose() * remaining) * root.transpose()).symmetric_eigenvalues().min()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_share_is_one_less_the_squared_correlation() {
        // A column at 60° to the nuisance direction keeps sin² 60° of its squares.
        let (sin, cos) = 60f64.to_radians().sin_cos();
        let columns = DMatrix::from_column_slice(2, 1, &[2.0 * cos, 2.0 * sin]);
        let remaining = DMatrix::from_column_slice(2, 1, &[0.0, 2.0 * sin]);
        assert!((least_share(&columns, &remaining) - 0.75).abs() < 1e-12);
    }

    #[test]
    fn two_parameters_are_as_confounded_as_their_worst_combination() {
        let columns = DMatrix::identity(3, 2);
        let remaining = DMatrix::from_row_slice(3, 2, &[0.5, -0.5, -0.5, 0.5, 0.0, 0.0]);
        assert!(least_share(&columns, &remaining).abs() < 1e-12);
        assert_eq!(least_share(&DMatrix::from_element(3, 2, 1.0), &remaining), 0.0);
    }

    #[test]
    fn an_effect_is_confounded_where_a_large_one_would_not_gain_enough() {
        let columns = DMatrix::from_element(100, 1, 1.0);
        let is_hidden = |kept: f64| is_hidden((&columns, &(&columns * kept.sqrt())), 100);
        // 10² · 100 · share against ln 100 + 10 = 14.6.
        assert!(!is_hidden(0.0015));
        assert!(is_hidden(0.0014));
    }
}
