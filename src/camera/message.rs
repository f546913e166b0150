//! Pictures and lenses out of ROS 2 recordings.
//!
//! Source: the definitions of ROS 2's package `sensor_msgs`; its `image_encodings.hpp` for the names of encodings.

use super::file::{FISHEYES, WrongPart};
use super::frame::{Frame, Samples};
use super::lens::Lens;
use super::picture::decode_frame;
use crate::bag::messages::{CameraInfo, CompressedImage};
use crate::bag::{Cdr, CdrResult, Stamped, Topic};
use crate::error::Result;

impl Lens {
    /// The lens that the first `sensor_msgs/CameraInfo` of a topic tells.
    ///
    /// # Errors
    /// A recording that cannot be read or has no such topic; a camera of another model.
    pub fn of_topic(topic: &Topic) -> Result<Self> {
        Self::of_info(&topic.first()?).map_err(|why| topic.error(why))
    }

    /// The lens that a `sensor_msgs/CameraInfo` tells.
    ///
    /// # Errors
    /// A camera that was not calibrated, or one of another model: in words.
    pub fn of_info(info: &CameraInfo) -> std::result::Result<Self, String> {
        let model = info.distortion_model.as_str();
        let is_fisheye = FISHEYES.contains(&model);
        if !is_fisheye && !["", "plumb_bob", "rational_polynomial"].contains(&model) {
            return Err(format!("distortion_model {model:?}, expected plumb_bob, rational_polynomial or equidistant"));
        }
        let lens = Self::of_parts((info.width, info.height), info.matrix, &info.distortion, is_fisheye);
        let lens = lens.map_err(|part| match part {
            WrongPart::Matrix(why) => format!("k: {why}; calibrate the camera"),
            WrongPart::Distortion(why) => format!("d: {why}"),
        })?;
        lens.windowed(&Window { binning: info.binning, offset: info.offset, size: info.window })
    }

    /// The lens of pictures that show a window of the sensor, or several pixels as one, from that of the whole sensor.
    ///
    /// Derived: pixel centres are at integers. A pixel of b × b binned ones lies at the mean of theirs, so that u = x₀ + b u' + (b − 1)/2.
    ///
    /// # Errors
    /// A window that is not within the sensor.
    pub(super) fn windowed(mut self, window: &Window) -> std::result::Result<Self, String> {
        let Window { offset, size, .. } = *window;
        let whole = [self.width, self.height];
        let binning = window.binning.map(|count| count.max(1));
        let size = if size == [0, 0] { whole } else { size };
        let fits = |axis: usize| u64::from(offset[axis]) + u64::from(size[axis]) <= u64::from(whole[axis]);
        if !fits(0) || !fits(1) || size[0] < binning[0] || size[1] < binning[1] {
            return Err(format!(
                "the window (roi) of {}×{} px from ({}, {}) on, binned {}×{}, does not fit the sensor of {}×{} px, so that it is not known whether the camera matrix \
                 is that of the window or of the sensor; calibrate with pictures of the window, and give that camera file",
                size[0], size[1], offset[0], offset[1], binning[0], binning[1], whole[0], whole[1]
            ));
        }
        for axis in 0..2 {
            let bins = f64::from(binning[axis]);
            self.focal_px[axis] /= bins;
            self.centre_px[axis] = (self.centre_px[axis] - f64::from(offset[axis]) - (bins - 1.0) / 2.0) / bins;
        }
        (self.width, self.height) = (size[0] / binning[0], size[1] / binning[1]);
        Ok(self)
    }
}

/// The part of a sensor that a camera sends, px of the sensor, and how many of them each way it sends as one.
///
/// Source: `sensor_msgs/CameraInfo`, `RegionOfInterest`: zeros stand for the whole sensor, unbinned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Window {
    /// Pixels that are one.
    pub binning: [u32; 2],
    /// The first column and row.
    pub offset: [u32; 2],
    /// Columns and rows.
    pub size: [u32; 2],
}

/// A picture with its time.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// s.
    pub stamp_s: f64,
    /// The pixels.
    pub frame: Frame,
}

impl Stamped for Picture {
    const KINDS: &'static [&'static str] = &[CompressedImage::DEFINITION.kind, "sensor_msgs/Image"];

    fn body(stamp_s: f64, kind: &str, cdr: &mut Cdr) -> CdrResult<Self> {
        if kind == "sensor_msgs/Image" {
            return Ok(Self { stamp_s, frame: RawImage::read(cdr)?.frame()? });
        }
        Ok(Self { stamp_s, frame: decode_frame(CompressedImage::read(cdr)?.data)? })
    }
}

/// `sensor_msgs/Image` behind its header.
struct RawImage<'a> {
    height: usize,
    width: usize,
    encoding: String,
    is_big_endian: bool,
    /// Bytes of a row.
    step: usize,
    data: &'a [u8],
}

