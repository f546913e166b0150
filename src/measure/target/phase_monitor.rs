//! Whether the grid target is where the rig says, from the phases of its waves in a few windows of a frame.
//!
//! A shift by a whole number of pitches leaves the phases as they were; what tells such shifts is the snake's holder, which the rig's
//! drift monitor looks at beside the target.

use super::pattern::{GridPattern, wrap_cycles};
use super::robust_linear::RobustLinear;
use super::sheet::Sheet;
use super::sparse_window::{Phase, SparseWindow};
use crate::camera::{Frame, Lens};
use crate::geometry::Pose;
use crate::statistics::least_squares::central_differences;
use crate::statistics::order::mad_scale;
use nalgebra::{
    DMatrix, DVector, Matrix2, Matrix2x6, Matrix6, Point2, Translation3, UnitQuaternion, Vector2, Vector3, Vector6,
};
use rustfft::num_complex::Complex;
use std::f64::consts::{PI, TAU};

/// Columns and rows of windows.
///
/// Convention: a limit of time; twelve windows on either side of the snake leave enough of them when a hand covers some.
const COLUMNS: usize = 6;
const ROWS: usize = 4;
/// Pixels that are read per wavelength, and the widest distance between them, px.
///
/// Derived: a sampled wave needs more than two per wavelength; five leave room for its overtone.
const SAMPLES_PER_WAVE: f64 = 5.0;
const WIDEST_STRIDE: usize = 3;
/// Systematic error of a phase as a shift of its wave, px (1σ): printing, waviness and light.
///
/// Fitted: by hand on the project's renders (tests/eye/drift.rs) and the sequences that it was first tried on; not judged elsewhere.
pub const PHASE_SIGMA_PX: f64 = 0.05;
/// How many windows count as one: they share the printing's errors.
///
/// Fitted: by hand on the project's renders (tests/eye/drift.rs), so that rigs at rest are seen at rest; not judged elsewhere.
const DESIGN_EFFECT: f64 = 4.0;
/// Most scatter of the phases about a common motion where they show the target, cycles.
///
/// Derived: phases at random scatter by 1/√12 = 0.29 cycles, and [`PHASE_SIGMA_PX`] is 0.01 cycles of a wave of 5 px. The limit is a fifth
/// of the former and six times the latter.
const MOST_SCATTER_CYCLES: f64 = 0.06;
/// Least share of the phases that must agree on the motion.
///
/// Convention: a majority.
const LEAST_AGREEING: f64 = 0.5;
/// What may be known of the target's motion beforehand: shifts (mm) and turns (rad), 1σ.
///
/// Convention: weak; wider than what the phases can tell, so that directions that they leave open stay finite.
const PRIOR_SD: [f64; 6] = [5.0, 5.0, 5.0, 0.05, 0.05, 0.05];
/// A motion is seen if it is more than this many of its sigmas.
///
/// Derived: the probability that normal errors of six parameters exceed 5 σ is below 4·10⁻⁶ a frame.
pub const DETECTION_SIGMAS: f64 = 5.0;
/// Turns out of its plane (rad) and lift (mm) of a target at rest that may come from its own waviness.
///
/// Fitted: by hand on the project's renders (tests/eye/drift.rs), whose targets are flat; a sheet that is not pinned flat was not measured.
const WAVINESS_RAD: f64 = 0.15 * PI / 180.0;
const WAVINESS_MM: f64 = 0.2;
/// Steps, in the plane and along the line of sight, of the search for a motion from which the phases can be unwrapped, and their
/// number on either side.
///
/// Fitted: by hand on the sequences of tests/eye/drift.rs, whose knocks are about 100 px; not judged elsewhere.
const SEARCH_TURN_RAD: f64 = 0.005;
const SEARCH_LIFT_MM: f64 = 1.0;
const SEARCH_REACH: i32 = 5;
/// Agreement of the phases (0 to 2) on one slide from which on no turn or lift is searched for.
///
/// Derived: two waves whose phases scatter by σ radians agree to 2 exp(−σ²/2): 1.6 is a scatter of 0.11 cycles.
const AGREEMENT: f64 = 1.6;
/// Steps of central differences: shifts (mm) and turns (rad).
///
/// Convention: phases are nearly linear in them.
const STEPS: [f64; 6] = [1e-3, 1e-3, 1e-2, 1e-5, 1e-5, 1e-5];

