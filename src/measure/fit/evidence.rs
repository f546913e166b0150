//! The evidence of a picture's edges: how much likelier they are with a snake where a fit puts it than without one.
//!
//! Where a snake is, the edge near a point of its outline lies a normal error from the model, unless something covers it. Where none is, what looks like
//! an edge lies anywhere within the search distance. With the share a of the points whose edges agree, an edge of standard deviation σ found at the
//! distance d within ±w has the ratio of densities
//!
//! ```text
//! a N(d; 0, e σ²) · 2w + (1 − a) ,
//! ```
//!
//! and a point without an edge 1 − a. The factor e is by how much the agreeing edges' variance exceeds what σ says ([`excess`](super::excess)). The logarithms
//! are added up over the points of each part; as many neighbours as err alike count as one
//! ([`NoiseModel::design_effect`](super::noise_model::NoiseModel::design_effect)). The bend is what its tip does, so that it is known only as far as the outline
//! up to the tip speaks for the snake.
//!
//! The end counts as seen if the odds that it is where the fit says, and not hidden, are those that decide between bends. A face that mirrors a lamp shines,
//! and its border is an edge the other way round: such a fit, whose edges were looked for either way, is a mode beside the others, and says so much less as
//! this is rare.
//!
//! An edge that a printed line or a highlight beside it may displace has a large σ, so that it says little wherever it lies. What compares two fits
//! must not take many such edges for a bad fit, nor a wrong fit whose edges happen to scatter less for a good one.

use super::correspondences::Correspondences;
use super::noise_model::noise_model;
use super::visibility::END_DISKS;
use crate::measure::body::Piece;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// How often a disk is hidden.
///
/// Fitted: to the lone frames of `tests/eye/robustness` with the seeds 13000 to 13056: of 2,821 disks of snakes that were measured rightly 50 had less evidence than clutter.
const HIDDEN: f64 = 0.02;

/// How often faces mirror a lamp, so that they are as unlike the snake as the target is, or more.
///
/// Convention: as rare as a hidden disk.
const MIRRORING: f64 = HIDDEN;

/// Odds that decide.
///
/// Convention: 20 to 1, the usual 5 % of a wrong decision.
pub(super) const DECIDING_ODDS: f64 = 20.0;

/// Logarithms of how much likelier edges are with the snake than without it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Evidence {
    /// Of each disk, by its number, from the base on; it may be hidden.
    disks: Vec<f64>,
    tubes: f64,
    /// ln of how often the light falls so that edges are what they were taken for.
    light: f64,
}

impl Evidence {
    /// Of the searched points of a fit. The edges lie these distances (px) from the model; a share `agreeing` of all points have edges that agree with
    /// it, with a variance that exceeds what their σ say by this factor.
    pub fn new(edges: &Correspondences, distances_px: &[f64], search_px: f64, agreeing: f64, excess: f64) -> Self {
        let points = edges.searched().len().max(1) as f64;
        // No share that a picture shows is known more exactly than to one point.
        let share = agreeing.clamp(1.0 / points, 1.0 - 1.0 / points);
        let found = |distance_px: f64, sigma_px: f64| {
            let spread_px = sigma_px * excess.sqrt();
            let density = (-0.5 * (distance_px / spread_px).powi(2)).exp() / (spread_px * TAU.sqrt());
            (share * density * 2.0 * search_px + 1.0 - share).ln()
        };
        let missing = (1.0 - share).ln();
        let mut parts: BTreeMap<Option<u8>, f64> = BTreeMap::new();
        let mut add = |piece: Piece, ratio: f64| *parts.entry(piece.disk()).or_default() += ratio;
        edges.searched().iter().for_each(|(piece, _)| add(*piece, missing));
        let found = edges.all.iter().zip(distances_px).map(|(edge, px)| (edge.piece, found(*px, edge.sigma_px)));
        found.for_each(|(piece, ratio)| add(piece, ratio - missing));
        let alike = noise_model().design_effect;
        let tubes = parts.remove(&None).unwrap_or(0.0) / alike;
        Self { tubes, disks: parts.into_values().map(|sum| or_hidden(sum / alike)).collect(), light: 0.0 }
    }

    /// Edges that say so much for the snake, wherever they are.
    #[cfg(test)]
    pub fn amounting_to(total: f64) -> Self {
        Self { tubes: total, ..Self::default() }
    }

    /// Takes it that the edges were looked for either way, since faces may mirror a lamp.
    pub fn assume_a_mirrored_lamp(&mut self) {
        self.light = MIRRORING.ln();
    }

    /// Of the whole outline.
    pub fn total(&self) -> f64 {
        self.tubes + self.disks.iter().sum::<f64>() + self.light
    }

    /// Whether there is a snake, at the odds that decide.
    pub fn shows_snake(&self) -> bool {
        self.total() >= DECIDING_ODDS.ln()
    }

    /// Of the tubes between the disks.
    pub fn of_tubes(&self) -> f64 {
        self.tubes
    }

    /// Of the disks from one of them on to the tip, at least [`END_DISKS`], from where on it is least: tubes look alike all along the snake.
    pub fn of_tip(&self) -> f64 {
        let (middle, end) = self.parts();
        let end: f64 = end.iter().sum();
        let sums = middle.iter().rev().scan(end, |sum, disk| {
            *sum += disk;
            Some(*sum)
        });
        sums.fold(end, f64::min)
    }

