//! One measurement linearised: its equations for x = (η, λ), which are rows of Eq. 20, and for the uncertain parameters of the model's
//! effects, and their covariance.
//!
//! Eq. 20 (with the inverses of K_d and K_c that Eq. 18 needs) says z = H x with z = q̃ − q(ψ) − ε_0 and H of
//! [`Model::epsilon_by_parameters`]. Both sides are computed from the measured ψ, which is noisy; the encoders hardly
//! are. With the bend vector measured as b_m = b + e,
//!
//! ```text
//! q̃ = Q b + ε(b) + n    ⇒    q̃ − Q b* − A (b_m − b*) − ε_0 = H(b*) x − A e + n,     A = Q + ∂ε/∂b
//! ```
//!
//! to first order about any b* near b. Two things follow.
//!
//! **Three numbers, however many backbones.** Q, A and H's first column lie in the span of Q's two columns, ε_0 and H's second
//! along (1, …, 1): of n equations two tell the bend, one the common part, and n − 3 hold the encoders' noise alone and nothing of
//! x. The three are kept, in coordinates that keep lengths ([`bend_and_common`](crate::robot::Robot::bend_and_common)), so
//! that the encoders' noise stays σ_q² I.
//!
//! **Weights.** The covariance of the three is A Σ_b Aᵗ + σ_q² I: the camera's through the kinematics *and* through ε, and the
//! encoders'. A has rank 2. In the common part only the encoders' noise is left, and rightly so: a common part of q̃ moves neither
//! θ nor δ, so the camera's noise cannot reach it. Where the model is wrong there by more than the encoders' noise, the
//! [`Consistency`](super::Consistency) of that part shows it.
//!
//! **Where to evaluate H.** At b* = b_m the noise stands in H as well as in z and pulls η towards smaller values by
//! (1 + η) σ²/θ², in the mean over the measurements; at small bends that is much. Once there is an estimate, the encoders
//! tell b too, by the forward problem, and far better than the camera along what η does not change. b* is the weighted
//! mean of both, so H soon depends on the quiet encoders alone, and the bias dies away with the number of measurements.
//!
//! **Effects.** The travel of the lines, its slope A and its derivatives by x are those of the model with its effects, along the path that led to
//! the reading ([`Mechanics::step`]). Nothing is taken off the data. H has a column more for each uncertain parameter of the effects: the
//! difference quotient of the same equations by models that have this parameter nudged, each with a memory of its own.
//!
//! **Standing straight.** A bend that cannot be told from none has an H that is noise alone, and a long time of that would,
//! with forgetting, pull η to where the noise is. Such a measurement takes b* = 0, where H says nothing of η and λ alone is learnt.

use super::Sample;
use crate::geometry::Configuration;
use crate::robot::{MAX_THETA, Mechanics, Model, Motion, PerBackbone, Robot};
use nalgebra::allocator::Allocator;
use nalgebra::{
    Const, DMatrix, DefaultAllocator, Dim, Matrix2, Matrix2xX, Matrix3, Matrix3x2, Matrix3x6, Matrix3xX, OMatrix,
    Vector2, Vector3,
};

/// How measurements are weighted against each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Weighting {
    /// By each measurement's own sigmas.
    Measured,
    /// The paper's: one flat standard deviation (degrees; the paper takes 1) for every backbone of every measurement, as
    /// r·σ in mm, with H at the measured configuration. The paper calls 1° 0.0294 mm; r·1° is 0.0262 mm.
    Flat {
        /// The standard deviation, degrees.
        sigma_deg: f64,
    },
}

/// One measurement's equations z = H x + noise: two for the bend, one for the common part.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearisedMeasurement {
    /// z, mm.
    pub z: Vector3<f64>,
    /// H: columns for η (mm), for λ (1), and for each uncertain parameter of the effects in its unit of the estimator (mm).
    pub h: Matrix3xX<f64>,
    /// Covariance of the noise, mm².
    pub covariance: Matrix3<f64>,
    /// The part of the noise that the other measurements before the same rig share, mm, for each of its six unit errors; `covariance` holds
    /// it. See [`Measured::by_rig`](crate::observation::Measured::by_rig).
    pub by_rig: Matrix3x6<f64>,
}

impl LinearisedMeasurement {
    /// z − H x, mm.
    pub fn residual(&self, x: &[f64]) -> Vector3<f64> {
        self.h.column_iter().zip(x).fold(self.z, |left, (h, x)| left - h * *x)
    }

    /// H P Hᵗ + R, mm²: how the residuals of an x̂ in which this measurement had no part scatter, by its covariance.
    pub(super) fn predicted(&self, covariance: &DMatrix<f64>) -> Matrix3<f64> {
        &self.h * covariance * self.h.transpose() + self.covariance
    }

