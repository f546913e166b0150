//! Finds the printed grid and the camera's pose to it.
//!
//! A grid is a sum of plane waves. Within a window of some ten pitches the phase of the wave along each of its two
//! directions tells where the lines are, from every pixel at once and whatever the lines' colour or width; thick lines
//! every 5 or 10 mm lie on the same lattice and add to the same wave. Windows all over the picture, counted from
//! neighbour to neighbour, give pairs of picture and paper coordinates, and these the pose.

use crate::camera::{Frame, Lens};
use crate::geometry::Pose;
use crate::measure::image::plane::{Plane, median};
use crate::statistics::least_squares::{self, Solution, minimise};
use nalgebra::{DMatrix, DVector, Matrix2, Point2, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use rustfft::{FftPlanner, num_complex::Complex};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};
use std::ops::{Range, RangeInclusive};

/// What is printed on the paper.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pattern {
    /// Lines in two directions, one pitch apart.
    Lines,
    /// Squares of side one pitch, alternately dark and light: waves along the diagonals, √2 pitches long.
    Checkerboard,
}

/// A place of the paper seen in the picture.
#[derive(Debug, Clone, Copy)]
pub struct GridPoint {
    /// Where it is seen, px.
    pub pixel: Point2<f64>,
    /// Where it is on the paper, mm, in the grid frame.
    pub paper_mm: Point2<f64>,
}

/// The grid in one picture.
#[derive(Debug, Clone)]
pub struct Grid {
    /// What is printed.
    pub pattern: Pattern,
    /// The camera's pose to it.
    pub camera_from_grid: Pose,
    /// Variance of that pose's rotation about each of the camera's axes, rad².
    pub rotation_variance: Vector3<f64>,
    /// The places it was seen at.
    pub points: Vec<GridPoint>,
    /// Scatter of the points about the pose, px per coordinate.
    pub rms_px: f64,
}

impl Grid {
    /// Depth (camera z), mm, at which a line of sight meets the paper.
    pub fn distance_mm(&self, ray: &Vector3<f64>) -> f64 {
        let normal = self.camera_from_grid * Vector3::z();
        let along = normal.dot(&self.camera_from_grid.translation.vector) / normal.dot(ray);
        along * ray.z
    }
}

impl Pattern {
    /// Radius of the windows, in wavelengths: a Hann window of 5 pitches is blind to the waves of a 5 mm ruling beside
    /// those of a 1 mm one; a checkerboard has no such neighbours.
    pub(crate) fn window(self) -> f64 {
        match self {
            Self::Lines => 5.0,
            Self::Checkerboard => 1.5,
        }
    }

    /// Distance between windows, in pitches.
    fn spacing(self) -> f64 {
        match self {
            Self::Lines => 1.7,
            Self::Checkerboard => 0.6,
        }
    }
}

/// Finds the grid in a picture.
///
/// `pitch_px` is the range in which the snake's known size puts the pitch, narrow enough that a heavier ruling is not
/// mistaken for it. Within it the finest ruling has the strongest wave, for every heavier line lies on it too. The lines
/// run within 30° of the snake's `axis` or square to it. `is_snake` tells pixels that are not paper.
///
/// # Errors
///
/// A sentence that says what was not found.
pub fn find_grid(
    frame: &Frame,
    lens: &Lens,
    pitch_mm: f64,
    pitch_px: RangeInclusive<f64>,
    axis: Vector2<f64>,
    is_snake: impl Fn(&Point2<f64>) -> bool,
) -> Result<Grid, String> {
    let plane = strongest_pattern(frame, &is_snake);
    let mut best: Option<Grid> = None;
    for pattern in [Pattern::Lines, Pattern::Checkerboard] {
        let Some(seed) = seed(&plane, pattern, &pitch_px, axis, &is_snake) else { continue };
        let Some(grid) = follow(&plane, lens, pattern, pitch_mm, &seed, &is_snake) else { continue };
        if best.as_ref().is_none_or(|b| grid.points.len() > b.points.len()) {
            best = Some(grid);
        }
    }
    best.ok_or_else(|| {
        format!(
            "no grid of {pitch_mm} mm pitch was found on the paper; by the snake's size its lines should be {:.0} to \
             {:.0} px apart. Check grid_pitch_mm and that the lines can be seen",
            pitch_px.start(),
            pitch_px.end()
        )
    })
}

