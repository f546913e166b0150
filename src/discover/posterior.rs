//! The posterior over structures: which sets of effects the data leave open, how probable each is, and what the choice between them adds
//! to the covariance of the model that is chosen.

use super::data::Data;
use crate::geometry::Configuration;
use crate::robot::{Model, PerBackbone};
use nalgebra::{DMatrix, DVector};

/// The most bends at which commands are compared.
///
/// Convention: a bound on computing time; commands are smooth in the bend.
const MOST_BENDS: usize = 60;

/// Directions of the parameters of which a typical size changes the commands by less than this share of what the strongest does are not moved:
///
/// Convention: numerical; the commands' derivatives are differences.
const RELATIVE_LEAST: f64 = 1e-6;

/// A set of effects that the data leave open.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// Its effects beyond those of the model as given.
    pub effects: Vec<&'static str>,
    /// Its probability among all that are left open.
    pub probability: f64,
    /// The model with them, fitted.
    pub(super) model: Model,
}

/// What the choice of a structure adds to the covariance of the chosen model's parameters: Σ p δ δᵗ over the structures that are left
/// open, δ being the change of its parameters by which its commands come nearest to the other's, in the sense of least squares over the
/// measured bends. What no change of them can do is not in it.
///
/// Source: the variance between models of Hoeting et al. 1999, Bayesian model averaging: a tutorial, Stat. Sci. 14:382.
pub fn covariance_between(candidates: &[Candidate], chosen: &Model, data: &Data) -> DMatrix<f64> {
    let specs = chosen.parameter_specs();
    let mut covariance = DMatrix::zeros(specs.len(), specs.len());
    if candidates.len() < 2 {
        return covariance;
    }
    let stride = data.len().div_ceil(MOST_BENDS);
    let bends: Vec<Configuration> = data.measured.iter().step_by(stride).map(|m| m.configuration).collect();
    let by_parameters: Vec<Vec<PerBackbone>> =
        bends.iter().map(|bend| chosen.command_by_parameters(bend.bend_vector())).collect();
    let n = data.backbones();
    // In units of their typical sizes, since the parameters' own units are worlds apart.
    let tangent =
        DMatrix::from_fn(n * bends.len(), specs.len(), |row, j| by_parameters[row / n][j][row % n] * specs[j].typical);
    let tangent = tangent.svd(true, true);
    let least = RELATIVE_LEAST * tangent.singular_values.max();
    let commands = |model: &Model| {
        DVector::from_vec(
            bends.iter().flat_map(|bend| model.command(*bend).iter().copied().collect::<Vec<_>>()).collect(),
        )
    };
    let own = commands(chosen);
    for candidate in candidates {
        let apart = commands(&candidate.model) - &own;
        let is_finite = apart.iter().all(|mm| mm.is_finite());
        let Some(change) = is_finite.then(|| tangent.solve(&apart, least).ok()).flatten() else { continue };
        let change = DVector::from_fn(specs.len(), |j, _| change[j] * specs[j].typical);
        covariance += &change * change.transpose() * candidate.probability;
    }
    covariance
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::discover::fixture::{experiment, truth};
    use crate::robot::Effect;

    #[test]
    fn the_choice_between_two_etas_adds_the_variance_of_that_choice() {
        let data = experiment(1);
        let with = |eta: f64, probability: f64| {
            let mut values = truth().parameter_values();
            values[0] = eta;
            Candidate { effects: Vec::new(), probability, model: truth().with_parameter_values(&values) }
        };
        let chosen = with(1.2, 0.7);
        let between = covariance_between(&[chosen.clone(), with(1.25, 0.3)], &chosen.model, &data);
        assert!((between[(0, 0)] / (0.3 * 0.05f64.powi(2)) - 1.0).abs() < 1e-6, "{between}");
        assert!(between[(0, 1)].abs() < 1e-9 && between[(1, 1)].abs() < 1e-9, "{between}");
        assert_eq!(covariance_between(std::slice::from_ref(&chosen), &chosen.model, &data).amax(), 0.0);
    }

    #[test]
    fn sigmas_hold_what_the_parameters_can_do_of_the_difference_to_another_structure() {
        let data = experiment(1);
        let mut values = truth().parameter_values();
        values[1] += 0.02;
        // Offsets sum to zero over the backbones: no λ makes them, and η hardly.
        let mut other = truth().with_parameter_values(&values);
        other.effects.push(Effect::parse("actuator_offset:offset_1_mm=0.01,offset_2_mm=0").unwrap());
        let open = [(truth(), 0.8), (other, 0.2)].map(|(model, probability)| {
            let effects = model.effects.iter().map(|effect| effect.physics.name).collect();
            Candidate { effects, probability, model }
        });
        let mut model = truth();
        model.covariance = covariance_between(&open, &truth(), &data);
        let sds = model.command_sds(Configuration::from_degrees(50.0, 20.0));
        let expected = 0.2f64.sqrt() * 0.02;
        assert!(sds.iter().all(|sd| (sd / expected - 1.0).abs() < 0.1), "{sds:?} {expected}");
    }
}
