//! The recursion of Eq. 19 as a square-root information filter of x = (η, λ, uncertain parameters of the effects).
//!
//! Eq. 19's P_k = (HᵗR⁻¹H)⁻¹ over all measurements so far and its x̂ are what [`SquareRootInformation`] arrives at; each linearised
//! measurement is whitened by its own covariance R before it is absorbed. Of η and λ there is no prior: the first measurements alone make the
//! first estimate. What is known beforehand of the effects stands beside what the measurements say, so that forgetting these leads back to it.

use super::LinearisedMeasurement;
use super::effects::EffectsPrior;
use crate::statistics::information::SquareRootInformation;
use nalgebra::{DMatrix, DVector, Matrix6xX};

/// The largest standard deviation of η, and of λ in mm, with which they count as known; an estimate with a larger one is not given.
///
/// Convention: as wide as the range in which any robot's η (about 1) and λ (below 1 mm) are looked for.
pub(super) const KNOWN_SD: f64 = 1.0;
/// The standard deviation, likewise, at which forgetting stops.
///
/// Convention: half of [`KNOWN_SD`], so that an estimate that was known does not cease to be while nothing excites it.
const FORGOTTEN_SD: f64 = 0.5;

/// What all measurements so far say about x.
#[derive(Debug, Clone, PartialEq)]
pub struct InformationFilter {
    /// What is known beforehand of the effects, if anything is uncertain there, ...
    prior: Option<SquareRootInformation>,
    /// ... and what the measurements say.
    information: SquareRootInformation,
    measurements: usize,
    /// Σ CᵗR⁻¹H over the measurements, C being what the rig's unit errors do to each.
    by_rig: Matrix6xX<f64>,
    /// Σ HᵗR⁻¹CCᵗR⁻¹H: what their share of R counts for where it is taken for each measurement's own.
    of_rig: DMatrix<f64>,
}

impl Default for InformationFilter {
    /// Of η and λ, of which nothing is known.
    fn default() -> Self {
        Self::new(&EffectsPrior::default())
    }
}

impl InformationFilter {
    /// Of η, λ and the parameters of effects of which something is known beforehand.
    pub(super) fn new(prior: &EffectsPrior) -> Self {
        let n = prior.count();
        Self {
            prior: prior.information.clone(),
            information: SquareRootInformation::none(n),
            measurements: 0,
            by_rig: Matrix6xX::zeros(n),
            of_rig: DMatrix::zeros(n, n),
        }
    }

    /// Adds a measurement. One whose covariance is not positive definite, or whose numbers or their squares are not all finite,
    /// says nothing and changes nothing.
    pub fn absorb(&mut self, linearised: &LinearisedMeasurement) {
        let LinearisedMeasurement { z, h, by_rig, .. } = linearised;
        let whitened = (linearised.whitened(h), linearised.whitened(z), linearised.whitened(by_rig));
        let (Some(h), Some(z), Some(by_rig)) = whitened else { return };
        if self.information.absorb(&h, &z) {
            self.measurements += 1;
            let by_rig = by_rig.tr_mul(&h);
            self.of_rig += by_rig.tr_mul(&by_rig);
            self.by_rig += by_rig;
        }
    }

    /// Multiplies all that the measurements said by the forgetting factor in (0, 1], but lets no direction's standard deviation grow beyond
    /// 0.5, see [`SquareRootInformation::forget`]. Without a prior x̂ does not move; with one it goes back towards it.
    pub fn forget(&mut self, factor: f64) {
        self.information.forget(factor, FORGOTTEN_SD);
        self.by_rig *= factor;
        self.of_rig *= factor;
    }

    /// What is to be added to P because the measurements before one rig share its errors: P takes them for independent, so that any number
    /// of measurements would average them away. Weighted by R, x̂ errs by P Σ HᵗR⁻¹C for the rig's unit errors, which takes the place of
    /// their part of P.
    ///
    /// Source: the consider covariance of Schmidt, Application of state-space methods to navigation problems, 1966.
    pub fn covariance_by_rig(&self, covariance: &DMatrix<f64>) -> DMatrix<f64> {
        covariance * (self.by_rig.tr_mul(&self.by_rig) - &self.of_rig) * covariance
    }

    /// The part of P that the uncertainty of what was known beforehand makes, P times its information times P.
    pub(super) fn covariance_by_prior(&self, covariance: &DMatrix<f64>) -> DMatrix<f64> {
        let information = self.prior.as_ref().map(|prior| covariance * prior.matrix() * covariance);
        information.unwrap_or_else(|| covariance * 0.0)
    }

