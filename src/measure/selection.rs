//! The selection among the local minima of a frame's fit: which of them the picture shows, and whether another explains it as well.

use super::eye::{COARSE_TO_REFINED, Eye, REFINEMENT, SAME_MINIMUM_RAD};
use super::fit::{Alternative, BendFit, EDGE_ON_RAD, EdgeFinder, FitSchedule, Start, distinct, fit_bend};
use crate::observation::Status;
use rayon::prelude::*;

/// An alternative is fitted in the fine stage if its cost is at most this many times the best one's.
///
/// Derived: the 1.5 times from which on it is worse, and a third more: the stages so far search fewer points, and two ways to the same bend
/// were seen to end with costs of 0.0125 and 0.0164.
const ALTERNATIVE_COST_RATIO: f64 = 2.0;
/// How often the better of a bend and its mirrored solution is tried in its place.
///
/// Convention: an iteration cap; once is nearly always enough, and twice was seen.
const MIRRORED_AGAIN: usize = 3;

/// What a minimum leads to.
pub(super) struct Attempt {
    /// Where it starts.
    pub minimum: BendFit,
    /// The fit of its mirrored solution, where that is not hopeless beside it.
    pub mirrored: Option<BendFit>,
    /// Its fit in the fine stage.
    pub finest: Option<BendFit>,
}

impl Attempt {
    /// The mirrored solution, where it is another minimum and the better one.
    fn better_mirrored(&self) -> Option<&BendFit> {
        let Self { minimum, mirrored, .. } = self;
        let is_another = |other: &BendFit| (other.bend() - minimum.bend()).norm() > SAME_MINIMUM_RAD;
        mirrored.as_ref().filter(|other| is_another(other) && other.cost < minimum.cost)
    }
}

/// The outcome of the selection among local minima.
pub(super) struct Selection {
    /// The local minima, best first.
    pub fits: Vec<BendFit>,
    /// Whether there is a first and its fit in the fine stage succeeded.
    pub has_fine_fit: bool,
    /// Whether another bend explained the picture in the fine stage as well as the best one so far.
    pub has_alternative: bool,
    /// What was tried.
    pub attempts: Vec<Attempt>,
    /// Why the first is not to be relied on, if another one explains the picture as well: another bend, or the same snake of another shape.
    pub doubt: Option<Status>,
}

impl Selection {
    /// None of these minima has a fit in the fine stage.
    fn without_fine_fit(fits: Vec<BendFit>, attempts: Vec<Attempt>) -> Self {
        Self { fits, has_fine_fit: false, has_alternative: false, attempts, doubt: None }
    }
}

impl Eye {
    /// The fit in the fine stage; with any shape where the picture contradicts what is known of the snake's.
    fn fit_fine(&self, finder: &EdgeFinder, start: Start, schedule: &FitSchedule) -> Option<BendFit> {
        let fit = self.fit(finder, start, schedule)?;
        if !fit.contradicts_shape {
            return Some(fit);
        }
        self.fit_any_shape(finder, fit.start(), schedule).or(Some(fit))
    }

    /// The fit in the fine stage of a snake that may have any shape.
    fn fit_any_shape(&self, finder: &EdgeFinder, start: Start, schedule: &FitSchedule) -> Option<BendFit> {
        let (view, any_shape) = (self.projection(), self.rig.prior().of_any_shape());
        // Edges may lie further from the wrong shape than the fine stage searches.
        let refined = fit_bend(&view, finder, start, any_shape, &COARSE_TO_REFINED)?;
        let mut fit = fit_bend(&view, finder, refined.start(), any_shape, schedule)?;
        fit.contradicts_shape = true;
        Some(fit)
    }

