//! Hypotheses: the model with one effect of the library more, at the values where its fit begins.

use super::fit::Fit;
use super::periodogram;
use super::residuals::{Problem, stacked};
use crate::robot::effects::Starts;
use crate::robot::{Effect, Model, Physics};
use nalgebra::{DMatrix, Vector2};

/// The relative ridge that keeps the normal equations of one step solvable.
///
/// Convention: a numerical guard.
const RELATIVE_RIDGE: f64 = 1e-6;

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

    /// The residuals' derivatives at the start, and the sum of squares that one Gauss–Newton step from it is expected to leave.
    pub fn one_step(&self, problem: &Problem, path: &[Vector2<f64>]) -> (DMatrix<f64>, f64) {
        let prediction = problem.predict(&self.start, Some(path));
        let jacobian = problem.jacobian(&self.start, &prediction);
        let r = stacked(&prediction.residuals);
        let gradient = jacobian.transpose() * &r;
        let mut information = jacobian.transpose() * &jacobian;
        for j in 0..information.nrows() {
            information[(j, j)] *= 1.0 + RELATIVE_RIDGE;
        }
        let gain = information.cholesky().map_or(0.0, |factor| gradient.dot(&factor.solve(&gradient)));
        (jacobian, r.norm_squared() - gain)
    }
}

/// Every effect that is looked for and whose name the fitted model does not have, in each of its forms, at each of its starts.
pub fn one_effect_more(problem: &Problem, fit: &Fit) -> Vec<Hypothesis> {
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
