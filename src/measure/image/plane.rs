//! A single-channel picture with real values, and how it is sampled.

use crate::statistics::order::SD_BY_MAD;
pub use crate::statistics::order::median;
use nalgebra::{Point2, Vector2};
use std::ops::Range;

/// Fractions of a pixel along a line are whole numbers of this part of it, which is twice as fast as floating-point numbers and as
/// exact as their `f32` products.
///
/// Derived: from its bits, below.
const FIXED_POINT: f64 = 1.0 / (1 << FIXED_POINT_BITS) as f64;
/// The bits of such a fraction.
///
/// Derived: `f32` has a mantissa of 24 bits.
const FIXED_POINT_BITS: u32 = 24;
/// So many values of a profile are computed at a time.
///
/// Convention: two registers of four numbers, which every x86-64 and ARM64 processor has.
pub const LANES: usize = 8;
/// How far a Gaussian kernel reaches to either side, in units of its σ.
///
/// Convention: 0.3 % of its weight lies beyond; the kernel is normalised without it.
const KERNEL_REACH: f32 = 3.0;
/// For the noise every so many rows and columns one pixel is used.
///
/// Convention: a prime, so that no pattern of the target is sampled in step; a megapixel leaves 20,000 pixels, whose median scatters
/// by 1 %.
const NOISE_STRIDE: usize = 7;
/// The norm of the noise mask [1 −2 1; −2 4 −2; 1 −2 1].
///
/// Source: Immerkær 1996, see [`Plane::noise`].
const NOISE_MASK_NORM: f64 = 6.0;

/// A grey picture of `f32`, row by row, or a part of one.
#[derive(Debug, Clone)]
pub struct Plane {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The pixel of the whole picture that is this part's first.
    pub first: Vector2<f64>,
    /// `width * height` values.
    pub data: Vec<f32>,
    /// Whether each value is hidden by print that cannot be looked through; empty where none is.
    pub hidden: Vec<bool>,
}

/// Columns and rows of values that are so many in a row.
#[cfg(test)]
fn cropped<T: Copy>(values: &[T], width: usize, columns: &Range<usize>, rows: &Range<usize>) -> Vec<T> {
    let rows = values.chunks_exact(width.max(1)).skip(rows.start).take(rows.len());
    rows.flat_map(|row| &row[columns.clone()]).copied().collect()
}

/// A part of a picture: the columns of every row that belong to it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Region {
    rows: Vec<Range<usize>>,
}

impl Region {
    /// All of a picture.
    pub fn whole(width: u32, height: u32) -> Self {
        Self { rows: vec![0..width as usize; height as usize] }
    }

    /// What lies within `reach_px` of a line's points, to the side, above or below, in a picture of this width and height.
    pub fn along(line: impl IntoIterator<Item = Point2<f64>>, reach_px: f64, (width, height): (u32, u32)) -> Self {
        let range = |middle: f64, most: u32| {
            let limit = |v: f64| v.clamp(0.0, f64::from(most)) as usize;
            limit(middle - reach_px)..limit((middle + reach_px).ceil())
        };
        let mut rows = vec![0..0; height as usize];
        for point in line {
            let columns = range(point.x, width);
            if columns.is_empty() {
                continue;
            }
            rows[range(point.y, height)].iter_mut().for_each(|row| *row = joined(row, &columns));
        }
        Self { rows }
    }

    /// Whether all of another region of the same picture is in it.
    pub fn contains(&self, other: &Self) -> bool {
        let holds = |a: &Range<usize>, b: &Range<usize>| b.is_empty() || (a.start <= b.start && b.end <= a.end);
        self.rows.iter().zip(&other.rows).all(|(row, other)| holds(row, other))
    }

    /// Its rows, each with its columns, that are not empty.
    pub fn rows(&self) -> impl Iterator<Item = (usize, Range<usize>)> {
        self.rows.iter().cloned().enumerate().filter(|(_, columns)| !columns.is_empty())
    }

    /// The least and most column and row, each up to but not including the most.
    pub fn bounds(&self) -> (Range<usize>, Range<usize>) {
        self.rows().fold((0..0, 0..0), |(x, y), (row, columns)| (joined(&x, &columns), joined(&y, &(row..row + 1))))
    }
}

