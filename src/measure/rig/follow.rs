//! The rig of a camera that moves, followed from frame to frame.
//!
//! Camera against target and base is what moves; target against base is what the straight picture told once and for all. From
//! frame to frame the camera is found again from the holder's edges and the target's waves together; where it jumped further
//! than they can tell, from the holder and the grid as in a first picture.

use super::body_template::BodyTemplate;
use super::calibrate::region_of;
use super::drift::{DriftCheck, RigDriftMonitor};
use super::parameters::Rig;
use super::snake_search::{search_everywhere, search_nearby};
use crate::camera::{Frame, Lens};
use crate::geometry::{Pose, perturbed};
use crate::measure::body::Projection;
use crate::measure::fit::EdgeFinder;
use crate::measure::target::{SheetHypothesis, SheetSearch};
use crate::observation::Status;
use crate::robot::Robot;
use nalgebra::{Matrix6, Point3, Vector2, Vector6};
use std::ops::Range;

/// What holder and target leave unknown of the camera's pose however well they are seen (waviness of the target, printing, shading; 1σ):
/// turns about the camera's axes, rad, and shifts along them, mm.
///
/// Fitted: by hand to the errors of followed rigs on the project's renders (tests/eye/drift.rs); not judged elsewhere.
const UNKNOWN: [f64; 6] = [8e-4, 8e-4, 2e-4, 3e-3, 3e-3, 0.07];
/// The most Gauss–Newton steps from one rig to the next, and the one, as a shift of the target, px, after which it has converged.
///
/// Convention: a cap, and less than any frame's noise.
const ROUNDS: usize = 5;
const CONVERGED_PX: f64 = 0.03;
/// The pitches, in units of the rig's, that are looked at where the camera jumped.
///
/// Convention: a camera that came nearer or went away by a quarter.
const PITCHES: Range<f64> = 0.75..1.33;

/// How far the camera may have rolled where it jumped, rad.
///
/// Convention: a knock, not a new setup.
const MOST_TURN: f64 = 0.5;

/// What a frame says of the rig.
pub enum Followed {
    /// Nothing moved.
    Still,
    /// The rig where the camera of this frame is, and the monitor that goes with it.
    Moved(Box<(Rig, RigDriftMonitor)>),
}

/// Follows a rig whose camera may move.
pub struct RigFollower<'a> {
    pub lens: &'a Lens,
    pub robot: &'a Robot,
    /// Covariance of the camera's pose as calibrated, before a camera that moves was followed.
    pub calibrated_covariance: &'a Matrix6<f64>,
}

