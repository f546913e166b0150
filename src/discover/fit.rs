//! The fit of a model to the samples: robust least squares over η, λ and the parameters of its effects.

use super::residuals::{Prediction, Problem, Residual, stacked};
use crate::robot::Model;
use crate::robot::effects::{COMMAND_GAIN, ParameterSpec};
use crate::robot::model::ETA;
use crate::statistics::cluster::clustered_covariance;
use crate::statistics::least_squares::covariance;
use crate::statistics::least_squares::{self, Options};
use crate::statistics::normal_equations::normal_equations as weighted_normal_equations;
use crate::statistics::robust::Loss;
use nalgebra::{DMatrix, DVector, Vector2};

/// What a whitened residual costs: a few samples at the edge of a sign must not name an effect.
///
/// Derived: with its limit at 3σ Huber's loss gives away 0.04 % of the efficiency on normal errors (Huber and Ronchetti, Robust
/// Statistics, 2nd ed., 4.5).
pub const LOSS: Loss = Loss::Huber(3.0);

/// The most Gauss–Newton steps, and the most dampings that are tried in each.
///
/// Convention: iteration caps.
const MOST_STEPS: (usize, usize) = (16, 6);

/// A step that lowers the cost by less than this, in squares of the noise, has converged.
///
/// Convention: a convergence tolerance; differences of the information criterion count from 6 on.
const CONVERGED: f64 = 0.02;

/// The same as a share of the cost, for models that are far off.
///
/// Convention: a convergence tolerance.
const CONVERGED_SHARE: f64 = 1e-4;

/// The same of a fit that is only compared with others, to first order about where it ends.
///
/// Convention: a tenth of what a [structure](super::search) may still promise.
const ROUGHLY_CONVERGED_SHARE: f64 = 0.01;

/// One step changes what is positive by this factor at most.
///
/// Convention: half of what lies between two starts of a time constant.
const MOST_FACTOR: f64 = 2.0;

/// What is added to the information, so that a parameter that the data do not determine has a standard deviation of a hundred
/// typical sizes and not of infinity.
///
/// Convention: a numerical guard.
const LEAST_INFORMATION: f64 = 1e-4;

/// Beside a free gain of the command η is known beforehand to lie about 1, as of a line that stretches by its compliance; this is the standard
/// deviation. The two are nearly one gain, and what of it is η hardly any data tell.
///
/// Source: Xu and Simaan 2006, whose robot has η = 1.22.
const SD_ETA_BESIDE_GAIN: f64 = 0.25;

/// A model fitted to the samples.
#[derive(Debug, Clone)]
pub struct Fit {
    /// The model, with η, λ and the parameters of its effects at their best.
    pub model: Model,
    /// Whitened residuals of each sample.
    pub residuals: Vec<Residual>,
    /// The bends that the encoders imply at every reading, rad.
    pub path: Vec<Vector2<f64>>,
    /// The sum of the residuals' losses.
    pub cost: f64,
    /// Derivatives of the residuals by the parameters in units of their scales, η and λ first.
    pub jacobian: DMatrix<f64>,
}

impl Fit {
    /// The number of parameters.
    pub fn parameter_count(&self) -> usize {
        self.jacobian.ncols()
    }

    /// The Bayesian information criterion (Schwarz 1978) with the effects' prior penalties; less is better.
    pub fn bic(&self) -> f64 {
        let prior: f64 = self.model.effects.iter().map(|effect| effect.physics.prior_penalty).sum();
        self.cost + self.parameter_count() as f64 * (self.jacobian.nrows() as f64).ln() + prior
    }
}

/// The sum of the losses of residuals.
pub fn cost(residuals: &[Residual]) -> f64 {
    residuals.iter().flat_map(|residual| residual.iter()).map(|&r| LOSS.rho(r)).sum()
}

/// JᵗWJ and JᵗWr with the loss's weights W.
pub fn normal_equations(jacobian: &DMatrix<f64>, residuals: &[Residual]) -> (DMatrix<f64>, DVector<f64>) {
    let residuals = stacked(residuals);
    weighted_normal_equations(jacobian, &residuals, &residuals.map(|r| LOSS.weight(r)))
}

/// The residual of what is known beforehand of η, and its derivative by η over its scale; 0 where no gain stands beside η.
fn prior_of_eta(model: &Model) -> (f64, f64) {
    let has_gain = model.effects.iter().any(|effect| effect.physics.name == COMMAND_GAIN);
    let precision = if has_gain { SD_ETA_BESIDE_GAIN.recip() } else { 0.0 };
    ((model.parameters().x - 1.0) * precision, ETA.typical * precision)
}

