//! What of a picture is unlike the grid target, of which nothing is known but that it fills most of the picture.
//!
//! Without its pattern the target is a smooth surface in every channel: a quadratic polynomial in the picture's coordinates, fitted to the
//! majority of the pixels. The two colours of a checkerboard are two such surfaces, and a border between squares is a mixture
//! of them.

use crate::camera::Frame;
use crate::measure::image::plane::Plane;
use crate::statistics::order::{mad_scale, median};
use crate::statistics::robust::{Irls, Loss};
use image::{GrayImage, Luma};
use imageproc::contrast::otsu_level;
use nalgebra::{DMatrix, DVector, Vector6};
use rayon::prelude::*;

/// Side of the blocks of pixels that are looked at as one.
///
/// Convention: a limit of time; a holder is ten blocks wide and more.
pub const BLOCK: usize = 4;
/// What deviates from the surface by more than this many standard deviations is not the target's, and the least standard
/// deviation, grey levels.
///
/// Convention: 2.5 keeps 98.8 % of normal errors; an eight-bit picture's rounding alone is 0.29 levels, and less is no noise.
const SURFACE_LIMIT: f64 = 2.5;
const LEAST_SURFACE_SCALE: f64 = 0.2;
/// Rounds of its fit; of the pixels every so manieth is used.
///
/// Convention: limits of time; thousands of blocks are left for six parameters.
const SURFACE_ROUNDS: usize = 6;
const SURFACE_STRIDE: usize = 7;
/// Least scale, grey levels, in whose units channels' deviations are added.
///
/// Convention: that of rounding, as above.
const LEAST_CHANNEL_SCALE: f32 = 0.5;
/// Rounds of two means (k-means with k = 2 along one direction), and of assigning pixels to two surfaces.
///
/// Convention: caps; both settle sooner.
const TWO_MEANS_ROUNDS: usize = 20;
const TWO_SURFACES_ROUNDS: usize = 3;
/// The shares of the picture that either colour of a checkerboard may have, and the least share of the variance that two colours
/// explain.
///
/// Derived: each colour has half of the target, and the snake and its shadow cover far less than a quarter of the picture. Of values
/// spread evenly two classes explain three quarters of the variance, of noise or shading less (2/π of a normal distribution).
const SQUARES_SHARE: std::ops::Range<f64> = 0.25..0.75;
const SQUARES_EXPLAINED: f64 = 0.75;

/// The colours of a picture, channel by channel, or what the two colours of a checkerboard leave unexplained of them.
pub struct Colours {
    pub planes: Vec<Plane>,
    pub is_without_squares: bool,
}

impl Colours {
    /// How a picture may be looked at, most promising first: where it has a checkerboard, without its colours; and as it is.
    pub fn of(frame: &Frame) -> Vec<Self> {
        let planes: Vec<Plane> = (0..frame.channels).map(|c| channel(frame, c)).collect();
        let without = Squares::find(&planes).map(|squares| squares.unexplained(&planes));
        let without = without.map(|planes| Self { planes, is_without_squares: true });
        without.into_iter().chain([Self { planes, is_without_squares: false }]).collect()
    }

    /// Blocks whose colour, as a mean over `reach` blocks around them, is unlike that of the target, a smooth surface that fills most
    /// of the picture.
    pub fn unlike_target(&self, reach: i64) -> GrayImage {
        let channels: Vec<Plane> =
            self.planes.par_iter().map(|plane| smoothed(&plane.shrunk::<BLOCK>(), reach)).collect();
        let (width, height) = (channels[0].width, channels[0].height);
        let mut distance = vec![0.0_f32; width * height];
        for plane in &channels {
            let residual = minus_smooth_surface(plane);
            let scale = (mad_scale(residual.iter().map(|r| f64::from(*r))) as f32).max(LEAST_CHANNEL_SCALE);
            for (d, r) in distance.iter_mut().zip(&residual) {
                *d += (r / scale).powi(2);
            }
        }
        // The square root of the distance squeezes the range so that neither a black snake nor a highlight rules the threshold.
        let values: Vec<f32> = distance.iter().map(|d| d.sqrt().sqrt()).collect();
        let top = values.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
        let scaled = GrayImage::from_fn(width as u32, height as u32, |x, y| {
            Luma([(values[y as usize * width + x as usize] / top * 255.0) as u8])
        });
        let level = otsu_level(&scaled);
        GrayImage::from_fn(width as u32, height as u32, |x, y| {
            Luma([if scaled.get_pixel(x, y).0[0] > level { 255 } else { 0 }])
        })
    }
}

/// The two colours of a checkerboard, each a smooth surface in every channel.
struct Squares {
    surfaces: [Vec<Vector6<f64>>; 2],
}

