//! Whether the straight snake is seen turned about its axis against what was stated: its backbones tell.
//!
//! A mirrored picture shows an odd number of backbones where they would be if the snake were turned by half of their spacing. Everything else of
//! the straight snake looks the same, and every bend would be measured with a mirrored azimuth.

use super::base_fit::STRAIGHT;
use crate::geometry::Pose;
use crate::measure::body::{Outline, Projection};
use crate::measure::image::plane::Plane;
use nalgebra::{Point2, Translation3, UnitQuaternion, Vector3};
use std::f64::consts::PI;

/// Of the pixels that only one of two snakes would cover, the mean by which they must agree with the turned one, where 1 is all of them.
///
/// Convention: half; a picture in which no gap between the backbones is seen clearly has nearly 0.
const TURNED: f64 = 0.5;
/// The fewest such pixels that tell.
///
/// Convention: a guard; two backbones seen side by side along a snake that is 300 px long differ in thousands.
const FEWEST_PIXELS: u32 = 200;

/// Whether a picture, in which the snake is 1 and the target 0, agrees with a straight snake that is turned by half of the backbones' spacing
/// rather than with the stated one.
pub fn is_turned(view: &Projection, plane: &Plane) -> bool {
    let half_spacing = PI / view.robot.backbone_count() as f64;
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), half_spacing);
    let camera_from_base = view.camera_from_base * Pose::from_parts(Translation3::identity(), turn);
    let turned = Outline::new(&Projection { camera_from_base, ..view.clone() }, STRAIGHT);
    let stated = Outline::new(view, STRAIGHT);
    let (x0, y0, x1, y1) = stated.bounds();
    let (mut sum, mut pixels) = (0.0, 0);
    for y in y0.max(0.0) as i64..=y1.min(f64::from(view.lens.height) - 1.0) as i64 {
        for x in x0.max(0.0) as i64..=x1.min(f64::from(view.lens.width) - 1.0) as i64 {
            let pixel = Point2::new(x as f64, y as f64);
            let (of_turned, of_stated) = (turned.covers(&pixel), stated.covers(&pixel));
            if of_turned != of_stated {
                let share = f64::from(plane.sample(&pixel).clamp(0.0, 1.0));
                sum += if of_turned { 2.0 * share - 1.0 } else { 1.0 - 2.0 * share };
                pixels += 1;
            }
        }
    }
    pixels >= FEWEST_PIXELS && sum > TURNED * f64::from(pixels)
}
