//! How the printed lines look in the channel that tells snake from target, so that the eye can look through them.
//!
//! A pixel of the border mixes light of the snake and of what is behind it. With the share α of the snake and the discriminant b of the print
//! behind, it has d = α + (1 − α) b, since the snake's own is about 1. Hence
//!
//! ```text
//! α = (d − b) / (1 − b)
//! ```
//!
//! is free of the lines wherever b is known. The sheet tells it: b is the paper's, and on it a profile across and one along, each periodic in ten
//! pitches of the lattice (millimetre paper has its heavier lines every five and ten). Print that is faint in a part of the sheet, or lies elsewhere
//! than the sheet's model says, shows there with less of its contrast, or with none.

use super::sheet::{Sheet, SheetShape};
use crate::camera::Lens;
use crate::measure::image::plane::{Plane, Region};
use crate::statistics::order::median;
use nalgebra::{Point2, Vector2};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::Range;

/// The profiles repeat after so many pitches.
///
/// Convention: millimetre paper, whose heavier lines are every fifth and tenth.
const PERIOD: usize = 10;
/// Values of a profile for each pitch.
///
/// Derived: 0.06 mm of millimetre paper, about a pixel of a picture in which its lines are told apart well.
const PER_PITCH: usize = 16;
/// Values of a profile.
///
/// Derived: from the two above.
const VALUES: usize = PERIOD * PER_PITCH;
/// Lattice places are worked out at every so many pixels of a row, and interpolated between.
///
/// Derived: a lens that distorts by a tenth over 600 px bends a line by 1e-3 px over that length.
const MESH_PX: usize = 16;
/// A profile is learned from one pixel of so many in each direction.
///
/// Convention: of a megapixel a tenth of a million is left, seven hundred for each value.
const STRIDE: usize = 3;
/// The fewest pixels of a value that count.
///
/// Convention: a median of five is known to half of their scatter.
const FEWEST: usize = 5;
/// Rounds of a profile across beside that along.
///
/// Convention: lines cover a fifth of the paper, so that the first round's medians are nearly free of the other direction's already.
const ROUNDS: usize = 2;
/// The contrast is learned of parts of the sheet so many pitches wide and high.
///
/// Convention: half a period, so that each has a heavier line of both directions.
const PART: f32 = 5.0;
/// The fewest pixels that tell the contrast of a part.
///
/// Convention: a slope of one number from two hundred is known to a tenth where lines stand out of the noise.
const FEWEST_OF_PART: usize = 200;
/// What discriminants of the sheet are rounded to.
///
/// Convention: a hundredth of the noise of a good picture.
const RESOLUTION: f64 = 1e-4;
/// A picture that shows less of the print's contrast does not show the print.
///
/// Convention: the half; a snake across the sheet and noise change the slope of a picture that shows it by a tenth.
const LEAST_CONTRAST: f32 = 0.5;
/// Print as much like the snake as this is looked through, and up to 1 less and less; there no edge is looked for.
///
/// Convention: there noise is raised to twice of what it is.
const MOST_LIKE_SNAKE: f32 = 0.5;

/// The discriminant of the printed lines over one period of the lattice, and how much of it shows in each part of the sheet.
#[derive(Debug, Clone, PartialEq)]
pub struct PrintProfile {
    /// Across the sheet, as a difference from the paper between the lines: sixteen numbers for each of ten pitches.
    pub across: Vec<f32>,
    /// Along it: as many.
    pub along: Vec<f32>,
    /// The paper between the lines.
    pub paper: f32,
    /// The contrast of each part in which it was seen, 0 to 1, by its number across and along from the lattice's origin.
    pub contrast: BTreeMap<(i32, i32), f32>,
}

/// A pixel that shows the sheet: its place of the lattice, in pitches, and its discriminant.
#[derive(Debug, Clone, Copy)]
struct Seen {
    place: Vector2<f32>,
    discriminant: f32,
}