impl Plane {
    /// A picture of these values, row by row.
    pub fn new(width: usize, height: usize, data: Vec<f32>) -> Self {
        Self { width, height, first: Vector2::zeros(), data, hidden: Vec::new() }
    }

    /// The value of one of its own pixels; positions outside are those of the nearest border pixel.
    #[inline]
    pub fn get(&self, x: i64, y: i64) -> f32 {
        let x = x.clamp(0, self.width as i64 - 1) as usize;
        let y = y.clamp(0, self.height as i64 - 1) as usize;
        self.data[y * self.width + x]
    }

    /// Whether the pixel at a place of the picture is hidden.
    pub fn is_hidden(&self, at: &Point2<f64>) -> bool {
        let own = at - self.first;
        let (x, y) = (own.x.round(), own.y.round());
        let is_own = x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64;
        is_own && self.hidden.get(y as usize * self.width + x as usize).is_some_and(|hidden| *hidden)
    }

    /// Bilinear interpolation at a place of the picture; pixel centres are at integers.
    #[inline]
    pub fn sample(&self, at: &Point2<f64>) -> f32 {
        self.sample_own(&(at - self.first))
    }

    /// The same at a place counted from its own first pixel.
    #[inline]
    fn sample_own(&self, at: &Point2<f64>) -> f32 {
        if self.surrounds(at) { self.sample_inside(at) } else { self.sample_at_border(at) }
    }

    /// The same where not all four pixels around are there.
    #[cold]
    fn sample_at_border(&self, at: &Point2<f64>) -> f32 {
        let (x, y) = (at.x.floor(), at.y.floor());
        let (fx, fy) = ((at.x - x) as f32, (at.y - y) as f32);
        let (x, y) = (x as i64, y as i64);
        let top = self.get(x, y) * (1.0 - fx) + self.get(x + 1, y) * fx;
        let bottom = self.get(x, y + 1) * (1.0 - fx) + self.get(x + 1, y + 1) * fx;
        top * (1.0 - fy) + bottom * fy
    }

    /// Values along a line of the picture, the first at `start` and each `step` further than the one before.
    pub fn profile(&self, start: &Point2<f64>, step: Vector2<f64>, into: &mut [[f32; LANES]]) {
        let start = start - self.first;
        let at = |k: usize| start + step * k as f64;
        if !self.surrounds(&start) || !self.surrounds(&at((LANES * into.len()).saturating_sub(1))) {
            into.as_flattened_mut().iter_mut().enumerate().for_each(|(k, value)| *value = self.sample_own(&at(k)));
            return;
        }
        let (mut x, mut y) = (fixed(start.x), fixed(start.y));
        let (dx, dy) = (fixed(step.x), fixed(step.y));
        // The fraction has fewer bits than an `i32`, which is turned into a float four at a time.
        let fraction = |v: i64| (v & ((1 << FIXED_POINT_BITS) - 1)) as i32 as f32 * FIXED_POINT as f32;
        for values in into {
            let (mut fractions, mut pixels) = ([[0.0; LANES]; 2], [[0.0; LANES]; 4]);
            for k in 0..LANES {
                let (column, row) = ((x >> FIXED_POINT_BITS) as usize, (y >> FIXED_POINT_BITS) as usize);
                (fractions[0][k], fractions[1][k]) = (fraction(x), fraction(y));
                let around = self.around(column, row);
                (0..4).for_each(|corner| pixels[corner][k] = around[corner]);
                (x, y) = (x + dx, y + dy);
            }
            for (k, value) in values.iter_mut().enumerate() {
                let around = [pixels[0][k], pixels[1][k], pixels[2][k], pixels[3][k]];
                *value = bilinear(around, fractions[0][k], fractions[1][k]);
            }
        }
    }

    /// The values of the pixels nearest to places along a line, counted from its own first pixel, the first at `start` and each `step` further than
    /// the one before; 0 outside.
    pub fn nearest_along(&self, start: Point2<f64>, step: Vector2<f64>) -> impl Iterator<Item = f32> {
        let (mut x, mut y) = (fixed(start.x + 0.5), fixed(start.y + 0.5));
        let (dx, dy) = (fixed(step.x), fixed(step.y));
        std::iter::repeat_with(move || {
            let (column, row) = ((x >> FIXED_POINT_BITS) as usize, (y >> FIXED_POINT_BITS) as usize);
            (x, y) = (x + dx, y + dy);
            let is_inside = column < self.width && row < self.height;
            if is_inside { self.data[row * self.width + column] } else { 0.0 }
        })
    }

