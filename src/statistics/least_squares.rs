//! Nonlinear least squares by the method of Levenberg and Marquardt, with box bounds and a robust loss.
//!
//! Minimises the cost Σ v_i ρ(r_i(x)) over lower ≤ x ≤ upper, with residuals r, fixed weights v (1 unless said otherwise) and a loss
//! ρ ([`Loss`]). From a linearisation r(x + s) ≈ r + J s the step solves
//!
//! ```text
//! (JᵗWJ + μ diag JᵗWJ) s = −JᵗWr,        W = diag v_i w(r_i),
//! ```
//!
//! with the loss's weights w of reweighted least squares. The damping μ falls tenfold after each step that lowers the cost and rises
//! tenfold, with the step tried again, after one that does not. Marquardt's scaling by the diagonal makes the steps independent of
//! the parameters' units. A parameter that lies on a bound and would leave the box is held there for the step; a parameter
//! that a step would carry out of the box is carried to its edge, and the step solved again for the others.
//!
//! Source: D. W. Marquardt, "An Algorithm for Least-Squares Estimation of Nonlinear Parameters", J. SIAM 11, 1963; K. Madsen,
//! H. B. Nielsen, O. Tingleff, *Methods for Non-Linear Least Squares Problems*, 2nd ed., DTU 2004; for the bounds
//! D. P. Bertsekas, "Projected Newton Methods for Optimization Problems with Simple Constraints", SIAM J. Control Optim. 20, 1982.
//!
//! # How to call it
//!
//! [`minimise`] takes residuals as a closure and differentiates them by central differences. Where residuals come with a Jacobian,
//! or an evaluation has more to it than residuals (a path that the next evaluation starts from), implement [`Problem`] and call
//! [`solve`].

use super::normal_equations::{information, normal_equations};
use super::robust::Loss;
use nalgebra::{DMatrix, DVector};
use thiserror::Error;

/// Damping of the first step.
///
/// Convention: nearly a Gauss–Newton step; a start that needs more gets it after the first step that fails.
const FIRST_DAMPING: f64 = 1e-6;
/// What the damping is divided by after a step that lowers the cost, and multiplied by after one that does not.
///
/// Source: Marquardt 1963.
const DAMPING_FACTOR: f64 = 10.0;
/// The damping does not fall below this.
///
/// Convention: far below the rounding of a step that matters, far above that of the normal equations.
const LEAST_DAMPING: f64 = 1e-9;
/// A step that failed is tried again with at least this damping.
///
/// Convention: less would repeat the step that failed.
const LEAST_DAMPING_AFTER_FAILURE: f64 = 1e-4;

/// Residuals as a function of parameters, and what belongs to one evaluation of them.
pub trait Problem {
    /// All that one evaluation gives: at least what the residuals are made from.
    type Evaluation;

    /// Evaluates at `parameters`. `near` is an evaluation at parameters close by (none at the start), from which an iterative
    /// evaluation may go on. `None` where there is no answer at these parameters; a step that leads there counts as failed.
    fn evaluate(&self, parameters: &DVector<f64>, near: Option<&Self::Evaluation>) -> Option<Self::Evaluation>;

    /// The residuals of an evaluation; always as many.
    fn residuals(&self, evaluation: &Self::Evaluation) -> DVector<f64>;

    /// ∂(residuals)/∂(parameters) at an evaluation, a row for each residual.
    fn jacobian(&self, parameters: &DVector<f64>, evaluation: &Self::Evaluation) -> DMatrix<f64>;

    /// Fixed weights of the residuals, 0 for one that is left out; `None` for 1 each.
    fn weights(&self) -> Option<&DVector<f64>> {
        None
    }
}

/// How a cost is minimised.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// What a residual costs.
    pub loss: Loss,
    /// Least and largest values of the parameters.
    pub bounds: Option<(DVector<f64>, DVector<f64>)>,
    /// The longest step of each parameter.
    pub most_step: Option<DVector<f64>>,
    /// The most linearisations.
    pub most_iterations: usize,
    /// The most dampings that are tried from one linearisation.
    pub most_dampings: usize,
    /// A step that lowers the cost by no more than this is the last.
    pub least_decrease: f64,
    /// The same, as a share of the cost.
    pub least_relative_decrease: f64,
}

