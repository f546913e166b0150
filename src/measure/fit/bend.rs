//! Fits the snake's bend to the edges of one picture.

use super::correspondences::{BiasPrior, Correspondences, EdgeBias, SHARP_PX, State, fine_filter, predict_blur};
use super::edges::EdgeFinder;
use super::shape::{Departure, departure};
use super::solve::covariance;
use super::uncertainty::{clustered_covariance, inliers, systematic_covariance, whole_covariance};
use super::visibility::PartVisibility;
use crate::measure::body::{Outline, Piece, Projection};
use nalgebra::{Matrix2, Matrix2x6, Vector2};

/// Edges are searched for within this distance, px, once the model has settled.
pub(crate) const FINE_SEARCH_PX: f64 = 4.0;

/// Another bend explains a picture as well if its cost is within this factor of the best one's.
pub(crate) const ALTERNATIVE_COST_RATIO: f64 = 1.5;

/// The snake's bend in one picture.
#[derive(Debug, Clone)]
pub(crate) struct BendFit {
    pub bend: Vector2<f64>,
    pub bias: EdgeBias,
    /// Covariance of the bend vector from this picture alone, rad².
    pub covariance: Matrix2<f64>,
    /// Change of the bend vector with the camera's pose (see [`nudged`](crate::measure::target::grid::nudged)).
    pub by_pose: Matrix2x6<f64>,
    /// Edges that agree with the model.
    pub inliers: usize,
    pub rms_px: f64,
    pub blur_px: f64,
    /// Share of the outline that lies outside the picture.
    pub out_of_frame: f64,
    /// Mean over all places of the squared distance, cut off at the last search distance, in units of that: 0 if every
    /// place has its edge where the model says, 1 if none has.
    pub cost: f64,
    /// The edges that were matched last.
    matches: Correspondences,
}

impl BendFit {
    /// How the snake departs from a circle; `None` where the edges do not tell.
    pub fn departure(&self, view: &Projection, bias: &BiasPrior) -> Option<Departure> {
        departure(view, &self.matches, &self.start().state, &bias.at_blur(self.blur_px), self.rms_px)
    }

    /// The share of the places that were looked at whose edges agree with the model.
    pub fn inlier_fraction(&self) -> f64 {
        self.inliers as f64 / self.matches.places().max(1) as f64
    }

    /// What of the snake is there to be seen.
    pub fn visibility(&self) -> PartVisibility {
        PartVisibility::of(self.matches.asked())
    }

    /// Whether all of the outline is where the fit says, so that no other bend needs to be looked at.
    pub fn explains_all(&self) -> bool {
        const HARDLY_OFF: f64 = 0.01;
        const NEARLY_ALL: f64 = 0.95;
        if self.cost >= HARDLY_OFF || self.inlier_fraction() < NEARLY_ALL {
            return false;
        }
        let visibility = self.visibility();
        visibility.visible_disk_share() == 1.0 && visibility.is_end_visible()
    }

    /// The better of two that end close together, with the doubt which of them is right.
    pub fn or(self, other: Self) -> Self {
        let apart = self.bend - other.bend;
        let (mut better, worse) = if other.cost < self.cost { (other, self) } else { (self, other) };
        if worse.cost < ALTERNATIVE_COST_RATIO * better.cost {
            // The variance of two equally likely answers.
            better.covariance += apart * apart.transpose() / 4.0;
        }
        better
    }

    /// Where to go on from here.
    pub fn start(&self) -> Start {
        Start { state: State { bend: self.bend, bias: self.bias }, blur_px: Some(self.blur_px) }
    }
}

/// Moves a state to where matched edges agree with it best, and the square roots of the weights that they have there.
fn moved_to_edges(
    matches: &Correspondences,
    view: &Projection,
    start: State,
    bias: BiasPrior,
    settling: bool,
) -> Option<(State, Vec<f64>)> {
    const LINEARISATIONS: usize = 4;
    const FURTHEST_RAD: f64 = 0.2;
    /// Steps of the bend this short, rad, leave nothing of what is not linear; the bias is.
    const SHORT: f64 = 5e-3;
    let (mut state, mut roots) = (start, Vec::new());
    for _ in 0..LINEARISATIONS {
        let step;
        (step, roots) = matches.linearised(view, &state).step(&bias, &state, settling)?;
        let step = step * (FURTHEST_RAD / step.xy().norm()).min(1.0);
        if step.iter().any(|v| !v.is_finite()) {
            return None;
        }
        state = state.moved(&step);
        if step.xy().norm() < SHORT {
            break;
        }
    }
    Some((state, roots))
}

/// How thoroughly a picture is looked at.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FitSchedule {
    /// Search distances, px, one a round of matching; the last one is kept until nothing moves.
    pub searches_px: &'static [f64],
    /// Most rounds.
    pub rounds: usize,
    /// Whether the start is as good as the answer, so that what disagrees with it is not the snake's outline. Then every
    /// place of it is asked; until then a few are enough to tell which bend it is.
    pub is_fine: bool,
    /// Nothing moves if the bend moves by less, rad.
    pub converged_rad: f64,
}

