//! The picture's blur in the fit: the edge filters that suit it, and the edges that a picture of the model has under them.
//!
//! A lens is focused on one distance. What is nearer to the camera, such as the tip of a snake that bends towards it, may be blurred two or three
//! times as much as the rest. Under a filter for sharp edges the noise on the slope of a wide edge has peaks of its own, each as sharp as an edge, and
//! the highest one is found a pixel or two away from the border. So each disk has the filter that suits its own blur.
//!
//! Source: J. H. Elder, S. W. Zucker, "Local scale control for edge detection and blur estimation", IEEE PAMI 20, 1998, for a filter's width that
//! follows the blur from place to place.

use super::edges::{EdgeFinder, SHARPEST_PX};
use super::noise_model::SHARP_PX;
use crate::measure::body::{Outline, OutlinePoint, Piece, PredictedEdge};
use crate::statistics::order::median;
use std::collections::BTreeMap;

/// The furthest that blur may displace an edge of the model in a sharp picture, px; in others so many times further as they are
/// more blurred.
///
/// Fitted: by hand on renders; judged by `tests/eye/robustness`.
const PREDICTION_SEARCH_PX: f64 = 1.0;
/// The least blur ratio of a predicted edge.
///
/// Convention: a guard. On a part much narrower than the blur the model itself shows hardly an edge.
const LEAST_BLUR_RATIO: f64 = 0.3;
/// From one of the widths that filters have to the next.
///
/// Convention: a width that is a quarter off makes no difference that counts, and each takes a picture of the model of its own.
const STEP: f64 = 1.5;
/// A disk with fewer edges has no blur of its own.
///
/// Convention: the median of fewer is of no use.
const FEWEST_EDGES: usize = 10;

/// The blur of a picture along the snake.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Blur {
    /// The median of all edges, σ in px.
    pub px: f64,
    /// How many times the blur of each disk is [`STEP`] times wider than that, by the disk's number; 0 is the base.
    steps: Vec<u8>,
}

impl Blur {
    /// Of edges of these pieces with these blurs, σ in px.
    pub fn of(edges: &[(Piece, f32)]) -> Self {
        let median_of = |blurs_px: &mut Vec<f32>| f64::from(median(blurs_px));
        let px = median_of(&mut edges.iter().map(|(_, px)| *px).collect());
        let mut of_disks: BTreeMap<u8, Vec<f32>> = BTreeMap::new();
        for (piece, blur_px) in edges {
            if let Some(disk) = piece.disk() {
                of_disks.entry(disk).or_default().push(*blur_px);
            }
        }
        let last = of_disks.keys().next_back().copied().unwrap_or(0);
        let mut steps = vec![0; usize::from(last) + 1];
        for disk in 0..=last {
            let before = disk.checked_sub(1).map_or(0, |before| steps[usize::from(before)]);
            let own_px = of_disks.get_mut(&disk).filter(|edges| edges.len() >= FEWEST_EDGES).map(median_of);
            steps[usize::from(disk)] = own_px.map_or(before, |own_px| steps_to(px, own_px));
        }
        Self { px, steps }
    }

    /// Of edges that are all alike.
    pub fn uniform(px: f64) -> Self {
        Self { px, steps: Vec::new() }
    }

    /// σ in px where a piece is.
    pub fn at(&self, piece: Piece) -> f64 {
        self.after(self.step(piece))
    }

    /// What this blur is taken for once edges of another one were seen: a picture that was taken for sharper than it is was searched with too
    /// narrow a filter.
    pub fn following(&self, seen: &Self) -> Self {
        let of = |blur: &Self, disk: usize| blur.steps.get(disk).copied().unwrap_or(0);
        let disks = self.steps.len().max(seen.steps.len());
        let steps = (0..disks).map(|disk| of(self, disk).max(of(seen, disk))).collect();
        Self { px: if seen.px > SHARP_PX { seen.px } else { self.px }, steps }
    }

    /// σ in px after so many steps.
    fn after(&self, step: usize) -> f64 {
        self.px * STEP.powi(step as i32)
    }

    /// How many steps a piece's blur is wider than the median; that of a tube is the mean of its disks'.
    fn step(&self, piece: Piece) -> usize {
        let of_disk = |disk: u8| usize::from(self.steps.get(usize::from(disk)).copied().unwrap_or(0));
        match piece {
            Piece::Tube(_, _, disk) => (of_disk(disk) + of_disk(disk.saturating_add(1))) / 2,
            piece => piece.disk().map_or(0, of_disk),
        }
    }
}

