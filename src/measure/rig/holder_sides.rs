//! Finds the holder's two sides once its width is known, and follows them to its upper end, where the snake begins.

use super::background::Colours;
use super::error::RigError;
use super::locate::Holder;
use crate::measure::image::plane::{LANES, Plane};
use nalgebra::{Point2, Vector2};
use rayon::prelude::*;
use std::ops::Range;

/// How far the axis is turned to either side, rad (as a tangent), and in how many steps: coarsely, then finely about the best.
///
/// Convention: the first covers what the holder's rough axis leaves open; the last step moves the far end of a side by less than its blur.
const TURNS: [(f64, i32); 2] = [(0.10, 10), (0.010, 5)];
/// Length of the holder along which its sides are looked for, in widths: an edge runs at least so far.
///
/// Fitted: by hand on the project's renders (tests/eye/robustness), whose holders are seen for one width and more; not judged elsewhere.
const SIDE_WIDTHS: f64 = 0.9;
/// The least of a holder that must be seen, in widths.
///
/// Convention: documented to the user; less is not told from a line of the target.
const LEAST_WIDTHS: f64 = 0.5;
/// A side goes on where it is at least so steep, in units of its mean steepness.
///
/// Fitted: by hand on the project's renders with shadows and checkerboards (tests/eye/robustness); not judged elsewhere.
const GOES_ON: f64 = 0.4;
/// Where following begins, its step and half the length of a mean along the side, px; and the length of side that may be missed, in
/// widths.
///
/// Convention: what the fit of the base then searches, 14 px, is far wider.
const FIRST_PX: f64 = 4.0;
const STEP_PX: f64 = 2.0;
const HALF_LENGTH_PX: f64 = 3.0;
const MISSED_WIDTHS: f64 = 0.05;
/// Length of the two means whose difference is a step of colour, in widths and at least px: more than a printed line's width, less than the
/// tubes lie inside the holder's sides.
///
/// Fitted: to the paper's robot, whose tubes lie a tenth of its width inside.
const STEP_WIDTHS: f64 = 0.1;
const LEAST_STEP_PX: f64 = 3.0;
/// How far off the axis the sides are looked for, in widths.
///
/// Convention: where only a dark side of the holder was seen, or its shadow with it, its middle is off by up to one width.
const REACH_WIDTHS: f64 = 1.6;
/// How far a side may be off its place, in widths, where it is followed.
///
/// Convention: a side that is a little turned is followed all the same.
const OFF_WIDTHS: f64 = 0.025;
/// How many of the places at which the border may cut a holder are tried.
///
/// Convention: a limit of time.
const MOST_CUT: usize = 3;
/// Lengths over which colours are averaged before their step is measured, px: before a checkerboard a side may be a step up here and
/// a step down there.
///
/// Convention: less than a square that matters.
const MEAN_LENGTH_PX: f64 = 6.0;

/// Where the snake begins.
#[derive(Debug, Clone)]
pub struct SnakeStart {
    /// Middle of the holder's upper end, px.
    pub base: Point2<f64>,
    /// Direction from the holder to the tip.
    pub axis: Vector2<f64>,
}

/// Finds the holder's two sides, `width_px` apart, and follows them to its upper end.
///
/// A side is a step of colour all along the holder: shading is smooth, print across the holder is here and there, and
/// print along it is too thin to be a step.
///
/// # Errors
///
/// [`RigError::NoHolder`] where no two sides reach far enough.
pub fn find_start(colours: &Colours, holder: &Holder, width_px: f64) -> Result<SnakeStart, RigError> {
    let strip = Strip { channels: &colours.planes, root: holder.root, width_px };
    let (_, mut axis, mut left) = strip.steepest_sides(holder.axis, SIDE_WIDTHS * width_px);
    let mut end = strip.upper_end(axis, left);
    // Twice the length tells the axis twice as well.
    if let Some(followed_px) = end.filter(|followed_px| *followed_px > SIDE_WIDTHS * width_px) {
        (_, axis, left) = strip.steepest_sides(axis, followed_px);
        end = strip.upper_end(axis, left);
    }
    let end = end.filter(|end| *end > LEAST_WIDTHS * width_px).ok_or(RigError::NoHolder { width_px })?;
    let across = Vector2::new(-axis.y, axis.x);
    Ok(SnakeStart { base: holder.root + axis * end + across * (left + width_px / 2.0), axis })
}

