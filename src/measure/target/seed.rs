//! Recognises the grid target's two waves in a part of the picture, by the peaks of its Fourier spectrum.

use super::pattern::PatternKind;
use crate::camera::Frame;
use crate::measure::image::plane::Plane;
use crate::statistics::order::median;
use nalgebra::{DMatrix, DVector, Point2, Vector2};
use rayon::prelude::*;
use rustfft::{Fft, FftPlanner, num_complex::Complex};
use std::f64::consts::TAU;
use std::ops::{Range, RangeInclusive};

/// Side of the blocks, px, within which colours are compared with their mean.
///
/// Convention: longer than most printed lines are wide; which mix of colours is strongest does not hang on it.
const BLOCK_PX: u32 = 8;
/// Sides of the squares of the picture that are transformed, px.
///
/// Convention: powers of two, for the FFT's sake.
const SIZES_PX: [usize; 4] = [128, 256, 512, 1024];
/// The smallest square, px, where the picture allows it, and the fewest waves of the expected length in it.
///
/// Derived: a Hann window's main lobe is ±2/n cycles per px wide for n px, so five waves across stand 2.5 lobe halves from the
/// mean grey. 256 px give as much to waves of 50 px, and more to shorter ones.
const LEAST_SIZE_PX: f64 = 256.0;
const FEWEST_WAVES: f64 = 5.0;
/// Where between the shortest and the longest wave of the range the expected one is, as a share of the longest.
///
/// Convention: near the middle of the ranges that are asked for.
const EXPECTED_SHARE: f64 = 0.7;
/// Columns and rows of squares that are looked at.
///
/// Convention: enough that some lie beside the snake; the strongest one counts.
const COLUMNS: usize = 5;
const ROWS: usize = 3;
/// Places along each side of a square at which it is asked whether it shows the snake, and the largest share of them that may.
///
/// Convention: a snake's edge is no wave, and an eighth of the square is too little of it to matter beside five waves.
const PROBES: usize = 8;
const MOST_SNAKE: f64 = 0.125;
/// The strongest peaks of a spectrum, of which the best pair is taken.
///
/// Convention: the two waves and their diagonal sums are six; the rest is room for a heavier ruling's.
const PEAKS: usize = 12;
/// Largest angle between the lines and the snake's axis (or square to it), degrees.
///
/// Convention: waves of lines run along the snake's axis, those of squares at 45° to it; of the 45° between the two the lines get two
/// thirds.
const MOST_TURN_DEG: f64 = 30.0;
/// Largest |cosine| of the angle between the two waves, and the range of the ratio of their lengths.
///
/// Derived: a target tilted by the angle φ shrinks by cos φ along one direction: at 41° the lengths' ratio is 0.75, and waves at 45° to
/// that direction meet under a cosine of (1 − cos² φ)/(1 + cos² φ) = 0.28; the lens and perspective need the rest.
const MOST_COSINE: f64 = 0.35;
const LENGTH_RATIOS: Range<f64> = 0.75..1.33;
/// Least strength of both waves over the median of the spectrum in the range.
///
/// Derived: amplitudes of noise have a Rayleigh distribution, whose median is 1.18 σ; five medians are exceeded with a probability of
/// exp(−17) per place of the spectrum, of which there are fewer than 10⁵.
const LEAST_STRENGTH: f64 = 5.0;

/// Where the grid was first recognised: a square's centre and its two wave vectors, cycles per px.
pub(super) struct Seed {
    pub centre: Point2<f64>,
    pub waves: [Vector2<f64>; 2],
}

impl Seed {
    /// Length of its longer wave, px.
    pub fn period_px(&self) -> f64 {
        1.0 / self.waves[0].norm().min(self.waves[1].norm())
    }
}