    /// Whether the snake's end is where the fit says, and not hidden, at the odds that decide: an end is hidden as often as a disk is.
    pub fn shows_tip(&self) -> bool {
        self.of_tip() + ((1.0 - HIDDEN) / HIDDEN).ln() >= DECIDING_ODDS.ln()
    }

    /// Of the disks before the snake's end.
    pub fn before_tip(&self) -> f64 {
        self.parts().0.iter().sum()
    }

    /// The disks before the snake's end, and those of its end.
    fn parts(&self) -> (&[f64], &[f64]) {
        self.disks.split_at(self.disks.len().saturating_sub(END_DISKS))
    }
}

/// The evidence for a part that is hidden as often as a disk is: what hides it says as much as clutter.
fn or_hidden(evidence: f64) -> f64 {
    ((1.0 - HIDDEN) * evidence.exp() + HIDDEN).ln()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::body::Outline;
    use crate::measure::fixture::Scene;
    use crate::robot::BendProfile;
    use nalgebra::{Vector2, Vector3};
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;

    const SEARCH_PX: f64 = 3.0;
    const RMS_PX: f64 = 0.2;

    /// Edges that lie as `draw` says, a share of which agrees with the model.
    fn evidence(mut draw: impl FnMut(&mut StdRng) -> f64, agreeing: f64) -> Evidence {
        let scene = Scene::new(Vector3::new(0.05, -0.1, 0.0));
        let outline = Outline::spaced(&scene.view(), BendProfile::arc(Vector2::new(0.6, 0.4)), 2.0);
        let mut random = StdRng::seed_from_u64(1);
        let displacements_px: Vec<f64> = outline.points.iter().map(|_| draw(&mut random)).collect();
        let edges = Correspondences::displaced(&outline, &displacements_px, RMS_PX);
        let distances_px: Vec<f64> = edges.searched().iter().filter_map(|(_, edge)| Some((*edge)?.offset_px)).collect();
        Evidence::new(&edges, &distances_px, SEARCH_PX, agreeing, 1.0)
    }

    /// The mean of the logarithm is the relative entropy of both densities.
    #[test]
    fn edges_of_a_snake_speak_for_it_by_as_much_as_both_densities_differ() {
        let of_snake = evidence(|random| RMS_PX * random.sample::<f64, _>(StandardNormal), 1.0);
        let per_point = (2.0 * SEARCH_PX / (RMS_PX * (TAU * std::f64::consts::E).sqrt())).ln();
        let points = {
            let scene = Scene::new(Vector3::new(0.05, -0.1, 0.0));
            let outline = Outline::spaced(&scene.view(), BendProfile::arc(Vector2::new(0.6, 0.4)), 2.0);
            Correspondences::displaced(&outline, &vec![0.0; outline.points.len()], RMS_PX).len() as f64
        };
        let expected = per_point * points / noise_model().design_effect;
        assert!((of_snake.total() / expected - 1.0).abs() < 0.05, "{} {expected}", of_snake.total());
        assert!(of_snake.of_tip() > 5.0, "{of_snake:?}");
    }

    #[test]
    fn a_snake_is_shown_at_odds_of_twenty_to_one() {
        assert!(Evidence::amounting_to(3.0).shows_snake() && !Evidence::amounting_to(2.99).shows_snake());
    }

    #[test]
    fn clutter_speaks_against_a_snake_whatever_share_of_it_agrees_by_chance() {
        for agreeing in [0.2, 0.5, 0.8] {
            let of_clutter = evidence(|random| random.random_range(-SEARCH_PX..SEARCH_PX), agreeing);
            assert!(of_clutter.total() < 0.0 && of_clutter.of_tip() < 0.0, "{agreeing}: {of_clutter:?}");
        }
    }

    #[test]
    fn one_hidden_disk_does_not_hide_the_tip_and_two_at_the_end_do() {
        let snake =
            |disks: &[f64]| Evidence { disks: disks.iter().map(|&e| or_hidden(e)).collect(), tubes: 20.0, light: 0.0 };
        assert!(snake(&[8.0, 8.0, 8.0, 8.0, 8.0, 8.0, -9.0]).of_tip() > 0.0);
        assert!(snake(&[8.0, 8.0, 8.0, 8.0, 8.0, -9.0, 8.0]).of_tip() > 0.0);
        assert!(snake(&[8.0, 8.0, 8.0, 8.0, 8.0, -9.0, -9.0]).of_tip() < 0.0);
        assert!(snake(&[8.0, 8.0, 8.0, 8.0, 8.0, -9.0, -9.0]).before_tip() > 0.0);
        // What no edge tells is decided by how rare a hidden end is, and an end that is as rare as the odds that decide is not.
        assert!(snake(&[8.0, 8.0, 0.0, 0.0]).shows_tip() && !snake(&[8.0, 8.0, -1.0, -1.0]).shows_tip());
        // Half a snake, whose tubes are seen.
        let half = snake(&[-0.8, -0.9, 0.7, -0.7, 0.3, -0.2, -1.9]);
        assert!(half.total() > 0.0 && half.of_tip() < 0.0 && half.before_tip() < 0.0);
        // What hides a disk costs what it is rare, however much of it there is.
        assert!((or_hidden(-50.0) - HIDDEN.ln()).abs() < 1e-12);
        assert!(snake(&[]).of_tip() <= 0.0);
    }
}
