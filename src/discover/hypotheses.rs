//! Hypotheses: the model with one effect of the library more, at the values where its fit begins.

use super::data::Data;
use super::fit::Fit;
use super::periodogram;
use super::residuals::{Problem, Residual, stacked};
use crate::robot::effects::Starts;
use crate::robot::{Effect, Model, Physics};
use crate::statistics::projection::Complement;
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

    /// What its effect does to the residuals of a fit, to first order about the start.
    fn first_step(self, problem: &Problem, fit: &Fit) -> FirstStep {
        let prediction = problem.predict(&self.start, Some(&fit.path));
        let own = fit.parameter_count()..self.start.parameter_specs().len();
        let columns = thinned(problem.data, &problem.jacobian(&self.start, &prediction, own));
        let shift = thinned_residuals(problem, &prediction.residuals) - thinned_residuals(problem, &fit.residuals);
        FirstStep { hypothesis: self, columns, shift }
    }
}

/// What a hypothesis does to the residuals of the fit that it is about, to first order about its start.
#[derive(Debug, Clone)]
pub struct FirstStep {
    /// The hypothesis.
    pub hypothesis: Hypothesis,
    /// Derivatives of the [thinned] residuals by the effect's parameters in units of their scales.
    pub columns: DMatrix<f64>,
    /// By how much the effect at its starting values changes the [thinned] residuals.
    shift: DMatrix<f64>,
}

impl FirstStep {
    /// Whether it is about a fit with as many effects.
    fn is_about(&self, fit: &Fit) -> bool {
        self.hypothesis.start.effects.len() == fit.model.effects.len() + 1
    }

    /// By how much one Gauss–Newton step lowers the Bayesian information criterion of a fit, of whose [thinned] residuals this is what its
    /// own parameters leave.
    fn gain(&self, problem: &Problem, left: &DMatrix<f64>, beyond_fit: &Complement) -> f64 {
        let own = beyond_fit.of(&self.columns);
        let start = left + beyond_fit.of(&self.shift);
        let gradient = own.tr_mul(&start);
        let mut information = own.tr_mul(&own);
        for j in 0..information.nrows() {
            information[(j, j)] *= 1.0 + RELATIVE_RIDGE;
        }
        let taken = information.cholesky().map_or(0.0, |factor| gradient.dot(&factor.solve(&gradient)));
        let rows = problem.data.residual_count() as f64;
        let squares = (left.norm_squared() - start.norm_squared() + taken) * rows / left.len() as f64;
        squares - self.columns.ncols() as f64 * rows.ln() - self.hypothesis.physics.prior_penalty
    }
}

/// The first step of every hypothesis about a fit that `admits`.
pub fn first_steps(problem: &Problem, fit: &Fit, admits: impl Fn(&Physics) -> bool) -> Vec<FirstStep> {
    let hypotheses = one_effect_more(problem, fit, admits);
    hypotheses.into_par_iter().map(|hypothesis| hypothesis.first_step(problem, fit)).collect()
}

/// The hypotheses about a fit with the gain in the information criterion that one step promises. The steps may be about a fit with fewer
/// effects: what effects do is then taken to add up, but for periodic ones, whose frequency is looked for anew.
pub fn promised(problem: &Problem, fit: &Fit, steps: &[FirstStep]) -> Vec<(f64, Hypothesis)> {
    let beyond_fit = Complement::new(thinned(problem.data, &fit.jacobian));
    let left = beyond_fit.of(&thinned_residuals(problem, &fit.residuals));
    let has = |physics: &Physics| fit.model.effects.iter().any(|effect| effect.physics.name == physics.name);
    let anew = match steps.first() {
        Some(first) if !first.is_about(fit) => first_steps(problem, fit, is_periodic),
        _ => Vec::new(),
    };
    let adds_up = |step: &&FirstStep| {
        let physics = step.hypothesis.physics;
        step.is_about(fit) || !is_periodic(physics) && !has(physics)
    };
    let all: Vec<&FirstStep> = steps.iter().filter(adds_up).chain(&anew).collect();
    let of_step = |step: &FirstStep| {
        let Hypothesis { physics, start } = &step.hypothesis;
        let values = start.effects.last().map_or_else(Vec::new, |own| own.values.clone());
        (step.gain(problem, &left, &beyond_fit), Hypothesis::new(&fit.model, physics, values))
    };
    all.into_par_iter().map(of_step).collect()
}

