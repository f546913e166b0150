//! How the printed lines look in the channel that tells snake from target, so that edges of lines are told from the snake's border.
//!
//! The discriminant of the lines is the sum of a profile across and one along, each periodic in ten pitches of the lattice (millimetre paper has
//! its heavier lines every five and ten). Paper waves and print is faint in places, so that each part of the sheet has a shift and a contrast of
//! its own.

use super::sheet::{Sheet, SheetShape};
use crate::camera::Lens;
use crate::measure::image::plane::Plane;
use crate::statistics::order::{SD_BY_MAD, median};
use nalgebra::{Matrix2, Point2, Vector2};
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
const VALUES: usize = PERIOD * PER_PITCH;
/// Lattice places are worked out at every so many pixels of every so many rows, and interpolated between.
///
/// Derived: a lens with a distortion of a tenth over 600 px bends a line by 1e-3 px over that length.
const MESH_PX: usize = 16;
/// A profile is learned from one pixel of so many in each direction.
///
/// Convention: of a megapixel a tenth of a million is left, seven hundred for each value.
const STRIDE: usize = 3;
/// The fewest pixels for each value, on the average.
///
/// Convention: a median of ten is known to a third of their scatter.
const FEWEST_PER_VALUE: usize = 10;
/// Rounds of a profile across beside that along, and of cells laid on both.
///
/// Convention: lines cover a fifth of the paper, so that the first round's medians are nearly free of the other direction's already; shifts of cells
/// make the profiles sharper in the second, and the third moves them by a hundredth of a pitch.
const ROUNDS: usize = 3;
/// Paper waves: the print is laid on anew in cells of so many pitches.
///
/// Convention: half a period, so that a cell has one heavier line of each direction.
const CELL: f32 = 5.0;
/// The fewest pixels that lay a cell.
///
/// Convention: a hundred for each of its two coordinates.
const FEWEST_PER_CELL: usize = 200;
/// How far the print of a cell may be from where the sheet's model has it, pitches (1σ).
///
/// Source: photographed sheets wave by 0.02 to 0.08 pitches (rms).
const SHIFT_SD: f32 = 0.08;
/// Steps of Gauss and Newton that lay a cell in each round.
///
/// Convention: an iteration cap; lines are a quarter of a pitch wide, and a shift is less.
const STEPS: usize = 3;
/// What differs from the print by more than so many of the usual deviations is something else.
///
/// Convention: the usual three.
const MOST_DEVIATIONS: f32 = 3.0;
/// The discriminant of the printed lines: one period of the lattice, and how it lies in the cells of the sheet.
#[derive(Debug, Clone, PartialEq)]
pub struct PrintProfile {
    /// Across the sheet, as a difference from the paper: [`VALUES`] numbers.
    across: Vec<f32>,
    /// Along it: as many.
    along: Vec<f32>,
    /// The paper between the lines.
    paper: f32,
    /// The cells in which the print was seen, by their number across and along from the lattice's origin.
    cells: BTreeMap<(i32, i32), Cell>,
}

