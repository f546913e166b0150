//! The start of the recursion: η and λ from a few measurements of which some may be outliers.
//!
//! Least trimmed squares over all pairs of the measurements finds the majority that agrees best; those within the gate of the
//! majority's estimate join it. With two measurements there is one pair: the paper's first estimate.

use super::effects::EffectsPrior;
use super::gate::{self, SquaredDistances, distrust, squared_distances};
use super::{InformationFilter, LinearisedMeasurement, Options, Reason, Sample};
use crate::robot::Model;
use crate::statistics::trimmed::{least_trimmed_squares, majority, subsets};
use nalgebra::{DMatrix, DVector, Vector3};

/// The most measurements that are taken together.
///
/// Fitted: chosen on the simulated experiments of `tests/library/estimator.rs`, whose first two measurements are outliers; not judged elsewhere. Least
/// trimmed squares of eight bears three outliers.
pub(super) const MOST: usize = 8;
/// Concentration steps from each pair.
///
/// Source: Rousseeuw and Van Driessen 2006, who take two before they choose among starts.
const CONCENTRATION_STEPS: usize = 2;
/// How often the gate is asked which measurements join the majority.
///
/// Convention: once for the majority's estimate, once for that of all who joined.
const GATE_ROUNDS: usize = 2;

/// A measurement whose verdict may still change.
#[derive(Debug, Clone)]
pub(super) struct Undecided {
    /// Counted in updates of the estimator from 0.
    pub update: usize,
    pub sample: Sample,
    /// Whether it was last reported as used.
    pub reported_used: bool,
}

impl Undecided {
    /// Linearised under a model with the estimate so far, if there is one.
    pub fn linearised(&self, model: &Model, options: &Options) -> LinearisedMeasurement {
        LinearisedMeasurement::new(model, options.weighting, options.sd_encoder_mm, &self.sample)
    }
}

/// What a few measurements say together, and which of them are outliers.
pub(super) struct InitialEstimate {
    /// The information of the measurements that are no outliers.
    pub filter: InformationFilter,
    pub x: DVector<f64>,
    pub covariance: DMatrix<f64>,
    /// All measurements, linearised.
    pub linearised: Vec<LinearisedMeasurement>,
    /// For each, why it is an outlier.
    pub outliers: Vec<Option<Reason>>,
}

impl InitialEstimate {
    /// Of these samples, on the robot and the friction of `model`, and of what is known of its effects beforehand; `None` while they do not
    /// pin η and λ.
    pub fn of(samples: &[Undecided], model: &Model, prior: &EffectsPrior, options: &Options) -> Option<Self> {
        let linearised_under = |model: &Model| samples.iter().map(|sample| sample.linearised(model, options)).collect();
        // Weights need an η; that of the naive model does for a first estimate, that of the first for the second.
        let naive = model.without_estimate();
        let first = Self::trimmed(linearised_under(&naive), prior, options.gate)?;
        if first.x[0] <= 0.0 {
            return Some(first);
        }
        let mut informed = Model { eta: first.x[0], lambda_mm: first.x[1], samples: Some(0), ..naive };
        informed.covariance.view_mut((0, 0), (2, 2)).copy_from(&first.covariance.view((0, 0), (2, 2)));
        Self::trimmed(linearised_under(&informed), prior, options.gate).or(Some(first))
    }

    /// Least trimmed squares, and all within the gate of it.
    fn trimmed(linearised: Vec<LinearisedMeasurement>, prior: &EffectsPrior, gate_sds: f64) -> Option<Self> {
        let count = linearised.len();
        let filter = |members: &[usize]| {
            let mut filter = InformationFilter::new(prior);
            members.iter().for_each(|&k| filter.absorb(&linearised[k]));
            filter
        };
        let kept = least_trimmed_squares(
            count,
            majority(count),
            subsets(count, 2, MOST * (MOST - 1) / 2, 0),
            CONCENTRATION_STEPS,
            |members| Some(filter(members).solution()?.0),
            |x, k| squared_misfit(&linearised[k], x),
        )?;
        let mut members = kept.members;
        let mut outliers = vec![None; count];
        for _ in 0..GATE_ROUNDS {
            let (x, covariance) = filter(&members).solution()?;
            let distances: Vec<_> = linearised.iter().map(|one| distances_from(one, &x, &covariance)).collect();
            outliers = gated(&distances, gate_sds);
            members = (0..count).filter(|&k| outliers[k].is_none()).collect();
        }
        let filter = filter(&members);
        let (x, covariance) = filter.solution()?;
        Some(Self { filter, x, covariance, linearised, outliers })
    }

