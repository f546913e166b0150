//! Finds printed sheets in a picture, and the camera's pose to them.
//!
//! [`SheetSearch`] finds lattices without knowing what else is in the picture. The clearest gives the geometry: where the sheet is, how it leans
//! and bows. Which of the rulings seen on it has the stated pitch is open until the snake's size tells; each is a [`SheetHypothesis`], and
//! [`SheetSearch::refined`] measures the one that is decided for by its own waves and lines.

use super::lines::{Lines, MOST_SCATTER};
use super::pattern::PatternKind;
use super::phases::{Windows, design_effect};
use super::region::PictureRegion;
use super::seed::{LEAST_WAVE_PX, Seed, evened, evened_without, find_seeds, ordered, strongest_mix};
use super::sheet::{Sheet, turn_covariance};
use super::sheet_fit::{SheetFit, TargetPoint, fit_from_afar, fit_points, square_sheet};
use crate::camera::{Frame, Lens};
use crate::measure::image::plane::Plane;
use nalgebra::{Matrix2, Matrix3, Point2, Vector2, Vector3};
use rayon::prelude::*;
use std::f64::consts::FRAC_1_SQRT_2;

/// The most rounds in which phases are measured again with the waves that the sheet predicts, and by how much more of the sheet is seen in a
/// round that is not the last.
///
/// Convention: the first round removes what perspective did to the seed's waves; a snake across the sheet hides its other half until
/// the second or third.
const MOST_ROUNDS: usize = 5;
const GROWING: f64 = 1.02;
/// Rounds in which lines are looked for where the sheet puts them.
///
/// Convention: the second round confirms the first.
const LINE_ROUNDS: usize = 2;
/// Waves are looked for in a picture that is halved for as long as its longer side stays this long or longer, px.
///
/// Convention: a limit of time. Two hundred and fifty waves of the least length go into it, and lines are placed in the whole picture all the same.
const WAVES_SIDE_PX: usize = 1024;
/// Fewest windows that must show a sheet.
///
/// Convention: three times four; fewer could not show its lean in both directions.
const FEWEST_POINTS: usize = 12;
/// The share of the places with strong waves in which these must be where the sheet predicts them, for a print to be named.
///
/// Derived: of phases at random a quarter are within a quarter of a cycle in both directions, and up to a half where the sheet was fitted to
/// them; on every printed sheet so far 97 % and more are.
const LEAST_AGREEING: f64 = 0.55;
/// How far the middle of the sheet that is seen may be from the middle of the sheet as it was laid and measured (1σ), in units of half of
/// what is seen.
///
/// Fitted: by hand to the azimuths that eight photo-real rigs of laboratories show from the straight picture. Looked at by halves, the likelihood of
/// four (500, 504, 508, 512) is largest at 0.12, with 0.06 to 0.29 in its 95 % region, and that of the others at 0.15. Nothing is left that judges it.
const MIDDLE_SD: f64 = 0.15;
/// Slope of the mean plane that waves leave, in units of their height over half of what is seen.
///
/// Derived: the slope of a straight line fitted to n independent heights over ±1 has σ = √(3/n); along a sheet there are about four waves' halves.
const WAVE_SLOPE: f64 = 0.87;
/// The most by which a ruling's two pitches may differ, as a share.
///
/// Derived: three times what printers do (1σ of 2 %); a heavier line's wave across and a thinner one's along make no ruling.
const MOST_ANISOTROPY: f64 = 0.06;
/// Turn within which waves are thought to run along the picture's borders, as a cosine.
///
/// Convention: 30°; squares' waves run at 45° to their sides.
const ALONG_BORDERS: f64 = 0.866;

/// The grid in one picture.
#[derive(Debug, Clone)]
pub struct Grid {
    /// The kind of pattern.
    pub kind: PatternKind,
    /// The sheet that it is printed on.
    pub sheet: Sheet,
    /// Covariance of a turn of the sheet's mean plane about the camera's axes, rad².
    pub turn_covariance: Matrix3<f64>,
    /// Scatter of what was seen of it about the sheet's model, px per coordinate.
    pub rms_px: f64,
    /// How far the sheet lies before and behind its model, mm (rms): waves and creases.
    pub waves_mm: f64,
}

