//! How unlike the printed sheet each part of a picture is, by its colours.
//!
//! The picture is looked at in cells. A smooth surface is taken out of each channel; what is left of the sheet's cells scatters about a mean
//! colour with a covariance, and a cell's squared distance from it, over that of a body, is a number between 0 and 1.

use crate::camera::Frame;
use crate::measure::image::plane::Plane;
use crate::measure::target::PictureRegion;
use crate::statistics::order::{mad_scale, median};
use crate::statistics::robust::{Irls, Loss};
use nalgebra::{DMatrix, DVector, Matrix3, Point2, Vector2, Vector3, Vector6};
use rayon::prelude::*;

/// The squared distance from the sheet's colours from which on a cell is unlike the sheet.
///
/// Derived: a χ² of three degrees of freedom exceeds 9 in 3 of 100 cells.
const UNLIKE_CHI2: f64 = 9.0;
/// The multiple of the median squared distance beyond which a cell is not asked what the sheet's colours are.
///
/// Derived: a χ² of three degrees of freedom exceeds 6 times its median in 3 of 1000 cells.
const MOST_MEDIANS: f64 = 6.0;
/// The share of the sheet that a snake and its holder cover.
///
/// Convention: in the pictures of the book 3 to 10 %.
const BODY_SHARE: f64 = 0.06;
/// Least variance of a channel about the sheet's colours, grey levels².
///
/// Derived: that of rounding to whole levels, and as much noise of a mean over a cell.
const LEAST_VARIANCE: f64 = 0.2;
/// What deviates from the surface of a channel's brightness by more than this many standard deviations is not asked for it, the least standard
/// deviation (grey levels), and the rounds of its fit.
///
/// Convention: 2.5 keeps 98.8 % of normal errors.
const SURFACE_LIMIT: f64 = 2.5;
const LEAST_SURFACE_SCALE: f64 = 0.2;
const SURFACE_ROUNDS: usize = 6;
/// Rounds in which the cells that are the sheet's and its colours follow each other.
///
/// Convention: a cap; they settle sooner.
const COLOUR_ROUNDS: usize = 4;
/// How unlike the sheet the cells of a picture are, 0 to 1.
pub struct Unlike {
    pub cell_px: f64,
    pub width: usize,
    pub height: usize,
    /// 1 where a cell shows the sheet's part of the picture, and there how unlike the sheet it is, and its square; 0 elsewhere.
    pub moments: [Vec<f32>; 3],
}

impl Unlike {
    /// Looks at a picture in cells of this side.
    pub fn of(frame: &Frame, cell_px: f64, region: &PictureRegion) -> Self {
        let channels = (0..frame.channels).map(|channel| cell_means(frame, channel, cell_px)).collect::<Vec<_>>();
        let (width, height) = (channels[0].width, channels[0].height);
        let middle = |k: usize| middle_of(cell_px, (k % width) as i64, (k / width) as i64);
        let sheet: Vec<usize> = (0..width * height).filter(|&k| region.contains(&middle(k))).collect();
        let residuals: Vec<Vec<f64>> = channels.par_iter().map(|plane| minus_surface(plane, &sheet)).collect();
        let distances = distances(&residuals, &sheet);
        let middle_chi2 = middle_chi2(&distances);
        let mut moments: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; width * height]);
        for (&k, distance) in sheet.iter().zip(&distances) {
            let unlike = (distance / (distance + middle_chi2)) as f32;
            [1.0, unlike, unlike * unlike].into_iter().zip(&mut moments).for_each(|(value, moment)| moment[k] = value);
        }
        Self { cell_px, width, height, moments }
    }

    /// The middle of a cell, px.
    pub fn middle(&self, x: i64, y: i64) -> Point2<f64> {
        middle_of(self.cell_px, x, y)
    }

    /// The cell of a pixel.
    pub fn cell_of(&self, pixel: &Point2<f64>) -> [i64; 2] {
        [pixel.x, pixel.y].map(|at| ((at + 0.5) / self.cell_px).floor() as i64)
    }

    /// The moments at a pixel.
    pub fn at(&self, pixel: &Point2<f64>) -> [f32; 3] {
        let [x, y] = self.cell_of(pixel);
        self.cell(x, y)
    }

    /// The moments of a cell.
    pub fn cell(&self, x: i64, y: i64) -> [f32; 3] {
        let is_inside = x >= 0 && y >= 0 && x < self.width as i64 && y < self.height as i64;
        if is_inside {
            self.moments.each_ref().map(|moment| moment[y as usize * self.width + x as usize])
        } else {
            [0.0; 3]
        }
    }
}

/// The middle of a cell of this size, px.
fn middle_of(cell_px: f64, x: i64, y: i64) -> Point2<f64> {
    Point2::new(x as f64 + 0.5, y as f64 + 0.5) * cell_px - Vector2::new(0.5, 0.5)
}