/// The mix of channels in which the paper's fine structure is strongest: the first principal component of what is left
/// after the mean of each pixel's surroundings is taken away.
fn strongest_pattern(frame: &Frame, is_snake: &impl Fn(&Point2<f64>) -> bool) -> Plane {
    let channels = frame.channels;
    let block = 8;
    let mut scatter = DMatrix::zeros(channels, channels);
    for y in (0..frame.height.saturating_sub(block)).step_by(2 * block as usize) {
        for x in (0..frame.width.saturating_sub(block)).step_by(2 * block as usize) {
            if is_snake(&Point2::new(f64::from(x), f64::from(y))) {
                continue;
            }
            let colours: Vec<DVector<f64>> = (0..block * block)
                .map(|k| DVector::from_fn(channels, |c, _| f64::from(frame.get(x + k % block, y + k / block, c))))
                .collect();
            let mean = colours.iter().fold(DVector::zeros(channels), |a, b| a + b) / colours.len() as f64;
            colours.iter().for_each(|colour| scatter += (colour - &mean) * (colour - &mean).transpose());
        }
    }
    let eigen = scatter.symmetric_eigen();
    let weights = eigen.eigenvectors.column(eigen.eigenvalues.imax()).map(|w| w as f32);
    let mixed = |first: usize| weights.iter().zip(first..).map(|(w, k)| w * frame.samples.level(k)).sum();
    let data = (0..frame.samples.len()).step_by(channels).map(mixed).collect();
    Plane::new(frame.width as usize, frame.height as usize, data)
}

/// Where the grid was first recognised: a window's centre and its two wave vectors, cycles per px.
struct Seed {
    centre: Point2<f64>,
    waves: [Vector2<f64>; 2],
}

impl Seed {
    /// Length of its longer wave, px.
    fn period_px(&self) -> f64 {
        1.0 / self.waves[0].norm().min(self.waves[1].norm())
    }
}

/// Looks for two square waves of the expected length in windows that show little but paper.
fn seed(
    plane: &Plane,
    pattern: Pattern,
    pitch_px: &RangeInclusive<f64>,
    axis: Vector2<f64>,
    is_snake: &impl Fn(&Point2<f64>) -> bool,
) -> Option<Seed> {
    let per_pitch = match pattern {
        Pattern::Lines => 1.0,
        Pattern::Checkerboard => FRAC_1_SQRT_2,
    };
    let numbers = per_pitch / pitch_px.end()..per_pitch / pitch_px.start();
    // Enough waves to tell their length, in a window that finds paper beside the snake.
    const ENOUGH_WAVES: f64 = 5.0;
    let fits = |size: &usize| *size <= plane.width.min(plane.height);
    let sizes = [128, 256, 512, 1024];
    let longest = 0.7 / numbers.start;
    let size = sizes.into_iter().filter(fits).find(|&s| s as f64 >= 256.0_f64.max(ENOUGH_WAVES * longest));
    let size = size.or_else(|| sizes.into_iter().rfind(fits))?;
    let mut planner = FftPlanner::new();
    let fft = planner.plan_fft_forward(size);
    let mut best: Option<(f64, Seed)> = None;
    for row in 0..3 {
        for column in 0..5 {
            let (x0, y0) = (column * (plane.width - size) / 4, row * (plane.height - size) / 2);
            let centre = Point2::new((x0 + size / 2) as f64, (y0 + size / 2) as f64);
            let covered = (0..64)
                .filter(|k| is_snake(&Point2::new((x0 + k % 8 * size / 8) as f64, (y0 + k / 8 * size / 8) as f64)));
            if covered.count() > 8 {
                continue;
            }
            let spectrum = amplitude_spectrum(plane, x0, y0, size, fft.as_ref());
            if let Some((strength, waves)) = wave_pair(&spectrum, size, &numbers, axis, pattern)
                && best.as_ref().is_none_or(|(s, _)| strength > *s)
            {
                best = Some((strength, Seed { centre, waves }));
            }
        }
    }
    best.map(|(_, seed)| seed)
}

/// |FFT| of a Hann-windowed square of the picture.
fn amplitude_spectrum(plane: &Plane, x0: usize, y0: usize, size: usize, fft: &dyn rustfft::Fft<f64>) -> Vec<f64> {
    let hann: Vec<f64> = (0..size).map(|k| 0.5 - 0.5 * (TAU * k as f64 / size as f64).cos()).collect();
    let rows = (0..size).map(|y| &plane.data[(y0 + y) * plane.width + x0..][..size]);
    let mean = rows.clone().flatten().map(|&v| f64::from(v)).sum::<f64>() / (size * size) as f64;
    let mut data: Vec<Complex<f64>> = rows
        .enumerate()
        .flat_map(|(y, row)| row.iter().enumerate().map(move |(x, &v)| (x, y, f64::from(v))))
        .map(|(x, y, v)| Complex::new((v - mean) * hann[x] * hann[y], 0.0))
        .collect();
    for _ in 0..2 {
        data.chunks_exact_mut(size).for_each(|row| fft.process(row));
        data = (0..size * size).map(|k| data[k % size * size + k / size]).collect();
    }
    data.iter().map(|c| c.norm()).collect()
}

