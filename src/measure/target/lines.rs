//! The printed lines themselves, or the borders of a checkerboard's squares, placed one by one once a pose tells where to look.
//!
//! The waves average over windows that cannot reach the picture's border and that shadows and the snake cut into; the
//! lines are seen everywhere, and each place of each line is a measurement of its own. Large squares have few waves in a picture, which its light
//! then shifts; their borders are as sharp as those of small ones.

use super::pattern::PatternKind;
use super::sheet::{Sheet, SheetShape};
use super::sheet_fit::{SeenPlace, SheetFit, fit_distances};
use crate::camera::Lens;
use crate::measure::image::plane::Plane;
use crate::statistics::order::median;
use nalgebra::{Point2, Vector2};
use rayon::prelude::*;
use std::ops::RangeInclusive;

/// How far from its place, in pitches, a line is searched for.
///
/// Fitted: by hand on the project's renders (tests/eye/robustness): more than the waves are off, less than the way to the next line's flank.
const SEARCH: f64 = 0.15;
/// Most scatter of lines' places, in pitches.
///
/// Derived: places at random within ±[`SEARCH`] scatter by SEARCH/√3 = 0.087 pitches; half of that is as much line as chance.
pub(super) const MOST_SCATTER: f64 = 0.044;
/// Distance between the samples across a line, px.
///
/// Convention: half a pixel, which bilinear samples resolve.
const STEP_PX: f64 = 0.5;
/// Half width of the difference that finds a line's middle or a border, in pitches, and the least, px.
///
/// Convention: lines are a tenth of a pitch to a fifth wide, blurred ones more, and none is seen thinner than two pixels.
const HALF_WIDTH: f64 = 0.1;
const LEAST_HALF_WIDTH_PX: f64 = 2.0;
/// Every other line is missing where it is less dark, on the mean, than this share of the ones beside.
///
/// Convention: it lies between chance and equal lines. By chance a mean over hundreds of places is some hundredths.
const MISSING: f64 = 0.2;
/// There are further lines where what lies half way between lines is darker than this share of them.
///
/// Derived: of equal lines with heavier ones every 5 and 10 of them half way is 0.85 as dark; fainter ones are a finer ruling of the same sheet.
const BETWEEN: f64 = 0.7;
/// Half length of the mean along a line, in pitches: it stops short of the lines that cross it half a pitch away.
///
/// Convention: long against noise; the crossing lines, half a pitch away, may be 0.3 pitches wide.
const HALF_LENGTH: f64 = 0.35;
/// The picture's margin in which no line is looked for, px.
///
/// Convention: the profile across a line needs as much.
const MARGIN_PX: f64 = 3.0;
/// More lines than this in one direction are not a grid that can be seen.
///
/// Convention: a limit of resources; 2000 lines in a picture of 4000 px are 2 px apart.
const MOST_LINES: f64 = 2000.0;
/// Fewest places of lines to which a pose is fitted.
///
/// Convention: a pose has 6 parameters, and the grids of real pictures thousands of places.
const FEWEST_PLACES: usize = 50;
/// How many neighbouring places count as one: they share their line's printing errors.
///
/// Fitted: by hand on the project's renders, with the rotation's normalised errors in tests/eye/uncertainty; not judged elsewhere.
const DESIGN_EFFECT: f64 = 10.0;
/// The step along a line by which its direction in the picture is told, pitches.
///
/// Convention: short enough that the lens does not bend it.
const ALONG: f64 = 0.3;

/// Where only means over all lines are asked for, so many places along each line are looked at.
///
/// Convention: a limit of time; the means are over hundreds of places.
const SAMPLED: usize = 20;

/// Looks for lines, or the borders of squares, in a picture.
pub(super) struct Lines<'a> {
    pub plane: &'a Plane,
    pub lens: &'a Lens,
    pub kind: PatternKind,
    pub pitch_mm: f64,
}

