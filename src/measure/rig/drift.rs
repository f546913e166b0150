//! Whether the camera, the snake's base and the paper are still where the rig says.
//!
//! Two things in a frame do not bend: the holder below the base, and the paper. The holder's edges are looked for where the
//! rig puts them; the paper is asked for the phase of its print's waves in a few windows, sampled sparsely, which costs a
//! thousandth of what finding the grid anew would. A shift by a whole number of pitches leaves the phases as they were,
//! but not the holder.

use crate::camera::{Frame, Lens, Sample, Samples};
use crate::geometry::{Configuration, Pose};
use crate::measure::body::{BodyPoint, Outline, OutlinePoint, Piece, Projection};
use crate::measure::fit::{EdgeBias, EdgeFinder, RobustPhase};
use crate::measure::image::plane::median;
use crate::measure::rig::calibrate::Rig;
use crate::measure::target::grid::{Pattern, nudged, paper_at, phases_from_paper, project_paper, waves_from_gradient};
use crate::observation::Status;
use nalgebra::{
    DMatrix, DVector, Matrix2, Matrix3, Matrix6, Point2, Translation3, UnitQuaternion, Vector2, Vector3, Vector6,
};
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
pub(crate) struct Watched {
    /// The holder's shift; `None` where too little of it is seen.
    pub base: Option<BaseShift>,
    /// The paper's shift, up to whole pitches; `None` where its print is not seen.
    pub grid: Option<GridShift>,
}

/// The holder's shift in the picture: right and down at its middle, and its turn clockwise as a shift at
/// [`BaseShift::ARM_PX`]; px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BaseShift {
    pub by: Vector3<f64>,
    pub covariance: Matrix3<f64>,
}

/// The paper's shift.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct GridShift {
    /// Root mean square of the shift across the print's waves over all windows, px.
    pub px: f64,
    /// Its standard deviation, px.
    pub sigma_px: f64,
    /// The shift in the picture where the holder's middle is seen, px.
    pub at_base: Vector2<f64>,
    /// The part that no sliding in its own plane explains, turns about the paper's axes and a lift, in units of what is
    /// allowed for.
    pub lean: f64,
    /// Whether it may as well be the camera that turned about the snake's base, which shifts the paper behind it.
    pub may_be_a_turn: bool,
    /// The camera's pose to the paper where it is now.
    pub camera_from_grid: Pose,
}

/// What is looked at in every frame, made ready once.
#[derive(Debug)]
pub(crate) struct Watch {
    holder: Vec<OutlinePoint>,
    /// The middle of these places.
    middle: Point2<f64>,
    bias: EdgeBias,
    print: Option<PrintWatch>,
}

