//! Which shapes may show in which part of the picture.

use crate::geometry::Pose;
use crate::simulate::body::Shape;
use crate::simulate::scene::Scene;
use nalgebra::{Point2, Vector2, Vector3};
use rayon::prelude::*;

/// The picture cut into squares, each with the shapes that may show in it.
pub(super) struct Tiles {
    columns: usize,
    shapes: Vec<Vec<u16>>,
}

impl Tiles {
    /// Side of a square, px.
    ///
    /// Convention: affects the time only.
    const SIDE: usize = 8;

    pub fn new(scene: &Scene, shapes: &[Shape]) -> Self {
        let count = |pixels: u32| (pixels as usize).div_ceil(Self::SIDE);
        let (columns, rows) = (count(scene.lens.width), count(scene.lens.height));
        let camera_from_base = scene.view.camera_from_base();
        let windows: Vec<Window> = shapes.iter().map(|shape| Window::of_shape(shape, &camera_from_base)).collect();
        let tile = |k: usize| {
            let tile = Window::of_tile(scene, Self::SIDE * (k % columns), Self::SIDE * (k / columns), Self::SIDE);
            (0..).zip(&windows).filter(|(_, window)| window.overlaps(&tile)).map(|(k, _)| k).collect()
        };
        Self { columns, shapes: (0..columns * rows).into_par_iter().map(tile).collect() }
    }

    pub fn near(&self, column: usize, row: usize) -> &[u16] {
        &self.shapes[row / Self::SIDE * self.columns + column / Self::SIDE]
    }
}

/// A rectangle of directions, as x/z and y/z in the camera's frame, before any distortion.
struct Window {
    low: Vector2<f64>,
    high: Vector2<f64>,
}

impl Window {
    /// Holds all of these; everything if one of them is no direction to the camera's front.
    fn around(directions: impl Iterator<Item = Vector3<f64>>) -> Self {
        let everything = Vector2::repeat(f64::INFINITY);
        let mut window = Self { low: everything, high: -everything };
        for direction in directions {
            if direction.z.is_nan() || direction.z <= 0.0 {
                return Self { low: -everything, high: everything };
            }
            let place = direction.xy() / direction.z;
            window = Self { low: window.low.inf(&place), high: window.high.sup(&place) };
        }
        window
    }

    fn of_shape(shape: &Shape, camera_from_base: &Pose) -> Self {
        Self::around(shape.bounds().into_iter().flat_map(|(centre, radius)| {
            let centre = (camera_from_base * centre).coords;
            let side = move |corner: i32, bit: i32| if corner & bit == 0 { -radius } else { radius };
            (0..8).map(move |corner| centre + Vector3::new(side(corner, 1), side(corner, 2), side(corner, 4)))
        }))
    }

    /// A pixel wider all round than the tile, for what distortion bends its sides.
    fn of_tile(scene: &Scene, column: usize, row: usize, side: usize) -> Self {
        let place = |start: usize, end: bool| if end { (start + side) as f64 + 0.5 } else { start as f64 - 1.5 };
        let corners = [(false, false), (true, false), (false, true), (true, true)];
        Self::around(corners.into_iter().map(|(x, y)| scene.lens.ray(&Point2::new(place(column, x), place(row, y)))))
    }

    fn overlaps(&self, other: &Self) -> bool {
        (0..2).all(|axis| self.low[axis] <= other.high[axis] && other.low[axis] <= self.high[axis])
    }
}
