//! Whether the camera, the snake's base and the paper are still where the rig says.
//!
//! Two things in a frame do not bend: the holder below the base, and the paper. The holder's edges are looked for where the
//! rig puts them; the paper is asked for the phase of its print's waves in a few windows, sampled sparsely, which costs a
//! thousandth of what finding the grid anew would. A shift by a whole number of pitches leaves the phases as they were,
//! but not the holder.

use super::edges::EdgeFinder;
use super::fit::{EdgeBias, robust_weights};
use super::grid::{Pattern, paper_at, phases_from_paper, project_paper, waves_from_gradient};
use super::outline::{Outline, OutlinePoint, Piece, Projection};
use super::plane::median;
use super::rig::Rig;
use crate::camera::{Frame, Lens};
use crate::geometry::{Configuration, Pose};
use crate::record::Status;
use nalgebra::{DMatrix, DVector, Matrix3, Point2, Translation3, UnitQuaternion, Vector2, Vector3};
use rustfft::num_complex::Complex;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// What is printed on the paper, and in which mix of colours it shows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Print {
    /// The pattern.
    pub pattern: Pattern,
    /// Weight of each channel (one for grey, three for red, green, blue): the mix has its crests where the grid's
    /// coordinates are whole pitches.
    pub weights: Vec<f64>,
}

impl Default for Print {
    /// Dark lines.
    fn default() -> Self {
        Self { pattern: Pattern::Lines, weights: vec![-1.0; 3] }
    }
}

/// How far holder and paper are from where the rig says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Watched {
    /// The holder's shift; `None` where too little of it is seen.
    pub base: Option<BaseShift>,
    /// The paper's shift, up to whole pitches; `None` where its print is not seen.
    pub grid: Option<GridShift>,
}

/// The holder's shift in the picture: right and down at its middle, and its turn clockwise as a shift at
/// [`BaseShift::ARM_PX`]; px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BaseShift {
    pub by: Vector3<f64>,
    pub covariance: Matrix3<f64>,
}

/// The paper's shift.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct GridShift {
    /// Root mean square of the shift across the print's waves over all windows, px.
    pub px: f64,
    /// Its standard deviation, px.
    pub sigma_px: f64,
    /// The shift in the picture where the holder's middle is seen, px.
    pub at_base: Vector2<f64>,
    /// The part that no sliding in its own plane explains, turns about the paper's axes and a lift, in units of what is
    /// allowed for.
    pub lean: f64,
}

/// What is looked at in every frame, made ready once.
#[derive(Debug)]
pub(super) struct Watch {
    holder: Vec<OutlinePoint>,
    /// The middle of these places.
    middle: Point2<f64>,
    bias: EdgeBias,
    print: Option<PrintWatch>,
}

/// A holder that is found further from its place than this, px, has moved; it takes as much light and shadow less.
const BASE_MOVED_PX: f64 = 0.3;
/// The same for the paper.
const GRID_MOVED_PX: f64 = 0.4;
/// Turns (rad) and lift (mm) of the paper that may come from its own waviness.
const LEAN_RAD: f64 = 0.15 * PI / 180.0;
const LIFT_MM: f64 = 0.2;
/// What is no more than this many times its σ is nothing.
const SURE: f64 = 5.0;

impl Watch {
    pub fn new(lens: &Lens, rig: &Rig, view: &Projection) -> Self {
        const CLEAR_PX: f64 = 5.0;
        const PLACES: usize = 90;
        let outline = Outline::new(view, Configuration::new(0.0, 0.0));
        let clear = |p: &OutlinePoint| {
            matches!(p.piece, Piece::HolderSide(_) | Piece::BaseRim) && p.gap_px >= CLEAR_PX && p.depth_px >= CLEAR_PX
        };
        let holder: Vec<OutlinePoint> = outline.points.into_iter().filter(clear).collect();
        let step = holder.len().div_ceil(PLACES).max(1);
        let holder: Vec<OutlinePoint> = holder.into_iter().step_by(step).collect();
        let sum = holder.iter().map(|p| p.pixel.coords).sum::<Vector2<f64>>();
        Self {
            middle: Point2::from(sum / holder.len().max(1) as f64),
            holder,
            bias: rig.edge_bias,
            print: PrintWatch::new(lens, &rig.camera_from_grid, rig.grid_pitch_mm, &rig.print),
        }
    }