/// How far the target is from where the rig says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridShift {
    /// Root mean square of the shift across the pattern's waves over all windows, px.
    pub px: f64,
    /// Its standard deviation, px.
    pub sigma_px: f64,
    /// The shift in the picture at the place that was asked for, px.
    pub at_base: Vector2<f64>,
    /// Its covariance.
    pub at_base_covariance: Matrix2<f64>,
    /// The part that no sliding in its own plane explains, turns about the target's axes and a lift, in units of what may come from
    /// waviness or noise.
    pub out_of_plane: f64,
    /// Whether it may as well be the camera that turned about the snake's base, which shifts the target behind it.
    pub may_be_a_turn: bool,
    /// The camera's pose to the target where it is now.
    pub camera_from_grid: Pose,
}

impl GridShift {
    /// Squared distance of the shift at the base from none, in units of its covariance and of what light does to a target at rest (px, 1σ).
    pub fn departure2_at_base(&self, shaded_px: f64) -> f64 {
        let covariance = self.at_base_covariance + Matrix2::identity() * shaded_px.powi(2);
        covariance.cholesky().map_or(0.0, |factor| self.at_base.dot(&factor.solve(&self.at_base)))
    }
}

/// Measures phases of the target's waves in a few windows, and the motion of the target that they tell.
#[derive(Debug)]
pub struct GridPhaseMonitor {
    lens: Lens,
    sheet: Sheet,
    standoff_mm: f64,
    pattern: GridPattern,
    windows: Vec<SparseWindow>,
    /// What each wave's phase, as a shift in px, does when the target moves in its own frame: shift x, y, z (mm), turn about
    /// x, y, z (rad). Two rows a window.
    by_motion: DMatrix<f64>,
}

/// Phases of both waves in every window.
pub type Phases = Vec<[Phase; 2]>;

impl GridPhaseMonitor {
    /// `None` where the picture has too little room for windows, or some of them would not see the target.
    pub fn new(lens: &Lens, sheet: &Sheet, standoff_mm: f64, pitch_mm: f64, pattern: &GridPattern) -> Option<Self> {
        let windows = windows(lens, sheet, pitch_mm, pattern)?;
        let shifts_px = |by: &DVector<f64>| {
            let moved = moved_target(sheet, by.as_slice());
            let of_window = |window: &SparseWindow| -> [f64; 2] {
                let seen = moved.at(lens, &window.centre());
                let phases = seen.map(|(place, _)| pattern.kind.phases(place.coords / pitch_mm));
                [0, 1].map(|k| phases.map_or(f64::NAN, |phases| phases[k]) * window.wavelengths_px()[k])
            };
            DVector::from_iterator(2 * windows.len(), windows.iter().flat_map(of_window))
        };
        let by_motion = central_differences(shifts_px, &DVector::zeros(6), &DVector::from_column_slice(&STEPS));
        let (lens, sheet, pattern) = (lens.clone(), sheet.clone(), pattern.clone());
        let sees_all = by_motion.iter().all(|slope| slope.is_finite());
        sees_all.then_some(Self { lens, sheet, standoff_mm, pattern, windows, by_motion })
    }

    /// The mix of channels in which the target's waves are strongest and have their crests where the rig expects them.
    pub fn weights_in(&self, frame: &Frame) -> Vec<f64> {
        let amplitude = |channel: usize| -> f64 {
            let only: Vec<f64> = (0..frame.channels).map(|c| f64::from(u8::from(c == channel))).collect();
            let phases = self.windows.iter().flat_map(|window| window.phases(frame, &only));
            phases.map(|phase| phase.amplitude * (TAU * phase.cycles).cos()).sum()
        };
        let amplitudes = DVector::from_fn(frame.channels, |c, _| amplitude(c));
        let norm = amplitudes.norm().max(f64::MIN_POSITIVE);
        amplitudes.iter().map(|a| a / norm).collect()
    }

