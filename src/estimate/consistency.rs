//! Whether measurements scatter as much as their covariances promise.
//!
//! Residuals of ε have two parts that live apart: the *bending* part (two numbers), where the camera's noise is
//! and which pins η, and the *common* part (one number), where only the encoders' noise is and which pins λ. In the
//! paper's model neither part says anything about the other's parameter. Each part's scatter is compared with its own
//! promise, so that a model that is wrong in one, by microns that matter only against the encoders' noise, leaves the other's
//! sigma alone.
//!
//! A part's variance is inflated by the reduced χ², where that is above 1, and by the design effect of the correlation of one
//! residual with the next ([`SerialScatter::variance_inflation`]): errors that last from frame to frame average out more slowly than
//! independent ones.
//!
//! Source: the normalised innovation squared of Y. Bar-Shalom, X. R. Li, T. Kirubarajan, *Estimation with Applications to Tracking and
//! Navigation*, Wiley 2001, ch. 5.4.

use super::LinearisedMeasurement;
use crate::statistics::correlation::SerialScatter;
use nalgebra::{DMatrix, DVector, Matrix3, Vector1, Vector2, Vector3};

/// One residual, split into its parts and divided by what their covariances promise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Whitened {
    /// The bending part, in units of its standard deviations.
    pub bending: Vector2<f64>,
    /// The common part, likewise.
    pub common: f64,
}

impl Whitened {
    /// Splits and whitens a residual (mm) of a given covariance (mm²); `None` where that is not positive definite.
    pub fn new(residual: &Vector3<f64>, covariance: &Matrix3<f64>) -> Option<Self> {
        let lower = covariance.fixed_view::<2, 2>(0, 0).into_owned().cholesky()?.l();
        Some(Self {
            bending: lower.solve_lower_triangular(&residual.xy())?,
            common: residual.z / covariance[(2, 2)].sqrt(),
        })
    }
}

/// The running comparison of residuals with their promised covariances.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Consistency {
    bending: SerialScatter<2>,
    common: SerialScatter<1>,
}

impl Consistency {
    /// Of the residuals that a fit leaves of its own measurements.
    pub(super) fn of_fit<'a>(
        x: &DVector<f64>,
        measurements: impl IntoIterator<Item = &'a LinearisedMeasurement>,
    ) -> Self {
        let mut consistency = Self { bending: SerialScatter::new(1), common: SerialScatter::new(1) };
        for linearised in measurements {
            if let Some(whitened) = Whitened::new(&linearised.residual(x.as_slice()), &linearised.covariance) {
                consistency.add(&whitened);
            }
        }
        consistency
    }

    /// Adds a residual: an innovation, whitened by its predicted covariance.
    pub(super) fn add(&mut self, whitened: &Whitened) {
        self.bending.add(whitened.bending);
        self.common.add(Vector1::new(whitened.common));
    }

    /// Multiplies all sums so far by the forgetting factor.
    pub(super) fn forget(&mut self, factor: f64) {
        self.bending.forget(factor);
        self.common.forget(factor);
    }

    /// Reduced χ² of the bending part: about 1 where the camera's sigmas are right and the model holds.
    pub fn bending_chi_square(&self) -> f64 {
        self.bending.reduced_chi_square()
    }

    /// Reduced χ² of the common part: about 1 where the encoders' noise is all there is.
    pub fn common_chi_square(&self) -> f64 {
        self.common.reduced_chi_square()
    }

    /// A covariance of η, λ and effects' parameters, as promised, inflated to what the residuals show. Its part `by_prior`, from what was known before
    /// the measurements, is not inflated. Either part of the residuals may tell of an effect, so that the larger of both counts there.
    pub(super) fn inflate(&self, covariance: &DMatrix<f64>, by_prior: &DMatrix<f64>) -> DMatrix<f64> {
        let (of_eta, of_lambda) = (self.bending.variance_inflation(), self.common.variance_inflation());
        let scale = |k: usize| [of_eta, of_lambda].get(k).copied().unwrap_or(of_eta.max(of_lambda)).sqrt();
        let n = covariance.nrows();
        DMatrix::from_fn(n, n, |a, b| by_prior[(a, b)] + scale(a) * (covariance[(a, b)] - by_prior[(a, b)]) * scale(b))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn parts_of_a_drawn_residual_are_standard_normal() {
        let covariance = Matrix3::new(4.0, 1.0, 0.5, 1.0, 3.0, -0.5, 0.5, -0.5, 2.0);
        let lower = covariance.cholesky().unwrap().l();
        let mut random = rand::rngs::StdRng::seed_from_u64(5);
        let mut sums = [0.0; 3];
        let draws = 20_000;
        for _ in 0..draws {
            let residual = lower * Vector3::from_fn(|_, _| StandardNormal.sample(&mut random));
            let whitened = Whitened::new(&residual, &covariance).unwrap();
            sums[0] += whitened.bending.x.powi(2);
            sums[1] += whitened.bending.y.powi(2);
            sums[2] += whitened.common.powi(2);
        }
        assert!(sums.iter().all(|sum| (sum / f64::from(draws) - 1.0).abs() < 0.05), "{sums:?}");
    }
}