/// The two strongest, roughly square, waves with wave numbers (cycles per px) in a range, with their strength over the
/// background.
fn wave_pair(
    spectrum: &[f64],
    size: usize,
    numbers: &Range<f64>,
    axis: Vector2<f64>,
    pattern: Pattern,
) -> Option<(f64, [Vector2<f64>; 2])> {
    let at = |x: i64, y: i64| spectrum[y.rem_euclid(size as i64) as usize * size + x.rem_euclid(size as i64) as usize];
    let reach = (numbers.end * size as f64).ceil() as i64;
    let mut peaks: Vec<(f64, Vector2<f64>)> = Vec::new();
    let mut floor: Vec<f32> = Vec::new();
    for y in -reach..=reach {
        for x in 0..=reach {
            let amplitude = at(x, y);
            let number = ((x * x + y * y) as f64).sqrt() / size as f64;
            if !numbers.contains(&number) || (x == 0 && y <= 0) {
                continue;
            }
            floor.push(amplitude as f32);
            let neighbours = [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)];
            if neighbours.iter().all(|(dx, dy)| at(x + dx, y + dy) <= amplitude) {
                let vertex =
                    |before: f64, after: f64| 0.5 * (after - before) / (2.0 * amplitude - before - after).max(1e-12);
                let dx = vertex(at(x - 1, y), at(x + 1, y));
                let dy = vertex(at(x, y - 1), at(x, y + 1));
                peaks.push((amplitude, Vector2::new(x as f64 + dx, y as f64 + dy) / size as f64));
            }
        }
    }
    let floor = f64::from(median(&mut floor));
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
    peaks.truncate(12);
    let mut best: Option<(f64, [Vector2<f64>; 2])> = None;
    for (i, (strength_a, a)) in peaks.iter().enumerate() {
        for (strength_b, b) in &peaks[i + 1..] {
            let cosine = a.dot(b) / (a.norm() * b.norm());
            let ratio = a.norm() / b.norm();
            let strength = strength_a.min(*strength_b) / floor.max(1e-12);
            // Lines run along the snake, roughly, and a checkerboard's waves along its diagonals.
            let turn = a.angle(&axis).to_degrees().rem_euclid(90.0);
            let along = turn.min(90.0 - turn) < 30.0;
            let runs_right = along == (pattern == Pattern::Lines);
            const STANDS_OUT: f64 = 5.0;
            if runs_right
                && cosine.abs() < 0.35
                && (0.75..1.33).contains(&ratio)
                && strength > STANDS_OUT
                && best.is_none_or(|(s, _)| strength > s)
            {
                best = Some((strength, ordered(*a, *b, pattern)));
            }
        }
    }
    best
}

/// Turns two waves so that the paper's axes they imply are nearest to the picture's: x right, y down.
fn ordered(a: Vector2<f64>, b: Vector2<f64>, pattern: Pattern) -> [Vector2<f64>; 2] {
    let mut best = ([a, b], f64::MIN);
    for (first, second) in [(a, b), (b, a)] {
        for (s, t) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
            let waves = [first * s, second * t];
            let [x, y] = axes_from_waves(waves, pattern);
            let agreement = x.x / x.norm() + y.y / y.norm();
            if agreement > best.1 {
                best = (waves, agreement);
            }
        }
    }
    best.0
}

/// Gradients of the paper's x and y coordinates, pitches per px, from the phases' gradients.
fn axes_from_waves(waves: [Vector2<f64>; 2], pattern: Pattern) -> [Vector2<f64>; 2] {
    match pattern {
        Pattern::Lines => waves,
        // The phases are (x + y)/2 and (x − y)/2 pitches.
        Pattern::Checkerboard => [waves[0] + waves[1], waves[0] - waves[1]],
    }
}

/// Paper coordinates, pitches, to phases, cycles: the inverse of [`axes_from_waves`] on numbers.
pub(crate) fn phases_from_paper(paper: Vector2<f64>, pattern: Pattern) -> Vector2<f64> {
    match pattern {
        Pattern::Lines => paper,
        Pattern::Checkerboard => Vector2::new(paper.x + paper.y, paper.x - paper.y) / 2.0,
    }
}

fn paper_from_phases(phases: Vector2<f64>, pattern: Pattern) -> Vector2<f64> {
    match pattern {
        Pattern::Lines => phases,
        Pattern::Checkerboard => Vector2::new(phases.x + phases.y, phases.x - phases.y),
    }
}

