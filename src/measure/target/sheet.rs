//! The printed sheet as it lies: its pose, and how it departs from a flat and square one.
//!
//! A printer stretches one direction, a copier shears, and paper bows. A place of the sheet has lattice coordinates, in mm of the stated
//! pitch: where it would be on a perfect print. With a, b the lattice coordinates from the middle of the sheet that is seen, in units of
//! half its extent, the place lies in the grid frame at
//!
//! ```text
//! x = x₀ + (1 + α/2) Δu + (γ/2) Δv ,      y = y₀ + (γ/2) Δu + (1 − α/2) Δv ,
//! z = c₀ P₂(a) + c₁ a b + c₂ P₂(b) ,      P₂(t) = (3 t² − 1)/2 ,
//! ```
//!
//! with the anisotropy α, the shear γ (by which the lines' angle differs from 90°) and the bow c. Over the rectangle that is seen these three
//! terms are orthogonal to a plane, so that the grid frame's plane z = 0 is the mean plane of the visible sheet, and the stated pitch the
//! mean of both directions.

use crate::camera::Lens;
use crate::geometry::Pose;
use nalgebra::{Matrix2, Matrix2x3, Matrix3, Point2, Point3, SMatrix, Translation3, Vector2, Vector3};

/// Rounds in which the place that a line of sight meets is moved onto the bowed surface.
///
/// Convention: each round leaves the surface's slope times the line of sight's, below a hundredth, of the distance to go.
const SURFACE_ROUNDS: usize = 4;

/// How a printed sheet departs from a flat and square one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SheetShape {
    /// The pitch across less the pitch along, as a share of their mean: α.
    pub anisotropy: f64,
    /// By how much the angle between the lines differs from 90°, rad: γ.
    pub shear: f64,
    /// The bow, mm: c₀ across, c₁ twisted, c₂ along.
    pub bow_mm: [f64; 3],
    /// The middle of the sheet that is seen, in lattice coordinates, mm.
    pub centre_mm: Point2<f64>,
    /// Half the extent of the sheet that is seen, mm.
    pub half_mm: Vector2<f64>,
}

impl Default for SheetShape {
    /// Flat and square.
    fn default() -> Self {
        let half_mm = Vector2::new(1.0, 1.0);
        Self { anisotropy: 0.0, shear: 0.0, bow_mm: [0.0; 3], centre_mm: Point2::origin(), half_mm }
    }
}

impl SheetShape {
    /// How many numbers describe it. Derived: the difference of the pitches, the shear, and three of the bow.
    pub(super) const NUMBERS: usize = 5;
    /// How far the sheet may go on beyond the middles of the outermost windows that saw it, in units of half its extent.
    ///
    /// Derived: a window reaches five pitches further, and a small sheet shows forty of them.
    pub(super) const BEYOND: f64 = 1.25;

    /// α, γ and the bow.
    pub(super) fn to_array(self) -> [f64; Self::NUMBERS] {
        let [across, twist, along] = self.bow_mm;
        [self.anisotropy, self.shear, across, twist, along]
    }

    /// The same sheet with other α, γ and bow.
    pub(super) fn with(self, [anisotropy, shear, across, twist, along]: [f64; Self::NUMBERS]) -> Self {
        Self { anisotropy, shear, bow_mm: [across, twist, along], ..self }
    }

    /// The stretch of the printed plane.
    fn stretch(&self) -> Matrix2<f64> {
        let (half, shear) = (self.anisotropy / 2.0, self.shear / 2.0);
        Matrix2::new(1.0 + half, shear, shear, 1.0 - half)
    }

    /// How far the surface is behind the mean plane at a lattice place, mm.
    pub fn height_mm(&self, lattice_mm: &Point2<f64>) -> f64 {
        let [across, twist, along] = self.bow_mm;
        let at = (lattice_mm - self.centre_mm).component_div(&self.half_mm);
        across * legendre(at.x) + twist * at.x * at.y + along * legendre(at.y)
    }

    /// The root mean square of the surface about its mean plane over the sheet that is seen, mm: of P₂ it is 1/√5, of a b 1/3.
    pub fn rms_mm(&self) -> f64 {
        let [across, twist, along] = self.bow_mm;
        ((across * across + along * along) / 5.0 + twist * twist / 9.0).sqrt()
    }

    /// Covariance of the surface's slopes (∂z/∂x, ∂z/∂y) where the middle is known only to this standard deviation, in units of half the
    /// extent: what the bow turns the mean plane by if more of the sheet, or less, were seen.
    pub fn slope_covariance(&self, middle_sd: f64) -> Matrix2<f64> {
        let [across, twist, along] = self.bow_mm;
        let scale = Matrix2::from_diagonal(&self.half_mm.map(|half| 1.0 / half));
        let by_middle = scale * Matrix2::new(3.0 * across, twist, twist, 3.0 * along);
        by_middle * by_middle.transpose() * middle_sd.powi(2)
    }

