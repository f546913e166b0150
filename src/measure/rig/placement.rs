//! Where the snake's base stands before the grid target: five numbers, and the poses and covariances that follow from them.

use super::parameters::{RigOptions, azimuth};
use crate::camera::Lens;
use crate::geometry::Pose;
use crate::measure::target::Grid;
use crate::statistics::least_squares::central_differences;
use nalgebra::{
    DMatrix, DVector, Matrix3, Matrix6, Point2, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3,
};

/// How many numbers a placement has.
///
/// Derived: two of the place, the turn, the height and the tilt.
pub const PLACEMENT: usize = 5;
/// Which of them is the height above the stated standoff.
///
/// Convention: the order in which they are written.
pub const HEIGHT: usize = 3;
/// Which of them is the tilt.
///
/// Convention: the order in which they are written.
pub const TILT: usize = 4;
/// The distance along the snake at which its direction is carried onto its plane, px.
///
/// Convention: about a snake's length.
const AHEAD_PX: f64 = 300.0;
/// Steps of central differences of its numbers.
///
/// Convention: far below what edges tell, far above rounding.
const STEP: f64 = 1e-5;

/// The base's place before the target: x, y (mm, grid frame), turn γ in the target's plane (rad), height above the stated standoff
/// (mm), tilt out of that plane (rad).
#[derive(Debug, Clone, PartialEq)]
pub struct Placement(pub DVector<f64>);

impl Placement {
    /// The base's place and direction in the picture, carried onto the plane a standoff before the target; `None` where that
    /// plane is behind the camera.
    pub fn from_picture(
        lens: &Lens,
        options: &RigOptions,
        grid: &Grid,
        base: &Point2<f64>,
        axis: Vector2<f64>,
    ) -> Option<Self> {
        let grid_from_camera = grid.sheet.camera_from_grid.inverse();
        let eye = grid_from_camera * Point3::origin();
        let on_plane = |pixel: &Point2<f64>| -> Option<Point3<f64>> {
            let ray = grid_from_camera * lens.ray(pixel);
            let distance = (-options.standoff_mm - eye.z) / ray.z;
            (distance > 0.0).then(|| eye + ray * distance)
        };
        let (base, tip) = on_plane(base).zip(on_plane(&(base + axis * AHEAD_PX)))?;
        let up = (tip - base).xy().normalize();
        // At γ = 0 the snake points along the grid's −y.
        let gamma = up.x.atan2(-up.y);
        Some(Self(DVector::from_column_slice(&[base.x, base.y, gamma, 0.0, 0.0])))
    }

    /// How far the base is above the stated standoff, mm.
    pub fn height_mm(&self) -> f64 {
        self.0[HEIGHT]
    }

    /// How far the snake is from parallel to the target, rad.
    pub fn tilt(&self) -> f64 {
        self.0[TILT]
    }

