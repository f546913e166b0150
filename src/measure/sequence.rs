//! An eye over a sequence of frames: its rig refined from them, or followed from one to the next.

use crate::camera::Frame;
use crate::geometry::Pose;
use crate::measure::eye::{Eye, MeasurementStages};
use crate::measure::fit::{EdgeFinder, Start};
use crate::measure::image::exposure::is_saturated;
use crate::measure::rig::{Followed, Rig, RigDriftMonitor, RigFollower, SnakePlane, refined_rig};
use crate::observation::Status;
use nalgebra::Point3;
use rayon::prelude::*;
use std::sync::Arc;

/// Where the snake's ends are seen further than this, px, from where the coarse search was made for, it is made anew.
///
/// Convention: a pixel or two of the search's small picture.
const SEARCH_OFF_PX: f64 = 4.0;
/// How much of a picture is kept around the snake for the refinement of the rig, px.
///
/// Derived: from the outline edges are searched up to 3 px away and examined 5 px further, the filters reach up to 9 px, and the outline
/// moves by a pixel or two while the rig does.
const REFINING_REACH_PX: f64 = 20.0;

impl Eye {
    /// This eye with its rig refined from frames of a sequence: the errors of pose and bias are then what the frames
    /// leave, not what the straight picture did. Frames that cannot be measured are passed over; where fewer than three
    /// can, the eye stays as it is.
    pub fn refined(self, frames: impl ParallelIterator<Item = Frame>) -> Self {
        let find = |frame: Frame| {
            let exposed = self.exposed(&frame);
            let MeasurementStages { measurement, fits, .. } = self.measure_in_stages(&exposed, None);
            // What shape a snake has that is no arc is told by its frames together, where none tells it alone.
            let is_seen = matches!(measurement.status, Status::Ok | Status::UnknownShape);
            let fit = fits.first().filter(|_| is_seen)?;
            let surroundings = self.projection().image_region(fit.profile, REFINING_REACH_PX);
            Some((SnakePlane { plane: self.plane(&exposed, &surroundings), noise: exposed.noise }, fit.start()))
        };
        // Before frames are measured in parallel, of which each would make its own.
        self.prepare();
        let (planes, starts): (Vec<SnakePlane>, Vec<Start>) = frames.filter_map(find).unzip();
        match refined_rig(&self.lens, &self.robot, &self.rig, &planes, starts) {
            // The sheet stayed where it is.
            Some(rig) => Self { sheet: self.sheet.clone(), ..Self::new(self.lens.clone(), rig, self.robot.clone()) }
                .with_search_of(&self),
            None => self,
        }
    }

    /// This eye where the camera of a frame is. A grid target that slid behind a snake that stayed is followed, too.
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
        let calibrated_covariance = &self.calibrated_covariance;
        let follower = RigFollower { lens: &self.lens, robot: &self.robot, calibrated_covariance };
        Ok(match follower.follow(&self.rig, &self.drift_monitor, frame, &finder)? {
            Followed::Still => self.clone(),
            Followed::Moved(moved) => self.with_rig(moved.0, moved.1),
        })
    }

    /// The same eye with another rig.
    fn with_rig(&self, rig: Rig, drift_monitor: RigDriftMonitor) -> Self {
        let search_pose = rig.camera_from_base;
        let eye = Self {
            rig,
            drift_monitor: Arc::new(drift_monitor),
            search: Arc::default(),
            sheet: Arc::default(),
            search_pose,
            ..self.clone()
        };
        eye.with_search_of(self)
    }

    /// This eye with the coarse search of another one, where both see the snake's ends nearly at the same places.
    fn with_search_of(self, other: &Self) -> Self {
        let pixel = |pose: &Pose, along_mm: f64| self.lens.project(&(pose * Point3::new(0.0, 0.0, along_mm)));
        let shift_px = |along_mm| (pixel(&self.search_pose, along_mm) - pixel(&other.search_pose, along_mm)).norm();
        let is_near = shift_px(0.0).max(shift_px(self.robot.length_mm)) <= SEARCH_OFF_PX;
        if is_near { Self { search: other.search.clone(), search_pose: other.search_pose, ..self } } else { self }
    }
}
