//! What the covariance of a model's parameters makes of its predictions.
//!
//! All parameters p, η and λ and those of the effects, have one covariance matrix P ([`Model::covariance`]). To first order that of q̃
//! is J P Jᵗ with J = ∂q̃/∂p at a bend, and that of the bend which a given q̃ leads to is A P Aᵗ with A = −∂b/∂q̃ · ∂q̃/∂p, since b
//! moves so that q̃ stays.

use super::PerBackbone;
use super::compensation::polar;
use super::mechanics::Mechanics;
use super::model::{Model, PARAMETER_STEP};
use crate::error::Result;
use crate::geometry::Configuration;
use nalgebra::{DVector, Matrix2, Matrix2xX, Vector2};

impl Model {
    /// Standard deviations of [`command`](Self::command), mm, from the covariance of all parameters, and from what the model may miss
    /// beyond the bends that it was learned on ([`data_range`](super::data_range)).
    pub fn command_sds(&self, psi: Configuration) -> PerBackbone {
        let (columns, covariance) = (self.command_by_parameters(psi.bend_vector()), self.covariance());
        let beyond_mm = self.beyond_data_mm(psi.bend_vector());
        PerBackbone::from_fn(self.robot.backbone_count(), |i| {
            let by = DVector::from_iterator(columns.len(), columns.iter().map(|column| column[i]));
            // A variance may come out as a rounding below zero.
            by.dot(&(&covariance * &by)).max(0.0).sqrt().hypot(beyond_mm[i])
        })
    }

    /// J = ∂q̃/∂p of a single pose by each parameter, mm per its unit; by differences where there are effects.
    pub(crate) fn command_by_parameters(&self, bend: Vector2<f64>) -> Vec<PerBackbone> {
        if self.effects.is_empty() {
            let h = self.epsilon_by_parameters(bend);
            return vec![h.column(0), h.column(1)];
        }
        let values = self.parameter_values();
        let command = |j: usize, value: f64| {
            let mut moved = values.clone();
            moved[j] = value;
            Mechanics::new(&self.with_parameter_values(&moved)).command(bend, None)
        };
        let specs = self.parameter_specs();
        let columns = specs.iter().enumerate().map(|(j, spec)| {
            // Not beyond what such a robot can have, where an equation may have no meaning.
            let step = PARAMETER_STEP * spec.typical;
            let below = (values[j] - step).max(spec.range.0.min(values[j]));
            let above = (values[j] + step).min(spec.range.1.max(values[j]));
            (command(j, above) - command(j, below)) / (above - below)
        });
        columns.collect()
    }

    /// Covariance of the bend vector (rad²) that a given q̃ leads to, from that of all parameters, and from what the model may miss beyond the
    /// bends that it was learned on.
    ///
    /// # Errors
    /// As [`updated_jacobian_bend`](Self::updated_jacobian_bend).
    pub fn response_covariance_bend(&self, bend: Vector2<f64>) -> Result<Matrix2<f64>> {
        let by_command = self.updated_jacobian_bend(bend)?;
        let columns: Vec<_> = self.command_by_parameters(bend).iter().map(|column| by_command.tr_mul(column)).collect();
        let by_parameters = Matrix2xX::from_columns(&columns);
        let beyond = by_command.tr_mul(&self.beyond_data_mm(bend));
        Ok(&by_parameters * self.covariance() * by_parameters.transpose() + beyond * beyond.transpose())
    }