    /// Looks at holder and paper in one frame, whose edges the finder finds.
    pub fn look(&self, frame: &Frame, finder: &mut EdgeFinder) -> Watched {
        Watched {
            base: self.base_shift(finder),
            grid: self.print.as_ref().and_then(|print| print.shift(&print.phases(frame), &self.middle)),
        }
    }

    /// The holder's shift and turn in the picture.
    fn base_shift(&self, finder: &mut EdgeFinder) -> Option<BaseShift> {
        const ENOUGH: f64 = 0.5;
        let mut moved = DVector::zeros(5);
        let mut fit = None;
        for search_px in [12.0, 5.0, 4.0] {
            let mut rows: Vec<[f64; 5]> = Vec::new();
            let mut right: Vec<f64> = Vec::new();
            for point in &self.holder {
                let normal = point.normal.into_inner();
                let arm = (point.pixel - self.middle) / BaseShift::ARM_PX;
                let turned = normal.y * arm.x - normal.x * arm.y;
                let shift = Vector2::new(moved[0] - moved[2] * arm.y, moved[1] + moved[2] * arm.x);
                let there = OutlinePoint { pixel: point.pixel + shift, ..*point };
                let Some(edge) = finder.find(&there, search_px) else { continue };
                let is_side = matches!(point.piece, Piece::HolderSide(_));
                let bias = if is_side { self.bias.side_px } else { self.bias.rim_px };
                let sigma_px = edge.sigma_px.hypot(EDGE_PX);
                let row = [normal.x, normal.y, turned, f64::from(is_side), f64::from(!is_side)];
                rows.push(row.map(|v| v / sigma_px));
                right.push((edge.offset_px + normal.dot(&shift) - bias) / sigma_px);
            }
            if (rows.len() as f64) < ENOUGH * self.holder.len() as f64 || rows.len() < 12 {
                return None;
            }
            let jacobian = DMatrix::from_fn(rows.len(), 5, |r, c| rows[r][c]);
            // Without the base's rim nothing tells a shift along the holder: px, px, px at 100 px, px, px.
            let prior = [10.0, 10.0, 10.0, 0.1, 0.1];
            let found = robust_linear(&jacobian, &DVector::from_vec(right), &prior, search_px > 10.0)?;
            moved = found.x.clone();
            fit = Some(found);
        }
        let found = fit?;
        if found.agreeing < ENOUGH * self.holder.len() as f64 {
            return None;
        }
        /// Neighbouring edges err alike.
        const ALIKE: f64 = 4.0;
        Some(BaseShift {
            by: found.x.fixed_rows::<3>(0).into_owned(),
            covariance: found.covariance.fixed_view::<3, 3>(0, 0) * ALIKE,
        })
    }
}

/// Systematic error of an edge of the holder, px.
const EDGE_PX: f64 = 0.06;

impl Watched {
    /// Why angles of this frame would be wrong, if they would.
    ///
    /// A holder that is elsewhere means that camera or base moved: the camera, if the paper is elsewhere too. A paper that
    /// only slid in its own plane, behind a holder that did not go with it, changes no angle.
    pub fn status(&self) -> Option<Status> {
        let slid = self.grid.filter(|grid| grid.px > GRID_MOVED_PX.max(SURE * grid.sigma_px));
        let leans = self.grid.is_some_and(|grid| grid.lean > 1.0);
        match (self.base, slid) {
            (Some(base), _) if base.is_elsewhere() => {
                Some(if slid.is_none() && self.grid.is_some() { Status::BaseMoved } else { Status::CameraMoved })
            }
            (Some(base), Some(grid)) if base.went_with(&grid) => Some(Status::CameraMoved),
            (None, Some(_)) => Some(Status::CameraMoved),
            _ if leans => Some(Status::CameraMoved),
            _ => None,
        }
    }
}

impl BaseShift {
    /// Where a turn is told as a shift, px from the middle.
    const ARM_PX: f64 = 100.0;

    /// Squared distance of the shift from another, in units of its covariance.
    fn distance2(&self, other: &Vector3<f64>) -> f64 {
        let off = self.by - other;
        self.covariance.cholesky().map_or(0.0, |factor| off.dot(&factor.solve(&off)))
    }

    fn is_elsewhere(&self) -> bool {
        self.by.norm() > BASE_MOVED_PX && self.distance2(&Vector3::zeros()) > SURE * SURE
    }