impl Squares {
    /// The colours, if the picture has two that each cover much of it. In grey two levels explain all between them.
    fn find(planes: &[Plane]) -> Option<Self> {
        let shrunk: Vec<Plane> = planes.iter().map(|plane| plane.shrunk::<BLOCK>()).collect();
        let count = shrunk.first().map_or(0, |plane| plane.data.len());
        if planes.len() < 2 || count == 0 {
            return None;
        }
        let along = along_main_colour(&shrunk);
        let border = two_means(&along)?;
        let mut is_second: Vec<bool> = along.iter().map(|&v| v > border).collect();
        let fitted = |is_second: &[bool]| Self {
            surfaces: [false, true]
                .map(|class| shrunk.iter().map(|plane| smooth_surface(plane, |k| is_second[k] == class)).collect()),
        };
        for _ in 0..TWO_SURFACES_ROUNDS {
            let squares = fitted(&is_second);
            is_second = (0..count).map(|k| squares.second_share(&shrunk, k) > 0.5).collect();
        }
        Some(fitted(&is_second))
    }

    /// How much of the second colour is in the mixture of both that is nearest to a pixel's, 0 to 1.
    fn second_share(&self, planes: &[Plane], k: usize) -> f64 {
        let terms = terms(&planes[0], k);
        let (mut along, mut length) = (0.0, 0.0);
        for (c, plane) in planes.iter().enumerate() {
            let first = self.surfaces[0][c].dot(&terms);
            let apart = self.surfaces[1][c].dot(&terms) - first;
            along += apart * (f64::from(plane.data[k]) - first);
            length += apart * apart;
        }
        (along / length.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0)
    }

    /// What is left of each pixel's colour without the nearest mixture of both: borders between squares are mixtures.
    fn unexplained(&self, planes: &[Plane]) -> Vec<Plane> {
        let count = planes[0].data.len();
        let shares: Vec<f64> = (0..count).map(|k| self.second_share(planes, k)).collect();
        let left = |c: usize, k: usize| {
            let mixture = self.surfaces[0][c] * (1.0 - shares[k]) + self.surfaces[1][c] * shares[k];
            planes[c].data[k] - mixture.dot(&terms(&planes[c], k)) as f32
        };
        let plane = |c: usize| (0..count).map(|k| left(c, k)).collect();
        (0..planes.len()).map(|c| Plane::new(planes[c].width, planes[c].height, plane(c))).collect()
    }
}

/// How far each pixel's colour, without the smooth surface of its channel, lies along the first principal component of them all.
fn along_main_colour(planes: &[Plane]) -> Vec<f64> {
    let residuals: Vec<Vec<f32>> = planes.iter().map(minus_smooth_surface).collect();
    let count = planes[0].data.len();
    let colour = |k: usize| DVector::from_iterator(residuals.len(), residuals.iter().map(|r| f64::from(r[k])));
    let mean = (0..count).map(colour).sum::<DVector<f64>>() / count as f64;
    let scatter = (0..count).map(|k| colour(k) - &mean).map(|c| &c * c.transpose()).sum::<DMatrix<f64>>();
    let eigen = scatter.symmetric_eigen();
    let direction = eigen.eigenvectors.column(eigen.eigenvalues.imax());
    (0..count).map(|k| direction.dot(&(colour(k) - &mean))).collect()
}

/// The value half way between the means of the two classes that it parts values of mean zero into; `None` where they are not two
/// colours' as a checkerboard has them.
fn two_means(values: &[f64]) -> Option<f64> {
    let count = values.len() as f64;
    let mean_of = |border: f64, above: bool| {
        let class = values.iter().filter(|&&v| (v > border) == above);
        let (sum, number) = class.fold((0.0, 0.0), |(sum, number), v| (sum + v, number + 1.0));
        (sum / f64::max(number, 1.0), number / count)
    };
    let middle = |border: f64| (mean_of(border, true).0 + mean_of(border, false).0) / 2.0;
    let border = (0..TWO_MEANS_ROUNDS).fold(0.0, |border, _| middle(border));
    let ((high, share), (low, _)) = (mean_of(border, true), mean_of(border, false));
    let variance = values.iter().map(|v| v * v).sum::<f64>() / count;
    let explained = share * (1.0 - share) * (high - low).powi(2);
    (SQUARES_SHARE.contains(&share) && explained > SQUARES_EXPLAINED * variance).then_some(border)
}

fn channel(frame: &Frame, c: usize) -> Plane {
    let data = (c..frame.samples.len()).step_by(frame.channels).map(|k| frame.samples.level(k)).collect();
    Plane::new(frame.width as usize, frame.height as usize, data)
}

/// The mean over (2 reach + 1)² blocks.
fn smoothed(plane: &Plane, reach: i64) -> Plane {
    let pass = |plane: &Plane, dx: i64, dy: i64| {
        let (w, h) = (plane.width as i64, plane.height as i64);
        let mean = |x: i64, y: i64| (-reach..=reach).map(|k| plane.get(x + k * dx, y + k * dy)).sum::<f32>();
        let scale = 1.0 / (2 * reach + 1) as f32;
        let data = (0..w * h).map(|k| mean(k % w, k / w) * scale).collect();
        Plane::new(plane.width, plane.height, data)
    };
    pass(&pass(plane, 1, 0), 0, 1)
}

/// What remains of a plane after a quadratic surface, fitted to the majority of it, is taken away.
fn minus_smooth_surface(plane: &Plane) -> Vec<f32> {
    let surface = smooth_surface(plane, |_| true);
    (0..plane.data.len()).map(|k| plane.data[k] - surface.dot(&terms(plane, k)) as f32).collect()
}