/// A place on a printed line: where it is on the target, where it was seen, and the line's normal in the picture.
struct LinePlace {
    target_mm: Point2<f64>,
    seen: Point2<f64>,
    normal: Vector2<f64>,
    /// How much darker it is than its surroundings; negative if lighter. At a border of squares the step from one to the other, of one sign on the
    /// whole sheet.
    darkness: f64,
    /// 1, or −1 at a border of squares at which the step has the other sign along the normal.
    side: f64,
    /// The axis that its line is square to, and the line's number.
    axis: usize,
    line: i64,
}

impl Lines<'_> {
    /// Fits the sheet to the lines' places, looked for where a sheet that is nearly right puts them. A sheet of lines is counted from where two of
    /// them cross, one of squares from the middle of one.
    pub fn fit_sheet(&self, start: &Sheet) -> Option<SheetFit> {
        let to_line = match self.kind {
            PatternKind::Lines => Vector2::zeros(),
            PatternKind::Checkerboard => Vector2::repeat(self.pitch_mm / 2.0),
        };
        let start = start.counted_from(to_line);
        let places = of_one_kind(self.places(&start, None)?)?;
        let fit = self.fit_places(&places, &start, 0.0)?;
        let fit = match self.kind {
            PatternKind::Lines => fit,
            PatternKind::Checkerboard => {
                let spread_px = self.spread_px(&places, &fit.sheet);
                self.fit_places(&places, &fit.sheet, spread_px)?
            }
        };
        Some(SheetFit { sheet: fit.sheet.counted_from(-to_line), ..fit })
    }

    /// Fits the sheet to places, of which those at borders are displaced by so much to the side of the squares whose step is negative.
    fn fit_places(&self, places: &[LinePlace], start: &Sheet, spread_px: f64) -> Option<SheetFit> {
        let place = |place: &LinePlace| {
            let along = place.normal.transpose();
            let seen = place.seen - place.normal * (place.side * spread_px);
            SeenPlace { lattice_mm: place.target_mm, seen, along }
        };
        let places: Vec<_> = places.iter().map(place).collect();
        fit_distances(self.lens, &places, start, DESIGN_EFFECT)
    }

    /// How far the borders of a sheet are displaced from one kind of squares to the other, px (the median): ink spreads, and so does light that
    /// is too much for the sensor.
    fn spread_px(&self, places: &[LinePlace], sheet: &Sheet) -> f64 {
        let displaced = |place: &LinePlace| {
            place.side * place.normal.dot(&(place.seen - sheet.project(self.lens, &place.target_mm)))
        };
        median(&mut places.iter().map(displaced).collect::<Vec<f64>>())
    }

    /// The waves' crests are the lines if these are light, and half way between them if they are dark. Lines are the
    /// narrower of the two, so the place with the stronger second difference tells.
    pub fn put_origin_on_a_line(&self, sheet: &Sheet) -> Option<Sheet> {
        let shifted = |by: f64| sheet.counted_from(Vector2::new(by, by) * self.pitch_mm);
        let sharpness = |sheet: &Sheet| -> Option<f64> {
            let places = self.places(sheet, Some(SAMPLED))?;
            Some((places.iter().map(|place| place.darkness).sum::<f64>() / places.len().max(1) as f64).abs())
        };
        let (crest, trough) = (shifted(0.0), shifted(0.5));
        Some(if sharpness(&crest)? > sharpness(&trough)? { crest } else { trough })
    }

    /// The distance of the lines, in pitches, if every other one is missing (2), or there are as many between (½).
    pub fn other_ruling(&self, sheet: &Sheet) -> Option<f64> {
        // Along each axis the mean of lines of even numbers and of odd ones.
        let darkness = |sheet: &Sheet| -> Option<[[f64; 2]; 2]> {
            let mut sums = [[(0.0, 0.0); 2]; 2];
            for place in self.places(sheet, Some(SAMPLED))? {
                let (sum, count) = &mut sums[place.axis][place.line.rem_euclid(2) as usize];
                *sum += place.darkness;
                *count += 1.0;
            }
            Some(sums.map(|axis| axis.map(|(sum, count)| sum / f64::max(count, 1.0))))
        };
        let sheet = &self.put_origin_on_a_line(sheet)?;
        let lines = darkness(sheet)?;
        let total: f64 = lines.as_flattened().iter().sum();
        let half_way = sheet.counted_from(Vector2::new(0.5, 0.5) * self.pitch_mm);
        let between: f64 = darkness(&half_way)?.as_flattened().iter().sum();
        let is_missing = |[even, odd]: &[f64; 2]| {
            let (even, odd) = (even * total.signum(), odd * total.signum());
            even.min(odd) < MISSING * even.max(odd)
        };
        if lines.iter().all(is_missing) {
            Some(2.0)
        } else {
            (between * total.signum() > BETWEEN * total.abs()).then_some(0.5)
        }
    }

    /// Looks at every line of both directions, in the middle between lines that cross it: all of them, or about so many.
    fn places(&self, sheet: &Sheet, most: Option<usize>) -> Option<Vec<LinePlace>> {
        let lines = self.lines_in_view(sheet)?;
        let of_line = |axis: usize, line: i64| {
            let crossing = lines[1 - axis].clone();
            let every = most.map_or(1, |most| crossing.clone().count() / most).max(1);
            crossing.step_by(every).filter_map(move |between| self.place(sheet, axis, [line, between]))
        };
        let all: Vec<(usize, i64)> =
            (0..2).flat_map(|axis| lines[axis].clone().map(move |line| (axis, line))).collect();
        Some(all.into_par_iter().flat_map_iter(|(axis, line)| of_line(axis, line)).collect())
    }

    /// The lines square to each of the target's axes that may be in the picture; `None` where they are too many.
    fn lines_in_view(&self, sheet: &Sheet) -> Option<[RangeInclusive<i64>; 2]> {
        let size = Vector2::new(self.plane.width as f64 - 1.0, self.plane.height as f64 - 1.0);
        let window_mm = self.kind.window_radius() * self.kind.wavelength() * self.pitch_mm;
        let mut reach = [(f64::MAX, f64::MIN); 2];
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            let place_mm = sheet.place_at(self.lens, &Point2::new(x * size.x, y * size.y))?;
            for axis in 0..2 {
                // The sheet ends where the last windows saw it, or soon after.
                let half_mm = sheet.shape.half_mm[axis];
                let end = (SheetShape::BEYOND * half_mm).max(half_mm + window_mm);
                let place_mm =
                    (place_mm[axis] - sheet.shape.centre_mm[axis]).clamp(-end, end) + sheet.shape.centre_mm[axis];
                let line = place_mm / self.pitch_mm;
                reach[axis] = (reach[axis].0.min(line), reach[axis].1.max(line));
            }
        }
        let few = reach.iter().all(|(low, high)| high - low <= MOST_LINES);
        few.then(|| reach.map(|(low, high)| (low.ceil() as i64)..=(high.floor() as i64)))
    }

    /// The line of a number square to an axis, half a pitch behind a crossing line of a number, where the picture shows it there.
    fn place(&self, sheet: &Sheet, axis: usize, [line, crossing]: [i64; 2]) -> Option<LinePlace> {
        let mut target_mm = Point2::origin();
        target_mm[axis] = line as f64 * self.pitch_mm;
        target_mm[1 - axis] = (crossing as f64 + 0.5) * self.pitch_mm;
        let pixel = sheet.project(self.lens, &target_mm);
        if !self.lens.contains(&pixel, MARGIN_PX) {
            return None;
        }
        let mut ahead = target_mm;
        ahead[1 - axis] += ALONG * self.pitch_mm;
        let along = (sheet.project(self.lens, &ahead) - pixel) / ALONG;
        let (found, seen, normal) = found_across(self.plane, self.kind, &pixel, along)?;
        // From square to square along a line the step across it changes its sign, and seen along both axes one turns the other way.
        let is_turned = self.kind == PatternKind::Checkerboard && (line + crossing + axis as i64).rem_euclid(2) == 1;
        let side = if is_turned { -1.0 } else { 1.0 };
        Some(LinePlace { target_mm, seen, normal, darkness: side * found, side, axis, line })
    }
}

