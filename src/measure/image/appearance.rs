//! What distinguishes the snake from the grid target: the mix of colour channels that separates them best.

use crate::camera::{Frame, Sample, Samples};
use crate::measure::image::plane::{Plane, Region, laplacian, noise_of};
use crate::statistics::order::median;
use nalgebra::{DMatrix, DVector, Matrix3, Vector2, Vector3};
use serde::{Deserialize, Serialize};
use std::sync::LazyLock;

/// Colours are learned from one pixel of so many in each direction.
///
/// Convention: of a megapixel a quarter of a million is left.
const LEARNING_STRIDE: usize = 2;
/// The exposure is measured on one pixel of so many in each direction.
///
/// Convention: a prime, so that no pattern of the target is sampled in step; around a snake of 500 px some 3,000 pixels are left.
const EXPOSURE_STRIDE: usize = 7;
/// The noise is measured on one pixel of so many in each direction.
///
/// Convention: a prime, for the same reason; a megapixel leaves 5,500 pixels in 60 rows, so that it matters little how many of these lie on printed
/// lines. From a dozen rows it scatters by 5 %.
const NOISE_STRIDE: usize = 13;
/// The fewest pixels of a class from which it can be learned.
///
/// Convention: a guard for the covariance of three channels.
const FEWEST_PIXELS: f64 = 50.0;
/// Variance of the light that is added to each channel, full light being 1, so that pictures without noise have a solution.
///
/// Derived: σ = 0.3 %, about one level of 8 bits.
const LIGHT_VARIANCE_FLOOR: f64 = 1e-5;
/// A background pixel is on the snake's side above this value of the discriminant, which is 1 on the snake and 0 on the target.
///
/// Convention: a little nearer to the snake than to the target.
const LIKE_SNAKE: f64 = 0.6;
/// The share of the background on the snake's side from which on edges may go either way.
///
/// Fitted: by hand on renders: shadows and thick grid lines cover less of the target than that, a checkerboard's dark squares half of
/// it.
const TWO_SIDED_SHARE: f64 = 0.2;
/// The mean of the discriminant on the snake, whose rms there is 1, up to which edges may go either way.
///
/// Derived: of normal values with a mean of 0.7 and an rms of 1 a sixth is negative: so much of the snake lies on the far side of the target.
const ONE_SIDED_MEAN: f64 = 0.7;
/// What each channel of linear light contributes to brightness.
///
/// Source: ITU-R BT.709, item 3.2.
const BRIGHTNESS: [f64; 3] = [0.2126, 0.7152, 0.0722];
/// How far the hue of a pixel at the border errs, in units of what snake and target differ in hue (rms): a JPEG and many a camera keep hues at half of
/// the brightness's resolution, smear them over the border and shift them. Placing edges by brightness alone, which infinity would mean, loses what
/// hues tell of brass before paper.
///
/// Fitted: to rigs 900 to 926, which the project drew with a path tracer: with 0.3 sixteen of their 60 bends are not measured, with 1 eleven or more,
/// with 3 three and with 9 four. Judged by 940 to 946 and 960 to 966, and by thirty rigs of others, on which 0.3 and 9 were tried as well (see the
/// book).
const HUE_ERROR: f64 = 3.0;
/// The least offset of the discriminant for which the background's brightness tells the exposure.
///
/// Convention: the offset is what the target's light contributes, the difference between the classes being 1.
const LEAST_TELLING_OFFSET: f64 = 0.5;
/// The least and largest exposure, relative to the picture that was learned from.
///
/// Convention: a guard; a picture darker or brighter than that is not measured for other reasons.
const EXPOSURE_RANGE: (f64, f64) = (0.02, 5.0);

/// What of snake and target is told apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Separation {
    /// Their mean colours, where the snake's outline is known roughly and much of either lies in the other.
    OfMeans,
    /// Each pixel of the snake from the target, where the outline is known well.
    OfPixels,
}

