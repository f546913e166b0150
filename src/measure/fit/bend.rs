//! Fits the snake's bend to the edges of one picture.
//!
//! Each round draws the model's outline, searches the picture's edges near it, and moves bend and edge bias to where the edges agree
//! with the model best (Gauss–Newton with iteratively reweighted least squares). The search distances shrink from round to round.

use super::blur::{Blur, Filters};
use super::correspondences::Correspondences;
use super::edges::EdgeFinder;
use super::evidence::Evidence;
use super::linearised::{Linearised, robust_step};
use super::schedule::FitSchedule;
use super::state::{EdgeBias, FramePrior, STATE, State};
use super::uncertainty::{FitCovariance, RobustPhase, inliers};
use super::visibility::PartVisibility;
use crate::measure::body::{Outline, Piece, Projection};
use crate::robot::{BendProfile, MAX_THETA, PROFILE};
use nalgebra::{SMatrix, SVector, Vector2};
use std::collections::BTreeSet;

/// From this search distance on, px, the model is close enough to the picture for the redescending loss.
///
/// Fitted: by hand on renders; judged by `tests/eye/robustness`.
pub(crate) const FINE_SEARCH_PX: f64 = 4.0;
/// The largest bend that a fit may pass through, rad. It must end within what the model answers for, [`MAX_THETA`].
///
/// Convention: 126°, a little more than 120°; a fit that goes further has lost the snake.
const LARGEST_BEND_RAD: f64 = 2.2;
/// The least length of outline that must have edges, px.
///
/// Convention: a guard for the solver. Whether a fit may be believed is decided by its share of inliers.
const LEAST_MATCHED_PX: f64 = 60.0;
/// A round that moves the bend by no more than this, rad, starts the redescending phase, and the rounds after it search within the last distance.
///
/// Fitted: by hand on renders; judged by `tests/eye/robustness`.
const REDESCENDING_RAD: f64 = 2e-3;
/// A bend that differs by less than this, rad, leaves the border on the same points of the body, near enough for the coarse stages.
/// The fine stage draws the outline anew in each round: which rims of disks seen edge-on are on the border depends on every hundredth
/// of a degree.
///
/// Fitted: by hand on renders, for speed; judged by `tests/eye/robustness`.
const REPROJECTED_RAD: f64 = 0.03;
/// The most linearisations for the edges of one round.
///
/// Convention: an iteration cap; the next round goes on from there.
const LINEARISATIONS: usize = 4;
/// Beside another fit one with more than so many times its cost, after a step within a wider distance than the last, is hopeless: it would go on
/// for up to twenty rounds in vain.
///
/// Fitted: to 432 mirrored fits of the photo-realistic frames and rigs; of the 55 that ended at another bend and within twice the best cost, from
/// which on none counts, none had more than 6.4 times before the last distance, and of the hopeless ones 85 % have more than this. Judged by
/// `tests/eye/robustness`.
const HOPELESS_COST_RATIO: f64 = 10.0;
/// The longest step of the bend, rad.
///
/// Convention: a trust region, a tenth of the range of bends.
const LONGEST_STEP_RAD: f64 = 0.2;
/// A step of the bend shorter than this, rad, is the last of a round: what the linearisation leaves out goes with the step's square,
/// 2.5e-5 rad here.
///
/// Derived: its square is a fortieth of what a fit must move by to go on.
const LINEAR_RAD: f64 = 5e-3;

/// The snake's bend in one picture.
#[derive(Debug, Clone)]
pub(crate) struct BendFit {
    /// Where the first of the fits started that led here.
    pub origin: Vector2<f64>,
    /// The bend along the snake.
    pub profile: BendProfile,
    pub bias: EdgeBias,
    /// Covariance of the profile's numbers from this picture alone, rad²; zero of a fit of the coarse stages, which nothing is drawn from
    /// but where to go on.
    pub covariance: ProfileCovariance,
    /// By how much the covariance is wider, since this picture's edges scatter more than they may (see [`excess`](super::excess)), rad². The choice
    /// between fits and what is learned of the snake's shape do not know of it: a few such frames would make a snake an arc for certain in all others.
    pub scatter: ProfileCovariance,
    /// By how much this picture's edges scatter more than they may, see [`excess`](super::excess); zero of a coarse fit.
    pub excess: f64,
    /// What of the covariance is doubt between this fit and others of the same snake seen edge-on, rad².
    pub doubt: ProfileCovariance,
    /// Change of the profile's numbers with the camera's pose (see [`perturbed`](crate::geometry::perturbed)); zero of a coarse fit as well.
    pub by_pose: SMatrix<f64, PROFILE, 6>,
    /// The number of edges that agree with the model.
    pub inliers: usize,
    /// Root mean square of their distances from it, px.
    pub rms_px: f64,
    /// The blur of the edges.
    pub blur: Blur,
    /// By how much this picture's edges contradict what was known of the snake's shape, see [`FramePrior::contradiction`], in units of the χ² from which on
    /// they do, if they scatter as they may; zero of a coarse fit.
    pub contradiction: f64,
    /// Whether the snake may have any shape in this fit.
    pub of_any_shape: bool,
    /// Share of the outline that lies outside the picture.
    pub out_of_frame: f64,
    /// The mean over all searched points of the squared distance, cut off at the last search distance, in units of that: 0 if every
    /// point has its edge where the model says, 1 if none has.
    pub cost: f64,
    /// What the edges say for the snake; nothing in a coarse fit, which is not asked.
    pub evidence: Evidence,
    /// The edges of the last round.
    edges: Correspondences,
}

