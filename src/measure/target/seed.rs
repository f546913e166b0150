//! Recognises the grid target's two waves wherever the picture shows them, by the peaks of Fourier spectra.
//!
//! Nothing is known yet of the snake, nor of how much of the picture is the target. Contrast is made even first, so that a shadow, a dark
//! table or a heavy line weighs no more than the rest. Each square of the picture then has a spectrum of its own; pairs of peaks that may be a
//! target's two waves are collected over all squares, and the pair that most squares show most clearly comes first. Heavier lines every 5 or
//! 10 mm, and overtones, make further pairs: which of them has the stated pitch is for the snake's size to tell.

use super::pattern::PatternKind;
use crate::camera::Frame;
use crate::measure::image::plane::Plane;
use crate::statistics::order::{mad_scale, median};
use nalgebra::{DMatrix, DVector, Vector2};
use rayon::prelude::*;
use rustfft::{Fft, FftPlanner, num_complex::Complex};
use std::f64::consts::TAU;
use std::ops::Range;

/// Side of the blocks, px, within which colours are compared with their mean.
///
/// Convention: longer than most printed lines are wide; which mix of colours is strongest does not hang on it.
const BLOCK_PX: u32 = 8;
/// Half the side of the square whose mean is taken away from a pixel, as a share of the picture's longer side; and of the square over which
/// contrast is made even, in units of that.
///
/// Convention: longer than a pitch, of which a picture shows dozens; and short against shadows.
const MEAN_SHARE: f64 = 0.04;
const CONTRAST_REACH: usize = 2;
/// The largest deviation that counts, in units of the contrast around it, and of all deviations' scale.
///
/// Convention: a dark line beside a pale one counts three times, the edge of a snake or a trace of ink no more.
const MOST_DEVIATION: f32 = 3.0;
const MOST_CONTRAST: f32 = 4.0;
/// The least contrast, in units of that scale: a blank part of the picture is not made to look like a pattern.
///
/// Convention: a third of what is usual.
const LEAST_CONTRAST: f32 = 0.3;
/// The least share of a neighbourhood that is shown, of which a mean is taken; of less there is none.
///
/// Convention: a thousandth; keeps what is hidden all around finite.
const LEAST_SHOWN: f32 = 1e-3;
/// The largest and the least side of the squares of the picture that are transformed, px.
///
/// Convention: 146 px for the longest wave, and half of a picture that is 1000 px high; a picture of less than the least shows nothing.
const MOST_SIZE_PX: usize = 512;
const LEAST_SIZE_PX: usize = 96;
/// Fewest waves in a square.
///
/// Derived: a Hann window's main lobe is ±2/n cycles per px wide for n px, so that two and a half waves across stand more than a lobe half
/// from the mean grey, which was taken away before.
const FEWEST_WAVES: f64 = 2.5;
/// The shortest wave that is looked for, px.
///
/// Derived: the second difference that places a line spans 4 px; with lines closer than that it would see three of them.
pub(super) const LEAST_WAVE_PX: f64 = 4.0;
/// Columns and rows of squares that are looked at.
///
/// Convention: squares overlap, so that a small sheet fills some of them.
const COLUMNS: usize = 5;
const ROWS: usize = 3;
/// The strongest peaks of a spectrum of which pairs are made.
///
/// Convention: the two waves, their overtones and diagonal sums are ten; the rest is room for a heavier ruling's.
const PEAKS: usize = 16;
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
/// Pairs of different squares whose waves differ by less than this share are one target's.
///
/// Derived: across a target that is tilted by 12° the waves change by ±4 %.
const SAME_WAVES: f64 = 0.06;
/// The most seeds.
///
/// Convention: a limit of time; the ruling of the stated pitch is nearly always the first or the second.
const MOST_SEEDS: usize = 6;

/// Two waves that may be a target's.
#[derive(Debug, Clone)]
pub(super) struct Seed {
    /// Cycles per px.
    pub waves: [Vector2<f64>; 2],
    /// The weaker wave's amplitude over the median of the spectrum, summed over all squares that show these waves.
    pub strength: f64,
}

impl Seed {
    /// Length of its longer wave, px.
    pub fn period_px(&self) -> f64 {
        1.0 / self.waves[0].norm().min(self.waves[1].norm())
    }

    /// Whether two seeds are of the same target.
    fn is_like(&self, other: &Self) -> bool {
        (0..2).all(|k| (self.waves[k] - other.waves[k]).norm() < SAME_WAVES * self.waves[k].norm())
    }
}

