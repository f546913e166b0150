//! Finds the straight snake before a sheet whose scale is known: a matched filter of the body's silhouette.
//!
//! The picture is looked at in cells a fraction of the snake's width wide. How unlike the sheet a cell's colour is, is a number between 0
//! and 1; the silhouette of the straight robot is another. For every place of the base and every direction the correlation r of the two over
//! the silhouette and its surroundings tells how well two levels, one on the body and one beside it, explain the cells: n cells gain
//! −n/2 ln(1 − r²) of log-likelihood over a single level. Ink, clamps, table and shadows are unlike the sheet as well, but not of this form.
//! Below the base the silhouette has a piece of the holder, and nothing is asked of what lies further down.

use super::body_template::{BELOW, BodyTemplate, Cell};
use super::unlike::Unlike;
use crate::camera::Frame;
use crate::measure::target::PictureRegion;
use nalgebra::{Point2, Vector2};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Cells across the snake's width in the first search, of all places.
///
/// Convention: a limit of time, which goes with the fourth power; the body is still two cells wide, and what it finds is only looked at again.
const FIRST_CELLS: f64 = 2.0;
/// How many places are looked at again in each direction.
///
/// Convention: a limit of time; twice as many as are gone on from in all.
const MOST_PLACES: usize = 16;
/// Cells across the snake's width in the second search, around the places that the first one found.
///
/// Derived: the disks of the paper's robot are 0.9 widths apart; four cells show them as waves. With three, which takes a third of the time, a snake of
/// thirty photo-real rigs is lost beside its shadow.
const COARSE_CELLS: f64 = 4.0;
/// Cells across the snake's width in the refinement of what that search finds: while it is turned and moved in coarse steps, and in single ones.
///
/// Derived: the disks of the paper's robot are 0.9 widths apart; twelve cells show each. The coarse steps along and across are as long as six are.
const REFINEMENT_CELLS: [f64; 2] = [6.0, 12.0];
/// Directions that are searched.
///
/// Derived: 6° apart; half of that moves the tip, six widths away, by 0.3 widths.
const DIRECTIONS: usize = 60;
/// What is covered on either side of the body's axis and beyond its tip, in widths.
///
/// Convention: half of its width, and a fifth of that more for blur.
const COVERED: f64 = 0.6;
/// The least share of the strip that must be in the picture, on the sheet.
///
/// Convention: a majority.
const LEAST_SEEN: f64 = 0.55;
/// How many findings are refined.
///
/// Convention: a limit of time.
const MOST_FOUND: usize = 8;
/// The least distance between two findings of nearly one direction, in widths.
///
/// Convention: closer ones lead to the same refinement.
const APART_WIDTHS: f64 = 0.75;
/// The angle up to which two findings have nearly one direction, rad.
///
/// Convention: three and a third of the steps in which directions are searched; closer ones lead to the same refinement.
const APART_RAD: f64 = 0.35;
/// Refined findings closer than this, in widths, are one.
///
/// Convention: what the fit of the base searches is wider.
const SAME_WIDTHS: f64 = 0.2;
/// How far a finding is refined: rad, and widths along and across, in steps.
///
/// Derived: half the distance of the directions and more; along, a disk's distance to either side; across, a coarse cell and more.
const TURNS: (f64, i32) = (0.07, 5);
const ALONG_WIDTHS: (f64, i32) = (1.0, 12);
const ACROSS_WIDTHS: (f64, i32) = (0.42, 5);
/// The least variance of how unlike the sheet the cells of a strip are.
///
/// Convention: a tenth of the range, squared; a blank sheet's cells scatter by less, and show nothing.
const LEAST_SCATTER: f64 = 0.01;
/// Where a straight snake was found.
#[derive(Debug, Clone, Copy)]
pub struct SnakeStart {
    /// Middle of the base disk's upper face, px.
    pub base: Point2<f64>,
    /// Direction from the holder to the tip, in the picture.
    pub axis: Vector2<f64>,
    /// How well a snake there explains what is seen.
    pub fit: StripFit,
}

/// How well two levels, one on the body and one beside it, explain a strip's cells.
#[derive(Debug, Clone, Copy, Default)]
pub struct StripFit {
    /// By how much log-likelihood better than one level, where each cell counts once, however large.
    pub gain: f64,
    /// The share of the cells' variance that they explain: r².
    pub share: f64,
    /// The squares that they explain, summed over the strip's area, px²: how much of the picture that is.
    pub squares_px2: f64,
}

impl SnakeStart {
    /// Whether another start leads to the same refinement: no further away than that, px, and in nearly one direction.
    fn is_near(&self, other: &Self, apart_px: f64) -> bool {
        (other.base - self.base).norm() <= apart_px && other.axis.angle(&self.axis) <= APART_RAD
    }