    /// Whether the holder moved as the paper did rather than stayed.
    fn went_with(&self, grid: &GridShift) -> bool {
        let with = Vector3::new(grid.at_base.x, grid.at_base.y, self.by.z);
        self.distance2(&with) < self.distance2(&Vector3::zeros())
    }
}

/// The paper's waves in a few windows.
#[derive(Debug)]
pub(super) struct PrintWatch {
    lens: Lens,
    camera_from_grid: Pose,
    weights: Vec<f64>,
    windows: Vec<Window>,
    /// What each wave's phase, as a shift in px, does when the paper moves in its own frame: shift x, y, z (mm), turn about
    /// x, y, z (rad). Two rows a window.
    by_motion: DMatrix<f64>,
}

/// A square of the picture, tapered towards its borders, in which phases are measured.
#[derive(Debug)]
struct Window {
    /// The first pixel.
    corner: (usize, usize),
    /// The rows that are sampled, each with the first of its columns.
    rows: Vec<(usize, usize)>,
    side: usize,
    stride: usize,
    taper: Vec<f32>,
    waves: [WindowWave; 2],
    /// Sum of the taper over the samples.
    weight: f64,
}

#[derive(Debug)]
struct WindowWave {
    /// Factors of the wave along columns and rows, times the taper.
    across: Vec<Complex<f32>>,
    down: Vec<Complex<f32>>,
    /// What a flat picture of 1 leaves.
    flat: Complex<f64>,
    /// Where the rig expects the crests, cycles.
    expected: f64,
    wavelength_px: f64,
}

/// Phases of both waves in every window, cycles beyond what the rig expects, with their amplitudes.
pub(super) type Phases = Vec<[(f64, f64); 2]>;

impl PrintWatch {
    /// `None` where the picture holds too few windows.
    pub fn new(lens: &Lens, camera_from_grid: &Pose, pitch_mm: f64, print: &Print) -> Option<Self> {
        const COLUMNS: usize = 6;
        const ROWS: usize = 4;
        let (width, height) = (f64::from(lens.width), f64::from(lens.height));
        let middle = Point2::new(width / 2.0, height / 2.0);
        let wave = |at: &Point2<f64>| {
            let (paper, gradient) = paper_at(lens, camera_from_grid, at)?;
            let waves = waves_from_gradient(gradient / pitch_mm, print.pattern);
            Some((phases_from_paper(paper.coords / pitch_mm, print.pattern), waves))
        };
        let (_, [longest, other]) = wave(&middle)?;
        let wavelength_px = 1.0 / longest.norm().min(other.norm());
        let radius = (print.pattern.window() * wavelength_px).ceil();
        let (free_x, free_y) = (width - 2.0 * radius - 3.0, height - 2.0 * radius - 3.0);
        if !radius.is_finite() || free_x < radius || free_y < 0.5 * radius {
            return None;
        }
        let stride = ((wavelength_px / 6.0).floor() as usize).clamp(1, 3);
        let mut windows = Vec::new();
        for k in 0..COLUMNS * ROWS {
            let share = |k: usize, count: usize| k as f64 / (count - 1) as f64;
            let x = (1.0 + share(k % COLUMNS, COLUMNS) * free_x).floor();
            let y = (1.0 + share(k / COLUMNS, ROWS) * free_y).floor();
            let centre = Point2::new(x + radius, y + radius);
            let (phases, waves) = wave(&centre)?;
            windows.push(Window::new((x as usize, y as usize), radius as usize, stride, phases, waves));
        }
        let by_motion = DMatrix::from_columns(
            &(0..6)
                .map(|axis| {
                    const STEPS: [f64; 6] = [1e-3, 1e-3, 1e-2, 1e-5, 1e-5, 1e-5];
                    let column = |sign: f64| -> Option<Vec<f64>> {
                        let mut by = [0.0; 6];
                        by[axis] = sign * STEPS[axis];
                        let moved = moved_paper(camera_from_grid, &by);
                        let mut column = Vec::new();
                        for window in &windows {
                            let (paper, _) = paper_at(lens, &moved, &window.centre())?;
                            let phases = phases_from_paper(paper.coords / pitch_mm, print.pattern);
                            column.extend((0..2).map(|k| phases[k] * window.waves[k].wavelength_px));
                        }
                        Some(column)
                    };
                    let (ahead, behind) = (DVector::from_vec(column(1.0)?), DVector::from_vec(column(-1.0)?));
                    Some((ahead - behind) / (2.0 * STEPS[axis]))
                })
                .collect::<Option<Vec<_>>>()?,
        );
        let (lens, camera_from_grid) = (lens.clone(), *camera_from_grid);
        Some(Self { lens, camera_from_grid, weights: print.weights.clone(), windows, by_motion })
    }