impl<'a> RawImage<'a> {
    fn read(cdr: &mut Cdr<'a>) -> CdrResult<Self> {
        Ok(Self {
            height: cdr.u32()? as usize,
            width: cdr.u32()? as usize,
            encoding: cdr.text()?,
            is_big_endian: cdr.u8()? != 0,
            step: cdr.u32()? as usize,
            data: cdr.bytes()?,
        })
    }

    fn frame(&self) -> CdrResult<Frame> {
        let (channels, samples) = match self.encoding.as_str() {
            "mono8" | "8UC1" => (1, Samples::Bits8(self.pixels(1, [0])?)),
            "mono16" | "16UC1" => (1, Samples::Bits16(self.pixels_of_16_bits([0])?)),
            "rgb16" => (3, Samples::Bits16(self.pixels_of_16_bits([0, 1, 2])?)),
            "bgr16" => (3, Samples::Bits16(self.pixels_of_16_bits([2, 1, 0])?)),
            "rgb8" => (3, Samples::Bits8(self.pixels(3, [0, 1, 2])?)),
            "bgr8" | "8UC3" => (3, Samples::Bits8(self.pixels(3, [2, 1, 0])?)),
            "rgba8" => (3, Samples::Bits8(self.pixels(4, [0, 1, 2])?)),
            "bgra8" => (3, Samples::Bits8(self.pixels(4, [2, 1, 0])?)),
            // Where red stands in each block of two by two.
            "bayer_rggb8" => (3, Samples::Bits8(self.demosaiced(0, 0)?)),
            "bayer_grbg8" => (3, Samples::Bits8(self.demosaiced(1, 0)?)),
            "bayer_gbrg8" => (3, Samples::Bits8(self.demosaiced(0, 1)?)),
            "bayer_bggr8" => (3, Samples::Bits8(self.demosaiced(1, 1)?)),
            other => {
                return Err(format!(
                    "pictures in {other}, expected mono8, mono16, rgb8, bgr8, rgba8, bgra8, rgb16, bgr16 or bayer_*8"
                ));
            }
        };
        // A recording holds no picture whose side is beyond 32 bits.
        Ok(Frame { width: self.width as u32, height: self.height as u32, channels, samples })
    }

    /// The rows, each of so many bytes a pixel, without what pads them.
    fn rows(&self, bytes: usize) -> CdrResult<impl Iterator<Item = &'a [u8]>> {
        let wanted = self.width.checked_mul(bytes).filter(|wanted| *wanted > 0 && *wanted <= self.step);
        let whole = self.step.checked_mul(self.height).filter(|whole| *whole > 0 && *whole <= self.data.len());
        let (Some(wanted), Some(whole)) = (wanted, whole) else {
            let Self { width, height, step, data, .. } = self;
            let message = format!("{width}×{height} px in rows of {step} bytes do not fit {} bytes", data.len());
            return Err(message);
        };
        Ok(self.data[..whole].chunks_exact(self.step).map(move |row| &row[..wanted]))
    }

    /// Some bytes of each pixel, in this order.
    fn pixels<const N: usize>(&self, bytes: usize, order: [usize; N]) -> CdrResult<Vec<u8>> {
        let pixels = self.rows(bytes)?.flat_map(move |row| row.chunks_exact(bytes));
        Ok(pixels.flat_map(|pixel| order.map(|channel| pixel[channel])).collect())
    }

    /// All numbers of 16 bits of each pixel, in this order.
    fn pixels_of_16_bits<const N: usize>(&self, order: [usize; N]) -> CdrResult<Vec<u16>> {
        let number = |pixel: &[u8], channel: usize| {
            let pair = [pixel[2 * channel], pixel[2 * channel + 1]];
            if self.is_big_endian { u16::from_be_bytes(pair) } else { u16::from_le_bytes(pair) }
        };
        let pixels = self.rows(2 * N)?.flat_map(|row| row.chunks_exact(2 * N));
        Ok(pixels.flat_map(|pixel| order.map(|channel| number(pixel, channel))).collect())
    }

    /// Red, green and blue from a mosaic whose red pixels have these parities of column and row: each colour is the mean of its
    /// pixels among the nine around (bilinear interpolation).
    fn demosaiced(&self, red_column: usize, red_row: usize) -> CdrResult<Vec<u8>> {
        let rows: Vec<&[u8]> = self.rows(1)?.collect();
        let mut pixels = Vec::with_capacity(3 * self.width * self.height);
        for y in 0..self.height {
            for x in 0..self.width {
                let (mut sums, mut counts) = ([0u32; 3], [0u32; 3]);
                let own = colour(x, y, red_column, red_row);
                for (v, row) in rows.iter().enumerate().take(y + 2).skip(y.saturating_sub(1)) {
                    for (u, &level) in row.iter().enumerate().take(x + 2).skip(x.saturating_sub(1)) {
                        let of = colour(u, v, red_column, red_row);
                        if of != own || (u, v) == (x, y) {
                            sums[of] += u32::from(level);
                            counts[of] += 1;
                        }
                    }
                }
                pixels.extend([0, 1, 2].map(|c| ((sums[c] + counts[c] / 2) / counts[c].max(1)) as u8));
            }
        }
        Ok(pixels)
    }
}