    /// Measures all phases in a frame.
    pub fn phases(&self, frame: &Frame) -> Phases {
        let weights = self.pattern.weights_for(frame.channels);
        self.windows.iter().map(|window| window.phases(frame, &weights)).collect()
    }

    /// How far the target moved, up to whole pitches, and how far that is at a pixel of the base; `None` where the phases do not agree on
    /// anything.
    pub fn shift(&self, phases: &Phases, base: &Point2<f64>) -> Option<GridShift> {
        let expected_px = self.expected_px(phases);
        let seen_px = self.seen_px(phases, &expected_px);
        let (design, right) = (&self.by_motion / PHASE_SIGMA_PX, &seen_px / PHASE_SIGMA_PX);
        let RobustLinear { parameters: motion, covariance, agreeing } =
            RobustLinear::fit(&design, &right, &PRIOR_SD, true)?;
        let residuals = &seen_px - &self.by_motion * &motion;
        let lengths = self.windows.iter().flat_map(SparseWindow::wavelengths_px);
        let scatter_cycles = mad_scale(residuals.iter().zip(lengths).map(|(residual, length)| residual / length));
        let count = residuals.len() as f64;
        if scatter_cycles > MOST_SCATTER_CYCLES || (agreeing as f64) < LEAST_AGREEING * count {
            return None;
        }
        let covariance = covariance * DESIGN_EFFECT;
        let variance_px = (&self.by_motion * &covariance * self.by_motion.transpose()).trace() / count;
        let moved = moved_target(&self.sheet, motion.as_slice());
        let place_mm = self.sheet.place_at(&self.lens, base)?;
        let (_, arm, by_point, _) = self.sheet.project_with_jacobian(&self.lens, &place_mm);
        let from_grid = self.sheet.camera_from_grid.rotation.to_rotation_matrix().into_inner();
        let mut at_base_by_motion = Matrix2x6::zeros();
        at_base_by_motion.fixed_columns_mut::<3>(0).copy_from(&(by_point * from_grid));
        at_base_by_motion.fixed_columns_mut::<3>(3).copy_from(&(-by_point * arm.cross_matrix() * from_grid));
        let motion = Vector6::from_column_slice(motion.as_slice());
        let covariance: Matrix6<f64> = covariance.fixed_view::<6, 6>(0, 0).into_owned();
        Some(GridShift {
            px: (&self.by_motion * motion).norm() / count.sqrt(),
            sigma_px: variance_px.sqrt(),
            at_base: moved.project(&self.lens, &place_mm) - base,
            at_base_covariance: at_base_by_motion * covariance * at_base_by_motion.transpose(),
            out_of_plane: out_of_plane(&motion, &covariance),
            may_be_a_turn: self.may_be_a_turn(&motion, &covariance, &place_mm)?,
            camera_from_grid: moved.camera_from_grid,
        })
    }

    /// Whether a motion of the target may be a turn of the camera about the base, which is seen before this place of the target.
    fn may_be_a_turn(&self, motion: &Vector6<f64>, covariance: &Matrix6<f64>, place_mm: &Point2<f64>) -> Option<bool> {
        // Turned about the base by ω, the target at its distance behind it shifts by (ω_y, −ω_x) times that.
        let (turn, at) = (motion.fixed_rows::<3>(3).into_owned(), Vector3::new(place_mm.x, place_mm.y, 0.0));
        let slide = motion.fixed_rows::<3>(0) + turn.cross(&at);
        let off = turn.xy() - Vector2::new(-slide.y, slide.x) / self.standoff_mm;
        let waviness = Matrix2::identity() * (WAVINESS_RAD / DETECTION_SIGMAS).powi(2);
        let uncertainty = covariance.fixed_view::<2, 2>(3, 3) + waviness;
        Some(off.dot(&(uncertainty.try_inverse()? * off)) < DETECTION_SIGMAS.powi(2))
    }

    /// The shifts, px along each wave, that the phases are, each the one nearest to what is expected.
    pub fn seen_px(&self, phases: &Phases, expected_px: &DVector<f64>) -> DVector<f64> {
        let seen = self.windows.iter().zip(phases).enumerate().flat_map(|(w, (window, phases))| {
            [0, 1].map(|k| {
                let length = window.wavelengths_px()[k];
                let cycles = expected_px[2 * w + k] / length;
                (cycles + wrap_cycles(phases[k].cycles - cycles)) * length
            })
        });
        DVector::from_iterator(2 * self.windows.len(), seen)
    }