impl BendFit {
    /// The tip's bend vector, rad.
    pub fn bend(&self) -> Vector2<f64> {
        self.profile.tip
    }

    /// Whether the snake is not taken to have about the shape that was known of it: it may have any, or the picture's edges contradict what was known,
    /// though their variance exceeds what their σ say by the factor `dispersion`: they say so many times less.
    pub fn is_of_unlikely_shape(&self, dispersion: f64) -> bool {
        self.of_any_shape || self.contradiction > dispersion
    }

    /// The number of outline points at which an edge was searched.
    pub fn searched_points(&self) -> usize {
        self.edges.searched().len()
    }

    /// The share of the searched points whose edges agree with the model.
    pub fn inlier_fraction(&self) -> f64 {
        self.inliers as f64 / self.searched_points().max(1) as f64
    }

    /// How much of each part's outline has its edge.
    pub fn visibility(&self) -> PartVisibility {
        PartVisibility::of(self.edges.searched())
    }

    /// Whether another fit of the same picture ended in the same state after starting at the same bend: it is this one.
    pub fn is_same_fit(&self, other: &Self) -> bool {
        self.origin == other.origin && self.profile == other.profile && self.bias == other.bias
    }

    /// Where another fit may go on from here.
    pub fn start(&self) -> Start {
        let state = State { profile: self.profile, bias: self.bias };
        Start { state, blur: Some(self.blur.clone()), origin: self.origin }
    }
}

/// The covariance of the numbers of a bend profile, rad².
pub(crate) type ProfileCovariance = SMatrix<f64, PROFILE, PROFILE>;

/// Where a fit starts.
#[derive(Debug, Clone)]
pub(crate) struct Start {
    pub state: State,
    /// The blur of the picture's edges, if it is known.
    pub blur: Option<Blur>,
    /// The tip's bend vector where the first of the fits started that led here, rad.
    pub origin: Vector2<f64>,
}

/// Fits bend and edge bias by matching edges within ever smaller distances.
///
/// `None` where too little of the outline has edges, or the bend leaves the range of what a snake can do.
pub(crate) fn fit_bend(
    view: &Projection,
    finder: &EdgeFinder,
    start: Start,
    prior: FramePrior,
    schedule: &FitSchedule,
) -> Option<BendFit> {
    let mut fitting = Fitting::new(view, finder, start, prior, schedule);
    let mut searches_px = schedule.searches_px;
    for _ in 0..schedule.rounds {
        fitting.follow_blur();
        fitting.draw_outline();
        let moved_rad = fitting.match_and_move(*searches_px.first()?)?;
        searches_px = match searches_px {
            [_] if moved_rad < schedule.converged_rad => break,
            [.., last] if moved_rad <= REDESCENDING_RAD => std::slice::from_ref(last),
            [_, narrower @ ..] if !narrower.is_empty() => narrower,
            last => last,
        };
    }
    fitting.finish()
}

/// A fit under way.
struct Fitting<'a> {
    view: &'a Projection<'a>,
    /// The picture's edge finder as it came.
    finder: &'a EdgeFinder<'a>,
    schedule: &'a FitSchedule,
    prior: FramePrior,
    origin: Vector2<f64>,
    state: State,
    phase: RobustPhase,
    /// The blur that the model is given, in the fine stage.
    blur: Option<Blur>,
    /// The filters in use.
    filters: Filters<'a>,
    spacing_px: f64,
    /// The outline, and the bend at which it was drawn.
    drawn: Option<(BendProfile, Outline)>,
    last: Option<Round>,
}