/// The [thinned] residuals, a column.
fn thinned_residuals(problem: &Problem, residuals: &[Residual]) -> DMatrix<f64> {
    thinned(problem.data, &DMatrix::from_vec(problem.data.residual_count(), 1, stacked(residuals).data.into()))
}

/// The rows of so many samples, evenly spaced, that no more than [`MOST_ROWS`] are left.
pub fn thinned(data: &Data, rows: &DMatrix<f64>) -> DMatrix<f64> {
    let n = data.backbones();
    let stride = data.residual_count().div_ceil(MOST_ROWS);
    let samples = data.len().div_ceil(stride);
    DMatrix::from_fn(n * samples, rows.ncols(), |r, c| rows[(n * (r / n * stride) + r % n, c)])
}

/// Whether the data must say at which period a search for an effect starts.
pub fn is_periodic(physics: &Physics) -> bool {
    matches!(physics.starts, Starts::Periodogram(_))
}

/// Every effect that is looked for, that `admits` and whose name the fitted model does not have, in each of its forms, at each of its
/// starts.
fn one_effect_more(problem: &Problem, fit: &Fit, admits: impl Fn(&Physics) -> bool) -> Vec<Hypothesis> {
    let has = |name: &str| fit.model.effects.iter().any(|effect| effect.physics.name == name);
    let lacking: Vec<&'static Physics> =
        problem.data.library.iter().copied().filter(|physics| !has(physics.name) && admits(physics)).collect();
    let has_periodic = lacking.iter().any(|physics| is_periodic(physics));
    let periodic = if has_periodic { periodogram::starts(problem, fit) } else { Vec::new() };
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
    one_effect_more(problem, fit, |physics| physics.name == name)
        .into_iter()
        .map(|hypothesis| problem.fit(&hypothesis.start, Some(&fit.path), None))
        .min_by(|a, b| a.bic().total_cmp(&b.bic()))
        .unwrap_or_else(|| fit.clone())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::discover::fixture::{experiment, truth};
    use crate::discover::noise::Noise;

    #[test]
    fn a_step_promises_what_the_fit_then_gains_also_beside_an_effect_that_it_was_not_made_beside() {
        let mut data = experiment(4);
        // A turned camera and an actuator that reads too much, by one or two standard deviations of the noise.
        data.measured.iter_mut().for_each(|measured| measured.configuration.delta += 0.006);
        data.log.q_mm.iter_mut().for_each(|q| q[0] *= 1.003);
        let problem = Problem::new(&data, &Noise::stated(&data), &truth());
        let before = problem.fit(&truth(), None, None);
        let fitted = |fit: &Fit, name: &str| {
            let steps = first_steps(&problem, fit, |physics| physics.name == name);
            problem.fit(&promised(&problem, fit, &steps)[0].1.start, Some(&fit.path), None)
        };
        let steps = first_steps(&problem, &before, |physics| physics.name == "actuator_scale");
        let turned = fitted(&before, "plane_misalignment");
        for fit in [&before, &turned] {
            let gained = fit.bic() - fitted(fit, "actuator_scale").bic();
            let promise = promised(&problem, fit, &steps)[0].0;
            // The fit's loss grows more slowly than squares from three standard deviations on.
            assert!(gained > 100.0 && (promise / gained - 1.0).abs() < 0.25, "{promise} of {gained}");
        }
    }
}