impl Default for Options {
    /// Least squares without bounds, to the end of what rounding leaves.
    fn default() -> Self {
        Self {
            loss: Loss::Squares,
            bounds: None,
            most_step: None,
            most_iterations: 100,
            most_dampings: 12,
            least_decrease: 0.0,
            least_relative_decrease: 1e-14,
        }
    }
}

/// Why the iterations ended. Each is a minimum as far as can be told but the last.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stopped {
    /// The last step lowered the cost by no more than was asked for.
    SmallDecrease,
    /// No damping gave a step that lowers the cost.
    NoDescent,
    /// All iterations were used up.
    IterationLimit,
}

/// Why there is no solution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum Failure {
    /// There are fewer residuals than parameters.
    #[error("{residuals} residuals cannot determine {parameters} parameters")]
    TooFewResiduals {
        /// How many residuals there are.
        residuals: usize,
        /// How many parameters there are.
        parameters: usize,
    },
    /// The residuals at the start, or their derivatives at the solution, are not all finite numbers.
    #[error("the residuals or their derivatives are not finite numbers")]
    NotFinite,
}

/// A minimum of the cost.
#[derive(Debug, Clone)]
pub struct Solution<E = DVector<f64>> {
    /// x̂.
    pub parameters: DVector<f64>,
    /// The problem's evaluation there.
    pub evaluation: E,
    /// The residuals there.
    pub residuals: DVector<f64>,
    /// The residuals' Jacobian at the last linearisation, which is at x̂ or one last step away from it.
    pub jacobian: DMatrix<f64>,
    /// Σ v ρ(r).
    pub cost: f64,
    /// How often the residuals were linearised.
    pub iterations: usize,
    /// Why the iterations ended.
    pub stopped: Stopped,
}

impl<E> Solution<E> {
    /// [`covariance`] of the parameters.
    pub fn covariance(&self) -> Option<DMatrix<f64>> {
        covariance(&self.jacobian)
    }
}

/// (JᵗJ)⁻¹: the parameters' covariance if the residuals, whose Jacobian this is, are independent and in units of their σ. `None` if
/// the data leave a parameter undetermined.
pub fn covariance(jacobian: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    Some(information(jacobian).cholesky()?.inverse())
}

/// The Jacobian of a function at `x` by central differences, (f(x + h) − f(x − h))/2h for each parameter's step h.
pub fn central_differences(
    of: impl Fn(&DVector<f64>) -> DVector<f64>,
    x: &DVector<f64>,
    steps: &DVector<f64>,
) -> DMatrix<f64> {
    let columns: Vec<DVector<f64>> = steps
        .iter()
        .enumerate()
        .map(|(k, &step)| {
            let mut moved = x.clone();
            moved[k] += step;
            let ahead = of(&moved);
            moved[k] -= 2.0 * step;
            (ahead - of(&moved)) / (2.0 * step)
        })
        .collect();
    DMatrix::from_columns(&columns)
}

/// Minimises the cost of residuals from `start`, differentiating them by central differences with a step for each parameter.
///
/// # Errors
/// [`Failure`] where there are too few residuals, or residuals or derivatives that are not finite.
pub fn minimise(
    residuals: impl Fn(&DVector<f64>) -> DVector<f64>,
    start: DVector<f64>,
    steps: &DVector<f64>,
    options: &Options,
) -> Result<Solution, Failure> {
    solve(&Differentiated { residuals, steps }, start, options)
}

struct Differentiated<'a, F> {
    residuals: F,
    steps: &'a DVector<f64>,
}