impl RigFollower<'_> {
    /// The rig where the camera of a frame is, whose edges the finder finds. A target that slid behind a snake that stayed is followed, too.
    ///
    /// # Errors
    ///
    /// Why the camera is not known: most often [`Status::GridLost`].
    pub fn follow(
        &self,
        rig: &Rig,
        monitor: &RigDriftMonitor,
        frame: &Frame,
        finder: &EdgeFinder,
    ) -> Result<Followed, Status> {
        let DriftCheck { base, grid } = monitor.check(frame, finder);
        let drift = DriftCheck { base, grid };
        if drift.is_still() {
            return Ok(Followed::Still);
        }
        match (base, grid) {
            (Some(base), Some(grid)) if drift.status().is_none() && !base.went_with(&grid) => {
                let rig = Rig { camera_from_grid: grid.camera_from_grid, ..rig.clone() };
                let monitor = self.monitor(&rig);
                return Ok(Followed::Moved(Box::new((rig, monitor))));
            }
            (Some(_), None) if drift.status().is_none() => return Ok(Followed::Still),
            _ => {}
        }
        self.converged(rig.clone(), frame, finder).or_else(|status| {
            let again = self.found_again(rig, frame);
            again.into_iter().find_map(|rig| self.converged(rig, frame, finder).ok()).ok_or(status)
        })
    }

    fn view(&self, rig: &Rig) -> Projection<'_> {
        Projection { lens: self.lens, camera_from_base: rig.camera_from_base, robot: self.robot }
    }

    fn monitor(&self, rig: &Rig) -> RigDriftMonitor {
        RigDriftMonitor::new(self.lens, rig, &self.view(rig))
    }

    /// The rig to which holder and target lead from one that is nearly right.
    fn converged(&self, mut rig: Rig, frame: &Frame, finder: &EdgeFinder) -> Result<Followed, Status> {
        let unknown = Matrix6::from_diagonal(&Vector6::from(UNKNOWN).map(|s| s * s));
        for _ in 0..ROUNDS {
            let motion = self.monitor(&rig).camera_motion(frame, finder, &self.view(&rig)).ok_or(Status::GridLost)?;
            rig = with_camera_moved(&rig, &motion.by);
            rig.pose_covariance = self.calibrated_covariance + motion.covariance + unknown;
            if motion.px < CONVERGED_PX {
                break;
            }
        }
        let monitor = self.monitor(&rig);
        let drift = monitor.check(frame, finder);
        match drift.status() {
            Some(Status::CameraMoved) => Err(Status::GridLost),
            Some(other) => Err(other),
            None if drift.grid.is_none() || drift.base.is_none() => Err(Status::GridLost),
            None => Ok(Followed::Moved(Box::new((rig, monitor)))),
        }
    }

    /// Rigs that may be nearly right, from the grid and the holder as a first picture would tell them: of a snake that may be bent the holder is what
    /// stands out, together with the first of the snake.
    fn found_again(&self, rig: &Rig, frame: &Frame) -> Vec<Rig> {
        let search = SheetSearch::new(frame, self.lens, rig.grid_pitch_mm);
        let depth_mm = (rig.camera_from_grid * Point3::origin()).z;
        let pitch_px = self.lens.focal_px.x * rig.grid_pitch_mm / depth_mm;
        let is_near = |hypothesis: &&SheetHypothesis| {
            hypothesis.kind == rig.pattern.kind
                && hypothesis.pitch_px.iter().all(|px| PITCHES.contains(&(px / pitch_px)))
        };
        let ruling = search.hypotheses.iter().find(is_near);
        ruling.and_then(|ruling| self.found_at(rig, frame, &search, ruling)).unwrap_or_default()
    }

    /// The same if this is the ruling, the likeliest first.
    fn found_at(
        &self,
        rig: &Rig,
        frame: &Frame,
        search: &SheetSearch,
        hypothesis: &SheetHypothesis,
    ) -> Option<Vec<Rig>> {
        let Self { lens, robot, .. } = self;
        let grid = search.refined(lens, hypothesis, None)?;
        let grid_from_base = rig.camera_from_grid.inverse() * rig.camera_from_base;
        let base_mm = grid_from_base.translation.vector;
        let region = region_of(search, lens);
        let distance_mm = grid.distance_mm(&lens.ray(&region.middle())) + base_mm.z;
        let width_px = lens.focal_px.x * robot.body.disk_diameter_mm / distance_mm;
        let template = BodyTemplate::of_holder(robot);
        let (_, axis) = self.view(rig).holder_end();
        let found = search_everywhere(frame, &template, width_px, &region, |seen| seen.angle(&axis) < MOST_TURN);
        let starts = search_nearby(frame, &template, width_px, &region, &found);
        // Where the base would be on the lattice as it was found now: the base's height over the target is known.
        let grid_from_camera = grid.sheet.camera_from_grid.inverse();
        let eye = grid_from_camera * Point3::origin();
        // The holder's end is found to half a pitch or so: the lines next to the nearest ones are tried as well.
        let near = [(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)];
        let rigs = starts.into_iter().flat_map(|start| {
            let ray = grid_from_camera * lens.ray(&start.base);
            let at = eye + ray * ((base_mm.z - eye.z) / ray.z);
            let lines = ((at.coords - base_mm).xy() / rig.grid_pitch_mm).map(f64::round);
            near.map(|(x, y)| {
                let slide = (lines + Vector2::new(f64::from(x), f64::from(y))) * rig.grid_pitch_mm;
                let camera_from_grid: Pose = grid.sheet.counted_from(slide).camera_from_grid;
                Rig { camera_from_grid, camera_from_base: camera_from_grid * grid_from_base, ..rig.clone() }
            })
        });
        Some(rigs.collect())
    }
}

/// A rig whose camera moved: turned about the base's origin and shifted (see [`perturbed`]).
fn with_camera_moved(rig: &Rig, by: &Vector6<f64>) -> Rig {
    let camera_from_base = perturbed(&rig.camera_from_base, by);
    let grid_from_base = rig.camera_from_grid.inverse() * rig.camera_from_base;
    Rig { camera_from_grid: camera_from_base * grid_from_base.inverse(), camera_from_base, ..rig.clone() }
}

#[cfg(test)]
mod tests {
    use super::super::parameters::tests::rig;
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn a_camera_that_moves_leaves_the_base_before_the_target_where_it_was() {
        let moved = with_camera_moved(&rig(), &Vector6::new(0.01, -0.02, 0.03, 1.0, 2.0, 3.0));
        let grid_from_base = |rig: &Rig| rig.camera_from_grid.inverse() * rig.camera_from_base;
        let (before, after) = (grid_from_base(&rig()), grid_from_base(&moved));
        assert_relative_eq!(before.translation.vector, after.translation.vector, epsilon = 1e-9);
        assert!(before.rotation.angle_to(&after.rotation) < 1e-9);
        let shift = moved.camera_from_base.translation.vector - rig().camera_from_base.translation.vector;
        assert_relative_eq!(shift, nalgebra::Vector3::new(1.0, 2.0, 3.0), epsilon = 1e-12);
    }
}