    /// What each wave's phase, as a shift in px, does when the camera turns about a point (mm, its own axes) and shifts: columns turn
    /// (rad) and shift (mm), along the camera's axes.
    pub fn by_camera(&self, about: &Vector3<f64>) -> DMatrix<f64> {
        let to_grid = self.sheet.camera_from_grid.rotation.inverse().to_rotation_matrix().into_inner();
        let arm = self.sheet.camera_from_grid.translation.vector - about;
        let mut target = DMatrix::zeros(6, 6);
        target.view_mut((0, 0), (3, 3)).copy_from(&(-to_grid * arm.cross_matrix()));
        target.view_mut((0, 3), (3, 3)).copy_from(&to_grid);
        target.view_mut((3, 0), (3, 3)).copy_from(&to_grid);
        &self.by_motion * target
    }

    /// Shifts, px along each wave, of the motion under which the phases agree best, of a few turns in the plane and lifts and any slide.
    pub fn expected_px(&self, phases: &Phases) -> DVector<f64> {
        let mut best = (f64::MIN, DVector::zeros(6));
        let reach = if self.slide(phases, &DVector::zeros(6)).0 > AGREEMENT { 0 } else { SEARCH_REACH };
        for turn in -reach..=reach {
            for lift in -reach..=reach {
                let mut motion = DVector::zeros(6);
                motion[5] = f64::from(turn) * SEARCH_TURN_RAD;
                motion[2] = f64::from(lift) * SEARCH_LIFT_MM;
                let (agreement, cycles) = self.slide(phases, &motion);
                if agreement > best.0 {
                    // The slide that moves the middle's phases by as much.
                    let k = self.windows.len() / 2;
                    let slide = Matrix2::from_fn(|r, c| self.by_motion[(2 * k + r, c)]);
                    let px = Vector2::from_fn(|r, _| cycles[r] * self.windows[k].wavelengths_px()[r]);
                    if let Some(by) = slide.try_inverse().map(|inverse| inverse * px) {
                        motion[0] = by.x;
                        motion[1] = by.y;
                    }
                    best = (agreement, motion);
                }
            }
        }
        &self.by_motion * best.1
    }

    /// How well all phases agree on one slide after a motion, 0 to 2, and its cycles along both waves.
    fn slide(&self, phases: &Phases, motion: &DVector<f64>) -> (f64, [f64; 2]) {
        let expected_px = &self.by_motion * motion;
        let mut sums = [Complex::<f64>::ZERO; 2];
        let mut weights = [0.0; 2];
        for (w, (window, phases)) in self.windows.iter().zip(phases).enumerate() {
            for k in 0..2 {
                let cycles = phases[k].cycles - expected_px[2 * w + k] / window.wavelengths_px()[k];
                sums[k] += Complex::from_polar(phases[k].amplitude, TAU * cycles);
                weights[k] += phases[k].amplitude;
            }
        }
        let agreement = (0..2).map(|k| sums[k].norm() / weights[k].max(f64::MIN_POSITIVE)).sum();
        (agreement, sums.map(|sum| sum.arg() / TAU))
    }
}

/// Lays windows over the picture; `None` where it has too little room for them.
fn windows(lens: &Lens, sheet: &Sheet, pitch_mm: f64, pattern: &GridPattern) -> Option<Vec<SparseWindow>> {
    let (width, height) = (f64::from(lens.width), f64::from(lens.height));
    let waves_at = |at: &Point2<f64>| {
        let (place, gradient) = sheet.at(lens, at)?;
        Some((pattern.kind.phases(place.coords / pitch_mm), pattern.kind.waves(gradient / pitch_mm)))
    };
    let (_, [one, other]) = waves_at(&Point2::new(width / 2.0, height / 2.0))?;
    let wavelength_px = 1.0 / one.norm().min(other.norm());
    let radius = (pattern.kind.window_radius() * wavelength_px).ceil();
    let (free_x, free_y) = (width - 2.0 * radius - 3.0, height - 2.0 * radius - 3.0);
    if !radius.is_finite() || free_x < radius || free_y < 0.5 * radius {
        return None;
    }
    let stride = ((wavelength_px / SAMPLES_PER_WAVE).floor() as usize).clamp(1, WIDEST_STRIDE);
    let share = |k: usize, count: usize| k as f64 / (count - 1) as f64;
    let window = |k: usize| {
        let x = (1.0 + share(k % COLUMNS, COLUMNS) * free_x).floor();
        let y = (1.0 + share(k / COLUMNS, ROWS) * free_y).floor();
        let (phases, waves) = waves_at(&Point2::new(x + radius, y + radius))?;
        Some(SparseWindow::new((x as usize, y as usize), radius as usize, stride, phases, waves))
    };
    (0..COLUMNS * ROWS).map(window).collect()
}