/// The phase (cycles, in [−½, ½)) of a wave in a round window, and its amplitude.
fn phase_at(plane: &Plane, centre: &Point2<f64>, wave: Vector2<f64>, radius: f64) -> (f64, f64) {
    let reach = radius.floor() as i64;
    let (cx, cy) = (centre.x.round() as i64, centre.y.round() as i64);
    let taper: Vec<f64> = (-reach..=reach).map(|k| 0.5 + 0.5 * (PI * k as f64 / radius).cos()).collect();
    let turn = |k: f64| Complex::from_polar(1.0, -TAU * k);
    let columns: Vec<Complex<f64>> = (-reach..=reach).zip(&taper).map(|(k, t)| turn(wave.x * k as f64) * t).collect();
    let column_sum: Complex<f64> = columns.iter().sum();
    let (mut total, mut plain, mut weight) = (Complex::<f64>::ZERO, 0.0, Complex::<f64>::ZERO);
    let mut plain_weight = 0.0;
    for (dy, t) in (-reach..=reach).zip(&taper) {
        let row = &plane.data[(cy + dy) as usize * plane.width + (cx - reach) as usize..][..taper.len()];
        let turned = turn(wave.y * dy as f64) * t;
        let (mut sum, mut grey) = (Complex::<f64>::ZERO, 0.0);
        for ((&v, c), w) in row.iter().zip(&columns).zip(&taper) {
            sum += c * f64::from(v);
            grey += w * f64::from(v);
        }
        total += sum * turned;
        weight += column_sum * turned;
        plain += grey * t;
        plain_weight += t * taper.iter().sum::<f64>();
    }
    // The mean grey must not leak into the wave.
    let wave_part: Complex<f64> = (total - weight * (plain / plain_weight)) / plain_weight;
    // The phase belongs to the window's pixel; carry it to the exact centre.
    let shift = wave.dot(&(centre - Point2::new(cx as f64, cy as f64)));
    (wrap_cycles(wave_part.arg() / TAU + shift), wave_part.norm())
}

fn wrap_cycles(cycles: f64) -> f64 {
    cycles - cycles.round()
}

/// One window: its centre and, once counted, the phases in cycles of the whole picture.
struct Window {
    centre: Point2<f64>,
    phases: Option<Vector2<f64>>,
}

/// Counts phases from window to window over the paper, then fits the pose and measures again with the waves it predicts.
fn follow(
    plane: &Plane,
    lens: &Lens,
    pattern: Pattern,
    pitch_mm: f64,
    seed: &Seed,
    is_snake: &impl Fn(&Point2<f64>) -> bool,
) -> Option<Grid> {
    let wavelength = 1.0 / seed.waves[0].norm();
    let radius = pattern.window() * wavelength;
    let step = pattern.spacing() / (axes_from_waves(seed.waves, pattern)[0].norm());
    let columns = ((plane.width as f64 - 2.0 * radius - 2.0) / step).floor() as i64;
    let rows = ((plane.height as f64 - 2.0 * radius - 2.0) / step).floor() as i64;
    if columns < 3 || rows < 3 {
        return None;
    }
    let place = |x: i64, y: i64| Point2::new(radius + 1.0 + x as f64 * step, radius + 1.0 + y as f64 * step);
    let mut windows: Vec<Window> =
        (0..rows * columns).map(|k| Window { centre: place(k % columns, k / columns), phases: None }).collect();
    let clear: Vec<bool> = windows.iter().map(|w| paper_share(&w.centre, radius, is_snake) > 0.85).collect();

    // Amplitude that counts as the grid: a third of what the seed shows.
    let enough = seed.waves.map(|wave| phase_at(plane, &clamp_into(plane, &seed.centre, radius), wave, radius).1 / 3.0);
    let measure = |centre: &Point2<f64>, predicted: Vector2<f64>, waves: [Vector2<f64>; 2]| -> Option<Vector2<f64>> {
        let mut phases = Vector2::zeros();
        for k in 0..2 {
            let (phase, amplitude) = phase_at(plane, centre, waves[k], radius);
            let deviation = wrap_cycles(phase - predicted[k]);
            const SURE_CYCLES: f64 = 0.25;
            if amplitude < enough[k] || deviation.abs() > SURE_CYCLES {
                return None;
            }
            phases[k] = predicted[k] + deviation;
        }
        Some(phases)
    };

    let start = (0..windows.len()).filter(|&k| clear[k]).min_by(|&a, &b| {
        let distance = |k: usize| (windows[k].centre - seed.centre).norm();
        distance(a).total_cmp(&distance(b))
    })?;
    let first = seed.waves.map(|wave| phase_at(plane, &windows[start].centre, wave, radius).0);
    windows[start].phases = Some(Vector2::new(first[0], first[1]));
    let mut queue = VecDeque::from([start]);
    while let Some(from) = queue.pop_front() {
        let Some(known) = windows[from].phases else { continue };
        let (x, y) = (from as i64 % columns, from as i64 / columns);
        for (nx, ny) in [(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)] {
            let k = (ny * columns + nx) as usize;
            if nx < 0 || ny < 0 || nx >= columns || ny >= rows || !clear[k] || windows[k].phases.is_some() {
                continue;
            }
            let moved = windows[k].centre - windows[from].centre;
            let predicted = known + Vector2::new(seed.waves[0].dot(&moved), seed.waves[1].dot(&moved));
            windows[k].phases = measure(&windows[k].centre, predicted, seed.waves);
            if windows[k].phases.is_some() {
                queue.push_back(k);
            }
        }
    }

    let sightings = |windows: &[Window]| -> Vec<GridPoint> {
        let seen = windows.iter().filter_map(|w| Some((w.centre, w.phases?)));
        seen.map(|(pixel, phases)| GridPoint {
            pixel,
            paper_mm: Point2::from(paper_from_phases(phases, pattern) * pitch_mm),
        })
        .collect()
    };
    let gradients = axes_from_waves(seed.waves, pattern);
    let mut points = sightings(&windows);
    let square = starting_pose(lens, pitch_mm, gradients, points.first()?);
    let mut fit = fit_pose_afresh(lens, &points, &square)?;
    for _ in 0..2 {
        for (window, _) in windows.iter_mut().zip(&clear).filter(|(_, clear)| **clear) {
            let (paper, gradient) = paper_at(lens, &fit.pose, &window.centre)?;
            let phases = phases_from_paper(paper.coords / pitch_mm, pattern);
            let waves = waves_from_gradient(gradient / pitch_mm, pattern);
            window.phases = measure(&window.centre, phases, waves);
        }
        points = sightings(&windows);
        fit = fit_pose(lens, &points, &fit.pose)?;
    }
    let clear_count = clear.iter().filter(|c| **c).count();
    /// Most scatter of the windows, in periods. Before random rigs it is below 0.015; windows that were miscounted, or that see no
    /// grid, scatter by 0.05 and more.
    const LOOSEST: f64 = 0.03;
    if points.len() < 12 || points.len() * 3 < clear_count || fit.rms_px > LOOSEST * seed.period_px() {
        return None;
    }
    if pattern == Pattern::Lines {
        let lines = Lines { plane, lens, pitch_mm, is_snake };
        fit.pose = lines.put_origin_on_a_line(fit.pose)?;
        for _ in 0..2 {
            fit = lines.fit_pose(&fit.pose)?;
        }
        if fit.rms_px > NEARLY_AT_RANDOM * seed.period_px() {
            return None;
        }
    }
    let PoseFit { pose, rotation_variance, rms_px } = fit;
    Some(Grid { pattern, camera_from_grid: pose, rotation_variance, points, rms_px })
}

