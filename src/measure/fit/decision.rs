//! The decision between the local minima of one picture's fit: which bend the picture shows, and whether it shows one.
//!
//! The picture of one camera hardly tells towards it from away from it, so that a fit has local minima: the mirrored solution, and bends whose disks fall
//! on their neighbours' places. Each is a mode of the posterior of bend and shape, and holds a mass of it: the [`Evidence`](super::evidence::Evidence) of
//! its edges and the prior probability of its shape. A bend is told if its mode holds nearly all of the mass.

use super::bend::BendFit;
use super::evidence::DECIDING_ODDS;
use crate::observation::Status;
use crate::robot::{MODES, PROFILE};
use nalgebra::SVector;

/// Refined fits that end within this distance of each other, rad, are one local minimum.
///
/// Convention: five times what they have converged to.
pub(crate) const SAME_MINIMUM_RAD: f64 = 5e-3;
/// Fits this close together, rad, differ by how the disks are tilted, which does not show where they are seen edge-on.
///
/// Fitted: by hand on renders; judged by `tests/eye/robustness`.
pub(crate) const EDGE_ON_RAD: f64 = 0.1;
/// The same in a coarse picture: so close that the rims of the tip's disk open by the same amount, px.
///
/// Fitted: by hand on coarse renders; judged by `tests/eye/robustness`.
const EDGE_ON_PX: f64 = 2.0;
/// The share of the posterior's mass that one mode must hold for its bend to be told.
///
/// Derived: the share at the odds that decide.
const DECIDING_SHARE: f64 = DECIDING_ODDS / (1.0 + DECIDING_ODDS);

/// The heaviest mode of a picture's posterior, and what the others leave in doubt.
#[derive(Debug, Clone)]
pub(crate) struct Decision {
    /// The heaviest mode; joined with those of the same snake seen edge-on.
    pub fit: BendFit,
    /// Why its bend is not told, if other snakes hold more than a share of 1 − [`DECIDING_SHARE`] of the mass.
    pub doubt: Option<Status>,
    /// Whether nearly all of the mass of its snake is [of an unlikely shape](BendFit::is_of_unlikely_shape).
    pub is_of_unlikely_shape: bool,
}

impl Decision {
    /// Decides between the modes of the posterior of one picture, which are fits of the fine stage; the snake is `diameter_px` wide in it. `None` of no modes.
    pub fn between(mut modes: Vec<BendFit>, diameter_px: f64) -> Option<Self> {
        let dispersion = dispersion(&modes);
        modes.sort_by(|a, b| b.log_mass(dispersion).total_cmp(&a.log_mass(dispersion)));
        let heaviest = modes.first()?.clone();
        let mass = |fit: &BendFit| (fit.log_mass(dispersion) - heaviest.log_mass(dispersion)).exp();
        let edge_on_rad = EDGE_ON_RAD.max(2.0 * EDGE_ON_PX / diameter_px);
        let is_edge_on = |fit: &BendFit| (fit.bend() - heaviest.bend()).norm() < edge_on_rad;
        let (same, others): (Vec<BendFit>, Vec<BendFit>) =
            separate(modes, SAME_MINIMUM_RAD).into_iter().partition(|fit| is_edge_on(fit));
        let [own, of_others] = [&same, &others].map(|modes| modes.iter().map(mass).sum::<f64>());
        let is_decided = own >= DECIDING_SHARE * (own + of_others);
        let doubt = others.first().filter(|_| !is_decided).map(|other| heaviest.doubt_beside(other));
        let shares: Vec<(&BendFit, f64)> = same.iter().map(|fit| (fit, mass(fit) / own)).collect();
        let is_of_unlikely_shape = are_all(&shares, |fit| fit.is_of_unlikely_shape(dispersion));
        Some(Self { fit: heaviest.joined(&shares), doubt, is_of_unlikely_shape })
    }
}

/// The mode that holds most of the mass.
pub(crate) fn heaviest(modes: &[BendFit]) -> Option<&BendFit> {
    let dispersion = dispersion(modes);
    modes.iter().max_by(|a, b| a.log_mass(dispersion).total_cmp(&b.log_mass(dispersion)))
}

