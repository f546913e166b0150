//! The surfaces of the body that may bound its silhouette: rims and limbs of disks and holder, limbs of the tubes.
//!
//! Each function gives two things: the surface points that may lie on the border, and polygons whose union is the silhouette.

use super::parts::{HOLDER_MM, Piece};
use super::projection::Projection;
use super::section::{Section, SurfacePoint};
use crate::robot::Curve;
use nalgebra::{Point2, Vector2, Vector3};
use std::f64::consts::TAU;

/// The fewest points on a rim, however small it is in the picture.
///
/// Convention: an octagon's area is 90 % of its circle's; disks as small as that are a few pixels wide.
const FEWEST_RIM_POINTS: f64 = 8.0;
/// The fewest sections at which the tubes' sides are computed.
///
/// Convention: a guard for snakes that are a few pixels long.
const FEWEST_TUBE_SECTIONS: f64 = 8.0;
/// Length of the polygons into which a tube's silhouette is cut, px: the bounding box of a bent tube is mostly empty, and
/// rasterising takes time in proportion to the box.
///
/// Convention: affects the time only.
const TUBE_POLYGON_PX: f64 = 40.0;
/// The most length of a polygon's straight sides, px.
///
/// Derived: a snake that bends by 90° over 300 px is 0.02 px off the middle of such a chord.
const TUBE_CHORD_PX: f64 = 6.0;
/// Chords that neighbouring polygons of a tube have in common, so that no gap is left between them.
///
/// Derived: one section shared would close the gap exactly; a chord covers the rounding of the rasteriser.
const TUBE_POLYGON_OVERLAP: usize = 1;

/// What the projection of all surfaces gives.
#[derive(Default)]
pub(super) struct Surfaces {
    /// Points that may lie on the silhouette's border, section by section.
    pub points: Vec<SurfacePoint>,
    /// Polygons, px, whose union is the silhouette.
    pub polygons: Vec<Vec<Point2<f64>>>,
}

impl Surfaces {
    /// The surfaces of the whole body, with points about `spacing_px` apart; a pixel is `mm_per_px` large at the snake.
    pub fn new(view: &Projection, curve: &Curve, spacing_px: f64, mm_per_px: f64) -> Self {
        let mut surfaces = Self::default();
        surfaces.add_cylinders(view, curve, spacing_px * mm_per_px);
        surfaces.add_tubes(view, curve, spacing_px, mm_per_px);
        surfaces
    }

    /// Rims and side walls of the holder, the disks and the tool.
    fn add_cylinders(&mut self, view: &Projection, curve: &Curve, spacing_mm: f64) {
        let body = &view.robot.body;
        let (half, radius_mm) = (body.disk_thickness_mm / 2.0, body.disk_diameter_mm / 2.0);
        let tip_mm = view.robot.length_mm;
        // The holder is number 0, disks count from 1, and the tool comes after the end disk. Each as the section that its axis is
        // perpendicular to, its faces from there, and its radius, mm.
        let spacers = view.robot.spacer_middles_mm().into_iter().map(|middle| (middle, -half, half, radius_mm));
        let end = (tip_mm, -body.disk_thickness_mm, 0.0, radius_mm);
        let tool = body.tool.map(|tool| (tip_mm, 0.0, tool.length_mm, tool.diameter_mm / 2.0));
        let all = std::iter::once((0.0, -HOLDER_MM, 0.0, radius_mm)).chain(spacers).chain([end]).chain(tool);
        for (number, (s_mm, near_mm, far_mm, radius_mm)) in (0..).zip(all) {
            let section = Section::new(view, curve, s_mm);
            let cylinder = Cylinder { number, section, radius_mm, near_mm, far_mm, spacing_mm };
            self.polygons.push(cylinder.outline(&mut self.points));
        }
    }

