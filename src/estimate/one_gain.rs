//! One gain for all bends: the estimate that stands in where the recursion has none, or knows η no better than before.
//!
//! The recursion weights measurements as if the model were right, and its gate and its first estimate follow from that. On a machine that departs from the
//! model by many times the noise, they hold on to the few measurements that happen to agree, and η comes out anywhere. What is left to say
//! there is how far the snake bends for what its encoders read: with u = Q⁺q̃ the least-squares gain g of b = g u under Huber's loss, in units of the
//! residuals' own scale. Since 1/g = 1 + ηk with the model's k, that is an η; λ is the median of the common part less what friction
//! explains. Both σ come from the residuals, whose serial correlation counts.

use super::filter::KNOWN_SD;
use super::friction::friction_covariance;
use super::initial::MOST;
use super::usable::usable;
use super::{NewPoses, pairs_without_effects};
use crate::observation::{EncoderReading, Measurement};
use crate::robot::{DataRange, Estimate, Model, PerBackbone};
use crate::statistics::binomial;
use crate::statistics::correlation::SerialScatter;
use crate::statistics::order::{mad_scale, median};
use crate::statistics::robust::{HUBER_LIMIT, Loss};
use crate::statistics::spread::Spread;
use nalgebra::{Matrix2, Vector1, Vector2};
use std::f64::consts::PI;

/// Measurements that a result is judged by; of more, as many spread over the run. Convention: a resource limit, far beyond what the tests need.
pub(crate) const MOST_JUDGED: usize = 2000;
/// The probability with which an estimate that is as good as one gain is kept for better. Convention: that of the verdict's tests.
const LEVEL: f64 = 0.001;
/// Rounds of reweighting. Convention: each changes the gain by a share of the one before; ten are beyond its digits.
const ROUNDS: usize = 10;
/// The bend at which k is taken, rad. Convention: k is the same at all bends but for some per mille.
const BEND: f64 = 0.5;

/// The median length of a residual whose two numbers have the standard deviation 1.
///
/// Derived: √(2 ln 2), of the Rayleigh distribution.
const MEDIAN_SIZE: f64 = 1.177_410;

/// That one gain took the recursion's place, and why.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Replaced {
    /// Poses whose bend one gain predicts better; of all where the recursion gave no estimate.
    pub better: usize,
    /// Poses that were compared.
    pub of: usize,
}

/// The model, with its estimate replaced by one gain for all bends if the estimate is missing or its σ of η is above 1. An estimate that
/// predicts more bends better than the gain (sign test over poses) is kept.
pub fn or_one_gain(model: Model, measurements: &[Measurement], log: &[EncoderReading]) -> (Model, Option<Replaced>) {
    let mut points = Spread::new(MOST_JUDGED);
    let mut poses = NewPoses::default();
    let mut learned = DataRange::default();
    for (measurement, reading) in pairs_without_effects(&model, measurements, log) {
        let Ok((measured, q_mm)) = usable(model.robot.backbone_count(), &measurement, reading.as_ref()) else {
            continue;
        };
        let bend = measured.configuration.bend_vector();
        learned.add(measured.configuration, measured.sigma_theta, measured.sigma_delta);
        if !poses.is_new(bend) {
            continue;
        }
        points.add((bend, q_mm));
    }
    let points = points.kept;
    let Some(estimate) = one_gain(&model, &points) else { return (model, None) };
    let candidate = Model { learned: Some(learned), ..model.without_estimate() }.with_estimate(estimate);
    let miss = |model: &Model, bend: Vector2<f64>, q: &_| model.plain().forward_bend(q).map(|b| (b - bend).norm()).ok();
    let better = |&&(bend, ref q): &&(Vector2<f64>, _)| match (miss(&candidate, bend, q), miss(&model, bend, q)) {
        (Some(one), Some(own)) => one < own,
        (Some(_), None) => true,
        _ => false,
    };
    let (better, of) = (points.iter().filter(better).count(), points.len());
    let is_known = model.estimate().is_some_and(|estimate| estimate.sd_eta() <= KNOWN_SD);
    let is_worse = model.estimate().is_some() && binomial::at_least(of - better, of, 0.5) < LEVEL;
    let replaces = !is_known && !is_worse;
    if replaces { (candidate, Some(Replaced { better, of })) } else { (model, None) }
}