/// A linear map from colour to a discriminant that is about 1 on the snake and 0 on the target, with the printed grid suppressed.
///
/// The grid's lines are part of the background's scatter, so the direction that separates the two classes best is also the one in which
/// the lines' colour shows least.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Appearance {
    /// Weight of each channel (one for grey, three for red, green, blue), per unit of linear light.
    pub weights: Vec<f64>,
    /// Added to the weighted sum.
    pub offset: f64,
    /// Whether much of the background is on the snake's side of the target's mean, as on a checkerboard with squares darker than
    /// the snake: edges may then go either way.
    pub two_sided: bool,
    /// The median of the weighted light around the straight snake in the picture that was learned from, which tells the exposure of others. Files
    /// of older versions have none; the target is then taken for most of what is seen there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light: Option<f64>,
}

impl Appearance {
    /// Learns from a picture in which `label(x, y)` tells snake (`Some(true)`) from background (`Some(false)`), and how much a
    /// pixel counts, up to 1.
    ///
    /// `None` if one of the classes has too few pixels or they do not differ.
    pub fn learn(
        frame: &Frame,
        separation: Separation,
        label: impl Fn(u32, u32) -> Option<(bool, f64)>,
    ) -> Option<Self> {
        let channels = frame.channels;
        let places = (0..frame.height)
            .step_by(LEARNING_STRIDE)
            .flat_map(|y| (0..frame.width).step_by(LEARNING_STRIDE).map(move |x| (x, y)));
        let pixels: Vec<_> = places.filter_map(|(x, y)| Some((x, y, label(x, y)?))).collect();
        if !(1..=3).contains(&channels) {
            return None;
        }
        let colour = |x: u32, y: u32| {
            let first = (y as usize * frame.width as usize + x as usize) * channels;
            Vector3::from_fn(|c, _| if c < channels { f64::from(light(&frame.samples, first + c)) } else { 0.0 })
        };
        let mut count = [0.0; 2];
        let mut mean = [Vector3::zeros(); 2];
        for &(x, y, (is_snake, weight)) in &pixels {
            count[usize::from(is_snake)] += weight;
            mean[usize::from(is_snake)] += colour(x, y) * weight;
        }
        if count[0] < FEWEST_PIXELS || count[1] < FEWEST_PIXELS {
            return None;
        }
        mean.iter_mut().zip(count).for_each(|(mean, count)| *mean /= count);
        let mut square = [Matrix3::zeros(); 2];
        for &(x, y, (is_snake, weight)) in &pixels {
            let off = colour(x, y) - mean[usize::from(is_snake)];
            square[usize::from(is_snake)].syger(weight, &off, &off, 1.0);
        }
        let scatter = [0, 1].map(|class: usize| {
            square[class].fill_upper_triangle_with_lower_triangle();
            (square[class] / count[class]).view((0, 0), (channels, channels)).into_owned()
        });
        let mean = mean.map(|mean| mean.rows(0, channels).into_owned());
        let difference = &mean[1] - &mean[0];
        let weights = match separation {
            Separation::OfMeans => between_means(&scatter, count, &difference),
            Separation::OfPixels => between_pixels(scatter, &difference),
        }?;
        let mut appearance = Self {
            offset: -weights.dot(&mean[0]),
            weights: weights.iter().copied().collect(),
            two_sided: false,
            light: None,
        };
        let discriminant = |x: u32, y: u32| colour(x, y).rows(0, channels).dot(&weights) + appearance.offset;
        let background = pixels.iter().filter(|(_, _, (is_snake, _))| !is_snake);
        let like_snake = background.filter(|&&(x, y, _)| discriminant(x, y) > LIKE_SNAKE);
        let like_snake: f64 = like_snake.map(|(.., (_, weight))| weight).sum();
        let is_snake_on_one_side = weights.dot(&difference) > ONE_SIDED_MEAN;
        appearance.two_sided = like_snake > TWO_SIDED_SHARE * count[0] || !is_snake_on_one_side;
        Some(appearance)
    }