/// How precisely each parameter is known beforehand, in units of its scale.
pub fn prior_precision(model: &Model) -> DVector<f64> {
    let mut precision = DVector::repeat(model.parameter_count(), LEAST_INFORMATION);
    precision[0] += prior_of_eta(model).1.powi(2);
    precision
}

impl Problem<'_> {
    /// Fits η, λ and all parameters of the model's effects, starting from their values and from a path near that of the model.
    /// Samples of the fold `held_out` have no part in it.
    pub fn fit(&self, start: &Model, guess: Option<&[Vector2<f64>]>, held_out: Option<usize>) -> Fit {
        let weights = held_out.map(|fold| self.weights(|k| self.data.fold(k) != fold));
        self.fit_weighted(start, guess, weights, CONVERGED_SHARE)
    }

    /// The same to all samples, until a step brings little: near enough to tell to first order how well such a model can do.
    pub fn fit_roughly(&self, start: &Model, guess: Option<&[Vector2<f64>]>) -> Fit {
        self.fit_weighted(start, guess, None, ROUGHLY_CONVERGED_SHARE)
    }

    /// The same to the samples that are seen.
    pub fn fit_to(&self, start: &Model, guess: Option<&[Vector2<f64>]>, is_seen: impl Fn(usize) -> bool) -> Fit {
        self.fit_weighted(start, guess, Some(self.weights(is_seen)), CONVERGED_SHARE)
    }

    fn fit_weighted(
        &self,
        start: &Model,
        guess: Option<&[Vector2<f64>]>,
        weights: Option<DVector<f64>>,
        least_relative_decrease: f64,
    ) -> Fit {
        let coordinates = Coordinates::of(start);
        let bound = |of: fn(&(f64, f64)) -> f64| {
            coordinates.at_values(start.parameter_specs().iter().map(|spec| of(&spec.range)))
        };
        let options = Options {
            loss: LOSS,
            bounds: Some((bound(|range| range.0), bound(|range| range.1))),
            most_step: Some(coordinates.most_step()),
            most_iterations: MOST_STEPS.0,
            most_dampings: MOST_STEPS.1,
            least_decrease: CONVERGED,
            least_relative_decrease,
        };
        let x = coordinates.at_values(start.parameter_values().into_iter());
        let weights = weights.map(|weights| weights.push(1.0));
        let objective = Objective { problem: self, start, guess, coordinates, weights };
        match least_squares::solve(&objective, x, &options) {
            Ok(solution) => {
                let model = objective.model(&solution.parameters);
                let least_squares::Solution { parameters, evaluation, cost, jacobian, .. } = solution;
                let evaluation = evaluation.0;
                let path = evaluation.path();
                let cost = cost - LOSS.rho(prior_of_eta(&model).0);
                let mut jacobian = jacobian.rows(0, self.data.residual_count()).into_owned();
                let slopes = objective.coordinates.slopes(&parameters);
                jacobian.column_iter_mut().zip(slopes.iter()).for_each(|(mut column, slope)| column /= *slope);
                Fit { model, residuals: evaluation.residuals, path, cost, jacobian }
            }
            // More parameters than residuals, or no finite numbers: the start is as good as anything.
            Err(_) => self.evaluated(start, guess),
        }
    }

    /// A model as it is, with its residuals and their derivatives.
    pub fn evaluated(&self, model: &Model, guess: Option<&[Vector2<f64>]>) -> Fit {
        let prediction = self.predict(model, guess);
        let all = 0..model.parameter_specs().len();
        let (jacobian, path) = (self.jacobian(model, &prediction, all), prediction.path());
        let residuals = prediction.residuals;
        Fit { model: model.clone(), cost: cost(&residuals), residuals, path, jacobian }
    }

    /// 1 for the residuals of the samples that are seen, 0 for all others.
    fn weights(&self, is_seen: impl Fn(usize) -> bool) -> DVector<f64> {
        let n = self.data.backbones();
        DVector::from_fn(self.data.residual_count(), |row, _| f64::from(u8::from(is_seen(row / n))))
    }

    /// The fitted model with its covariance, (JᵗWJ)⁻¹.
    pub fn with_covariance(&self, fit: &Fit) -> Model {
        self.with_given_covariance(fit, inverse_information(fit))
    }

    /// The fitted model with a covariance that allows for residuals which hang together within sweeps. With too few sweeps for that,
    /// the samples of a sweep count as one.
    pub fn with_clustered_covariance(&self, fit: &Fit) -> Model {
        let (data, n) = (self.data, self.data.backbones());
        let residuals = stacked(&fit.residuals);
        let roots = residuals.map(|r| LOSS.weight(r).sqrt());
        let mut jacobian = fit.jacobian.clone();
        jacobian.row_iter_mut().zip(roots.iter()).for_each(|(mut row, root)| row *= *root);
        // Beyond the clusters, what is known beforehand.
        let count = n * data.len();
        let priors = DMatrix::from_diagonal(&prior_precision(&fit.model).map(f64::sqrt));
        let mut jacobian = jacobian.resize_vertically(count + priors.nrows(), 0.0);
        jacobian.rows_mut(count, priors.nrows()).copy_from(&priors);
        let residuals = residuals.component_mul(&roots).resize_vertically(count + priors.nrows(), 0.0);
        let clusters = (0..count).map(|row| data.sweeps[row / n]);
        let clustered = covariance(&jacobian)
            .and_then(|independent| clustered_covariance(&jacobian, &residuals, &independent, clusters, 1.0));
        let by_sweeps = data.len() as f64 / data.sweep_count() as f64;
        self.with_given_covariance(fit, clustered.or_else(|| Some(inverse_information(fit)? * by_sweeps)))
    }

    /// With the covariance of the parameters in units of their scales, if there is one.
    fn with_given_covariance(&self, fit: &Fit, inverse: Option<DMatrix<f64>>) -> Model {
        let mut model = fit.model.clone();
        let Some(inverse) = inverse else { return model };
        let specs = model.parameter_specs();
        model.samples = Some(self.data.len());
        let in_units = |a: usize, b: usize| inverse[(a, b)] * specs[a].typical * specs[b].typical;
        model.covariance = DMatrix::from_fn(specs.len(), specs.len(), in_units);
        model
    }
}