/// The mix of channels in which the target's fine structure is strongest: the first principal component of what is left
/// after the mean of each pixel's block is taken away.
pub(super) fn strongest_mix(frame: &Frame) -> Plane {
    let channels = frame.channels;
    let mut scatter = DMatrix::zeros(channels, channels);
    for y in (0..frame.height.saturating_sub(BLOCK_PX)).step_by(2 * BLOCK_PX as usize) {
        for x in (0..frame.width.saturating_sub(BLOCK_PX)).step_by(2 * BLOCK_PX as usize) {
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

/// The picture with its local mean taken away, and its contrast made even.
pub(super) fn evened(plane: &Plane) -> Plane {
    evened_without(plane, &Plane::new(plane.width, plane.height, vec![1.0; plane.data.len()]))
}

/// The same of a picture of which a part is hidden, where `shown` is 0 and not 1: neither mean nor contrast know what is seen there, and it
/// becomes the mean.
pub(super) fn evened_without(plane: &Plane, shown: &Plane) -> Plane {
    let reach = ((MEAN_SHARE * plane.width.max(plane.height) as f64) as usize).max(BLOCK_PX as usize);
    let mean_of_shown = |data: Vec<f32>, reach: usize| -> Vec<f32> {
        let sums = box_mean(&Plane::new(plane.width, plane.height, data), reach).data;
        let shares = box_mean(shown, reach).data;
        sums.iter().zip(&shares).map(|(sum, share)| sum / share.max(LEAST_SHOWN)).collect()
    };
    let masked = plane.data.iter().zip(&shown.data).map(|(value, shown)| value * shown).collect();
    let mean = mean_of_shown(masked, reach);
    let values = plane.data.iter().zip(&mean).zip(&shown.data);
    let mut data: Vec<f32> = values.map(|((value, mean), shown)| (value - mean) * shown).collect();
    let scale =
        mad_scale(data.iter().step_by(BLOCK_PX as usize - 1).map(|v| f64::from(*v))).max(f64::MIN_POSITIVE) as f32;
    let squares = data.iter().map(|v| v.powi(2).min((MOST_CONTRAST * scale).powi(2))).collect();
    let contrast = mean_of_shown(squares, CONTRAST_REACH * reach);
    for (value, square) in data.iter_mut().zip(&contrast) {
        let contrast = square.sqrt() + LEAST_CONTRAST * scale;
        *value = (*value / contrast).clamp(-MOST_DEVIATION, MOST_DEVIATION);
    }
    Plane::new(plane.width, plane.height, data)
}

/// The mean over (2 reach + 1)² pixels around each; beyond the border there are none.
fn box_mean(plane: &Plane, reach: usize) -> Plane {
    let mut result = plane.clone();
    result.data.par_chunks_exact_mut(plane.width).for_each(|row| {
        let sums: Vec<f64> = std::iter::once(0.0)
            .chain(row.iter().scan(0.0, |sum, v| {
                *sum += f64::from(*v);
                Some(*sum)
            }))
            .collect();
        for (x, value) in row.iter_mut().enumerate() {
            let (from, to) = (x.saturating_sub(reach), (x + reach + 1).min(sums.len() - 1));
            *value = ((sums[to] - sums[from]) / (to - from) as f64) as f32;
        }
    });
    let rows: Vec<&[f32]> = result.data.chunks_exact(plane.width).collect();
    let mut sums = vec![0.0_f64; plane.width];
    let mut data = Vec::with_capacity(plane.data.len());
    rows.iter().take(reach).for_each(|row| sums.iter_mut().zip(*row).for_each(|(sum, v)| *sum += f64::from(*v)));
    for y in 0..plane.height {
        if let Some(row) = rows.get(y + reach) {
            sums.iter_mut().zip(*row).for_each(|(sum, v)| *sum += f64::from(*v));
        }
        if y > reach {
            sums.iter_mut().zip(rows[y - reach - 1]).for_each(|(sum, v)| *sum -= f64::from(*v));
        }
        let count = (y + reach + 1).min(plane.height) - y.saturating_sub(reach);
        data.extend(sums.iter().map(|sum| (sum / count as f64) as f32));
    }
    Plane::new(plane.width, plane.height, data)
}

/// Looks for targets in an evened picture, the clearest first.
pub(super) fn find_seeds(plane: &Plane) -> Vec<Seed> {
    let side = plane.width.min(plane.height);
    if side < LEAST_SIZE_PX {
        return Vec::new();
    }
    // An even side, of which a wave is told from its opposite.
    let size = side.min(MOST_SIZE_PX) / 2 * 2;
    let numbers = FEWEST_WAVES / size as f64..1.0 / LEAST_WAVE_PX;
    let fft = FftPlanner::new().plan_fft_forward(size);
    let in_square = |k: usize| {
        let x0 = k % COLUMNS * (plane.width - size) / (COLUMNS - 1);
        let y0 = k / COLUMNS * (plane.height - size) / (ROWS - 1);
        let pairs = Spectrum::of_square(plane, (x0, y0), size, fft.as_ref()).wave_pairs(&numbers);
        pairs.into_iter().map(move |(strength, waves)| Seed { waves, strength }).collect::<Vec<_>>()
    };
    let mut all: Vec<Seed> = (0..ROWS * COLUMNS).into_par_iter().flat_map_iter(in_square).collect();
    all.sort_by(|a, b| b.strength.total_cmp(&a.strength));
    let mut seeds: Vec<Seed> = Vec::new();
    for seed in all {
        match seeds.iter_mut().find(|known| known.is_like(&seed)) {
            Some(known) => {
                // The mean over all squares is nearest to what the middle of the sheet shows.
                let share = seed.strength / (known.strength + seed.strength);
                known.waves = [0, 1].map(|k| known.waves[k] * (1.0 - share) + seed.waves[k] * share);
                known.strength += seed.strength;
            }
            None => seeds.push(seed),
        }
    }
    seeds.sort_by(|a, b| b.strength.total_cmp(&a.strength));
    seeds.truncate(MOST_SEEDS);
    seeds
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

    /// Pairs of roughly square waves with wave numbers (cycles per px) in a range, each with the weaker one's strength over the median.
    fn wave_pairs(&self, numbers: &Range<f64>) -> Vec<(f64, [Vector2<f64>; 2])> {
        let (peaks, floor) = self.peaks(numbers);
        let pairs = peaks.iter().enumerate().flat_map(|(i, one)| peaks[i + 1..].iter().map(move |other| (one, other)));
        let found = pairs.filter_map(|((strength_a, a), (strength_b, b))| {
            let strength = strength_a.min(*strength_b) / floor.max(f64::MIN_POSITIVE);
            let is_square = (a.dot(b) / (a.norm() * b.norm())).abs() < MOST_COSINE
                && LENGTH_RATIOS.contains(&(a.norm() / b.norm()));
            (is_square && strength > LEAST_STRENGTH).then(|| (strength, ordered(*a, *b, PatternKind::Lines)))
        });
        found.collect()
    }
}

/// Turns two waves so that the target's axes they imply are nearest to the picture's: x right, y down.
pub(super) fn ordered(a: Vector2<f64>, b: Vector2<f64>, kind: PatternKind) -> [Vector2<f64>; 2] {
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
            [(PatternKind::Lines, 8.0_f64), (PatternKind::Lines, -40.0), (PatternKind::Checkerboard, 5.0)]
        {
            let pitch_px = 16.3;
            let (sin, cos) = roll_deg.to_radians().sin_cos();
            let gradient = nalgebra::Matrix2::new(cos, sin, -sin, cos) / pitch_px;
            let [one, other] = kind.waves(gradient);
            let waves = ordered(one, other, PatternKind::Lines);
            let plane = noisy(wave_plane(400, 300, waves, [0.1, -0.3]), 1.0, 3);
            let seeds = find_seeds(&evened(&plane));
            for (found, true_wave) in seeds[0].waves.iter().zip(waves) {
                // A tenth of the spectrum's resolution of one cycle over 256 px.
                assert!((found - true_wave).norm() < 0.1 / 256.0, "{kind:?} {roll_deg}°: {found} for {true_wave}");
            }
            let longest = 1.0 / waves[0].norm().min(waves[1].norm());
            assert!((seeds[0].period_px() / longest - 1.0).abs() < 0.01);
        }
    }

    #[test]
    fn noise_alone_and_stripes_are_not_taken_for_a_grid() {
        let noise = noisy(Plane::new(400, 300, vec![0.0; 400 * 300]), 1.0, 5);
        let stripes = (0..400 * 300).map(|k| ((k % 400) as f32 / 3.0).cos()).collect();
        let stripes = noisy(Plane::new(400, 300, stripes), 0.3, 6);
        for plane in [noise, stripes] {
            assert!(find_seeds(&evened(&plane)).is_empty());
        }
    }

    #[test]
    fn contrast_is_even_afterwards_and_a_box_mean_is_that_of_its_pixels() {
        let plane = noisy(Plane::new(64, 48, vec![5.0; 64 * 48]), 2.0, 7);
        let mean = box_mean(&plane, 3);
        for (x, y) in [(0, 0), (10, 20), (63, 47), (2, 46)] {
            let inside = |c: i64, n: i64| (c - 3).max(0)..(c + 4).min(n);
            let values: Vec<f32> =
                inside(y, 48).flat_map(|y| inside(x, 64).map(move |x| (x, y))).map(|(x, y)| plane.get(x, y)).collect();
            let expected = values.iter().sum::<f32>() / values.len() as f32;
            assert!((mean.get(x, y) - expected).abs() < 1e-4);
        }
        // The same waves, a tenth as strong in the right half, under a step of brightness.
        let waves = [Vector2::new(0.1, 0.0), Vector2::new(0.0, 0.1)];
        let mut plane = wave_plane(400, 200, waves, [0.0, 0.0]);
        for (k, value) in plane.data.iter_mut().enumerate() {
            *value = if k % 400 < 200 { *value } else { 30.0 + 0.3 * (*value - 100.0) };
        }
        let evened = evened(&plane);
        let contrast = |from: usize| {
            let part = evened.data.iter().enumerate().filter(|(k, _)| (from..from + 100).contains(&(k % 400)));
            (part.map(|(_, v)| v * v).sum::<f32>() / 20_000.0).sqrt()
        };
        assert!((contrast(280) / contrast(20) - 1.0).abs() < 0.3, "{} {}", contrast(280), contrast(20));
    }
}
