//! The picture's blur in the fit: the edge filter that suits it, and the edges that a picture of the model has under it.

use super::correspondences::is_clear;
use super::edges::EdgeFinder;
use super::noise_model::{SHARP_PX, SMALL_DIAMETER_PX};
use crate::measure::body::{Outline, PredictedEdge, Projection};

/// The furthest that blur may displace an edge of the model in a sharp picture, px; in others so many times further as they are
/// more blurred.
///
/// Fitted: by hand on renders; judged by `tests/eye/robustness`.
const PREDICTION_SEARCH_PX: f64 = 1.0;
/// The least blur ratio of a predicted edge.
///
/// Convention: a guard. On a part much narrower than the blur the model itself shows hardly an edge.
const LEAST_BLUR_RATIO: f64 = 0.3;

/// The finder for the fine stage, in which the model is close to the picture: as fine as the blur, against shading. A small snake
/// has so few edges that noise does more harm than shading; there it is never finer than for the coarse stages.
pub(crate) fn fine_filter<'a>(finder: &EdgeFinder<'a>, view: &Projection, blur_px: f64) -> EdgeFinder<'a> {
    if view.diameter_px() < SMALL_DIAMETER_PX { finder.coarse_for_blur(blur_px) } else { finder.fine_for_blur(blur_px) }
}

/// Predicts the edges of an outline in a picture of this blur (σ, px): the model's silhouette is blurred as much and searched with
/// the same filter. Corners and curved borders, which blur rounds off, are then rounded in the picture and in the model, and a part
/// that is hardly wider than the blur looks sharper in both.
pub(crate) fn predict_blur(outline: &mut Outline, blur_px: f64, finder: &EdgeFinder) {
    let silhouette = outline.blurred_silhouette(blur_px);
    let finder = finder.for_model(&silhouette);
    let search_px = PREDICTION_SEARCH_PX * (blur_px / SHARP_PX).max(1.0);
    for point in outline.points.iter_mut().filter(|point| is_clear(point)) {
        point.predicted = finder.find(point, search_px).map(|edge| PredictedEdge {
            offset_px: edge.offset_px,
            blur_ratio: (edge.blur_px / blur_px).max(LEAST_BLUR_RATIO),
        });
    }
}