/// The printed lines themselves, followed at many places once a pose tells where to look.
///
/// The waves average over windows that cannot reach the picture's border and that shadows and the snake cut into; the
/// lines are seen everywhere, and each place of each line is a measurement of its own.
struct Lines<'a, F> {
    plane: &'a Plane,
    lens: &'a Lens,
    pitch_mm: f64,
    is_snake: &'a F,
}

/// How far from its place, in pitches, a line is searched for.
const SEARCH: f64 = 0.15;
/// Scatter of places, in pitches, that are hardly more than the strongest of what is around: those at random have SEARCH/√3,
/// 0.087. The lines are not where the waves put them, so the waves were not the lines'.
const NEARLY_AT_RANDOM: f64 = 0.08;

/// A place on a printed line: where it is on the paper, where it was seen, and the line's normal in the picture.
struct LinePlace {
    paper_mm: Point2<f64>,
    seen: Point2<f64>,
    normal: Vector2<f64>,
}

impl<F: Fn(&Point2<f64>) -> bool> Lines<'_, F> {
    fn fit_pose(&self, start: &Pose) -> Option<PoseFit> {
        let places = kept_places(self.places(start)?)?;
        let mut pose = *start;
        let mut fit = None;
        let distance =
            |pose: &Pose, p: &LinePlace| p.normal.dot(&(p.seen - project_paper(self.lens, pose, &p.paper_mm)));
        for _ in 0..3 {
            let mut sizes: Vec<f32> = places.iter().map(|p| distance(&pose, p).abs() as f32).collect();
            let limit = 4.0 * 1.4826 * f64::from(median(&mut sizes)) + 1e-3;
            let kept: Vec<&LinePlace> = places.iter().filter(|p| distance(&pose, p).abs() < limit).collect();
            let residuals = |x: &DVector<f64>| {
                let moved = nudged(&pose, x);
                DVector::from_iterator(kept.len(), kept.iter().map(|p| distance(&moved, p)))
            };
            let solution =
                minimise(residuals, DVector::zeros(6), &pose_steps(), &least_squares::Options::default()).ok()?;
            pose = nudged(&pose, &solution.parameters);
            // Neighbouring places of one line share its printing's errors.
            const CORRELATED: f64 = 10.0;
            fit = PoseFit::new(pose, &solution, CORRELATED);
        }
        fit
    }

    /// The waves' crests are the lines if these are light, and half way between them if they are dark. Lines are the
    /// narrower of the two, so the sharper bow tells.
    fn put_origin_on_a_line(&self, pose: Pose) -> Option<Pose> {
        let shifted = |by: f64| pose * Translation3::new(by * self.pitch_mm, by * self.pitch_mm, 0.0);
        let sharpness = |pose: &Pose| -> Option<f64> {
            let places = self.places(pose)?;
            Some((places.iter().map(|(depth, _)| depth).sum::<f64>() / places.len().max(1) as f64).abs())
        };
        let (crest, trough) = (shifted(0.0), shifted(0.5));
        Some(if sharpness(&crest)? > sharpness(&trough)? { crest } else { trough })
    }

    /// Looks at every line of both directions, in the middle between the lines that cross it.
    fn places(&self, pose: &Pose) -> Option<Vec<(f64, LinePlace)>> {
        const MARGIN_PX: f64 = 3.0;
        let size = Vector2::new(self.plane.width as f64 - 1.0, self.plane.height as f64 - 1.0);
        let corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)];
        let mut reach = [(f64::MAX, f64::MIN); 2];
        for (x, y) in corners {
            let (paper, _) = paper_at(self.lens, pose, &Point2::new(x * size.x, y * size.y))?;
            for axis in 0..2 {
                let line = paper[axis] / self.pitch_mm;
                reach[axis] = (reach[axis].0.min(line), reach[axis].1.max(line));
            }
        }
        const MOST_LINES: f64 = 2000.0;
        if reach.iter().any(|(low, high)| high - low > MOST_LINES) {
            return None;
        }
        let range = |axis: usize| (reach[axis].0.ceil() as i64)..=(reach[axis].1.floor() as i64);
        let mut found: Vec<(f64, LinePlace)> = Vec::new();
        for axis in 0..2 {
            for line in range(axis) {
                for between in range(1 - axis) {
                    let mut paper = Point2::origin();
                    paper[axis] = line as f64 * self.pitch_mm;
                    paper[1 - axis] = (between as f64 + 0.5) * self.pitch_mm;
                    let pixel = project_paper(self.lens, pose, &paper);
                    if !self.lens.contains(&pixel, MARGIN_PX) || (self.is_snake)(&pixel) {
                        continue;
                    }
                    let mut ahead = paper;
                    ahead[1 - axis] += 0.3 * self.pitch_mm;
                    let along = (project_paper(self.lens, pose, &ahead) - pixel) / 0.3;
                    found.extend(
                        self.ridge(&pixel, along)
                            .map(|(depth, seen, normal)| (depth, LinePlace { paper_mm: paper, seen, normal })),
                    );
                }
            }
        }
        Some(found)
    }

    /// The middle of the darkest or lightest stripe near a pixel, along a vector of one pitch: its depth (positive if
    /// dark), its place and the line's normal.
    fn ridge(&self, pixel: &Point2<f64>, along: Vector2<f64>) -> Option<(f64, Point2<f64>, Vector2<f64>)> {
        const STEP_PX: f64 = 0.5;
        let pitch_px = along.norm();
        let direction = along / pitch_px;
        let normal = Vector2::new(-direction.y, direction.x);
        let search = (SEARCH * pitch_px / STEP_PX).ceil() as i64;
        let reach = search + 6;
        let rows = (0.35 * pitch_px).floor() as i64;
        let profile: Vec<f64> = (-reach..=reach)
            .map(|k| {
                let centre = pixel + normal * (k as f64 * STEP_PX);
                let sum: f64 =
                    (-rows..=rows).map(|r| f64::from(self.plane.sample(&(centre + direction * r as f64)))).sum();
                sum / (2 * rows + 1) as f64
            })
            .collect();
        // A second difference about as wide as a line finds its middle whatever the paper's slope.
        let width = 4;
        let curve = |k: usize| profile[k - width] + profile[k + width] - 2.0 * profile[k];
        let smooth = |k: usize| curve(k - 1) + 2.0 * curve(k) + curve(k + 1);
        let inner = width + 2..profile.len().saturating_sub(width + 2);
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
}