    /// Whether another start leads to the same fit of a base that is so many px wide.
    pub fn is_same(&self, other: &Self, width_px: f64) -> bool {
        self.is_near(other, SAME_WIDTHS * width_px)
    }

    /// The corners of the strip around a body here that is so many px wide: holder left and right, tip right and left.
    pub fn strip(&self, template: &BodyTemplate, width_px: f64) -> [Point2<f64>; 4] {
        self.corners([-BELOW, template.length_widths], 0.5, width_px)
    }

    /// What a body here that is so many px wide covers at most: its strip and a little around it, and the holder below for as far as it may go.
    pub fn covered(&self, template: &BodyTemplate, width_px: f64) -> PictureRegion {
        let tip = template.length_widths + COVERED;
        PictureRegion::around(self.corners([-tip, tip], COVERED, width_px))
    }

    /// The corners of a rectangle along the body, from and to so many widths from the base and so many to either side.
    fn corners(&self, [from, to]: [f64; 2], beside: f64, width_px: f64) -> [Point2<f64>; 4] {
        let across = Vector2::new(-self.axis.y, self.axis.x);
        let at = |along: f64, aside: f64| self.base + (self.axis * along + across * aside) * width_px;
        [at(from, -beside), at(from, beside), at(to, beside), at(to, -beside)]
    }
}

/// Sums over the cells of a strip that show the sheet's part of the picture, from which the correlation of silhouette and picture follows:
/// of one, of the body's share and its square, of how unlike the sheet they are and its square, and of the product of both.
type Sums = [f32; 6];

/// How well two levels explain a strip of so many cells, each of an area (px²). The body's level must be the more unlike one.
fn strip_fit(sums: Sums, of: usize, cell_px2: f64) -> StripFit {
    let [n, body, body2, seen, seen2, both] = sums.map(f64::from);
    if n < LEAST_SEEN * of as f64 {
        return StripFit::default();
    }
    let covariance = both - body * seen / n;
    let scatter = (seen2 - seen * seen / n).max(LEAST_SCATTER * n);
    let r2 = covariance * covariance / ((body2 - body * body / n).max(f64::MIN_POSITIVE) * scatter);
    let r2 = if covariance > 0.0 { r2.min(1.0 - 1e-9) } else { 0.0 };
    StripFit { gain: -0.5 * n * (1.0 - r2).ln(), share: r2, squares_px2: r2 * scatter * cell_px2 }
}

/// The same of a strip's cells: the moments of each, and the share that the body covers.
fn fit_over(cells: impl ExactSizeIterator<Item = ([f32; 3], f32)>, cell_px2: f64) -> StripFit {
    let (mut sums, of) = (Sums::default(), cells.len());
    for ([shown, seen, seen2], body) in cells {
        let terms = [shown, body * shown, body * body * shown, seen, seen2, body * seen];
        sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
    }
    strip_fit(sums, of, cell_px2)
}

/// Where a straight snake, so many px wide, may be before the part of a picture that shows the sheet, roughly, in directions that are asked
/// for; the likeliest first.
pub fn search_everywhere(
    frame: &Frame,
    template: &BodyTemplate,
    width_px: f64,
    region: &PictureRegion,
    is_asked: impl Fn(&Vector2<f64>) -> bool + Sync,
) -> Vec<SnakeStart> {
    let [first, second] = [FIRST_CELLS, COARSE_CELLS]
        .map(|per_width| (Unlike::of(frame, width_px / per_width, region), template.cells(per_width)));
    let axis = |k: usize| {
        let direction = TAU * k as f64 / DIRECTIONS as f64;
        Vector2::new(direction.sin(), -direction.cos())
    };
    let found = |axis: Vector2<f64>| {
        let places = in_direction(&first.0, &offsets(&first.1, axis, FIRST_CELLS), axis);
        let offsets = offsets(&second.1, axis, COARSE_CELLS);
        places.into_iter().map(|place| best_around(&second.0, &offsets, place)).collect::<Vec<_>>()
    };
    let asked = (0..DIRECTIONS).into_par_iter().map(axis).filter(|axis| is_asked(axis));
    let mut all: Vec<SnakeStart> = asked.flat_map_iter(found).collect();
    all.sort_by(|a, b| b.fit.gain.total_cmp(&a.fit.gain));
    distinct(all, APART_WIDTHS * width_px)
}

/// The same places, each moved to where the snake fits best in fine cells; the likeliest first.
pub fn search_nearby(
    frame: &Frame,
    template: &BodyTemplate,
    width_px: f64,
    region: &PictureRegion,
    found: &[SnakeStart],
) -> Vec<SnakeStart> {
    let levels =
        REFINEMENT_CELLS.map(|per_width| (Unlike::of(frame, width_px / per_width, region), template.cells(per_width)));
    let mut all: Vec<SnakeStart> = found.par_iter().map(|start| refined(&levels, width_px, start)).collect();
    all.sort_by(|a, b| b.fit.gain.total_cmp(&a.fit.gain));
    distinct(all, SAME_WIDTHS * width_px)
}

