//! The outlier gate: how far a measurement may be from its prediction.
//!
//! A residual is split into the bending part (θ or δ are wrong) and the common part (the encoders are), and each is measured in units
//! of its predicted standard deviation. Sigmas may promise too much and the model may lack an effect, so the distance that counts is
//! relative to the typical one: the median over the last 51 measurements, rejected or not, where that is above its nominal value. For
//! the common part, which encoders tell to a micron, the model is not trusted to better than 0.02 mm: effects of that size are what a
//! later search is to find, and it cannot find them in measurements thrown away here.

use super::consistency::Whitened;
use super::{LinearisedMeasurement, Reason};
use crate::statistics::order::median;
use nalgebra::{Matrix3, Vector3};
use std::collections::VecDeque;

/// Measurements over which the gate takes its typical distance.
///
/// Fitted: chosen with the estimator on the simulated experiments of `tests/library/estimator.rs`; not judged elsewhere. The median of 51 squared
/// distances is known to 20 %, and 25 outliers among them do not spoil it.
const RECENT: usize = 51;
/// How far the model is trusted in the part common to all backbones when outliers are sought, mm.
///
/// Fitted: below the effects that the project's hidden-effect experiments switch on (0.04 mm rms in ε and more, `simulate::sealed`); not judged
/// elsewhere.
const COMMON_TRUST_MM: f64 = 0.02;
/// Medians of χ² with 2 and 1 degrees of freedom.
///
/// Derived: 2 ln 2, and Φ⁻¹(¾)².
const NOMINAL_MEDIANS: [f64; 2] = [1.386_294, 0.454_936];

/// Squared distances of a residual from its prediction, in units of the predicted variances: bending part, common part.
pub(super) type SquaredDistances = [f64; 2];

/// The gate with its memory of typical distances.
#[derive(Debug, Clone)]
pub(super) struct Gate {
    /// Standard deviations beyond which a measurement is an outlier.
    sds: f64,
    /// Of the last measurements.
    recent: VecDeque<SquaredDistances>,
}

impl Gate {
    pub fn new(sds: f64) -> Self {
        Self { sds, recent: VecDeque::with_capacity(RECENT) }
    }

    /// Whether a residual is too far off for what the last measurements were.
    pub fn outlier(&self, squared: &SquaredDistances) -> Option<Reason> {
        outlier(self.sds, squared, self.recent.iter())
    }

    /// Takes a distance into the memory; the earliest makes room.
    pub fn remember(&mut self, squared: SquaredDistances) {
        if self.recent.len() == RECENT {
            self.recent.pop_front();
        }
        self.recent.push_back(squared);
    }

    /// Forgets all distances but these.
    pub fn restart(&mut self, squared: impl IntoIterator<Item = SquaredDistances>) {
        self.recent.clear();
        squared.into_iter().for_each(|squared| self.remember(squared));
    }
}

/// Whether a distance is beyond so many standard deviations, in units of the typical one of `others` where that is above nominal.
pub(super) fn outlier<'a>(
    sds: f64,
    squared: &SquaredDistances,
    others: impl Iterator<Item = &'a SquaredDistances> + Clone,
) -> Option<Reason> {
    let beyond = |part: usize| {
        // What is typical counts at least 1: within the gate without it is within the gate.
        if squared[part].sqrt() <= sds {
            return None;
        }
        let mut sizes: Vec<f64> = others.clone().map(|squared| squared[part]).collect();
        let typical = (median(&mut sizes) / NOMINAL_MEDIANS[part]).max(1.0);
        Some((squared[part] / typical).sqrt()).filter(|distance| *distance > sds)
    };
    beyond(0).map(Reason::BendOutlier).or_else(|| beyond(1).map(Reason::CommonOutlier))
}

/// The distances of a residual from 0, as the gate sees them, by its covariance H P Hᵗ + R, mm²; `None` where that is not positive definite.
pub(super) fn squared_distances(
    linearised: &LinearisedMeasurement,
    residual: &Vector3<f64>,
    predicted: &Matrix3<f64>,
) -> Option<SquaredDistances> {
    let whitened = Whitened::new(residual, &(predicted + distrust(linearised)))?;
    Some([whitened.bending.norm_squared(), whitened.common.powi(2)])
}

/// What is added to a measurement's covariance because the model's common part deserves no more trust, mm².
pub(super) fn distrust(linearised: &LinearisedMeasurement) -> Matrix3<f64> {
    // λ's column of H: a mm in every backbone.
    let common = linearised.h.column(1) * COMMON_TRUST_MM;
    common * common.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gate_is_in_units_of_what_is_typical() {
        let mut gate = Gate::new(4.5);
        assert_eq!(gate.outlier(&[4.4f64.powi(2), 4.4f64.powi(2)]), None);
        assert_eq!(gate.outlier(&[5.0f64.powi(2), 9.0]), Some(Reason::BendOutlier(5.0)));
        assert_eq!(gate.outlier(&[9.0, 5.0f64.powi(2)]), Some(Reason::CommonOutlier(5.0)));
        // Where distances are typically twice nominal, 8 standard deviations are 4, and 10 are 5.
        (0..RECENT).for_each(|_| gate.remember(NOMINAL_MEDIANS.map(|nominal| 4.0 * nominal)));
        assert_eq!(gate.outlier(&[64.0, 64.0]), None);
        let Some(Reason::BendOutlier(distance)) = gate.outlier(&[100.0, 0.0]) else { panic!("10 is beyond the gate") };
        assert!((distance - 5.0).abs() < 1e-12);
        // Where they are typically smaller than nominal, the gate stays where it is.
        gate.restart(std::iter::repeat_n([0.01, 0.01], RECENT));
        assert_eq!(gate.outlier(&[5.0f64.powi(2), 0.0]), Some(Reason::BendOutlier(5.0)));
    }

    #[test]
    fn the_nominal_medians_are_those_of_chi_square() {
        let normal_quartile = 1.0 / crate::statistics::order::SD_BY_MAD;
        assert!((NOMINAL_MEDIANS[0] - 2.0 * 2f64.ln()).abs() < 1e-6);
        assert!((NOMINAL_MEDIANS[1] - normal_quartile.powi(2)).abs() < 1e-6);
    }
}