    /// The discriminant of every pixel. A grey frame seen with a colour appearance counts as neutral colours, and a colour
    /// frame seen with a grey appearance is averaged.
    pub fn plane(&self, frame: &Frame) -> Plane {
        self.plane_within(frame, &Region::whole(frame.width, frame.height))
    }

    /// The same for a region of the frame, with zeros elsewhere in the rectangle around it.
    pub fn plane_within(&self, frame: &Frame, region: &Region) -> Plane {
        let weights = self.weights_for(frame.channels);
        let (x, y) = region.bounds();
        let (width, height) = (x.len(), y.len());
        let mut data = vec![0.0; width * height];
        let shares = shares_of_8_bits(&weights);
        for (row, columns) in region.rows() {
            let pixels = &mut data[(row - y.start) * width..][columns.start - x.start..columns.end - x.start];
            let first = row * frame.width as usize;
            let colours = (first + columns.start) * frame.channels..(first + columns.end) * frame.channels;
            match &frame.samples {
                Samples::Bits8(samples) => self.add_up(&samples[colours], &shares, pixels),
                Samples::Bits16(samples) => self.discriminate(&samples[colours], &weights, pixels),
            }
        }
        Plane { width, height, first: Vector2::new(x.start as f64, y.start as f64), data, hidden: Vec::new() }
    }

    /// The discriminant of a frame made `FACTOR` times smaller, each pixel the mean over a block, of which every second pixel counts, as those of one
    /// colour of a chessboard: no printed line is then missed.
    ///
    /// The centre of block (x, y) is at pixel `FACTOR * x + (FACTOR - 1) / 2` of the frame.
    pub fn overview<const FACTOR: usize>(&self, frame: &Frame) -> Plane {
        let counted = (FACTOR * FACTOR / 2) as f32;
        let weights: Vec<f32> = self.weights_for(frame.channels).into_iter().map(|weight| weight / counted).collect();
        let shares = shares_of_8_bits(&weights);
        let light = |number: u16| LIGHT_16[usize::from(number)];
        match (&frame.samples, weights.as_slice(), shares.as_slice()) {
            (Samples::Bits8(samples), _, [grey]) => {
                self.block_sums::<_, 1, FACTOR>(frame, samples, |&[v]| grey[usize::from(v)])
            }
            (Samples::Bits8(samples), _, [red, green, blue]) => {
                self.block_sums::<_, 3, FACTOR>(frame, samples, |&[r, g, b]| {
                    red[usize::from(r)] + green[usize::from(g)] + blue[usize::from(b)]
                })
            }
            (Samples::Bits16(samples), &[grey], _) => {
                self.block_sums::<_, 1, FACTOR>(frame, samples, |&[v]| light(v) * grey)
            }
            (Samples::Bits16(samples), &[red, green, blue], _) => {
                self.block_sums::<_, 3, FACTOR>(frame, samples, |&[r, g, b]| {
                    light(r) * red + light(g) * green + light(b) * blue
                })
            }
            _ => self.plane(frame).shrunk::<FACTOR>(),
        }
    }

    /// The offset and, of every second pixel of each block, what its colour adds.
    fn block_sums<S, const CHANNELS: usize, const FACTOR: usize>(
        &self,
        frame: &Frame,
        samples: &[S],
        added: impl Fn(&[S; CHANNELS]) -> f32,
    ) -> Plane {
        let (width, height) = (frame.width as usize / FACTOR, frame.height as usize / FACTOR);
        let mut sums = vec![self.offset as f32; width * height];
        let mut rows = samples.as_chunks::<CHANNELS>().0.chunks_exact((frame.width as usize).max(1));
        for sums in sums.chunks_exact_mut(width.max(1)) {
            for (line, row) in rows.by_ref().take(FACTOR).enumerate() {
                for (sum, block) in sums.iter_mut().zip(row.as_chunks::<FACTOR>().0) {
                    *sum += (0..FACTOR / 2).map(|x| added(&block[2 * x + line % 2])).sum::<f32>();
                }
            }
        }
        Plane::new(width, height, sums)
    }

