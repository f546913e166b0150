//! In which rounds a picture is fitted.

use super::linearised::{COARSE_REWEIGHTING_TOLERANCE, REWEIGHTING_TOLERANCE};

/// A fit has converged when a round moves the bend by less than this, rad: the tip then moves by less than half a pixel, and the same
/// edges would be found again.
///
/// Derived: L/2 · 1e-3 = 0.013 mm for L = 26 mm, half a pixel at 38 px/mm.
pub(crate) const CONVERGED_RAD: f64 = 1e-3;
/// The fine stage has converged when a round moves the bend by less than this, rad.
///
/// Derived: a round, which draws the outline and searches its edges anew, moves the bend by about a seventh of what the round before it did. What
/// is left is 0.02°, below the sigma of any picture.
const FINELY_CONVERGED_RAD: f64 = 2e-3;
/// The last search distance of all fits, px.
///
/// Fitted: by hand on renders, as the others; judged by `tests/eye/robustness`.
const LAST_SEARCH_PX: f64 = 3.0;

/// How a picture is fitted: the rounds, and what is done in each.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FitSchedule {
    /// Search distances, px, one for each round; the last one is gone on to as soon as a round hardly moves the bend, and kept until the fit has
    /// converged.
    pub searches_px: &'static [f64],
    /// The most rounds.
    pub rounds: usize,
    /// Whether it is the fine stage, whose start is close to the answer: all outline points are searched, with the finest filter
    /// and against a blurred model, and what disagrees is an outlier. The coarse stages search fewer points, enough to tell which
    /// bend it is.
    pub is_fine: bool,
    /// A round that moves the bend by less than this, rad, is the last.
    pub converged_rad: f64,
    /// The cost of another fit, beside which this one is given up where it will end far above it.
    pub rival_cost: f64,
}

impl FitSchedule {
    /// The fit of a candidate, from the lattice of the coarse search.
    ///
    /// Fitted: the search distances, by hand on renders, here and below; judged by `tests/eye/robustness`.
    pub const COARSE: Self = Self { searches_px: &[14.0, 8.0], rounds: 2, ..Self::REFINEMENT };
    /// The refinement of a coarse fit.
    pub const REFINEMENT: Self = Self {
        searches_px: &[6.0, LAST_SEARCH_PX],
        rounds: 20,
        is_fine: false,
        converged_rad: CONVERGED_RAD,
        rival_cost: f64::INFINITY,
    };
    /// Both in one, of a candidate that is tried alone.
    ///
    /// Derived: from both.
    pub const FROM_CANDIDATE: Self = Self { searches_px: &[14.0, 8.0, 6.0, LAST_SEARCH_PX], ..Self::REFINEMENT };
    /// The same from a start that is closer than the lattice: the last frame's bend, or a mirrored solution.
    pub const FROM_NEAR: Self = Self { searches_px: &[14.0, 6.0, LAST_SEARCH_PX], ..Self::REFINEMENT };
    /// The fine stage.
    pub const FINE: Self = Self {
        searches_px: &[LAST_SEARCH_PX],
        rounds: 9,
        is_fine: true,
        converged_rad: FINELY_CONVERGED_RAD,
        ..Self::REFINEMENT
    };
    /// The fine stage of a tracked sequence, which must keep up with the camera: another round would change the bend by a hundredth of a
    /// degree.
    pub const TRACKED_FINE: Self = Self { rounds: 1, ..Self::FINE };

    /// The same, but given up where it will end far above this cost of another fit.
    pub fn beside(self, rival_cost: f64) -> Self {
        Self { rival_cost, ..self }
    }

    /// A reweighting that moves the state by less is the last of a linearisation.
    pub fn reweighting_tolerance(&self) -> f64 {
        if self.is_fine { REWEIGHTING_TOLERANCE } else { COARSE_REWEIGHTING_TOLERANCE }
    }
}
