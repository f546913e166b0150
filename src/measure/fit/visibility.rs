//! Part visibility: which parts of the snake a picture shows where a model puts them.
//!
//! A fit knows only the edges that it found, and gives no weight to those that disagree: with a hand before the tip, or with a disk
//! taken for its neighbour, enough edges are left. What tells is where edges should be and are not, so the share of the outline that
//! has its edge is computed for each part on its own.

use super::edges::{Edge, EdgeFinder};
use crate::measure::body::{Outline, Piece};
use crate::statistics::order::median;
use std::collections::BTreeMap;

/// Search distance, px.
///
/// Convention: that of the fine stage ([`FINE_SEARCH_PX`](super::FINE_SEARCH_PX)).
const SEARCH_PX: f64 = 4.0;
/// An edge confirms the model if it lies this close to it, px, or within two of its σ.
///
/// Fitted: by hand on renders, where edges scatter by 0.14 px in the median rig; judged by `tests/eye/robustness`.
const CONFIRMING_PX: f64 = 1.0;
/// A disk with fewer searched points has no share of its own.
///
/// Convention: of three points a share says nothing.
const FEWEST_POINTS: usize = 4;
/// A part is visible if at least this share of its outline is.
///
/// Convention: the majority.
const VISIBLE_SHARE: f64 = 0.5;
/// The same for every part of a faint snake.
///
/// Fitted: on renders of 200 random rigs, where right models of faint snakes have parts of which as little as 0.43 is visible and
/// wrong models with half of their edges at most 0.28; judged on no other.
const FAINTLY_VISIBLE_SHARE: f64 = 0.4;
/// How many disks count as the snake's end.
///
/// Convention: one of the two may be hidden.
pub(super) const END_DISKS: usize = 2;

/// How much of the outline of each part has its edge where the model says.
#[derive(Debug, Clone)]
pub struct PartVisibility {
    /// Points with their edge, and all searched points, of the holder (number 0) and the disks (from 1 next to the base).
    parts: BTreeMap<u8, (usize, usize)>,
}

impl PartVisibility {
    /// Searches the edges of an outline in a picture.
    pub fn new(outline: &Outline, finder: &EdgeFinder) -> Self {
        let clear = outline.points.iter().filter(|p| finder.is_clear(p) && !finder.is_hidden(p));
        Self::of(&clear.map(|p| (p.piece, finder.find(p, SEARCH_PX))).collect::<Vec<_>>())
    }

    /// From searched points of the outline and the edge found near each. A displacement that all edges share, as in overexposed or
    /// blurred pictures, is not held against them.
    pub(super) fn of(points: &[(Piece, Option<Edge>)]) -> Self {
        let searched: Vec<_> = points.iter().filter_map(|(piece, edge)| Some((piece.disk()?, edge))).collect();
        let mut offsets: Vec<f32> =
            searched.iter().filter_map(|(_, edge)| Some(edge.as_ref()?.offset_px as f32)).collect();
        let bias_px = f64::from(median(&mut offsets));
        let mut parts: BTreeMap<u8, (usize, usize)> = BTreeMap::new();
        for (part, edge) in searched {
            let (confirmed, points) = parts.entry(part).or_default();
            *points += 1;
            let confirms = |edge: Edge| (edge.offset_px - bias_px).abs() < CONFIRMING_PX.max(2.0 * edge.sigma_px);
            *confirmed += usize::from(edge.is_some_and(confirms));
        }
        Self { parts }
    }

    /// The share of each disk's outline that is visible, 0 to 1, by the disk's number; disks that are too covered by others are left
    /// out.
    pub fn disk_shares(&self) -> impl Iterator<Item = (u8, f64)> {
        self.parts
            .iter()
            .filter(|&(&part, &(_, points))| part > 0 && points >= FEWEST_POINTS)
            .map(|(&part, _)| (part, self.share(part)))
    }

    /// The share of the disks that are visible.
    pub fn visible_disk_share(&self) -> f64 {
        let (visible, all) = self
            .disk_shares()
            .fold((0, 0), |(visible, all), (_, share)| (visible + u32::from(is_visible(share)), all + 1));
        f64::from(visible) / f64::from(all.max(1))
    }

    /// Whether the snake's end is visible: the last disk that could be searched or the one before it. A bend further towards the
    /// camera and one less far look alike from the disks near the base alone.
    pub fn is_end_visible(&self) -> bool {
        let mut shares: Vec<f64> = self.disk_shares().map(|(_, share)| share).collect();
        shares.drain(..shares.len().saturating_sub(END_DISKS));
        shares.into_iter().any(is_visible)
    }

    /// Whether the holder (0) or a disk is visible.
    pub fn is_visible(&self, part: u8) -> bool {
        is_visible(self.share(part))
    }

    /// Whether the holder and all disks up to the `last` are visible, if only faintly. Of a model that is one disk too far along the
    /// snake, next to nothing of some part is.
    pub fn are_all_faintly_visible(&self, last: u8) -> bool {
        (0..=last).all(|part| self.share(part) >= FAINTLY_VISIBLE_SHARE)
    }

    /// The share of a part's outline that is visible; 0 where none of it could be searched.
    fn share(&self, part: u8) -> f64 {
        self.parts.get(&part).map_or(0.0, |&(confirmed, points)| confirmed as f64 / points as f64)
    }
}

fn is_visible(share: f64) -> bool {
    share >= VISIBLE_SHARE
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_faint_snake_is_visible_if_every_part_of_it_is() {
        let of = |shares: &[(u8, usize)]| PartVisibility {
            parts: shares.iter().map(|&(part, seen)| (part, (seen, 100))).collect(),
        };
        assert!(of(&[(0, 43), (1, 52), (2, 64)]).are_all_faintly_visible(2));
        for not in [&[(0, 43), (1, 99), (2, 14)][..], &[(0, 43), (1, 52)], &[]] {
            assert!(!of(not).are_all_faintly_visible(2), "{not:?}");
        }
    }

    /// The visibility of a snake of seven disks, whose disks in `hidden` show no edge and whose others lie `offset_px` outside.
    fn without(hidden: std::ops::RangeInclusive<u8>, offset_px: f64) -> PartVisibility {
        let edge = |disk: u8| {
            let edge = Edge { offset_px, sigma_px: 0.1, blur_px: 1.0 };
            (!hidden.contains(&disk)).then_some(edge)
        };
        let points = (1..=7).flat_map(|disk| (0..20).map(move |_| disk));
        PartVisibility::of(&points.map(|disk| (Piece::Rim(disk, true), edge(disk))).collect::<Vec<_>>())
    }

    #[test]
    fn a_snake_whose_last_two_disks_are_hidden_has_no_visible_end() {
        assert!(!without(6..=7, 0.1).is_end_visible());
        assert!((without(6..=7, 0.1).visible_disk_share() - 5.0 / 7.0).abs() < 1e-12);
        for hidden in [7..=7, 6..=6, 3..=5] {
            assert!(without(hidden.clone(), 0.1).is_end_visible(), "{hidden:?}");
        }
    }

    #[test]
    fn an_offset_that_all_edges_share_hides_nothing() {
        assert_eq!(without(7..=7, 2.5).visible_disk_share(), 6.0 / 7.0);
    }
}