/// What a fit of the fine stage leaves uncertain; see the fields of [`BendFit`].
#[derive(Default)]
struct Uncertainty {
    evidence: Evidence,
    covariance: ProfileCovariance,
    scatter: ProfileCovariance,
    /// See [`excess`](super::excess).
    excess: f64,
    by_pose: SMatrix<f64, PROFILE, 6>,
    /// See [`BendFit::contradiction`].
    contradiction: f64,
}

/// What a round of matching leaves.
struct Round {
    edges: Correspondences,
    /// Square roots of the edges' weights.
    roots: Vec<f64>,
    search_px: f64,
}

impl<'a> Fitting<'a> {
    fn new(
        view: &'a Projection<'a>,
        finder: &'a EdgeFinder<'a>,
        start: Start,
        prior: FramePrior,
        schedule: &'a FitSchedule,
    ) -> Self {
        let blur = start.blur.filter(|_| schedule.is_fine);
        Self {
            view,
            finder,
            schedule,
            prior: blur.as_ref().map_or(prior, |blur| prior.at_blur(blur.px)),
            origin: start.origin,
            state: start.state,
            phase: if schedule.is_fine { RobustPhase::Redescending } else { RobustPhase::Monotone },
            filters: blur
                .as_ref()
                .map_or_else(|| Filters::uniform(finder.clone()), |blur| Filters::fine(finder, blur.clone())),
            blur,
            spacing_px: if schedule.is_fine { Outline::SPACING_PX } else { view.coarse_spacing_px() },
            drawn: None,
            last: None,
        }
    }

    /// Adapts the edge filters to the blur of the last round's edges.
    fn follow_blur(&mut self) {
        let Some(Round { edges, .. }) = &self.last else { return };
        let Some(blur) = &mut self.blur else {
            self.filters = Filters::coarse(self.finder, edges.blur.clone());
            return;
        };
        let followed = blur.following(&edges.blur);
        if followed != *blur {
            self.filters = Filters::fine(self.finder, followed.clone());
            *blur = followed;
        }
    }

    /// Draws the outline at the present bend, or reprojects the last one in the coarse stages.
    fn draw_outline(&mut self) {
        let (view, state) = (self.view, self.state);
        self.drawn = Some(match self.drawn.take() {
            Some((at, mut outline)) if !self.schedule.is_fine && apart(&state.profile, &at) < REPROJECTED_RAD => {
                outline.reproject(view, state.profile);
                (at, outline)
            }
            _ => {
                let mut outline = Outline::spaced(view, state.profile, self.spacing_px);
                if self.blur.is_some() {
                    self.filters.predict(&mut outline);
                }
                (state.profile, outline)
            }
        });
    }

    /// Searches the outline's edges and moves the state to them; returns by how much the bend moved, rad.
    fn match_and_move(&mut self, search_px: f64) -> Option<f64> {
        let (_, outline) = self.drawn.as_ref()?;
        let edges = Correspondences::find(outline, &self.filters, search_px, Piece::bends);
        if edges.len() as f64 * self.spacing_px < LEAST_MATCHED_PX {
            return None;
        }
        let phase = if search_px > FINE_SEARCH_PX { RobustPhase::Monotone } else { self.phase };
        let before = self.state.profile;
        let tolerance = self.schedule.reweighting_tolerance();
        let (state, roots) = gauss_newton(&edges, self.view, self.state, &self.prior, phase, tolerance)?;
        if state.profile.tip.norm() > LARGEST_BEND_RAD {
            return None;
        }
        let moved_rad = apart(&state.profile, &before);
        if moved_rad <= REDESCENDING_RAD {
            self.phase = RobustPhase::Redescending;
        }
        self.state = state;
        if self.schedule.searches_px.last() != Some(&search_px) && self.is_hopeless(&edges) {
            return None;
        }
        self.last = Some(Round { edges, roots, search_px });
        Some(moved_rad)
    }

    /// Whether the fit has many times the cost of the fit beside it, both within the last search distance.
    fn is_hopeless(&self, edges: &Correspondences) -> bool {
        let FitSchedule { searches_px, rival_cost, .. } = *self.schedule;
        let own_cost = |last_px: &f64| {
            let distances_px = edges.in_px(&edges.residuals(self.view, self.state.profile, self.state.bias));
            cost(edges, &distances_px, *last_px)
        };
        rival_cost.is_finite()
            && searches_px.last().is_some_and(|last_px| own_cost(last_px) > HOPELESS_COST_RATIO * rival_cost)
    }

