//! The snake's shadow on the grid target.

use super::light::{Radiance, blurred};
use crate::simulate::body::{Ray, Shape};
use crate::simulate::scene::Scene;
use nalgebra::{Point2, Point3, Vector2, Vector3};
use rayon::prelude::*;

/// How dark the snake's shadow is on the grid target, as a picture of it in (x_b, z_b).
pub(super) struct Shadow {
    corner: Point2<f64>,
    columns: usize,
    rows: usize,
    darkness: Vec<f64>,
}

impl Shadow {
    /// Side of a cell, mm.
    ///
    /// Convention: a third of a tube's diameter; values between the cells are interpolated.
    const CELL: f64 = 0.2;

    pub fn new(scene: &Scene, shapes: &[Shape], to_lamp: &Vector3<f64>) -> Option<Self> {
        // The lamp must be before the target.
        if scene.light.shadow <= 0.0 || to_lamp.y >= -0.05 {
            return None;
        }
        let standoff = scene.paper.standoff_mm;
        let fall = |point: &Point3<f64>| {
            let drop = (standoff - point.y) / to_lamp.y;
            Point2::new(point.x + drop * to_lamp.x, point.z + drop * to_lamp.z)
        };
        // The holder's far end lies outside any picture; its shadow is followed down to the length of the snake.
        let depth = scene.robot.length_mm;
        let blur = scene.light.shadow_blur_mm;
        let mut low = Point2::new(f64::INFINITY, f64::INFINITY);
        let mut high = -low;
        for (centre, radius) in shapes.iter().flat_map(Shape::bounds) {
            let centre = Point3::new(centre.x, centre.y, centre.z.max(-depth));
            // A sphere's shadow is longer than wide where the light is slanted.
            let reach = radius / to_lamp.y.abs() + 4.0 * blur + Self::CELL;
            let at = fall(&centre);
            low = low.inf(&(at - Vector2::repeat(reach)));
            high = high.sup(&(at + Vector2::repeat(reach)));
        }
        let count = |length: f64| (length / Self::CELL).ceil().clamp(1.0, 2000.0) as usize;
        let (columns, rows) = (count(high.x - low.x), count(high.y - low.y));
        let darkness = (0..columns * rows)
            .into_par_iter()
            .map(|k| {
                let at = low + Self::CELL * Vector2::new((k % columns) as f64 + 0.5, (k / columns) as f64 + 0.5);
                let ray = Ray { origin: Point3::new(at.x, standoff, at.y), direction: *to_lamp };
                let dark = shapes.iter().any(|shape| shape.meet(&ray).is_some());
                Radiance::repeat(f64::from(u8::from(dark)))
            })
            .collect();
        let darkness = blurred(darkness, columns, rows, blur / Self::CELL).into_iter().map(|v| v.x).collect();
        Some(Self { corner: low, columns, rows, darkness })
    }

    /// Darkness at (x_b, z_b), 0 to 1, interpolated between the cells' middles.
    pub fn at(&self, point: &Point2<f64>) -> f64 {
        let place = (point - self.corner) / Self::CELL - Vector2::repeat(0.5);
        let (columns, rows) = (self.columns as f64, self.rows as f64);
        if !((-1.0..columns).contains(&place.x) && (-1.0..rows).contains(&place.y)) {
            return 0.0;
        }
        // A cast truncates several times as fast as a number is rounded down.
        let [column, row] = [place.x, place.y].map(|v| ((v + 1.0) as i64 - 1) as f64);
        let cell = |dx: f64, dy: f64| {
            let (x, y) = (column + dx, row + dy);
            let inside = x >= 0.0 && y >= 0.0 && x < columns && y < rows;
            if inside { self.darkness[y as usize * self.columns + x as usize] } else { 0.0 }
        };
        let (fx, fy) = (place.x - column, place.y - row);
        let upper = cell(0.0, 0.0) * (1.0 - fx) + cell(1.0, 0.0) * fx;
        let lower = cell(0.0, 1.0) * (1.0 - fx) + cell(1.0, 1.0) * fx;
        upper * (1.0 - fy) + lower * fy
    }
}
