//! The model: what a prediction needs to know about one robot.

use super::effects::ParameterSpec;
use super::{DataRange, Effect, Friction, Robot};
use nalgebra::{DMatrix, Matrix2, Vector2};
use std::ops::Range;

/// η as a parameter.
pub static ETA: ParameterSpec = ParameterSpec::positive("eta", "1", (0.05, 10.0), 0.03);
/// λ as a parameter.
pub static LAMBDA: ParameterSpec = ParameterSpec::size("lambda_mm", "mm", 2.0, 0.02);

/// Step of differences by a parameter, in its typical sizes: central differences are good to the step's square.
///
/// Convention: numerical.
pub(super) const PARAMETER_STEP: f64 = 1e-3;

/// η and λ of Eq. 18 as they were estimated, read off a [`Model`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// η, which scales the snake's actuation forces.
    pub eta: f64,
    /// λ, the backlash that all actuators share, mm.
    pub lambda_mm: f64,
    /// Covariance of (η, λ in mm).
    pub covariance: Matrix2<f64>,
    /// Measurements behind the estimate.
    pub samples: usize,
}

impl Estimate {
    /// Standard deviation of η.
    pub fn sd_eta(&self) -> f64 {
        self.covariance[(0, 0)].sqrt()
    }

    /// Standard deviation of λ, mm.
    pub fn sd_lambda_mm(&self) -> f64 {
        self.covariance[(1, 1)].sqrt()
    }

    /// Correlation of the errors of η and λ; 0 where one of them has none.
    pub fn correlation(&self) -> f64 {
        let scale = self.sd_eta() * self.sd_lambda_mm();
        if scale > 0.0 { self.covariance[(0, 1)] / scale } else { 0.0 }
    }
}

/// The robot, its friction, and what has been learned about its actuation line.
///
/// The default is the paper's robot with the calibrated friction and no estimate: naive compensation.
///
/// Its *parameters* are η, λ and the values of all effects, in the order of the list; they have one
/// [covariance](Self::covariance).
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Constants of the robot.
    pub robot: Robot,
    /// Constants of the snake cone.
    pub friction: Friction,
    /// η; 1, the naive value of Section IV, where nothing was estimated.
    pub eta: f64,
    /// λ, mm; 0 where nothing was estimated.
    pub lambda_mm: f64,
    /// Measurements behind η and λ; `None` where they were not estimated.
    pub samples: Option<usize>,
    /// What else acts, beyond Eq. 18.
    pub effects: Vec<Effect>,
    /// P, the parameters' covariance, each in its own unit; parameters beyond its end are exactly known.
    pub covariance: DMatrix<f64>,
    /// The bends that η and λ were learned on; `None` where nobody says.
    pub learned: Option<DataRange>,
}

impl Default for Model {
    fn default() -> Self {
        Self {
            robot: Robot::default(),
            friction: Friction::default(),
            eta: 1.0,
            lambda_mm: 0.0,
            samples: None,
            effects: Vec::new(),
            covariance: DMatrix::zeros(2, 2),
            learned: None,
        }
    }
}

impl Model {
    /// x = (η, λ in mm).
    pub fn parameters(&self) -> Vector2<f64> {
        Vector2::new(self.eta, self.lambda_mm)
    }

    /// Covariance of (η, λ in mm).
    pub fn parameter_covariance(&self) -> Matrix2<f64> {
        Matrix2::from_fn(|a, b| self.known(a, b))
    }

    /// η and λ, where they were estimated.
    pub fn estimate(&self) -> Option<Estimate> {
        let (covariance, samples) = (self.parameter_covariance(), self.samples?);
        Some(Estimate { eta: self.eta, lambda_mm: self.lambda_mm, covariance, samples })
    }

    /// The model with other η and λ, as they were estimated.
    pub fn with_estimate(self, Estimate { eta, lambda_mm, covariance: own, samples }: Estimate) -> Self {
        let mut covariance = self.covariance();
        covariance.fixed_view_mut::<2, 2>(0, 0).copy_from(&own);
        Self { eta, lambda_mm, samples: Some(samples), covariance, ..self }
    }

