//! Whether measurements scatter as much as their covariances promise.
//!
//! Residuals of ε have two parts that live apart: the *bending* part (two numbers), where the camera's noise is
//! and which pins η, and the *common* part (one number), where only the encoders' noise is and which pins λ. In the
//! paper's model neither part says anything about the other's parameter. Each part's scatter is compared with its own
//! promise, so that a model that is wrong in one, by microns that matter only against the encoders' noise, leaves the other's
//! sigma alone.
//!
//! A part's variance is inflated by the reduced χ², where that is above 1, and by (1 + ρ)/(1 − ρ) with ρ the correlation
//! of one residual with the next: errors that last from frame to frame average out more slowly than independent ones.

use super::Row;
use nalgebra::{Matrix2, Matrix3, SMatrix, Vector1, Vector2, Vector3};

/// One residual, split into its parts and divided by what their covariances promise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Whitened {
    /// The bending part, in units of its standard deviations.
    pub bending: Vector2<f64>,
    /// The common part, likewise.
    pub common: f64,
}

impl Whitened {
    /// Splits and whitens a row's residual (mm) of a given covariance (mm²); `None` where that is not positive definite.
    pub fn new(residual: &Vector3<f64>, covariance: &Matrix3<f64>) -> Option<Self> {
        let lower = covariance.fixed_view::<2, 2>(0, 0).into_owned().cholesky()?.l();
        Some(Self {
            bending: lower.solve_lower_triangular(&residual.xy())?,
            common: residual.z / covariance[(2, 2)].sqrt(),
        })
    }
}

/// Sums over the residuals of one part, of D numbers each.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Scatter<const D: usize> {
    squares: f64,
    degrees_of_freedom: f64,
    with_the_last: f64,
    last: SMatrix<f64, D, 1>,
}

impl<const D: usize> Scatter<D> {
    fn new(parameters: usize) -> Self {
        Self { squares: 0.0, degrees_of_freedom: -(parameters as f64), with_the_last: 0.0, last: SMatrix::zeros() }
    }

    fn add(&mut self, residual: SMatrix<f64, D, 1>) {
        self.squares += residual.norm_squared();
        self.degrees_of_freedom += D as f64;
        self.with_the_last += residual.dot(&self.last);
        self.last = residual;
    }

    fn fade(&mut self, keep: f64) {
        self.squares *= keep;
        self.degrees_of_freedom *= keep;
        self.with_the_last *= keep;
    }

    fn reduced_chi_square(&self) -> f64 {
        if self.degrees_of_freedom > 0.0 { self.squares / self.degrees_of_freedom } else { 1.0 }
    }

    fn inflation(&self) -> f64 {
        let correlation = if self.squares > 0.0 { (self.with_the_last / self.squares).clamp(0.0, 0.9) } else { 0.0 };
        self.reduced_chi_square().max(1.0) * (1.0 + correlation) / (1.0 - correlation)
    }
}

/// The running comparison of residuals with their promised covariances.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Consistency {
    bending: Scatter<2>,
    common: Scatter<1>,
}

impl Consistency {
    /// Of the residuals that a fit of η and λ leaves of its own rows.
    pub(super) fn of_fit<'a>(x: &Vector2<f64>, rows: impl IntoIterator<Item = &'a Row>) -> Self {
        let mut consistency = Self { bending: Scatter::new(1), common: Scatter::new(1) };
        for row in rows {
            if let Some(whitened) = Whitened::new(&row.residual(x), &row.covariance) {
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

    /// Fading memory, as in [`Filter::fade`](super::Filter::fade).
    pub(super) fn fade(&mut self, keep: f64) {
        self.bending.fade(keep);
        self.common.fade(keep);
    }

    /// Reduced χ² of the bending part: about 1 where the camera's sigmas are right and the model holds.
    pub fn bending_chi_square(&self) -> f64 {
        self.bending.reduced_chi_square()
    }

    /// Reduced χ² of the common part: about 1 where the encoders' noise is all there is.
    pub fn common_chi_square(&self) -> f64 {
        self.common.reduced_chi_square()
    }

    /// A covariance of (η, λ) as promised, inflated to what the residuals show.
    pub(super) fn inflate(&self, covariance: &Matrix2<f64>) -> Matrix2<f64> {
        let scale =
            Matrix2::from_diagonal(&Vector2::new(self.bending.inflation(), self.common.inflation()).map(f64::sqrt));
        scale * covariance * scale
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

    #[test]
    fn errors_that_last_inflate_the_mean_as_they_should() {
        // The mean of an autoregressive series with ρ = 0.6 has (1 + ρ)/(1 − ρ) = 4 times the variance of white noise.
        let mut random = rand::rngs::StdRng::seed_from_u64(6);
        let mut scatter = Scatter::<1>::new(1);
        let mut value = 0.0;
        for _ in 0..20_000 {
            let fresh: f64 = StandardNormal.sample(&mut random);
            value = 0.6 * value + 0.8 * fresh;
            scatter.add(Vector1::new(value));
        }
        assert!((scatter.inflation() - 4.0).abs() < 0.3, "{}", scatter.inflation());
    }
}
