//! The phases of the target's two waves in windows all over the picture, unwrapped from neighbour to neighbour.
//!
//! In each window the phase of a wave is that of Σ w(x) I(x) exp(−2πi k·x), with a Hann window w, the picture I and the wave vector
//! k: synchronous demodulation. It is known up to whole cycles. A window's neighbour has the phase that the wave vector
//! predicts to well within half a cycle, so that a flood fill from the seed counts the cycles.

use super::pattern::{PatternKind, wrap_cycles};
use super::sheet::Sheet;
use super::sheet_fit::TargetPoint;
use crate::camera::Lens;
use crate::measure::image::plane::Plane;
use crate::statistics::order::quantile;
use nalgebra::{Point2, Vector2};
use rayon::prelude::*;
use rustfft::num_complex::Complex;
use std::collections::BinaryHeap;
use std::f64::consts::{PI, TAU};

/// Amplitude from which on a wave counts as the target's, as a share of that in the clearest windows, and the share of windows that these are.
///
/// Derived: in a picture of even contrast the waves are as strong everywhere; at half of the clearest amplitude a window lies half
/// beyond the sheet's edge, and a quarter is still ten times what noise of the same contrast leaves in a window of 1000 px.
const LEAST_AMPLITUDE: f64 = 0.25;
const CLEAREST: f64 = 0.9;
/// Largest difference, cycles, between a phase and the one predicted.
///
/// Derived: a phase is certain up to whole cycles, so that half a cycle cannot be told from its opposite; half of that keeps both
/// signs apart.
const MOST_DEVIATION_CYCLES: f64 = 0.25;
/// Fewest columns and rows of windows.
///
/// Convention: fewer could not show a target's tilt.
const FEWEST_WINDOWS: i64 = 3;

/// Distance between the centres of windows, in pitches: neighbours overlap, so that their phases cannot differ by much more
/// than the seed's waves predict.
///
/// Fitted: by hand on the project's renders (tests/eye/robustness); for ruled lines the lines themselves decide in the end.
fn spacing(kind: PatternKind) -> f64 {
    match kind {
        PatternKind::Lines => 1.7,
        PatternKind::Checkerboard => 0.6,
    }
}

/// In how many windows each part of the target is seen, so that their errors are alike: the variance of a mean over all windows is so
/// many times what it would be if they did not overlap.
///
/// Derived: for noise that is independent from pixel to pixel the phases of two windows are correlated as the windows'
/// autocorrelation; its sum over the lattice of windows is (∫w)²/∫w² over the distance of the windows, squared for the two directions, and
/// for Hann's window of radius R that is 4 R/3.
pub(super) fn design_effect(kind: PatternKind) -> f64 {
    let radius = kind.window_radius() * kind.wavelength();
    (4.0 / 3.0 * radius / spacing(kind)).powi(2)
}

/// The windows of one picture.
pub(super) struct Windows<'a> {
    plane: &'a Plane,
    kind: PatternKind,
    taper: Taper,
    columns: i64,
    /// Row by row.
    windows: Vec<Window>,
    /// Amplitudes from which on the two waves count as the target's.
    enough: [f64; 2],
}

/// A part of the picture in which phases are measured.
#[derive(Debug, Clone, Copy)]
struct Window {
    centre: Point2<f64>,
    /// Counted phases of the two waves, cycles; `None` where they are not seen.
    phases: Option<Vector2<f64>>,
    /// Whether both waves are as strong here as on the target.
    is_strong: bool,
}

/// A window whose phases are counted, the clearest of which is gone on from first.
#[derive(Debug, PartialEq)]
struct Counted {
    amplitude: f64,
    window: usize,
}

impl Eq for Counted {}

impl PartialOrd for Counted {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Counted {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.amplitude.total_cmp(&other.amplitude).then(self.window.cmp(&other.window))
    }
}