impl PrintProfile {
    /// From the discriminant of a picture, where `is_target` says that nothing hides the sheet. `None` where too little of the sheet is seen.
    pub fn learn(
        plane: &Plane,
        lens: &Lens,
        sheet: &Sheet,
        pitch_mm: f64,
        is_target: impl Fn(&Point2<f64>) -> bool + Sync,
    ) -> Option<Self> {
        let lattice = Lattice { lens, sheet, pitch_mm };
        let of_row = |row: usize| {
            let mut own = Vec::new();
            lattice.visit_row(0..plane.width, row, |run| {
                let used = run.columns.clone().step_by(STRIDE);
                let used = used.filter(|&column| is_target(&Point2::new(column as f64, row as f64)));
                let discriminant = |column: usize| plane.data[row * plane.width + column];
                own.extend(used.map(|column| Seen { place: run.at(column), discriminant: discriminant(column) }));
            });
            own
        };
        let rows = (0..plane.height.div_ceil(STRIDE)).into_par_iter();
        let seen: Vec<Seen> = rows.flat_map_iter(|row| of_row(row * STRIDE)).collect();
        let (mut across, mut along, mut paper) = (vec![0.0; VALUES], vec![0.0; VALUES], 0.0);
        for _ in 0..ROUNDS {
            across = medians(&seen, |place| place.x, |place| value(&along, place.y))?;
            paper = median(&mut across.clone());
            across.iter_mut().for_each(|value| *value -= paper);
            along = medians(&seen, |place| place.y, |place| paper + value(&across, place.x))?;
        }
        [&mut across, &mut along].into_iter().flatten().for_each(|value| *value = rounded(*value));
        let mut print = Self { across, along, paper: rounded(paper), contrast: BTreeMap::new() };
        let mut parts: BTreeMap<(i32, i32), Vec<Seen>> = BTreeMap::new();
        seen.iter().for_each(|seen| parts.entry(part_of(seen.place)).or_default().push(*seen));
        parts.retain(|_, seen| seen.len() >= FEWEST_OF_PART);
        print.contrast = parts.par_iter().map(|(&part, seen)| (part, rounded(print.contrast_in(seen)))).collect();
        Some(print)
    }

    /// Whether it has as many numbers as a print has, all of them finite.
    pub fn is_sound(&self) -> bool {
        let numbers = self.across.iter().chain(&self.along).chain(self.contrast.values()).chain([&self.paper]);
        self.across.len() == VALUES && self.along.len() == VALUES && numbers.copied().all(f32::is_finite)
    }

    /// The share of the print's contrast that pixels of a part show, 0 to 1.
    fn contrast_in(&self, seen: &[Seen]) -> f32 {
        contrast(seen.iter().map(|seen| (self.lines(seen.place), seen.discriminant - self.paper)))
    }

    /// The lines at a place of the lattice, in pitches, as a difference from the paper. Where two cross, the heavier one shows.
    fn lines(&self, place: Vector2<f32>) -> f32 {
        let (across, along) = (value(&self.across, place.x), value(&self.along, place.y));
        match across * along > 0.0 {
            true if across.abs() > along.abs() => across,
            true => along,
            false => across + along,
        }
    }

    /// The share of the contrast at a place of the lattice, in pitches; `None` where the sheet was not seen.
    fn contrast_at(&self, place: Vector2<f32>) -> Option<f32> {
        let corner = place / PART - Vector2::repeat(0.5);
        let first = corner.map(f32::floor);
        let share = corner - first;
        let (mut weights, mut contrast) = (0.0, 0.0);
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let Some(own) = self.contrast.get(&(first.x as i32 + dx, first.y as i32 + dy)) else { continue };
            let along = |d: i32, share: f32| if d == 0 { 1.0 - share } else { share };
            let weight = along(dx, share.x) * along(dy, share.y);
            weights += weight;
            contrast += own * weight;
        }
        (weights > 0.0).then(|| contrast / weights)
    }

    /// What of the sheet is behind every pixel of the rectangle around a region, 0 where it was not seen.
    pub fn picture(&self, lens: &Lens, sheet: &Sheet, pitch_mm: f64, around: &Region) -> Plane {
        let (columns, rows) = around.bounds();
        let (width, height) = (columns.len(), rows.len());
        let lattice = Lattice { lens, sheet, pitch_mm };
        let mut data = vec![0.0; width * height];
        data.par_chunks_mut(width.max(1)).zip(rows.clone()).for_each(|(values, row)| {
            lattice.visit_row(columns.clone(), row, |run| {
                let ends = [run.at(run.columns.start), run.at(run.columns.end)].map(|place| self.contrast_at(place));
                let (Some(from), Some(to)) = (ends[0].or(ends[1]), ends[1].or(ends[0])) else { return };
                let step = (to - from) / run.columns.len() as f32;
                for (k, column) in run.columns.clone().enumerate() {
                    let contrast = from + step * k as f32;
                    values[column - columns.start] = self.paper + contrast * self.lines(run.at(column));
                }
            });
        });
        let first = Vector2::new(columns.start as f64, rows.start as f64);
        hiding(Plane { first, ..Plane::new(width, height, data) })
    }
}

