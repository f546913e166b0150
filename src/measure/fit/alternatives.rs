//! Where other local minima of a fit are looked for, and when none needs to be.
//!
//! The picture of one camera hardly tells towards it from away from it: the mirrored solution looks nearly alike, and so do other shapes of the snake.

use super::bend::{BendFit, Start};
use super::state::State;
use crate::geometry::Pose;
use crate::measure::body::Projection;
use crate::robot::BendProfile;
use nalgebra::{Vector2, Vector3};

/// A fit that agrees with this share of the outline's points explains it. One with less may be one of several, or have a shape that no snake has.
///
/// Fitted: to frames of `tests/eye/robustness`; one that was too dark had 0.951 at a wrong bend, of snakes of unlikely shape that were measured falsely up to 0.964
/// agreed, and all 36 frames of a photo-realistic experiment have more at the right bend. With it one frame of 1,140 of other seeds is false, with 0.971.
/// Judged by the seeds 16000 to 16063 (the book's "How well it measures").
const EXPLAINING_SHARE: f64 = 0.965;
/// A coarse fit with this share, of which every disk is visible, is worth a fit in the fine stage before others are tried.
///
/// Fitted: to the first candidates of 217 photo-realistic frames; those with less hardly ever reach what follows, and no wrong one has more and every
/// disk visible. For speed; judged by `tests/eye/robustness`.
const PROMISING_SHARE: f64 = 0.93;

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

impl BendFit {
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

    /// Whether nearly all of the outline agrees with the fit.
    pub fn explains_outline(&self) -> bool {
        self.inlier_fraction() >= EXPLAINING_SHARE
    }

    /// Whether the fit explains the outline, with every disk visible, so that no other bend needs to be tried.
    pub fn explains_all(&self) -> bool {
        self.explains_outline() && self.shows_every_disk()
    }

    /// Whether a coarse fit is likely to explain all in the fine stage.
    pub fn is_promising(&self) -> bool {
        self.inlier_fraction() >= PROMISING_SHARE && self.shows_every_disk()
    }

    fn shows_every_disk(&self) -> bool {
        let visibility = self.visibility();
        visibility.visible_disk_share() == 1.0 && visibility.is_end_visible()
    }
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