    /// Whether there are pixels on all sides of a place.
    fn surrounds(&self, at: &Point2<f64>) -> bool {
        at.x >= 0.0 && at.y >= 0.0 && at.x < self.width as f64 - 1.0 && at.y < self.height as f64 - 1.0
    }

    /// [`sample`](Self::sample) where all four pixels around are known to be there.
    #[inline]
    fn sample_inside(&self, at: &Point2<f64>) -> f32 {
        let (x, y) = (at.x as usize, at.y as usize);
        bilinear(self.around(x, y), (at.x - x as f64) as f32, (at.y - y as f64) as f32)
    }

    /// Its own pixel (x, y), and those right of it, below it, and both.
    #[inline]
    fn around(&self, x: usize, y: usize) -> [f32; 4] {
        let (first, width) = (y * self.width + x, self.width);
        let pixels = &self.data[first..first + width + 2];
        [pixels[0], pixels[1], pixels[width], pixels[width + 1]]
    }

    /// The rectangle around a region of this whole picture.
    #[cfg(test)]
    pub fn cropped(&self, around: &Region) -> Self {
        let (x, y) = around.bounds();
        let first = Vector2::new(x.start as f64, y.start as f64);
        let (data, hidden) = (cropped(&self.data, self.width, &x, &y), cropped(&self.hidden, self.width, &x, &y));
        Self { width: x.len(), height: y.len(), first, data, hidden }
    }

    /// The picture made `FACTOR` times smaller, each pixel the mean of a block.
    ///
    /// The centre of block (x, y) is at pixel `FACTOR * x + (FACTOR - 1) / 2` of this picture.
    pub fn shrunk<const FACTOR: usize>(&self) -> Self {
        let (width, height) = (self.width / FACTOR, self.height / FACTOR);
        let scale = 1.0 / (FACTOR * FACTOR) as f32;
        let mut data = vec![0.0; width * height];
        for (y, row) in data.chunks_exact_mut(width.max(1)).enumerate() {
            for line in 0..FACTOR {
                let source = &self.data[(y * FACTOR + line) * self.width..][..width * FACTOR];
                for (value, block) in row.iter_mut().zip(source.as_chunks::<FACTOR>().0) {
                    *value += block.iter().sum::<f32>() * scale;
                }
            }
        }
        Self::new(width, height, data)
    }

    /// The picture, whose margins are 0, blurred by a Gaussian of this σ, px.
    pub fn blurred(&self, sigma_px: f32) -> Self {
        let reach = (KERNEL_REACH * sigma_px).ceil() as usize;
        let mut kernel: Vec<f32> = (0..=reach).map(|k| (-0.5 * (k as f32 / sigma_px).powi(2)).exp()).collect();
        let sum = kernel[0] + 2.0 * kernel[1..].iter().sum::<f32>();
        kernel.iter_mut().for_each(|weight| *weight /= sum);
        let (width, height) = (self.width, self.height);
        let row = |y: usize| &self.data[y * width..][..width];
        let filled: Vec<Range<usize>> = (0..height).map(|y| filled(row(y))).collect();
        let mut data = vec![0.0; width * height];
        let mut line = vec![0.0; width];
        let add = |to: &mut [f32], from: &[f32], weight: f32| {
            to.iter_mut().zip(from).for_each(|(to, from)| *to += weight * from);
        };
        for (y, blurred) in data.chunks_exact_mut(width.max(1)).enumerate() {
            let rows = y.saturating_sub(reach)..(y + reach + 1).min(height);
            let columns = filled[rows.clone()].iter().fold(0..0, |all, columns| joined(&all, columns));
            if columns.is_empty() {
                continue;
            }
            for other in rows {
                let columns = filled[other].clone();
                add(&mut line[columns.clone()], &row(other)[columns], kernel[other.abs_diff(y)]);
            }
            add(&mut blurred[columns.clone()], &line[columns.clone()], kernel[0]);
            let line_within = &line[columns.clone()];
            for (k, &weight) in kernel.iter().enumerate().skip(1) {
                let to_the_left = columns.start.saturating_sub(k);
                let cut = k - (columns.start - to_the_left);
                add(&mut blurred[to_the_left..], &line_within[cut.min(line_within.len())..], weight);
                add(blurred.get_mut(columns.start + k..).unwrap_or_default(), line_within, weight);
            }
            line[columns].fill(0.0);
        }
        Self { data, hidden: self.hidden.clone(), ..*self }
    }