/// (JᵗWJ)⁻¹.
fn inverse_information(fit: &Fit) -> Option<DMatrix<f64>> {
    let (information, _) = normal_equations(&fit.jacobian, &fit.residuals);
    (information + DMatrix::from_diagonal(&prior_precision(&fit.model))).cholesky().map(|factor| factor.inverse())
}

/// The coordinates in which a fit moves: parameters over their scales; of what is positive, the logarithm of that. η, a time constant or a
/// pitch is known to within a factor: a linear step would carry it from a hundred seconds beyond its least.
struct Coordinates {
    typical: DVector<f64>,
    is_logarithm: Vec<bool>,
}

impl Coordinates {
    fn of(model: &Model) -> Self {
        let is_positive = |spec: &ParameterSpec| spec.range.0 > 0.0;
        Self { typical: scales(model), is_logarithm: model.parameter_specs().iter().map(is_positive).collect() }
    }

    fn at_values(&self, values: impl Iterator<Item = f64>) -> DVector<f64> {
        let all = values.zip(self.typical.iter()).zip(&self.is_logarithm);
        let all = all.map(|((value, typical), is_logarithm)| match is_logarithm {
            true => (value / typical).ln(),
            false => value / typical,
        });
        DVector::from_iterator(self.typical.len(), all)
    }

    fn values(&self, x: &DVector<f64>) -> Vec<f64> {
        let all = x.iter().zip(self.typical.iter()).zip(&self.is_logarithm);
        all.map(|((x, typical), is_logarithm)| typical * if *is_logarithm { x.exp() } else { *x }).collect()
    }

    fn most_step(&self) -> DVector<f64> {
        let all =
            self.is_logarithm.iter().map(|is_logarithm| if *is_logarithm { MOST_FACTOR.ln() } else { f64::INFINITY });
        DVector::from_iterator(self.is_logarithm.len(), all)
    }

    /// The derivatives of the parameters over their scales by the coordinates.
    fn slopes(&self, x: &DVector<f64>) -> DVector<f64> {
        let all = x.iter().zip(&self.is_logarithm).map(|(x, is_logarithm)| if *is_logarithm { x.exp() } else { 1.0 });
        DVector::from_iterator(x.len(), all)
    }
}

/// The least-squares problem of one fit.
struct Objective<'a> {
    problem: &'a Problem<'a>,
    start: &'a Model,
    guess: Option<&'a [Vector2<f64>]>,
    coordinates: Coordinates,
    weights: Option<DVector<f64>>,
}

impl Objective<'_> {
    fn model(&self, x: &DVector<f64>) -> Model {
        self.start.with_parameter_values(&self.coordinates.values(x))
    }
}