/// A holder that is found further from its place than this, px, has moved; it takes as much light and shadow less.
const BASE_MOVED_PX: f64 = 0.4;
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
            print: PrintWatch::new(lens, &rig.camera_from_grid, rig.standoff_mm(), rig.grid_pitch_mm, &rig.print),
        }
    }

    /// Looks at holder and paper in one frame, whose edges the finder finds.
    pub fn look(&self, frame: &Frame, finder: &EdgeFinder) -> Watched {
        Watched {
            base: self.base_shift(finder),
            grid: self.print.as_ref().and_then(|print| print.shift(&print.phases(frame), &self.middle)),
        }
    }

    /// The holder's shift and turn in the picture.
    fn base_shift(&self, finder: &EdgeFinder) -> Option<BaseShift> {
        let enough = (0.5 * self.holder.len() as f64).max(12.0);
        let mut by = Vector3::zeros();
        let mut fit = None;
        for search_px in [12.0, 5.0, 4.0] {
            let edges = self.holder_edges(finder, &by, search_px);
            if (edges.len() as f64) < enough {
                return None;
            }
            let row = |e: &HolderEdge| {
                let (x, y) = (e.normal.x, e.normal.y);
                [x, y, y * e.arm.x - x * e.arm.y, f64::from(e.is_side), f64::from(!e.is_side)]
            };
            let jacobian = DMatrix::from_fn(edges.len(), 5, |r, c| row(&edges[r])[c] / edges[r].sigma_px);
            let right = DVector::from_fn(edges.len(), |r, _| edges[r].distance_px / edges[r].sigma_px);
            // Without the base's rim nothing tells a shift along the holder.
            let prior = [10.0, 10.0, 10.0, BIAS_PX, BIAS_PX];
            let found = robust_linear(&jacobian, &right, &prior, search_px > 10.0)?;
            by = found.x.fixed_rows::<3>(0).into_owned();
            fit = Some(found);
        }
        let found = fit?;
        let covariance = found.covariance.fixed_view::<3, 3>(0, 0) * ALIKE;
        (found.agreeing >= enough).then_some(BaseShift { by, covariance })
    }

    /// The holder's edges near their places once it is shifted.
    fn holder_edges(&self, finder: &EdgeFinder, by: &Vector3<f64>, search_px: f64) -> Vec<HolderEdge> {
        let mut edge = |point: &OutlinePoint| {
            let normal = point.normal.into_inner();
            let arm = (point.pixel - self.middle) / BaseShift::ARM_PX;
            let shift = Vector2::new(by.x - by.z * arm.y, by.y + by.z * arm.x);
            let edge = finder.find(&OutlinePoint { pixel: point.pixel + shift, ..*point }, search_px)?;
            let is_side = matches!(point.piece, Piece::HolderSide(_));
            Some(HolderEdge {
                body: point.body,
                normal,
                arm,
                is_side,
                distance_px: edge.offset_px + normal.dot(&shift) - self.bias.of(point.piece),
                sigma_px: edge.sigma_px.hypot(EDGE_PX),
            })
        };
        self.holder.iter().filter_map(&mut edge).collect()
    }

    /// How the camera moved against holder and paper, which did not move against each other; `None` where they do not tell.
    pub fn camera_motion(&self, frame: &Frame, finder: &EdgeFinder, view: &Projection) -> Option<CameraMotion> {
        let print = self.print.as_ref()?;
        let base = self.base_shift(finder);
        let edges = base.map(|base| self.holder_edges(finder, &base.by, 4.0)).unwrap_or_default();
        let pose = view.camera_from_base;
        let by_camera = print.by_camera(&pose.translation.vector);
        let phases = print.phases(frame);
        // The holder tells which of the waves a phase belongs to; without it the nearest has to do.
        let expected = match base {
            Some(base) => {
                let mm_per_px = pose.translation.vector.z / view.lens.focal_px.x;
                let (x, y) = (base.by.x * mm_per_px, base.by.y * mm_per_px);
                &by_camera * DVector::from_column_slice(&[0.0, 0.0, base.by.z / BaseShift::ARM_PX, x, y, 0.0])
            }
            None => &print.by_motion * print.start(&phases),
        };
        let seen = print.seen_px(&phases, &expected);
        const STEP: f64 = 1e-4;
        let pixel = |e: &HolderEdge, axis: usize, step: f64| {
            let mut by = DVector::zeros(6);
            by[axis] = step;
            let moved = Projection { camera_from_base: nudged(&pose, &by), ..view.clone() };
            moved.pixel(Configuration::new(0.0, 0.0), &e.body)
        };
        let by_step =
            |e: &HolderEdge, axis: usize| e.normal.dot(&(pixel(e, axis, STEP) - pixel(e, axis, -STEP))) / (2.0 * STEP);
        let (waves, count) = (seen.len(), seen.len() + edges.len());
        let jacobian = DMatrix::from_fn(count, 8, |r, c| match (r < waves, c) {
            (true, 0..6) => by_camera[(r, c)] / PHASE_PX,
            (true, _) => 0.0,
            (false, 0..6) => by_step(&edges[r - waves], c) / edges[r - waves].sigma_px,
            (false, c) => f64::from(edges[r - waves].is_side == (c == 6)) / edges[r - waves].sigma_px,
        });
        let right = DVector::from_fn(count, |r, _| match r.checked_sub(waves) {
            None => seen[r] / PHASE_PX,
            Some(k) => edges[k].distance_px / edges[k].sigma_px,
        });
        // rad, mm and px.
        let prior = [0.2, 0.2, 0.2, 20.0, 20.0, 50.0, BIAS_PX, BIAS_PX];
        let found = robust_linear(&jacobian, &right, &prior, false)?;
        let by = found.x.fixed_rows::<6>(0).into_owned();
        let px = (&by_camera * found.x.rows(0, 6)).norm() / (waves as f64).sqrt();
        let covariance = found.covariance.fixed_view::<6, 6>(0, 0) * ALIKE;
        (found.agreeing > 0.5 * count as f64).then_some(CameraMotion { by, covariance, px })
    }
}