impl<'a> Windows<'a> {
    /// Lays windows over a picture and counts the phases of two waves from the clearest window on, as far as the target goes; `None`
    /// where the picture has too little room for windows.
    pub fn new(plane: &'a Plane, kind: PatternKind, waves: [Vector2<f64>; 2]) -> Option<Self> {
        let radius = kind.window_radius() / waves[0].norm();
        let step = spacing(kind) / kind.gradients(waves)[0].norm();
        let count = |length: usize| ((length as f64 - 2.0 * radius - 2.0) / step).floor() as i64;
        let (columns, rows) = (count(plane.width), count(plane.height));
        if columns < FEWEST_WINDOWS || rows < FEWEST_WINDOWS {
            return None;
        }
        let place = |x: i64, y: i64| Point2::new(radius + 1.0 + x as f64 * step, radius + 1.0 + y as f64 * step);
        let window = |k: i64| Window { centre: place(k % columns, k / columns), phases: None, is_strong: false };
        let windows: Vec<Window> = (0..rows * columns).map(window).collect();
        let taper = Taper::new(radius);
        let seen: Vec<[(f64, f64); 2]> =
            windows.par_iter().map(|window| phases_at(plane, &window.centre, waves, &taper)).collect();
        let enough = [0, 1].map(|wave| {
            let mut amplitudes: Vec<f64> = seen.iter().map(|seen| seen[wave].1).collect();
            LEAST_AMPLITUDE * quantile(&mut amplitudes, CLEAREST)
        });
        let mut windows = Self { plane, kind, taper, columns, windows, enough };
        windows.count(waves, &seen);
        Some(windows)
    }

    /// Counts cycles from neighbour to neighbour, the clearest first.
    fn count(&mut self, waves: [Vector2<f64>; 2], seen: &[[(f64, f64); 2]]) {
        let amplitude = |k: usize| {
            (0..2).map(|wave| seen[k][wave].1 / self.enough[wave].max(f64::MIN_POSITIVE)).fold(f64::MAX, f64::min)
        };
        let amplitudes: Vec<f64> = (0..seen.len()).map(amplitude).collect();
        let Some(start) = (0..seen.len()).max_by(|&a, &b| amplitudes[a].total_cmp(&amplitudes[b])) else { return };
        self.windows[start].phases = Some(Vector2::new(seen[start][0].0, seen[start][1].0));
        let mut open = BinaryHeap::from([Counted { amplitude: amplitudes[start], window: start }]);
        while let Some(Counted { window: from, .. }) = open.pop() {
            let Some(known) = self.windows[from].phases else { continue };
            for to in self.neighbours(from) {
                if self.windows[to].phases.is_some() {
                    continue;
                }
                let moved = self.windows[to].centre - self.windows[from].centre;
                let predicted = known + Vector2::new(waves[0].dot(&moved), waves[1].dot(&moved));
                self.windows[to].phases = self.counted(&seen[to], predicted);
                if self.windows[to].phases.is_some() {
                    open.push(Counted { amplitude: amplitudes[to], window: to });
                }
            }
        }
    }

    /// Measures the phases of all windows again, with the waves and the cycles that a sheet predicts.
    pub fn measure_again(&mut self, lens: &Lens, pitch_mm: f64, sheet: &Sheet) {
        let again = |window: &Window| {
            let Some((place_mm, gradient)) = sheet.at(lens, &window.centre) else {
                return Window { phases: None, is_strong: false, ..*window };
            };
            let waves = self.kind.waves(gradient / pitch_mm);
            let seen = phases_at(self.plane, &window.centre, waves, &self.taper);
            let phases = self.counted(&seen, self.kind.phases(place_mm.coords / pitch_mm));
            Window { phases, is_strong: self.are_strong(&seen), ..*window }
        };
        self.windows = self.windows.par_iter().map(again).collect();
    }

    /// The share of the windows with waves as strong as the target's in which they are where a sheet predicted them, when phases were measured
    /// again.
    pub fn agreeing(&self) -> f64 {
        let strong = self.windows.iter().filter(|window| window.is_strong);
        let (all, seen) = strong.fold((0, 0), |(all, seen), w| (all + 1, seen + usize::from(w.phases.is_some())));
        f64::from(seen as u32) / f64::from(all.max(1))
    }