    /// The two sides of each tube.
    fn add_tubes(&mut self, view: &Projection, curve: &Curve, spacing_px: f64, mm_per_px: f64) {
        let robot = view.robot;
        let steps = (robot.length_mm / (spacing_px * mm_per_px)).ceil().max(FEWEST_TUBE_SECTIONS) as usize;
        let mut axes = vec![(Vector2::zeros(), robot.primary.outer_diameter_mm / 2.0)];
        for azimuth in &robot.backbone_azimuths() {
            let offset = robot.backbone_circle_radius_mm * Vector2::new(azimuth.cos(), azimuth.sin());
            axes.push((offset, robot.secondary.outer_diameter_mm / 2.0));
        }
        let middles_mm = robot.spacer_middles_mm();
        let mut sides = vec![[Vec::with_capacity(steps), Vec::with_capacity(steps)]; axes.len()];
        self.points.reserve(2 * steps * axes.len());
        for step in 0..steps {
            let section = Section::new(view, curve, robot.length_mm * (step as f64 + 0.5) / steps as f64);
            let camera = section.camera_centre.coords.xy();
            let disks_below = middles_mm.partition_point(|middle| *middle <= section.s_mm) as u8;
            for (number, &(offset, radius)) in axes.iter().enumerate() {
                for (side, radial) in tangent_directions(camera - offset, radius) {
                    let local = (offset + radius * radial).push(0.0);
                    let piece = Piece::Tube(number as u8, side, disks_below);
                    let point = section.surface_point(local, piece, 0.0, radial.push(0.0), Vector3::z());
                    sides[number][usize::from(side > 0)].push(point.pixel);
                    self.points.push(point);
                }
            }
        }
        let stride = (TUBE_CHORD_PX / spacing_px).max(1.0) as usize;
        let length = (TUBE_POLYGON_PX / spacing_px / stride as f64).ceil() as usize * stride;
        for [left, right] in sides {
            // From too near no sides are seen.
            let Some(last) = left.len().min(right.len()).checked_sub(1) else { continue };
            for start in (0..last).step_by(length) {
                let end = (start + length + TUBE_POLYGON_OVERLAP * stride).min(last);
                let corners = || (start..end).step_by(stride).chain([end]);
                let there = corners().map(|k| left[k]);
                self.polygons.push(there.chain(corners().rev().map(|k| right[k])).collect());
            }
        }
    }
}

/// A disk, the holder or the tool as the camera sees it.
struct Cylinder<'a> {
    /// 0 for the holder; disks count from 1, and the tool after them.
    number: u8,
    section: Section<'a>,
    radius_mm: f64,
    /// Its faces along the section's tangent, mm.
    near_mm: f64,
    far_mm: f64,
    /// Distance between surface points, mm.
    spacing_mm: f64,
}

impl Cylinder<'_> {
    /// Its outline in the picture, px.
    ///
    /// A rim bounds the silhouette where exactly one of the two surfaces that meet in it faces the camera. On the side of the
    /// camera, where the wall is visible, that is the rim of the face that is not; behind, it is the rim of the face that is. The
    /// limbs of the wall join them.
    fn outline(&self, points: &mut Vec<SurfacePoint>) -> Vec<Point2<f64>> {
        let camera = self.section.camera_centre;
        let (near_is_seen, far_is_seen) = (camera.z < self.near_mm, camera.z > self.far_mm);
        let Some((towards, half)) = tangent_angles(camera.coords.xy(), self.radius_mm) else {
            return self.rim(far_is_seen, 0.0, [0.0, TAU], points);
        };
        let (before, after) = (towards - half, towards + half);
        let mut outline = self.rim(near_is_seen, towards, [before, after], points);
        let mut back = if near_is_seen || far_is_seen {
            self.rim(far_is_seen, towards, [after, before + TAU], points)
        } else {
            self.rim(true, towards, [after, before], points)
        };
        let before = self.side(-1, before, points);
        let after = self.side(1, after, points);
        let [front_face, back_face] = if near_is_seen { [1, 0] } else { [0, 1] };
        outline.insert(0, before[front_face]);
        outline.extend([after[front_face], after[back_face]]);
        outline.append(&mut back);
        outline.push(before[back_face]);
        outline
    }

    /// The rim of the near or far face from one angle about the axis to another; `towards` is the angle of the camera.
    fn rim(&self, far: bool, towards: f64, [from, to]: [f64; 2], points: &mut Vec<SurfacePoint>) -> Vec<Point2<f64>> {
        let steps = ((to - from).abs() * self.radius_mm / self.spacing_mm).ceil().max(FEWEST_RIM_POINTS);
        let z = if far { self.far_mm } else { self.near_mm };
        // Any positive combination of the normals of the two surfaces points out of the border.
        let slope = if far { 1.0 } else { -1.0 };
        let (towards_sin, towards_cos) = towards.sin_cos();
        let point = |step: usize| {
            let angle = from + (to - from) * (step as f64 + 0.5) / steps;
            let (sin, cos) = angle.sin_cos();
            let local = Vector3::new(self.radius_mm * cos, self.radius_mm * sin, z);
            let piece = match (self.number, far) {
                // The holder goes on below what is modelled of it, so that this rim does not exist.
                (0, false) => return self.section.pixel(local),
                (0, true) => Piece::BaseRim,
                (number, far) => Piece::Rim(number, far),
            };
            let (outward, along) = (Vector3::new(cos, sin, slope), Vector3::new(-sin, cos, 0.0));
            let lateral = (sin * towards_cos - cos * towards_sin).abs();
            let point = self.section.surface_point(local, piece, lateral, outward, along);
            let pixel = point.pixel;
            points.push(SurfacePoint { face_px: self.face_px(local, far, lateral), ..point });
            pixel
        };
        (0..steps as usize).map(point).collect()
    }

    /// How far the face of a rim reaches behind a point of it in the picture, px: the chord of the face's ellipse along its minor axis.
    /// 0 where the face is turned away.
    fn face_px(&self, local: Vector3<f64>, far: bool, lateral: f64) -> f64 {
        let (px_per_mm, slant) = self.section.scale_and_slant(local);
        let slant = if far { slant } else { -slant };
        2.0 * self.radius_mm * px_per_mm * slant.max(0.0) * (1.0 - lateral * lateral).max(0.0).sqrt()
    }

    /// The limb of the wall at an angle about the axis; returns the pixels of its near and far end.
    fn side(&self, side: i8, angle: f64, points: &mut Vec<SurfacePoint>) -> [Point2<f64>; 2] {
        let radial = Vector2::new(angle.cos(), angle.sin());
        let at = |z: f64| (self.radius_mm * radial).push(z);
        let height_mm = self.far_mm - self.near_mm;
        let count = (height_mm / self.spacing_mm).floor().max(1.0);
        let piece = if self.number == 0 { Piece::HolderSide(side) } else { Piece::DiskSide(self.number, side) };
        points.extend((0..count as usize).map(|step| {
            let z = self.near_mm + height_mm * (step as f64 + 0.5) / count;
            self.section.surface_point(at(z), piece, 0.0, radial.push(0.0), Vector3::z())
        }));
        [self.near_mm, self.far_mm].map(|z| self.section.pixel(at(z)))
    }
}