/// The middle of the darkest or lightest stripe near a pixel, or of squares the highest step, along a vector of one pitch: how much darker than its
/// surroundings it is, or how high, its place and the line's normal.
fn found_across(
    plane: &Plane,
    kind: PatternKind,
    pixel: &Point2<f64>,
    along: Vector2<f64>,
) -> Option<(f64, Point2<f64>, Vector2<f64>)> {
    let pitch_px = along.norm();
    let direction = along / pitch_px;
    let normal = Vector2::new(-direction.y, direction.x);
    let search = (SEARCH * pitch_px / STEP_PX).ceil() as i64;
    let half_width = ((HALF_WIDTH * pitch_px).max(LEAST_HALF_WIDTH_PX) / STEP_PX).round() as usize;
    let reach = search + half_width as i64 + 2;
    let rows = (HALF_LENGTH * pitch_px).floor() as i64;
    let profile: Vec<f64> = (-reach..=reach)
        .map(|k| {
            let centre = pixel + normal * (k as f64 * STEP_PX);
            let sum: f64 = (-rows..=rows).map(|r| f64::from(plane.sample(&(centre + direction * r as f64)))).sum();
            sum / (2 * rows + 1) as f64
        })
        .collect();
    let difference = |k: usize| match kind {
        // A second difference about as wide as a line finds its middle whatever the target's slope of brightness.
        PatternKind::Lines => profile[k - half_width] + profile[k + half_width] - 2.0 * profile[k],
        // The means of both sides differ most at the step.
        PatternKind::Checkerboard => {
            (1..=half_width).map(|j| profile[k + j] - profile[k - j]).sum::<f64>() / half_width as f64
        }
    };
    let smooth = |k: usize| difference(k - 1) + 2.0 * difference(k) + difference(k + 1);
    let inner = half_width + 2..profile.len().saturating_sub(half_width + 2);
    let best = inner.clone().max_by(|&a, &b| smooth(a).abs().total_cmp(&smooth(b).abs()))?;
    if best == inner.start || best + 1 == inner.end {
        return None;
    }
    let (before, at, after) = (smooth(best - 1), smooth(best), smooth(best + 1));
    let bow = 2.0 * at - before - after;
    let vertex = if bow == 0.0 { return None } else { 0.5 * (after - before) / bow };
    let offset = (best as f64 + vertex.clamp(-1.0, 1.0) - reach as f64) * STEP_PX;
    Some((at, pixel + normal * offset, normal))
}