/// Lines are dark on light paper or light on dark; most places tell which, and the others saw something else.
fn kept_places(found: Vec<(f64, LinePlace)>) -> Option<Vec<LinePlace>> {
    let dark = found.iter().map(|(depth, _)| depth).sum::<f64>() > 0.0;
    let places: Vec<LinePlace> =
        found.into_iter().filter(|(depth, _)| (*depth > 0.0) == dark).map(|(_, p)| p).collect();
    (places.len() >= 50).then_some(places)
}

/// Steps of central differences for a pose.
fn pose_steps() -> DVector<f64> {
    DVector::from_column_slice(&[1e-5, 1e-5, 1e-5, 1e-4, 1e-4, 1e-4])
}

fn clamp_into(plane: &Plane, centre: &Point2<f64>, radius: f64) -> Point2<f64> {
    Point2::new(
        centre.x.clamp(radius + 1.0, (plane.width as f64 - radius - 2.0).max(radius + 1.0)),
        centre.y.clamp(radius + 1.0, (plane.height as f64 - radius - 2.0).max(radius + 1.0)),
    )
}

/// The share of a window that shows paper.
fn paper_share(centre: &Point2<f64>, radius: f64, is_snake: &impl Fn(&Point2<f64>) -> bool) -> f64 {
    const SIDE: i32 = 9;
    let offsets =
        (0..SIDE * SIDE).map(|k| Vector2::new(f64::from(k % SIDE), f64::from(k / SIDE)) * 2.0 / f64::from(SIDE - 1));
    let free = offsets.filter(|o| !is_snake(&(centre + (o - Vector2::new(1.0, 1.0)) * 0.7 * radius)));
    free.count() as f64 / f64::from(SIDE * SIDE)
}