impl<F: Fn(&DVector<f64>) -> DVector<f64>> Problem for Differentiated<'_, F> {
    type Evaluation = DVector<f64>;

    fn evaluate(&self, parameters: &DVector<f64>, _: Option<&DVector<f64>>) -> Option<DVector<f64>> {
        Some((self.residuals)(parameters))
    }

    fn residuals(&self, evaluation: &DVector<f64>) -> DVector<f64> {
        evaluation.clone()
    }

    fn jacobian(&self, parameters: &DVector<f64>, _: &DVector<f64>) -> DMatrix<f64> {
        central_differences(&self.residuals, parameters, self.steps)
    }
}

/// Minimises the cost of a problem from `start`, which is moved into the bounds if it lies outside.
///
/// # Errors
/// [`Failure`] where there are too few residuals, or residuals or derivatives that are not finite.
pub fn solve<P: Problem>(
    problem: &P,
    start: DVector<f64>,
    options: &Options,
) -> Result<Solution<P::Evaluation>, Failure> {
    let mut at = Point::evaluate(problem, options, options.clamped(start), None).ok_or(Failure::NotFinite)?;
    let (residuals, parameters) = (at.residuals.len(), at.parameters.len());
    if residuals < parameters {
        return Err(Failure::TooFewResiduals { residuals, parameters });
    }
    let mut jacobian = DMatrix::zeros(residuals, parameters);
    let mut damping = FIRST_DAMPING;
    let (mut iterations, mut stopped) = (0, Stopped::IterationLimit);
    while iterations < options.most_iterations {
        iterations += 1;
        jacobian = problem.jacobian(&at.parameters, &at.evaluation);
        if jacobian.iter().any(|slope| !slope.is_finite()) {
            return Err(Failure::NotFinite);
        }
        let Some(next) = at.descended(problem, options, &jacobian, &mut damping) else {
            stopped = Stopped::NoDescent;
            break;
        };
        let decrease = at.cost - next.cost;
        at = next;
        if decrease <= options.tolerance(at.cost) {
            stopped = Stopped::SmallDecrease;
            break;
        }
    }
    let Point { parameters, evaluation, residuals, cost } = at;
    Ok(Solution { parameters, evaluation, residuals, jacobian, cost, iterations, stopped })
}

/// Parameters with all that follows from them.
struct Point<E> {
    parameters: DVector<f64>,
    evaluation: E,
    residuals: DVector<f64>,
    cost: f64,
}

impl<E> Point<E> {
    /// `None` where the residuals are not finite.
    fn evaluate<P: Problem<Evaluation = E>>(
        problem: &P,
        options: &Options,
        parameters: DVector<f64>,
        near: Option<&E>,
    ) -> Option<Self> {
        let evaluation = problem.evaluate(&parameters, near)?;
        let residuals = problem.residuals(&evaluation);
        let loss = residuals.iter().map(|&residual| options.loss.rho(residual));
        let cost: f64 = match problem.weights() {
            None => loss.sum(),
            Some(weights) => loss.zip(weights.iter()).map(|(loss, weight)| weight * loss).sum(),
        };
        cost.is_finite().then_some(Self { parameters, evaluation, residuals, cost })
    }

    /// The point after one step that lowers the cost; `None` where no damping gives one.
    fn descended<P: Problem<Evaluation = E>>(
        &self,
        problem: &P,
        options: &Options,
        jacobian: &DMatrix<f64>,
        damping: &mut f64,
    ) -> Option<Self> {
        let mut weights = self.residuals.map(|residual| options.loss.weight(residual));
        if let Some(fixed) = problem.weights() {
            weights.component_mul_assign(fixed);
        }
        let (mut information, mut slope) = normal_equations(jacobian, &self.residuals, &weights);
        options.hold_at_bounds(&self.parameters, &mut information, &mut slope);
        for _ in 0..options.most_dampings {
            if let Some(step) = options.step_inside(&self.parameters, &information, &slope, *damping) {
                let promised = promised_decrease(&information, &slope, &step);
                let to = options.clamped(&self.parameters + step);
                let next = Self::evaluate(problem, options, to, Some(&self.evaluation));
                if let Some(next) = next.filter(|next| next.cost < self.cost) {
                    *damping = (*damping / DAMPING_FACTOR).max(LEAST_DAMPING);
                    return Some(next);
                }
                // The linearisation itself promises no more than rounding or the tolerance hides.
                if promised <= options.tolerance(self.cost) {
                    return None;
                }
            }
            *damping = (*damping * DAMPING_FACTOR).max(LEAST_DAMPING_AFTER_FAILURE);
        }
        None
    }
}