    /// The noise of the discriminant in a frame, σ of a pixel.
    pub fn noise(&self, frame: &Frame) -> f64 {
        let (light, width) = (self.light_in(frame), frame.width as usize);
        let inside = |size: u32| (1..(size as usize).saturating_sub(1)).step_by(NOISE_STRIDE);
        let pixels = inside(frame.height).flat_map(|row| inside(frame.width).map(move |column| row * width + column));
        let line = |middle: usize| [light(middle - 1), light(middle), light(middle + 1)];
        noise_of(pixels.map(|pixel| laplacian([pixel - width, pixel, pixel + width].map(line))).collect())
    }

    /// Writes the discriminant of pixels of 8 bits, from their colours and what each number of each channel adds.
    fn add_up(&self, colours: &[u8], shares: &[[f32; 256]], pixels: &mut [f32]) {
        let offset = self.offset as f32;
        match shares {
            [red, green, blue] => pixels.iter_mut().zip(colours.as_chunks().0).for_each(|(pixel, &[r, g, b])| {
                *pixel = offset + red[usize::from(r)] + green[usize::from(g)] + blue[usize::from(b)];
            }),
            _ => pixels.iter_mut().zip(colours.chunks_exact(shares.len())).for_each(|(pixel, colour)| {
                *pixel = colour.iter().zip(shares).fold(offset, |sum, (&v, share)| sum + share[usize::from(v)]);
            }),
        }
    }

    /// The same for pixels of 16 bits, from the weights of their channels.
    fn discriminate(&self, colours: &[u16], weights: &[f32], pixels: &mut [f32]) {
        let offset = self.offset as f32;
        for (pixel, colour) in pixels.iter_mut().zip(colours.chunks_exact(weights.len())) {
            *pixel = colour.iter().zip(weights).fold(offset, |sum, (&v, w)| sum + LIGHT_16[usize::from(v)] * w);
        }
    }

    /// The same appearance in a frame with another exposure than the picture that was learned from, by the light around the straight snake, most of
    /// which the target reflects. A two-sided background, or one that differs from the snake in colour alone, does not tell the exposure, which is
    /// then taken for the same.
    pub fn exposed_as(&self, frame: &Frame, around: &Region) -> Self {
        let is_told = !self.two_sided && self.offset.abs() >= LEAST_TELLING_OFFSET;
        let Some(now) = self.median_light(frame, around).filter(|_| is_told) else { return self.clone() };
        // The target's light adds up to minus the offset in the picture that was learned from.
        let then = self.light.unwrap_or(-self.offset);
        let (least, largest) = EXPOSURE_RANGE;
        let exposure = (now / then).clamp(least, largest);
        Self { weights: self.weights.iter().map(|w| w / exposure).collect(), ..self.clone() }
    }

    /// The median of the weighted light of what a frame shows of a region; `None` where it shows nothing of it.
    pub fn median_light(&self, frame: &Frame, around: &Region) -> Option<f64> {
        let (width, height) = (frame.width as usize, frame.height as usize);
        let rows = around.rows().take_while(|(row, _)| *row < height).step_by(EXPOSURE_STRIDE);
        let pixels = rows.flat_map(|(row, columns)| {
            (columns.start..columns.end.min(width)).step_by(EXPOSURE_STRIDE).map(move |x| row * width + x)
        });
        let mut levels: Vec<f32> = pixels.map(self.light_in(frame)).collect();
        (!levels.is_empty()).then(|| f64::from(median(&mut levels)))
    }