/// The colour of a pixel of a mosaic: 0 red, 1 green, 2 blue.
fn colour(x: usize, y: usize, red_column: usize, red_row: usize) -> usize {
    (x + red_column) % 2 + (y + red_row) % 2
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::FrameSource;
    use nalgebra::{Point2, Vector2};
    use std::path::PathBuf;

    /// Written by the Python package rosbags: tests/golden/ros2.py.
    fn golden(topic: &str) -> Topic {
        Topic { bag: PathBuf::from("tests/golden/ros2.mcap").into(), topic: topic.to_owned() }
    }

    /// What the script draws: 40 x + 10 y + channel.
    fn is_drawn(frame: &Frame) -> bool {
        let channels = frame.channels;
        (frame.width, frame.height) == (6, 4)
            && (0..4).all(|y| {
                (0..6).all(|x| (0..channels).all(|c| frame.get(x, y, c) == (40 * x + 10 * y) as f32 + c as f32))
            })
    }

    #[test]
    fn compressed_frames_come_with_their_times_and_in_order() {
        let source = FrameSource::of_topic(golden("/camera/image_raw/compressed")).unwrap();
        assert_eq!(source.count().unwrap(), Some(3));
        let frames: Vec<_> = source.frames().unwrap().collect();
        assert_eq!(frames.iter().map(|frame| frame.index).collect::<Vec<_>>(), [0, 1, 2]);
        let tenths = frames.iter().map(|frame| (10.0 * (frame.time_s.unwrap() - 1.7e9)).round());
        assert_eq!(tenths.collect::<Vec<_>>(), [1.0, 3.0, 5.0]);
        assert!(frames.into_iter().all(|frame| is_drawn(&frame.read().unwrap())));
        let wrong = FrameSource::of_topic(golden("/joint_states")).unwrap_err().to_string();
        assert!(wrong.contains("expected sensor_msgs/CompressedImage or sensor_msgs/Image"), "{wrong}");
    }

    #[test]
    fn raw_frames_of_every_layout_are_read_without_their_padding() {
        for (encoding, channels) in [("mono8", 1), ("bgr8", 3), ("rgb8", 3)] {
            let picture: Picture = golden(&format!("/raw/{encoding}")).first().unwrap();
            assert!(picture.frame.channels == channels && is_drawn(&picture.frame), "{encoding}");
        }
        let bayer: Picture = golden("/raw/bayer").first().unwrap();
        for (x, y) in [(0, 0), (3, 1), (2, 3), (5, 2)] {
            let colour = [0, 1, 2].map(|c| bayer.frame.get(x, y, c));
            assert_eq!(colour, [200.0, 100.0, 50.0], "one colour everywhere, {x} {y}");
        }
        let image = |encoding: &str, step, data| RawImage {
            height: 2,
            width: 2,
            encoding: encoding.to_owned(),
            is_big_endian: true,
            step,
            data,
        };
        let deep = image("mono16", 4, &[1, 0, 2, 0, 3, 0, 255, 255]).frame().unwrap();
        assert_eq!(deep.samples, Samples::Bits16(vec![256, 512, 768, 65535]));
        let bytes = [0, 3, 0, 2, 0, 1, 0, 6, 0, 5, 0, 4].repeat(2);
        let deep = image("bgr16", 12, &bytes).frame().unwrap();
        assert_eq!(deep.samples, Samples::Bits16([1, 2, 3, 4, 5, 6].repeat(2)));
        for (encoding, step, data) in
            [("rgb8", 4, &[0; 8][..]), ("mono8", 2, &[0; 3]), ("mono8", usize::MAX, &[0; 3]), ("yuv422", 4, &[0; 8])]
        {
            assert!(image(encoding, step, data).frame().is_err(), "{encoding}");
        }
    }

    #[test]
    fn a_lens_is_that_of_the_camera_info() {
        let lens = Lens::of_topic(&golden("/camera/camera_info")).unwrap();
        assert_eq!((lens.width, lens.height), (640, 480));
        assert_eq!((lens.focal_px, lens.centre_px), (Vector2::new(900.0, 910.0), Point2::new(320.5, 240.5)));
        assert_eq!(lens.distortion[..6], [0.1, -0.2, 0.001, 0.002, 0.03, 0.0]);
    }
}
