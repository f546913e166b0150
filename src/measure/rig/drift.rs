//! Whether the camera, the snake's base and the grid target are still where the rig says.
//!
//! Two things in a frame do not bend: the holder below the base, and the target. The holder's edges are looked for where the
//! rig puts them; the target is asked for the phases of its waves in a few windows. A shift by a whole number of pitches leaves the phases as
//! they were, but not the holder.

use super::base_monitor::{BaseMonitor, BaseShift, HolderEdge, LIGHT_SIGMA_PX, SHADED_PX};
use super::parameters::Rig;
use crate::camera::{Frame, Lens};
use crate::measure::body::Projection;
use crate::measure::fit::{EdgeFinder, noise_model};
use crate::measure::target::{DETECTION_SIGMAS, GridPhaseMonitor, GridShift, PHASE_SIGMA_PX, RobustLinear};
use crate::observation::Status;
use nalgebra::{DMatrix, DVector, Matrix6, Vector3, Vector6};

/// What moved by less than this, px, or by less than so many of its sigmas, need not be followed.
///
/// Convention: a tenth of a pixel changes the angles by less than their sigmas; 3 σ are exceeded in 3 of 1000 frames, which are then followed
/// for nothing.
const STILL_PX: f64 = 0.1;
const STILL_SIGMAS: f64 = 3.0;
/// What may be known of the camera's motion beforehand: turns (rad) and shifts (mm), 1σ.
///
/// Convention: weak; wider than what holder and target can tell, so that directions that they leave open stay finite.
const MOTION_SD: [f64; 6] = [0.2, 0.2, 0.2, 20.0, 20.0, 50.0];
/// Least share of phases and edges that must agree on the camera's motion.
///
/// Convention: a majority.
const LEAST_AGREEING: f64 = 0.5;

/// How far holder and target are from where the rig says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriftCheck {
    /// The holder's shift; `None` where too little of it is seen.
    pub base: Option<BaseShift>,
    /// The target's shift, up to whole pitches; `None` where its pattern is not seen.
    pub grid: Option<GridShift>,
}

/// How the camera moved.
#[derive(Debug, Clone, Copy)]
pub struct CameraMotion {
    /// See [`perturbed`](crate::geometry::perturbed): about the base's origin.
    pub by: Vector6<f64>,
    /// Its covariance.
    pub covariance: Matrix6<f64>,
    /// The same as a shift of the target in the picture, px (rms over the windows).
    pub px: f64,
}

/// Checks every frame for drift; made ready once for a rig.
#[derive(Debug)]
pub struct RigDriftMonitor {
    base: BaseMonitor,
    grid: Option<GridPhaseMonitor>,
}

impl RigDriftMonitor {
    pub fn new(lens: &Lens, rig: &Rig, view: &Projection) -> Self {
        let grid = GridPhaseMonitor::new(lens, &rig.sheet(), rig.standoff_mm(), rig.grid_pitch_mm, &rig.pattern);
        Self { base: BaseMonitor::new(view, &rig.pose_covariance, rig.edge_bias), grid }
    }

    /// Looks at holder and target in one frame, whose edges the finder finds.
    pub fn check(&self, frame: &Frame, finder: &EdgeFinder) -> DriftCheck {
        DriftCheck {
            base: self.base.shift(finder),
            grid: self.grid.as_ref().and_then(|grid| grid.shift(&grid.phases(frame), &self.base.middle)),
        }
    }

    /// How the camera moved against holder and target, which did not move against each other; `None` where they do not tell.
    pub fn camera_motion(&self, frame: &Frame, finder: &EdgeFinder, view: &Projection) -> Option<CameraMotion> {
        let grid = self.grid.as_ref()?;
        let base = self.base.shift(finder);
        let edges = base.map(|base| self.base.edges(finder, &base.by)).unwrap_or_default();
        let pose = view.camera_from_base;
        let by_camera = grid.by_camera(&pose.translation.vector);
        let phases = grid.phases(frame);
        // The holder tells which of the waves a phase belongs to; without it the nearest has to do.
        let expected_px = match base {
            Some(base) => {
                let mm_per_px = pose.translation.vector.z / view.lens.focal_px.x;
                let (x, y) = (base.by.x * mm_per_px, base.by.y * mm_per_px);
                &by_camera * DVector::from_column_slice(&[0.0, 0.0, base.by.z / BaseShift::ARM_PX, x, y, 0.0])
            }
            None => grid.expected_px(&phases),
        };
        let seen_px = grid.seen_px(&phases, &expected_px);
        let (design, seen) = rows(&by_camera, &seen_px, &edges, view);
        let mut prior = MOTION_SD.to_vec();
        prior.extend([LIGHT_SIGMA_PX; 2]);
        let found = RobustLinear::fit(&design, &seen, &prior, true)?;
        let by = found.parameters.fixed_rows::<6>(0).into_owned();
        let px = (&by_camera * by).norm() / (seen_px.len() as f64).sqrt();
        let covariance = found.covariance.fixed_view::<6, 6>(0, 0) * noise_model().design_effect;
        let agrees = found.agreeing as f64 > LEAST_AGREEING * seen.len() as f64;
        agrees.then_some(CameraMotion { by, covariance, px })
    }
}

