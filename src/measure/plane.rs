//! A single-channel picture with real values, and how it is sampled.

use nalgebra::{Point2, Vector2};
use std::ops::Range;

/// A grey picture of `f32`, row by row.
#[derive(Debug, Clone)]
pub struct Plane {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width * height` values.
    pub data: Vec<f32>,
}

/// A part of a picture.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Region {
    /// Columns.
    pub x: Range<usize>,
    /// Rows.
    pub y: Range<usize>,
}

impl Region {
    /// All of a picture.
    pub fn whole(width: u32, height: u32) -> Self {
        Self { x: 0..width as usize, y: 0..height as usize }
    }

    /// What lies within bounds (x0, y0, x1, y1; px) grown by a margin, of a picture this large.
    pub fn around((x0, y0, x1, y1): (f64, f64, f64, f64), margin_px: f64, size: (u32, u32)) -> Self {
        let range = |from: f64, to: f64, most: u32| {
            let start = (from - margin_px).clamp(0.0, f64::from(most)) as usize;
            start..((to + margin_px).clamp(0.0, f64::from(most)).ceil() as usize).max(start)
        };
        Self { x: range(x0, x1, size.0), y: range(y0, y1, size.1) }
    }

    /// Whether all of another region is in it.
    pub fn contains(&self, other: &Self) -> bool {
        let holds = |a: &Range<usize>, b: &Range<usize>| a.start <= b.start && b.end <= a.end;
        holds(&self.x, &other.x) && holds(&self.y, &other.y)
    }
}

impl Plane {
    /// The value of one pixel; positions outside are those of the nearest border pixel.
    pub fn get(&self, x: i64, y: i64) -> f32 {
        let x = x.clamp(0, self.width as i64 - 1) as usize;
        let y = y.clamp(0, self.height as i64 - 1) as usize;
        self.data[y * self.width + x]
    }

    /// Bilinear interpolation; pixel centres are at integers.
    pub fn sample(&self, at: &Point2<f64>) -> f32 {
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

    /// Values along a line, the first at `start` and each `step` further than the one before.
    pub fn profile(&self, start: &Point2<f64>, step: Vector2<f64>, into: &mut [f32]) {
        let at = |k: usize| start + step * k as f64;
        let last = into.len().saturating_sub(1);
        let inside = self.surrounds(start) && self.surrounds(&at(last));
        for (k, value) in into.iter_mut().enumerate() {
            *value = if inside { self.sample_inside(&at(k)) } else { self.sample(&at(k)) };
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
        let (fx, fy) = ((at.x - x as f64) as f32, (at.y - y as f64) as f32);
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
        Self { width, height, data }
    }

    /// An estimate of the pixel noise σ within a region, robust against everything that is not noise.
    ///
    /// Source: J. Immerkær, "Fast Noise Variance Estimation", 1996: the difference of two Laplacians kills all structure
    /// that is locally linear; the median instead of the mean survives the edges.
    pub fn noise(&self, within: &Region) -> f64 {
        const STRIDE: usize = 5;
        let mut responses: Vec<f32> = Vec::new();
        for y in (within.y.start.max(1)..within.y.end.min(self.height.saturating_sub(1))).step_by(STRIDE) {
            for x in (within.x.start.max(1)..within.x.end.min(self.width.saturating_sub(1))).step_by(STRIDE) {
                let at = |dx: i64, dy: i64| self.data[(y as i64 + dy) as usize * self.width + (x as i64 + dx) as usize];
                let laplacians = at(-1, -1) + at(1, -1) + at(-1, 1) + at(1, 1)
                    - 2.0 * (at(0, -1) + at(-1, 0) + at(1, 0) + at(0, 1))
                    + 4.0 * at(0, 0);
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