    /// The mix of channels in which the paper's waves are strongest and have their crests where the rig expects them.
    pub fn weights_in(&self, frame: &Frame) -> Vec<f64> {
        let amplitude = |channel: usize| -> f64 {
            let only: Vec<f64> = (0..frame.channels).map(|c| f64::from(u8::from(c == channel))).collect();
            let phases = self.windows.iter().flat_map(|window| window.phases(frame, &only));
            phases.map(|(phase, amplitude)| amplitude * (TAU * phase).cos()).sum()
        };
        let amplitudes = DVector::from_fn(frame.channels, |c, _| amplitude(c));
        let norm = amplitudes.norm().max(f64::MIN_POSITIVE);
        amplitudes.iter().map(|a| a / norm).collect()
    }

    /// Measures all phases in a frame.
    pub fn phases(&self, frame: &Frame) -> Phases {
        let weights: Vec<f64> = match (self.weights.len(), frame.channels) {
            (a, b) if a == b => self.weights.clone(),
            (_, channels) => vec![self.weights.iter().sum::<f64>() / channels as f64; channels],
        };
        self.windows.iter().map(|window| window.phases(frame, &weights)).collect()
    }

    /// How far the paper moved, up to whole pitches; `None` where the phases do not agree on anything.
    pub fn shift(&self, phases: &Phases, base: &Point2<f64>) -> Option<GridShift> {
        let start = self.start(phases);
        let lengths: Vec<f64> =
            self.windows.iter().flat_map(|w| [w.waves[0].wavelength_px, w.waves[1].wavelength_px]).collect();
        let measured: Vec<f64> = phases.iter().flatten().map(|(phase, _)| *phase).collect();
        // The nearest whole number of waves to where the start puts each phase.
        let expected = &self.by_motion * &start;
        let seen = DVector::from_fn(measured.len(), |k, _| {
            let cycles = expected[k] / lengths[k];
            (cycles + wrap_cycles(measured[k] - cycles)) * lengths[k]
        });
        /// Scatter of a phase that shows the print, cycles.
        const CLEAR_CYCLES: f64 = 0.06;
        const PHASE_PX: f64 = 0.05;
        // mm and rad.
        let prior = [5.0, 5.0, 5.0, 0.05, 0.05, 0.05];
        let jacobian = &self.by_motion / PHASE_PX;
        let right = &seen / PHASE_PX;
        let found = robust_linear(&jacobian, &right, &prior, false)?;
        let left = &seen - &self.by_motion * &found.x;
        let mut cycles: Vec<f32> = left.iter().zip(&lengths).map(|(l, length)| (l / length).abs() as f32).collect();
        if 1.4826 * f64::from(median(&mut cycles)) > CLEAR_CYCLES || found.agreeing < 0.5 * lengths.len() as f64 {
            return None;
        }
        let count = lengths.len() as f64;
        let px = (&self.by_motion * &found.x).norm() / count.sqrt();
        /// Windows overlap, and share the printing's errors.
        const ALIKE: f64 = 4.0;
        let covariance = &found.covariance * ALIKE;
        let sigma_px = ((&self.by_motion * &covariance * self.by_motion.transpose()).trace() / count).sqrt();
        let lean = |k: usize, allowed: f64| found.x[k].abs() / allowed.max(SURE * covariance[(k, k)].sqrt());
        let lean = lean(2, LIFT_MM).max(lean(3, LEAN_RAD)).max(lean(4, LEAN_RAD));
        let (paper, _) = paper_at(&self.lens, &self.camera_from_grid, base)?;
        let moved = moved_paper(&self.camera_from_grid, &std::array::from_fn(|k| found.x[k]));
        let at_base = project_paper(&self.lens, &moved, &paper) - base;
        Some(GridShift { px, sigma_px, at_base, lean })
    }

