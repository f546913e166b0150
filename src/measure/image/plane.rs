//! A single-channel picture with real values, and how it is sampled.

use nalgebra::{Point2, Vector2};
use std::ops::Range;

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

    /// What lies within `reach_px` of a line's points to the side, above or below, in a picture this large.
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
            for row in &mut rows[range(point.y, height)] {
                let joined = row.start.min(columns.start)..row.end.max(columns.end);
                *row = if row.start == row.end { columns.clone() } else { joined };
            }
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
        self.rows().fold((0..0, 0..0), |(x, y), (row, columns)| {
            let joined = x.start.min(columns.start)..x.end.max(columns.end);
            if y.is_empty() { (columns, row..row + 1) } else { (joined, y.start..row + 1) }
        })
    }
}

impl Plane {
    /// A picture of these values, row by row.
    pub fn new(width: usize, height: usize, data: Vec<f32>) -> Self {
        Self { width, height, first: Vector2::zeros(), data }
    }

    /// The value of one of its own pixels; positions outside are those of the nearest border pixel.
    #[inline]
    pub fn get(&self, x: i64, y: i64) -> f32 {
        let x = x.clamp(0, self.width as i64 - 1) as usize;
        let y = y.clamp(0, self.height as i64 - 1) as usize;
        self.data[y * self.width + x]
    }

    /// Bilinear interpolation at a place of the picture; pixel centres are at integers.
    #[inline]
    pub fn sample(&self, at: &Point2<f64>) -> f32 {
        self.sample_own(&(at - self.first))
    }

    /// The same at a place counted from its own first pixel.
    fn sample_own(&self, at: &Point2<f64>) -> f32 {
        if self.surrounds(at) {
            return self.sample_inside(at);
        }
        let (x, y) = (at.x.floor(), at.y.floor());
        let (fx, fy) = ((at.x - x) as f32, (at.y - y) as f32);
        let (x, y) = (x as i64, y as i64);
        let top = self.get(x, y) * (1.0 - fx) + self.get(x + 1, y) * fx;
        let bottom = self.get(x, y + 1) * (1.0 - fx) + self.get(x + 1, y + 1) * fx;
        top * (1.0 - fy) + bottom * fy
    }

    /// Values along a line of the picture, the first at `start` and each `step` further than the one before.
    pub fn profile(&self, start: &Point2<f64>, step: Vector2<f64>, into: &mut [f32]) {
        let start = start - self.first;
        let at = |k: usize| start + step * k as f64;
        if !self.surrounds(&start) || !self.surrounds(&at(into.len().saturating_sub(1))) {
            into.iter_mut().enumerate().for_each(|(k, value)| *value = self.sample_own(&at(k)));
            return;
        }
        // Whole numbers of this part of a pixel: twice as quick, and as exact.
        const PART: f64 = 1.0 / (1 << 24) as f64;
        let fixed = |v: f64| (v / PART) as i64;
        let (mut x, mut y) = (fixed(start.x), fixed(start.y));
        let (dx, dy) = (fixed(step.x), fixed(step.y));
        let share = |v: i64| (v & 0xff_ffff) as f32 * PART as f32;
        for value in into {
            *value = self.mixed((x >> 24) as usize, (y >> 24) as usize, share(x), share(y));
            (x, y) = (x + dx, y + dy);
        }
    }

    /// Whether there are pixels on all sides of a place.
    fn surrounds(&self, at: &Point2<f64>) -> bool {
        at.x >= 0.0 && at.y >= 0.0 && at.x < self.width as f64 - 1.0 && at.y < self.height as f64 - 1.0
    }

    /// [`sample`](Self::sample) where all four pixels around are known to be there.
    #[inline]
    fn sample_inside(&self, at: &Point2<f64>) -> f32 {
        let (x, y) = (at.x as usize, at.y as usize);
        self.mixed(x, y, (at.x - x as f64) as f32, (at.y - y as f64) as f32)
    }

