//! The tangent space of every hypothesis: what its effect can do to the residuals, to first order.

use super::fit::Fit;
use super::hypotheses::{FirstStep, is_periodic, thinned};
use super::periodogram::{Waves, frequencies};
use super::residuals::Problem;
use crate::robot::Physics;
use crate::statistics::projection::Complement;
use nalgebra::DMatrix;
use rayon::prelude::*;

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

/// The tangent spaces of all hypotheses about a fit, of which these are the first steps.
pub fn tangent_spaces(problem: &Problem, fit: &Fit, steps: &[FirstStep]) -> Vec<TangentSpace> {
    let data = problem.data;
    let beyond_fit = Complement::new(thinned(data, &fit.jacobian));
    let per_parameter = (data.residual_count() as f64).ln();
    let space = |physics: Option<&'static Physics>, parameters: usize, columns: DMatrix<f64>| {
        let remaining = beyond_fit.of(&columns);
        TangentSpace { physics, penalty: per_parameter * parameters as f64, columns, remaining }
    };
    let (periodic, others): (Vec<_>, Vec<_>) =
        steps.iter().partition(|step: &&FirstStep| is_periodic(step.hypothesis.physics));
    let of_step = |step: &FirstStep| space(Some(step.hypothesis.physics), step.columns.ncols(), step.columns.clone());
    let mut spaces: Vec<TangentSpace> = others.into_par_iter().map(of_step).collect();
    // A wave of every frequency, each with its pitch as a further parameter.
    if periodic.is_empty() {
        return spaces;
    }
    let waves = frequencies(data).into_par_iter().flat_map_iter(|frequency| {
        let Waves { common, separate } = Waves::new(problem, frequency);
        [space(None, 3, thinned(data, &common)), space(None, 2 + data.backbones(), thinned(data, &separate))]
    });
    spaces.extend(waves.collect::<Vec<_>>());
    spaces
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_basis_is_orthonormal_and_leaves_out_a_column_that_depends_on_another() {
        let remaining = DMatrix::from_fn(20, 2, |row, c| if c == 0 { row as f64 } else { 2.0 * row as f64 });
        let space = TangentSpace { physics: None, penalty: 0.0, columns: remaining.clone(), remaining };
        let basis = space.orthonormal_basis();
        assert!((basis.column(0).norm() - 1.0).abs() < 1e-12 && basis.column(1).norm() == 0.0);
    }
}
