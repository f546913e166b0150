//! The silhouette of the straight robot as the search for it compares it with a picture: in cells, and as the strip that it takes.

use super::base_fit::STRAIGHT;
use crate::camera::Lens;
use crate::geometry::Pose;
use crate::measure::body::{Outline, Projection};
use crate::measure::image::plane::Plane;
use crate::robot::Robot;
use nalgebra::{Point2, UnitQuaternion, Vector2, Vector3};
use std::f64::consts::FRAC_PI_2;

/// How far the strip around the body goes beside its axis, in widths.
///
/// Convention: half a width of sheet on either side.
const HALF_WIDTH: f64 = 1.1;
/// How far it goes below the base, in widths.
///
/// Convention: as much holder as the user is asked to show, and a fifth more.
pub const BELOW: f64 = 1.2;
/// How far it goes beyond the tip, in widths.
///
/// Convention: more than half a width of sheet.
const BEYOND: f64 = 0.7;
/// How far the strip around a snake that may be bent goes above the base, in widths.
///
/// Convention: one disk's distance.
const HELD_ABOVE: f64 = 0.9;
/// How far that strip goes below the base, in widths.
///
/// Convention: as much holder as most pictures show.
const HELD_BELOW: f64 = 2.0;
/// Width of the body in the drawing from which its silhouette is taken, px.
///
/// Convention: fine beside the fine cells.
pub const DRAWN_WIDTH_PX: f64 = 36.0;
/// How far away the drawing's camera is, in widths.
///
/// Convention: far enough that perspective does not matter.
const DRAWN_FROM_WIDTHS: f64 = 60.0;

/// The straight body's silhouette in units of its width.
pub struct BodyTemplate {
    /// Drawn in so many px a width ([`DRAWN_WIDTH_PX`]), upright.
    pub drawn: Plane,
    /// Where the base is in the drawing, px.
    pub base: Point2<f64>,
    /// How much of the strip lies above the base, and below it, in widths.
    above: f64,
    below: f64,
    /// How far the tip is from the base, in widths.
    pub length_widths: f64,
}

/// One cell of the strip around the body: where it is from the base (widths, along and across), and the share of it that the body covers.
#[derive(Debug, Clone, Copy)]
pub struct Cell {
    pub along: f64,
    pub across: f64,
    pub body: f32,
}

impl BodyTemplate {
    /// The silhouette of a robot's holder and of the first of its snake, which hardly bends there.
    pub fn of_holder(robot: &Robot) -> Self {
        Self { above: HELD_ABOVE, below: HELD_BELOW, ..Self::of(robot) }
    }

    /// The silhouette of a straight robot.
    pub fn of(robot: &Robot) -> Self {
        let width_mm = robot.body.disk_diameter_mm;
        let end_mm = robot.length_mm + robot.body.tool.map_or(0.0, |tool| tool.length_mm);
        let length_widths = end_mm / width_mm;
        let size = |widths: f64| (widths * DRAWN_WIDTH_PX).ceil() as u32;
        let (width, height) = (size(2.0 * HALF_WIDTH + 1.0), size(length_widths + HELD_BELOW + BEYOND + 1.0));
        let focal_px = DRAWN_WIDTH_PX * DRAWN_FROM_WIDTHS;
        let base = Point2::new(f64::from(width) / 2.0, (length_widths + BEYOND + 0.5) * DRAWN_WIDTH_PX);
        let lens = Lens {
            width,
            height,
            focal_px: [focal_px, focal_px].into(),
            // Square to the body's middle, so that its disks are seen edge-on.
            centre_px: [base.x, f64::from(height) / 2.0].into(),
            distortion: Default::default(),
            fisheye: None,
        };
        let distance_mm = DRAWN_FROM_WIDTHS * width_mm;
        let drop_mm = (base.y - f64::from(height) / 2.0) / DRAWN_WIDTH_PX * width_mm;
        // The base's z is up in the picture, its y away from the camera.
        let upright = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), FRAC_PI_2);
        let camera_from_base = Pose::from_parts([0.0, drop_mm, distance_mm].into(), upright);
        let view = Projection { lens: &lens, camera_from_base, robot };
        let outline = Outline::new(&view, STRAIGHT);
        let covered = |k: u32| outline.covers(&Point2::new(f64::from(k % width), f64::from(k / width)));
        let data = (0..width * height).map(|k| if covered(k) { 1.0 } else { 0.0 }).collect();
        let drawn = Plane::new(width as usize, height as usize, data);
        Self { drawn, base, above: length_widths + BEYOND, below: BELOW, length_widths }
    }

    /// The strip in cells of which so many go into a width.
    pub fn cells(&self, per_width: f64) -> Vec<Cell> {
        let side_px = DRAWN_WIDTH_PX / per_width;
        let (columns, rows) = ((HALF_WIDTH * per_width) as i32, (self.above * per_width) as i32);
        let below = (self.below * per_width) as i32;
        let cell = |row: i32, column: i32| {
            let (along, across) = (f64::from(row) / per_width, f64::from(column) / per_width);
            let middle = self.base + Vector2::new(across, -along) * DRAWN_WIDTH_PX;
            // The mean over a lattice of places in the cell. Convention: finer than the picture's pixels.
            const PLACES: i32 = 6;
            let at = |k: i32| ((f64::from(k) + 0.5) / f64::from(PLACES) - 0.5) * side_px;
            let places = (0..PLACES * PLACES).map(|k| middle + Vector2::new(at(k % PLACES), at(k / PLACES)));
            let body = places.map(|place| self.drawn.sample(&place)).sum::<f32>() / (PLACES * PLACES) as f32;
            Cell { along, across, body }
        };
        (-below..=rows).flat_map(|row| (-columns..=columns).map(move |column| cell(row, column))).collect()
    }
}