    /// The value these shares of a pixel right of and below its own pixel (x, y).
    #[inline]
    fn mixed(&self, x: usize, y: usize, fx: f32, fy: f32) -> f32 {
        let first = y * self.width + x;
        let (above, below) = (&self.data[first..first + 2], &self.data[first + self.width..first + self.width + 2]);
        let top = above[0] * (1.0 - fx) + above[1] * fx;
        let bottom = below[0] * (1.0 - fx) + below[1] * fx;
        top * (1.0 - fy) + bottom * fy
    }

    /// The picture made `factor` times smaller, each pixel the mean of a block.
    ///
    /// The centre of block (x, y) is at pixel `factor * x + (factor - 1) / 2` of this picture.
    pub fn shrunk(&self, factor: usize) -> Self {
        let (width, height) = (self.width / factor, self.height / factor);
        let scale = 1.0 / (factor * factor) as f32;
        let mut data = vec![0.0; width * height];
        for (y, row) in data.chunks_exact_mut(width.max(1)).enumerate() {
            for line in 0..factor {
                let source = &self.data[(y * factor + line) * self.width..][..width * factor];
                for (value, block) in row.iter_mut().zip(source.chunks_exact(factor)) {
                    *value += block.iter().sum::<f32>() * scale;
                }
            }
        }
        Self::new(width, height, data)
    }

    /// The picture, whose margins are 0, blurred by a Gaussian of this σ, px.
    pub fn blurred(&self, sigma_px: f32) -> Self {
        let reach = (3.0 * sigma_px).ceil() as usize;
        let mut kernel: Vec<f32> = (0..=reach).map(|k| (-0.5 * (k as f32 / sigma_px).powi(2)).exp()).collect();
        let sum = kernel[0] + 2.0 * kernel[1..].iter().sum::<f32>();
        kernel.iter_mut().for_each(|weight| *weight /= sum);
        let (width, height) = (self.width, self.height);
        let mut data = vec![0.0; width * height];
        let mut line = vec![0.0; width];
        let add = |to: &mut [f32], from: &[f32], weight: f32| {
            to.iter_mut().zip(from).for_each(|(to, from)| *to += weight * from);
        };
        for (y, row) in data.chunks_exact_mut(width.max(1)).enumerate() {
            line.fill(0.0);
            for other in y.saturating_sub(reach)..(y + reach + 1).min(height) {
                add(&mut line, &self.data[other * width..][..width], kernel[other.abs_diff(y)]);
            }
            add(row, &line, kernel[0]);
            for (k, &weight) in kernel.iter().enumerate().take(width).skip(1) {
                add(&mut row[k..], &line, weight);
                add(row, &line[k..], weight);
            }
        }
        Self { data, ..*self }
    }

    /// An estimate of the pixel noise σ within a region, robust against everything that is not noise.
    ///
    /// Source: J. Immerkær, "Fast Noise Variance Estimation", 1996: the difference of two Laplacians kills all structure
    /// that is locally linear; the median instead of the mean survives the edges.
    pub fn noise(&self, within: &Region) -> f64 {
        const STRIDE: usize = 7;
        let (left, top) = (self.first.x as usize, self.first.y as usize);
        let mut responses: Vec<f32> = Vec::new();
        for (row, columns) in within.rows().step_by(STRIDE) {
            let y = row.saturating_sub(top);
            let (from, to) = (columns.start.saturating_sub(left), columns.end.saturating_sub(left));
            if y == 0 || y + 1 >= self.height {
                continue;
            }
            for x in (from + 1..to.min(self.width).saturating_sub(1)).step_by(STRIDE) {
                let line = |dy: usize| &self.data[(y + dy - 1) * self.width + x - 1..][..3];
                let (above, here, below) = (line(0), line(1), line(2));
                let laplacians = above[0] + above[2] + below[0] + below[2]
                    - 2.0 * (above[1] + here[0] + here[2] + below[1])
                    + 4.0 * here[1];
                responses.push(laplacians.abs());
            }
        }
        // The mask's norm is 6; the median of |N(0, σ)| is 0.6745 σ.
        f64::from(median(&mut responses)) / (6.0 * 0.6745)
    }
}

/// The median of some values (0 for none); reorders them.
pub fn median(values: &mut [f32]) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}