/// A camera square to the paper, from the pitch and the direction of its lines.
fn starting_pose(lens: &Lens, pitch_mm: f64, gradients: [Vector2<f64>; 2], point: &GridPoint) -> Pose {
    let mm_per_px = (gradients[0].norm() * gradients[1].norm()).sqrt() * pitch_mm;
    let depth = lens.focal_px.x * mm_per_px;
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), gradients[0].y.atan2(gradients[0].x));
    let seen = lens.ray(&point.pixel);
    let at = seen * (depth / seen.z) - rotation * Vector3::new(point.paper_mm.x, point.paper_mm.y, 0.0);
    Pose::from_parts(Translation3::from(at), rotation)
}

/// A pose fitted to what was seen of the paper.
#[derive(Debug, Clone, Default)]
struct PoseFit {
    pose: Pose,
    rotation_variance: Vector3<f64>,
    rms_px: f64,
}

impl PoseFit {
    /// `correlated` is how many residuals count as one.
    fn new(pose: Pose, solution: &Solution, correlated: f64) -> Option<Self> {
        let variance = solution.residuals.norm_squared() / solution.residuals.len() as f64;
        let covariance = solution.covariance()? * (variance * correlated);
        let rotation_variance = Vector3::from_fn(|k, _| covariance[(k, k)]);
        Some(Self { pose, rotation_variance, rms_px: variance.sqrt() })
    }
}

/// [`fit_pose`] where nothing is known of the tilt: seen from afar, paper that leans towards the camera looks almost like paper
/// that leans away by as much, and a fit may end in either (G. Schweighofer, A. Pinz, "Robust Pose Estimation from a Planar
/// Target", 2006). Both are tried.
fn fit_pose_afresh(lens: &Lens, points: &[GridPoint], start: &Pose) -> Option<PoseFit> {
    let one = fit_pose(lens, points, start)?;
    let middle = points.iter().map(|p| p.paper_mm.coords).sum::<Vector2<f64>>() / points.len() as f64;
    let other = fit_pose(lens, points, &leaning_the_other_way(&one.pose, &Point2::from(middle)));
    Some(other.filter(|other| other.rms_px < one.rms_px).unwrap_or(one))
}

/// The pose in which a place of the paper (mm) is where it is, and the paper leans as far to the other side of its line of
/// sight.
fn leaning_the_other_way(camera_from_grid: &Pose, paper_mm: &Point2<f64>) -> Pose {
    let place = Point3::new(paper_mm.x, paper_mm.y, 0.0);
    let seen = camera_from_grid * place;
    let sight = seen.coords.normalize();
    let normal = camera_from_grid * Vector3::z();
    let mirrored = sight * (2.0 * sight.dot(&normal)) - normal;
    let turn = UnitQuaternion::rotation_between(&normal, &mirrored).unwrap_or_default();
    let rotation = turn * camera_from_grid.rotation;
    Pose::from_parts(Translation3::from(seen.coords - rotation * place.coords), rotation)
}