    /// The place of the grid frame at lattice coordinates, mm.
    fn place(&self, lattice_mm: &Point2<f64>) -> Point3<f64> {
        let flat = self.centre_mm + self.stretch() * (lattice_mm - self.centre_mm);
        Point3::new(flat.x, flat.y, self.height_mm(lattice_mm))
    }

    /// How the place moves with α, γ and the bow (columns), mm per unit.
    fn place_by_shape(&self, lattice_mm: &Point2<f64>) -> SMatrix<f64, 3, { Self::NUMBERS }> {
        let off = (lattice_mm - self.centre_mm) / 2.0;
        let at = (lattice_mm - self.centre_mm).component_div(&self.half_mm);
        SMatrix::from_columns(&[
            Vector3::new(off.x, -off.y, 0.0),
            Vector3::new(off.y, off.x, 0.0),
            Vector3::new(0.0, 0.0, legendre(at.x)),
            Vector3::new(0.0, 0.0, at.x * at.y),
            Vector3::new(0.0, 0.0, legendre(at.y)),
        ])
    }

    /// The lattice coordinates of a place of the mean plane.
    fn lattice(&self, flat_mm: &Point2<f64>) -> Point2<f64> {
        let back = self.stretch().try_inverse().unwrap_or_else(Matrix2::identity);
        self.centre_mm + back * (flat_mm - self.centre_mm)
    }
}

/// P₂.
fn legendre(t: f64) -> f64 {
    1.5 * t * t - 0.5
}

/// A printed sheet where it lies before a camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Sheet {
    /// The camera's pose to the sheet's mean plane.
    pub camera_from_grid: Pose,
    /// Its shape.
    pub shape: SheetShape,
}

impl Sheet {
    /// A flat and square sheet.
    pub fn flat(camera_from_grid: Pose) -> Self {
        Self { camera_from_grid, shape: SheetShape::default() }
    }

    /// The pixel of lattice coordinates, mm.
    pub fn project(&self, lens: &Lens, lattice_mm: &Point2<f64>) -> Point2<f64> {
        lens.project(&(self.camera_from_grid * self.shape.place(lattice_mm)))
    }

    /// The pixel of lattice coordinates (mm), and how it moves with the arm from the grid frame's origin as the camera sees it (mm, px per mm) and
    /// with the shape's numbers.
    pub(super) fn project_with_jacobian(
        &self,
        lens: &Lens,
        lattice_mm: &Point2<f64>,
    ) -> (Point2<f64>, Vector3<f64>, Matrix2x3<f64>, SMatrix<f64, 2, { SheetShape::NUMBERS }>) {
        let arm = self.camera_from_grid.rotation * self.shape.place(lattice_mm).coords;
        let (pixel, by_point) =
            lens.project_with_jacobian(&Point3::from(arm + self.camera_from_grid.translation.vector));
        let turned = by_point * self.camera_from_grid.rotation.to_rotation_matrix();
        (pixel, arm, by_point, turned * self.shape.place_by_shape(lattice_mm))
    }

    /// The lattice coordinates (mm) seen at a pixel, and their gradients (rows), mm per px; `None` where the line of sight leads away
    /// from the sheet.
    pub fn at(&self, lens: &Lens, pixel: &Point2<f64>) -> Option<(Point2<f64>, Matrix2<f64>)> {
        let centre = self.place_at(lens, pixel)?;
        let right = self.place_at(lens, &(pixel + Vector2::x()))? - centre;
        let down = self.place_at(lens, &(pixel + Vector2::y()))? - centre;
        Some((centre, Matrix2::from_columns(&[right, down])))
    }

    /// The lattice coordinates (mm) seen at a pixel, without their gradients.
    pub fn place_at(&self, lens: &Lens, pixel: &Point2<f64>) -> Option<Point2<f64>> {
        let grid_from_camera = self.camera_from_grid.inverse();
        let eye = grid_from_camera * Point3::origin();
        let ray = grid_from_camera * lens.ray(pixel);
        let mut height_mm = 0.0;
        let mut lattice_mm = Point2::origin();
        for _ in 0..if self.shape.bow_mm == [0.0; 3] { 1 } else { SURFACE_ROUNDS } {
            let distance = (height_mm - eye.z) / ray.z;
            if distance.is_nan() || distance <= 0.0 {
                return None;
            }
            lattice_mm = self.shape.lattice(&Point2::new(eye.x + distance * ray.x, eye.y + distance * ray.y));
            height_mm = self.shape.height_mm(&lattice_mm);
        }
        Some(lattice_mm)
    }

    /// How long so many mm across are in the picture in the middle of the sheet that is seen, px.
    pub fn length_px(&self, lens: &Lens, mm: f64) -> f64 {
        let middle = self.shape.centre_mm;
        (self.project(lens, &(middle + Vector2::new(mm, 0.0))) - self.project(lens, &middle)).norm()
    }

    /// The same sheet with its lattice counted from another place of it, mm.
    #[must_use]
    pub fn counted_from(&self, lattice_mm: Vector2<f64>) -> Self {
        let camera_from_grid = self.camera_from_grid * Translation3::new(lattice_mm.x, lattice_mm.y, 0.0);
        Self { camera_from_grid, shape: SheetShape { centre_mm: self.shape.centre_mm - lattice_mm, ..self.shape } }
    }