    /// Covariance of (θ, δ), rad², that a given q̃ leads to, from that of all parameters.
    ///
    /// # Errors
    /// As [`updated_jacobian`](Self::updated_jacobian).
    pub fn response_covariance(&self, psi: Configuration) -> Result<Matrix2<f64>> {
        let turn = polar(psi)?;
        Ok(turn * self.response_covariance_bend(psi.bend_vector())? * turn.transpose())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{Effect, Estimate, Friction, MAX_THETA};
    use nalgebra::DMatrix;
    use proptest::prelude::*;
    use rand::SeedableRng;
    use rand::rngs::StdRng;
    use rand_distr::{Distribution, StandardNormal};
    use std::f64::consts::PI;

    fn paper() -> Model {
        let estimate =
            Estimate { eta: 1.221, lambda_mm: 0.1765, covariance: Matrix2::new(1e-4, 2e-6, 2e-6, 1e-6), samples: 10 };
        Model { friction: Friction::paper_printed(), ..Model::default() }.with_estimate(estimate)
    }

    fn any_configuration() -> impl Strategy<Value = Configuration> {
        (prop_oneof![Just(0.0), 0.0..1e-6f64, 0.0..1e-2f64, 0.0..MAX_THETA], -PI..PI)
            .prop_map(|(theta, delta)| Configuration { theta, delta })
    }

    #[test]
    fn covariances_are_those_of_redrawn_parameters() {
        // So small that the nonlinear part is a millionth.
        let mut model = paper();
        model.covariance *= 1e-6;
        let psi = Configuration::from_degrees(70.0, -140.0);
        let q_tilde = model.command(psi);
        let lower = model.parameter_covariance().cholesky().unwrap().l();
        // Points at ±√2 along both axes of the parameters' ellipse carry its covariance exactly.
        let mut command = PerBackbone::repeat(3, 0.0);
        let mut response = Matrix2::zeros();
        for axis in 0..2 {
            for sign in [-1.0, 1.0] {
                let shift = lower.column(axis) * sign * 2f64.sqrt();
                let mut moved = model.clone();
                moved.eta += shift.x;
                moved.lambda_mm += shift.y;
                let by_command = moved.command(psi) - q_tilde;
                let by_response = moved.forward(&q_tilde).unwrap().configuration;
                let by_response = Vector2::new(by_response.theta - psi.theta, by_response.delta - psi.delta);
                command += by_command.component_mul(&by_command) / 4.0;
                response += by_response * by_response.transpose() / 4.0;
            }
        }
        assert!((command.map(f64::sqrt) - model.command_sds(psi)).amax() < 1e-12);
        let predicted = model.response_covariance(psi).unwrap();
        assert!((response - predicted).norm() < 1e-4 * predicted.norm(), "{response} {predicted}");
    }

    /// Independent draws of a model's parameters by its covariance.
    fn drawn(model: &Model, draws: usize) -> impl Iterator<Item = Model> {
        let (values, covariance) = (model.parameter_values(), model.covariance());
        let lower = covariance.cholesky().unwrap().l();
        let mut random = StdRng::seed_from_u64(3);
        (0..draws).map(move |_| {
            let noise = DVector::from_fn(values.len(), |_, _| StandardNormal.sample(&mut random));
            let moved = DVector::from_column_slice(&values) + &lower * noise;
            model.with_parameter_values(moved.as_slice())
        })
    }

    #[test]
    fn with_effects_the_covariances_are_those_of_drawn_parameters() {
        let mut model = paper();
        let effects = [
            "load_directed_backlash:play_mm=0.08",
            "actuator_scale:scale_1=0.02,scale_2=-0.01,scale_3=0.015",
            "tip_load:fx_n=0.3,fy_n=-0.2,fz_n=0.1",
        ];
        model.effects = effects.iter().map(|text| Effect::parse(text).unwrap()).collect();
        // Any covariance: parameters that vary by some hundredths of what matters, correlated with each other.
        let specs = model.parameter_specs();
        let factor = DMatrix::from_fn(specs.len(), specs.len(), |a, b| {
            0.02 * specs[a].typical * ((1.9 * a as f64 + 0.6 * b as f64).sin() + if a == b { 1.5 } else { 0.0 })
        });
        model.covariance = &factor * factor.transpose();
        let psi = Configuration::from_degrees(70.0, -140.0);
        let q_tilde = model.command(psi);
        let (mut command, mut response) = (PerBackbone::repeat(3, 0.0), Matrix2::zeros());
        let draws = 4000;
        for moved in drawn(&model, draws) {
            let by_command = moved.command(psi) - q_tilde;
            let by_response = moved.forward(&q_tilde).unwrap().configuration.bend_vector() - psi.bend_vector();
            command += by_command.component_mul(&by_command) / draws as f64;
            response += by_response * by_response.transpose() / draws as f64;
        }
        // Variances of as many draws scatter by √(2/4000), 2.2 %: three of that.
        let predicted = model.command_sds(psi).map(|sd| sd.powi(2));
        assert!((command - predicted).component_div(&predicted).amax() < 0.07, "{command:?} {predicted:?}");
        let predicted = model.response_covariance_bend(psi.bend_vector()).unwrap();
        assert!((response - predicted).norm() < 0.07 * predicted.norm(), "{response} {predicted}");
        // What the effects add is not small.
        let of_estimate = Model { covariance: model.covariance.clone().resize(2, 2, 0.0), ..model.clone() };
        assert!(model.command_sds(psi).norm() > 1.2 * of_estimate.command_sds(psi).norm());
    }

    proptest! {
        #[test]
        fn without_effects_the_sds_are_those_of_equation_20(psi in any_configuration()) {
            let model = paper();
            let h = model.epsilon_by_parameters(psi.bend_vector());
            let sds = h.map(|row| row.dot(&(model.parameter_covariance() * row)).sqrt());
            prop_assert!((model.command_sds(psi) - sds).amax() < 1e-15);
            // An effect that does nothing and is exactly known changes nothing but the way there.
            let idle = Effect::parse("thermal_drift:rate_mm_per_s=0").unwrap();
            let with_idle = Model { effects: vec![idle], ..model.clone() };
            prop_assert!((with_idle.command_sds(psi) - sds).amax() < 1e-9 * sds.amax());
        }
    }
}