/// The mix of channels in which the target's fine structure is strongest: the first principal component of what is left
/// after the mean of each pixel's block is taken away.
pub(super) fn strongest_mix(frame: &Frame, is_snake: &impl Fn(&Point2<f64>) -> bool) -> Plane {
    let channels = frame.channels;
    let mut scatter = DMatrix::zeros(channels, channels);
    for y in (0..frame.height.saturating_sub(BLOCK_PX)).step_by(2 * BLOCK_PX as usize) {
        for x in (0..frame.width.saturating_sub(BLOCK_PX)).step_by(2 * BLOCK_PX as usize) {
            if is_snake(&Point2::new(f64::from(x), f64::from(y))) {
                continue;
            }
            let level = |k: u32, c: usize| f64::from(frame.get(x + k % BLOCK_PX, y + k / BLOCK_PX, c));
            let colours: Vec<DVector<f64>> =
                (0..BLOCK_PX * BLOCK_PX).map(|k| DVector::from_fn(channels, |c, _| level(k, c))).collect();
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

/// Looks for two square waves of the expected length in squares of the picture that show little but the target.
///
/// `pitch_px` is the range of the pitch, and `axis` the direction of the snake.
pub(super) fn find_seed(
    plane: &Plane,
    kind: PatternKind,
    pitch_px: &RangeInclusive<f64>,
    axis: Vector2<f64>,
    is_snake: &(impl Fn(&Point2<f64>) -> bool + Sync),
) -> Option<Seed> {
    let numbers = 1.0 / (kind.wavelength() * pitch_px.end())..1.0 / (kind.wavelength() * pitch_px.start());
    let size = square_size(plane, &numbers)?;
    let fft = FftPlanner::new().plan_fft_forward(size);
    let in_square = |k: usize| {
        let x0 = k % COLUMNS * (plane.width - size) / (COLUMNS - 1);
        let y0 = k / COLUMNS * (plane.height - size) / (ROWS - 1);
        let probe =
            |k: usize| Point2::new((x0 + k % PROBES * size / PROBES) as f64, (y0 + k / PROBES * size / PROBES) as f64);
        let covered = (0..PROBES * PROBES).filter(|&k| is_snake(&probe(k))).count();
        if covered as f64 > MOST_SNAKE * (PROBES * PROBES) as f64 {
            return None;
        }
        let spectrum = Spectrum::of_square(plane, (x0, y0), size, fft.as_ref());
        let (strength, waves) = spectrum.wave_pair(&numbers, axis, kind)?;
        let centre = Point2::new((x0 + size / 2) as f64, (y0 + size / 2) as f64);
        Some((strength, Seed { centre, waves }))
    };
    // In the order of the squares, so that the first of the strongest is taken.
    let seeds: Vec<_> = (0..ROWS * COLUMNS).into_par_iter().filter_map(in_square).collect();
    let stronger = |a: (f64, Seed), b: (f64, Seed)| if b.0 > a.0 { b } else { a };
    seeds.into_iter().reduce(stronger).map(|(_, seed)| seed)
}

/// Side of the squares, px, that hold enough waves with numbers (cycles per px) in a range; `None` where the picture is smaller
/// than the smallest.
fn square_size(plane: &Plane, numbers: &Range<f64>) -> Option<usize> {
    let fits = |size: &usize| *size <= plane.width.min(plane.height);
    let expected_px = EXPECTED_SHARE / numbers.start;
    let enough = LEAST_SIZE_PX.max(FEWEST_WAVES * expected_px);
    let size = SIZES_PX.into_iter().filter(fits).find(|&size| size as f64 >= enough);
    size.or_else(|| SIZES_PX.into_iter().rfind(fits))
}

/// |FFT| of a Hann-windowed square of the picture.
struct Spectrum {
    size: usize,
    amplitudes: Vec<f64>,
}

impl Spectrum {
    fn of_square(plane: &Plane, (x0, y0): (usize, usize), size: usize, fft: &dyn Fft<f64>) -> Self {
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
        // Numbers of this size need no guard against overflow, which takes ten times as long.
        Self { size, amplitudes: data.iter().map(|c| c.norm_sqr().sqrt()).collect() }
    }

    /// The amplitude of the wave with x and y periods over the square.
    fn at(&self, x: i64, y: i64) -> f64 {
        let size = self.size as i64;
        self.amplitudes[(y.rem_euclid(size) * size + x.rem_euclid(size)) as usize]
    }

    /// The strongest peaks with wave numbers in a range, cycles per px, and the median amplitude there. Of a wave and its opposite,
    /// which are one, the one to the right is taken.
    fn peaks(&self, numbers: &Range<f64>) -> (Vec<(f64, Vector2<f64>)>, f64) {
        let size = self.size as f64;
        let reach = (numbers.end * size).ceil() as i64;
        let mut peaks: Vec<(f64, Vector2<f64>)> = Vec::new();
        let mut amplitudes: Vec<f64> = Vec::new();
        for y in -reach..=reach {
            for x in 0..=reach {
                let number = ((x * x + y * y) as f64).sqrt() / size;
                if !numbers.contains(&number) || (x == 0 && y <= 0) {
                    continue;
                }
                let amplitude = self.at(x, y);
                amplitudes.push(amplitude);
                let neighbours = [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)];
                if neighbours.iter().all(|(dx, dy)| self.at(x + dx, y + dy) <= amplitude) {
                    // The vertex of the parabola through a peak and its two neighbours.
                    let vertex = |before: f64, after: f64| {
                        0.5 * (after - before) / (2.0 * amplitude - before - after).max(f64::MIN_POSITIVE)
                    };
                    let dx = vertex(self.at(x - 1, y), self.at(x + 1, y));
                    let dy = vertex(self.at(x, y - 1), self.at(x, y + 1));
                    peaks.push((amplitude, Vector2::new(x as f64 + dx, y as f64 + dy) / size));
                }
            }
        }
        peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
        peaks.truncate(PEAKS);
        (peaks, median(&mut amplitudes))
    }

    /// The two strongest, roughly square, waves with wave numbers (cycles per px) in a range that run as a target's may, with the
    /// weaker one's strength over the median.
    fn wave_pair(
        &self,
        numbers: &Range<f64>,
        axis: Vector2<f64>,
        kind: PatternKind,
    ) -> Option<(f64, [Vector2<f64>; 2])> {
        let (peaks, floor) = self.peaks(numbers);
        let mut best: Option<(f64, [Vector2<f64>; 2])> = None;
        for (i, (strength_a, a)) in peaks.iter().enumerate() {
            for (strength_b, b) in &peaks[i + 1..] {
                let strength = strength_a.min(*strength_b) / floor.max(f64::MIN_POSITIVE);
                let is_square = (a.dot(b) / (a.norm() * b.norm())).abs() < MOST_COSINE
                    && LENGTH_RATIOS.contains(&(a.norm() / b.norm()));
                if is_square
                    && runs_as_expected(a, axis, kind)
                    && strength > LEAST_STRENGTH
                    && best.is_none_or(|(s, _)| strength > s)
                {
                    best = Some((strength, ordered(*a, *b, kind)));
                }
            }
        }
        best
    }
}

/// Whether a wave runs as those of a kind of pattern may: lines along the snake or square to it, squares' waves between.
fn runs_as_expected(wave: &Vector2<f64>, axis: Vector2<f64>, kind: PatternKind) -> bool {
    let turn_deg = wave.angle(&axis).to_degrees().rem_euclid(90.0);
    let is_along = turn_deg.min(90.0 - turn_deg) < MOST_TURN_DEG;
    is_along == (kind == PatternKind::Lines)
}

/// Turns two waves so that the target's axes they imply are nearest to the picture's: x right, y down.
fn ordered(a: Vector2<f64>, b: Vector2<f64>, kind: PatternKind) -> [Vector2<f64>; 2] {
    let mut best = ([a, b], f64::MIN);
    for (first, second) in [(a, b), (b, a)] {
        for (s, t) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
            let waves = [first * s, second * t];
            let [x, y] = kind.gradients(waves);
            let agreement = x.x / x.norm() + y.y / y.norm();
            if agreement > best.1 {
                best = (waves, agreement);
            }
        }
    }
    best.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::target::phases::tests::{noisy, wave_plane};

    #[test]
    fn two_waves_under_noise_are_found_with_their_lengths_and_directions() {
        for (kind, roll_deg) in
            [(PatternKind::Lines, 8.0_f64), (PatternKind::Lines, -20.0), (PatternKind::Checkerboard, 5.0)]
        {
            let pitch_px = 16.3;
            let (sin, cos) = roll_deg.to_radians().sin_cos();
            let gradient = nalgebra::Matrix2::new(cos, sin, -sin, cos) / pitch_px;
            let waves = kind.waves(gradient);
            let plane = noisy(wave_plane(400, 300, waves, [0.1, -0.3]), 1.0, 3);
            let seed = find_seed(&plane, kind, &(10.0..=25.0), Vector2::y(), &|_| false).unwrap();
            for (found, true_wave) in seed.waves.iter().zip(waves) {
                // A tenth of the spectrum's resolution of one cycle over 256 px.
                assert!((found - true_wave).norm() < 0.1 / 256.0, "{kind:?} {roll_deg}°: {found} for {true_wave}");
            }
            let longest = 1.0 / waves[0].norm().min(waves[1].norm());
            assert!((seed.period_px() / longest - 1.0).abs() < 0.01);
        }
    }

    #[test]
    fn noise_alone_and_waves_of_another_length_are_not_taken_for_the_grid() {
        let noise = noisy(Plane::new(400, 300, vec![0.0; 400 * 300]), 1.0, 5);
        let coarse = [Vector2::new(1.0 / 60.0, 0.0), Vector2::new(0.0, 1.0 / 60.0)];
        let coarse = noisy(wave_plane(400, 300, coarse, [0.0, 0.0]), 2.0, 6);
        for plane in [noise, coarse] {
            for kind in [PatternKind::Lines, PatternKind::Checkerboard] {
                assert!(find_seed(&plane, kind, &(10.0..=25.0), Vector2::y(), &|_| false).is_none(), "{kind:?}");
            }
        }
    }
}
