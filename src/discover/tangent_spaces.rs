//! The tangent space of every hypothesis: what its effect can do to the residuals, to first order.

use super::fit::Fit;
use super::hypotheses::{Hypothesis, one_effect_more};
use super::periodogram::{Waves, frequencies};
use super::residuals::Problem;
use crate::robot::Physics;
use crate::robot::effects::Starts;
use nalgebra::DMatrix;
use rayon::prelude::*;

/// Samples are thinned evenly until no more residuals than these are left.
///
/// Convention: a bound on memory and computing time.
const MOST_ROWS: usize = 3000;

/// The ridge that keeps a projection solvable, relative and absolute.
///
/// Convention: a numerical guard.
const RIDGE: f64 = 1e-12;

/// Columns shorter than this after orthogonalisation are taken for zero.
///
/// Convention: a numerical guard.
const LEAST_LENGTH: f64 = 1e-9;

/// One effect's tangent space at one start.
#[derive(Debug, Clone)]
pub struct TangentSpace {
    /// The effect; none for one frequency of a periodic effect, as only low ones are confounded with anything.
    pub physics: Option<&'static Physics>,
    /// What the information criterion charges for it.
    pub penalty: f64,
    /// Derivatives of the residuals by the effect's parameters in units of their scales; of a periodic effect, by its waves.
    pub columns: DMatrix<f64>,
    /// The same without what η, λ and the model's other effects can do as well.
    pub remaining: DMatrix<f64>,
}

impl TangentSpace {
    /// An orthonormal basis of what remains; columns without length are zero.
    pub fn orthonormal_basis(&self) -> DMatrix<f64> {
        let qr = self.remaining.clone().qr();
        let lengths = qr.r().diagonal();
        let mut basis = qr.q();
        for (mut column, length) in basis.column_iter_mut().zip(lengths.iter()) {
            if length.abs() < LEAST_LENGTH {
                column.fill(0.0);
            }
        }
        basis
    }
}

/// The tangent spaces of all hypotheses about a fit.
pub fn tangent_spaces(problem: &Problem, fit: &Fit) -> Vec<TangentSpace> {
    let data = problem.data;
    let n = data.backbones();
    let stride = data.residual_count().div_ceil(MOST_ROWS);
    let thinned = |columns: &DMatrix<f64>| -> DMatrix<f64> {
        let samples = data.len().div_ceil(stride);
        DMatrix::from_fn(n * samples, columns.ncols(), |r, c| columns[(n * (r / n * stride) + r % n, c)])
    };
    let base = thinned(&fit.jacobian);
    let p = base.ncols();
    let per_parameter = (data.residual_count() as f64).ln();
    let space = |physics: Option<&'static Physics>, parameters: usize, columns: DMatrix<f64>| {
        let remaining = without_projection(&base, &columns);
        TangentSpace { physics, penalty: per_parameter * parameters as f64, columns, remaining }
    };
    let is_periodic = |hypothesis: &Hypothesis| matches!(hypothesis.physics.starts, Starts::Periodogram(_));
    let (periodic, others): (Vec<_>, Vec<_>) = one_effect_more(problem, fit).into_iter().partition(is_periodic);
    let mut spaces: Vec<TangentSpace> = others
        .into_par_iter()
        .map(|hypothesis| {
            let jacobian = thinned(&hypothesis.one_step(problem, &fit.path).0);
            let own = jacobian.columns(p, jacobian.ncols() - p).into_owned();
            space(Some(hypothesis.physics), own.ncols(), own)
        })
        .collect();
    // A wave of every frequency, each with its pitch as a further parameter.
    if periodic.is_empty() {
        return spaces;
    }
    let waves = frequencies(data).into_par_iter().flat_map_iter(|frequency| {
        let Waves { common, separate } = Waves::new(problem, frequency);
        [space(None, 3, thinned(&common)), space(None, 2 + n, thinned(&separate))]
    });
    spaces.extend(waves.collect::<Vec<_>>());
    spaces
}

/// Columns less their projection on the span of a basis.
fn without_projection(basis: &DMatrix<f64>, columns: &DMatrix<f64>) -> DMatrix<f64> {
    let transposed = basis.transpose();
    let mut information = &transposed * basis;
    for j in 0..information.nrows() {
        information[(j, j)] = information[(j, j)] * (1.0 + RIDGE) + RIDGE;
    }
    match information.cholesky() {
        Some(factor) => columns - basis * factor.solve(&(transposed * columns)),
        None => columns.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_remains_is_at_right_angles_to_the_basis_and_nothing_of_its_span_is_left() {
        let basis = DMatrix::from_fn(20, 2, |row, c| (row as f64 + 1.0).powi(c as i32));
        let columns = DMatrix::from_fn(20, 2, |row, c| if c == 0 { 3.0 - row as f64 } else { (row as f64).sin() });
        let remaining = without_projection(&basis, &columns);
        assert!((basis.transpose() * &remaining).amax() < 1e-7);
        assert!(remaining.column(0).norm() < 1e-8 && remaining.column(1).norm() > 1.0);
    }

    #[test]
    fn the_basis_is_orthonormal_and_leaves_out_a_column_that_depends_on_another() {
        let remaining = DMatrix::from_fn(20, 2, |row, c| if c == 0 { row as f64 } else { 2.0 * row as f64 });
        let space = TangentSpace { physics: None, penalty: 0.0, columns: remaining.clone(), remaining };
        let basis = space.orthonormal_basis();
        assert!((basis.column(0).norm() - 1.0).abs() < 1e-12 && basis.column(1).norm() == 0.0);
    }
}
