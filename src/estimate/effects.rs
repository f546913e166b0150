//! The parameters of a model's effects that are not known exactly: they are estimated beside η and λ, from what the model says of them on.

use crate::robot::Model;
use crate::statistics::information::SquareRootInformation;
use nalgebra::{DMatrix, DVector};

/// Directions in which correlated parameters vary by less than this share of their variances are known no better than that.
///
/// Convention: numerical.
const SINGULAR: f64 = 1e-9;

/// The unit in which an uncertain parameter is estimated, in standard deviations: the parameters' own units are worlds apart.
///
/// Convention: what is said of a parameter is forgotten until its standard deviation is half a unit; what was known beforehand outweighs it then.
const UNIT_SDS: f64 = 100.0;

/// What is known beforehand of x: nothing of η and λ, and of the effects' uncertain parameters their covariance.
#[derive(Debug, Clone, Default)]
pub(super) struct EffectsPrior {
    /// Which of the model's parameters they are, with their units.
    parameters: Vec<(usize, f64)>,
    /// About x; `None` if no parameter is uncertain.
    pub information: Option<SquareRootInformation>,
}

impl EffectsPrior {
    /// Of a model's effects.
    pub fn of(model: &Model) -> Self {
        let (covariance, values) = (model.covariance(), model.parameter_values());
        let is_uncertain = |j: &usize| covariance[(*j, *j)] > 0.0 && covariance.row(*j).iter().all(|p| p.is_finite());
        let parameters: Vec<(usize, f64)> =
            (2..values.len()).filter(is_uncertain).map(|j| (j, UNIT_SDS * covariance[(j, j)].sqrt())).collect();
        if parameters.is_empty() {
            return Self::default();
        }
        let (m, at) = (parameters.len(), |k: usize| parameters[k]);
        let own = DMatrix::from_fn(m, m, |a, b| covariance[(at(a).0, at(b).0)] / (at(a).1 * at(b).1)).symmetric_eigen();
        let least = SINGULAR / (UNIT_SDS * UNIT_SDS);
        let precisions = own.eigenvalues.map(|variance| variance.max(least).sqrt().recip());
        let whitener = DMatrix::from_diagonal(&precisions) * own.eigenvectors.transpose();
        let z = &whitener * DVector::from_fn(m, |k, _| values[at(k).0] / at(k).1);
        let mut information = SquareRootInformation::none(2 + m);
        // Numbers that are not finite say nothing.
        let _ = information.absorb(&whitener.insert_columns(0, 2, 0.0), &z);
        Self { parameters, information: Some(information) }
    }

    /// The number of parameters that are estimated.
    pub fn count(&self) -> usize {
        2 + self.parameters.len()
    }

    /// The uncertain parameters, with the units that they are estimated in.
    pub fn parameters(&self) -> impl Iterator<Item = (usize, f64)> {
        self.parameters.iter().copied()
    }

    /// Gives a model that has its η and λ the effects' parameters of an x̂, within their ranges, and the covariance of all.
    pub fn place(&self, model: &mut Model, x: &DVector<f64>, covariance: &DMatrix<f64>) {
        if self.parameters.is_empty() {
            return;
        }
        let (mut values, specs) = (model.parameter_values(), model.parameter_specs());
        let mut all = DMatrix::zeros(values.len(), values.len());
        let places = || [(0, 1.0), (1, 1.0)].into_iter().chain(self.parameters()).enumerate();
        for (a, (j, unit)) in places() {
            if a > 1 {
                values[j] = (x[a] * unit).clamp(specs[j].range.0, specs[j].range.1);
            }
            places().for_each(|(b, (k, other))| all[(j, k)] = covariance[(a, b)] * unit * other);
        }
        *model = model.with_parameter_values(&values);
        model.covariance = all;
    }
}

#[cfg(test)]
mod tests;