/// s of (H + μ diag H) s = −g. A parameter that no residual depends on stays where it is.
fn damped_step(information: &DMatrix<f64>, slope: &DVector<f64>, damping: f64) -> Option<DVector<f64>> {
    let mut damped = information.clone();
    for j in 0..slope.len() {
        let own = information[(j, j)];
        damped[(j, j)] += damping * if own > 0.0 { own } else { 1.0 };
    }
    Some(-damped.cholesky()?.solve(slope))
}

/// By how much a step lowers the cost of the linearised residuals: −2 gᵗs − sᵗHs.
fn promised_decrease(information: &DMatrix<f64>, slope: &DVector<f64>, step: &DVector<f64>) -> f64 {
    -2.0 * slope.dot(step) - step.dot(&(information * step))
}

impl Options {
    fn tolerance(&self, cost: f64) -> f64 {
        self.least_decrease.max(self.least_relative_decrease * cost)
    }

    fn clamped(&self, parameters: DVector<f64>) -> DVector<f64> {
        match &self.bounds {
            None => parameters,
            Some((lower, upper)) => parameters.sup(lower).inf(upper),
        }
    }

    /// The damped step, inside the box and no longer than [`most_step`](Self::most_step). Parameters that it would carry out are carried to the edge
    /// alone, and the others follow: a step that was only projected may lead uphill, where two parameters change much alike.
    fn step_inside(
        &self,
        at: &DVector<f64>,
        information: &DMatrix<f64>,
        slope: &DVector<f64>,
        damping: f64,
    ) -> Option<DVector<f64>> {
        let (mut least, mut most) =
            (DVector::repeat(at.len(), f64::NEG_INFINITY), DVector::repeat(at.len(), f64::INFINITY));
        if let Some((lower, upper)) = &self.bounds {
            (least, most) = (lower - at, upper - at);
        }
        if let Some(longest) = &self.most_step {
            (least, most) = (least.sup(&-longest), most.inf(longest));
        }
        let (mut information, mut slope) = (information.clone(), slope.clone());
        // Damping belongs to what is free; a parameter at the edge stays there.
        let mut held: Vec<Option<f64>> = vec![None; at.len()];
        loop {
            let mut step = damped_step(&information, &slope, damping)?;
            held.iter().enumerate().for_each(|(j, held)| step[j] = held.unwrap_or(step[j]));
            let leaves = |&j: &usize| held[j].is_none() && (step[j] < least[j] || step[j] > most[j]);
            let leaving: Vec<usize> = (0..at.len()).filter(leaves).collect();
            if leaving.is_empty() {
                return Some(step);
            }
            for j in leaving {
                let edge = step[j].clamp(least[j], most[j]);
                held[j] = Some(edge);
                slope += information.column(j) * edge;
                hold(j, &mut information, &mut slope);
            }
        }
    }

    /// Takes parameters that lie on a bound, and that descent would push out of the box, out of the normal equations.
    fn hold_at_bounds(&self, parameters: &DVector<f64>, information: &mut DMatrix<f64>, slope: &mut DVector<f64>) {
        let Some((lower, upper)) = &self.bounds else { return };
        for j in 0..parameters.len() {
            let leaves = (parameters[j] <= lower[j] && slope[j] > 0.0) || (parameters[j] >= upper[j] && slope[j] < 0.0);
            if leaves {
                hold(j, information, slope);
            }
        }
    }
}

/// Takes a parameter out of the normal equations.
fn hold(j: usize, information: &mut DMatrix<f64>, slope: &mut DVector<f64>) {
    slope[j] = 0.0;
    information.fill_row(j, 0.0);
    information.fill_column(j, 0.0);
    information[(j, j)] = 1.0;
}

#[cfg(test)]
mod tests;