    /// x̂ and P, without inflation; `None` while the measurements do not pin η and λ.
    pub fn solution(&self) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let known = |p: &DMatrix<f64>| (0..2).all(|k| p[(k, k)] < KNOWN_SD.powi(2));
        let solution = match &self.prior {
            None => self.information.solution(),
            Some(prior) => self.information.clone().and(prior).solution(),
        };
        solution.filter(|(_, covariance)| known(covariance))
    }

    /// How many measurements were added.
    pub fn measurements(&self) -> usize {
        self.measurements
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Matrix3, Matrix3x6, Matrix3xX, Vector2, Vector3};
    use proptest::prelude::*;

    fn of<'a>(rows: impl IntoIterator<Item = &'a LinearisedMeasurement>) -> InformationFilter {
        let mut filter = InformationFilter::default();
        rows.into_iter().for_each(|row| filter.absorb(row));
        filter
    }

    fn any_measurement() -> impl Strategy<Value = LinearisedMeasurement> {
        (proptest::array::uniform3(-2.0..2.0f64), proptest::array::uniform3(-1.0..1.0f64), 1e-3..1.0f64).prop_map(
            |(z, elastic, sd)| {
                let h = Matrix3xX::from_columns(&[Vector3::from(elastic), Vector3::repeat(1.0)]);
                let skew = Vector3::from(elastic) * sd;
                let covariance = Matrix3::identity() * sd.powi(2) + skew * skew.transpose();
                LinearisedMeasurement { z: z.into(), h, covariance, by_rig: Matrix3x6::zeros() }
            },
        )
    }

    /// A measurement of a straight snake: λ = 0.2 mm, nothing of η.
    fn straight() -> LinearisedMeasurement {
        LinearisedMeasurement {
            z: Vector3::repeat(0.2),
            h: Matrix3xX::from_columns(&[Vector3::zeros(), Vector3::repeat(1.0)]),
            covariance: Matrix3::identity() * 1e-4,
            by_rig: Matrix3x6::zeros(),
        }
    }

    proptest! {
        #[test]
        fn recursion_and_weighted_batch_agree(rows in proptest::collection::vec(any_measurement(), 2..60)) {
            let (mut information, mut right) = (Matrix2::zeros(), Vector2::zeros());
            for row in &rows {
                let weight = row.covariance.try_inverse().unwrap();
                information += row.h.transpose() * weight * &row.h;
                right += row.h.transpose() * weight * row.z;
            }
            let covariance = information.try_inverse().unwrap();
            prop_assume!(covariance.diagonal().max() < 0.9);
            let (ours, p) = of(&rows).solution().unwrap();
            prop_assert!((&ours - covariance * right).norm() <= 1e-9 * ours.norm(), "{ours}");
            prop_assert!((p - covariance).norm() <= 1e-9 * covariance.norm());
        }

        #[test]
        fn the_covariance_stays_positive_and_bounded_while_only_lambda_is_excited(
            rows in proptest::collection::vec(any_measurement(), 2..20), factor in 0.01..0.999f64
        ) {
            let largest = |filter: &InformationFilter| {
                filter.information.solution().map(|(_, p)| p.symmetric_eigenvalues())
            };
            let mut filter = of(&rows);
            prop_assume!(largest(&filter).is_some_and(|own| own.max() < FORGOTTEN_SD.powi(2)));
            for _ in 0..2000 {
                filter.forget(factor);
                filter.absorb(&straight());
            }
            let own = largest(&filter).unwrap();
            prop_assert!(own.min() > 0.0 && own.max() <= (1.0 + 1e-9) * FORGOTTEN_SD.powi(2), "{own}");
            prop_assert!((filter.solution().unwrap().0[1] - 0.2).abs() < 1e-3);
        }
    }

    #[test]
    fn a_straight_snake_alone_tells_nothing_of_eta() {
        assert!(of(&[straight(), straight(), straight()]).solution().is_none());
    }

    #[test]
    fn a_measurement_without_a_proper_covariance_changes_nothing() {
        let mut filter = InformationFilter::default();
        let bad = |covariance| LinearisedMeasurement {
            z: Vector3::zeros(),
            h: Matrix3xX::repeat(2, 1.0),
            covariance,
            by_rig: Matrix3x6::zeros(),
        };
        filter.absorb(&bad(Matrix3::zeros()));
        filter.absorb(&bad(Matrix3::repeat(f64::NAN)));
        assert_eq!(filter, InformationFilter::default());
    }
}
