//! Model selection among the local minima of a fit: which other bends explain a picture as well as the best one.
//!
//! The picture of one camera hardly tells towards it from away from it, so that a fit has local minima: the mirrored solution, and
//! bends whose disks fall on their neighbours' places. Two fits are compared by their cost and by the scatter of their edges.

use super::bend::{BendFit, ProfileCovariance, Start};
use super::noise_model::noise_model;
use super::schedule::LAST_SEARCH_PX;
use super::state::State;
use crate::geometry::Pose;
use crate::measure::body::Projection;
use crate::robot::{BendProfile, MODES};
use nalgebra::{SVector, Vector2, Vector3};
use std::f64::consts::{E, TAU};

/// Another fit explains the picture as well only if its cost is below this many times the best one's.
///
/// Fitted: by hand on renders; judged by `tests/eye/robustness`.
const COST_RATIO: f64 = 1.5;
/// And only if the scatter of its edges is below this many times the best one's.
///
/// Fitted: on renders of snakes bent by 3°, which have a second minimum with a third more scatter; judged by `tests/eye/robustness`.
const SCATTER_RATIO: f64 = 1.3;
/// Fits this close together, rad, differ by how the disks are tilted, which does not show where they are seen edge-on.
///
/// Fitted: by hand on renders; judged by `tests/eye/robustness`.
pub(crate) const EDGE_ON_RAD: f64 = 0.1;
/// The same in a coarse picture: so close that the rims of the tip's disk open by the same amount, px.
///
/// Fitted: by hand on coarse renders; judged by `tests/eye/robustness`.
const EDGE_ON_PX: f64 = 2.0;
/// A fit explains all of the outline only if its cost is below this.
///
/// Fitted: by hand on renders, for speed; judged by `tests/eye/robustness`.
const EXPLAINING_COST: f64 = 0.01;
/// And only if this share of the outline agrees with it.
///
/// Fitted: by hand on renders, for speed, together with the cost; judged by `tests/eye/robustness`.
const EXPLAINING_INLIERS: f64 = 0.95;
/// A coarse fit with this share, of which every disk is visible, is worth a fit in the fine stage before others are tried, ...
///
/// Fitted: to the first candidates of 217 photo-realistic frames; those with less hardly ever reach what follows, and no wrong one has more and every
/// disk visible.
const PROMISING_INLIERS: f64 = 0.93;
/// ... and one of the fine stage with this share need not be compared with others. A fit with less may be one of several.
///
/// Fitted: to frames of `tests/eye/robustness`; one that was too dark had 0.951 at a wrong bend, and all 36 of a photo-realistic experiment have more
/// at the right one.
const UNRIVALLED_INLIERS: f64 = 0.965;

/// How far the last disk of a snake that may have any shape is turned, rad, to look for other local minima.
///
/// Fitted: on lone frames of random rigs (`tests/eye/robustness`), whose other minima were 1.4° to 3.1° from the first; starts from 1.5° to 5°
/// away led to the same ones.
const TIP_TURN_RAD: f64 = 0.05;

/// The step of the difference by which a bend's change of the tip's tilt is found, rad.
///
/// Convention: far below what a tilt changes over, far above rounding.
const TILT_STEP_RAD: f64 = 1e-4;
/// Steps of Newton's method to a mirrored bend.
///
/// Convention: an iteration cap; two leave less than any fit needs to be near to its end.
const MIRRORING_STEPS: usize = 3;
/// The least change of the last disk's tilt with the tip's bend.
///
/// Derived: the cosine of 75°; beyond that angle to the picture's plane the disk is seen from the front, and no bend near by looks alike.
const LEAST_TILT_SLOPE: f64 = 0.26;
/// How far a mirrored bend may be from where it would be for a camera far away, rad.
///
/// Derived: twice the 15° at which a camera may see the tip beside the base: the snake is then as long as half the picture's distance.
const FURTHEST_FROM_AFAR_RAD: f64 = 0.5;
/// Of two fits that explain a picture as well, the one nearer to an arc is taken if its shape is this many times as likely.
///
/// Convention: odds of 20 to 1, the usual 5 % of a wrong decision.
const SHAPE_ODDS: f64 = 20.0;