    /// Columns of three rows in units of the measurement's standard deviations: L⁻¹ times them, with L Lᵗ its covariance; `None` where that is not
    /// positive definite.
    pub(super) fn whitened<C: Dim>(&self, columns: &OMatrix<f64, Const<3>, C>) -> Option<OMatrix<f64, Const<3>, C>>
    where
        DefaultAllocator: Allocator<Const<3>, C>,
    {
        self.covariance.cholesky()?.l_dirty().solve_lower_triangular(columns)
    }

    /// Linearises one measurement; `model` carries the estimate so far, if there is one, and the effects that it came by.
    pub(crate) fn new(model: &Model, weighting: Weighting, sd_encoder_mm: f64, sample: &Sample) -> Self {
        let mechanics = Mechanics::new(model);
        let (motion, bend, measured) = (&sample.motion(), sample.true_bend(&mechanics), &sample.measured);
        let as_measured = || (bend, measured.bend_covariance(measured.configuration));
        let (at, of_eye) = match weighting {
            Weighting::Flat { .. } => as_measured(),
            Weighting::Measured => {
                smoothed(model, &mechanics, sd_encoder_mm, (sample, motion), bend).unwrap_or_else(as_measured)
            }
        };
        let robot = &model.robot;
        let slope = mechanics.line_jacobian(at, motion).line_by_bend;
        let left_mm = mechanics.misfit_mm(&sample.q_tilde, at, motion) - slope * (bend - at);
        let own = bend_and_common_by(robot, &mechanics.travel_by_parameters(at, motion));
        let mut z = robot.bend_and_common(&left_mm) + own * model.parameters();
        let mut h = Matrix3xX::zeros(2 + sample.nudged().len());
        h.fixed_columns_mut::<2>(0).copy_from(&own);
        for (k, nudged) in sample.nudged().iter().enumerate() {
            let by_parameter = nudged.difference(model, |mechanics| {
                let bend = mechanics.true_bend(measured.configuration.bend_vector()) + nudged.since_frame;
                left_mm - mechanics.misfit_mm(&nudged.q_tilde, at, &nudged.motion) + slope * (bend - at)
            });
            let column = robot.bend_and_common(&by_parameter) * nudged.unit;
            z += column * (model.parameter_values()[nudged.parameter] / nudged.unit);
            h.set_column(2 + k, &column);
        }
        let slope = bend_and_common_by(robot, &slope);
        let (covariance, by_rig) = match weighting {
            Weighting::Flat { sigma_deg } => {
                let sigma_mm = robot.backbone_circle_radius_mm * sigma_deg.to_radians();
                (Matrix3::identity() * sigma_mm.powi(2), Matrix3x6::zeros())
            }
            Weighting::Measured => (
                slope * of_eye * slope.transpose() + Matrix3::identity() * sd_encoder_mm.powi(2),
                slope * measured.by_rig,
            ),
        };
        Self { z, h, covariance, by_rig }
    }
}

/// A derivative of the lines' travel by two numbers, as that of its bend and common part, which hold all that says something of x.
fn bend_and_common_by(robot: &Robot, by: &PerBackbone<Vector2<f64>>) -> Matrix3x2<f64> {
    Matrix3x2::from_columns(&[0, 1].map(|axis| robot.bend_and_common(&by.column(axis))))
}

/// A bend of fewer standard deviations than this counts as straight.
///
/// Derived: |H|² grows with θ², to which noise of standard deviation σ adds σ²; from ten standard deviations on that is 1 % at most.
const TOLD_FROM_STRAIGHT_SD: f64 = 10.0;