    /// An estimate of the pixel noise σ within a region, robust against everything that is not noise.
    ///
    /// Source: J. Immerkær, "Fast Noise Variance Estimation", Computer Vision and Image Understanding 64, 1996: the difference of two
    /// Laplacians removes all structure that is locally linear. Here the median replaces the mean, so that edges do not count.
    pub fn noise(&self, within: &Region) -> f64 {
        let (left, top) = (self.first.x as usize, self.first.y as usize);
        let own = |v: usize, first: usize| v.saturating_sub(first);
        let rows = within.rows().step_by(NOISE_STRIDE);
        let rows = rows.map(|(row, columns)| (own(row, top), own(columns.start, left)..own(columns.end, left)));
        noise_of(rows.flat_map(|(row, columns)| self.laplacians(row, columns)).collect())
    }

    /// The [`laplacian`] at some of the own pixels of a row.
    fn laplacians(&self, row: usize, columns: Range<usize>) -> impl Iterator<Item = f32> {
        let is_inside = row > 0 && row + 1 < self.height;
        let columns = columns.start + 1..columns.end.min(self.width).saturating_sub(1);
        columns.step_by(NOISE_STRIDE).filter(move |_| is_inside).map(move |x| {
            let line = |row: usize| std::array::from_fn(|k| self.data[row * self.width + x - 1 + k]);
            laplacian([row - 1, row, row + 1].map(line))
        })
    }
}

/// The magnitude of the difference of two Laplacians in the middle of three lines of three pixels.
pub fn laplacian([above, here, below]: [[f32; 3]; 3]) -> f32 {
    let corners = above[0] + above[2] + below[0] + below[2];
    (corners - 2.0 * (above[1] + here[0] + here[2] + below[1]) + 4.0 * here[1]).abs()
}

/// The pixel noise σ of a picture with these magnitudes of its [`laplacian`].
pub fn noise_of(mut laplacians: Vec<f32>) -> f64 {
    SD_BY_MAD * f64::from(median(&mut laplacians)) / NOISE_MASK_NORM
}

/// The columns of two ranges, and those between.
fn joined(a: &Range<usize>, b: &Range<usize>) -> Range<usize> {
    match (a.is_empty(), b.is_empty()) {
        (true, _) => b.clone(),
        (_, true) => a.clone(),
        _ => a.start.min(b.start)..a.end.max(b.end),
    }
}

/// A number of pixels in units of [`FIXED_POINT`].
fn fixed(v: f64) -> i64 {
    (v / FIXED_POINT) as i64
}

/// The columns of a row from the first that is not 0 to the last, give or take [`LANES`].
fn filled(row: &[f32]) -> Range<usize> {
    let is_filled = |values: &[f32]| values.iter().fold(0, |bits, value| bits | value.to_bits()) != 0;
    let Some(first) = row.chunks(LANES).position(is_filled) else { return 0..0 };
    let last = row.chunks(LANES).rposition(is_filled).unwrap_or(first);
    first * LANES..((last + 1) * LANES).min(row.len())
}

