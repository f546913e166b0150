//! Which parts of the snake a picture proves to be where a model puts them.
//!
//! A fit has only the edges that it found, and forgives those that disagree: a hand before the tip, or a disk taken for its
//! neighbour, leaves it with edges enough. What tells is where edges should be and are not, so every part is asked on its
//! own whether its outline is seen.

use super::edges::{Edge, EdgeFinder};
use crate::measure::body::{Outline, Piece};
use crate::measure::image::plane::median;
use std::collections::BTreeMap;

/// How much of the outline of each part has its edge where the model says.
#[derive(Debug, Clone)]
pub struct PartVisibility {
    /// Places with their edge, and all places, of the holder (number 0) and the disks (from 1 next to the base).
    parts: BTreeMap<u8, (usize, usize)>,
}

impl PartVisibility {
    /// Looks for the edges of an outline in a picture.
    pub fn new(outline: &Outline, finder: &EdgeFinder) -> Self {
        // Nearer to another part the edge's surroundings are not what the edge filter assumes.
        const CLEAR_PX: f64 = 3.0;
        const SEARCH_PX: f64 = 4.0;
        let clear = outline.points.iter().filter(|p| p.gap_px >= CLEAR_PX && p.depth_px >= CLEAR_PX);
        Self::of(&clear.map(|p| (p.piece, finder.find(p, SEARCH_PX))).collect::<Vec<_>>())
    }

    /// From places of the outline and the edge found near each. Where all of them lie to one side of it, as overexposed or
    /// soft ones do, that is not held against them.
    pub(crate) fn of(places: &[(Piece, Option<Edge>)]) -> Self {
        const NEAR_PX: f64 = 1.0;
        let asked: Vec<_> = places.iter().filter_map(|(piece, edge)| Some((part(*piece)?, edge))).collect();
        let mut offsets: Vec<f32> =
            asked.iter().filter_map(|(_, edge)| Some(edge.as_ref()?.offset_px as f32)).collect();
        let bias_px = f64::from(median(&mut offsets));
        let mut parts: BTreeMap<u8, (usize, usize)> = BTreeMap::new();
        for (part, edge) in asked {
            let (seen, places) = parts.entry(part).or_default();
            *places += 1;
            let is_near = |offset_px: f64, sigma_px: f64| (offset_px - bias_px).abs() < NEAR_PX.max(2.0 * sigma_px);
            *seen += usize::from(edge.is_some_and(|edge| is_near(edge.offset_px, edge.sigma_px)));
        }
        Self { parts }
    }

    /// The share of each disk's outline that is seen, 0 to 1, by the disk's number; disks too covered by others to be
    /// asked are left out.
    pub fn disk_shares(&self) -> impl Iterator<Item = (u8, f64)> {
        const FEWEST: usize = 4;
        self.parts
            .iter()
            .filter(|&(&part, &(_, places))| part > 0 && places >= FEWEST)
            .map(|(&part, _)| (part, self.share(part)))
    }

    /// The share of the disks that are there.
    pub fn visible_disk_share(&self) -> f64 {
        let (there, all) =
            self.disk_shares().fold((0, 0), |(there, all), (_, share)| (there + u32::from(is_there(share)), all + 1));
        f64::from(there) / f64::from(all.max(1))
    }

    /// Whether the snake's end is there: the last disk that can be asked or the one before it. Further down a bend towards the
    /// camera and one less long look alike, and where the tip points would be told by the disks of the base alone.
    pub fn is_end_visible(&self) -> bool {
        let mut shares: Vec<f64> = self.disk_shares().map(|(_, share)| share).collect();
        shares.drain(..shares.len().saturating_sub(2));
        shares.into_iter().any(is_there)
    }

    /// Whether the holder (0) or a disk is there.
    pub fn is_visible(&self, part: u8) -> bool {
        is_there(self.share(part))
    }

    /// Whether the holder and all disks up to the `last` are there, if only faintly. A snake that was put one disk too far along has
    /// parts of which next to nothing is seen.
    pub fn are_all_faintly_visible(&self, last: u8) -> bool {
        /// In renders of 200 random rigs right models of faint snakes have parts of which as little as 0.43 is seen, wrong ones that half
        /// of the edges agree with at most 0.28.
        const FAINTLY: f64 = 0.4;
        (0..=last).all(|part| self.share(part) >= FAINTLY)
    }

    /// The share of a part's outline that is seen; 0 where none of it can be asked.
    fn share(&self, part: u8) -> f64 {
        self.parts.get(&part).map_or(0.0, |&(seen, places)| seen as f64 / places as f64)
    }
}

/// A part is there if most of its outline is seen.
fn is_there(share: f64) -> bool {
    share >= 0.5
}

/// The number of the part that a piece belongs to. Tubes prove nothing: they look alike all along the snake.
fn part(piece: Piece) -> Option<u8> {
    match piece {
        Piece::HolderSide(_) | Piece::BaseRim => Some(0),
        Piece::Rim(disk, _) | Piece::DiskSide(disk, _) => Some(disk),
        Piece::Tube(..) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_faint_snake_is_there_if_every_part_of_it_is() {
        let of = |shares: &[(u8, usize)]| PartVisibility {
            parts: shares.iter().map(|&(part, seen)| (part, (seen, 100))).collect(),
        };
        assert!(of(&[(0, 43), (1, 52), (2, 64)]).are_all_faintly_visible(2));
        for not in [&[(0, 43), (1, 99), (2, 14)][..], &[(0, 43), (1, 52)], &[]] {
            assert!(!of(not).are_all_faintly_visible(2), "{not:?}");
        }
    }

    /// The visibility of a snake of seven disks, whose disks in `hidden` show no edge.
    fn without(hidden: std::ops::RangeInclusive<u8>) -> PartVisibility {
        let edge = |disk: u8| {
            let there = Edge { offset_px: 0.1, sigma_px: 0.1, blur_px: 1.0 };
            (!hidden.contains(&disk)).then_some(there)
        };
        let places = (1..=7).flat_map(|disk| (0..20).map(move |_| disk));
        PartVisibility::of(&places.map(|disk| (Piece::Rim(disk, true), edge(disk))).collect::<Vec<_>>())
    }

    #[test]
    fn a_snake_whose_two_last_disks_are_hidden_has_no_end() {
        assert!(!without(6..=7).is_end_visible());
        assert!(without(6..=7).visible_disk_share() > 0.7);
        for hidden in [7..=7, 6..=6, 3..=5] {
            assert!(without(hidden.clone()).is_end_visible(), "{hidden:?}");
        }
    }
}
