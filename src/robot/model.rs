//! The model: what a prediction needs to know about one robot.

use super::{Effect, Friction, Robot};
use nalgebra::{Matrix2, Vector2};

/// The estimated parameters x = (η, λ) of Eq. 18.
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
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Model {
    /// Constants of the robot.
    pub robot: Robot,
    /// Constants of the snake cone.
    pub friction: Friction,
    /// η and λ; where absent, the naive η = 1, λ = 0 of Section IV.
    pub estimate: Option<Estimate>,
    /// What else acts, beyond Eq. 18.
    pub effects: Vec<Effect>,
}

impl Model {
    /// x = (η, λ in mm), (1, 0) where nothing was estimated.
    pub fn parameters(&self) -> Vector2<f64> {
        self.estimate.map_or(Vector2::new(1.0, 0.0), |estimate| Vector2::new(estimate.eta, estimate.lambda_mm))
    }

    /// Covariance of x; zero where nothing was estimated.
    pub fn parameter_covariance(&self) -> Matrix2<f64> {
        self.estimate.map_or(Matrix2::zeros(), |estimate| estimate.covariance)
    }

    /// This model without its effects.
    pub fn plain(&self) -> Self {
        Self { effects: Vec::new(), ..self.clone() }
    }
}

#[cfg(test)]
pub(crate) mod fixtures {
    use super::*;
    use crate::robot::effects::{ParameterSpec, Physics, Role};

    /// A robot of so many backbones with an effect of its typical size times `scale`, and η and λ.
    pub fn with_example(physics: &'static Physics, backbones: u8, scale: f64) -> Model {
        let value = |spec: &ParameterSpec| match spec.role {
            Role::Size { .. } => spec.typical * scale,
            Role::Shape { example, .. } => example,
        };
        let values = (physics.parameters)(usize::from(backbones)).iter().map(value).collect();
        let estimate = Estimate { eta: 1.2, lambda_mm: 0.17, covariance: Matrix2::zeros(), samples: 9 };
        let robot = Robot { backbones, ..Robot::default() };
        Model { robot, estimate: Some(estimate), effects: vec![Effect::of(physics, values)], ..Model::default() }
    }
}