/// The mean over the cells of one channel.
fn cell_means(frame: &Frame, channel: usize, cell_px: f64) -> Plane {
    let count = |length: u32| ((f64::from(length) / cell_px) as usize).max(1);
    let (width, height) = (count(frame.width), count(frame.height));
    let part = |k: usize| {
        (k as f64 * cell_px) as u32..(((k + 1) as f64 * cell_px) as u32).max((k as f64 * cell_px) as u32 + 1)
    };
    let mean = |k: usize| {
        let (columns, rows) = (part(k % width), part(k / width));
        let (mut sum, mut pixels) = (0.0, 0.0);
        for y in rows.filter(|y| *y < frame.height) {
            for x in columns.clone().filter(|x| *x < frame.width) {
                sum += frame.get(x, y, channel);
                pixels += 1.0;
            }
        }
        sum / f32::max(pixels, 1.0)
    };
    Plane::new(width, height, (0..width * height).into_par_iter().map(mean).collect())
}

/// What some cells of a channel leave of a quadratic surface, fitted to the majority of them.
fn minus_surface(plane: &Plane, cells: &[usize]) -> Vec<f64> {
    let level = f64::from(median(&mut cells.iter().map(|&k| plane.data[k]).collect::<Vec<f32>>()));
    let terms = |k: usize| {
        let along = |at: usize, length: usize| at as f64 / length as f64 - 0.5;
        let (x, y) = (along(k % plane.width, plane.width), along(k / plane.width, plane.height));
        Vector6::new(1.0, x, y, x * x, x * y, y * y)
    };
    let stride = (cells.len() / 2000).max(1);
    let used: Vec<usize> = cells.iter().copied().step_by(stride).collect();
    let design = DMatrix::from_fn(used.len(), 6, |row, column| terms(used[row])[column]);
    let offset = DVector::from_iterator(used.len(), used.iter().map(|&k| level - f64::from(plane.data[k])));
    let irls = Irls {
        loss: Loss::Talwar(SURFACE_LIMIT),
        least_scale: LEAST_SURFACE_SCALE,
        rounds: SURFACE_ROUNDS,
        tolerance: 0.0,
    };
    let surface = irls.fit(&design, &offset, used.len()).map(|fit| fit.parameters);
    let at = |k: usize| {
        surface.as_ref().map_or(0.0, |surface| surface.dot(&DVector::from_column_slice(terms(k).as_slice())))
    };
    cells.iter().map(|&k| f64::from(plane.data[k]) - level - at(k)).collect()
}

/// Squared distances of cells from the sheet's colours, in units of the covariance of those that are the sheet's.
fn distances(residuals: &[Vec<f64>], cells: &[usize]) -> Vec<f64> {
    // A colour has up to three channels; what a picture lacks of them is zero in all cells.
    let colour = |k: usize| Vector3::from_fn(|c, _| residuals.get(c).map_or(0.0, |channel| channel[k]));
    let least = Matrix3::from_diagonal_element(LEAST_VARIANCE);
    let scales = Vector3::from_fn(|c, _| residuals.get(c).map_or(0.0, |r| mad_scale(r.iter().copied()).powi(2)));
    let mut covariance = Matrix3::from_diagonal(&scales) + least;
    let mut mean = Vector3::zeros();
    let mut distances = vec![0.0; cells.len()];
    for _ in 0..COLOUR_ROUNDS {
        let Some(information) = covariance.try_inverse() else { break };
        for (k, distance) in distances.iter_mut().enumerate() {
            let off = colour(k) - mean;
            *distance = off.dot(&(information * off));
        }
        let limit = MOST_MEDIANS * median(&mut distances.clone());
        let kept: Vec<Vector3<f64>> = (0..cells.len()).filter(|&k| distances[k] < limit).map(colour).collect();
        let count = (kept.len() as f64).max(1.0);
        mean = kept.iter().sum::<Vector3<f64>>() / count;
        covariance = kept.iter().map(|c| (c - mean) * (c - mean).transpose()).sum::<Matrix3<f64>>() / count + least;
    }
    distances
}

/// The squared distance at which a cell is half unlike the sheet: half of what the least alike cells have, so that a shadow is less so than the
/// body that throws it.
fn middle_chi2(distances: &[f64]) -> f64 {
    let mut sorted = distances.to_vec();
    sorted.sort_by(f64::total_cmp);
    let least_alike = &sorted[((1.0 - BODY_SHARE) * sorted.len() as f64) as usize..];
    let mean = least_alike.iter().sum::<f64>() / (least_alike.len() as f64).max(1.0);
    UNLIKE_CHI2.max(0.25 * mean)
}