/// An edge of the holder.
struct HolderEdge {
    body: BodyPoint,
    normal: Vector2<f64>,
    /// From the holder's middle, in units of [`BaseShift::ARM_PX`].
    arm: Vector2<f64>,
    is_side: bool,
    /// How far outside its place it is, px.
    distance_px: f64,
    sigma_px: f64,
}

/// How the camera moved.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CameraMotion {
    /// A turn about the base's origin (rad) and a shift (mm), along the camera's axes.
    pub by: Vector6<f64>,
    pub covariance: Matrix6<f64>,
    /// The same as a shift of the paper in the picture, px.
    pub px: f64,
}

/// Systematic error of an edge of the holder, px.
const EDGE_PX: f64 = 0.06;
/// The same of a phase, as a shift.
const PHASE_PX: f64 = 0.05;
/// How far the light of a frame may shift the holder's edges outwards, px (1σ).
const BIAS_PX: f64 = 0.1;
/// So many neighbouring edges err alike, and so many windows share the printing's errors.
const ALIKE: f64 = 4.0;

impl Watched {
    /// Whether nothing moved by more than a hair.
    pub fn is_still(&self) -> bool {
        const HAIR_PX: f64 = 0.1;
        let base = |base: BaseShift| base.by.norm() < HAIR_PX || base.distance2(&Vector3::zeros()) < 9.0;
        let grid = |grid: GridShift| grid.px < HAIR_PX.max(3.0 * grid.sigma_px);
        self.base.is_none_or(base) && self.grid.is_some_and(grid)
    }

