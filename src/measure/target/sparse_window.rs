//! Phases of the target's two waves in a window of a frame, from a sparse sample of its pixels.
//!
//! The demodulation is that of `phases`, made ready once for a fixed window and fixed waves and carried out on every so manieth
//! pixel, straight from the frame's own samples, so that it costs a thousandth of what finding the grid anew would.

use super::pattern::wrap_cycles;
use crate::camera::{Frame, Sample, Samples};
use nalgebra::{Point2, Vector2};
use rustfft::num_complex::Complex;
use std::f64::consts::{PI, TAU};

/// Phase and amplitude of a wave in a window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Phase {
    /// Cycles beyond what is expected, in [−½, ½].
    pub cycles: f64,
    /// Half of a cosine's, grey levels.
    pub amplitude: f64,
}

/// A square of the picture, tapered towards its borders, in which phases are measured.
#[derive(Debug)]
pub struct SparseWindow {
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
    /// The phase that is expected, cycles.
    expected: f64,
    wavelength_px: f64,
}

impl SparseWindow {
    /// A window whose centre is `radius` pixels right of and below `corner`, of which every `stride`-th pixel in both directions is
    /// read. `phases` (cycles) are expected at the centre, of waves (cycles per px).
    pub fn new(
        corner: (usize, usize),
        radius: usize,
        stride: usize,
        phases: Vector2<f64>,
        waves: [Vector2<f64>; 2],
    ) -> Self {
        let side = 2 * radius + 1;
        let place = |k: usize| k as f64 - radius as f64;
        let taper: Vec<f64> = (0..side).map(|k| 0.5 + 0.5 * (PI * place(k) / (radius as f64 + 1.0)).cos()).collect();
        let rows = jittered_rows(side, stride);
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

    /// The middle pixel.
    pub fn centre(&self) -> Point2<f64> {
        let radius = (self.side / 2) as f64;
        Point2::new(self.corner.0 as f64 + radius, self.corner.1 as f64 + radius)
    }

    /// Lengths of the two waves, px.
    pub fn wavelengths_px(&self) -> [f64; 2] {
        [0, 1].map(|k| self.waves[k].wavelength_px)
    }

    /// Measures both waves in the mix of a frame's channels with these weights, one for each.
    pub fn phases(&self, frame: &Frame, weights: &[f64]) -> [Phase; 2] {
        let columns = self.column_sums(frame, weights);
        let [grey, parts @ ..] = &columns;
        let plain: f64 = (0..self.side).map(|k| f64::from(grey[self.place(k)] * self.taper[k])).sum();
        // The mean grey must not leak into the wave.
        let mean = plain / self.weight;
        std::array::from_fn(|wave| {
            let along = |k: usize| {
                let down = Complex::new(parts[2 * wave][self.place(k)], parts[2 * wave + 1][self.place(k)]);
                let along = self.waves[wave].across[k] * down;
                Complex::new(f64::from(along.re), f64::from(along.im))
            };
            let sum: Complex<f64> = (0..self.side).map(along).sum();
            let wave_part = (sum - self.waves[wave].flat * mean) / self.weight;
            let cycles = wrap_cycles(wave_part.arg() / TAU - self.waves[wave].expected);
            Phase { cycles, amplitude: wave_part.norm() }
        })
    }

    /// Sums down every column: of the grey and, real and imaginary, of both waves' parts, each at [`place`](Self::place).
    fn column_sums(&self, frame: &Frame, weights: &[f64]) -> [Vec<f32>; 5] {
        let (x0, y0) = self.corner;
        let weights: Vec<f32> = weights.iter().map(|w| *w as f32).collect();
        let together = self.side.div_ceil(self.stride);
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
        columns
    }

    /// Where a column's sums are: columns that are sampled together lie side by side, so that the compiler takes many at once.
    fn place(&self, column: usize) -> usize {
        column % self.stride * self.side.div_ceil(self.stride) + column / self.stride
    }
}

/// The rows of a window that are sampled, each with the first of its columns: every so many, but not in step, so that what a
/// regular lattice would mistake for the wave becomes noise.
fn jittered_rows(side: usize, stride: usize) -> Vec<(usize, usize)> {
    // A hash that is the same in every run: multiplication by 2⁶⁴ over the golden ratio (Knuth, The Art of Computer Programming,
    // vol. 3, 6.4).
    let jitter = |k: usize, salt: u64| {
        let bits = (k as u64 + salt).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        ((bits >> 40) % stride as u64) as usize
    };
    (0..side / stride).map(|k| (k * stride + jitter(k, 1), jitter(k, 1000))).filter(|(row, _)| *row < side).collect()
}

/// The weighted sums of the channels of some pixels: every so many, from the `first` on.
fn mix<S: Sample>(pixels: Option<&[S]>, weights: &[f32], (first, stride): (usize, usize), into: &mut Vec<f32>) {
    let pixels = pixels.unwrap_or_default();
    if let &[red, green, blue] = weights {
        let colours = pixels.as_chunks::<3>().0.get(first..).unwrap_or_default();
        let grey = |[r, g, b]: [S; 3]| r.level() * red + g.level() * green + b.level() * blue;
        into.extend(colours.chunks(stride).map(|some| grey(some[0])));
    } else {
        let channels = weights.len().max(1);
        let grey = |pixel: &[S]| pixel.iter().zip(weights).map(|(v, w)| v.level() * w).sum::<f32>();
        into.extend(pixels.chunks_exact(channels).skip(first).step_by(stride).map(grey));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::moments::rms;
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, Normal};

    /// A grey frame of two waves with these phases at pixel (0, 0), under normal noise.
    fn frame(waves: [Vector2<f64>; 2], phases: [f64; 2], sigma: f64, seed: u64) -> Frame {
        let mut random = StdRng::seed_from_u64(seed);
        let noise = Normal::new(0.0, sigma).unwrap();
        let (width, height) = (200_u32, 160_u32);
        let value = |k: u32| {
            let at = Vector2::new(f64::from(k % width), f64::from(k / width));
            let waves = (0..2).map(|k| 40.0 * (TAU * (waves[k].dot(&at) + phases[k])).cos()).sum::<f64>();
            (120.0 + waves + noise.sample(&mut random)).round() as u8
        };
        let samples = Samples::Bits8((0..width * height).map(value).collect());
        Frame { width, height, channels: 1, samples }
    }

    #[test]
    fn a_sparse_window_sees_the_phases_of_a_picture_as_far_as_its_noise_allows() {
        let waves = [Vector2::new(0.060, 0.010), Vector2::new(-0.011, 0.062)];
        let (corner, radius) = ((30, 20), 60);
        for stride in [1, 3] {
            let centre = Vector2::new((corner.0 + radius) as f64, (corner.1 + radius) as f64);
            let expected = Vector2::from_fn(|k, _| waves[k].dot(&centre));
            let window = SparseWindow::new(corner, radius, stride, expected, waves);
            assert_eq!(window.centre().coords, centre);
            let still = window.phases(&frame(waves, [0.12, -0.31], 0.0, 0), &[1.0]);
            for (phase, shift) in still.iter().zip([0.12, -0.31]) {
                // A sparse sample mistakes some of the other wave for noise.
                assert!((phase.cycles - shift).abs() < if stride == 1 { 1e-3 } else { 0.01 }, "{phase:?}");
                assert!((phase.amplitude / 20.0 - 1.0).abs() < 0.05, "{phase:?}");
            }
            // Noise of σ = 8 on n samples weighted by Hann's window: σ √(Σw²/2)/(20 Σw) rad, where of a square window Σw² = (3/8)² n and
            // Σw = n/4.
            let samples = ((2 * radius + 1) / stride).pow(2) as f64;
            let predicted = 8.0 * (3.0 / 8.0) / (20.0 * 0.25 * (2.0 * samples).sqrt()) / TAU;
            let errors = (0..150).map(|seed| {
                let seen = window.phases(&frame(waves, [0.12, -0.31], 8.0, 1 + seed), &[1.0]);
                seen[0].cycles - still[0].cycles
            });
            let seen = rms(errors);
            // 150 draws tell it to 6 %; three and a half times that.
            assert!((seen / predicted - 1.0).abs() < 0.2, "stride {stride}: {seen} seen, {predicted} predicted");
        }
    }

    #[test]
    fn rows_of_a_sparse_window_are_each_in_their_own_stripe() {
        for stride in 1..=3 {
            let rows = jittered_rows(61, stride);
            assert!(rows.len() >= 61 / stride - 1);
            for (k, (row, first)) in rows.into_iter().enumerate() {
                assert!((k * stride..(k + 1) * stride).contains(&row) && first < stride);
            }
        }
    }
}