impl Grid {
    /// Depth (camera z), mm, at which a line of sight meets the sheet's mean plane.
    pub fn distance_mm(&self, ray: &Vector3<f64>) -> f64 {
        distance_mm(&self.sheet, ray)
    }

    /// The grid of another pitch, in units of this one's, that would be seen in the same place.
    #[must_use]
    pub fn with_pitch_times(&self, factor: f64) -> Self {
        Self { sheet: self.sheet.scaled(factor), ..self.clone() }
    }
}

/// Depth (camera z), mm, at which a line of sight meets a sheet's mean plane.
fn distance_mm(sheet: &Sheet, ray: &Vector3<f64>) -> f64 {
    let normal = sheet.camera_from_grid * Vector3::z();
    let along = normal.dot(&sheet.camera_from_grid.translation.vector) / normal.dot(ray);
    along * ray.z
}

/// One of the rulings that a sheet shows, taken for the one of the stated pitch.
#[derive(Debug, Clone)]
pub struct SheetHypothesis {
    /// The kind of pattern.
    pub kind: PatternKind,
    /// Where the sheet is if this ruling has the stated pitch, roughly.
    pub sheet: Sheet,
    /// Distance between its lines, or side of its squares, in the middle of the sheet, px, across and along.
    pub pitch_px: [f64; 2],
    /// Cycles per px of the reduced picture.
    waves: [Vector2<f64>; 2],
}

impl SheetHypothesis {
    /// The same ruling of another pitch, in units of this one's.
    #[must_use]
    pub fn with_pitch_times(&self, factor: f64) -> Self {
        Self { sheet: self.sheet.scaled(factor), ..self.clone() }
    }

    /// The grid as this ruling shows it roughly, its direction taken for certain.
    pub fn rough_grid(&self) -> Grid {
        let (kind, sheet) = (self.kind, self.sheet.clone());
        Grid { kind, sheet, turn_covariance: Matrix3::zeros(), rms_px: 0.0, waves_mm: 0.0 }
    }

    /// The vectors in the picture from one line to the next, across and along, px.
    pub fn lines_px(&self) -> [Vector2<f64>; 2] {
        // A checkerboard's waves run along the diagonals of its squares.
        let square_to_lines = self.kind.gradients(self.waves);
        [0, 1].map(|k| square_to_lines[k].normalize() * self.pitch_px[k])
    }

    /// Depth (camera z), mm, at which a line of sight meets the sheet.
    pub fn distance_mm(&self, ray: &Vector3<f64>) -> f64 {
        distance_mm(&self.sheet, ray)
    }
}

/// The printed sheet in a picture of which nothing is known but the camera.
pub struct SheetSearch {
    mix: Plane,
    reduced: Reduced,
    /// The reduced mix with its contrast made even.
    evened: Plane,
    pitch_mm: f64,
    /// The clearest ruling's kind and waves, and the sheet that they show.
    clearest: Option<(PatternKind, [Vector2<f64>; 2], SheetFit)>,
    /// The rulings, the likeliest first.
    pub hypotheses: Vec<SheetHypothesis>,
    /// Where windows of the clearest one lie, px.
    pub seen: Vec<Point2<f64>>,
    /// How far a window reaches around its middle, px.
    pub reach_px: f64,
    /// Whether the clearest ruling is regular enough to be called a print: where no snake is found before it either, it is none.
    pub is_print: bool,
}

impl SheetSearch {
    /// The distance of the lines of a grid of this picture, in units of the stated one, if every other line is missing, or there are as many
    /// between.
    pub fn other_ruling(&self, lens: &Lens, grid: &Grid) -> Option<f64> {
        let lines = Lines { plane: &self.mix, lens, kind: grid.kind, pitch_mm: self.pitch_mm };
        (grid.kind == PatternKind::Lines).then(|| lines.other_ruling(&grid.sheet)).flatten()
    }

