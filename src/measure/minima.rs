//! The local minima of a frame's fit, from the candidates of the coarse search.

use super::eye::{Eye, REFINEMENT, SAME_MINIMUM_RAD};
use super::fit::{BendFit, CoarseSearch, EdgeFinder, FitSchedule, distinct};
use super::image::plane::Plane;
use nalgebra::Vector2;
use rayon::prelude::*;

/// How many candidates the coarse search hands on.
///
/// Fitted: by hand on renders; judged by `tests/robustness`.
const CANDIDATES: usize = 6;
/// How many candidates are fitted at a time.
///
/// Convention: two whatever the number of cores, so that the answer does not depend on it.
const CANDIDATES_AT_A_TIME: usize = 2;
/// How many candidates are tried one after the other, each the nearest to where the one before led.
///
/// Convention: an iteration cap. In one frame of six the second is needed, and leads to what it is nearest to.
const CANDIDATES_FOLLOWED: usize = 2;
/// How many coarse fits are refined.
///
/// Fitted: by hand on renders, for speed; judged by `tests/robustness`.
const REFINED: usize = 2;
/// The fit of a candidate, from the lattice of the coarse search.
///
/// Fitted: the search distances, by hand on renders; judged by `tests/robustness`.
const COARSE: FitSchedule = FitSchedule { searches_px: &[14.0, 8.0], rounds: 2, ..REFINEMENT };
/// Both in one, of a candidate that is tried alone.
///
/// Derived: from both.
const COARSE_THEN_REFINED: FitSchedule = FitSchedule { searches_px: &[14.0, 8.0, 6.0, 3.0], ..REFINEMENT };
/// Coarse fits are refined if their cost is at most this many times the best one's.
///
/// Fitted: by hand on renders, for speed; judged by `tests/robustness`.
const REFINED_COST_RATIO: f64 = 3.0;
/// Of coarse fits that end within this distance of each other, rad, only the best is refined.
///
/// Convention: half a spacing of the coarse search's lattice.
const SAME_COARSE_RAD: f64 = 0.035;

impl Eye {
    /// The coarse search; made now if no frame asked for it before.
    pub(super) fn search(&self) -> &CoarseSearch {
        if let Some(made) = self.search.get() {
            return made;
        }
        // Made outside of the lock: a thread of a pool that waits here for others may be given the next frame, which asks as well.
        let made = CoarseSearch::new(&self.lens, self.search_pose, &self.robot);
        self.search.get_or_init(|| made)
    }

    /// Makes the coarse search now, and not when the first frame asks for it.
    pub fn prepare(&self) {
        self.search();
    }

    /// Bends that the coarse search finds in a whole picture, best first.
    pub(super) fn candidates(&self, plane: &Plane) -> Vec<Vector2<f64>> {
        self.search().candidates(plane, self.rig.appearance.two_sided, CANDIDATES)
    }

    /// The local minimum to which the candidate nearest to an expected bend leads; where another candidate is nearer to the minimum, the one
    /// to which that leads. `None` where it is not promising, or no candidate leads to what it is nearest to.
    pub(super) fn minimum_near(
        &self,
        expected: Vector2<f64>,
        candidates: &[Vector2<f64>],
        finder: &EdgeFinder,
    ) -> Option<BendFit> {
        let mut candidate = nearest(candidates, expected)?;
        for _ in 0..CANDIDATES_FOLLOWED {
            let minimum = self.fit(finder, self.start(candidate), &COARSE_THEN_REFINED);
            let minimum = minimum.filter(BendFit::is_promising)?;
            let nearest = nearest(candidates, minimum.bend())?;
            if nearest == candidate {
                return Some(minimum);
            }
            candidate = nearest;
        }
        None
    }

    /// The local minima to which the candidates lead, of which one may be known already from [`minimum_near`](Self::minimum_near).
    pub(super) fn minima(
        &self,
        candidates: &[Vector2<f64>],
        known: Option<BendFit>,
        finder: &EdgeFinder,
    ) -> Vec<BendFit> {
        let minima = self.refine(self.coarse_fits(candidates, finder), finder);
        self.reached_from_nearest(minima, candidates, known, finder)
    }

    /// Local minima, of which the best is reached once more from the candidate nearest to it: what a fit ends at depends a little on where it
    /// starts, and the answer must not depend on which candidates were tried.
    fn reached_from_nearest(
        &self,
        mut minima: Vec<BendFit>,
        candidates: &[Vector2<f64>],
        known: Option<BendFit>,
        finder: &EdgeFinder,
    ) -> Vec<BendFit> {
        let Some(best) = minima.iter().min_by(|a, b| a.cost.total_cmp(&b.cost)) else { return minima };
        let from = nearest(candidates, best.bend());
        let known = known.filter(|known| Some(known.origin) == from);
        if let Some(again) = known.or_else(|| self.minimum_near(best.bend(), candidates, finder)) {
            minima.retain(|minimum| (minimum.bend() - again.bend()).norm() > SAME_MINIMUM_RAD);
            minima.push(again);
        }
        minima
    }

    /// Fits the candidates, best first, until one explains all of the outline, and the mirrored solution of the best: the coarse
    /// search may have taken one for the other, and the fit of the wrong one then ends between both.
    fn coarse_fits(&self, candidates: &[Vector2<f64>], finder: &EdgeFinder) -> Vec<BendFit> {
        let fit = |bend: Vector2<f64>| self.fit(finder, self.start(bend), &COARSE);
        let mut fits: Vec<BendFit> = Vec::new();
        for few in candidates.chunks(CANDIDATES_AT_A_TIME) {
            fits.par_extend(few.par_iter().filter_map(|&bend| fit(bend)));
            if fits.iter().any(BendFit::explains_all) {
                break;
            }
        }
        let best = fits.iter().min_by(|a, b| a.cost.total_cmp(&b.cost));
        let mirrored = best.and_then(|best| fit(self.mirrored(best.origin)));
        fits.extend(mirrored);
        fits
    }

    /// Fits the best of the coarse fits until they converge, or prove hopeless beside those before them.
    fn refine(&self, coarse: Vec<BendFit>, finder: &EdgeFinder) -> Vec<BendFit> {
        let mut coarse = distinct(coarse, SAME_COARSE_RAD);
        coarse.truncate(REFINED);
        let least_cost = coarse.first().map_or(0.0, |best| best.cost);
        let mut refined: Vec<BendFit> = Vec::new();
        for fit in coarse.iter().filter(|fit| fit.cost <= REFINED_COST_RATIO * least_cost) {
            let best = refined.iter().min_by(|a, b| a.cost.total_cmp(&b.cost));
            let schedule = best.map_or(REFINEMENT, |best| REFINEMENT.beside(best));
            refined.extend(self.fit(finder, fit.start(), &schedule));
        }
        refined
    }
}

/// The bend nearest to another one.
fn nearest(candidates: &[Vector2<f64>], bend: Vector2<f64>) -> Option<Vector2<f64>> {
    let distance2 = |candidate: &Vector2<f64>| (candidate - bend).norm_squared();
    candidates.iter().copied().min_by(|a, b| distance2(a).total_cmp(&distance2(b)))
}