/// Where the picture's border may cut a holder of this width, px: the places whose two sides are the steepest, most likely first.
pub fn holders_at_border(colours: &Colours, width_px: f64) -> Vec<Holder> {
    let Some(plane) = colours.planes.first() else { return Vec::new() };
    let (right, bottom) = (plane.width as f64 - 1.0, plane.height as f64 - 1.0);
    let (left_top, right_bottom) = (Point2::origin(), Point2::new(right, bottom));
    let borders = [
        (right_bottom, -Vector2::x(), right, -Vector2::y()),
        (left_top, Vector2::x(), right, Vector2::y()),
        (left_top, Vector2::y(), bottom, Vector2::x()),
        (right_bottom, -Vector2::y(), bottom, -Vector2::x()),
    ];
    // Around each root the sides are looked for as far as half the way to the next.
    let step_px = (2.0 * REACH_WIDTHS - 1.0) * width_px;
    let roots = borders.into_iter().flat_map(|(corner, along, length, inward)| {
        let count = (length / step_px).ceil() as i32;
        (0..count).map(move |k| (corner + along * (f64::from(k) + 0.5) * (length / f64::from(count)), inward))
    });
    let mut found: Vec<(f64, Holder)> = roots
        .map(|(root, inward)| {
            let strip = Strip { channels: &colours.planes, root, width_px };
            let (strength, axis, left) = strip.steepest_sides(inward, SIDE_WIDTHS * width_px);
            let across = Vector2::new(-axis.y, axis.x);
            (strength, Holder { root: root + across * (left + width_px / 2.0), axis, width_px })
        })
        .collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().take(MOST_CUT).map(|(_, holder)| holder).collect()
}

/// The picture around the holder, in coordinates along and across it.
struct Strip<'a> {
    channels: &'a [Plane],
    root: Point2<f64>,
    width_px: f64,
}