    /// The places of the target that were seen.
    pub fn points(&self, pitch_mm: f64) -> Vec<TargetPoint> {
        let seen = self.windows.iter().filter_map(|window| Some((window.centre, window.phases?)));
        seen.map(|(pixel, phases)| TargetPoint { pixel, target_mm: Point2::from(self.kind.place(phases) * pitch_mm) })
            .collect()
    }

    /// The windows left, right, above and below one.
    fn neighbours(&self, of: usize) -> impl Iterator<Item = usize> + use<> {
        let (columns, rows) = (self.columns, self.windows.len() as i64 / self.columns);
        let (x, y) = (of as i64 % columns, of as i64 / columns);
        let all = [(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)];
        let inside = move |&(x, y): &(i64, i64)| (0..columns).contains(&x) && (0..rows).contains(&y);
        all.into_iter().filter(inside).map(move |(x, y)| (y * columns + x) as usize)
    }

    /// The phases that were seen, counted by predicted ones; `None` where a wave is too weak or too far from there.
    fn counted(&self, seen: &[(f64, f64); 2], predicted: Vector2<f64>) -> Option<Vector2<f64>> {
        let mut phases = Vector2::zeros();
        for (wave, &(phase, _)) in seen.iter().enumerate() {
            let deviation = wrap_cycles(phase - predicted[wave]);
            if deviation.abs() > MOST_DEVIATION_CYCLES {
                return None;
            }
            phases[wave] = predicted[wave] + deviation;
        }
        self.are_strong(seen).then_some(phases)
    }

    /// Whether both waves are as strong as on the target.
    fn are_strong(&self, seen: &[(f64, f64); 2]) -> bool {
        seen.iter().zip(self.enough).all(|((_, amplitude), enough)| *amplitude >= enough)
    }
}

/// Hann's window of one radius (px), along one direction: its weights at whole pixels from its middle.
struct Taper {
    weights: Vec<f64>,
    sum: f64,
}

impl Taper {
    fn new(radius: f64) -> Self {
        let reach = radius.floor() as i64;
        let weights: Vec<f64> = (-reach..=reach).map(|k| 0.5 + 0.5 * (PI * k as f64 / radius).cos()).collect();
        Self { sum: weights.iter().sum(), weights }
    }

    /// Pixels on either side of the middle.
    fn reach(&self) -> i64 {
        self.weights.len() as i64 / 2
    }

    /// The weights times exp(−2πi f k) at the k-th pixel from the middle, for a wave of f cycles per px.
    fn turned(&self, cycles_per_px: f64) -> Vec<Complex<f64>> {
        let by_pixel = Complex::from_polar(1.0, -TAU * cycles_per_px);
        let first = Complex::from_polar(1.0, TAU * cycles_per_px * self.reach() as f64);
        let turns = std::iter::successors(Some(first), |turn| Some(turn * by_pixel));
        turns.zip(&self.weights).map(|(turn, weight)| turn * weight).collect()
    }
}

/// The phases (cycles, in [−½, ½]) of two waves (cycles per px) at the centre of a window, and their amplitudes.
fn phases_at(plane: &Plane, centre: &Point2<f64>, waves: [Vector2<f64>; 2], taper: &Taper) -> [(f64, f64); 2] {
    let reach = taper.reach();
    let (cx, cy) = (centre.x.round() as i64, centre.y.round() as i64);
    let columns = waves.map(|wave| taper.turned(wave.x));
    let rows = waves.map(|wave| taper.turned(wave.y));
    let (mut totals, mut grey) = ([Complex::<f64>::ZERO; 2], 0.0);
    for (k, weight) in taper.weights.iter().enumerate() {
        let first = (cy - reach + k as i64) as usize * plane.width + (cx - reach) as usize;
        let sums = row_sums(&plane.data[first..][..taper.weights.len()], &columns, &taper.weights);
        totals.iter_mut().zip(&rows).zip(sums.0).for_each(|((total, row), sum)| *total += sum * row[k]);
        grey += sums.1 * weight;
    }
    let all = taper.sum * taper.sum;
    std::array::from_fn(|wave| {
        // The mean grey must not leak into the wave.
        let weight = columns[wave].iter().sum::<Complex<f64>>() * rows[wave].iter().sum::<Complex<f64>>();
        let wave_part: Complex<f64> = (totals[wave] - weight * (grey / all)) / all;
        // The phase belongs to the window's pixel; carry it to the exact centre.
        let shift = waves[wave].dot(&(centre - Point2::new(cx as f64, cy as f64)));
        (wrap_cycles(wave_part.arg() / TAU + shift), wave_part.norm())
    })
}