    /// The weighted light of each of a frame's pixels, which are counted row by row.
    fn light_in<'a>(&self, frame: &'a Frame) -> impl Fn(usize) -> f32 + use<'a> {
        let weights = self.weights_for(frame.channels);
        let shares = shares_of_8_bits(&weights);
        move |pixel| match (&frame.samples, shares.as_slice()) {
            (Samples::Bits8(samples), [red, green, blue]) => {
                let [r, g, b] = samples.as_chunks().0[pixel].map(usize::from);
                red[r] + green[g] + blue[b]
            }
            (samples, _) => weights.iter().zip(pixel * weights.len()..).map(|(w, k)| light(samples, k) * w).sum(),
        }
    }

    /// The weights of a frame's own channels.
    fn weights_for(&self, channels: usize) -> Vec<f32> {
        match (self.weights.len(), channels) {
            (a, b) if a == b => self.weights.iter().map(|&w| w as f32).collect(),
            (_, channels) => vec![self.weights.iter().sum::<f64>() as f32 / channels as f32; channels],
        }
    }
}

/// The weights with which the means of two classes differ most against the scatter within both; that difference is 1. `None` where they do not differ.
///
/// Source: R. A. Fisher, "The Use of Multiple Measurements in Taxonomic Problems", Annals of Eugenics 7, 1936.
fn between_means(scatter: &[DMatrix<f64>; 2], count: [f64; 2], difference: &DVector<f64>) -> Option<DVector<f64>> {
    let pooled = (&scatter[0] * count[0] + &scatter[1] * count[1]) / (count[0] + count[1]);
    let floor = DMatrix::identity(difference.len(), difference.len()) * LIGHT_VARIANCE_FLOOR;
    let direction = (pooled + floor).cholesky()?.solve(difference);
    let scale = direction.dot(difference);
    (scale > 0.0).then(|| direction / scale)
}

/// The weights with which the snake's pixels differ most (rms) from the target's mean, whichever way, against the target's scatter and what
/// compression and lens do to hues; that difference is 1, and its mean is not negative. `None` where they do not differ.
///
/// Metal is here brighter than paper and there darker, so that the means may agree where every edge is plain.
fn between_pixels([target, snake]: [DMatrix<f64>; 2], difference: &DVector<f64>) -> Option<DVector<f64>> {
    let channels = difference.len();
    let snake = snake + difference * difference.transpose();
    let hue = match channels {
        3 => DMatrix::from_fn(3, 3, |row, column| f64::from(u8::from(row == column)) - BRIGHTNESS[column]),
        _ => DMatrix::zeros(channels, channels),
    };
    let floor = DMatrix::identity(channels, channels) * LIGHT_VARIANCE_FLOOR;
    let noise = target + floor + &hue * &snake * hue.transpose() * HUE_ERROR.powi(2);
    let whitener = noise.cholesky()?.l().try_inverse()?;
    let ratio = (&whitener * &snake * whitener.transpose()).symmetric_eigen();
    let direction = whitener.transpose() * ratio.eigenvectors.column(ratio.eigenvalues.imax());
    let scale = direction.dot(&(&snake * &direction)).sqrt();
    let scale = if direction.dot(difference) < 0.0 { -scale } else { scale };
    (scale != 0.0).then(|| direction / scale)
}

