//! The rig: where camera, grid target and snake are, and what the snake looks like. Data only.

use crate::geometry::Pose;
use crate::measure::fit::{
    CONTRADICTION_OF_KNOWN_CHI2, CONTRADICTION_OF_UNKNOWN_CHI2, EdgeBias, FramePrior, UNKNOWN_SHAPE_RAD, noise_model,
};
use crate::measure::image::appearance::Appearance;
use crate::measure::target::{GridPattern, PrintProfile, Sheet, SheetShape};
use crate::robot::MODES;
use nalgebra::{Matrix6, UnitQuaternion, Vector3};

/// A calibrated view: everything that does not change from frame to frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Rig {
    /// The camera's pose to the snake's base.
    pub camera_from_base: Pose,
    /// Covariance of that pose: a small turn about the base's origin (rad) and a shift (mm), both along the camera's axes.
    pub pose_covariance: Matrix6<f64>,
    /// The camera's pose to the grid.
    pub camera_from_grid: Pose,
    /// How the printed sheet departs from a flat and square one.
    pub sheet_shape: SheetShape,
    /// Pitch of the grid's lines, mm: the mean of both directions.
    pub grid_pitch_mm: f64,
    /// What is printed on the grid target.
    pub pattern: GridPattern,
    /// What tells snake from grid target.
    pub appearance: Appearance,
    /// How the sheet looks in that channel; `None` where the eye does not look through its lines.
    pub print: Option<PrintProfile>,
    /// How far outside the snake's true border its edges are seen.
    pub edge_bias: EdgeBias,
    /// Standard deviation of either component of each mode of the snake's [`BendProfile`](crate::robot::BendProfile), rad: what is
    /// known of how far this snake departs from an arc.
    pub mode_sigma_rad: [f64; MODES],
    /// Scatter of the grid about its pose, px.
    pub grid_rms_px: f64,
    /// Scatter of the straight snake's edges about the model, px.
    pub edge_rms_px: f64,
}

/// What is known about a rig before it is calibrated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigOptions {
    /// Pitch of the grid's finest lines (or side of a checkerboard's squares), mm.
    pub grid_pitch_mm: f64,
    /// Distance from the snake's axis back to the grid plane, mm.
    pub standoff_mm: f64,
    /// Azimuth in {b} of the direction that points to this view's image right, rad.
    pub delta_offset: f64,
}

impl Rig {
    /// The rig of a view that looks from elsewhere: `self` was calibrated as if image right were the base's x,
    /// `delta_offset` (rad) is the azimuth in {b} that it is.
    #[must_use]
    pub fn looking_from(mut self, delta_offset: f64) -> Self {
        self.camera_from_base.rotation *= azimuth(delta_offset);
        self
    }

    /// The grid target's sheet.
    pub(crate) fn sheet(&self) -> Sheet {
        Sheet { camera_from_grid: self.camera_from_grid, shape: self.sheet_shape }
    }

    /// Whether the frames of a sequence told how far this snake departs from an arc.
    pub(crate) fn is_shape_known(&self) -> bool {
        // Degrees in rig.toml round the last digit.
        let differs = |(sigma, unknown): (&f64, &f64)| (sigma - unknown).abs() > 1e-9 * unknown;
        self.mode_sigma_rad.iter().zip(&UNKNOWN_SHAPE_RAD).any(differs)
    }

    /// What is known of a frame's state before it is looked at.
    pub(crate) fn prior(&self) -> FramePrior {
        let contradiction_chi2 =
            if self.is_shape_known() { CONTRADICTION_OF_KNOWN_CHI2 } else { CONTRADICTION_OF_UNKNOWN_CHI2 };
        FramePrior {
            mode_sigma_rad: self.mode_sigma_rad,
            contradiction_chi2,
            bias: self.edge_bias,
            bias_sigma: noise_model().frame_bias_sigma(),
        }
    }

    /// Distance from the snake's base back to the grid target, mm.
    pub(crate) fn standoff_mm(&self) -> f64 {
        let normal = self.camera_from_grid * Vector3::z();
        normal.dot(&(self.camera_from_grid.translation.vector - self.camera_from_base.translation.vector))
    }
}

/// The base's axes in those of a view whose image right is at this azimuth of the base, rad.
pub(super) fn azimuth(delta_offset: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -delta_offset)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use nalgebra::Translation3;
    use std::f64::consts::FRAC_PI_2;

    /// A rig 230 mm from the camera, 25 mm before its target, tilted a little.
    pub fn rig() -> Rig {
        let camera_from_grid = Pose::new(Vector3::new(0.0, 0.0, 255.0), Vector3::new(0.02, 0.01, 0.03));
        // The base's z is the grid's −y, its y the grid's z.
        let upright = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), FRAC_PI_2);
        let grid_from_base = Pose::from_parts(Translation3::new(1.0, 2.0, -25.0), upright);
        Rig {
            camera_from_base: camera_from_grid * grid_from_base,
            pose_covariance: Matrix6::from_diagonal_element(1e-6),
            camera_from_grid,
            sheet_shape: SheetShape::default(),
            grid_pitch_mm: 1.0,
            pattern: GridPattern::default(),
            appearance: Appearance { weights: vec![-1.0, 0.5, -2.0], offset: 1.25, two_sided: false, light: None },
            print: None,
            edge_bias: EdgeBias { side_px: -0.05, tube_px: 0.2, rim_px: 0.01, glare: [0.3, 0.2] },
            mode_sigma_rad: [1e-3, 2e-4, 1e-4],
            grid_rms_px: 0.1,
            edge_rms_px: 0.12,
        }
    }

    #[test]
    fn the_standoff_is_the_distance_along_the_grids_normal() {
        assert_relative_eq!(rig().standoff_mm(), 25.0, epsilon = 1e-12);
    }

    #[test]
    fn a_view_from_the_side_sees_the_azimuth_that_it_was_told_to_its_right() {
        let seen = rig().looking_from(0.3);
        let image_right = rig().camera_from_base.rotation * Vector3::x();
        let azimuth = seen.camera_from_base.rotation.inverse() * image_right;
        assert_relative_eq!(azimuth.y.atan2(azimuth.x), 0.3, epsilon = 1e-12);
        assert_eq!(seen.camera_from_base.translation, rig().camera_from_base.translation);
    }
}