/// How the print lies in a part of the sheet.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Cell {
    /// What is to be added to the lattice's coordinates there, pitches.
    shift: Vector2<f32>,
    /// By how much of its contrast the print shows there, 0 to 1.
    contrast: f32,
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
        let lattice = LatticeMesh { lens, sheet, pitch_mm };
        let of_row = |row: usize| {
            let mut own = Vec::new();
            lattice.visit_row(plane, row, |column, place| {
                let pixel = Point2::new(column as f64, row as f64) + plane.first;
                if column.is_multiple_of(STRIDE) && is_target(&pixel) {
                    own.push(Seen { place, discriminant: plane.data[row * plane.width + column] });
                }
            });
            own
        };
        let rows: Vec<usize> = (0..plane.height).step_by(STRIDE).collect();
        let seen: Vec<Seen> = rows.into_par_iter().flat_map_iter(of_row).collect();
        let mut by_cell: BTreeMap<(i32, i32), Vec<Seen>> = BTreeMap::new();
        seen.iter().for_each(|seen| by_cell.entry(cell_of(seen.place)).or_default().push(*seen));
        by_cell.retain(|_, seen| seen.len() >= FEWEST_PER_CELL);
        let unmoved = Cell { shift: Vector2::zeros(), contrast: 1.0 };
        let cells = by_cell.keys().map(|&cell| (cell, unmoved)).collect();
        let mut print = Self { across: vec![0.0; VALUES], along: vec![0.0; VALUES], paper: 0.0, cells };
        for _ in 0..ROUNDS {
            print.learn_profiles(&by_cell)?;
            print.cells = by_cell.par_iter().map(|(&at, seen)| (at, print.laid(print.cells[&at], seen))).collect();
        }
        Some(print)
    }

    /// The medians of the profiles, each of what the other leaves.
    fn learn_profiles(&mut self, by_cell: &BTreeMap<(i32, i32), Vec<Seen>>) -> Option<()> {
        let moved = |(at, seen): (&(i32, i32), &Vec<Seen>)| {
            let shift = self.cells[at].shift;
            seen.iter().map(move |seen| Seen { place: seen.place + shift, ..*seen }).collect::<Vec<_>>()
        };
        let seen: Vec<Seen> = by_cell.iter().flat_map(moved).collect();
        self.across = medians(&seen, |place| place.x, |place| value(&self.along, place.y))?;
        self.paper = median(&mut self.across.clone());
        self.across.iter_mut().for_each(|value| *value -= self.paper);
        self.along = medians(&seen, |place| place.y, |place| self.paper + value(&self.across, place.x))?;
        Some(())
    }

    /// The cell in which the print agrees best with what is seen, from where it was.
    fn laid(&self, Cell { mut shift, .. }: Cell, seen: &[Seen]) -> Cell {
        let left = |shift: Vector2<f32>, seen: &Seen| seen.discriminant - self.paper - self.lines(seen.place + shift);
        let step = 0.5 / PER_PITCH as f32;
        for _ in 0..STEPS {
            let mut residuals: Vec<f32> = seen.iter().map(|seen| left(shift, seen)).collect();
            let most = MOST_DEVIATIONS * deviation(&mut residuals);
            let variance = (most / MOST_DEVIATIONS).powi(2).max(f32::MIN_POSITIVE);
            let mut information = Matrix2::identity() / SHIFT_SD.powi(2);
            let mut gradient = -shift / SHIFT_SD.powi(2);
            for seen in seen {
                let residual = left(shift, seen);
                if residual.abs() > most {
                    continue;
                }
                let at = |by: Vector2<f32>| self.lines(seen.place + shift + by);
                let slope = Vector2::new(
                    at(Vector2::new(step, 0.0)) - at(Vector2::new(-step, 0.0)),
                    at(Vector2::new(0.0, step)) - at(Vector2::new(0.0, -step)),
                ) / (2.0 * step);
                information += slope * slope.transpose() / variance;
                gradient += slope * residual / variance;
            }
            let Some(inverse) = information.try_inverse() else { break };
            shift += inverse * gradient;
            shift = shift.map(|own| own.clamp(-0.5, 0.5));
        }
        let mut residuals: Vec<f32> = seen.iter().map(|seen| left(shift, seen)).collect();
        let most = MOST_DEVIATIONS * deviation(&mut residuals);
        let (mut own, mut both, mut sums, mut count) = (0.0, 0.0, Vector2::zeros(), 0.0_f32);
        for seen in seen.iter().filter(|seen| left(shift, seen).abs() <= most) {
            let (print, d) = (self.lines(seen.place + shift), seen.discriminant - self.paper);
            own += print * print;
            both += print * d;
            sums += Vector2::new(print, d);
            count += 1.0;
        }
        let count = count.max(1.0);
        let (variance, covariance) = (own - sums.x * sums.x / count, both - sums.x * sums.y / count);
        let contrast = if variance > 0.0 { (covariance / variance).clamp(0.0, 1.0) } else { 0.0 };
        Cell { shift, contrast }
    }

    /// The lines at a place of the lattice, in pitches, as a difference from the paper. Where two cross, what is printed twice counts once.
    fn lines(&self, place: Vector2<f32>) -> f32 {
        let (across, along) = (value(&self.across, place.x), value(&self.along, place.y));
        if across * along > 0.0 {
            // The heavier one, and of the lighter one what a heavier leaves of it.
            if across.abs() > along.abs() { across } else { along }
        } else {
            across + along
        }
    }

    /// By how much the discriminant of the print differs from the paper's at a place of the lattice, in pitches; `None` where it was not seen.
    fn at(&self, place: Vector2<f32>) -> Option<f32> {
        let corner = place / CELL - Vector2::repeat(0.5);
        let first = corner.map(f32::floor);
        let share = corner - first;
        let (mut weights, mut shift, mut contrast) = (0.0, Vector2::zeros(), 0.0);
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let Some(cell) = self.cells.get(&(first.x as i32 + dx, first.y as i32 + dy)) else { continue };
            let along = |d: i32, share: f32| if d == 0 { 1.0 - share } else { share };
            let weight = along(dx, share.x) * along(dy, share.y);
            weights += weight;
            shift += cell.shift * weight;
            contrast += cell.contrast * weight;
        }
        (weights > 0.0).then(|| contrast / weights * self.lines(place + shift / weights))
    }

    /// By how much every pixel of a picture differs from the paper between the lines; 0 where the print was not seen.
    pub fn picture(&self, lens: &Lens, sheet: &Sheet, pitch_mm: f64) -> Plane {
        let (width, height) = (lens.width as usize, lens.height as usize);
        let mut picture = Plane::new(width, height, vec![0.0; width * height]);
        let lattice = LatticeMesh { lens, sheet, pitch_mm };
        let bounds = Plane::new(width, height, Vec::new());
        picture.data.par_chunks_mut(width.max(1)).enumerate().for_each(|(row, values)| {
            lattice.visit_row(&bounds, row, |column, place| values[column] = self.at(place).unwrap_or(0.0));
        });
        picture
    }
}