    /// The motion, of a few turns and lifts and any slide, under which the phases agree best.
    fn start(&self, phases: &Phases) -> DVector<f64> {
        const TURN_RAD: f64 = 0.005;
        const LIFT_MM: f64 = 1.0;
        const REACH: i32 = 5;
        let mut best = (f64::MIN, DVector::zeros(6));
        let reach = if self.slide(phases, &DVector::zeros(6)).0 > 1.6 { 0 } else { REACH };
        for turn in -reach..=reach {
            for lift in -reach..=reach {
                let mut motion = DVector::zeros(6);
                motion[5] = f64::from(turn) * TURN_RAD;
                motion[2] = f64::from(lift) * LIFT_MM;
                let (agreement, cycles) = self.slide(phases, &motion);
                if agreement > best.0 {
                    // The slide that moves the middle's phases by as much.
                    let k = self.windows.len() / 2;
                    let slide = nalgebra::Matrix2::from_fn(|r, c| self.by_motion[(2 * k + r, c)]);
                    let px = Vector2::from_fn(|r, _| cycles[r] * self.windows[k].waves[r].wavelength_px);
                    if let Some(by) = slide.try_inverse().map(|inverse| inverse * px) {
                        motion[0] = by.x;
                        motion[1] = by.y;
                    }
                    best = (agreement, motion);
                }
            }
        }
        best.1
    }

    /// How well all phases agree on one slide after a motion, 0 to 2, and its cycles along both waves.
    fn slide(&self, phases: &Phases, motion: &DVector<f64>) -> (f64, [f64; 2]) {
        let expected = &self.by_motion * motion;
        let mut sums = [Complex::<f64>::ZERO; 2];
        let mut weights = [0.0; 2];
        for (w, (window, phases)) in self.windows.iter().zip(phases).enumerate() {
            for k in 0..2 {
                let (phase, amplitude) = phases[k];
                let cycles = phase - expected[2 * w + k] / window.waves[k].wavelength_px;
                sums[k] += Complex::from_polar(amplitude, TAU * cycles);
                weights[k] += amplitude;
            }
        }
        let agreement = (0..2).map(|k| sums[k].norm() / weights[k].max(f64::MIN_POSITIVE)).sum();
        (agreement, sums.map(|sum| sum.arg() / TAU))
    }
}

/// The paper's pose after it moved in its own frame: shift x, y, z (mm), turn about x, y, z (rad).
fn moved_paper(camera_from_grid: &Pose, by: &[f64; 6]) -> Pose {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(by[3], by[4], by[5]));
    camera_from_grid * Pose::from_parts(Translation3::new(by[0], by[1], by[2]), turn)
}

fn wrap_cycles(cycles: f64) -> f64 {
    cycles - cycles.round()
}

impl Window {
    fn new(
        corner: (usize, usize),
        radius: usize,
        stride: usize,
        phases: Vector2<f64>,
        waves: [Vector2<f64>; 2],
    ) -> Self {
        let side = 2 * radius + 1;
        let place = |k: usize| k as f64 - radius as f64;
        let taper: Vec<f64> = (0..side).map(|k| 0.5 + 0.5 * (PI * place(k) / (radius as f64 + 1.0)).cos()).collect();
        // Every so many pixels, but not in step: what a regular grid would mistake for the wave becomes noise.
        let jitter = |k: usize, salt: u64| {
            let bits = (k as u64 + salt).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            ((bits >> 40) % stride as u64) as usize
        };
        let rows: Vec<(usize, usize)> = (0..side / stride)
            .map(|k| (k * stride + jitter(k, 1), jitter(k, 1000)))
            .filter(|(row, _)| *row < side)
            .collect();
        let sampled = |first: usize| (first..side).step_by(stride);
        let weight = rows.iter().map(|&(row, first)| taper[row] * sampled(first).map(|c| taper[c]).sum::<f64>()).sum();
        let wave = |k: usize| {
            let wave: Vector2<f64> = waves[k];
            let factors = |along: f64| -> Vec<Complex<f64>> {
                (0..side).map(|k| Complex::from_polar(taper[k], -TAU * along * place(k))).collect()
            };
            let (across, down) = (factors(wave.x), factors(wave.y));
            let flat =
                rows.iter().map(|&(row, first)| down[row] * sampled(first).map(|c| across[c]).sum::<Complex<f64>>());
            let narrow =
                |factors: &[Complex<f64>]| factors.iter().map(|c| Complex::new(c.re as f32, c.im as f32)).collect();
            WindowWave {
                flat: flat.sum(),
                across: narrow(&across),
                down: narrow(&down),
                expected: phases[k],
                wavelength_px: 1.0 / wave.norm(),
            }
        };
        let taper_f32 = taper.iter().map(|t| *t as f32).collect();
        Self { corner, waves: [wave(0), wave(1)], rows, side, stride, taper: taper_f32, weight }
    }

