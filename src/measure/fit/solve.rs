//! Nonlinear least squares: the `levenberg-marquardt` crate behind a function that takes residuals as a closure.
//!
//! That crate is built on an older nalgebra than the rest; vectors cross here and nowhere else.

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::{DMatrix, DVector};
use nalgebra_034 as solver;

/// The minimum of a sum of squares.
#[derive(Debug, Clone)]
pub struct Solution {
    /// Where the minimum is.
    pub parameters: DVector<f64>,
    /// Residuals there.
    pub residuals: DVector<f64>,
    /// Their derivatives by the parameters there.
    pub jacobian: DMatrix<f64>,
}

impl Solution {
    /// [`covariance`] of the parameters.
    pub fn covariance(&self) -> Option<DMatrix<f64>> {
        covariance(&self.jacobian)
    }
}

/// (JᵗJ)⁻¹: the parameters' covariance if the residuals, whose Jacobian this is, are in units of their σ. `None` if the data
/// leave a parameter undetermined.
pub fn covariance(jacobian: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    Some(jacobian.tr_mul(jacobian).cholesky()?.inverse())
}

/// Minimises `½ ‖residuals(x)‖²` from `start`; `steps` are the parameters' scales for central differences.
///
/// `None` if the residuals are not finite at the start or there are fewer of them than parameters.
pub fn minimise(
    residuals: impl Fn(&DVector<f64>) -> DVector<f64>,
    start: DVector<f64>,
    steps: &DVector<f64>,
) -> Option<Solution> {
    let problem = Problem { current: residuals(&start), parameters: start, residuals, steps };
    if problem.current.len() < problem.parameters.len() || problem.current.iter().any(|r| !r.is_finite()) {
        return None;
    }
    let (problem, _) = LevenbergMarquardt::new().with_patience(30).minimize(problem);
    let jacobian = differences(&problem.residuals, &problem.parameters, problem.steps.as_slice());
    let finite = jacobian.iter().chain(problem.parameters.iter()).all(|v| v.is_finite());
    finite.then_some(Solution { parameters: problem.parameters, residuals: problem.current, jacobian })
}

struct Problem<'a, F> {
    residuals: F,
    parameters: DVector<f64>,
    current: DVector<f64>,
    steps: &'a DVector<f64>,
}

/// The Jacobian of a function at x by central differences with these steps.
fn differences(of: impl Fn(&DVector<f64>) -> DVector<f64>, x: &DVector<f64>, steps: &[f64]) -> DMatrix<f64> {
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

impl<F: Fn(&DVector<f64>) -> DVector<f64>> LeastSquaresProblem<f64, solver::Dyn, solver::Dyn> for Problem<'_, F> {
    type ResidualStorage = solver::VecStorage<f64, solver::Dyn, solver::U1>;
    type JacobianStorage = solver::VecStorage<f64, solver::Dyn, solver::Dyn>;
    type ParameterStorage = solver::VecStorage<f64, solver::Dyn, solver::U1>;

    fn set_params(&mut self, x: &solver::DVector<f64>) {
        self.parameters.copy_from_slice(x.as_slice());
        self.current = (self.residuals)(&self.parameters);
    }

    fn params(&self) -> solver::DVector<f64> {
        solver::DVector::from_column_slice(self.parameters.as_slice())
    }

    fn residuals(&self) -> Option<solver::DVector<f64>> {
        let finite = self.current.iter().all(|r| r.is_finite());
        finite.then(|| solver::DVector::from_column_slice(self.current.as_slice()))
    }

    fn jacobian(&self) -> Option<solver::DMatrix<f64>> {
        let jacobian = differences(&self.residuals, &self.parameters, self.steps.as_slice());
        let finite = jacobian.iter().all(|v| v.is_finite());
        finite.then(|| solver::DMatrix::from_column_slice(jacobian.nrows(), jacobian.ncols(), jacobian.as_slice()))
    }
}