impl Strip<'_> {
    /// How steep the weaker of both sides is, over a length of the holder, along the axis, near a rough one, where it is steepest; that axis, and
    /// the place of the left side, px across from the root.
    fn steepest_sides(&self, rough: Vector2<f64>, length_px: f64) -> (f64, Vector2<f64>, f64) {
        let mut best = (0.0, rough, 0.0);
        for (reach, steps) in TURNS {
            let around = best.1;
            let sides = |k: i32| {
                let turn = reach * f64::from(k) / f64::from(steps);
                let axis = (around + Vector2::new(-around.y, around.x) * turn).normalize();
                let (strength, left) = self.best_sides(axis, length_px);
                (strength, axis, left)
            };
            let turned: Vec<_> = (-steps..=steps).into_par_iter().map(sides).collect();
            best = turned.into_iter().fold(best, |best, sides| if sides.0 > best.0 { sides } else { best });
        }
        best
    }

    /// How far from the root both sides go on, px; `None` where they do nowhere.
    fn upper_end(&self, axis: Vector2<f64>, left: f64) -> Option<f64> {
        let mean = self.sides(axis, left, 0.0..SIDE_WIDTHS * self.width_px);
        let mut end = None;
        let (mut along, mut missed) = (FIRST_PX, 0);
        let too_many = (MISSED_WIDTHS * self.width_px).round().max(2.0) as i32;
        while missed < too_many && self.is_in_picture(axis, left, along) {
            let here = self.sides(axis, left, along - HALF_LENGTH_PX..along + HALF_LENGTH_PX);
            if here.0 > GOES_ON * mean.0 && here.1 > GOES_ON * mean.1 {
                end = Some(along);
                missed = 0;
            } else {
                missed += 1;
            }
            along += STEP_PX;
        }
        end
    }

    /// Whether the middle between both sides is in the picture there; beyond its border nothing tells where they end.
    fn is_in_picture(&self, axis: Vector2<f64>, left: f64, along: f64) -> bool {
        let across = Vector2::new(-axis.y, axis.x);
        let middle = self.root + axis * along + across * (left + self.width_px / 2.0);
        let is_within = |v: f64, length: usize| (-1.0..=length as f64).contains(&v);
        self.channels.iter().all(|plane| is_within(middle.x, plane.width) && is_within(middle.y, plane.height))
    }

    /// Length of the two means whose difference is a step, px.
    fn step_px(&self) -> usize {
        (STEP_WIDTHS * self.width_px).round().max(LEAST_STEP_PX) as usize
    }

    /// How steep the weaker of both sides is where they are steepest, and the place of the left one, px across from the root.
    fn best_sides(&self, axis: Vector2<f64>, length_px: f64) -> (f64, f64) {
        let reach = (REACH_WIDTHS * self.width_px) as i32;
        let steps = self.steps(axis, -reach..reach, 0.0..length_px);
        let step = |t: i32| steps.get((t + reach) as usize).copied().unwrap_or(0.0);
        let width = self.width_px.round() as i32;
        let pairs = (-reach..reach - width).map(|t| (step(t).min(step(t + width)), f64::from(t)));
        pairs.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or_default()
    }

    /// How steep the two sides are over a part of the holder.
    fn sides(&self, axis: Vector2<f64>, left: f64, along: Range<f64>) -> (f64, f64) {
        let at = |t: f64| {
            let middle = t.round() as i32;
            let off = (OFF_WIDTHS * self.width_px).round().max(1.0) as i32;
            self.steps(axis, middle - off..middle + off + 1, along.clone()).into_iter().fold(0.0, f64::max)
        };
        (at(left), at(left + self.width_px))
    }

    /// How steep the colours are at every px across, as a mean over short lengths of the holder.
    fn steps(&self, axis: Vector2<f64>, across_px: Range<i32>, along: Range<f64>) -> Vec<f64> {
        let lengths = ((along.end - along.start) / MEAN_LENGTH_PX).round().max(1.0) as usize;
        let reach = self.step_px();
        let wider = across_px.start - reach as i32..across_px.end + reach as i32;
        let mut mean = vec![0.0; across_px.len()];
        for k in 0..lengths {
            let start = along.start + k as f64 * MEAN_LENGTH_PX;
            let sums = self.sums(axis, wider.clone(), start..start + MEAN_LENGTH_PX);
            for (t, value) in mean.iter_mut().enumerate() {
                // The mean colours on both sides of a place, which belongs to neither.
                let step = |sums: &Vec<f64>| {
                    let (before, after) = (sums[t + reach] - sums[t], sums[t + 2 * reach + 1] - sums[t + reach + 1]);
                    (after - before) / reach as f64
                };
                *value += sums.iter().map(|sums| step(sums).powi(2)).sum::<f64>().sqrt() / lengths as f64;
            }
        }
        mean
    }

    /// The mean colours over a part of the holder's length, of every channel, summed up to each px across: one more than those.
    fn sums(&self, axis: Vector2<f64>, across_px: Range<i32>, along: Range<f64>) -> Vec<Vec<f64>> {
        let across = Vector2::new(-axis.y, axis.x);
        let rows = (along.end - along.start).max(1.0).ceil();
        let mut line = vec![[0.0; LANES]; across_px.len().div_ceil(LANES)];
        let of_channel = |plane: &Plane| {
            let mut mean = vec![0.0; across_px.len()];
            for row in 0..rows as usize {
                let start = self.root + axis * (along.start + row as f64) + across * f64::from(across_px.start);
                plane.profile(&start, across, &mut line);
                mean.iter_mut().zip(line.as_flattened()).for_each(|(mean, value)| *mean += f64::from(*value) / rows);
            }
            let sums = mean.into_iter().scan(0.0, |sum, mean| {
                *sum += mean;
                Some(*sum)
            });
            std::iter::once(0.0).chain(sums).collect()
        };
        self.channels.iter().map(of_channel).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A dark holder from the bottom border of a picture of 300 × 240 px, turned by an angle, with thin lines along and across behind it.
    fn picture(turn_deg: f64, length_px: f64, width_px: f64) -> Colours {
        let (sin, cos) = turn_deg.to_radians().sin_cos();
        let value = |k: usize| {
            let (x, y) = ((k % 300) as f64 - 150.0, 239.0 - (k / 300) as f64);
            let (across, along) = (x * cos - y * sin, x * sin + y * cos);
            let is_line = k % 300 % 17 < 2 || k / 300 % 17 < 2;
            if across.abs() < width_px / 2.0 && along < length_px {
                60.0
            } else if is_line {
                140.0
            } else {
                200.0
            }
        };
        let plane = Plane::new(300, 240, (0..300 * 240).map(|k| value(k) as f32).collect());
        Colours { planes: vec![plane], is_without_squares: false }
    }

    #[test]
    fn the_holders_end_is_found_from_a_rough_place_of_it() {
        for (turn_deg, off_px) in [(0.0_f64, 0.0), (4.0, 8.0), (-3.0, -10.0)] {
            let colours = picture(turn_deg, 90.0, 60.0);
            // Rough: seen too narrow, to one side, with no direction.
            let root = Point2::new(150.0 + off_px, 239.0);
            let holder = Holder { root, axis: -Vector2::y(), width_px: 44.0 };
            let start = find_start(&colours, &holder, 60.0).unwrap();
            let (sin, cos) = turn_deg.to_radians().sin_cos();
            let expected = Point2::new(150.0 + 90.0 * sin, 239.0 - 90.0 * cos);
            assert!((start.base - expected).norm() < 5.0, "{start:?} for {expected}");
            // The fit of the base searches 14 px first: 2° over 400 px of snake.
            assert!(start.axis.angle(&Vector2::new(sin, -cos)).to_degrees() < 2.0, "{start:?}");
        }
    }

    /// From the tip's end of a snake whose holder the border cuts, the sides are followed to the border and no further.
    #[test]
    fn sides_that_the_border_cuts_end_there() {
        let colours = picture(0.0, 150.0, 60.0);
        let holder = Holder { root: Point2::new(150.0, 95.0), axis: Vector2::y(), width_px: 60.0 };
        let start = find_start(&colours, &holder, 60.0).unwrap();
        assert!((start.base.y - 239.0).abs() < 5.0, "{start:?}");
    }

    #[test]
    fn a_holder_that_is_hardly_in_the_picture_is_not_taken() {
        let colours = picture(0.0, 20.0, 60.0);
        let holder = Holder { root: Point2::new(150.0, 239.0), axis: -Vector2::y(), width_px: 60.0 };
        assert_eq!(find_start(&colours, &holder, 60.0).unwrap_err(), RigError::NoHolder { width_px: 60.0 });
    }
}