/// The first of several places that are closer than this, px, and seen from nearly one direction; no more than are gone on from.
fn distinct(sorted: Vec<SnakeStart>, apart_px: f64) -> Vec<SnakeStart> {
    let mut found: Vec<SnakeStart> = Vec::new();
    for start in sorted {
        if found.len() < MOST_FOUND && found.iter().all(|other| !other.is_near(&start, apart_px)) {
            found.push(start);
        }
    }
    found
}

/// The cells of a strip in one direction, counted from that of its base, and the share of each that the body covers.
fn offsets(cells: &[Cell], axis: Vector2<f64>, per_width: f64) -> Vec<(i64, i64, f32)> {
    let across = Vector2::new(-axis.y, axis.x);
    let offset = |cell: &Cell| {
        let off = (axis * cell.along + across * cell.across) * per_width;
        (off.x.round() as i64, off.y.round() as i64, cell.body)
    };
    cells.iter().map(offset).collect()
}

/// The best place for a base among the cells within half a width of one, all in its direction.
fn best_around(unlike: &Unlike, offsets: &[(i64, i64, f32)], place: SnakeStart) -> SnakeStart {
    let [x0, y0] = unlike.cell_of(&place.base);
    let reach = (0.5 * COARSE_CELLS) as i64;
    let around = (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (x0 + dx, y0 + dy)));
    let at = |(x, y): (i64, i64)| {
        let cells = offsets.iter().map(|&(dx, dy, body)| (unlike.cell(x + dx, y + dy), body));
        SnakeStart { base: unlike.middle(x, y), fit: fit_over(cells, unlike.cell_px.powi(2)), ..place }
    };
    let none = SnakeStart { fit: StripFit::default(), ..place };
    around.map(at).fold(none, |best, other| if other.fit.gain > best.fit.gain { other } else { best })
}

/// The best places in one direction: every local maximum of the gain over the cells that stands out from its neighbours.
fn in_direction(unlike: &Unlike, offsets: &[(i64, i64, f32)], axis: Vector2<f64>) -> Vec<SnakeStart> {
    let (width, height) = (unlike.width as i64, unlike.height as i64);
    let mut sums: [Vec<f32>; 6] = std::array::from_fn(|_| vec![0.0; (width * height) as usize]);
    for &(dx, dy, body) in offsets {
        for y in 0.max(-dy)..height.min(height - dy) {
            let columns = 0.max(-dx)..width.min(width - dx);
            if columns.is_empty() {
                continue;
            }
            let count = (columns.end - columns.start) as usize;
            let into = (y * width + columns.start) as usize;
            let from = ((y + dy) * width + columns.start + dx) as usize;
            let add = |into: &mut [f32], values: &[f32], by: f32| {
                into.iter_mut().zip(values).for_each(|(sum, value)| *sum += by * value);
            };
            let [shown, seen, seen2] = unlike.moments.each_ref().map(|moment| &moment[from..][..count]);
            let rows = sums.each_mut().map(|sum| &mut sum[into..][..count]);
            for (row, (values, by)) in rows.into_iter().zip([
                (shown, 1.0),
                (shown, body),
                (shown, body * body),
                (seen, 1.0),
                (seen2, 1.0),
                (seen, body),
            ]) {
                add(row, values, by);
            }
        }
    }
    let cell_px2 = unlike.cell_px.powi(2);
    let fit_at = |k: usize| strip_fit(sums.each_ref().map(|sum| sum[k]), offsets.len(), cell_px2);
    let fits: Vec<StripFit> = (0..(width * height) as usize).map(fit_at).collect();
    let at = |x: i64, y: i64| {
        let is_inside = (0..width).contains(&x) && (0..height).contains(&y);
        if is_inside { fits[(y * width + x) as usize] } else { StripFit::default() }
    };
    let mut places: Vec<SnakeStart> = Vec::new();
    for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
        let fit = at(x, y);
        let is_peak = fit.gain > 0.0 && (-1..=1).all(|dy| (-1..=1).all(|dx| at(x + dx, y + dy).gain <= fit.gain));
        if is_peak {
            places.push(SnakeStart { base: unlike.middle(x, y), axis, fit });
        }
    }
    places.sort_by(|a, b| b.fit.gain.total_cmp(&a.fit.gain));
    places.truncate(MOST_PLACES);
    places
}