/// The number of the cell of a place.
fn cell_of(place: Vector2<f32>) -> (i32, i32) {
    let cell = (place / CELL).map(f32::floor);
    (cell.x as i32, cell.y as i32)
}

/// A robust standard deviation about the median.
fn deviation(values: &mut [f32]) -> f32 {
    let middle = median(values);
    values.iter_mut().for_each(|value| *value = (*value - middle).abs());
    SD_BY_MAD as f32 * median(values)
}

/// The medians, of the pixels of each value of a profile, of what is left without the other; `None` where too little is seen.
fn medians(
    seen: &[Seen],
    by: impl Fn(&Vector2<f32>) -> f32,
    other: impl Fn(&Vector2<f32>) -> f32,
) -> Option<Vec<f32>> {
    let mut each: Vec<Vec<f32>> = vec![Vec::new(); VALUES];
    for Seen { place, discriminant } in seen {
        let number = (by(place).rem_euclid(PERIOD as f32) * PER_PITCH as f32) as usize;
        each[number.min(VALUES - 1)].push(discriminant - other(place));
    }
    let all: Vec<Option<f32>> =
        each.iter_mut().map(|values| (values.len() >= FEWEST_PER_VALUE / 2).then(|| median(values))).collect();
    let mut known: Vec<f32> = all.iter().flatten().copied().collect();
    if known.len() < VALUES / 2 {
        return None;
    }
    let usual = median(&mut known);
    Some(all.into_iter().map(|value| value.unwrap_or(usual)).collect())
}

/// The value of a profile at a coordinate, in pitches.
fn value(profile: &[f32], pitches: f32) -> f32 {
    let at = pitches.rem_euclid(PERIOD as f32) * PER_PITCH as f32 - 0.5;
    let before = at.floor();
    let share = at - before;
    let place = |k: i32| profile[k.rem_euclid(VALUES as i32) as usize];
    place(before as i32) * (1.0 - share) + place(before as i32 + 1) * share
}

/// The lattice coordinates that pixels show.
struct LatticeMesh<'a> {
    lens: &'a Lens,
    sheet: &'a Sheet,
    pitch_mm: f64,
}

impl LatticeMesh<'_> {
    /// Calls with each column of a plane's row that shows the sheet, and the lattice place there, in pitches.
    fn visit_row(&self, plane: &Plane, row: usize, mut visit: impl FnMut(usize, Vector2<f32>)) {
        let SheetShape { centre_mm, half_mm, .. } = self.sheet.shape;
        let reach_mm = half_mm * SheetShape::BEYOND;
        let at = |column: usize| {
            let pixel = Point2::new(column as f64, row as f64) + plane.first;
            Some(self.sheet.at(self.lens, &pixel)?.0)
        };
        let ends: Vec<Range<usize>> =
            (0..plane.width).step_by(MESH_PX).map(|first| first..(first + MESH_PX).min(plane.width)).collect();
        let mut start = at(0);
        for columns in ends {
            let end = at(columns.end);
            if let (Some(from), Some(to)) = (start, end) {
                let step = (to - from) / columns.len() as f64;
                for column in columns.clone() {
                    let place = from + step * (column - columns.start) as f64;
                    let off = (place - centre_mm).abs();
                    if off.x < reach_mm.x && off.y < reach_mm.y {
                        visit(column, (place.coords / self.pitch_mm).cast());
                    }
                }
            }
            start = end;
        }
    }
}