/// The light behind an encoded value 0–255, as 0–1, by the sRGB curve (IEC 61966-2-1).
///
/// Blur mixes light, not encoded values: half way across a blurred edge is half the light, and an edge placed in the
/// encoded picture would be off by up to half a pixel towards the dark side.
fn linear_light(encoded: f32) -> f64 {
    let v = f64::from(encoded) / 255.0;
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// What each number of 8 bits of each channel adds, of channels of these weights.
fn shares_of_8_bits(weights: &[f32]) -> Vec<[f32; 256]> {
    weights.iter().map(|weight| std::array::from_fn(|number| LIGHT_8[number] * weight)).collect()
}

/// The light behind a sample.
fn light(samples: &Samples, k: usize) -> f32 {
    match samples {
        Samples::Bits8(samples) => LIGHT_8[usize::from(samples[k])],
        Samples::Bits16(samples) => LIGHT_16[usize::from(samples[k])],
    }
}

/// [`linear_light`] of every number of 8 and of 16 bits.
static LIGHT_8: LazyLock<Vec<f32>> = LazyLock::new(|| (0..=u8::MAX).map(|v| linear_light(v.level()) as f32).collect());
static LIGHT_16: LazyLock<Vec<f32>> =
    LazyLock::new(|| (0..=u16::MAX).map(|v| linear_light(v.level()) as f32).collect());

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use image::{DynamicImage, RgbImage};
    use nalgebra::Point2;

    /// Dark and bluish above, light below; the brightness is sharp, the blue runs over the border as a JPEG makes it.
    #[test]
    fn what_is_sharp_at_the_border_tells_snake_from_target() {
        const BORDER: u32 = 60;
        let picture = RgbImage::from_fn(120, 120, |x, y| {
            // The snake is shaded and the target printed, so that far from the border blue tells the most.
            let shade = if y < BORDER { 30.0 * f64::from(x % 7) } else { 40.0 * f64::from(u8::from(x % 10 == 0)) };
            let below = ((f64::from(y) - f64::from(BORDER) + 8.0) / 8.0).clamp(0.0, 1.0);
            let grey = if y < BORDER { 120.0 - shade / 2.0 } else { 200.0 - shade / 2.0 };
            image::Rgb([grey, grey, grey + 25.0 * (1.0 - below)].map(|v: f64| v as u8))
        });
        let frame = Frame::from_image(DynamicImage::ImageRgb8(picture)).unwrap();
        // The share of the difference that the two rows make between which the border is.
        let step = |separation| {
            let appearance = Appearance::learn(&frame, separation, |_, y| Some((y < BORDER, 1.0))).unwrap();
            let plane = appearance.plane(&frame);
            let row = |y: i64| (0..120).map(|x| plane.get(x, y)).sum::<f32>() / 120.0;
            (row(59) - row(60)) / (row(20) - row(100))
        };
        let (means, pixels) = (step(Separation::OfMeans), step(Separation::OfPixels));
        assert!(pixels > means + 0.05 && pixels > 0.9, "{pixels} {means}");
    }

    /// Metal whose stripes are lighter and darker than the paper by as much: the means agree, and all of the snake is unlike the paper.
    #[test]
    fn a_snake_that_is_lighter_and_darker_than_the_target_is_told_from_it_either_way() {
        let picture = RgbImage::from_fn(120, 120, |x, y| {
            let paper = if x % 9 == 0 { 150 } else { 156 };
            image::Rgb([if y >= 60 { paper } else { [90, 197][usize::from(x % 8 < 4)] }; 3])
        });
        let frame = Frame::from_image(DynamicImage::ImageRgb8(picture)).unwrap();
        let appearance = Appearance::learn(&frame, Separation::OfPixels, |_, y| Some((y < 60, 1.0))).unwrap();
        assert!(appearance.two_sided);
        let plane = appearance.plane(&frame);
        let all = |rows: std::ops::Range<i64>| rows.flat_map(|y| (0..120).map(move |x| (x, y)));
        assert!(all(0..60).all(|(x, y)| (0.6..1.5).contains(&plane.get(x, y).abs())));
        assert!(all(60..120).all(|(x, y)| plane.get(x, y).abs() < 0.2));
    }

    #[test]
    fn an_overview_is_the_mean_of_blocks_and_counts_a_line_of_a_pixel_as_it_is() {
        let appearance = Appearance { weights: vec![0.5, -1.0, 0.8], offset: 0.1, two_sided: false, light: None };
        // Lines of one pixel, along the rows of one picture and along the columns of the other, anywhere in a block.
        let line = |place: u32| if place % 7 == 3 { [40, 60, 90] } else { [200, 190, 160] };
        for picture in [
            RgbImage::from_fn(84, 60, |x, _| image::Rgb(line(x))),
            RgbImage::from_fn(84, 60, |_, y| image::Rgb(line(y))),
        ] {
            let wide: image::ImageBuffer<image::Rgb<u16>, _> = DynamicImage::ImageRgb8(picture.clone()).into_rgb16();
            let grey = DynamicImage::ImageRgb8(picture.clone()).into_luma8();
            for image in
                [DynamicImage::ImageRgb8(picture), DynamicImage::ImageRgb16(wide), DynamicImage::ImageLuma8(grey)]
            {
                let frame = Frame::from_image(image).unwrap();
                let (overview, expected) = (appearance.overview::<4>(&frame), appearance.plane(&frame).shrunk::<4>());
                assert_eq!((overview.width, overview.height), (21, 15));
                for (mean, expected) in overview.data.iter().zip(&expected.data) {
                    assert_relative_eq!(mean, expected, epsilon = 1e-5);
                }
            }
        }
    }

    #[test]
    fn noise_is_that_of_the_whole_plane() {
        use rand::{RngExt, SeedableRng};
        let mut random = rand::rngs::StdRng::seed_from_u64(3);
        let picture = RgbImage::from_fn(700, 500, |x, _| {
            let paper = if x % 20 == 0 { 90.0 } else { 170.0 };
            image::Rgb([0; 3].map(|_| (paper + 5.0 * random.sample::<f64, _>(rand_distr::StandardNormal)) as u8))
        });
        let frame = Frame::from_image(DynamicImage::ImageRgb8(picture)).unwrap();
        let appearance = Appearance { weights: vec![0.5, -1.0, 0.8], offset: 0.0, two_sided: false, light: None };
        let whole = appearance.plane(&frame).noise(&Region::whole(700, 500));
        // 2,100 pixels beside 7,100; the median of |N| scatters by 0.787 σ/√n, 1.7 % and 0.9 %.
        assert_relative_eq!(appearance.noise(&frame), whole, max_relative = 0.05);
    }

    /// A small light sheet on a dark table, and a dark snake before it that covers the columns from `snake_x` on.
    fn on_a_table(snake_x: u32, exposure: f64) -> Frame {
        let picture = RgbImage::from_fn(200, 200, |x, y| {
            let light = match (x, y) {
                (x, _) if (snake_x..snake_x + 10).contains(&x) => 0.05,
                (80..120, 60..140) => 0.6,
                _ => 0.02,
            };
            let encoded = 1.055 * (light * exposure).powf(1.0 / 2.4) - 0.055;
            image::Rgb([(255.0 * encoded).round() as u8; 3])
        });
        Frame::from_image(DynamicImage::ImageRgb8(picture)).unwrap()
    }

    #[test]
    fn the_sheet_tells_the_exposure_and_not_the_table_that_most_of_a_picture_shows() {
        let straight = on_a_table(95, 1.0);
        // The sheet's own rows and columns.
        let around = Region::along((80..=120).map(|y| Point2::new(100.0, f64::from(y))), 20.0, (200, 200));
        let label = |x: u32, y: u32| {
            let is_sheet = (80..120).contains(&x) && (60..140).contains(&y);
            is_sheet.then_some(((95..105).contains(&x), 1.0))
        };
        let mut learned = Appearance::learn(&straight, Separation::OfMeans, label).unwrap();
        learned.light = learned.median_light(&straight, &around);
        let small = Frame::from_image(DynamicImage::ImageRgb8(RgbImage::new(90, 70))).unwrap();
        assert!(learned.median_light(&small, &around).is_some());
        for (exposure, tolerance) in [(1.0, 1e-6), (0.5, 0.02), (1.5, 0.02)] {
            let exposed = learned.exposed_as(&on_a_table(105, exposure), &around);
            let ratio = learned.weights[0] / exposed.weights[0];
            assert_relative_eq!(ratio, exposure, max_relative = tolerance);
        }
    }
}
