//! Whether a picture is too bright or too dark to be measured.

use crate::camera::{Frame, Sample, Samples};

/// A pixel is white if all its channels are at least at this level, 0 to 255.
///
/// Convention: three steps below the top, which noise and compression leave of full white.
const WHITE: f32 = 252.0;
/// A pixel is black if all its channels are at most at this level.
///
/// Convention: three steps above the bottom.
const BLACK: f32 = 3.0;
/// The share of black and white pixels above which a picture is saturated.
///
/// Convention: at most one pixel of fifty is left that shows something.
const SATURATED_SHARE: f64 = 0.98;
/// The share of white pixels above which it is: most of it is so overexposed that edges are no longer where half of the light is.
///
/// Fitted: by hand on renders; judged by `tests/eye/robustness`.
const WHITE_SHARE: f64 = 0.5;
/// One pixel of so many in each direction is examined.
///
/// Convention: a prime, so that no pattern of the target is sampled in step; a picture of a megapixel leaves 5,500. Few rows are read whole, and not
/// every row at few places: so memory is read once, and not at each place anew.
const STRIDE: usize = 13;

/// Whether nearly all of a picture is black or white, or most of it white.
pub fn is_saturated(frame: &Frame) -> bool {
    let (white, black) = match &frame.samples {
        Samples::Bits8(samples) => extreme_shares(samples, frame),
        Samples::Bits16(samples) => extreme_shares(samples, frame),
    };
    white > WHITE_SHARE || white + black > SATURATED_SHARE
}

/// The shares of white and of black pixels among those of a frame that are examined.
fn extreme_shares<S: Sample>(samples: &[S], frame: &Frame) -> (f64, f64) {
    let rows = samples.chunks_exact((frame.width as usize * frame.channels).max(1)).step_by(STRIDE);
    let pixels = rows.flat_map(|row| row.chunks_exact(frame.channels.max(1)).step_by(STRIDE));
    let (mut white, mut black, mut all) = (0_u32, 0_u32, 0_u32);
    for pixel in pixels {
        white += u32::from(pixel.iter().all(|v| v.level() >= WHITE));
        black += u32::from(pixel.iter().all(|v| v.level() <= BLACK));
        all += 1;
    }
    let share = |count: u32| f64::from(count) / f64::from(all.max(1));
    (share(white), share(black))
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{DynamicImage, GrayImage, Luma};

    /// A picture whose pixels are white, black and grey in these shares.
    fn picture(white: f64, black: f64) -> Frame {
        const ROWS: u32 = 100 * STRIDE as u32;
        let grey = GrayImage::from_fn(300, ROWS, |_, y| {
            let share = f64::from(y) / f64::from(ROWS);
            Luma([if share < white {
                255
            } else if share < white + black {
                0
            } else {
                128
            }])
        });
        Frame::from_image(DynamicImage::ImageLuma8(grey)).unwrap()
    }

    #[test]
    fn a_picture_is_saturated_if_most_is_white_or_nearly_all_is_black_or_white() {
        for (white, black, expected) in [
            (0.0, 0.0, false),
            (0.45, 0.0, false),
            (0.55, 0.0, true),
            (0.0, 0.96, false),
            (0.0, 1.0, true),
            (0.4, 0.59, true),
            (0.4, 0.5, false),
        ] {
            assert_eq!(is_saturated(&picture(white, black)), expected, "{white} {black}");
        }
    }
}