/// The terms of a quadratic surface at a plane's pixel; the same for the same place of a plane of another size.
fn terms(plane: &Plane, k: usize) -> Vector6<f64> {
    let along = |at: usize, length: usize| at as f64 / length as f64 - 0.5;
    let (x, y) = (along(k % plane.width, plane.width), along(k / plane.width, plane.height));
    Vector6::new(1.0, x, y, x * x, x * y, y * y)
}

/// The quadratic surface of the majority of some of a plane's pixels, from their median by reweighted least squares.
fn smooth_surface(plane: &Plane, is_asked: impl Fn(usize) -> bool) -> Vector6<f64> {
    let asked: Vec<usize> = (0..plane.data.len()).filter(|&k| is_asked(k)).collect();
    let level = f64::from(median(&mut asked.iter().map(|&k| plane.data[k]).collect::<Vec<f32>>()));
    let used: Vec<usize> = asked.into_iter().step_by(SURFACE_STRIDE).collect();
    let mut surface = Vector6::zeros();
    surface[0] = level;
    let mut design = DMatrix::zeros(used.len(), 6);
    used.iter().enumerate().for_each(|(row, &k)| design.row_mut(row).copy_from(&terms(plane, k).transpose()));
    let offset = DVector::from_iterator(used.len(), used.iter().map(|&k| level - f64::from(plane.data[k])));
    let irls = Irls {
        loss: Loss::Talwar(SURFACE_LIMIT),
        least_scale: LEAST_SURFACE_SCALE,
        rounds: SURFACE_ROUNDS,
        tolerance: 0.0,
    };
    if let Some(fit) = irls.fit(&design, &offset, used.len()) {
        surface += fit.parameters.fixed_rows::<6>(0);
    }
    surface
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(value: impl Fn(f64, f64) -> f64) -> Plane {
        let value = |k: usize| value((k % 96) as f64 / 96.0 - 0.5, (k / 96) as f64 / 64.0 - 0.5) as f32;
        Plane::new(96, 64, (0..96 * 64).map(value).collect())
    }

    #[test]
    fn a_quadratic_surface_is_found_under_an_object_on_a_third_of_it() {
        let light = |x: f64, y: f64| 180.0 + 20.0 * x - 10.0 * y + 15.0 * x * x - 8.0 * x * y + 5.0 * y * y;
        let with_object = plane(|x, y| if x.abs() < 0.15 { 40.0 } else { light(x, y) });
        let surface = smooth_surface(&with_object, |_| true);
        let expected = Vector6::new(180.0, 20.0, -10.0, 15.0, -8.0, 5.0);
        assert!((surface - expected).amax() < 1e-3, "{surface}");
        let left = minus_smooth_surface(&with_object);
        assert!(left.iter().filter(|r| r.abs() > 1.0).count() > 96 * 64 / 4);
    }

    #[test]
    fn two_colours_are_told_from_shading_and_from_noise() {
        // Sums of three even values, of which two classes explain 0.69 of the variance.
        let shading: Vec<f64> = (0..1001).map(|k| f64::from(k % 7 + k % 11 + k % 13) - 14.0).collect();
        assert_eq!(two_means(&shading), None);
        let two: Vec<f64> = (0..1000).map(|k| if k % 2 == 0 { 20.0 } else { -20.0 } + f64::from(k % 7)).collect();
        let border = two_means(&two).unwrap();
        assert!((border - 3.0).abs() < 0.1, "{border}");
        let few: Vec<f64> = (0..1000).map(|k| if k % 10 == 0 { 90.0 } else { -10.0 }).collect();
        assert_eq!(two_means(&few), None, "a tenth of the picture is no checkerboard's colour");
    }

    #[test]
    fn squares_are_explained_by_their_two_colours_and_a_third_colour_is_left() {
        // Squares 8 pixels wide of two colours under a gradient, and an object of another.
        let is_dark = |x: f64, y: f64| (((x + 0.5) * 12.0).floor() + ((y + 0.5) * 8.0).floor()) as i64 % 2 == 0;
        let planes: Vec<Plane> = [(200.0, 60.0, 90.0), (190.0, 70.0, 180.0), (180.0, 80.0, 30.0)]
            .into_iter()
            .map(|(light, dark, object)| {
                plane(|x, y| {
                    let square = if is_dark(x, y) { dark } else { light };
                    if x.abs() < 0.08 { object } else { square * (1.0 + 0.1 * x) }
                })
            })
            .collect();
        let squares = Squares::find(&planes).unwrap();
        let left = squares.unexplained(&planes);
        let size = |k: usize| left.iter().map(|plane| plane.data[k].abs()).fold(0.0, f32::max);
        for k in 0..96 * 64 {
            let is_object = ((k % 96) as f64 / 96.0 - 0.5).abs() < 0.08;
            assert!(if is_object { size(k) > 30.0 } else { size(k) < 3.0 }, "pixel {k}: {}", size(k));
        }
    }
}