    /// The number of parameters, 2 + m.
    pub fn parameter_count(&self) -> usize {
        2 + self.effects.iter().map(|effect| effect.values.len()).sum::<usize>()
    }

    /// Which of the parameters are those of an effect of the list.
    fn parameters_of(&self, k: usize) -> Range<usize> {
        let first = 2 + self.effects[..k].iter().map(|effect| effect.values.len()).sum::<usize>();
        first..first + self.effects[k].values.len()
    }

    /// What is known of each parameter.
    pub fn parameter_specs(&self) -> Vec<ParameterSpec> {
        let of_effects = self.effects.iter().flat_map(|effect| effect.parameters().iter().copied());
        [ETA, LAMBDA].into_iter().chain(of_effects).collect()
    }

    /// The parameters' names, those of an effect as `effect.parameter`.
    pub fn parameter_names(&self) -> Vec<String> {
        let name = |effect: &Effect, spec: &ParameterSpec| format!("{}.{}", effect.physics.name, spec.name);
        let of_effects = self.effects.iter().flat_map(|e| e.parameters().iter().map(move |spec| name(e, spec)));
        [ETA.name, LAMBDA.name].map(str::to_owned).into_iter().chain(of_effects).collect()
    }

    /// The parameters' values.
    pub fn parameter_values(&self) -> Vec<f64> {
        let of_effects = self.effects.iter().flat_map(|effect| effect.values.iter().copied());
        [self.eta, self.lambda_mm].into_iter().chain(of_effects).collect()
    }

    /// The model with other values of its parameters.
    pub fn with_parameter_values(&self, values: &[f64]) -> Self {
        let samples = self.samples.or(Some(0));
        let mut model = Self { eta: values[0], lambda_mm: values[1], samples, ..self.clone() };
        let of_effects = model.effects.iter_mut().flat_map(|effect| &mut effect.values);
        of_effects.zip(&values[2..]).for_each(|(own, value)| *own = *value);
        model
    }

    /// P of all parameters. Rounding may leave its halves apart: beyond η and λ the lower one counts.
    pub fn covariance(&self) -> DMatrix<f64> {
        let n = self.parameter_count();
        DMatrix::from_fn(n, n, |a, b| if b < 2 { self.known(a, b) } else { self.known(a.max(b), a.min(b)) })
    }

    /// An element of the covariance; 0 beyond its end.
    fn known(&self, a: usize, b: usize) -> f64 {
        self.covariance.get((a, b)).copied().unwrap_or(0.0)
    }

    /// Standard deviations of the values of an effect of the list; 0 where they are given and not estimated.
    pub fn effect_sds(&self, k: usize) -> Vec<f64> {
        let covariance = self.covariance();
        self.parameters_of(k).map(|j| covariance[(j, j)].max(0.0).sqrt()).collect()
    }

    /// The model without effect k of its list; what is known of the other parameters stays.
    pub fn without_effect(&self, k: usize) -> Self {
        let (mut model, own) = (self.clone(), self.parameters_of(k));
        let covariance = self.covariance().remove_rows(own.start, own.len());
        model.covariance = covariance.remove_columns(own.start, own.len());
        model.effects.remove(k);
        model
    }

    /// The model with one of its parameters moved by a small step, for difference quotients, and the step. It leads towards the inside where
    /// the parameter's range ends.
    pub(crate) fn nudged(&self, parameter: usize) -> (Self, f64) {
        let (mut values, spec) = (self.parameter_values(), self.parameter_specs()[parameter]);
        let step = PARAMETER_STEP * spec.typical;
        let step = if values[parameter] + step > spec.range.1 { -step } else { step };
        values[parameter] += step;
        (self.with_parameter_values(&values), step)
    }

    /// The model without what is known of η and λ; what is known of its effects stays.
    pub fn without_estimate(&self) -> Self {
        let mut covariance = self.covariance();
        covariance.rows_mut(0, 2).fill(0.0);
        covariance.columns_mut(0, 2).fill(0.0);
        Self { eta: 1.0, lambda_mm: 0.0, samples: None, covariance, learned: None, ..self.clone() }
    }