    /// The sheet, so many times as large and as far away, that is seen in the same place.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        let mut other = self.clone();
        other.camera_from_grid.translation.vector *= factor;
        other.shape.bow_mm = self.shape.bow_mm.map(|bow_mm| factor * bow_mm);
        other.shape.centre_mm *= factor;
        other.shape.half_mm *= factor;
        other
    }
}

/// Covariance of a turn of the grid frame (rad, about the grid's axes) from that of its plane's slopes (∂z/∂x, ∂z/∂y).
pub(super) fn turn_covariance(slopes: &Matrix2<f64>) -> Matrix3<f64> {
    // A slope along x is a turn about −y, one along y a turn about x.
    let turn = nalgebra::Matrix3x2::new(0.0, 1.0, -1.0, 0.0, 0.0, 0.0);
    turn * slopes * turn.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::scene::Scene;
    use approx::assert_relative_eq;
    use nalgebra::UnitQuaternion;

    fn bowed() -> Sheet {
        let shape = SheetShape {
            anisotropy: 0.02,
            shear: 0.005,
            bow_mm: [0.8, -0.6, 0.4],
            centre_mm: Point2::new(3.0, -2.0),
            half_mm: Vector2::new(30.0, 20.0),
        };
        let lean = UnitQuaternion::from_scaled_axis(Vector3::new(0.15, -0.1, 0.2));
        Sheet { camera_from_grid: Pose::from_parts(Translation3::new(2.0, 1.0, 250.0), lean), shape }
    }

    #[test]
    fn the_pixel_of_a_place_shows_that_place_and_its_gradients_are_those_of_differences() {
        let lens = Lens { focal_px: [5000.0, 5000.0].into(), ..Scene::default().lens };
        for sheet in [bowed(), Sheet::flat(bowed().camera_from_grid)] {
            for pixel in [Point2::new(100.0, 80.0), Point2::new(700.0, 500.0)] {
                let (place, gradient) = sheet.at(&lens, &pixel).unwrap();
                assert!((sheet.project(&lens, &place) - pixel).norm() < 1e-3);
                let step = 1e-3;
                for (axis, by) in [Vector2::x() * step, Vector2::y() * step].into_iter().enumerate() {
                    let slope = (sheet.at(&lens, &(pixel + by)).unwrap().0 - place) / step;
                    assert!((slope - gradient.column(axis)).norm() < 1e-3 * gradient.norm());
                }
            }
        }
    }

    #[test]
    fn the_mean_plane_of_the_rectangle_that_is_seen_is_the_grid_frames() {
        let shape = bowed().shape;
        let (mut sums, mut squares, count) = ([0.0; 3], 0.0, 400);
        let mid = |k: i32| (f64::from(k) + 0.5) / f64::from(count) * 2.0 - 1.0;
        for (i, j) in (0..count).flat_map(|i| (0..count).map(move |j| (i, j))) {
            let at = Vector2::new(mid(i), mid(j));
            let z = shape.height_mm(&(shape.centre_mm + at.component_mul(&shape.half_mm)));
            [1.0, at.x, at.y].into_iter().zip(&mut sums).for_each(|(by, sum)| *sum += z * by);
            squares += z * z;
        }
        let places = f64::from(count * count);
        assert!(sums.iter().all(|sum| (sum / places).abs() < 1e-5), "{sums:?}");
        assert_relative_eq!((squares / places).sqrt(), shape.rms_mm(), epsilon = 1e-4);
    }

    #[test]
    fn counted_from_elsewhere_and_scaled_it_is_seen_in_the_same_place() {
        let lens = Scene::default().lens;
        let (sheet, place, by) = (bowed(), Point2::new(5.0, 7.0), Vector2::new(1.5, -2.0));
        let seen = sheet.project(&lens, &place);
        assert!((sheet.counted_from(by).project(&lens, &(place - by)) - seen).norm() < 1e-9);
        assert!((sheet.scaled(2.0).project(&lens, &(place * 2.0)) - seen).norm() < 1e-9);
    }

    #[test]
    fn slopes_of_a_shifted_middle_are_those_of_differences() {
        let shape = bowed().shape;
        let slope = |at: Point2<f64>| {
            let step = 1e-5;
            let along = |by: Vector2<f64>| {
                (shape.height_mm(&(at + by * step)) - shape.height_mm(&(at - by * step))) / (2.0 * step)
            };
            Vector2::new(along(Vector2::x()), along(Vector2::y()))
        };
        // Independent shifts of the middle by a tenth of half the extent along either axis.
        let expected: Matrix2<f64> = (0..2)
            .map(|axis| {
                let mut by = Vector2::zeros();
                by[axis] = 0.1 * shape.half_mm[axis];
                let change = slope(shape.centre_mm + by) - slope(shape.centre_mm);
                change * change.transpose()
            })
            .sum();
        assert_relative_eq!(shape.slope_covariance(0.1), expected, epsilon = 1e-9);
    }
}