/// The mean of the measured bend vector and the one the encoders imply, weighted by their covariances (none where that
/// cannot be told from straight), and the covariance of the measured one; `None` where the encoders imply none, and before
/// the first estimate.
fn smoothed(
    model: &Model,
    mechanics: &Mechanics,
    sd_encoder_mm: f64,
    (sample, motion): (&Sample, &Motion),
    bend: Vector2<f64>,
) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    model.samples?;
    let near = sample.came.as_ref().map_or(bend, |came| came.solution.bend);
    let solution = mechanics.solve(&sample.q_tilde, Some(motion), near);
    let implied = solution.bend;
    if !solution.converged || implied.norm() > MAX_THETA {
        return None;
    }
    let by_line = mechanics.line_jacobian(implied, motion).bend_by_line;
    let mut by_parameters = Matrix2xX::zeros(model.parameter_count());
    let own = by_line.cross_gram(&mechanics.travel_by_parameters(implied, motion));
    by_parameters.fixed_columns_mut::<2>(0).copy_from(&own);
    for nudged in sample.nudged() {
        let misfit_mm = mechanics.misfit_mm(&sample.q_tilde, implied, motion);
        let by_parameter = nudged
            .difference(model, |mechanics| misfit_mm - mechanics.misfit_mm(&nudged.q_tilde, implied, &nudged.motion));
        by_parameters.set_column(nudged.parameter, &by_line.tr_mul(&by_parameter));
    }
    let implied_covariance = &by_parameters * model.covariance() * by_parameters.transpose()
        + by_line.cross_gram(&by_line) * sd_encoder_mm.powi(2);
    // Taken at the implied bend, too: weights that followed the noise would favour one sign of it.
    let bend_covariance = sample.measured.bend_covariance(Configuration::from_bend_vector(implied));
    let gain = implied_covariance * (implied_covariance + bend_covariance).try_inverse()?;
    let mean = implied + gain * (bend - implied);
    let mean_covariance = implied_covariance - gain * implied_covariance;
    let squared_distance = mean.dot(&(mean_covariance.try_inverse()? * mean));
    let bent = squared_distance >= TOLD_FROM_STRAIGHT_SD.powi(2);
    Some((if bent { mean } else { Vector2::zeros() }, bend_covariance))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation::Measured;
    use crate::robot::Estimate;
    use proptest::prelude::*;

    fn measured(
        theta_deg: f64,
        delta_deg: f64,
        sigma_theta_deg: f64,
        sigma_delta_deg: f64,
        correlation: f64,
    ) -> Measured {
        Measured::independent(
            Configuration::from_degrees(theta_deg, delta_deg),
            sigma_theta_deg.to_radians(),
            sigma_delta_deg.to_radians(),
            correlation,
        )
    }

    /// A measurement of a model without effects.
    fn of_plain(measured: Measured, q_tilde: PerBackbone) -> Sample {
        Sample { measured, q_tilde, came: None }
    }

    proptest! {
        #[test]
        fn the_covariance_can_always_be_factored(
            theta_deg in 0.0..120.0f64, delta_deg in -180.0..180.0f64, sigma in 0.0..10.0f64, sigma_delta in 0.0..1e4f64,
            rho in -1.0..1.0f64
        ) {
            let measured = measured(theta_deg, delta_deg, sigma, sigma_delta, rho);
            let q_tilde = Model::default().command(measured.configuration);
            let estimate = Estimate { eta: 1.1, lambda_mm: 0.1, covariance: Matrix2::identity() * 1e-4, samples: 3 };
            for model in [Model::default(), Model::default().with_estimate(estimate)] {
                let linearised = LinearisedMeasurement::new(&model, Weighting::Measured, 1.5e-3, &of_plain(measured, q_tilde));
                prop_assert!(linearised.covariance.cholesky().is_some());
                prop_assert!(linearised.h.iter().chain(linearised.z.iter()).all(|v| v.is_finite()));
            }
        }

        #[test]
        fn without_noise_it_is_equation_20_wherever_it_is_linearised(theta_deg in 0.0..110.0f64, delta_deg in -180.0..180.0f64) {
            let estimate = Estimate { eta: 1.1, lambda_mm: 0.1, covariance: Matrix2::identity() * 1e-4, samples: 3 };
            let model = Model::default().with_estimate(estimate);
            let measured = measured(theta_deg, delta_deg, 0.1, 0.2, 0.0);
            let q_tilde = model.command(measured.configuration);
            for weighting in [Weighting::Measured, Weighting::Flat { sigma_deg: 1.0 }] {
                let linearised = LinearisedMeasurement::new(&model, weighting, 1.5e-3, &of_plain(measured, q_tilde));
                // A bend that counts as straight is linearised there: at 0.3° its third order is 7e-10 mm.
                prop_assert!(linearised.residual(model.parameters().as_slice()).norm() < 1e-9);
            }
        }
    }

    #[test]
    fn the_cameras_noise_does_not_reach_the_common_part() {
        let measured = measured(50.0, 20.0, 2.0, 3.0, 0.2);
        let q_tilde = Model::default().command(measured.configuration);
        let linearised =
            LinearisedMeasurement::new(&Model::default(), Weighting::Measured, 1.5e-3, &of_plain(measured, q_tilde));
        assert!((linearised.covariance[(2, 2)] - 1.5e-3f64.powi(2)).abs() < 1e-15);
        assert!(linearised.covariance.fixed_view::<2, 1>(0, 2).norm() < 1e-15);
    }
}