/// η and λ of one gain; `None` where the bends do not tell it.
fn one_gain(model: &Model, points: &[(Vector2<f64>, PerBackbone)]) -> Option<Estimate> {
    let robot = &model.robot;
    let by_q = robot.bend_by_displacement();
    let implied: Vec<Vector2<f64>> = points.iter().map(|(_, q)| by_q.tr_mul(q)).collect();
    let mut weights = vec![1.0; points.len()];
    let (mut gain, mut information, mut residuals) = (0.0, 0.0, Vec::new());
    for _ in 0..ROUNDS {
        let rows = || points.iter().zip(&implied).zip(&weights);
        information = rows().map(|((_, u), weight)| weight * u.norm_squared()).sum();
        gain = rows().map(|(((bend, _), u), weight)| weight * u.dot(bend)).sum::<f64>() / information;
        residuals = points.iter().zip(&implied).map(|((bend, _), u)| bend - u * gain).collect::<Vec<_>>();
        let sizes: Vec<f64> = residuals.iter().map(|residual| residual.norm()).collect();
        let scale = (median(&mut sizes.clone()) / MEDIAN_SIZE).max(f64::MIN_POSITIVE);
        weights = sizes.iter().map(|size| Loss::Huber(HUBER_LIMIT).weight(size / scale)).collect();
    }
    // Fewer than the recursion judges together are fitted by anything.
    if points.len() < MOST || !gain.is_finite() || gain <= 0.0 {
        return None;
    }
    let mut scatter = SerialScatter::<2>::new(1);
    residuals.iter().for_each(|residual| scatter.add(*residual));
    let sd_gain = (scatter.reduced_chi_square() * scatter.design_effect() / information).sqrt();
    let k = line_share(model);
    let eta = (1.0 / gain - 1.0) / k;
    let sd_eta = sd_gain / (gain * gain * k);
    let (lambda_mm, sd_lambda_mm) = play(model, points);
    Some(Estimate {
        eta,
        lambda_mm,
        covariance: Matrix2::from_diagonal(&Vector2::new(sd_eta, sd_lambda_mm).map(|sd| sd * sd))
            + friction_covariance(model, eta),
        samples: points.len(),
    })
    .filter(|estimate| estimate.eta.is_finite() && estimate.sd_eta().is_finite())
}

/// k: what η adds to the readings, as a share of the bend.
pub(crate) fn line_share(model: &Model) -> f64 {
    let by_eta = model.plain().epsilon_by_parameters(Vector2::new(BEND, 0.0)).column(0);
    model.robot.bend_by_displacement().tr_mul(&by_eta).x / BEND
}

/// λ and its standard deviation, mm: the median of the readings' common part, less static friction.
fn play(model: &Model, points: &[(Vector2<f64>, PerBackbone)]) -> (f64, f64) {
    let mut common: Vec<f64> = points.iter().map(|(_, q)| q.mean() - model.static_friction_mm()).collect();
    let mut scatter = SerialScatter::<1>::new(1);
    let centre = median(&mut common.clone());
    common.iter().for_each(|value| scatter.add(Vector1::new(value - centre)));
    // The median of n normal values has π/2 times the variance of their mean.
    let variance_of_mean = mad_scale(common.drain(..)).powi(2) * scatter.design_effect() / points.len() as f64;
    (centre, (PI / 2.0 * variance_of_mean).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{Options, estimate};
    use crate::robot::Effect;
    use crate::simulate::{BendingExperiment, Plant, SimulatedEye};

    fn experiment(effects: &[&str], seed: u64) -> (Vec<Measurement>, Vec<EncoderReading>) {
        let effects = effects.iter().map(|text| Effect::parse(text).unwrap()).collect();
        let model = Model { effects, eta: 1.221, lambda_mm: 0.1765, samples: Some(0), ..Model::default() };
        let samples =
            Plant { model, sd_encoder_mm: 0.0015 }.run(&BendingExperiment::default().waypoints().unwrap(), seed);
        (SimulatedEye::default().observe(&samples, seed + 1), samples.iter().map(|sample| sample.reading).collect())
    }

    #[test]
    fn one_gain_is_the_truth_within_its_sigma_where_the_model_holds_and_replaces_nothing() {
        for seed in [1, 20, 300] {
            let (measurements, log) = experiment(&[], seed);
            let (_, model) = estimate(&Model::default(), Options::default(), &measurements, &log).unwrap();
            assert_eq!(or_one_gain(model.clone(), &measurements, &log), (model, None));
            // Without an estimate it is what there is.
            let (model, replaced) = or_one_gain(Model::default(), &measurements, &log);
            let found = model.estimate().unwrap();
            assert!(replaced.is_some() && (found.eta - 1.221).abs() < 4.0 * found.sd_eta(), "{found:?}");
            assert!((found.lambda_mm - 0.1765).abs() < 0.002 && found.sd_eta() < 0.02, "{found:?}");
        }
    }

    #[test]
    fn an_estimate_that_knows_nothing_of_eta_is_replaced() {
        let (measurements, log) = experiment(&["superelastic_softening:softening_per_rad2=0.1"], 5);
        let wrong = Estimate { eta: 0.4, lambda_mm: 0.1, covariance: Matrix2::identity() * 4.0, samples: 8 };
        let (model, replaced) = or_one_gain(Model::default().with_estimate(wrong), &measurements, &log);
        let Replaced { better, of } = replaced.unwrap();
        assert!(better > of / 2 && model.parameters().x > 0.8, "{model:?}");
        assert_eq!(or_one_gain(Model::default(), &measurements[..4], &log).1, None, "four bends are too few");
    }
}
