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
//! the parameters' units. A parameter that lies on a bound and would leave the box is held there for the step; a step that leaves
//! the box is projected onto it.
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
    Some(jacobian.tr_mul(jacobian).cholesky()?.inverse())
}

/// JᵗWJ and JᵗWr with W = diag(weights): a step −(JᵗWJ)⁻¹JᵗWr minimises Σ w r² of the linearised residuals.
pub fn normal_equations(
    jacobian: &DMatrix<f64>,
    residuals: &DVector<f64>,
    weights: &DVector<f64>,
) -> (DMatrix<f64>, DVector<f64>) {
    let mut weighted = jacobian.clone();
    for mut column in weighted.column_iter_mut() {
        column.component_mul_assign(weights);
    }
    (jacobian.tr_mul(&weighted), weighted.tr_mul(residuals))
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
            if let Some(step) = damped_step(&information, &slope, *damping) {
                let to = options.clamped(&self.parameters + step);
                let promised = promised_decrease(&information, &slope, &(&to - &self.parameters));
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

    /// Takes parameters that lie on a bound, and that descent would push out of the box, out of the normal equations.
    fn hold_at_bounds(&self, parameters: &DVector<f64>, information: &mut DMatrix<f64>, slope: &mut DVector<f64>) {
        let Some((lower, upper)) = &self.bounds else { return };
        for j in 0..parameters.len() {
            let leaves = (parameters[j] <= lower[j] && slope[j] > 0.0) || (parameters[j] >= upper[j] && slope[j] < 0.0);
            if leaves {
                slope[j] = 0.0;
                information.fill_row(j, 0.0);
                information.fill_column(j, 0.0);
                information[(j, j)] = 1.0;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steps(scale: &[f64]) -> DVector<f64> {
        DVector::from_column_slice(scale) * 1e-6
    }

    #[test]
    fn the_problem_of_rosenbrock_is_solved_from_the_usual_start() {
        // J. J. Moré, B. S. Garbow, K. E. Hillstrom, "Testing Unconstrained Optimization Software", ACM TOMS 7, 1981, no. 1.
        let residuals = |x: &DVector<f64>| DVector::from_column_slice(&[10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0]]);
        let start = DVector::from_column_slice(&[-1.2, 1.0]);
        let found = minimise(residuals, start, &steps(&[1.0, 1.0]), &Options::default()).unwrap();
        assert!((found.parameters - DVector::from_element(2, 1.0)).norm() < 1e-8);
        assert!(found.cost < 1e-16, "{}", found.cost);
    }

    /// y = b1 (1 − e^{−b2 x}): Misra1a of NIST's Statistical Reference Datasets (StRD), nonlinear regression, with certified
    /// values to eleven digits.
    const MISRA_1A: [(f64, f64); 14] = [
        (10.07, 77.6),
        (14.73, 114.9),
        (17.94, 141.1),
        (23.93, 190.8),
        (29.61, 239.9),
        (35.18, 289.0),
        (40.02, 332.8),
        (44.82, 378.4),
        (50.76, 434.8),
        (55.05, 477.3),
        (61.01, 536.8),
        (66.40, 593.1),
        (75.47, 689.1),
        (81.78, 760.0),
    ];

    fn misra_1a(x: &DVector<f64>) -> DVector<f64> {
        DVector::from_iterator(14, MISRA_1A.iter().map(|&(y, at)| x[0] * (1.0 - (-x[1] * at).exp()) - y))
    }

    #[test]
    fn nists_misra1a_is_certified_from_both_starts_with_its_standard_deviations() {
        for start in [[500.0, 1e-4], [250.0, 5e-4]] {
            let start = DVector::from_column_slice(&start);
            let found = minimise(misra_1a, start, &steps(&[100.0, 1e-4]), &Options::default()).unwrap();
            assert!((found.parameters[0] / 2.389_421_291_8e2 - 1.0).abs() < 1e-8, "{}", found.parameters);
            assert!((found.parameters[1] / 5.501_564_318_1e-4 - 1.0).abs() < 1e-8);
            assert!((found.cost / 1.245_513_889_4e-1 - 1.0).abs() < 1e-9);
            let variance = found.cost / 12.0;
            let sd = found.covariance().unwrap().diagonal().map(|own| (own * variance).sqrt());
            assert!((sd[0] / 2.707_007_524_1 - 1.0).abs() < 1e-6, "{sd}");
            assert!((sd[1] / 7.266_868_841_7e-6 - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn a_minimum_outside_the_bounds_is_found_at_their_edge() {
        // Of Misra1a with b1 held to 230 at most, b2 is the root of the remaining slope.
        let upper = DVector::from_column_slice(&[230.0, 1.0]);
        let options = Options { bounds: Some((DVector::zeros(2), upper)), ..Options::default() };
        let start = DVector::from_column_slice(&[200.0, 5e-4]);
        let found = minimise(misra_1a, start, &steps(&[100.0, 1e-4]), &options).unwrap();
        assert_eq!(found.parameters[0], 230.0);
        let alone = |x: &DVector<f64>| misra_1a(&DVector::from_column_slice(&[230.0, x[0]]));
        let start = DVector::from_element(1, 5e-4);
        let alone = minimise(alone, start, &steps(&[1e-4]), &Options::default()).unwrap();
        assert!((found.parameters[1] / alone.parameters[0] - 1.0).abs() < 1e-7);
        assert!(found.parameters[1] > 5.5e-4);
    }

    #[test]
    fn a_robust_loss_finds_hubers_location() {
        // Huber's estimate of location with limit k solves Σ ψ(y − m) = 0: of 0, 1, 2 and 30 with k = 3, three pull linearly
        // and one with k: 3 m − 3 = 3, so m = 2.
        let values = [0.0, 1.0, 2.0, 30.0];
        let residuals = |x: &DVector<f64>| DVector::from_iterator(4, values.iter().map(|y| x[0] - y));
        let options = Options { loss: Loss::Huber(3.0), ..Options::default() };
        let found = minimise(residuals, DVector::from_element(1, 20.0), &steps(&[1.0]), &options).unwrap();
        assert!((found.parameters[0] - 2.0).abs() < 1e-6, "{}", found.parameters[0]);
    }

    /// A line with a slope that its own evaluation remembers, and with rows that are left out.
    struct Line {
        weights: DVector<f64>,
    }

    impl Problem for Line {
        /// The residuals, and how many evaluations led here one from the other.
        type Evaluation = (DVector<f64>, usize);

        fn evaluate(&self, x: &DVector<f64>, near: Option<&Self::Evaluation>) -> Option<Self::Evaluation> {
            let residuals = [x[0] - 1.0, x[0] + x[1] - 3.0, x[0] + 2.0 * x[1] - 5.0, x[0] + 3.0 * x[1] - 100.0];
            Some((DVector::from_column_slice(&residuals), near.map_or(0, |near| near.1 + 1)))
        }

        fn residuals(&self, evaluation: &Self::Evaluation) -> DVector<f64> {
            evaluation.0.clone()
        }

        fn jacobian(&self, _: &DVector<f64>, _: &Self::Evaluation) -> DMatrix<f64> {
            DMatrix::from_fn(4, 2, |r, c| if c == 0 { 1.0 } else { r as f64 })
        }

        fn weights(&self) -> Option<&DVector<f64>> {
            Some(&self.weights)
        }
    }

    #[test]
    fn an_evaluation_starts_from_the_one_before_and_a_weight_of_zero_leaves_a_row_out() {
        let line = Line { weights: DVector::from_column_slice(&[1.0, 1.0, 1.0, 0.0]) };
        let found = solve(&line, DVector::zeros(2), &Options::default()).unwrap();
        assert!((found.parameters - DVector::from_column_slice(&[1.0, 2.0])).norm() < 1e-7);
        assert!(found.evaluation.1 > 0);
        assert_eq!(found.residuals.len(), 4, "the row that is left out has its residual");
    }

    #[test]
    fn a_parameter_without_influence_stays_and_what_cannot_be_solved_is_said() {
        let deaf = |x: &DVector<f64>| DVector::from_column_slice(&[x[0] - 2.0, x[0] - 4.0]);
        let start = DVector::from_column_slice(&[0.0, 7.0]);
        let found = minimise(deaf, start, &steps(&[1.0, 1.0]), &Options::default()).unwrap();
        assert!((found.parameters[0] - 3.0).abs() < 1e-7 && found.parameters[1] == 7.0);
        assert!(found.covariance().is_none());

        let one = |x: &DVector<f64>| DVector::from_element(1, x[0] + x[1]);
        let failure = minimise(one, DVector::zeros(2), &steps(&[1.0, 1.0]), &Options::default()).unwrap_err();
        assert_eq!(failure, Failure::TooFewResiduals { residuals: 1, parameters: 2 });
        let nowhere = |_: &DVector<f64>| DVector::from_element(3, f64::NAN);
        let failure = minimise(nowhere, DVector::zeros(2), &steps(&[1.0, 1.0]), &Options::default()).unwrap_err();
        assert_eq!(failure, Failure::NotFinite);
    }
}