/// Robust fit of the pose to sightings of the paper.
fn fit_pose(lens: &Lens, points: &[GridPoint], start: &Pose) -> Option<PoseFit> {
    let mut pose = *start;
    let mut kept: Vec<&GridPoint> = points.iter().collect();
    let mut fit = None;
    for _ in 0..3 {
        let residuals = |x: &DVector<f64>| {
            let moved = nudged(&pose, x);
            let errors = kept.iter().flat_map(|p| {
                let e = project_paper(lens, &moved, &p.paper_mm) - p.pixel;
                [e.x, e.y]
            });
            DVector::from_iterator(2 * kept.len(), errors)
        };
        let solution =
            minimise(residuals, DVector::zeros(6), &pose_steps(), &least_squares::Options::default()).ok()?;
        pose = nudged(&pose, &solution.parameters);
        let error = |p: &GridPoint| (project_paper(lens, &pose, &p.paper_mm) - p.pixel).norm();
        let mut sizes: Vec<f32> = points.iter().map(|p| error(p) as f32).collect();
        let limit = 4.0 * f64::from(median(&mut sizes)) + 1e-3;
        kept = points.iter().filter(|p| error(p) < limit).collect();
        // Windows overlap: each place of the paper is in so many of them.
        const OVERLAP: f64 = 28.0;
        fit = PoseFit::new(pose, &solution, OVERLAP);
    }
    fit
}

/// A pose turned by a rotation vector (rad) about its own origin and shifted (mm): x = (rotation, translation).
pub(crate) fn nudged(pose: &Pose, x: &DVector<f64>) -> Pose {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(x[0], x[1], x[2]));
    Pose::from_parts(Translation3::from(pose.translation.vector + Vector3::new(x[3], x[4], x[5])), turn * pose.rotation)
}

/// The pixel of a place on the paper (mm).
pub(crate) fn project_paper(lens: &Lens, camera_from_grid: &Pose, paper_mm: &Point2<f64>) -> Point2<f64> {
    lens.project(&(camera_from_grid * Point3::new(paper_mm.x, paper_mm.y, 0.0)))
}

/// The place of the paper (mm) seen at a pixel, and the gradients of its coordinates (rows), mm per px.
pub(crate) fn paper_at(
    lens: &Lens,
    camera_from_grid: &Pose,
    pixel: &Point2<f64>,
) -> Option<(Point2<f64>, Matrix2<f64>)> {
    let grid_from_camera = camera_from_grid.inverse();
    let eye = grid_from_camera * Point3::origin();
    let hit = |p: &Point2<f64>| -> Option<Point2<f64>> {
        let ray = grid_from_camera * lens.ray(p);
        let distance = -eye.z / ray.z;
        (distance > 0.0).then(|| Point2::new(eye.x + distance * ray.x, eye.y + distance * ray.y))
    };
    let centre = hit(pixel)?;
    let right = hit(&(pixel + Vector2::x()))? - centre;
    let down = hit(&(pixel + Vector2::y()))? - centre;
    Some((centre, Matrix2::from_columns(&[right, down])))
}

/// The wave vectors (cycles per px) that belong to the gradients (rows, pitches per px) of the paper's coordinates.
pub(crate) fn waves_from_gradient(gradient: Matrix2<f64>, pattern: Pattern) -> [Vector2<f64>; 2] {
    let (x, y) = (gradient.row(0).transpose(), gradient.row(1).transpose());
    match pattern {
        Pattern::Lines => [x, y],
        Pattern::Checkerboard => [(x + y) / 2.0, (x - y) / 2.0],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Paper 260 mm away through a long lens, of which only the picture's right side is seen, each place 0.05 px off.
    #[test]
    fn paper_that_leans_is_not_taken_for_paper_that_leans_the_other_way() {
        let scene = crate::simulate::scene::Scene::default();
        let lens = Lens { focal_px: [5000.0, 5000.0].into(), ..scene.lens };
        for about_deg in [0.0_f64, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0] {
            let (sin, cos) = about_deg.to_radians().sin_cos();
            let lean = UnitQuaternion::from_scaled_axis(Vector3::new(cos, sin, 0.0) * 20.0_f64.to_radians());
            let pose = Pose::from_parts(Translation3::new(0.0, 0.0, 260.0), lean);
            let places = (0..9).flat_map(|x| (0..20).map(move |y| (x, y)));
            let points: Vec<GridPoint> = places
                .map(|(x, y)| {
                    let pixel = Point2::new(900.0 + 35.0 * f64::from(x), 30.0 + 35.0 * f64::from(y));
                    let (paper_mm, _) = paper_at(&lens, &pose, &pixel).unwrap();
                    let off = Vector2::new(f64::from(x * 7 + y * 5).sin(), f64::from(x * 3 + y * 11).cos());
                    GridPoint { pixel: pixel + 0.05 * off, paper_mm }
                })
                .collect();
            let square = Pose::translation(0.0, 0.0, 260.0);
            let fit = fit_pose_afresh(&lens, &points, &square).unwrap();
            let off_deg = fit.pose.rotation.angle_to(&pose.rotation).to_degrees();
            assert!(off_deg < 0.1, "paper leaning about {about_deg}° is placed {off_deg:.2}° off");
        }
    }
}