    /// Looks for a sheet whose ruling may have this pitch, mm; without hypotheses where there is none.
    pub fn new(frame: &Frame, lens: &Lens, pitch_mm: f64) -> Self {
        let mix = strongest_mix(frame);
        let reduced = Reduced::of(&mix, lens);
        if mix.data.is_empty() {
            return Self::nothing(mix, reduced, pitch_mm);
        }
        let evened = evened(&reduced.mix);
        let seeds = find_seeds(&evened);
        // Windows for lines need more waves around them than a picture of large squares has.
        let kinds = [PatternKind::Lines, PatternKind::Checkerboard];
        let clearest = seeds.iter().flat_map(|seed| kinds.map(|kind| (seed, kind))).find_map(|(seed, kind)| {
            let waves = ordered(seed.waves[0], seed.waves[1], kind);
            let (points, fit, agreeing) = reduced.sheet(&evened, kind, pitch_mm, waves)?;
            let is_ruling = fit.sheet.shape.anisotropy.abs() < MOST_ANISOTROPY;
            is_ruling.then_some((seed, kind, points, fit, agreeing))
        });
        let Some((seed, kind, points, fit, agreeing)) = clearest else {
            return Self::nothing(mix, reduced, pitch_mm);
        };
        Self {
            pitch_mm,
            hypotheses: hypotheses(&seeds, seed, kind, &fit.sheet, reduced.times),
            seen: points.iter().map(|point| point.pixel).collect(),
            reach_px: kind.window_radius() * seed.period_px() * reduced.times,
            is_print: agreeing > LEAST_AGREEING,
            clearest: Some((kind, seed.waves, fit)),
            mix,
            reduced,
            evened,
        }
    }

    /// A picture in which no sheet was found.
    fn nothing(mix: Plane, reduced: Reduced, pitch_mm: f64) -> Self {
        let (hypotheses, seen, evened) = (Vec::new(), Vec::new(), Plane::new(0, 0, Vec::new()));
        Self { mix, reduced, evened, pitch_mm, clearest: None, hypotheses, seen, reach_px: 0.0, is_print: false }
    }

    /// The sheet of a hypothesis, measured by its own waves and lines beside the body that hides a part of it, if that is known; `None`
    /// where they are not seen well enough.
    pub fn refined(&self, lens: &Lens, hypothesis: &SheetHypothesis, body: Option<&PictureRegion>) -> Option<Grid> {
        let kind = hypothesis.kind;
        let waves = ordered(hypothesis.waves[0], hypothesis.waves[1], kind);
        let is_clearest = |of: &PatternKind, seen: &[Vector2<f64>; 2]| *of == kind && *seen == hypothesis.waves;
        let measured = |plane: &Plane| Some(self.reduced.sheet(plane, kind, self.pitch_mm, waves)?.1);
        let fit = match (&self.clearest, body) {
            (Some((of, seen, fit)), None) if is_clearest(of, seen) => fit.clone(),
            (_, None) => measured(&self.evened)?,
            (_, Some(body)) => measured(&self.evened_beside(body))?,
        };
        // Lines that are washed out tell less than the waves do.
        let pitch_px = self.reduced.times / waves[0].norm() / kind.wavelength();
        let by_lines = self
            .sheet_by_lines(lens, kind, &fit, pitch_px)
            .filter(|lines| lines.turn_covariance.trace() < fit.turn_covariance.trace());
        let waves_mm = self.waves_mm(lens, &fit);
        let SheetFit { sheet, turn_covariance: seen, rms_px, .. } = by_lines.unwrap_or(fit);
        let to_camera = sheet.camera_from_grid.rotation.to_rotation_matrix().into_inner();
        let of_waves = sheet.shape.half_mm.map(|half| (WAVE_SLOPE * waves_mm / half).powi(2));
        let slopes = sheet.shape.slope_covariance(MIDDLE_SD) + Matrix2::from_diagonal(&of_waves);
        let turn_covariance = seen + to_camera * turn_covariance(&slopes) * to_camera.transpose();
        Some(Grid { kind, sheet, turn_covariance, rms_px, waves_mm })
    }

