//! The local minima of a frame's fit, from the candidates of the coarse search.

use super::fit::{BendFit, FitSchedule, SAME_MINIMUM_RAD, distinct};
use super::fitter::Fitter;
use nalgebra::Vector2;
use rayon::prelude::*;

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
/// Fitted: by hand on renders, for speed; judged by `tests/eye/robustness`.
const REFINED: usize = 2;
/// A coarse fit is refined, and a refined one fitted in the fine stage, if its cost is at most this many times the best one's.
///
/// Fitted: by hand on renders, for speed; judged by `tests/eye/robustness`. The stages before search fewer points, and two ways to the same bend were seen to
/// end with costs of 0.0125 and 0.0164.
pub(super) const RIVAL_COST_RATIO: f64 = 2.0;
/// Of coarse fits that end within this distance of each other, rad, only the best is refined.
///
/// Convention: half a spacing of the coarse search's lattice.
const SAME_COARSE_RAD: f64 = 0.035;

impl Fitter<'_> {
    /// The local minima to which the candidates lead, of which one may be known already.
    pub fn minima(&self, candidates: &[Vector2<f64>], known: Option<BendFit>) -> Vec<BendFit> {
        let minima = self.refine(self.coarse_fits(candidates));
        self.reached_from_nearest(minima, candidates, known)
    }

    /// Local minima, of which the best is reached once more from the candidate nearest to it: what a fit ends at depends a little on where it
    /// starts, and the answer must not depend on which candidates were tried.
    fn reached_from_nearest(
        &self,
        mut minima: Vec<BendFit>,
        candidates: &[Vector2<f64>],
        known: Option<BendFit>,
    ) -> Vec<BendFit> {
        let Some(best) = minima.iter().min_by(|a, b| a.cost.total_cmp(&b.cost)) else { return minima };
        let from = nearest(candidates, best.bend());
        let known = known.filter(|known| Some(known.origin) == from);
        let fit_from =
            |candidate| self.fit(self.start(candidate), &FitSchedule::FROM_CANDIDATE).filter(BendFit::is_promising);
        let again = known.or_else(|| leading_home(candidates, best.bend(), fit_from, BendFit::bend));
        if let Some(again) = again {
            minima.retain(|minimum| (minimum.bend() - again.bend()).norm() > SAME_MINIMUM_RAD);
            minima.push(again);
        }
        minima
    }

    /// Fits the candidates, best first, until one explains all of the outline, and the mirrored solution of the best: the coarse
    /// search may have taken one for the other, and the fit of the wrong one then ends between both.
    fn coarse_fits(&self, candidates: &[Vector2<f64>]) -> Vec<BendFit> {
        let fit = |bend: Vector2<f64>| self.fit(self.start(bend), &FitSchedule::COARSE);
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
    fn refine(&self, coarse: Vec<BendFit>) -> Vec<BendFit> {
        let mut coarse = distinct(coarse, SAME_COARSE_RAD);
        coarse.truncate(REFINED);
        let least_cost = coarse.first().map_or(0.0, |best| best.cost);
        let mut refined: Vec<BendFit> = Vec::new();
        for fit in coarse.iter().filter(|fit| fit.cost <= RIVAL_COST_RATIO * least_cost) {
            let rival_cost = refined.iter().map(|other| other.cost).fold(f64::INFINITY, f64::min);
            refined.extend(self.fit(fit.start(), &FitSchedule::REFINEMENT.beside(rival_cost)));
        }
        refined
    }
}

/// The fit from the candidate nearest to a bend; where another candidate is nearer to where it ends, the fit from that one. `None` where a candidate
/// has no fit, or none ends nearest to where it began.
pub(super) fn leading_home<F>(
    candidates: &[Vector2<f64>],
    bend: Vector2<f64>,
    fit_from: impl Fn(Vector2<f64>) -> Option<F>,
    end: impl Fn(&F) -> Vector2<f64>,
) -> Option<F> {
    let mut candidate = nearest(candidates, bend)?;
    for _ in 0..CANDIDATES_FOLLOWED {
        let fit = fit_from(candidate)?;
        let nearest = nearest(candidates, end(&fit))?;
        if nearest == candidate {
            return Some(fit);
        }
        candidate = nearest;
    }
    None
}

/// The bend nearest to another one.
fn nearest(candidates: &[Vector2<f64>], bend: Vector2<f64>) -> Option<Vector2<f64>> {
    let distance2 = |candidate: &Vector2<f64>| (candidate - bend).norm_squared();
    candidates.iter().copied().min_by(|a, b| distance2(a).total_cmp(&distance2(b)))
}