/// Where a fit starts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Start {
    pub state: State,
    /// How soft the picture's edges are, if that is known.
    pub blur_px: Option<f64>,
}

/// Fits bend and edge bias by matching edges within ever smaller distances.
///
/// `None` where too little of the outline has edges, or the bend leaves what a snake can do.
pub(crate) fn fit_bend(
    view: &Projection,
    finder: &EdgeFinder,
    start: Start,
    bias: BiasPrior,
    schedule: &FitSchedule,
) -> Option<BendFit> {
    const FURTHEST_RAD: f64 = 2.2;
    const LEAST_OUTLINE_PX: f64 = 60.0;
    /// While the bend moves by more, what disagrees with it may be right.
    const SETTLING_RAD: f64 = 2e-3;
    /// A bend that differs by less leaves the border on the same points of the body, near enough for a look. A measurement
    /// draws it anew: which rims of disks seen edge-on are on the border hangs on every hundredth of a degree.
    const CARRIED_RAD: f64 = 0.03;
    let Start { mut state, blur_px } = start;
    let mut settling = !schedule.is_fine;
    let mut blur_px = blur_px.filter(|_| schedule.is_fine);
    let bias = blur_px.map_or(bias, |blur_px| bias.at_blur(blur_px));
    let mut filtered = blur_px.map_or_else(|| finder.clone(), |blur_px| fine_filter(finder, view, blur_px));
    let spacing_px = if schedule.is_fine { Outline::SPACING_PX } else { view.coarse_spacing_px() };
    let mut drawn: Option<(Vector2<f64>, Outline)> = None;
    let mut last: Option<(Correspondences, Vec<f64>, f64)> = None;
    let searches = schedule.searches_px.iter().chain(std::iter::repeat(schedule.searches_px.last()?));
    for (round, &search_px) in searches.take(schedule.rounds).enumerate() {
        // A picture that was thought sharper than it is was looked at with too narrow a filter.
        if let Some((matches, ..)) = &last {
            let seen_px = matches.blur_px;
            match &mut blur_px {
                None => filtered = finder.coarse_for_blur(seen_px),
                Some(blur_px) if seen_px > SHARP_PX => {
                    *blur_px = seen_px;
                    filtered = fine_filter(finder, view, seen_px);
                }
                Some(_) => {}
            }
        }
        let before = drawn.take();
        let (_, outline) = drawn.insert(match before {
            Some((at, mut outline)) if !schedule.is_fine && (state.bend - at).norm() < CARRIED_RAD => {
                outline.carry(view, state.psi());
                (at, outline)
            }
            _ => {
                let mut outline = Outline::spaced(view, state.psi(), spacing_px);
                if let Some(blur_px) = blur_px {
                    predict_blur(&mut outline, blur_px, &filtered);
                }
                (state.bend, outline)
            }
        });
        // The holder and the base disk do not bend.
        let matches = Correspondences::find(outline, &filtered, search_px, |p| {
            !matches!(p, Piece::HolderSide(_) | Piece::BaseRim)
        });
        if matches.len() as f64 * spacing_px < LEAST_OUTLINE_PX {
            return None;
        }
        let before = state.bend;
        let roots;
        (state, roots) = moved_to_edges(&matches, view, state, bias, settling || search_px > FINE_SEARCH_PX)?;
        if state.bend.norm() > FURTHEST_RAD {
            return None;
        }
        let moved_rad = (state.bend - before).norm();
        settling &= moved_rad > SETTLING_RAD;
        last = Some((matches, roots, search_px));
        if round + 1 >= schedule.searches_px.len() && moved_rad < schedule.converged_rad {
            break;
        }
    }

    let (matches, roots, search_px) = last?;
    let (_, outline) = drawn?;
    let linear = matches.linearised(view, &state);
    let misfits_px = matches.in_px(linear.residuals.as_slice());
    let linear = linear.weighted(&roots).with_prior(&bias, &state);
    let independent = covariance(&linear.by_state)?;
    let clustered = clustered_covariance(&linear.by_state, &linear.residuals, &matches.pieces())?;
    let (inliers, rms_px) = inliers(&misfits_px, &roots);
    let light = systematic_covariance(&matches, &linear.by_state, &independent, view, &roots, rms_px);
    let gain = &independent * linear.by_state.tr_mul(&linear.by_pose);
    let near: f64 = misfits_px.iter().map(|d| 1.0 - (d / search_px).powi(2).min(1.0)).sum();
    let covariance = whole_covariance([&clustered, &independent, &light], &[0, 1])?;
    Some(BendFit {
        bend: state.bend,
        bias: state.bias,
        covariance: covariance.fixed_view::<2, 2>(0, 0).into_owned(),
        by_pose: Matrix2x6::from_fn(|row, column| -gain[(row, column)]),
        inliers,
        rms_px,
        blur_px: matches.blur_px,
        out_of_frame: outline.out_of_frame,
        cost: 1.0 - near / matches.places() as f64,
        matches,
    })
}