/// What another local minimum means beside the best one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Alternative {
    /// The same snake with disks seen edge-on that tilt the other way: the doubt belongs into the covariance.
    EdgeOn,
    /// Another bend that explains the picture as well: the picture is ambiguous.
    AsGood,
    /// A bend that explains the picture worse.
    Worse,
}

impl Alternative {
    /// Compares a fit with the best one, of a snake that is `diameter_px` wide in the picture.
    pub fn of(other: &BendFit, best: &BendFit, diameter_px: f64) -> Self {
        let edge_on_rad = EDGE_ON_RAD.max(2.0 * EDGE_ON_PX / diameter_px);
        if (other.bend() - best.bend()).norm() < edge_on_rad {
            Self::EdgeOn
        } else if other.cost < COST_RATIO * best.cost && other.rms_px < SCATTER_RATIO * best.rms_px {
            Self::AsGood
        } else {
            Self::Worse
        }
    }
}

impl BendFit {
    /// Whether this fit's shape is so much more likely than another's that it decides between them, even where the edges speak for the other.
    /// A shape that contradicts what is known of the snake's decides nothing.
    ///
    /// A snake that is bent towards the camera and one bent away from it explain a picture alike if one of them may have any shape.
    /// How far this snake departs from an arc is known to its prior's width only, so that every size of a mode counts alike (a density of
    /// 1/σ for its width): the density of a pair of components with mean square error s² is then in proportion to 1/(|a|² + s²).
    pub fn has_likelier_shape_than(&self, other: &Self) -> bool {
        let against = (other.log_likelihood() - self.log_likelihood()).max(0.0);
        !self.contradicts_shape && other.shape_surprise() - self.shape_surprise() - against > SHAPE_ODDS.ln()
    }

    /// ln of the likelihood of what was found at the searched points, but for what all fits of a picture have in common: where edge and model
    /// agree a normal error, and elsewhere an edge anywhere within the search distance. As many neighbours as err alike count as one.
    fn log_likelihood(&self) -> f64 {
        let agreeing = self.inlier_fraction();
        // −ln of the density of a normal error of this σ, on the average, and of one that is uniform.
        let normal = (self.rms_px.max(f64::MIN_POSITIVE) * (TAU * E).sqrt()).ln();
        let uniform = (2.0 * LAST_SEARCH_PX).ln();
        let entropy = |share: f64| if share > 0.0 { -share * share.ln() } else { 0.0 };
        let surprise = agreeing * normal + (1.0 - agreeing) * uniform + entropy(agreeing) + entropy(1.0 - agreeing);
        -surprise * self.searched_points() as f64 / noise_model().design_effect
    }

    /// Where other local minima of a snake that may have any shape are looked for.
    ///
    /// The picture hardly tells how far the last disk is turned about an axis across the line of sight: towards the camera and away from it
    /// look alike, and so do some turns by few degrees. The rest of the profile moves with the tip as the covariance says, which leaves all
    /// but the last disk where it is.
    pub fn shapes_beside(&self, view: &Projection) -> [Start; 4] {
        let depth = depth_direction(&view.camera_from_base);
        let by_depth = self.covariance.fixed_columns::<2>(0) * depth;
        let moved_rad = depth.dot(&by_depth.fixed_rows::<2>(0));
        let turned = |by_rad: f64| self.profile.stepped((by_depth * (by_rad / moved_rad)).as_slice());
        let mirrored_rad = mirroring_turn(view, self.profile);
        let mirrored = turned_in_depth(self.profile, view, mirrored_rad);
        [mirrored, turned(mirrored_rad), turned(TIP_TURN_RAD), turned(-TIP_TURN_RAD)]
            .map(|profile| Start { state: State { profile, bias: self.bias }, ..self.start() })
    }

