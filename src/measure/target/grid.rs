//! Finds the grid target in a picture, and the camera's pose to it.

use super::lines::{Lines, MOST_SCATTER};
use super::pattern::PatternKind;
use super::phases::{Windows, design_effect};
use super::planar_pose::{PoseFit, TargetPoint, fit_from_afar, fit_points, square_pose};
use super::seed::{Seed, find_seed, strongest_mix};
use crate::camera::{Frame, Lens};
use crate::geometry::Pose;
use crate::measure::image::plane::Plane;
use nalgebra::{Point2, Vector2, Vector3};
use std::ops::RangeInclusive;

/// Rounds in which phases are measured again with the waves that the pose predicts, and lines looked for where it puts them.
///
/// Convention: the first round removes what perspective did to the seed's waves; the second confirms it.
const ROUNDS: usize = 2;
/// Most scatter of the windows about the pose, in periods.
///
/// Fitted: to the rigs of tests/eye/robustness (`cargo test --release --no-default-features --test eye robustness -- --ignored`): there it is below 0.015, and 0.05 and more where
/// windows were miscounted or see no grid; not judged elsewhere.
const MOST_WINDOW_SCATTER: f64 = 0.03;
/// Fewest windows, and least share of the clear ones, that must agree on the grid.
///
/// Fitted: by hand on the project's renders with shadows (tests/eye/robustness); not judged elsewhere.
const FEWEST_POINTS: usize = 12;
const LEAST_SHARE: f64 = 1.0 / 3.0;

/// The least pitch of a grid that is looked for, px.
///
/// Derived: the second difference that places a line spans 4 px; with lines closer than that it would see three of them.
const LEAST_PITCH_PX: f64 = 4.0;

/// The grid in one picture.
#[derive(Debug, Clone)]
pub struct Grid {
    /// The kind of pattern.
    pub kind: PatternKind,
    /// The camera's pose to it.
    pub camera_from_grid: Pose,
    /// Variance of that pose's rotation about each of the camera's axes, rad².
    pub rotation_variance: Vector3<f64>,
    /// Scatter of what was seen of it about the pose, px per coordinate.
    pub rms_px: f64,
}

impl Grid {
    /// The grid of another pitch, in units of this one's, that would be seen in the same place.
    #[must_use]
    pub fn with_pitch_times(&self, factor: f64) -> Self {
        let mut other = self.clone();
        other.camera_from_grid.translation.vector *= factor;
        other
    }

    /// Depth (camera z), mm, at which a line of sight meets the target.
    pub fn distance_mm(&self, ray: &Vector3<f64>) -> f64 {
        let normal = self.camera_from_grid * Vector3::z();
        let along = normal.dot(&self.camera_from_grid.translation.vector) / normal.dot(ray);
        along * ray.z
    }
}

/// Finds the grid in a picture; `None` where there is none.
///
/// `pitch_px` is the range in which the snake's known size puts the pitch, narrow enough that a heavier ruling is not
/// mistaken for it. Within it the finest ruling has the strongest wave, for every heavier line lies on it too. The lines
/// run within 30° of the snake's `axis` or square to it. `is_snake` tells pixels that are not the target's.
pub fn find_grid(
    frame: &Frame,
    lens: &Lens,
    pitch_mm: f64,
    pitch_px: &RangeInclusive<f64>,
    axis: Vector2<f64>,
    is_snake: impl Fn(&Point2<f64>) -> bool + Sync,
) -> Option<Grid> {
    let pitch_px = &(pitch_px.start().max(LEAST_PITCH_PX)..=*pitch_px.end());
    if pitch_px.is_empty() {
        return None;
    }
    let plane = strongest_mix(frame, &is_snake);
    let mut best: Option<(usize, Grid)> = None;
    for kind in [PatternKind::Lines, PatternKind::Checkerboard] {
        let Some(seed) = find_seed(&plane, kind, pitch_px, axis, &is_snake) else { continue };
        let Some((points, fit)) = pose_by_windows(&plane, lens, kind, pitch_mm, &seed, &is_snake) else { continue };
        let fit = match kind {
            PatternKind::Lines => pose_by_lines(&plane, lens, pitch_mm, &seed, fit, &is_snake),
            PatternKind::Checkerboard => Some(fit),
        };
        let Some(PoseFit { camera_from_grid, rotation_variance, rms_px }) = fit else { continue };
        if best.as_ref().is_none_or(|(most, _)| points > *most) {
            best = Some((points, Grid { kind, camera_from_grid, rotation_variance, rms_px }));
        }
    }
    best.map(|(_, grid)| grid)
}

/// The pose from the waves' phases, and how many windows show them; `None` where they are too few or do not agree on a pose.
fn pose_by_windows(
    plane: &Plane,
    lens: &Lens,
    kind: PatternKind,
    pitch_mm: f64,
    seed: &Seed,
    is_snake: &(impl Fn(&Point2<f64>) -> bool + Sync),
) -> Option<(usize, PoseFit)> {
    let mut windows = Windows::new(plane, kind, seed, is_snake)?;
    windows.unwrap_from(seed)?;
    let mut points: Vec<TargetPoint> = windows.points(pitch_mm);
    let square = square_pose(lens, pitch_mm, kind.gradients(seed.waves), points.first()?);
    let mut fit = fit_from_afar(lens, &points, &square, design_effect(kind))?;
    for _ in 0..ROUNDS {
        windows.measure_again(lens, pitch_mm, &fit.camera_from_grid)?;
        points = windows.points(pitch_mm);
        fit = fit_points(lens, &points, &fit.camera_from_grid, design_effect(kind))?;
    }
    let is_enough = points.len() >= FEWEST_POINTS && points.len() as f64 >= LEAST_SHARE * windows.clear_count() as f64;
    (is_enough && fit.rms_px <= MOST_WINDOW_SCATTER * seed.period_px()).then_some((points.len(), fit))
}

/// The pose from the lines themselves, from the one that the waves gave; `None` where the lines are not where the waves put them.
fn pose_by_lines(
    plane: &Plane,
    lens: &Lens,
    pitch_mm: f64,
    seed: &Seed,
    mut fit: PoseFit,
    is_snake: &(impl Fn(&Point2<f64>) -> bool + Sync),
) -> Option<PoseFit> {
    let lines = Lines { plane, lens, pitch_mm, is_snake };
    fit.camera_from_grid = lines.put_origin_on_a_line(fit.camera_from_grid)?;
    for _ in 0..ROUNDS {
        fit = lines.fit_pose(&fit.camera_from_grid)?;
    }
    (fit.rms_px <= MOST_SCATTER * seed.period_px()).then_some(fit)
}