    fn centre(&self) -> Point2<f64> {
        let radius = (self.side / 2) as f64;
        Point2::new(self.corner.0 as f64 + radius, self.corner.1 as f64 + radius)
    }

    /// Phase (cycles from what is expected, in [−½, ½)) and amplitude of both waves.
    fn phases(&self, frame: &Frame, weights: &[f64]) -> [(f64, f64); 2] {
        let (x0, y0) = self.corner;
        let mut sums = [Complex::<f64>::ZERO; 2];
        let mut plain = 0.0;
        let weights: Vec<f32> = weights.iter().map(|w| *w as f32).collect();
        let [first_wave, second_wave] = &self.waves;
        for &(row, first) in &self.rows {
            let start = ((y0 + row) * frame.width as usize + x0) * frame.channels;
            let Some(pixels) = frame.data.get(start..start + self.side * frame.channels) else { continue };
            let mut grey = 0.0_f32;
            let mut turned = [Complex::<f32>::ZERO; 2];
            let mut column = first;
            while column < self.side {
                let pixel = &pixels[column * frame.channels..][..frame.channels];
                let value: f32 = pixel.iter().zip(&weights).map(|(v, w)| v * w).sum();
                grey += self.taper[column] * value;
                turned[0] += first_wave.across[column] * value;
                turned[1] += second_wave.across[column] * value;
                column += self.stride;
            }
            plain += f64::from(grey * self.taper[row]);
            for k in 0..2 {
                let sum = turned[k] * self.waves[k].down[row];
                sums[k] += Complex::new(f64::from(sum.re), f64::from(sum.im));
            }
        }
        // The mean grey must not leak into the wave.
        let mean = plain / self.weight;
        std::array::from_fn(|k| {
            let wave = (sums[k] - self.waves[k].flat * mean) / self.weight;
            (wrap_cycles(wave.arg() / TAU - self.waves[k].expected), wave.norm())
        })
    }
}

/// The solution of a linear least-squares problem.
struct Linear {
    x: DVector<f64>,
    covariance: DMatrix<f64>,
    /// How many rows agree.
    agreeing: f64,
}

/// Robust linear least squares, rows in units of their σ, with independent priors of mean zero.
fn robust_linear(jacobian: &DMatrix<f64>, right: &DVector<f64>, prior: &[f64], settling: bool) -> Option<Linear> {
    const ROUNDS: usize = 8;
    let priors = DMatrix::from_diagonal(&DVector::from_iterator(prior.len(), prior.iter().map(|s| s.powi(-2))));
    let mut x = DVector::zeros(prior.len());
    let mut roots = vec![1.0; right.len()];
    let mut normal = priors.clone();
    for round in 0..ROUNDS {
        if round > 0 {
            let left: Vec<f64> = (right - jacobian * &x).iter().copied().collect();
            roots = robust_weights(&left, settling || round < ROUNDS / 2);
        }
        let weight = DVector::from_iterator(right.len(), roots.iter().map(|w| w * w));
        let weighted = DMatrix::from_fn(jacobian.nrows(), jacobian.ncols(), |r, c| jacobian[(r, c)] * weight[r]);
        normal = &priors + weighted.transpose() * jacobian;
        x = normal.clone().cholesky()?.solve(&(weighted.transpose() * right));
    }
    let left = right - jacobian * &x;
    let (mut sum, mut count) = (0.0, 0.0);
    for (l, root) in left.iter().zip(&roots) {
        sum += (l * root).powi(2);
        count += root * root;
    }
    let freedom = (count - prior.len() as f64).max(1.0);
    let covariance = normal.cholesky()?.inverse() * (sum / freedom).max(1.0);
    let agreeing = roots.iter().filter(|root| **root > 0.5).count() as f64;
    Some(Linear { x, covariance, agreeing })
}