    /// The base's axes in the grid frame when nothing is turned: x right, y away, z up (the grid's −y).
    fn upright() -> Rotation3<f64> {
        Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[Vector3::x(), Vector3::z(), -Vector3::y()]))
    }

    /// The base's pose in the grid frame.
    pub fn grid_from_base(&self, options: &RigOptions) -> Pose {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.0[2]);
        let tilt = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), self.tilt());
        let upright = UnitQuaternion::from_rotation_matrix(&Self::upright());
        let place = Translation3::new(self.0[0], self.0[1], self.height_mm() - options.standoff_mm);
        Pose::from_parts(place, turn * upright * tilt * azimuth(options.delta_offset))
    }

    /// The camera's pose to the base.
    pub fn camera_from_base(&self, options: &RigOptions, grid: &Grid) -> Pose {
        grid.sheet.camera_from_grid * self.grid_from_base(options)
    }

    /// How the camera's pose moves (rows, in the terms of [`perturbed`](crate::geometry::perturbed)) with each number.
    pub fn motions(&self, options: &RigOptions, grid: &Grid) -> DMatrix<f64> {
        let centre = self.camera_from_base(options, grid);
        let motion = |x: &DVector<f64>| {
            let moved = Self(x.clone()).camera_from_base(options, grid);
            let turn = (moved.rotation * centre.rotation.inverse()).scaled_axis();
            let shift = moved.translation.vector - centre.translation.vector;
            DVector::from_iterator(6, turn.iter().chain(shift.iter()).copied())
        };
        central_differences(motion, &self.0, &DVector::from_element(PLACEMENT, STEP))
    }

    /// The covariance of a placement as one of the camera's pose, in the terms of [`perturbed`](crate::geometry::perturbed).
    pub fn pose_covariance(&self, covariance: &DMatrix<f64>, options: &RigOptions, grid: &Grid) -> Matrix6<f64> {
        let jacobian = self.motions(options, grid);
        let placed = covariance.view((0, 0), (PLACEMENT, PLACEMENT));
        let motions = &jacobian * placed * jacobian.transpose();
        // The base is turned about its own axis as the grid is; the grid's own error adds to that of the placement on it.
        let from_grid = |r: usize, c: usize| if r < 3 && c < 3 { grid.turn_covariance[(r, c)] } else { 0.0 };
        Matrix6::from_fn(|r, c| motions[(r, c)] + from_grid(r, c))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::target::{PatternKind, Sheet};
    use crate::simulate::scene::Scene;
    use approx::assert_relative_eq;

    const OPTIONS: RigOptions = RigOptions { grid_pitch_mm: 1.0, standoff_mm: 25.0, delta_offset: 0.0 };

    fn grid() -> Grid {
        Grid {
            kind: PatternKind::Lines,
            sheet: Sheet::flat(Pose::new(Vector3::new(3.0, -2.0, 260.0), Vector3::new(0.05, -0.04, 0.1))),
            turn_covariance: Matrix3::from_diagonal(&Vector3::new(1e-6, 2e-6, 3e-6)),
            rms_px: 0.1,
            waves_mm: 0.0,
        }
    }

    #[test]
    fn the_base_frame_is_that_of_the_conventions() {
        let straight = Placement(DVector::zeros(PLACEMENT)).grid_from_base(&OPTIONS);
        // z_b up (the grid's y is down), y_b from the camera towards the grid, x_b to the image's right; 25 mm before the grid.
        assert_relative_eq!(straight * Vector3::z(), -Vector3::y(), epsilon = 1e-12);
        assert_relative_eq!(straight * Vector3::y(), Vector3::z(), epsilon = 1e-12);
        assert_relative_eq!(straight * Vector3::x(), Vector3::x(), epsilon = 1e-12);
        assert_relative_eq!(straight.translation.vector, Vector3::new(0.0, 0.0, -25.0));
    }

    #[test]
    fn a_placement_is_found_again_from_where_it_is_seen() {
        let lens = Scene::default().lens;
        let truth = Placement(DVector::from_column_slice(&[2.0, 3.0, 0.2, 0.0, 0.0]));
        let pose = truth.camera_from_base(&OPTIONS, &grid());
        let base = lens.project(&(pose * Point3::origin()));
        let tip = lens.project(&(pose * Point3::new(0.0, 0.0, 20.0)));
        let found = Placement::from_picture(&lens, &OPTIONS, &grid(), &base, (tip - base).normalize()).unwrap();
        // The lens bends the snake's line a little.
        assert!((&found.0 - &truth.0).amax() < 2e-3, "{:?}", found.0);
        let behind = RigOptions { standoff_mm: 300.0, ..OPTIONS };
        assert_eq!(Placement::from_picture(&lens, &behind, &grid(), &base, Vector2::x()), None);
    }

    #[test]
    fn the_pose_covariance_is_that_of_moved_placements() {
        let placement = Placement(DVector::from_column_slice(&[2.0, 3.0, 0.2, 0.1, 0.01]));
        let grid = Grid { turn_covariance: Matrix3::zeros(), ..grid() };
        // A turn γ alone turns the camera's pose about the target's normal, by its size.
        let mut covariance = DMatrix::zeros(PLACEMENT, PLACEMENT);
        covariance[(2, 2)] = 4e-6;
        let pose_covariance = placement.pose_covariance(&covariance, &OPTIONS, &grid);
        let normal = grid.sheet.camera_from_grid.rotation * Vector3::z();
        let expected = normal * normal.transpose() * 4e-6;
        assert_relative_eq!(pose_covariance.fixed_view::<3, 3>(0, 0).into_owned(), expected, epsilon = 1e-12);
        assert!(pose_covariance.fixed_view::<3, 3>(3, 3).norm() < 1e-12);
    }
}