    /// The picture of even contrast without what a body covers.
    fn evened_beside(&self, body: &PictureRegion) -> Plane {
        let (width, height) = (self.reduced.mix.width, self.reduced.mix.height);
        let at = |k: usize| self.reduced.whole_px(&Point2::new((k % width) as f64, (k / width) as f64));
        let shown = (0..width * height).into_par_iter().map(|k| if body.contains(&at(k)) { 0.0 } else { 1.0 });
        evened_without(&self.reduced.mix, &Plane::new(width, height, shown.collect()))
    }

    /// How far waves and creases take the sheet before and behind its model, mm (rms): by what neighbouring places are shifted in the picture,
    /// over the tangent of the angle (rms) under which they are seen off the camera's axis.
    fn waves_mm(&self, lens: &Lens, fit: &SheetFit) -> f64 {
        let tangents =
            self.seen.iter().map(|pixel| lens.ray(pixel)).map(|ray| (ray.x * ray.x + ray.y * ray.y) / (ray.z * ray.z));
        let tangent = (tangents.sum::<f64>() / 2.0 / (self.seen.len() as f64).max(1.0)).sqrt();
        fit.shared_px / fit.sheet.length_px(lens, 1.0) / tangent.max(f64::MIN_POSITIVE)
    }

    /// The sheet from the lines themselves, from the one that the waves gave; `None` where the lines are not where the waves put them.
    fn sheet_by_lines(&self, lens: &Lens, kind: PatternKind, by_waves: &SheetFit, pitch_px: f64) -> Option<SheetFit> {
        let lines = Lines { plane: &self.mix, lens, kind, pitch_mm: self.pitch_mm };
        let start = match kind {
            PatternKind::Lines => lines.put_origin_on_a_line(&by_waves.sheet)?,
            PatternKind::Checkerboard => by_waves.sheet.clone(),
        };
        let mut fit = lines.fit_sheet(&start)?;
        for _ in 1..LINE_ROUNDS {
            fit = lines.fit_sheet(&fit.sheet)?;
        }
        (fit.rms_px <= MOST_SCATTER * pitch_px).then_some(fit)
    }
}

/// A picture halved for some times, and its lens.
struct Reduced {
    mix: Plane,
    lens: Lens,
    times: f64,
}

impl Reduced {
    fn of(mix: &Plane, lens: &Lens) -> Self {
        let mut reduced = Self { mix: mix.clone(), lens: lens.clone(), times: 1.0 };
        while reduced.mix.width.max(reduced.mix.height) / 2 >= WAVES_SIDE_PX {
            let Self { mix, lens, times } = reduced;
            reduced = Self { mix: mix.shrunk::<2>(), lens: lens.halved(), times: 2.0 * times };
        }
        reduced
    }

    /// Where one of its pixels is in the whole picture.
    fn whole_px(&self, pixel: &Point2<f64>) -> Point2<f64> {
        (pixel + Vector2::new(0.5, 0.5)) * self.times - Vector2::new(0.5, 0.5)
    }

    /// The sheet by windows of its evened picture, see [`sheet_by_windows`], in pixels of the whole one.
    fn sheet(
        &self,
        evened: &Plane,
        kind: PatternKind,
        pitch_mm: f64,
        waves: [Vector2<f64>; 2],
    ) -> Option<(Vec<TargetPoint>, SheetFit, f64)> {
        let (mut points, fit, agreeing) = sheet_by_windows(evened, &self.lens, kind, pitch_mm, waves)?;
        points.iter_mut().for_each(|point| point.pixel = self.whole_px(&point.pixel));
        let (rms_px, shared_px) = (fit.rms_px * self.times, fit.shared_px * self.times);
        Some((points, SheetFit { rms_px, shared_px, ..fit }, agreeing))
    }
}