impl least_squares::Problem for Objective<'_> {
    /// What the model predicts, and the residual of what is known beforehand, which is the last.
    type Evaluation = (Prediction, f64);

    fn evaluate(&self, x: &DVector<f64>, near: Option<&Self::Evaluation>) -> Option<Self::Evaluation> {
        let (model, path) = (self.model(x), near.map(|near| near.0.path()));
        let prediction = self.problem.predict(&model, path.as_deref().or(self.guess));
        Some((prediction, prior_of_eta(&model).0))
    }

    fn residuals(&self, (prediction, prior): &Self::Evaluation) -> DVector<f64> {
        stacked(&prediction.residuals).push(*prior)
    }

    fn jacobian(&self, x: &DVector<f64>, (prediction, _): &Self::Evaluation) -> DMatrix<f64> {
        let model = self.model(x);
        let own = self.problem.jacobian(&model, prediction, 0..x.len());
        let rows = own.nrows();
        let mut all = own.insert_row(rows, 0.0);
        all[(rows, 0)] = prior_of_eta(&model).1;
        let slopes = self.coordinates.slopes(x);
        all.column_iter_mut().zip(slopes.iter()).for_each(|(mut column, slope)| column *= *slope);
        all
    }

    fn weights(&self) -> Option<&DVector<f64>> {
        self.weights.as_ref()
    }
}

/// The scales of a model's parameters.
pub fn scales(model: &Model) -> DVector<f64> {
    DVector::from_iterator(model.parameter_count(), model.parameter_specs().iter().map(|spec| spec.typical))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::discover::data::Data;
    use crate::discover::fixture::{experiment, truth};
    use crate::discover::noise::Noise;
    use crate::discover::sweeps::FOLDS;
    use crate::robot::Effect;

    #[test]
    fn eta_and_lambda_scatter_as_their_covariance_says() {
        let mut squares = 0.0;
        for seed in 0..40 {
            let data = experiment(seed);
            let problem = Problem::new(&data, &Noise::stated(&data), &truth());
            let fitted = problem.with_covariance(&problem.fit(&truth().without_estimate(), None, None));
            let error = fitted.parameters() - truth().parameters();
            let inverse = fitted.parameter_covariance().try_inverse().unwrap();
            squares += error.dot(&(inverse * error));
        }
        // χ² of 80 degrees of freedom lies between 53.5 and 112.3 in 98 of 100 (any table).
        assert!((53.5..112.3).contains(&squares), "{squares}");
    }

    #[test]
    fn what_is_positive_is_fitted_by_its_logarithm() {
        let mut model = truth();
        model.effects.push(Effect::parse("creep:share=0.1,time_constant_s=8").unwrap());
        let coordinates = Coordinates::of(&model);
        let values = model.parameter_values();
        let x = coordinates.at_values(values.iter().copied());
        assert!(coordinates.values(&x).iter().zip(&values).all(|(a, b)| (a / b - 1.0).abs() < 1e-12));
        // 0.5 s is the time constant's typical size.
        assert!((x[3] - 16f64.ln()).abs() < 1e-12 && (coordinates.slopes(&x)[3] - 16.0).abs() < 1e-9, "{x}");
        // η is 40 of its typical size; λ and a share may be negative or nothing.
        assert!(
            (coordinates.slopes(&x)[0] - 40.0).abs() < 1e-9
                && coordinates.slopes(&x).rows(1, 2) == x.rows(1, 2).map(|_| 1.0)
        );
    }

    #[test]
    fn an_effect_that_is_not_there_does_not_make_a_fit_worse_and_stays_in_its_range() {
        let data = experiment(2);
        let problem = Problem::new(&data, &Noise::stated(&data), &truth());
        let mut start = truth();
        start.effects.push(Effect::parse("creep:share=0.02,time_constant_s=0.5").unwrap());
        let fit = problem.fit(&start, None, None);
        // Nothing creeps: whatever the shape is, no step makes the fit worse than without.
        assert!(fit.cost <= problem.fit(&truth(), None, None).cost + 0.1, "{}", fit.cost);
        let bounds = fit.model.parameter_specs()[3].range;
        assert!((bounds.0..=bounds.1).contains(&fit.model.parameter_values()[3]));
    }

    #[test]
    fn samples_of_a_fold_held_out_have_no_part_in_the_fit() {
        let mut data = experiment(3);
        let fit = |data: &Data| {
            Problem::new(data, &Noise::stated(data), &truth()).fit(&truth(), None, Some(1)).model.parameters()
        };
        let before = fit(&data);
        for k in (0..data.len()).filter(|&k| data.sweeps[k] % FOLDS == 1) {
            data.measured[k].configuration.theta += 0.1;
        }
        assert!((fit(&data) - before).norm() < 1e-12);
    }
}
