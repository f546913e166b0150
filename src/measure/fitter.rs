//! The fits of one picture.

use super::body::Projection;
use super::fit::{BendFit, EdgeFinder, FitSchedule, Start, State, fit_bend, mirrored};
use super::rig::Rig;
use crate::robot::BendProfile;
use nalgebra::Vector2;

/// Fits the snake's bend to one picture, as a rig sees it.
pub(super) struct Fitter<'a> {
    pub view: Projection<'a>,
    pub rig: &'a Rig,
    /// Finds the picture's edges.
    pub finder: EdgeFinder<'a>,
}

impl Fitter<'_> {
    /// Where a fit starts that knows nothing but a bend.
    pub fn start(&self, bend: Vector2<f64>) -> Start {
        let state = State { profile: BendProfile::arc(bend), bias: self.rig.edge_bias };
        Start { state, blur: None, origin: bend }
    }

    /// The bend that looks alike with depth the other way round.
    pub fn mirrored(&self, bend: Vector2<f64>) -> Vector2<f64> {
        mirrored(bend, &self.view)
    }

    /// The fit of a snake whose shape is about as the rig says.
    pub fn fit(&self, start: Start, schedule: &FitSchedule) -> Option<BendFit> {
        fit_bend(&self.view, &self.finder, start, self.rig.prior(), schedule)
    }

    /// The fits in the fine stage: of a snake whose shape is about as the rig says and, if the picture contradicts that, of one of any shape. None if
    /// the edges determine none.
    pub fn fit_fine(&self, start: Start, schedule: &FitSchedule) -> Vec<BendFit> {
        let Some(fit) = self.fit(start, schedule) else { return Vec::new() };
        let any_shape = if fit.is_of_unlikely_shape(1.0) { self.fit_any_shape(fit.start(), schedule) } else { None };
        std::iter::once(fit).chain(any_shape).collect()
    }

    /// The fit in the fine stage of a snake that may have any shape.
    pub fn fit_any_shape(&self, start: Start, schedule: &FitSchedule) -> Option<BendFit> {
        let any_shape = self.rig.prior().of_any_shape();
        // Edges may lie further from the wrong shape than the fine stage searches.
        let refined = fit_bend(&self.view, &self.finder, start, any_shape, &FitSchedule::FROM_NEAR)?;
        let mut fit = fit_bend(&self.view, &self.finder, refined.start(), any_shape, schedule)?;
        fit.of_any_shape = true;
        Some(fit)
    }

    /// The fits in the fine stage of the snake of another fit whose faces may mirror a lamp: their borders are edges the other way round.
    pub fn fit_mirroring(&self, fit: &BendFit, schedule: &FitSchedule) -> Vec<BendFit> {
        let either_way = Fitter { finder: self.finder.either_way(), view: self.view.clone(), ..*self };
        let Some(refined) = either_way.fit(fit.start(), &FitSchedule::FROM_NEAR) else { return Vec::new() };
        let mut fits = either_way.fit_fine(refined.start(), schedule);
        fits.iter_mut().for_each(|fit| fit.evidence.assume_a_mirrored_lamp());
        fits
    }
}