    /// The fit from the last round; with its covariance in the fine stage.
    fn finish(self) -> Option<BendFit> {
        let Round { edges, roots, search_px } = self.last.as_ref()?;
        let distances_px = edges.in_px(&edges.residuals(self.view, self.state.profile, self.state.bias));
        let (inliers, rms_px) = inliers(&distances_px, roots);
        // A fit to fewer clusters has no covariance, and is none.
        if edges.clusters().collect::<BTreeSet<_>>().len() <= STATE || self.state.profile.tip.norm() > MAX_THETA {
            return None;
        }
        let uncertainty = match self.schedule.is_fine {
            true => self.uncertainty(&distances_px, (inliers, rms_px))?,
            false => Uncertainty::default(),
        };
        Some(BendFit {
            origin: self.origin,
            profile: self.state.profile,
            bias: self.state.bias,
            covariance: uncertainty.covariance,
            scatter: uncertainty.scatter,
            excess: uncertainty.excess,
            doubt: ProfileCovariance::zeros(),
            by_pose: uncertainty.by_pose,
            inliers,
            rms_px,
            blur: edges.blur.clone(),
            contradiction: uncertainty.contradiction,
            of_any_shape: false,
            out_of_frame: self.drawn?.1.out_of_frame,
            cost: cost(edges, &distances_px, *search_px),
            evidence: uncertainty.evidence,
            edges: self.last?.edges,
        })
    }

    /// What the edges of the last round leave uncertain, which lie these distances (px) from the model. So many of them are inliers, with this scatter.
    fn uncertainty(&self, distances_px: &[f64], (inliers, rms_px): (usize, f64)) -> Option<Uncertainty> {
        let Self { view, state, prior, .. } = self;
        let Round { edges, roots, search_px } = self.last.as_ref()?;
        let linear = Linearised::new(edges, view, state, roots, Some(prior));
        let covariance = FitCovariance::new(edges, &linear.by_state, &linear.residuals, view, roots, rms_px)?;
        let gain = &covariance.independent * linear.by_state.tr_mul(&linear.by_pose);
        let total = covariance.total(&std::array::from_fn::<_, PROFILE, _>(|k| k))?;
        let contradiction = prior.contradiction(&state.profile, &covariance.independent)?;
        let [own, scatter] = total.map(|part| part.fixed_view::<PROFILE, PROFILE>(0, 0).into_owned());
        let agreeing = inliers as f64 / edges.searched().len().max(1) as f64;
        Some(Uncertainty {
            evidence: Evidence::new(edges, distances_px, *search_px, agreeing, covariance.excess),
            covariance: own,
            scatter,
            excess: covariance.excess,
            by_pose: SMatrix::from_fn(|row, column| -gain[(row, column)]),
            contradiction: contradiction / prior.contradiction_chi2,
        })
    }
}

/// See [`BendFit::cost`].
fn cost(edges: &Correspondences, distances_px: &[f64], search_px: f64) -> f64 {
    let agreement: f64 = distances_px.iter().map(|d| 1.0 - (d / search_px).powi(2).min(1.0)).sum();
    1.0 - agreement / edges.searched().len() as f64
}

/// The largest difference between the numbers of two profiles, rad.
fn apart(a: &BendProfile, b: &BendProfile) -> f64 {
    let pairs = a.to_array().into_iter().zip(b.to_array());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Moves a state to where it agrees best with edges, by Gauss–Newton steps under a robust loss; returns with it the square roots of
/// the edges' weights.
fn gauss_newton(
    edges: &Correspondences,
    view: &Projection,
    start: State,
    prior: &FramePrior,
    phase: RobustPhase,
    tolerance: f64,
) -> Option<(State, Vec<f64>)> {
    let (mut state, mut roots) = (start, Vec::new());
    for _ in 0..LINEARISATIONS {
        let step;
        (step, roots) = robust_step(edges, view, &state, prior, phase, tolerance)?;
        let bends = |step: &SVector<f64, STATE>| step.fixed_rows::<PROFILE>(0).amax();
        let step = step * (LONGEST_STEP_RAD / bends(&step)).min(1.0);
        if step.iter().any(|v| !v.is_finite()) {
            return None;
        }
        state = state.moved(&step);
        // The residuals are linear in the bias, so that only the bend's step counts.
        if bends(&step) < LINEAR_RAD {
            break;
        }
    }
    Some((state, roots))
}

#[cfg(test)]
mod tests;