    /// −ln of the density of the modes, but for a constant.
    fn shape_surprise(&self) -> f64 {
        let of_mode = |k: usize| {
            let error = self.covariance[(2 + 2 * k, 2 + 2 * k)] + self.covariance[(3 + 2 * k, 3 + 2 * k)];
            (1.0 + self.profile.modes[k].norm_squared() / error).ln()
        };
        (0..MODES).map(of_mode).sum()
    }

    /// The better of two fits of a snake seen edge-on. If the other one is as good, the one whose shape is much likelier is the better one,
    /// and the covariance contains the doubt between them: the variance of two equally likely values. Of several such fits those furthest apart
    /// count, however often and in whatever order each is met.
    pub fn or_edge_on(self, other: Self) -> Self {
        let doubt = self.doubt_beside(&other);
        let (mut better, mut worse) = if other.cost < self.cost { (other, self) } else { (self, other) };
        if worse.cost < COST_RATIO * better.cost {
            if worse.has_likelier_shape_than(&better) {
                (better, worse) = (worse, better);
            }
            better.doubt_as_much_as(worse.doubt);
            better.doubt_as_much_as(doubt);
        }
        better
    }

    /// This fit, whose covariance contains the doubt between it and what it becomes if the snake may have any shape. `None` where that is another
    /// bend, of a snake that is `diameter_px` wide in the picture, or explains the picture better.
    ///
    /// Where part of the outline is hidden, what is left of it may not contradict a shape that the snake does not have.
    pub fn whatever_shape(mut self, any_shape: &Self, diameter_px: f64) -> Option<Self> {
        let is_near = Alternative::of(any_shape, &self, diameter_px) == Alternative::EdgeOn;
        self.doubt_as_much_as(self.doubt_beside(any_shape));
        (is_near && self.cost < COST_RATIO * any_shape.cost).then_some(self)
    }

    /// The variance of two equally likely values, this fit and another.
    fn doubt_beside(&self, other: &Self) -> ProfileCovariance {
        let apart = SVector::from(self.profile.to_array()) - SVector::from(other.profile.to_array());
        apart * apart.transpose() / 4.0
    }

    /// Makes the covariance contain at least this doubt.
    fn doubt_as_much_as(&mut self, doubt: ProfileCovariance) {
        if doubt.trace() > self.doubt.trace() {
            self.covariance += doubt - self.doubt;
            self.doubt = doubt;
        }
    }

    /// Whether the fit explains all of the outline, with every disk visible, so that no other bend needs to be tried.
    pub fn explains_all(&self) -> bool {
        self.cost < EXPLAINING_COST && self.inlier_fraction() >= EXPLAINING_INLIERS && self.shows_every_disk()
    }

    /// Whether a coarse fit is likely to be unrivalled in the fine stage.
    pub fn is_promising(&self) -> bool {
        self.inlier_fraction() >= PROMISING_INLIERS && self.shows_every_disk()
    }

    /// Whether a fit of the fine stage agrees with so much of the outline that other candidates need not be tried.
    pub fn is_unrivalled(&self) -> bool {
        self.inlier_fraction() >= UNRIVALLED_INLIERS && self.shows_every_disk()
    }

    fn shows_every_disk(&self) -> bool {
        let visibility = self.visibility();
        visibility.visible_disk_share() == 1.0 && visibility.is_end_visible()
    }
}

/// Local minima, best first; of those that ended within `apart_rad` of each other only the best.
pub(crate) fn distinct(mut fits: Vec<BendFit>, apart_rad: f64) -> Vec<BendFit> {
    fits.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut kept: Vec<BendFit> = Vec::new();
    for fit in fits {
        if kept.iter().all(|k| (k.bend() - fit.bend()).norm() > apart_rad) {
            kept.push(fit);
        }
    }
    kept
}

/// The bend whose outline is nearly the same: its last disk is tilted towards the camera by as much as that of this bend is tilted away.
pub(crate) fn mirrored(bend: Vector2<f64>, view: &Projection) -> Vector2<f64> {
    bend + depth_direction(&view.camera_from_base) * mirroring_turn(view, BendProfile::arc(bend))
}