/// By how much the variance of the picture's edges exceeds what their σ say, about the mode that explains them best.
fn dispersion(modes: &[BendFit]) -> f64 {
    modes.iter().map(|fit| fit.excess).reduce(f64::min).unwrap_or(1.0)
}

impl BendFit {
    /// ln of the mass of the posterior that this mode holds, but for what all modes of a picture have in common: what the edges say for it, less how
    /// improbable its shape is. Where edges scatter more than they may, by the factor `dispersion` of their variance, they say so many times less: what
    /// displaces them is unknown, and displaces many alike.
    ///
    /// Source: K. P. Burnham and D. R. Anderson, "Model Selection and Multimodel Inference", 2002, section 2.5: a quasi-likelihood divides ln L by the
    /// variance inflation factor.
    fn log_mass(&self, dispersion: f64) -> f64 {
        self.evidence.total() / dispersion - self.shape_surprise()
    }

    /// −ln of the prior probability of this shape, but for a constant.
    ///
    /// How far this snake departs from an arc is known to its prior's width only, so that every size of a mode counts alike (a density of
    /// 1/σ for its width): the density of a pair of components with mean square error s² is then in proportion to 1/(|a|² + s²), and the volume
    /// that the picture leaves of them to s².
    fn shape_surprise(&self) -> f64 {
        let of_mode = |k: usize| {
            let error = self.covariance[(2 + 2 * k, 2 + 2 * k)] + self.covariance[(3 + 2 * k, 3 + 2 * k)];
            (1.0 + self.profile.modes[k].norm_squared() / error).ln()
        };
        (0..MODES).map(of_mode).sum()
    }

    /// Why the picture tells no bend if another mode holds too much of the mass beside this one: it is the same snake of another shape if one start led
    /// to both.
    fn doubt_beside(&self, other: &Self) -> Status {
        if self.origin == other.origin { Status::UnknownShape } else { Status::Ambiguous }
    }

    /// This fit at the mean of modes with these shares of their mass, of which it is one, with their scatter in its covariance. It is of any shape if they
    /// are.
    fn joined(mut self, modes: &[(&Self, f64)]) -> Self {
        let from_here = |fit: &Self| SVector::from(fit.profile.to_array()) - SVector::from(self.profile.to_array());
        let apart: Vec<_> = modes.iter().map(|(fit, share)| (from_here(fit), *share)).collect();
        let mean: SVector<f64, PROFILE> = apart.iter().map(|(apart, share)| apart * *share).sum();
        let scatter =
            |(apart, share): &(SVector<f64, PROFILE>, f64)| (apart - mean) * (apart - mean).transpose() * *share;
        self.doubt = apart.iter().map(scatter).sum();
        self.covariance += self.doubt;
        self.profile = self.profile.stepped(mean.as_slice());
        self.of_any_shape = are_all(modes, |fit| fit.of_any_shape);
        self
    }
}

/// Whether modes with nearly all of the mass, of which each has this share, have a property.
fn are_all(modes: &[(&BendFit, f64)], property: impl Fn(&BendFit) -> bool) -> bool {
    let share: f64 = modes.iter().filter(|(fit, _)| property(fit)).map(|(_, share)| share).sum();
    share >= DECIDING_SHARE
}

/// Local minima, least cost first; of those that ended within `apart_rad` of each other only the first.
pub(crate) fn distinct(mut fits: Vec<BendFit>, apart_rad: f64) -> Vec<BendFit> {
    fits.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    separate(fits, apart_rad)
}

/// Of those whose bends lie within `apart_rad` of each other only the first.
fn separate(all: Vec<BendFit>, apart_rad: f64) -> Vec<BendFit> {
    let mut kept: Vec<BendFit> = Vec::new();
    for one in all {
        if kept.iter().all(|other| (other.bend() - one.bend()).norm() > apart_rad) {
            kept.push(one);
        }
    }
    kept
}
