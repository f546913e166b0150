//! Whether a picture keeps hues as sharp as its pixels are.
//!
//! JPEGs, video and the mosaic of most colour sensors keep hues at half of the resolution. What lies between two of them is a repeated or an
//! interpolated hue, so that neighbouring pixels differ in hue by less than those two apart. Of hues that are independent of each other the sum of squared
//! second differences over neighbours is so many times that over pixels two apart:
//!
//! | hues | ratio |
//! | --- | --- |
//! | of each pixel | 1 |
//! | of every second pixel, repeated | 2/6 |
//! | halfway interpolated between | 3/14 |
//! | at a quarter and three quarters, as decoders of JPEGs interpolate | 1/6 |
//!
//! Hues that hang together, as those of a printed sheet do, have a smaller ratio in each case.

use super::appearance::BRIGHTNESS;
use crate::camera::{Frame, Sample, Samples};

/// One pixel of so many in each direction is asked.
///
/// Convention: a prime, so that no pattern of the target is sampled in step, and odd, so that either pixel of a pair is as often met; a megapixel
/// leaves 20,000.
const STRIDE: usize = 7;
/// The ratio above which hues are each pixel's own.
///
/// Derived: 2/6 of repeated ones, and a fifth more for chance: from 2,000 pixels a sum of squares is known to some 5 %.
const SHARP: f64 = 0.4;
/// What rounding to whole levels adds to a squared second difference of the hue, its three parts together, 0 to 255.
///
/// Derived: a twelfth for each channel; 1 + 4 + 1 times for a second difference; and, of channels less their brightness, (Σ 1) − 2 (Σ w) + 3 Σ w² times.
fn rounding() -> f64 {
    let squares: f64 = BRIGHTNESS.iter().map(|w| w * w).sum();
    6.0 / 12.0 * (3.0 - 2.0 + 3.0 * squares)
}

/// Whether the hues of a frame's pixels are their own, along rows as along columns. A grey frame has none, and one whose hues differ by no more than
/// rounding does not tell.
pub fn are_sharp(frame: &Frame) -> bool {
    match &frame.samples {
        _ if frame.channels != BRIGHTNESS.len() => false,
        Samples::Bits8(samples) => of_samples(samples, frame),
        Samples::Bits16(samples) => of_samples(samples, frame),
    }
}

fn of_samples<S: Sample>(samples: &[S], frame: &Frame) -> bool {
    let pixels = samples.as_chunks::<3>().0;
    let (width, height) = (frame.width as usize, frame.height as usize);
    let hue = |pixel: usize| {
        let colour = pixels[pixel].map(|v| f64::from(v.level()));
        let brightness: f64 = colour.iter().zip(BRIGHTNESS).map(|(v, weight)| v * weight).sum();
        colour.map(|v| v - brightness)
    };
    let second_difference2 = |middle: usize, step: usize| {
        let (before, here, after) = (hue(middle - step), hue(middle), hue(middle + step));
        (0..3).map(|k| (before[k] - 2.0 * here[k] + after[k]).powi(2)).sum::<f64>()
    };
    let inside = |size: usize| (2..size.saturating_sub(2)).step_by(STRIDE);
    // Sums along a row and along a column, each over neighbours and over pixels two apart.
    let (mut sums, mut count) = ([[0.0; 2]; 2], 0.0);
    for (x, y) in inside(height).flat_map(|y| inside(width).map(move |x| (x, y))) {
        for (sums, step) in sums.iter_mut().zip([1, width]) {
            sums[0] += second_difference2(y * width + x, step);
            sums[1] += second_difference2(y * width + x, 2 * step);
        }
        count += 1.0;
    }
    // Rounding, whose hues are each pixel's own, is not to decide: neighbours must differ by as much again.
    let rounding = count * rounding();
    sums.iter().all(|[near, apart]| near - 2.0 * rounding > SHARP * (apart - rounding))
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{DynamicImage, Rgb, RgbImage};
    use rand::{RngExt, SeedableRng, rngs::StdRng};
    use rand_distr::StandardNormal;

    /// A picture of noise in brightness whose hues are `hue(x, y)`, a number that red has more and blue less.
    fn picture(size: u32, hue: impl Fn(u32, u32) -> f64) -> Frame {
        let mut random = StdRng::seed_from_u64(1);
        let picture = RgbImage::from_fn(size, size, |x, y| {
            let grey = 120.0 + 10.0 * random.sample::<f64, _>(StandardNormal);
            let hue = hue(x, y);
            Rgb([grey + hue, grey, grey - hue].map(|v| v.round() as u8))
        });
        Frame::from_image(DynamicImage::ImageRgb8(picture)).unwrap()
    }

    /// Hues of this σ, one for each pixel of a coarse picture.
    fn coarse(size: u32, sigma: f64) -> impl Fn(u32, u32) -> f64 {
        let mut random = StdRng::seed_from_u64(2);
        let hues: Vec<f64> = (0..size * size).map(|_| sigma * random.sample::<f64, _>(StandardNormal)).collect();
        move |x, y| hues[(y.min(size - 1) * size + x.min(size - 1)) as usize]
    }

    #[test]
    fn hues_of_each_pixel_are_sharp_and_those_of_half_the_resolution_are_not() {
        const SIZE: u32 = 300;
        let own = coarse(SIZE, 8.0);
        assert!(are_sharp(&picture(SIZE, &own)));
        let repeated = |x: u32, y: u32| own(x / 2, y / 2);
        let halfway = |x: u32, y: u32| {
            let mean = |y: u32| 0.5 * (own(x / 2, y) + own(x.div_ceil(2), y));
            0.5 * (mean(y / 2) + mean(y.div_ceil(2)))
        };
        let quarters = |x: u32, y: u32| {
            let other = |v: u32| (v + 1) / 2 + v % 2;
            let along = |y: u32| 0.75 * own(x / 2 + 1, y) + 0.25 * own(other(x), y);
            0.75 * along(y / 2 + 1) + 0.25 * along(other(y))
        };
        assert!(!are_sharp(&picture(SIZE, repeated)));
        assert!(!are_sharp(&picture(SIZE, halfway)));
        assert!(!are_sharp(&picture(SIZE, quarters)));
        // As video keeps them: at half of the resolution along rows alone.
        assert!(!are_sharp(&picture(SIZE, |x, y| own(x / 2, y))));
    }

    #[test]
    fn a_picture_without_hues_tells_nothing_of_them() {
        assert!(!are_sharp(&picture(200, |_, _| 0.0)));
        // Hues that only rounding makes.
        assert!(!are_sharp(&picture(200, |x, _| 0.3 * f64::from(x % 2))));
        assert!(!are_sharp(&picture(3, |_, _| 0.0)));
        let grey = Frame::from_image(DynamicImage::ImageLuma8(image::GrayImage::new(50, 50))).unwrap();
        assert!(!are_sharp(&grey));
    }
}