/// A picture of the sheet, with what print that is too much like the snake hides.
fn hiding(sheet: Plane) -> Plane {
    let hides = |&b: &f32| b > MOST_LIKE_SNAKE;
    let hidden = if sheet.data.iter().any(hides) { sheet.data.iter().map(hides).collect() } else { Vec::new() };
    Plane { hidden, ..sheet }
}

/// Takes away from a plane what of the sheet is behind it, of as much of the picture or more; from a plane that does not show the print, as where
/// something covers the sheet or it was moved, nothing. Print that is too much like the snake hides what is before it.
pub fn look_through(plane: &mut Plane, sheet: &Plane) {
    let offset = plane.first - sheet.first;
    let (x, y, width) = (offset.x as usize, offset.y as usize, plane.width.max(1));
    let behind = |row: usize| {
        let first = (y + row) * sheet.width + x;
        first..first + width
    };
    let rows = plane.data.chunks_exact(width).enumerate().step_by(STRIDE);
    let sampled = rows
        .flat_map(|(row, values)| sheet.data[behind(row)].iter().zip(values).step_by(STRIDE))
        .map(|(&b, &d)| (b, d));
    // What was not looked at is zero, and so is what shows no sheet.
    if contrast(sampled.filter(|(b, d)| *b != 0.0 && *d != 0.0)) < LEAST_CONTRAST {
        return;
    }
    if !sheet.hidden.is_empty() {
        plane.hidden = (0..plane.height).flat_map(|row| &sheet.hidden[behind(row)]).copied().collect();
    }
    for (row, values) in plane.data.chunks_exact_mut(width).enumerate() {
        for (value, &b) in values.iter_mut().zip(&sheet.data[behind(row)]) {
            let b = if b > MOST_LIKE_SNAKE { (1.0 - b).max(0.0) } else { b };
            *value = (*value - b) / (1.0 - b);
        }
    }
}

/// The slope of what is seen over what is printed, from pairs of print and discriminant, 0 to 1; something else than the sheet counts as a snake at
/// most.
fn contrast(pairs: impl Iterator<Item = (f32, f32)>) -> f32 {
    let (mut count, mut sums, mut own, mut both) = (0.0, Vector2::zeros(), 0.0, 0.0);
    for (b, d) in pairs.map(|(b, d)| (f64::from(b), f64::from(d.clamp(-1.0, 1.0)))) {
        count += 1.0;
        sums += Vector2::new(b, d);
        own += b * b;
        both += b * d;
    }
    let variance = own - sums.x * sums.x / count;
    if variance > 0.0 { ((both - sums.x * sums.y / count) / variance).clamp(0.0, 1.0) as f32 } else { 0.0 }
}

/// A number of few digits, since the rig's file holds hundreds of them.
fn rounded(value: f32) -> f32 {
    ((f64::from(value) / RESOLUTION).round() * RESOLUTION) as f32
}

/// The number of the part of a place.
fn part_of(place: Vector2<f32>) -> (i32, i32) {
    let part = (place / PART).map(f32::floor);
    (part.x as i32, part.y as i32)
}

/// The medians, of the pixels of each value of a profile, of what is left without the other; `None` where too little is seen.
fn medians(seen: &[Seen], by: impl Fn(&Vector2<f32>) -> f32, other: impl Fn(&Vector2<f32>) -> f32) -> Option<Vec<f32>> {
    let mut each: Vec<Vec<f32>> = vec![Vec::new(); VALUES];
    for Seen { place, discriminant } in seen {
        let number = (by(place).rem_euclid(PERIOD as f32) * PER_PITCH as f32) as usize;
        each[number.min(VALUES - 1)].push(discriminant - other(place));
    }
    let all: Vec<Option<f32>> =
        each.iter_mut().map(|values| (values.len() >= FEWEST).then(|| median(values))).collect();
    let mut known: Vec<f32> = all.iter().flatten().copied().collect();
    if known.len() < VALUES / 2 {
        return None;
    }
    let usual = median(&mut known);
    Some(all.into_iter().map(|value| value.unwrap_or(usual)).collect())
}

/// The value of a profile at a coordinate, in pitches.
fn value(profile: &[f32], pitches: f32) -> f32 {
    let at = pitches * PER_PITCH as f32 - 0.5;
    let before = at.floor();
    let share = at - before;
    let place = |k: i32| profile[k.rem_euclid(VALUES as i32) as usize];
    place(before as i32) * (1.0 - share) + place(before as i32 + 1) * share
}