    /// This model without its effects.
    pub fn plain(&self) -> Self {
        Self { effects: Vec::new(), covariance: self.covariance.clone().resize(2, 2, 0.0), ..self.clone() }
    }
}

#[cfg(test)]
pub(crate) mod fixtures {
    use super::*;
    use crate::robot::effects::{Physics, Role};

    /// A robot of so many backbones with an effect of its typical size times `scale`, and η and λ.
    pub fn with_example(physics: &'static Physics, backbones: u8, scale: f64) -> Model {
        let value = |spec: &ParameterSpec| match spec.role {
            Role::Size { .. } => spec.typical * scale,
            Role::Shape { example, .. } => example,
        };
        let values = physics.parameters_on(usize::from(backbones)).iter().map(value).collect();
        let (robot, effects) = (Robot { backbones, ..Robot::default() }, vec![Effect::of(physics, values)]);
        Model { robot, effects, eta: 1.2, lambda_mm: 0.17, samples: Some(9), ..Model::default() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A model with two effects of three parameters, and any covariance of all five.
    fn with_covariance() -> (Model, DMatrix<f64>) {
        let effects = ["load_directed_backlash:play_mm=0.08", "creep:share=0.1,time_constant_s=4"];
        let effects = effects.iter().map(|text| Effect::parse(text).unwrap()).collect();
        let mut model = Model { effects, eta: 1.2, lambda_mm: 0.17, samples: Some(9), ..Model::default() };
        let factor = DMatrix::from_fn(5, 5, |a, b| {
            let own = if a == b { 1.5 } else { 0.0 };
            (own + (1.3 * a as f64 + 0.7 * b as f64 + 0.2).sin()) * 10f64.powi(-(a as i32))
        });
        let covariance = &factor * factor.transpose();
        model.covariance.clone_from(&covariance);
        (model, covariance)
    }

    #[test]
    fn the_covariance_is_one_matrix_of_all_parameters() {
        let (mut model, covariance) = with_covariance();
        assert!((model.covariance() - &covariance).amax() < 1e-15);
        let names = ["eta", "lambda_mm", "load_directed_backlash.play_mm", "creep.share", "creep.time_constant_s"];
        assert_eq!(model.parameter_names(), names);
        assert_eq!(model.parameter_values(), [1.2, 0.17, 0.08, 0.1, 4.0]);
        let sds = [3, 4].map(|k| covariance[(k, k)].sqrt());
        assert_eq!(model.effect_sds(1), sds);
        // Without an effect, what is known of the others is the matrix without its rows and columns.
        let less = model.without_effect(0);
        assert!((less.covariance() - covariance.clone().remove_row(2).remove_column(2)).amax() < 1e-15);
        assert_eq!(less.effect_sds(0), sds);
        // An effect that is added is known exactly, until somebody says otherwise.
        model.effects.push(Effect::parse("thermal_drift:rate_mm_per_s=0.001").unwrap());
        assert_eq!((model.covariance().shape(), model.effect_sds(2)), ((6, 6), vec![0.0]));
        assert_eq!(model.plain().covariance().shape(), (2, 2));
    }

    #[test]
    fn without_its_estimate_a_model_knows_of_its_effects_what_it_knew() {
        let (model, covariance) = with_covariance();
        let none = model.without_estimate().covariance();
        assert!(
            none.view((0, 0), (2, 5)).amax() == 0.0 && none.view((2, 2), (3, 3)) == covariance.view((2, 2), (3, 3))
        );
    }

    #[test]
    fn a_nudge_stays_within_the_range() {
        let (mut model, _) = with_covariance();
        let most = model.parameter_specs()[3].range.1;
        for (value, sign) in [(0.1, 1.0), (most, -1.0)] {
            model.effects[1].values[0] = value;
            let (nudged, step) = model.nudged(3);
            assert!(step * sign > 0.0 && (nudged.effects[1].values[0] - value - step).abs() < 1e-15);
            assert!(nudged.effects[1].values[0] <= most && nudged.effects[0] == model.effects[0]);
        }
    }
}