/// How many steps wider than the median a disk's blur is; none of a sharp disk.
fn steps_to(median_px: f64, own_px: f64) -> u8 {
    let ratio = if own_px > SHARP_PX { own_px / median_px.max(SHARPEST_PX) } else { 1.0 };
    ratio.log(STEP).round().max(0.0) as u8
}

/// The filters with which the edges of a picture are looked for.
#[derive(Debug, Clone)]
pub(crate) struct Filters<'a> {
    blur: Blur,
    /// For the blur after each number of steps.
    by_step: Vec<EdgeFinder<'a>>,
}

impl<'a> Filters<'a> {
    /// The same filter everywhere.
    pub fn uniform(finder: EdgeFinder<'a>) -> Self {
        Self { blur: Blur::uniform(0.0), by_step: vec![finder] }
    }

    /// For the coarse stages: as wide as the blur of each part.
    pub fn coarse(finder: &EdgeFinder<'a>, blur: Blur) -> Self {
        Self::suiting(blur, |blur_px| finder.coarse_for_blur(blur_px))
    }

    /// For the fine stage, in which the model is close to the picture: as fine as the blur of each part, against shading.
    pub fn fine(finder: &EdgeFinder<'a>, blur: Blur) -> Self {
        Self::suiting(blur, |blur_px| finder.fine_for_blur(blur_px))
    }

    fn suiting(blur: Blur, filter: impl Fn(f64) -> EdgeFinder<'a>) -> Self {
        let widest = blur.steps.iter().copied().max().unwrap_or(0);
        let by_step = (0..=usize::from(widest)).map(|step| filter(blur.after(step))).collect();
        Self { blur, by_step }
    }

    /// The filter for a piece.
    pub fn at(&self, piece: Piece) -> &EdgeFinder<'a> {
        &self.by_step[self.blur.step(piece)]
    }

    /// Predicts the edges of an outline in the picture: the model's silhouette is blurred as much and searched with the same filters. Corners and
    /// curved borders, which blur rounds off, are then rounded in the picture and in the model, and a part that is hardly wider than the blur looks
    /// sharper in both.
    pub fn predict(&self, outline: &mut Outline) {
        for (step, finder) in self.by_step.iter().enumerate() {
            let is_of_step = |point: &OutlinePoint| finder.is_clear(point) && self.blur.step(point.piece) == step;
            if !outline.points.iter().any(is_of_step) {
                continue;
            }
            let blur_px = self.blur.after(step);
            let silhouette = outline.blurred_silhouette(blur_px);
            let finder = finder.for_model(&silhouette);
            let search_px = PREDICTION_SEARCH_PX * (blur_px / SHARP_PX).max(1.0);
            for point in outline.points.iter_mut().filter(|point| is_of_step(point)) {
                point.predicted = finder.find(point, search_px).map(|edge| PredictedEdge {
                    offset_px: edge.offset_px,
                    blur_ratio: (edge.blur_px / blur_px).max(LEAST_BLUR_RATIO),
                });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// So many edges of a disk with this blur.
    fn edges(disk: u8, count: usize, blur_px: f32) -> Vec<(Piece, f32)> {
        vec![(Piece::Rim(disk, true), blur_px); count]
    }

    #[test]
    fn a_tip_out_of_focus_has_a_blur_of_its_own() {
        let mut all: Vec<_> = (1..=5).flat_map(|disk| edges(disk, 40, 0.8)).collect();
        all.extend([edges(6, 40, 1.7), edges(7, 5, 9.0)].concat());
        let blur = Blur::of(&all);
        assert!((blur.px - 0.8).abs() < 1e-6);
        let at = |piece| blur.at(piece) / blur.px;
        assert_eq!(at(Piece::Rim(5, false)), 1.0);
        // ln 2.1 / ln 1.5 is 1.9; the last disk has too few edges for a blur of its own.
        assert_eq!([at(Piece::DiskSide(6, 1)), at(Piece::Rim(7, true))], [STEP * STEP; 2]);
        assert_eq!(at(Piece::Tube(1, -1, 5)), STEP);
        assert_eq!(at(Piece::HolderSide(1)), 1.0);
        // What has no edges at all has the blur of the whole.
        assert_eq!(at(Piece::Rim(9, true)), 1.0);
    }

    #[test]
    fn parts_of_a_sharp_picture_have_one_filter() {
        let blur = Blur::of(&[edges(1, 60, 0.7), edges(2, 20, 1.4)].concat());
        assert_eq!(blur.at(Piece::Rim(2, true)), blur.px);
    }
}
