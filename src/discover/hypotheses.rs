//! Hypotheses: the model with one effect of the library more, at the values where its fit begins.

use super::data::Data;
use super::fit::Fit;
use super::periodogram;
use super::residuals::{Problem, stacked};
use crate::robot::effects::Starts;
use crate::robot::{Effect, Model, Physics};
use nalgebra::DMatrix;
use rayon::prelude::*;

/// The relative ridge that keeps the normal equations of one step solvable.
///
/// Convention: a numerical guard.
const RELATIVE_RIDGE: f64 = 1e-6;

/// Samples are thinned evenly until no more residuals than these are left.
///
/// Convention: a bound on memory and computing time.
const MOST_ROWS: usize = 3000;

/// A model with one effect more.
#[derive(Debug, Clone)]
pub struct Hypothesis {
    /// The effect that is added; the last of the model's.
    pub physics: &'static Physics,
    /// The model, the effect at its starting values.
    pub start: Model,
}

impl Hypothesis {
    /// A model with an effect at these values besides its own.
    pub fn new(model: &Model, physics: &'static Physics, values: Vec<f64>) -> Self {
        let mut start = model.clone();
        start.effects.push(Effect::of(physics, values));
        Self { physics, start }
    }

    /// One Gauss–Newton step from the start.
    fn first_step(self, problem: &Problem, fit: &Fit) -> FirstStep {
        let prediction = problem.predict(&self.start, Some(&fit.path));
        let jacobian = problem.jacobian(&self.start, &prediction);
        let r = stacked(&prediction.residuals);
        let gradient = jacobian.tr_mul(&r);
        let mut information = jacobian.tr_mul(&jacobian);
        for j in 0..information.nrows() {
            information[(j, j)] *= 1.0 + RELATIVE_RIDGE;
        }
        let taken = information.cholesky().map_or(0.0, |factor| gradient.dot(&factor.solve(&gradient)));
        let squares: f64 = fit.residuals.iter().map(|r| r.norm_squared()).sum();
        let own = fit.parameter_count()..jacobian.ncols();
        let penalty = own.len() as f64 * (jacobian.nrows() as f64).ln();
        let columns = thinned(problem.data, &jacobian).columns_range(own).into_owned();
        FirstStep { hypothesis: self, gain: squares - r.norm_squared() + taken - penalty, columns }
    }
}

/// A hypothesis after one Gauss–Newton step from its start.
#[derive(Debug, Clone)]
pub struct FirstStep {
    /// The hypothesis.
    pub hypothesis: Hypothesis,
    /// By how much the step is expected to lower the Bayesian information criterion.
    pub gain: f64,
    /// Derivatives of the [thinned] residuals by the effect's parameters in units of their scales.
    pub columns: DMatrix<f64>,
}

/// The first step of every hypothesis that `admits`.
pub fn first_steps(problem: &Problem, fit: &Fit, admits: impl Fn(&Physics) -> bool) -> Vec<FirstStep> {
    let mut hypotheses = one_effect_more(problem, fit);
    hypotheses.retain(|hypothesis| admits(hypothesis.physics));
    hypotheses.into_par_iter().map(|hypothesis| hypothesis.first_step(problem, fit)).collect()
}

/// The rows of so many samples, evenly spaced, that no more than [`MOST_ROWS`] are left.
pub fn thinned(data: &Data, rows: &DMatrix<f64>) -> DMatrix<f64> {
    let n = data.backbones();
    let stride = data.residual_count().div_ceil(MOST_ROWS);
    let samples = data.len().div_ceil(stride);
    DMatrix::from_fn(n * samples, rows.ncols(), |r, c| rows[(n * (r / n * stride) + r % n, c)])
}

/// Every effect that is looked for and whose name the fitted model does not have, in each of its forms, at each of its starts.
fn one_effect_more(problem: &Problem, fit: &Fit) -> Vec<Hypothesis> {
    let has = |name: &str| fit.model.effects.iter().any(|effect| effect.physics.name == name);
    let lacking: Vec<&'static Physics> =
        problem.data.library.iter().copied().filter(|physics| !has(physics.name)).collect();
    let is_periodic = |physics: &&Physics| matches!(physics.starts, Starts::Periodogram(_));
    let periodic = if lacking.iter().any(is_periodic) { periodogram::starts(problem, fit) } else { Vec::new() };
    lacking
        .into_iter()
        .flat_map(|physics| {
            let starts: Vec<Vec<f64>> = match physics.starts {
                Starts::Periodogram(phases) => {
                    periodic.iter().filter(|(own, _)| *own == phases).map(|(_, start)| start.clone()).collect()
                }
                Starts::At(_) | Starts::Nowhere => physics.given_starts(problem.data.backbones()).collect(),
            };
            starts.into_iter().map(move |values| Hypothesis::new(&fit.model, physics, values))
        })
        .collect()
}

/// The best fit of the model with an effect of this name more, over its forms and starts; the fit itself where there is none.
pub fn best_with(problem: &Problem, fit: &Fit, name: &str) -> Fit {
    one_effect_more(problem, fit)
        .into_iter()
        .filter(|hypothesis| hypothesis.physics.name == name)
        .map(|hypothesis| problem.fit(&hypothesis.start, Some(&fit.path), None))
        .min_by(|a, b| a.bic().total_cmp(&b.bic()))
        .unwrap_or_else(|| fit.clone())
}