/// The rulings that other seeds show on the sheet of the clearest one, which was fitted as one of a kind, as lines and as squares: those that run as
/// its waves may. The seeds are those of a picture reduced by so many times.
fn hypotheses(seeds: &[Seed], clearest: &Seed, kind: PatternKind, sheet: &Sheet, times: f64) -> Vec<SheetHypothesis> {
    let length_px = |waves: [Vector2<f64>; 2]| 1.0 / (waves[0].norm() * waves[1].norm()).sqrt();
    let clearest_px = length_px(clearest.waves) / kind.wavelength();
    let ratio = |seed: &Seed| seed.waves[0].norm() / seed.waves[1].norm();
    let is_ruling = |seed: &&Seed| (ratio(seed) / ratio(clearest)).ln().abs() < MOST_ANISOTROPY;
    let of_seed = |seed: &Seed| {
        let wave_px = length_px(seed.waves);
        let is_along = seed.waves[0].normalize().x.abs() > ALONG_BORDERS;
        let of_kind = |kind: PatternKind| {
            let pitch_px = wave_px / kind.wavelength();
            SheetHypothesis {
                kind,
                sheet: sheet.scaled(clearest_px / pitch_px),
                pitch_px: seed.waves.map(|wave| times / (wave.norm() * kind.wavelength())),
                waves: seed.waves,
            }
        };
        let kinds = [PatternKind::Lines, PatternKind::Checkerboard];
        if is_along { kinds.map(of_kind) } else { [kinds[1], kinds[0]].map(of_kind) }
    };
    let all = seeds.iter().filter(is_ruling).flat_map(of_seed);
    all.filter(|hypothesis| hypothesis.pitch_px.iter().all(|pitch_px| *pitch_px > LEAST_WAVE_PX * FRAC_1_SQRT_2))
        .collect()
}

/// The sheet from the waves' phases, the places that show it, and the share of the places with strong waves that these are; `None` where they
/// are too few.
///
/// Phases are counted from window to window only as far as nothing is in the way. A sheet that fits them predicts the phases beyond, so that
/// each round sees more of the sheet, until it has seen all.
fn sheet_by_windows(
    plane: &Plane,
    lens: &Lens,
    kind: PatternKind,
    pitch_mm: f64,
    waves: [Vector2<f64>; 2],
) -> Option<(Vec<TargetPoint>, SheetFit, f64)> {
    let mut windows = Windows::new(plane, kind, waves)?;
    let mut points: Vec<TargetPoint> = windows.points(pitch_mm);
    if points.len() < FEWEST_POINTS {
        return None;
    }
    let square = square_sheet(lens, pitch_mm, kind.gradients(waves), &points)?;
    let mut fit = fit_from_afar(lens, &points, &square, design_effect(kind))?;
    for _ in 0..MOST_ROUNDS {
        windows.measure_again(lens, pitch_mm, &fit.sheet);
        let seen = windows.points(pitch_mm);
        if seen.len() < FEWEST_POINTS {
            return None;
        }
        let has_all = (seen.len() as f64) < GROWING * points.len() as f64;
        points = seen;
        fit = fit_points(lens, &points, &fit.sheet.seen_at(&points), design_effect(kind))?;
        if has_all {
            break;
        }
    }
    Some((points, fit, windows.agreeing()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;

    #[test]
    fn the_lines_of_a_checkerboard_run_along_its_squares() {
        let waves = [Vector2::new(0.05, 0.05), Vector2::new(0.05, -0.05)];
        let sheet = Sheet::flat(Pose::identity());
        let seen = SheetHypothesis { kind: PatternKind::Checkerboard, sheet, pitch_px: [10.0; 2], waves };
        let off = |kind, expected: [[f64; 2]; 2]| {
            let lines = SheetHypothesis { kind, ..seen.clone() }.lines_px();
            lines.into_iter().zip(expected).map(|(line, expected)| (line - Vector2::from(expected)).norm()).sum::<f64>()
        };
        assert!(off(PatternKind::Checkerboard, [[10.0, 0.0], [0.0, 10.0]]) < 1e-9);
        let along = 10.0 * FRAC_1_SQRT_2;
        assert!(off(PatternKind::Lines, [[along, along], [along, -along]]) < 1e-9);
    }
}