/// By how much the tip's bend must change along the line of sight, rad, for the last disk to be tilted the other way by as much.
///
/// From afar that is to mirror the bend in the plane through the snake's axis that is perpendicular to the line of sight. A camera sees the tip along
/// a line of its own, some degrees from that to the base, which counts where the bend is small. By Newton's method; where the tip points nearly
/// along the line of sight, so that its tilt hardly changes, the mirrored bend has to do.
fn mirroring_turn(view: &Projection, profile: BendProfile) -> f64 {
    let tilt = |by_rad: f64| tip_tilt(view, turned_in_depth(profile, view, by_rad));
    let tilt_now = tilt(0.0);
    let from_afar_rad = -2.0 * depth_direction(&view.camera_from_base).dot(&profile.tip);
    let mut turn_rad = from_afar_rad;
    for _ in 0..MIRRORING_STEPS {
        let slope = (tilt(turn_rad + TILT_STEP_RAD) - tilt(turn_rad - TILT_STEP_RAD)) / (2.0 * TILT_STEP_RAD);
        turn_rad -= (tilt(turn_rad) + tilt_now) / slope;
        if !(slope > LEAST_TILT_SLOPE && (turn_rad - from_afar_rad).abs() < FURTHEST_FROM_AFAR_RAD) {
            return from_afar_rad;
        }
    }
    turn_rad
}

/// The profile with another bend of the tip along the line of sight.
fn turned_in_depth(profile: BendProfile, view: &Projection, by_rad: f64) -> BendProfile {
    let depth = depth_direction(&view.camera_from_base);
    BendProfile { tip: profile.tip + depth * by_rad, modes: profile.modes }
}

/// By how much the snake's tip points away from the camera, rad: zero where its last disk is seen edge-on.
fn tip_tilt(view: &Projection, profile: BendProfile) -> f64 {
    let tip = view.camera_from_base * view.curve(profile).frame_at(view.robot.length_mm);
    (tip.rotation * Vector3::z()).dot(&tip.translation.vector.normalize()).asin()
}

/// The direction of a bend vector along which a straight snake bends towards a camera at this pose or away from it.
fn depth_direction(camera_from_base: &Pose) -> Vector2<f64> {
    let sight = camera_from_base.inverse() * camera_from_base.translation.vector;
    sight.xy().normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::fixture::Scene;

    /// Bends to all sides, up to 55°.
    fn bends() -> impl Iterator<Item = Vector2<f64>> {
        let at = |k: u32| 0.3 * f64::from(k) - 1.2;
        (0..81).map(move |k| Vector2::new(at(k / 9), at(k % 9))).filter(|bend| bend.norm() < 1.0)
    }

    #[test]
    fn a_mirrored_bend_tilts_the_last_disk_the_other_way() {
        for turn in [Vector3::zeros(), Vector3::new(0.05, -0.1, 0.0), Vector3::new(-0.1, 0.1, 0.1)] {
            let scene = Scene::new(turn);
            let view = scene.view();
            for bend in bends() {
                let mirrored_bend = mirrored(bend, &view);
                let [tilt, mirrored_tilt] = [bend, mirrored_bend].map(|bend| tip_tilt(&view, BendProfile::arc(bend)));
                assert!((tilt + mirrored_tilt).abs() < 1e-4, "{bend}: {tilt} and {mirrored_tilt} rad");
                assert!((mirrored(mirrored_bend, &view) - bend).norm() < 1e-3, "{bend}");
            }
        }
    }

    #[test]
    fn from_afar_a_bend_is_mirrored_in_the_plane_across_the_line_of_sight() {
        let mut scene = Scene::new(Vector3::zeros());
        scene.camera_from_base = Pose::from_parts(Vector3::new(0.0, 0.0, 1e7).into(), scene.camera_from_base.rotation);
        for bend in bends() {
            let plain = Vector2::new(bend.x, -bend.y);
            assert!((mirrored(bend, &scene.view()) - plain).norm() < 1e-5, "{bend}");
        }
    }
}