    /// Fits a minimum in the fine stage, and beside it its mirrored solution, unless that was done before; says which of the attempts it is.
    fn attempt(
        &self,
        minimum: &BendFit,
        attempts: &mut Vec<Attempt>,
        finder: &EdgeFinder,
        fine: &FitSchedule,
    ) -> usize {
        if let Some(known) = attempts.iter().position(|attempt| attempt.minimum.is_same_fit(minimum)) {
            return known;
        }
        let bend = self.mirrored(minimum.bend());
        let is_close = (bend - minimum.bend()).norm() < EDGE_ON_RAD;
        let schedule = if is_close { REFINEMENT } else { COARSE_TO_REFINED };
        let mirrored = || self.fit(finder, self.start(bend), &schedule.beside(minimum));
        // The longer of both is begun at once; the other waits for a free core.
        let (finest, mirrored) = rayon::join(|| self.fit_fine(finder, minimum.start(), fine), mirrored);
        attempts.push(Attempt { minimum: minimum.clone(), mirrored, finest });
        attempts.len() - 1
    }

    /// Fits the best of some local minima in the fine stage, and finds out whether another one explains the picture as well.
    pub(super) fn select(
        &self,
        minima: Vec<BendFit>,
        mut attempts: Vec<Attempt>,
        finder: &EdgeFinder,
        fine: &FitSchedule,
    ) -> Selection {
        let fits = distinct(minima, SAME_MINIMUM_RAD);
        let Some(best) = fits.first() else { return Selection::without_fine_fit(fits, attempts) };
        let mut last = self.attempt(best, &mut attempts, finder, fine);
        let mut mirrored = Vec::new();
        // The mirrored solution is seldom the better one. It is then tried itself, with a mirrored solution of its own, which need not be where
        // the fit before it ended.
        for _ in 0..MIRRORED_AGAIN {
            let Some(better) = attempts[last].better_mirrored().cloned() else { break };
            last = self.attempt(&better, &mut attempts, finder, fine);
            mirrored.push(better);
        }
        mirrored.extend(attempts[last].mirrored.clone());
        let mut fits = distinct(fits.into_iter().chain(mirrored).collect(), SAME_MINIMUM_RAD);
        let Some(mut best) = attempts[last].finest.clone() else {
            return Selection::without_fine_fit(fits, attempts);
        };
        let diameter_px = self.projection().diameter_px();
        let compare = |other: &BendFit, best: &BendFit| Alternative::of(other, best, diameter_px);
        let alternatives = fits[1..].iter().filter(|other| other.cost <= ALTERNATIVE_COST_RATIO * fits[0].cost);
        let (mut has_alternative, mut doubt) = (false, None);
        // An alternative may end at the same bend in the fine stage, or prove to be worse.
        let mut weigh = |best: BendFit, other: BendFit, status: Status| {
            let compared = compare(&other, &best);
            has_alternative |= compared == Alternative::AsGood;
            match compared {
                Alternative::EdgeOn => return best.or_edge_on(other),
                Alternative::AsGood if compare(&best, &other) == Alternative::Worse => return other,
                Alternative::AsGood if other.has_likelier_shape_than(&best) => return other,
                Alternative::AsGood if !best.has_likelier_shape_than(&other) => _ = doubt.get_or_insert(status),
                Alternative::AsGood | Alternative::Worse => {}
            }
            best
        };
        // Fitted side by side, since a frame with several may take three times as long as others, and weighed in order.
        let alternatives: Vec<&BendFit> = alternatives.collect();
        let fit_fine = |other: &BendFit| match attempts.iter().find(|attempt| attempt.minimum.is_same_fit(other)) {
            Some(known) => known.finest.clone(),
            None => self.fit_fine(finder, other.start(), fine),
        };
        let others: Vec<_> = alternatives.into_par_iter().filter_map(fit_fine).collect();
        for other in others {
            best = weigh(best, other, Status::Ambiguous);
        }
        // From a shape that the sequence told a fit starts in the right minimum.
        if best.contradicts_shape && !self.rig.is_shape_known() {
            let starts = best.shapes_beside(&self.projection()).into_par_iter();
            let others: Vec<_> = starts.filter_map(|start| self.fit_any_shape(finder, start, fine)).collect();
            for other in others {
                best = weigh(best, other, Status::UnknownShape);
            }
        }
        fits[0] = best;
        Selection { fits, has_fine_fit: true, has_alternative, attempts, doubt }
    }
}
