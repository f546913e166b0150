//! The selection among the local minima of a frame's fit: which of them the picture shows, and whether another explains it as well.

use super::fit::{BendFit, Decision, EDGE_ON_RAD, FitSchedule, SAME_MINIMUM_RAD, distinct, heaviest};
use super::fitter::Fitter;
use crate::observation::Status;
use rayon::prelude::*;

/// An alternative is fitted in the fine stage if its cost is at most this many times the best one's.
///
/// Fitted: by hand on renders, for speed; judged by `tests/eye/robustness`. The stages so far search fewer points, and two ways to the same bend were seen to
/// end with costs of 0.0125 and 0.0164.
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
    /// Its fits in the fine stage.
    pub finest: Vec<BendFit>,
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
    /// What was tried.
    pub attempts: Vec<Attempt>,
    /// Why the first is not to be relied on, if another one may be what the picture shows: another bend, or the same snake of another shape.
    pub refusal: Option<Status>,
}

impl Selection {
    /// None of these minima has a fit in the fine stage.
    fn without_fine_fit(fits: Vec<BendFit>, attempts: Vec<Attempt>) -> Self {
        Self { fits, has_fine_fit: false, attempts, refusal: None }
    }
}

impl Fitter<'_> {
    /// Fits the best of some local minima in the fine stage, and finds out whether another one explains the picture as well. What was
    /// attempted before is not fitted again.
    pub fn select(&self, minima: Vec<BendFit>, mut attempts: Vec<Attempt>, fine: &FitSchedule) -> Selection {
        let fits = distinct(minima, SAME_MINIMUM_RAD);
        let Some(first) = fits.first() else { return Selection::without_fine_fit(fits, attempts) };
        let (finest, mirrored) = self.attempt_with_mirrored(first, &mut attempts, fine);
        let mut fits = distinct(fits.into_iter().chain(mirrored).collect(), SAME_MINIMUM_RAD);
        if finest.is_empty() {
            return Selection::without_fine_fit(fits, attempts);
        }
        let others = self.alternatives(&fits, &attempts, fine);
        let mut modes: Vec<BendFit> = finest.into_iter().chain(others).collect();
        // From a shape that the sequence told a fit starts in the right minimum.
        if !self.rig.is_shape_known() {
            self.add_any_shape(&mut modes, fine);
            self.add_other_shapes(&mut modes, fine);
        }
        self.add_mirroring(&mut modes, fine);
        let decision = Decision::between(modes, self.view.diameter_px());
        let Some(Decision { fit, refusal }) = decision else { return Selection::without_fine_fit(fits, attempts) };
        fits[0] = fit;
        Selection { fits, has_fine_fit: true, attempts, refusal }
    }

    /// Adds what the heaviest mode becomes if the snake may have any shape: where part of the outline is hidden, what is left of it may not
    /// contradict a shape that the snake does not have.
    fn add_any_shape(&self, modes: &mut Vec<BendFit>, fine: &FitSchedule) {
        let best = heaviest(modes).filter(|best| !(best.is_of_unlikely_shape() || best.explains_all()));
        let any_shape = best.and_then(|best| self.fit_any_shape(best.start(), fine));
        modes.extend(any_shape);
    }

    /// Adds snakes of other shapes that look like that of the heaviest mode, if that contradicts what is known of the shape.
    fn add_other_shapes(&self, modes: &mut Vec<BendFit>, fine: &FitSchedule) {
        let Some(best) = heaviest(modes).filter(|best| best.of_any_shape) else { return };
        let starts = best.shapes_beside(&self.view).into_par_iter();
        let others: Vec<BendFit> = starts.filter_map(|start| self.fit_any_shape(start, fine)).collect();
        modes.extend(others);
    }

    /// Adds the snakes of modes whose faces mirror a lamp, if the end of the heaviest one is not seen as it should be and the disks before it are.
    fn add_mirroring(&self, modes: &mut Vec<BendFit>, fine: &FitSchedule) {
        let is_end_alone_unseen = |fit: &BendFit| !fit.evidence.shows_tip() && fit.evidence.before_tip() > 0.0;
        if heaviest(modes).is_some_and(is_end_alone_unseen) {
            let mirroring = modes.par_iter().flat_map_iter(|fit| self.fit_mirroring(fit, fine));
            modes.extend(mirroring.collect::<Vec<_>>());
        }
    }

    /// The fits in the fine stage of a minimum, or of its mirrored solution where that is the better one, and the mirrored solutions that
    /// were met.
    fn attempt_with_mirrored(
        &self,
        minimum: &BendFit,
        attempts: &mut Vec<Attempt>,
        fine: &FitSchedule,
    ) -> (Vec<BendFit>, Vec<BendFit>) {
        let mut last = self.attempt(minimum, attempts, fine);
        let mut mirrored = Vec::new();
        // The mirrored solution is seldom the better one. It is then tried itself, with a mirrored solution of its own, which need not be where
        // the fit before it ended.
        for _ in 0..MIRRORED_AGAIN {
            let Some(better) = attempts[last].better_mirrored().cloned() else { break };
            last = self.attempt(&better, attempts, fine);
            mirrored.push(better);
        }
        mirrored.extend(attempts[last].mirrored.clone());
        (attempts[last].finest.clone(), mirrored)
    }

    /// Fits a minimum in the fine stage, and beside it its mirrored solution, unless that was done before; says which of the attempts it is.
    fn attempt(&self, minimum: &BendFit, attempts: &mut Vec<Attempt>, fine: &FitSchedule) -> usize {
        if let Some(known) = attempts.iter().position(|attempt| attempt.minimum.is_same_fit(minimum)) {
            return known;
        }
        let bend = self.mirrored(minimum.bend());
        let is_close = (bend - minimum.bend()).norm() < EDGE_ON_RAD;
        let schedule = if is_close { FitSchedule::REFINEMENT } else { FitSchedule::FROM_NEAR };
        let mirrored = || self.fit(self.start(bend), &schedule.beside(minimum.cost));
        // The longer of both is begun at once; the other waits for a free core.
        let (finest, mirrored) = rayon::join(|| self.fit_fine(minimum.start(), fine), mirrored);
        attempts.push(Attempt { minimum: minimum.clone(), mirrored, finest });
        attempts.len() - 1
    }

    /// The fits in the fine stage of the minima after the first that may explain the picture as well. Side by side, since a frame with several
    /// may take three times as long as others.
    fn alternatives(&self, fits: &[BendFit], attempts: &[Attempt], fine: &FitSchedule) -> Vec<BendFit> {
        let [first, others @ ..] = fits else { return Vec::new() };
        let fit_fine = |other: &BendFit| match attempts.iter().find(|attempt| attempt.minimum.is_same_fit(other)) {
            Some(known) => known.finest.clone(),
            None => self.fit_fine(other.start(), fine),
        };
        let may_be = others.par_iter().filter(|other| other.cost <= ALTERNATIVE_COST_RATIO * first.cost);
        may_be.flat_map_iter(fit_fine).collect()
    }
}