/// The lattice coordinates that pixels show.
struct Lattice<'a> {
    lens: &'a Lens,
    sheet: &'a Sheet,
    pitch_mm: f64,
}

/// Pixels of a row that follow each other, and the lattice there.
struct Run {
    columns: Range<usize>,
    /// The place of the first, in pitches.
    from: Vector2<f32>,
    /// From one pixel to the next, pitches.
    step: Vector2<f32>,
}

impl Run {
    /// The place of a column, in pitches.
    fn at(&self, column: usize) -> Vector2<f32> {
        self.from + self.step * (column - self.columns.start) as f32
    }
}

impl Lattice<'_> {
    /// Calls with the runs of a picture's row that show the sheet.
    fn visit_row(&self, columns: Range<usize>, row: usize, mut visit: impl FnMut(&Run)) {
        let SheetShape { centre_mm, half_mm, .. } = self.sheet.shape;
        let reach_mm = half_mm * SheetShape::BEYOND;
        let at = |column: usize| {
            let place = self.sheet.place_at(self.lens, &Point2::new(column as f64, row as f64))?;
            let off = (place - centre_mm).abs();
            (off.x < reach_mm.x && off.y < reach_mm.y).then(|| place.coords / self.pitch_mm)
        };
        let mut start = at(columns.start);
        for first in columns.clone().step_by(MESH_PX) {
            let run = first..(first + MESH_PX).min(columns.end);
            let end = at(run.end);
            if let (Some(from), Some(to)) = (start, end) {
                let step = (to - from) / run.len() as f64;
                visit(&Run { columns: run, from: from.cast(), step: step.cast() });
            }
            start = end;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::measure::fixture::Scene;
    use crate::statistics::moments::rms;
    use nalgebra::{Translation3, UnitQuaternion, Vector3};

    /// A sheet of 60 × 44 mm, a little turned, with lines of 1 mm pitch.
    fn sheet() -> Sheet {
        let shape = SheetShape { half_mm: Vector2::new(30.0, 22.0), bow_mm: [0.4, 0.2, -0.3], ..SheetShape::default() };
        let lean = UnitQuaternion::from_scaled_axis(Vector3::new(0.05, -0.04, 0.1));
        Sheet { camera_from_grid: Pose::from_parts(Translation3::new(0.5, 0.3, 150.0), lean), shape }
    }

    /// The share of ink of lines 0.25 mm wide, every fifth twice as dark.
    fn ink(mm: f64) -> f64 {
        let line = mm.round();
        let depth = if line.rem_euclid(5.0) < 0.5 { 0.4 } else { 0.2 };
        depth * (-0.5 * ((mm - line) / 0.1).powi(2)).exp()
    }

    /// A picture of the sheet, whose lines are shifted across by so many mm, before a snake that covers the columns from 380 to 419 and mixes with
    /// what is behind at its borders; and the share of snake alone.
    fn picture(shift_mm: f64) -> (Plane, Plane) {
        let (lens, sheet) = (Scene::new(Vector3::zeros()).lens, sheet());
        let (width, height) = (lens.width as usize, lens.height as usize);
        let share = |x: usize| match x {
            380..420 => 1.0,
            379 | 420 => 0.4,
            _ => 0.0,
        };
        let of_pixel = |k: usize| {
            let (x, y) = (k % width, k / width);
            let (place, _) = sheet.at(&lens, &Point2::new(x as f64, y as f64)).unwrap();
            let behind = ink(place.x + shift_mm).max(ink(place.y)) - 0.05;
            (share(x) + (1.0 - share(x)) * behind) as f32
        };
        let alone = |k: usize| share(k % width) as f32;
        let plane = |of: &dyn Fn(usize) -> f32| Plane::new(width, height, (0..width * height).map(of).collect());
        (plane(&of_pixel), plane(&alone))
    }

    fn learned(seen: &Plane) -> PrintProfile {
        let is_target = |pixel: &Point2<f64>| (pixel.x - 399.5).abs() > 25.0;
        PrintProfile::learn(seen, &Scene::new(Vector3::zeros()).lens, &sheet(), 1.0, is_target).unwrap()
    }

    /// The root mean square of what is seen of the sheet, and of what it does to the snake's border.
    fn left(seen: &Plane, alone: &Plane) -> (f64, f64) {
        let at = |columns: Range<usize>| {
            let columns = columns.collect::<Vec<_>>();
            let pixels = (150..450).flat_map(|y| columns.iter().map(move |x| y * seen.width + x));
            rms(pixels.map(|k| f64::from(seen.data[k] - alone.data[k])))
        };
        (at(430..600), at(420..421))
    }

    #[test]
    fn lines_are_looked_through_beside_the_snake_and_at_its_border() {
        let (mut seen, alone) = picture(0.0);
        let print = learned(&seen);
        let lens = Scene::new(Vector3::zeros()).lens;
        let before = left(&seen, &alone);
        look_through(&mut seen, &print.picture(&lens, &sheet(), 1.0, &Region::whole(lens.width, lens.height)));
        let after = left(&seen, &alone);
        assert!(before.0 > 0.08 && after.0 < 0.2 * before.0, "{before:?} {after:?}");
        assert!(after.1 < 0.2 * before.1, "{before:?} {after:?}");
    }

    #[test]
    fn lines_that_lie_elsewhere_than_the_model_says_are_not_taken_away_twice() {
        let print = learned(&picture(0.0).0);
        // The same profile on a sheet that shows its lines half a pitch further.
        let (shifted, alone) = picture(0.5);
        let lens = Scene::new(Vector3::zeros()).lens;
        let mut own = learned(&shifted);
        (own.across, own.along, own.paper) = (print.across.clone(), print.along.clone(), print.paper);
        let misplaced: Vec<Seen> = (0..shifted.data.len())
            .step_by(7)
            .filter(|k| (430..600).contains(&(k % shifted.width)))
            .filter_map(|k| {
                let pixel = Point2::new((k % shifted.width) as f64, (k / shifted.width) as f64);
                let (place, _) = sheet().at(&lens, &pixel)?;
                Some(Seen { place: place.coords.cast(), discriminant: shifted.data[k] })
            })
            .collect();
        let contrast = own.contrast_in(&misplaced);
        own.contrast.values_mut().for_each(|own| *own = contrast);
        let mut seen = shifted.clone();
        look_through(&mut seen, &own.picture(&lens, &sheet(), 1.0, &Region::whole(lens.width, lens.height)));
        assert!(left(&seen, &alone).0 < 1.05 * left(&shifted, &alone).0, "{contrast}");
    }

    #[test]
    fn a_plane_of_a_part_of_the_picture_is_looked_through_as_the_whole_is() {
        let (mut whole, _) = picture(0.0);
        let print = learned(&whole);
        let lens = Scene::new(Vector3::zeros()).lens;
        let part = Region::along([Point2::new(300.0, 200.0)], 50.0, (lens.width, lens.height));
        let mut cropped = whole.cropped(&part);
        let behind = |around: &Region| print.picture(&lens, &sheet(), 1.0, around);
        look_through(&mut cropped, &behind(&Region::whole(lens.width, lens.height)));
        look_through(&mut whole, &behind(&Region::whole(lens.width, lens.height)));
        assert_eq!(cropped.data, whole.cropped(&part).data);
    }

    #[test]
    fn a_sheet_of_which_little_is_seen_is_not_learned() {
        let (seen, _) = picture(0.0);
        let lens = Scene::new(Vector3::zeros()).lens;
        assert!(PrintProfile::learn(&seen, &lens, &sheet(), 1.0, |pixel| pixel.x < 30.0 && pixel.y < 60.0).is_none());
    }

    #[test]
    fn print_like_the_snake_hides_what_is_before_it() {
        let value = |column: usize| if (12..15).contains(&column) { 0.8 } else { 0.1 };
        let mut plane = Plane::new(40, 40, (0..40 * 40).map(|k| value(k % 40)).collect());
        let behind = hiding(plane.clone());
        look_through(&mut plane, &behind);
        let hidden = |x: f64| plane.is_hidden(&Point2::new(x, 20.0));
        assert_eq!([11.0, 12.0, 14.0, 15.0].map(hidden), [false, true, true, false]);
    }

    #[test]
    fn a_picture_without_the_print_is_left_as_it_is() {
        let print = learned(&picture(0.0).0);
        let lens = Scene::new(Vector3::zeros()).lens;
        let behind = print.picture(&lens, &sheet(), 1.0, &Region::whole(lens.width, lens.height));
        for value in [0.0, 0.3] {
            let mut blank = Plane::new(behind.width, behind.height, vec![value; behind.data.len()]);
            look_through(&mut blank, &behind);
            assert!(blank.data.iter().all(|own| *own == value));
        }
    }
}