/// The best of all starts around one, first turned and moved in coarse steps over the coarser cells, then in the single ones around the best.
fn refined(levels: &[(Unlike, Vec<Cell>); 2], width_px: f64, start: &SnakeStart) -> SnakeStart {
    let coarse = best_turned(&levels[0], width_px, *start, [TURNS, ALONG_WIDTHS, ACROSS_WIDTHS], 2);
    let single = |(reach, count): (f64, i32)| (2.0 * reach / f64::from(count), 2);
    best_turned(&levels[1], width_px, coarse, [TURNS, ALONG_WIDTHS, ACROSS_WIDTHS].map(single), 1)
}

/// The best of the starts around one over some cells: turned, and moved along and across, each as far and in as many steps as told, of which every
/// so many is tried.
fn best_turned(
    (unlike, cells): &(Unlike, Vec<Cell>),
    width_px: f64,
    from: SnakeStart,
    [turns, along, across]: [(f64, i32); 3],
    every: i32,
) -> SnakeStart {
    let steps = |(reach, count): (f64, i32)| {
        (-count..=count).filter(move |k| k % every == 0).map(move |k| reach * f64::from(k) / f64::from(count))
    };
    let at = |base: Point2<f64>, axis: Vector2<f64>| {
        let across = Vector2::new(-axis.y, axis.x);
        let place = |cell: &Cell| base + (axis * cell.along + across * cell.across) * width_px;
        let cells = cells.iter().map(|cell| (unlike.at(&place(cell)), cell.body));
        SnakeStart { base, axis, fit: fit_over(cells, unlike.cell_px.powi(2)) }
    };
    let mut best = at(from.base, from.axis);
    for turn in steps(turns) {
        let axis = (from.axis + Vector2::new(-from.axis.y, from.axis.x) * turn).normalize();
        for (by_along, by_across) in steps(along).flat_map(|a| steps(across).map(move |b| (a, b))) {
            let base = from.base + (axis * by_along + Vector2::new(-axis.y, axis.x) * by_across) * width_px;
            let other = at(base, axis);
            if other.fit.gain > best.fit.gain {
                best = other;
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::super::body_template::DRAWN_WIDTH_PX;
    use super::*;
    use crate::camera::Samples;
    use crate::robot::Robot;

    /// A picture of grey paper on which the silhouette of a straight robot, so many px wide, is drawn at a place and in a direction, beside a
    /// blot and a clamp at the lower border.
    fn picture(robot: &Robot, width_px: f64, base: Point2<f64>, direction_deg: f64) -> Frame {
        let template = BodyTemplate::of(robot);
        let (sin, cos) = direction_deg.to_radians().sin_cos();
        let axis = Vector2::new(sin, -cos);
        let across = Vector2::new(-axis.y, axis.x);
        let (width, height) = (640_u32, 480_u32);
        let level = |k: u32| {
            let at = Point2::new(f64::from(k % width), f64::from(k / width));
            let off = (at - base) / width_px;
            let drawn = template.base + Vector2::new(across.dot(&off), -axis.dot(&off)) * DRAWN_WIDTH_PX;
            let is_in = drawn.x > 1.0 && drawn.x < template.drawn.width as f64 - 2.0 && drawn.y > 1.0;
            let is_body = is_in && template.drawn.sample(&drawn) > 0.5;
            let is_blot = (at - Point2::new(120.0, 100.0)).norm() < 45.0;
            let is_clamp = at.y > 440.0 && (at.x - base.x).abs() < 90.0;
            let noise = (k.wrapping_mul(2_654_435_761) >> 28) as u8;
            let paper = if k % 17 < 2 || k / width % 17 < 2 { 150 } else { 190 };
            noise
                + if is_body {
                    60
                } else if is_blot || is_clamp {
                    30
                } else {
                    paper
                }
        };
        Frame { width, height, channels: 1, samples: Samples::Bits8((0..width * height).map(level).collect()) }
    }

    #[test]
    fn the_straight_snake_is_found_beside_a_blot_and_a_clamp() {
        let robot = Robot::default();
        let template = BodyTemplate::of(&robot);
        let whole = [(-1.0, -1.0), (640.0, -1.0), (640.0, 480.0), (-1.0, 480.0)];
        let region = PictureRegion::around(whole.map(|(x, y)| Point2::new(x, y)));
        for (direction_deg, base) in [(0.0, Point2::new(330.0, 360.0)), (14.0, Point2::new(280.0, 350.0))] {
            let frame = picture(&robot, 40.0, base, direction_deg);
            let found = search_everywhere(&frame, &template, 40.0, &region, |_| true);
            let start = search_nearby(&frame, &template, 40.0, &region, &found).remove(0);
            assert!((start.base - base).norm() < 6.0, "{start:?} for {base}");
            let (sin, cos) = f64::to_radians(direction_deg).sin_cos();
            assert!(start.axis.angle(&Vector2::new(sin, -cos)).to_degrees() < 1.5, "{start:?}");
            assert!(start.fit.share > 0.5, "{start:?}");
        }
    }
}
