//! The selection among the local minima of a frame's fit: which of them the picture shows, and whether another explains it as well.

use super::fit::{BendFit, Decision, EDGE_ON_RAD, FitSchedule, SAME_MINIMUM_RAD, distinct, heaviest};
use super::fitter::Fitter;
use super::minima::RIVAL_COST_RATIO;
use crate::observation::Status;
use nalgebra::Vector2;
use rayon::prelude::*;

/// What a minimum leads to.
pub(super) struct Attempt {
    /// Where it starts.
    pub minimum: BendFit,
    /// The fit of its mirrored solution, where that is not hopeless beside it.
    pub mirrored: Option<BendFit>,
    /// Its fits in the fine stage.
    pub finest: Vec<BendFit>,
}

/// The outcome of the selection among local minima.
pub(super) struct Selection {
    /// The local minima, best first.
    pub fits: Vec<BendFit>,
    /// Whether there is a first and its fit in the fine stage succeeded.
    pub has_fine_fit: bool,
    /// What was tried.
    pub attempts: Vec<Attempt>,
    /// Why the first is not to be relied on, if another one may be what the picture shows, another bend or the same snake of another shape, or if its shape is
    /// unlikely and does not explain the picture.
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
        let minima = distinct(minima, SAME_MINIMUM_RAD);
        let Some(first) = minima.first().cloned() else { return Selection::without_fine_fit(minima, attempts) };
        let Attempt { mirrored, finest, .. } = self.attempt(&first, &mut attempts, fine);
        let (mirrored, finest) = (mirrored.clone(), finest.clone());
        let mut fits = distinct(minima.into_iter().chain(mirrored).collect(), SAME_MINIMUM_RAD);
        let others = self.alternatives(&fits, first.bend(), &attempts, fine);
        let mut modes: Vec<BendFit> = finest.into_iter().chain(others).collect();
        // From a shape that the sequence told a fit starts in the right minimum.
        if !self.rig.is_shape_known() {
            self.add_any_shape(&mut modes, fine);
            self.add_other_shapes(&mut modes, fine);
        }
        self.add_mirroring(&mut modes, fine);
        let decision = Decision::between(modes, self.view.diameter_px());
        let Some(Decision { fit, doubt, is_of_unlikely_shape }) = decision else {
            return Selection::without_fine_fit(fits, attempts);
        };
        // With any shape a fit has local minima of its own. From a shape that the sequence told it starts in the right one; else one
        // that leaves part of the outline unexplained is not to be relied on.
        let is_unexplained = is_of_unlikely_shape && !self.rig.is_shape_known() && !fit.explains_outline();
        let refusal = doubt.or(is_unexplained.then_some(Status::UnknownShape));
        fits[0] = fit;
        Selection { fits, has_fine_fit: true, attempts, refusal }
    }

    /// Adds what the heaviest mode becomes if the snake may have any shape: where part of the outline is hidden, what is left of it may not
    /// contradict a shape that the snake does not have.
    fn add_any_shape(&self, modes: &mut Vec<BendFit>, fine: &FitSchedule) {
        let best = heaviest(modes).filter(|best| !(best.is_of_unlikely_shape(1.0) || best.explains_all()));
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

    /// Fits a minimum in the fine stage, and beside it its mirrored solution, unless that was done before.
    fn attempt<'a>(&self, minimum: &BendFit, attempts: &'a mut Vec<Attempt>, fine: &FitSchedule) -> &'a Attempt {
        if let Some(known) = attempts.iter().position(|attempt| attempt.minimum.is_same_fit(minimum)) {
            return &attempts[known];
        }
        let bend = self.mirrored(minimum.bend());
        let is_close = (bend - minimum.bend()).norm() < EDGE_ON_RAD;
        let schedule = if is_close { FitSchedule::REFINEMENT } else { FitSchedule::FROM_NEAR };
        let mirrored = || self.fit(self.start(bend), &schedule.beside(minimum.cost));
        // The longer of both is begun at once; the other waits for a free core.
        let (finest, mirrored) = rayon::join(|| self.fit_fine(minimum.start(), fine), mirrored);
        attempts.push(Attempt { minimum: minimum.clone(), mirrored, finest });
        &attempts[attempts.len() - 1]
    }

    /// The fits in the fine stage of the minima beside the first, at `first`, that may explain the picture as well. Side by side, since a frame with
    /// several may take three times as long as others.
    fn alternatives(
        &self,
        fits: &[BendFit],
        first: Vector2<f64>,
        attempts: &[Attempt],
        fine: &FitSchedule,
    ) -> Vec<BendFit> {
        let most_cost = RIVAL_COST_RATIO * fits.first().map_or(0.0, |best| best.cost);
        let may_be = |fit: &&BendFit| fit.cost <= most_cost && (fit.bend() - first).norm() > SAME_MINIMUM_RAD;
        let fit_fine = |fit: &BendFit| match attempts.iter().find(|attempt| attempt.minimum.is_same_fit(fit)) {
            Some(known) => known.finest.clone(),
            None => self.fit_fine(fit.start(), fine),
        };
        fits.par_iter().filter(may_be).flat_map_iter(fit_fine).collect()
    }
}