/// The angles of the tangents from an observer (in the circle's plane, its centre at the origin) to a circle: the angle of the
/// observer, and how far to either side of it the tangents touch, n · (observer − radius n) = 0. `None` from inside the circle.
fn tangent_angles(observer: Vector2<f64>, radius: f64) -> Option<(f64, f64)> {
    let distance = observer.norm();
    (distance > radius).then(|| (observer.y.atan2(observer.x), (radius / distance).acos()))
}

/// The radial directions of the two tangents' points, to the right (−1) and to the left (+1) of the direction to the observer:
/// [`tangent_angles`] without trigonometric functions, since the tubes need thousands of them.
fn tangent_directions(observer: Vector2<f64>, radius: f64) -> impl Iterator<Item = (i8, Vector2<f64>)> {
    let distance = observer.norm();
    let directions = (distance > radius).then(|| {
        let towards = observer / distance;
        let (cos, sin) = (radius / distance, (1.0 - (radius / distance).powi(2)).sqrt());
        let left = Vector2::new(-towards.y, towards.x);
        [(-1, cos * towards - sin * left), (1, cos * towards + sin * left)]
    });
    directions.into_iter().flatten()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn both_forms_of_the_tangents_touch_the_circle_at_right_angles_to_the_line_of_sight(
            (x, y, radius) in (-5.0..5.0f64, -5.0..5.0f64, 0.1..3.0f64),
        ) {
            let observer = Vector2::new(x, y);
            let tangents: Vec<_> = tangent_directions(observer, radius).collect();
            let angles = tangent_angles(observer, radius);
            prop_assert_eq!(tangents.is_empty(), observer.norm() <= radius);
            prop_assert_eq!(angles.is_none(), tangents.is_empty());
            for (side, normal) in tangents {
                prop_assert!(normal.dot(&(observer - radius * normal)).abs() < 1e-9);
                prop_assert!((normal.norm() - 1.0).abs() < 1e-12);
                let (towards, half) = angles.unwrap();
                let angle = towards + f64::from(side) * half;
                prop_assert!((normal - Vector2::new(angle.cos(), angle.sin())).norm() < 1e-7);
            }
        }
    }
}