/// The turns about the target's axes and the lift of a motion, the largest in units of what may come from waviness or noise.
fn out_of_plane(motion: &Vector6<f64>, covariance: &Matrix6<f64>) -> f64 {
    let share = |k: usize, waviness: f64| motion[k].abs() / waviness.max(DETECTION_SIGMAS * covariance[(k, k)].sqrt());
    share(2, WAVINESS_MM).max(share(3, WAVINESS_RAD)).max(share(4, WAVINESS_RAD))
}

/// The sheet after it moved in its own frame: shift x, y, z (mm), turn about x, y, z (rad).
fn moved_target(sheet: &Sheet, by: &[f64]) -> Sheet {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(by[3], by[4], by[5]));
    let moved = Pose::from_parts(Translation3::new(by[0], by[1], by[2]), turn);
    Sheet { camera_from_grid: sheet.camera_from_grid * moved, shape: sheet.shape }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::target::pattern::PatternKind;
    use crate::simulate::scene::Scene;
    use crate::statistics::moments::rms;
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, Normal};

    const PITCH_MM: f64 = 1.0;

    fn rig_pose() -> Pose {
        Pose::new(Vector3::new(-3.0, 2.0, 255.0), Vector3::new(0.06, -0.09, 0.05))
    }

    fn monitor(kind: PatternKind) -> GridPhaseMonitor {
        let pattern = GridPattern::dark(kind);
        GridPhaseMonitor::new(&Scene::default().lens, &Sheet::flat(rig_pose()), 25.0, PITCH_MM, &pattern).unwrap()
    }

    /// The phases of a target that moved in its own frame, each with a normal error of this σ, px.
    fn phases(monitor: &GridPhaseMonitor, motion: [f64; 6], noise_px: f64, seed: u64) -> Phases {
        let mut random = StdRng::seed_from_u64(seed);
        let noise = Normal::new(0.0, noise_px).unwrap();
        let kind = monitor.pattern.kind;
        let phases_at = |pose: &Sheet, window: &SparseWindow| {
            kind.phases(pose.at(&monitor.lens, &window.centre()).unwrap().0.coords / PITCH_MM)
        };
        let moved = moved_target(&Sheet::flat(rig_pose()), &motion);
        let of_window = |window: &SparseWindow| {
            let change = phases_at(&moved, window) - phases_at(&Sheet::flat(rig_pose()), window);
            std::array::from_fn(|k| {
                let error = noise.sample(&mut random) / window.wavelengths_px()[k];
                Phase { cycles: wrap_cycles(change[k] + error), amplitude: 20.0 }
            })
        };
        monitor.windows.iter().map(of_window).collect()
    }

    #[test]
    fn a_motion_is_found_from_its_phases_up_to_whole_pitches() {
        let base = Point2::new(640.0, 600.0);
        for kind in [PatternKind::Lines, PatternKind::Checkerboard] {
            let monitor = monitor(kind);
            for motion in [
                [0.2, -0.1, 0.0, 0.0, 0.0, 0.0],
                [0.0, 0.0, 2.0, 0.0, 0.0, 0.0],
                [0.1, 0.3, -1.0, 0.004, -0.006, 0.008],
                // Further than half a wave at the picture's border.
                [0.0, 0.0, 0.0, 0.0, 0.0, 0.024],
            ] {
                let shift = monitor.shift(&phases(&monitor, motion, 0.0, 0), &base).unwrap();
                // The phases are taken for linear in the motion; a turn of φ shrinks distances by φ²/2.
                let second_order_mm = 0.5 * Vector3::new(motion[3], motion[4], motion[5]).norm_squared() * 255.0;
                let moved = moved_target(&Sheet::flat(rig_pose()), &motion);
                let off = shift.camera_from_grid.inverse() * moved.camera_from_grid;
                assert!(off.rotation.angle() < 2e-4, "{kind:?} {motion:?}: {off:?}");
                let slide = off.translation.vector.xy();
                assert!((slide - slide.map(f64::round)).norm() < 0.02, "{kind:?} {motion:?}: {off:?}");
                assert!(off.translation.z.abs() < 0.05 + second_order_mm, "{kind:?} {motion:?}: {off:?}");
            }
        }
    }

    #[test]
    fn a_target_at_rest_is_seen_at_rest_and_small_motions_are_seen() {
        let monitor = monitor(PatternKind::Lines);
        let base = Point2::new(640.0, 600.0);
        let is_seen = |motion: [f64; 6], seed: u64| {
            // With four times the variance, as windows that share their errors have in the mean.
            let noise_px = PHASE_SIGMA_PX * DESIGN_EFFECT.sqrt();
            let shift = monitor.shift(&phases(&monitor, motion, noise_px, seed), &base).unwrap();
            [shift.px > DETECTION_SIGMAS * shift.sigma_px, shift.out_of_plane > 1.0]
        };
        let alarms = (0..500).filter(|&seed| is_seen([0.0; 6], seed) != [false; 2]).count();
        assert_eq!(alarms, 0);
        for seed in 0..100 {
            assert_eq!(is_seen([0.1, 0.0, 0.0, 0.0, 0.0, 0.0], seed), [true, false], "a slide of 0.1 mm");
            assert!(is_seen([0.0, 0.0, 0.0, 0.01, 0.0, 0.0], seed)[1], "a lean of 0.6°");
        }
    }

    #[test]
    fn the_sigma_of_a_shift_is_that_of_its_scatter_times_the_design_effect() {
        let monitor = monitor(PatternKind::Lines);
        let base = Point2::new(640.0, 600.0);
        let shifts: Vec<GridShift> = (0..200)
            .map(|seed| monitor.shift(&phases(&monitor, [0.0; 6], PHASE_SIGMA_PX, seed), &base).unwrap())
            .collect();
        let predicted = rms(shifts.iter().map(|shift| shift.sigma_px)) / DESIGN_EFFECT.sqrt();
        let seen = rms(shifts.iter().map(|shift| shift.px));
        assert!((seen / predicted - 1.0).abs() < 0.15, "{seen} px seen, {predicted} px predicted");
    }

    #[test]
    fn phases_at_random_tell_nothing() {
        let monitor = monitor(PatternKind::Lines);
        assert!(monitor.shift(&phases(&monitor, [0.0; 6], 20.0, 1), &Point2::new(640.0, 600.0)).is_none());
    }

    #[test]
    fn a_turn_of_the_camera_is_the_motion_of_the_target_that_it_looks_like() {
        let monitor = monitor(PatternKind::Lines);
        let about = Vector3::new(1.0, 4.0, 230.0);
        let by_camera = monitor.by_camera(&about);
        let step = 1e-5;
        for axis in 0..6 {
            let mut by = [0.0; 6];
            by[axis] = step;
            // The camera's pose to the base turns about the base's origin and shifts, and takes the target along.
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(by[0], by[1], by[2]));
            let shift = Vector3::new(by[3], by[4], by[5]);
            let old = rig_pose();
            let place = turn * (old.translation.vector - about) + about + shift;
            let moved = Pose::from_parts(Translation3::from(place), turn * old.rotation);
            let motion = old.inverse() * moved;
            let turn = motion.rotation.scaled_axis();
            let parameters = DVector::from_iterator(6, motion.translation.vector.iter().chain(turn.iter()).copied());
            let expected = &monitor.by_motion * parameters / step;
            assert!((by_camera.column(axis) - &expected).norm() < 1e-3 * expected.norm(), "axis {axis}");
        }
    }
}