    /// The measurements that are no outliers.
    pub fn agreeing(&self) -> impl Iterator<Item = &LinearisedMeasurement> {
        self.linearised.iter().zip(&self.outliers).filter(|(_, outlier)| outlier.is_none()).map(|(one, _)| one)
    }

    /// All measurements' distances from the estimate.
    pub fn squared_distances(&self) -> impl Iterator<Item = SquaredDistances> {
        self.linearised.iter().filter_map(|one| distances_from(one, &self.x, &self.covariance))
    }
}

/// The distances of a measurement from what an x̂ with its covariance predicts.
fn distances_from(
    one: &LinearisedMeasurement,
    x: &DVector<f64>,
    covariance: &DMatrix<f64>,
) -> Option<SquaredDistances> {
    squared_distances(one, &one.residual(x.as_slice()), &one.predicted(covariance))
}

/// Which distances are beyond the gate; of two neither is, since two measurements always agree.
fn gated(distances: &[Option<SquaredDistances>], gate_sds: f64) -> Vec<Option<Reason>> {
    let outlier = |squared: &Option<SquaredDistances>| match squared {
        Some(squared) if distances.len() > 2 => gate::outlier(gate_sds, squared, distances.iter().flatten()),
        Some(_) => None,
        None => Some(Reason::NotFinite),
    };
    distances.iter().map(outlier).collect()
}

/// rᵗR⁻¹r of a measurement at x, as the gate trusts it; infinite where R is not positive definite.
fn squared_misfit(linearised: &LinearisedMeasurement, x: &DVector<f64>) -> f64 {
    let factor = (linearised.covariance + distrust(linearised)).cholesky();
    let whitened =
        factor.and_then(|factor| factor.l_dirty().solve_lower_triangular(&linearised.residual(x.as_slice())));
    whitened.map_or(f64::INFINITY, |whitened: Vector3<f64>| whitened.norm_squared())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Configuration;
    use crate::observation::Measured;
    use nalgebra::Vector2;

    /// Exact measurements of a robot with η = 1.221 and λ = 0.1765 mm; those in `wrong` are of a bend 10° off.
    fn samples(count: usize, wrong: &[usize]) -> Vec<Undecided> {
        let robot = Model { eta: 1.221, lambda_mm: 0.1765, samples: Some(0), ..Model::default() };
        (0..count)
            .map(|update| {
                let psi = Configuration::from_degrees(20.0 + 7.0 * update as f64, 50.0 * update as f64);
                let off = if wrong.contains(&update) { 10.0 } else { 0.0 };
                let configuration = Configuration::from_degrees(psi.theta_deg() + off, psi.delta_deg());
                let sigma = 0.1f64.to_radians();
                let measured = Measured::independent(configuration, sigma, sigma, 0.0);
                let sample = Sample { measured, q_tilde: robot.command(psi), came: None };
                Undecided { update, sample, reported_used: true }
            })
            .collect()
    }

    #[test]
    fn any_three_outliers_of_eight_are_named_and_have_no_say() {
        for wrong in subsets(8, 3, 100, 0) {
            let found = InitialEstimate::of(
                &samples(8, &wrong),
                &Model::default(),
                &EffectsPrior::default(),
                &Options::default(),
            )
            .unwrap();
            let named: Vec<usize> = (0..8).filter(|&k| found.outliers[k].is_some()).collect();
            assert_eq!(named, wrong);
            assert!((&found.x - Vector2::new(1.221, 0.1765)).norm() < 1e-3, "{}", found.x);
            assert_eq!(found.filter.measurements(), 5);
        }
    }

    #[test]
    fn two_measurements_are_the_papers_first_estimate_and_one_is_none() {
        let found =
            InitialEstimate::of(&samples(2, &[]), &Model::default(), &EffectsPrior::default(), &Options::default())
                .unwrap();
        assert!((&found.x - Vector2::new(1.221, 0.1765)).norm() < 1e-3, "{}", found.x);
        assert_eq!(found.outliers, [None, None]);
        assert!(
            InitialEstimate::of(&samples(1, &[]), &Model::default(), &EffectsPrior::default(), &Options::default())
                .is_none()
        );
    }
}