/// Bilinear interpolation between four pixels, see [`Plane::around`], at the fractions fx and fy of a pixel right of and below the first.
#[inline]
fn bilinear([above, above_right, below, below_right]: [f32; 4], fx: f32, fy: f32) -> f32 {
    let top = above * (1.0 - fx) + above_right * fx;
    let bottom = below * (1.0 - fx) + below_right * fx;
    top * (1.0 - fy) + bottom * fy
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, Normal};

    /// A picture whose values are a plane, which bilinear interpolation gives exactly.
    fn ramp(width: usize, height: usize) -> Plane {
        let value = |k: usize| 0.3 * (k % width) as f32 - 0.2 * (k / width) as f32;
        Plane::new(width, height, (0..width * height).map(value).collect())
    }

    proptest! {
        #[test]
        fn a_ramp_is_sampled_exactly_by_point_and_by_profile(
            (x, y) in (1.0..20.0f64, 1.0..20.0f64),
            (dx, dy) in (-0.5..0.5f64, -0.5..0.5f64),
        ) {
            let plane = ramp(40, 40);
            let (start, step) = (Point2::new(x + 10.0, y + 10.0), Vector2::new(dx, dy));
            let mut profile = [[0.0; LANES]; 2];
            plane.profile(&start, step, &mut profile);
            for (k, &value) in profile.as_flattened().iter().enumerate() {
                let at = start + step * k as f64;
                let expected = 0.3 * at.x - 0.2 * at.y;
                prop_assert!((f64::from(value) - expected).abs() < 2e-5);
                prop_assert!((f64::from(plane.sample(&at)) - expected).abs() < 2e-5);
            }
        }
    }

    #[test]
    fn a_block_of_a_shrunk_picture_is_the_mean_at_its_centre() {
        let small = ramp(40, 24).shrunk::<4>();
        assert_eq!((small.width, small.height), (10, 6));
        // Block (3, 2) has its centre at pixel (13.5, 9.5).
        assert!((small.get(3, 2) - (0.3 * 13.5 - 0.2 * 9.5)).abs() < 1e-5);
    }

    #[test]
    fn along_a_line_the_nearest_pixels_are_found_and_nothing_outside() {
        let plane = Plane::new(3, 2, vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        let along = |x: f64, y: f64, dx: f64, dy: f64| -> Vec<f32> {
            plane.nearest_along(Point2::new(x, y), Vector2::new(dx, dy)).take(4).collect()
        };
        assert_eq!(along(-1.4, 0.2, 1.0, 0.0), [0.0, 1.0, 2.0, 3.0]);
        assert_eq!(along(2.4, 1.4, -0.8, -0.5), [6.0, 6.0, 2.0, 1.0]);
        assert_eq!(along(1.0, 1.0, 0.0, 1.0), [5.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn a_blurred_point_is_a_gaussian() {
        const SIGMA: f32 = 2.0;
        let mut plane = Plane::new(31, 31, vec![0.0; 31 * 31]);
        plane.data[15 * 31 + 15] = 1.0;
        let blurred = plane.blurred(SIGMA);
        assert!((blurred.data.iter().sum::<f32>() - 1.0).abs() < 1e-5);
        let gaussian = |x: f32, y: f32| {
            (-(x * x + y * y) / (2.0 * SIGMA * SIGMA)).exp() / (2.0 * std::f32::consts::PI * SIGMA * SIGMA)
        };
        for (x, y) in [(0, 0), (1, 0), (2, 3), (-4, 1)] {
            let value = blurred.get(15 + x, 15 + y);
            // Cutting the kernel at 3σ raises it by 0.6 %.
            assert!((value / gaussian(x as f32, y as f32) - 1.0).abs() < 0.01, "{x} {y}: {value}");
        }
    }

    #[test]
    fn noise_is_found_on_a_ramp_with_a_grid_of_lines() {
        const SIGMA: f64 = 0.02;
        let mut random = StdRng::seed_from_u64(5);
        let noise = Normal::new(0.0, SIGMA).unwrap();
        let mut plane = ramp(400, 400);
        for (k, value) in plane.data.iter_mut().enumerate() {
            let is_line = (k % 400) % 20 == 0 || (k / 400) % 20 == 0;
            *value = *value * 0.01 - if is_line { 0.5 } else { 0.0 } + noise.sample(&mut random) as f32;
        }
        let found = plane.noise(&Region::whole(400, 400));
        // Lines are near 28 % of the pixels, whose responses are all above the median: the 0.69 quantile of |N|, 1.5 times it.
        assert!(found > SIGMA && found < 1.8 * SIGMA, "{found}");
        let clean = Plane::new(400, 400, plane.data.iter().map(|_| noise.sample(&mut random) as f32).collect());
        // 3,136 samples; the median of |N| scatters by 0.787 σ/√n of the mask's response, 2 % of σ.
        assert!((clean.noise(&Region::whole(400, 400)) / SIGMA - 1.0).abs() < 0.06);
    }

    #[test]
    fn a_region_contains_what_lies_nearer_to_the_same_line() {
        let line = || (0..50).map(|k| Point2::new(30.0 + f64::from(k), 20.0 + 0.5 * f64::from(k)));
        let (near, far) = (Region::along(line(), 5.0, (120, 90)), Region::along(line(), 8.0, (120, 90)));
        assert!(far.contains(&near) && !near.contains(&far));
        assert_eq!(far.bounds(), (22..87, 12..53));
    }
}
