//! The part of the bends' errors that all poses of a tracker share: those of the registration and of the azimuth. A row of measurements
//! has room for six of them ([`by_rig`](crate::observation::Measured::by_rig)), and thirteen independent ones are known: the six are
//! the combinations that move the bends most, by principal components. What the others do counts as the pose's own.
//!
//! Source: H. Hotelling, "Analysis of a complex of statistical variables into principal components", J. Educational Psychology 24, 1933.

use super::PoseFit;
use super::azimuth::Azimuth;
use super::registration::RIG;
use nalgebra::{Matrix2x6, SMatrix, SymmetricEigen, Vector2};

/// The registration's errors and the azimuth's. Derived: one more than numbers of a registration.
const ERRORS: usize = RIG + 1;

/// What the poses share.
pub struct SharedErrors {
    azimuth_sigma: f64,
    /// The foremost combinations of the errors, by columns.
    foremost: SMatrix<f64, ERRORS, 6>,
}

impl SharedErrors {
    /// Of these poses.
    pub fn of(good: &[&PoseFit], azimuth: &Azimuth) -> Self {
        let mut shared = Self { azimuth_sigma: azimuth.sigma, foremost: SMatrix::zeros() };
        let squares: SMatrix<f64, ERRORS, ERRORS> =
            good.iter().map(|fit| shared.errors(fit)).map(|errors| errors.transpose() * errors).sum();
        let SymmetricEigen { eigenvalues, eigenvectors } = SymmetricEigen::new(squares);
        let mut order: [usize; ERRORS] = std::array::from_fn(|k| k);
        order.sort_by(|&a, &b| eigenvalues[b].total_cmp(&eigenvalues[a]));
        shared.foremost = SMatrix::from_fn(|row, k| eigenvectors[(row, order[k])]);
        shared
    }

    /// What independent unit errors do to a bend, rad, in the registration's own azimuth; the azimuth's turns all bends together.
    pub fn errors(&self, fit: &PoseFit) -> SMatrix<f64, 2, ERRORS> {
        let mut errors = SMatrix::<f64, 2, ERRORS>::zeros();
        errors.fixed_columns_mut::<RIG>(0).copy_from(&fit.by_registration);
        let across = Vector2::new(-fit.bend.y, fit.bend.x) * self.azimuth_sigma;
        errors.set_column(RIG, &across);
        errors
    }

    /// The same of the six foremost combinations.
    pub fn foremost(&self, fit: &PoseFit) -> Matrix2x6<f64> {
        self.errors(fit) * self.foremost
    }

    /// The standard deviation of a factor that all θ have in common: what each unit error does to a gain fitted to the bends.
    pub fn share_of_theta(&self, good: &[&PoseFit]) -> f64 {
        let square: f64 = good.iter().map(|fit| fit.bend.norm_squared()).sum();
        let along: SMatrix<f64, 1, ERRORS> =
            good.iter().map(|fit| fit.bend.transpose() * self.errors(fit)).sum::<SMatrix<f64, 1, ERRORS>>();
        if square > 0.0 { along.norm() / square } else { 0.0 }
    }
}