/// Lines are dark on a light target or light on a dark one; most places tell which, and the others saw something else.
fn of_one_kind(found: Vec<LinePlace>) -> Option<Vec<LinePlace>> {
    let is_dark = found.iter().map(|place| place.darkness).sum::<f64>() > 0.0;
    let places: Vec<LinePlace> = found.into_iter().filter(|place| (place.darkness > 0.0) == is_dark).collect();
    (places.len() >= FEWEST_PLACES).then_some(places)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Pose, perturbed};
    use crate::measure::target::phases::tests::noisy;
    use nalgebra::{Matrix2, Vector6};

    /// A sheet whose grey follows from the pixel, the place of the sheet that it shows and that place's gradient.
    fn drawn(lens: &Lens, sheet: &Sheet, grey: impl Fn(Point2<f64>, Point2<f64>, Matrix2<f64>) -> f64) -> Plane {
        let (width, height) = (lens.width as usize, lens.height as usize);
        let value = |k: usize| {
            let pixel = Point2::new((k % width) as f64, (k / width) as f64);
            let (place, gradient) = sheet.at(lens, &pixel).unwrap();
            grey(pixel, place, gradient) as f32
        };
        Plane::new(width, height, (0..width * height).map(value).collect())
    }

    /// Lines 2 px wide (σ 0.8 px) in both directions, `sign` times 60 from grey 150, so many mm apart on a sheet.
    fn ruled(lens: &Lens, sheet: &Sheet, sign: f64, every: f64) -> Plane {
        drawn(lens, sheet, |_, place, gradient| {
            let line = |axis: usize| {
                let distance_px = (place[axis] - every * (place[axis] / every).round()) / gradient.row(axis).norm();
                (-0.5 * (distance_px / 0.8).powi(2)).exp()
            };
            150.0 + sign * 60.0 * line(0).max(line(1))
        })
    }

    /// A lens of 400 × 300 px, and a sheet that fills its picture.
    fn lens_and_sheet() -> (Lens, Sheet) {
        let mut lens = crate::simulate::scene::Scene::default().lens;
        (lens.width, lens.height) = (400, 300);
        lens.focal_px = [4000.0, 4000.0].into();
        lens.centre_px = [199.5, 149.5].into();
        let pose = perturbed(&Pose::translation(-2.0, 1.0, 250.0), &Vector6::new(0.05, -0.08, 0.1, 0.0, 0.0, 0.0));
        let shape =
            SheetShape { half_mm: Vector2::new(12.0, 9.0), centre_mm: Point2::new(2.0, -1.0), ..SheetShape::default() };
        (lens, Sheet { camera_from_grid: pose, shape })
    }

    #[test]
    fn lines_give_their_sheet_whether_dark_or_light_and_the_origin_comes_to_lie_on_one() {
        let (lens, sheet) = lens_and_sheet();
        for sign in [-1.0, 1.0] {
            let plane = noisy(ruled(&lens, &sheet, sign, 1.0), 3.0, 1);
            let lines = Lines { plane: &plane, lens: &lens, kind: PatternKind::Lines, pitch_mm: 1.0 };
            // Off by half a pitch along both axes, as the waves leave it.
            for start in [sheet.clone(), sheet.counted_from(Vector2::new(0.5, 0.5))] {
                let start = lines.put_origin_on_a_line(&start).unwrap();
                let near = Vector6::new(1e-4, -1e-4, 1e-4, 0.03, -0.02, 0.1);
                let near = Sheet { camera_from_grid: perturbed(&start.camera_from_grid, &near), ..start };
                let fit = lines.fit_sheet(&near).and_then(|fit| lines.fit_sheet(&fit.sheet)).unwrap();
                // The places of the truth's lattice are on the lines of the one that was found.
                for place in [Point2::new(0.0, 0.0), Point2::new(5.0, 4.0), Point2::new(-4.0, -6.0)] {
                    let (found, _) = fit.sheet.at(&lens, &sheet.project(&lens, &place)).unwrap();
                    assert!((found - found.map(f64::round)).norm() < 0.01, "{found}");
                }
                let turn = fit.sheet.camera_from_grid.rotation * sheet.camera_from_grid.rotation.inverse();
                for axis in 0..3 {
                    let sigma = fit.turn_covariance[(axis, axis)].sqrt();
                    assert!(turn.scaled_axis()[axis].abs() < 4.0 * sigma, "{turn} {fit:?}");
                }
                assert!(fit.rms_px < 0.3, "{}", fit.rms_px);
            }
        }
    }

    /// Squares with borders blurred by 0.8 px, under light that falls off to one side, the lighter ones grown by `spread_px` on all sides.
    fn squares(lens: &Lens, sheet: &Sheet, pitch_mm: f64, spread_px: f64) -> Plane {
        drawn(lens, sheet, |pixel, place, gradient| {
            // The sign of the cell along an axis, whose product with the other axis' is above 0 where the square is light, and how far its border is.
            let side = |axis: usize| {
                let px = pitch_mm / gradient.row(axis).norm();
                let cell = (place[axis] / pitch_mm).round();
                let to_border_px = (0.5 - (place[axis] / pitch_mm - cell).abs()) * px;
                let sign = if cell.rem_euclid(2.0) == 0.0 { 1.0 } else { -1.0 };
                (sign, to_border_px)
            };
            let [(a, a_px), (b, b_px)] = [side(0), side(1)];
            let (sign, nearest_px) = (a * b, a_px.min(b_px));
            let grown_px = nearest_px + sign * spread_px;
            (150.0 + 60.0 * sign * (grown_px / 0.8).tanh()) * (1.0 + 0.3 * pixel.x / f64::from(lens.width))
        })
    }

    #[test]
    fn large_squares_give_their_sheet_by_their_borders_though_ink_spreads_and_light_falls_off() {
        let (lens, sheet) = lens_and_sheet();
        for spread_px in [-0.5, 0.0, 0.5] {
            let plane = noisy(squares(&lens, &sheet, 4.0, spread_px), 3.0, 1);
            let lines = Lines { plane: &plane, lens: &lens, kind: PatternKind::Checkerboard, pitch_mm: 4.0 };
            let near = Vector6::new(4e-3, -4e-3, 2e-3, 0.2, -0.15, 1.0);
            let near = Sheet { camera_from_grid: perturbed(&sheet.camera_from_grid, &near), ..sheet.clone() };
            let fit = lines.fit_sheet(&near).and_then(|fit| lines.fit_sheet(&fit.sheet)).unwrap();
            for place in [Point2::new(0.0, 0.0), Point2::new(8.0, 4.0), Point2::new(-8.0, -4.0)] {
                let off = fit.sheet.project(&lens, &place) - sheet.project(&lens, &place);
                assert!(off.norm() < 0.1, "{spread_px}: {off}");
            }
            let turn = fit.sheet.camera_from_grid.rotation * sheet.camera_from_grid.rotation.inverse();
            for axis in 0..3 {
                let sigma = fit.turn_covariance[(axis, axis)].sqrt();
                assert!(turn.scaled_axis()[axis].abs() < 4.0 * sigma, "{spread_px}: {turn} {fit:?}");
            }
            assert!(fit.rms_px < 0.2, "{spread_px}: {}", fit.rms_px);
        }
    }

    #[test]
    fn every_other_line_that_is_missing_is_noticed() {
        let (lens, sheet) = lens_and_sheet();
        for (every, expected) in [(1.0, None), (2.0, Some(2.0)), (0.5, Some(0.5))] {
            let plane = noisy(ruled(&lens, &sheet, -1.0, every), 3.0, 2);
            let lines = Lines { plane: &plane, lens: &lens, kind: PatternKind::Lines, pitch_mm: 1.0 };
            assert_eq!(lines.other_ruling(&sheet), expected);
        }
    }

    #[test]
    fn a_line_is_found_where_it_is_to_a_twentieth_of_a_pixel() {
        for offset in [-1.3, 0.0, 0.4, 2.2] {
            let line = |y: usize| (-0.5 * ((y as f64 - 30.0 - offset) / 1.0).powi(2)).exp();
            // Under a gradient of brightness.
            let plane = Plane::new(
                60,
                60,
                (0..3600).map(|k| (200.0 - 80.0 * line(k / 60) + 0.5 * (k / 60) as f64) as f32).collect(),
            );
            let (darkness, seen, normal) =
                found_across(&plane, PatternKind::Lines, &Point2::new(30.0, 30.0), Vector2::new(20.0, 0.0)).unwrap();
            assert!(darkness > 0.0 && normal == Vector2::new(0.0, 1.0));
            assert!((seen.y - 30.0 - offset).abs() < 0.05, "{} for {offset}", seen.y - 30.0);
        }
        let flat = Plane::new(60, 60, vec![100.0; 3600]);
        assert!(found_across(&flat, PatternKind::Lines, &Point2::new(30.0, 30.0), Vector2::new(20.0, 0.0)).is_none());
    }
}
