//! An eye that goes with its camera.
//!
//! Camera against grid and base is what moves; grid against base is what the straight picture told once and for all. From
//! frame to frame the camera is found again from the holder's edges and the paper's waves together; where it jumped further
//! than they can tell, from the holder and the grid as in a first picture.

use crate::camera::Frame;
use crate::geometry::Pose;
use crate::measure::body::Projection;
use crate::measure::eye::Eye;
use crate::measure::fit::{CoarseSearch, EdgeFinder};
use crate::measure::image::exposure::is_saturated;
use crate::measure::rig::calibrate::Rig;
use crate::measure::rig::drift::{Watch, Watched};
use crate::measure::rig::locate::{Colours, find_start, locate_holders};
use crate::measure::target::grid::{find_grid, nudged};
use crate::observation::Status;
use nalgebra::{DVector, Matrix6, Point2, Point3, Translation3, Vector2, Vector6};
use std::sync::Arc;

/// What holder and paper leave unknown however well they are seen (waviness of the paper, printing, shading; 1σ): turns about
/// the camera's axes, rad, and shifts along them, mm.
const UNKNOWN: [f64; 6] = [8e-4, 8e-4, 2e-4, 3e-3, 3e-3, 0.07];

impl Eye {
    /// This eye where the camera of a frame is. A paper that slid behind a snake that stayed is followed, too.
    ///
    /// Angles measured by the new eye have the uncertainty of this pose in them.
    ///
    /// # Errors
    /// Why the camera is not known: most often [`Status::GridLost`].
    pub fn following(&self, frame: &Frame) -> Result<Self, Status> {
        if (frame.width, frame.height) != (self.lens.width, self.lens.height) {
            return Err(Status::WrongSize);
        }
        if is_saturated(frame) {
            return Err(Status::Saturated);
        }
        let plane = self.rig.appearance.plane(frame);
        let finder = EdgeFinder::new(&plane, self.rig.appearance.two_sided);
        let watched = self.watch.look(frame, &finder);
        if watched.is_still() {
            return Ok(self.clone());
        }
        match (watched.base, watched.grid) {
            (Some(base), Some(grid)) if watched.status().is_none() && !base.went_with(&grid) => {
                return Ok(self.with_rig(Rig { camera_from_grid: grid.camera_from_grid, ..self.rig.clone() }));
            }
            (Some(_), None) if watched.status().is_none() => return Ok(self.clone()),
            _ => {}
        }
        self.settled(self.rig.clone(), frame, &finder).or_else(|status| {
            let again = self.found_again(frame).and_then(|rig| self.settled(rig, frame, &finder).ok());
            again.ok_or(status)
        })
    }

    /// The eye of the rig to which holder and paper lead from one that is nearly right.
    fn settled(&self, mut rig: Rig, frame: &Frame, finder: &EdgeFinder) -> Result<Self, Status> {
        const ROUNDS: usize = 5;
        const SETTLED_PX: f64 = 0.03;
        for _ in 0..ROUNDS {
            let view = Projection { lens: &self.lens, camera_from_base: rig.camera_from_base, robot: &self.robot };
            let watch = Watch::new(&self.lens, &rig, &view);
            let motion = watch.camera_motion(frame, finder, &view).ok_or(Status::GridLost)?;
            rig = moved(&rig, &motion.by);
            rig.pose_covariance = self.still_covariance
                + motion.covariance
                + Matrix6::from_diagonal(&Vector6::from(UNKNOWN).map(|s| s * s));
            if motion.px < SETTLED_PX {
                break;
            }
        }
        let eye = self.with_rig(rig);
        let watched: Watched = eye.watch.look(frame, finder);
        match watched.status() {
            Some(Status::CameraMoved) => Err(Status::GridLost),
            Some(other) => Err(other),
            None if watched.grid.is_none() || watched.base.is_none() => Err(Status::GridLost),
            None => Ok(eye),
        }
    }

    /// A rig that is nearly right, from the holder and the grid as a first picture would tell them.
    fn found_again(&self, frame: &Frame) -> Option<Rig> {
        let Self { lens, rig, robot, .. } = self;
        let diameter_mm = robot.body.disk_diameter_mm;
        let grid_from_base = rig.camera_from_grid.inverse() * rig.camera_from_base;
        let base_mm = grid_from_base.translation.vector;
        let looks = Colours::of(frame);
        let holders = looks.iter().flat_map(|colours| {
            locate_holders(frame, colours).unwrap_or_default().into_iter().map(move |holder| (colours, holder))
        });
        for (colours, holder) in holders {
            let depth_mm = (rig.camera_from_grid * Point3::origin()).z;
            let pitch_px = lens.focal_px.x * rig.grid_pitch_mm / depth_mm;
            let across = Vector2::new(-holder.axis.y, holder.axis.x);
            let corridor = |p: &Point2<f64>| across.dot(&(p - holder.root)).abs() < 1.1 * holder.width_px;
            let range = 0.75 * pitch_px..=1.33 * pitch_px;
            let Ok(grid) = find_grid(frame, lens, rig.grid_pitch_mm, range, holder.axis, corridor) else { continue };
            let distance_mm = grid.distance_mm(&lens.ray(&holder.root)) + base_mm.z;
            let Ok(start) = find_start(colours, &holder, lens.focal_px.x * diameter_mm / distance_mm) else {
                continue;
            };
            // Where the base would be on the lattice as it was found now: the base's height over the paper is known.
            let grid_from_camera = grid.camera_from_grid.inverse();
            let eye = grid_from_camera * Point3::origin();
            let ray = grid_from_camera * lens.ray(&start.base);
            let at = eye + ray * ((base_mm.z - eye.z) / ray.z);
            let lines = (at.coords - base_mm).xy() / rig.grid_pitch_mm;
            let slide = lines.map(|v| v.round() * rig.grid_pitch_mm);
            let camera_from_grid = grid.camera_from_grid * Translation3::new(slide.x, slide.y, 0.0);
            return Some(Rig { camera_from_grid, camera_from_base: camera_from_grid * grid_from_base, ..rig.clone() });
        }
        None
    }

    /// The same eye with another rig, near enough for the coarse search to serve or with a new one.
    fn with_rig(&self, rig: Rig) -> Self {
        const FAR_PX: f64 = 4.0;
        let pixel = |pose: &Pose, along_mm: f64| self.lens.project(&(pose * Point3::new(0.0, 0.0, along_mm)));
        let shift_px = |along_mm| (pixel(&rig.camera_from_base, along_mm) - pixel(&self.search_pose, along_mm)).norm();
        let far = shift_px(0.0).max(shift_px(self.robot.length_mm)) > FAR_PX;
        let view = Projection { lens: &self.lens, camera_from_base: rig.camera_from_base, robot: &self.robot };
        let watch = Arc::new(Watch::new(&self.lens, &rig, &view));
        let mut eye = Self { rig, watch, ..self.clone() };
        if far {
            eye.search_pose = eye.rig.camera_from_base;
            eye.search = Arc::new(CoarseSearch::new(&eye.lens, eye.search_pose, &eye.robot));
        }
        eye
    }
}

/// A rig whose camera moved: turned about the base's origin and shifted (see [`nudged`]).
fn moved(rig: &Rig, by: &Vector6<f64>) -> Rig {
    let camera_from_base = nudged(&rig.camera_from_base, &DVector::from_column_slice(by.as_slice()));
    let grid_from_base = rig.camera_from_grid.inverse() * rig.camera_from_base;
    Rig { camera_from_grid: camera_from_base * grid_from_base.inverse(), camera_from_base, ..rig.clone() }
}