/// Phases and edges in units of their σ, and what the camera's motion and the light at the holder's sides and rim do to them.
fn rows(
    by_camera: &DMatrix<f64>,
    seen_px: &DVector<f64>,
    edges: &[HolderEdge],
    view: &Projection,
) -> (DMatrix<f64>, DVector<f64>) {
    let phases = seen_px.len();
    let mut design = DMatrix::zeros(phases + edges.len(), 8);
    design.view_mut((0, 0), (phases, 6)).copy_from(&(by_camera / PHASE_SIGMA_PX));
    let mut seen = (seen_px / PHASE_SIGMA_PX).insert_rows(phases, edges.len(), 0.0);
    for (row, edge) in (phases..).zip(edges) {
        let slopes = edge.by_camera(view);
        (0..6).for_each(|axis| design[(row, axis)] = slopes[axis] / edge.sigma_px);
        design[(row, if edge.is_side { 6 } else { 7 })] = 1.0 / edge.sigma_px;
        seen[row] = edge.distance_px / edge.sigma_px;
    }
    (design, seen)
}

impl DriftCheck {
    /// Whether nothing moved by more than a frame's angles feel.
    pub fn is_still(&self) -> bool {
        let base = |base: BaseShift| {
            base.by.norm() < STILL_PX || base.distance2(&Vector3::zeros()) < STILL_SIGMAS * STILL_SIGMAS
        };
        let grid = |grid: GridShift| grid.px < STILL_PX.max(STILL_SIGMAS * grid.sigma_px);
        self.base.is_none_or(base) && self.grid.is_some_and(grid)
    }

    /// Why angles of this frame would be wrong, if they would.
    ///
    /// A holder that is elsewhere means that camera or base moved: the camera, if the target is elsewhere too. Where the holder went with the target, both
    /// together tell it. A target that only slid in its own plane, behind a holder that did not go with it, changes no angle.
    pub fn status(&self) -> Option<Status> {
        let is_sure = |departure2: f64| departure2 > DETECTION_SIGMAS.powi(2);
        let went_together = self.base.zip(self.grid).is_some_and(|(base, grid)| {
            base.went_with(&grid) && is_sure(base.departure2() + grid.departure2_at_base(SHADED_PX))
        });
        let is_elsewhere = self.base.is_some_and(|base| is_sure(base.departure2()));
        let slid = self.grid.filter(|grid| is_sure((grid.px / grid.sigma_px.hypot(SHADED_PX)).powi(2)));
        if is_elsewhere && !went_together && self.grid.is_some() && slid.is_none() {
            return Some(Status::BaseMoved);
        }
        let turned = slid.is_some_and(|grid| self.base.is_none() || grid.may_be_a_turn);
        let leans = self.grid.is_some_and(|grid| grid.out_of_plane > 1.0);
        (went_together || is_elsewhere || turned || leans).then_some(Status::CameraMoved)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use nalgebra::{Matrix2, Matrix3, Vector2};

    fn base(x: f64, y: f64) -> Option<BaseShift> {
        Some(BaseShift { by: Vector3::new(x, y, 0.0), covariance: Matrix3::identity() * 0.01 })
    }

    fn grid(px: f64, at_base: [f64; 2], may_be_a_turn: bool) -> Option<GridShift> {
        let at_base = Vector2::from(at_base);
        let (at_base_covariance, camera_from_grid) = (Matrix2::identity() * 0.0025, Pose::identity());
        Some(GridShift {
            px,
            sigma_px: 0.05,
            at_base,
            at_base_covariance,
            out_of_plane: 0.2,
            may_be_a_turn,
            camera_from_grid,
        })
    }

    #[test]
    fn what_moved_is_told_from_what_was_seen_to_move() {
        let cases = [
            ("nothing", base(0.05, 0.0), grid(0.05, [0.05, 0.0], true), None),
            ("the base", base(3.0, 0.0), grid(0.05, [0.0, 0.0], true), Some(Status::BaseMoved)),
            ("the camera", base(3.0, 1.0), grid(3.0, [3.0, 1.0], false), Some(Status::CameraMoved)),
            ("the camera, by whole pitches", base(17.0, 0.0), grid(0.02, [0.0, 0.0], true), Some(Status::BaseMoved)),
            ("the target, in its plane", base(0.05, 0.0), grid(5.0, [5.0, 0.0], false), None),
            ("the camera about the base", base(0.0, 0.0), grid(5.0, [5.0, 0.0], true), Some(Status::CameraMoved)),
            ("something, the holder hidden", None, grid(5.0, [5.0, 0.0], false), Some(Status::CameraMoved)),
            ("the base, the target hidden", base(3.0, 0.0), None, Some(Status::CameraMoved)),
            ("nothing, the target hidden", base(0.05, 0.0), None, None),
        ];
        for (moved, base, grid, expected) in cases {
            assert_eq!(DriftCheck { base, grid }.status(), expected, "{moved}");
        }
        let leaning = grid(0.1, [0.0, 0.0], true).map(|grid| GridShift { out_of_plane: 1.5, ..grid });
        assert_eq!(DriftCheck { base: base(0.0, 0.0), grid: leaning }.status(), Some(Status::CameraMoved));
    }

    #[test]
    fn a_rig_is_followed_from_a_tenth_of_a_pixel_on_that_is_sure() {
        let check =
            |base_px: f64, grid_px: f64| DriftCheck { base: base(base_px, 0.0), grid: grid(grid_px, [0.0, 0.0], true) };
        assert!(check(0.0, 0.0).is_still() && check(0.29, 0.14).is_still());
        assert!(!check(0.31, 0.0).is_still() && !check(0.0, 0.16).is_still());
        assert!(!DriftCheck { base: base(0.0, 0.0), grid: None }.is_still());
    }
}