/// The sums of a row of pixels times the two waves' columns, and times the weights.
///
/// Four sums of each, side by side: the compiler keeps the order in which floating-point numbers are added, and a single sum would wait
/// for each of them.
fn row_sums(row: &[f32], columns: &[Vec<Complex<f64>>; 2], weights: &[f64]) -> ([Complex<f64>; 2], f64) {
    /// Convention: the width of the vector registers, 256 bits.
    const LANES: usize = 4;
    let mut waves = [[Complex::<f64>::ZERO; LANES]; 2];
    let mut grey = [0.0; LANES];
    let [first, second] = columns.each_ref().map(|column| column.as_chunks::<LANES>());
    let (pixels, weights) = (row.as_chunks::<LANES>(), weights.as_chunks::<LANES>());
    for (((pixels, first), second), weights) in pixels.0.iter().zip(first.0).zip(second.0).zip(weights.0) {
        for lane in 0..LANES {
            let value = f64::from(pixels[lane]);
            waves[0][lane] += first[lane] * value;
            waves[1][lane] += second[lane] * value;
            grey[lane] += weights[lane] * value;
        }
    }
    for (((&pixel, first), second), weight) in pixels.1.iter().zip(first.1).zip(second.1).zip(weights.1) {
        waves[0][0] += first * f64::from(pixel);
        waves[1][0] += second * f64::from(pixel);
        grey[0] += weight * f64::from(pixel);
    }
    (waves.map(|lanes| lanes.iter().sum()), grey.iter().sum())
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::statistics::moments::rms;
    use nalgebra::Matrix2;
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, Normal};

    /// A picture of two cosine waves of amplitude 10 about grey 100, with these phases (cycles) at pixel (0, 0).
    pub fn wave_plane(width: usize, height: usize, waves: [Vector2<f64>; 2], phases: [f64; 2]) -> Plane {
        let value = |x: usize, y: usize| {
            let at = Vector2::new(x as f64, y as f64);
            100.0 + (0..2).map(|k| 10.0 * (TAU * (waves[k].dot(&at) + phases[k])).cos()).sum::<f64>()
        };
        Plane::new(width, height, (0..width * height).map(|k| value(k % width, k / width) as f32).collect())
    }

    /// The picture with normal noise of this σ on every pixel.
    pub fn noisy(mut plane: Plane, sigma: f64, seed: u64) -> Plane {
        let mut random = StdRng::seed_from_u64(seed);
        let noise = Normal::new(0.0, sigma).unwrap();
        plane.data.iter_mut().for_each(|value| *value += noise.sample(&mut random) as f32);
        plane
    }

    #[test]
    fn the_phase_of_a_wave_is_exact_without_noise_and_scatters_as_theory_says_with_it() {
        let wave = Vector2::new(0.061, 0.013);
        let (radius, centre) = (5.0 / wave.norm(), Point2::new(150.3, 120.8));
        let taper = Taper::new(radius);
        let waves = [wave, Vector2::new(-0.013, 0.061)];
        let plane = wave_plane(300, 240, waves, [0.37, 0.1]);
        let expected = wrap_cycles(wave.dot(&centre.coords) + 0.37);
        let [(phase, amplitude), _] = phases_at(&plane, &centre, waves, &taper);
        assert!(wrap_cycles(phase - expected).abs() < 1e-4, "{phase} for {expected}");
        assert!((amplitude - 5.0).abs() < 0.01, "half the cosine's amplitude, {amplitude}");

        // Of Σ w n exp(−i φ) with white noise n half the power lies across the wave: σ_φ = σ √(Σ w²/2) / (A/2 Σ w) rad.
        let (sigma, draws) = (8.0, 200);
        let errors = (0..draws).map(|seed| {
            wrap_cycles(phases_at(&noisy(plane.clone(), sigma, seed), &centre, waves, &taper)[0].0 - expected)
        });
        let reach = radius.floor() as i64;
        let weights = (-reach..=reach).map(|k| 0.5 + 0.5 * (PI * k as f64 / radius).cos());
        let (sum, squares) = weights.fold((0.0, 0.0), |(sum, squares), t| (sum + t, squares + t * t));
        let predicted = sigma * squares / 2.0_f64.sqrt() / (5.0 * sum * sum) / TAU;
        let seen = rms(errors);
        // 200 draws tell a standard deviation to 5 %; four times that.
        assert!((seen / predicted - 1.0).abs() < 0.2, "{seen} seen, {predicted} predicted");
    }

    #[test]
    fn counted_phases_are_the_truth_up_to_whole_cycles_of_the_start_as_far_as_the_sheet_goes() {
        for kind in [PatternKind::Lines, PatternKind::Checkerboard] {
            let gradient = Matrix2::new(0.06, 0.004, -0.004, 0.06);
            let waves = kind.waves(gradient);
            let mut plane = noisy(wave_plane(640, 480, waves, [0.2, 0.4]), 2.0, 1);
            // The sheet ends at x = 500; beyond it there is noise.
            let is_sheet = |p: &Point2<f64>| p.x < 500.0;
            let noise = noisy(Plane::new(640, 480, vec![100.0; 640 * 480]), 2.0, 2);
            for (k, value) in plane.data.iter_mut().enumerate() {
                *value = if is_sheet(&Point2::new((k % 640) as f64, 0.0)) { *value } else { noise.data[k] };
            }
            // The seed's waves are off by 1 %, as those of a tilted target are at its far side.
            let windows = Windows::new(&plane, kind, waves.map(|wave| wave * 1.01)).unwrap();
            let seen: Vec<&Window> = windows.windows.iter().filter(|window| window.phases.is_some()).collect();
            let errors: Vec<Vector2<f64>> = seen
                .iter()
                .map(|window| {
                    let true_phase = |k: usize| waves[k].dot(&window.centre.coords) + [0.2, 0.4][k];
                    window.phases.unwrap() - Vector2::from_fn(|k, _| true_phase(k))
                })
                .collect();
            assert!(errors.len() as f64 > 0.6 * windows.windows.len() as f64, "{kind:?}: {}", errors.len());
            assert!(seen.iter().all(|window| window.centre.x < 530.0), "{kind:?}");
            let cycles = errors[0].map(f64::round);
            assert!(errors.iter().all(|error| (error - cycles).amax() < 0.06), "{kind:?}");
        }
    }

    #[test]
    fn the_design_effect_is_the_sum_of_the_windows_autocorrelation() {
        for kind in [PatternKind::Lines, PatternKind::Checkerboard] {
            let radius = kind.window_radius() * kind.wavelength();
            let hann = |x: f64| if x.abs() < radius { 0.5 + 0.5 * (PI * x / radius).cos() } else { 0.0 };
            let overlap = |shift: f64| -> f64 {
                (-4000..=4000).map(|k| f64::from(k) * radius / 2000.0).map(|x| hann(x) * hann(x - shift)).sum()
            };
            let sum: f64 = (-20..=20).map(|k| overlap(f64::from(k) * spacing(kind)) / overlap(0.0)).sum();
            assert!((design_effect(kind) / sum.powi(2) - 1.0).abs() < 0.01, "{kind:?}");
        }
    }
}
