//! Aligns the straight snake along its axis by its own colours: disks look alike, and shadows and glints may have put it a part of a disk off.
//!
//! The model's silhouette is moved along the axis in small steps over a strip of the picture. Where it covers the snake and nothing else,
//! what tells snake from target adds up to the most inside of it without what adds up outside.

use super::base_fit::{STRAIGHT, StraightPicture};
use super::colours::appearance_of;
use super::placement::Placement;
use super::snake_search::SnakeStart;
use crate::measure::body::{BodyPoint, Outline, Projection};
use crate::measure::image::plane::Plane;
use crate::measure::target::Grid;
use nalgebra::{Point2, Vector2, Vector3};
use rayon::prelude::*;

/// How far the start may be off, disk pitches to either side, and the step in which it is moved.
///
/// Convention: two and a half disks, and steps that move a rim by no more than its own thickness, three twentieths of the pitch.
const REACH_PITCHES: f64 = 2.5;
const STEP_PITCHES: f64 = 0.1;
/// Starts closer than this, in disk pitches, are one.
///
/// Convention: nearly half a pitch; the fit of the base searches about as far.
const APART_PITCHES: f64 = 0.4;
/// How many starts are fitted.
///
/// Convention: a limit of time; the second is for pictures in which a disk is hidden.
const MOST_STARTS: usize = 2;
/// The strip's half width, and how far it goes beyond the tip of the modelled snake, in diameters of the disks.
///
/// Derived: the former is the snake's and a little more; the latter two and a half disk pitches of the paper's robot, up to which the
/// snake is moved.
const HALF_WIDTH: f64 = 0.6;
const BEYOND: f64 = 2.3;
/// Distance between the strip's places, px.
///
/// Convention: a limit of time; tens of thousands of places are left.
const SPACING_PX: f64 = 2.0;
/// The value half way between the target's mean, 0, and the snake's, 1.
///
/// Derived: half of their sum.
const BETWEEN: f32 = 0.5;
/// The range within which a pixel's discriminant counts, 1 being the snake's mean and 0 the target's.
///
/// Convention: twice the difference; a highlight must not outweigh a disk.
const COUNTED: (f32, f32) = (-0.5, 1.5);

/// The most likely starts of the straight snake along the axis of a rough one, best first; none where the picture does not tell snake
/// from target there.
pub fn aligned_starts(picture: StraightPicture, rough: &SnakeStart, grid: &Grid) -> Vec<SnakeStart> {
    let StraightPicture { frame, lens, robot, options } = picture;
    let start_at = |offset_px: f64| SnakeStart { base: rough.base + rough.axis * offset_px, ..*rough };
    let view_from = |start: &SnakeStart| {
        let placement = Placement::from_picture(lens, options, grid, &start.base, start.axis)?;
        Some(Projection { lens, camera_from_base: placement.camera_from_base(options, grid), robot })
    };
    let Some(view) = view_from(rough) else { return Vec::new() };
    let outline = Outline::spaced(&view, STRAIGHT, view.coarse_spacing_px());
    let Some(appearance) = appearance_of(frame, &view, &outline, false, None) else { return Vec::new() };
    let strip = Strip::of(&view, &appearance.plane(frame));
    let pitch_px = view.diameter_px() * robot.disk_pitch_mm() / robot.body.disk_diameter_mm;
    let steps = (REACH_PITCHES / STEP_PITCHES).round() as i32;
    let scored = (-steps..=steps).into_par_iter().filter_map(|step| {
        let offset_px = f64::from(step) * STEP_PITCHES * pitch_px;
        let view = view_from(&start_at(offset_px))?;
        Some((strip.agreement(&Outline::spaced(&view, STRAIGHT, view.coarse_spacing_px())), offset_px))
    });
    let mut scored: Vec<(f64, f64)> = scored.collect();
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut chosen: Vec<f64> = Vec::new();
    for (_, offset_px) in scored {
        let is_apart = chosen.iter().all(|other| (other - offset_px).abs() > APART_PITCHES * pitch_px);
        if is_apart && chosen.len() < MOST_STARTS {
            chosen.push(offset_px);
        }
    }
    chosen.into_iter().map(start_at).collect()
}

/// The places of a strip of the picture, and how much more like snake than like target each is.
struct Strip(Vec<(Point2<f64>, f64)>);

impl Strip {
    /// The strip around the modelled snake. It begins where the model has its holder however it is moved: how far the holder goes on
    /// below is not known.
    fn of(view: &Projection, plane: &Plane) -> Self {
        let (end, axis) = view.holder_end();
        let across = Vector2::new(-axis.y, axis.x);
        let tip = view.holder_pixel(&BodyPoint { s_mm: view.robot.length_mm, local: Vector3::zeros() });
        let (width_px, (least, most)) = (view.diameter_px(), COUNTED);
        let beyond = BEYOND * width_px;
        let steps = |length_px: f64| (length_px / SPACING_PX) as i32;
        let (columns, rows) = (steps(HALF_WIDTH * width_px), steps((tip - end).norm() + beyond));
        let place = |row: i32, column: i32| end + (axis * f64::from(row) + across * f64::from(column)) * SPACING_PX;
        let places = (steps(beyond)..=rows).flat_map(|row| (-columns..=columns).map(move |column| place(row, column)));
        let inside = places.filter(|place| view.lens.contains(place, 1.0));
        Self(inside.map(|p| (p, f64::from(plane.sample(&p).clamp(least, most) - BETWEEN))).collect())
    }

    /// The sum over what an outline covers without the sum over the rest.
    fn agreement(&self, outline: &Outline) -> f64 {
        self.0.iter().map(|(place, value)| if outline.covers(place) { *value } else { -value }).sum()
    }
}