    /// Why angles of this frame would be wrong, if they would.
    ///
    /// A holder that is elsewhere means that camera or base moved: the camera, if the paper is elsewhere too. A paper that
    /// only slid in its own plane, behind a holder that did not go with it, changes no angle.
    pub fn status(&self) -> Option<Status> {
        let slid = self.grid.filter(|grid| grid.px > GRID_MOVED_PX.max(SURE * grid.sigma_px));
        let leans = self.grid.is_some_and(|grid| grid.lean > 1.0);
        match (self.base, slid) {
            (Some(base), _) if base.is_elsewhere() => {
                let stayed = slid.is_none() && self.grid.is_some_and(|grid| !base.went_with(&grid));
                Some(if stayed { Status::BaseMoved } else { Status::CameraMoved })
            }
            (Some(base), Some(grid)) if base.went_with(&grid) => Some(Status::CameraMoved),
            (None, Some(_)) => Some(Status::CameraMoved),
            (Some(_), Some(grid)) if grid.may_be_a_turn => Some(Status::CameraMoved),
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
    pub fn went_with(&self, grid: &GridShift) -> bool {
        let with = Vector3::new(grid.at_base.x, grid.at_base.y, self.by.z);
        self.distance2(&with) < 0.5 * self.distance2(&Vector3::zeros())
    }
}

/// The paper's waves in a few windows.
#[derive(Debug)]
pub(crate) struct PrintWatch {
    lens: Lens,
    camera_from_grid: Pose,
    standoff_mm: f64,
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
pub(crate) type Phases = Vec<[(f64, f64); 2]>;

impl PrintWatch {
    /// `None` where the picture holds too few windows.
    pub fn new(lens: &Lens, camera_from_grid: &Pose, standoff_mm: f64, pitch_mm: f64, print: &Print) -> Option<Self> {
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
        let stride = ((wavelength_px / 5.0).floor() as usize).clamp(1, 3);
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
        Some(Self { lens, camera_from_grid, standoff_mm, weights: print.weights.clone(), windows, by_motion })
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

    /// Median amplitude of the waves in a frame, grey levels.
    pub fn strength(&self, frame: &Frame) -> f64 {
        let amplitudes = self.phases(frame).into_iter().flatten().map(|(_, amplitude)| amplitude as f32);
        f64::from(median(&mut amplitudes.collect::<Vec<_>>()))
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
        let seen = self.seen_px(phases, &(&self.by_motion * &start));
        /// Scatter of a phase that shows the print, cycles.
        const CLEAR_CYCLES: f64 = 0.06;
        // mm and rad.
        let prior = [5.0, 5.0, 5.0, 0.05, 0.05, 0.05];
        let jacobian = &self.by_motion / PHASE_PX;
        let right = &seen / PHASE_PX;
        let found = robust_linear(&jacobian, &right, &prior, false)?;
        let left = &seen - &self.by_motion * &found.x;
        let lengths = self.windows.iter().flat_map(|window| window.waves.iter().map(|wave| wave.wavelength_px));
        let mut cycles: Vec<f32> = left.iter().zip(lengths).map(|(l, length)| (l / length).abs() as f32).collect();
        let count = left.len() as f64;
        if 1.4826 * f64::from(median(&mut cycles)) > CLEAR_CYCLES || found.agreeing < 0.5 * count {
            return None;
        }
        let px = (&self.by_motion * &found.x).norm() / count.sqrt();
        let covariance = &found.covariance * ALIKE;
        let sigma_px = ((&self.by_motion * &covariance * self.by_motion.transpose()).trace() / count).sqrt();
        let lean = |k: usize, allowed: f64| found.x[k].abs() / allowed.max(SURE * covariance[(k, k)].sqrt());
        let lean = lean(2, LIFT_MM).max(lean(3, LEAN_RAD)).max(lean(4, LEAN_RAD));
        let (paper, _) = paper_at(&self.lens, &self.camera_from_grid, base)?;
        // Turned about the base by ω, the paper at its distance behind it shifts by (ω_y, −ω_x) times that.
        let (turn, at) = (found.x.fixed_rows::<3>(3).into_owned(), Vector3::new(paper.x, paper.y, 0.0));
        let slide = found.x.fixed_rows::<3>(0) + turn.cross(&at);
        let off = turn.xy() - Vector2::new(-slide.y, slide.x) / self.standoff_mm;
        let of_turn = covariance.fixed_view::<2, 2>(3, 3) + Matrix2::identity() * (LEAN_RAD / SURE).powi(2);
        let may_be_a_turn = off.dot(&(of_turn.try_inverse()? * off)) < SURE * SURE;
        let moved = moved_paper(&self.camera_from_grid, &std::array::from_fn(|k| found.x[k]));
        let at_base = project_paper(&self.lens, &moved, &paper) - base;
        Some(GridShift { px, sigma_px, at_base, lean, may_be_a_turn, camera_from_grid: moved })
    }

    /// The shifts, px along each wave, that the phases are, each the one nearest to what is expected.
    fn seen_px(&self, phases: &Phases, expected_px: &DVector<f64>) -> DVector<f64> {
        let length = |k: usize| self.windows[k / 2].waves[k % 2].wavelength_px;
        DVector::from_fn(2 * self.windows.len(), |k, _| {
            let cycles = expected_px[k] / length(k);
            (cycles + wrap_cycles(phases[k / 2][k % 2].0 - cycles)) * length(k)
        })
    }

    /// The same as `by_motion` for a camera that turns about a point (mm, its own axes) and shifts.
    fn by_camera(&self, about: &Vector3<f64>) -> DMatrix<f64> {
        let to_grid = self.camera_from_grid.rotation.inverse().to_rotation_matrix().into_inner();
        let arm = self.camera_from_grid.translation.vector - about;
        let mut paper = DMatrix::zeros(6, 6);
        paper.view_mut((0, 0), (3, 3)).copy_from(&(-to_grid * arm.cross_matrix()));
        paper.view_mut((0, 3), (3, 3)).copy_from(&to_grid);
        paper.view_mut((3, 0), (3, 3)).copy_from(&to_grid);
        &self.by_motion * paper
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
        let weights: Vec<f32> = weights.iter().map(|w| *w as f32).collect();
        // Down every column: the grey and, real and imaginary, both waves' parts. Columns that are sampled together lie side
        // by side, so that the compiler takes many at once.
        let together = self.side.div_ceil(self.stride);
        let place = |column: usize| column % self.stride * together + column / self.stride;
        let mut columns: [Vec<f32>; 5] = std::array::from_fn(|_| vec![0.0; self.stride * together]);
        let mut values = Vec::with_capacity(together);
        for &(row, first) in &self.rows {
            let start = ((y0 + row) * frame.width as usize + x0) * frame.channels;
            let pixels = start..start + self.side * frame.channels;
            let step = (first, self.stride);
            values.clear();
            match &frame.samples {
                Samples::Bits8(samples) => mix(samples.get(pixels), &weights, step, &mut values),
                Samples::Bits16(samples) => mix(samples.get(pixels), &weights, step, &mut values),
            }
            let [one, other] = [0, 1].map(|k| self.waves[k].down[row]);
            for (sums, factor) in columns.iter_mut().zip([self.taper[row], one.re, one.im, other.re, other.im]) {
                sums[first * together..].iter_mut().zip(&values).for_each(|(sum, value)| *sum += value * factor);
            }
        }
        let [grey, parts @ ..] = &columns;
        let plain: f64 = (0..self.side).map(|k| f64::from(grey[place(k)] * self.taper[k])).sum();
        let sums: [Complex<f64>; 2] = std::array::from_fn(|wave| {
            let along = |k: usize| {
                let down = Complex::new(parts[2 * wave][place(k)], parts[2 * wave + 1][place(k)]);
                let along = self.waves[wave].across[k] * down;
                Complex::new(f64::from(along.re), f64::from(along.im))
            };
            (0..self.side).map(along).sum()
        });
        // The mean grey must not leak into the wave.
        let mean = plain / self.weight;
        std::array::from_fn(|k| {
            let wave = (sums[k] - self.waves[k].flat * mean) / self.weight;
            (wrap_cycles(wave.arg() / TAU - self.waves[k].expected), wave.norm())
        })
    }
}

/// The weighted sums of the channels of some pixels: every so many, from the `first` on.
fn mix<S: Sample>(pixels: Option<&[S]>, weights: &[f32], (first, stride): (usize, usize), into: &mut Vec<f32>) {
    let sampled = pixels.unwrap_or_default().chunks_exact(weights.len().max(1)).skip(first).step_by(stride);
    into.extend(sampled.map(|pixel| match (pixel, weights) {
        (&[r, g, b], &[red, green, blue]) => r.level() * red + g.level() * green + b.level() * blue,
        _ => pixel.iter().zip(weights).map(|(v, w)| v.level() * w).sum(),
    }));
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
            let is_monotone = settling || round < ROUNDS / 2;
            let phase = if is_monotone { RobustPhase::Monotone } else { RobustPhase::Redescending };
            roots = phase.roots(&left);
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
