//! One picture in memory.

use super::Lens;
use image::DynamicImage;
use image::metadata::Orientation;

/// A picture: grey or RGB, the file's numbers (gamma-encoded).
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Width, px.
    pub width: u32,
    /// Height, px.
    pub height: u32,
    /// 1 (grey) or 3 (red, green, blue).
    pub channels: usize,
    /// Row by row, the channels of a pixel side by side: `height × width × channels` numbers.
    pub samples: Samples,
}

/// A picture's numbers, as its file has them.
#[derive(Debug, Clone, PartialEq)]
pub enum Samples {
    /// From 0 to 255.
    Bits8(Vec<u8>),
    /// From 0 to 65,535.
    Bits16(Vec<u16>),
}

/// A number of a picture of either depth.
pub trait Sample: Copy + Into<usize> {
    /// On the scale from 0 to 255.
    fn level(self) -> f32;
}

impl Sample for u8 {
    fn level(self) -> f32 {
        f32::from(self)
    }
}

impl Sample for u16 {
    fn level(self) -> f32 {
        /// Convention: the scale of 8-bit pictures.
        const LEVEL: f32 = 257.0;
        f32::from(self) / LEVEL
    }
}

impl Frame {
    /// The frame as it is, or turned by a quarter as its mark asks if only that gives it the width and height of the camera file.
    #[must_use]
    pub fn turned_for(self, lens: &Lens, mark: impl FnOnce() -> Orientation) -> Self {
        let is_turned = (self.width, self.height) == (lens.height, lens.width) && self.width != self.height;
        match if is_turned { mark() } else { Orientation::NoTransforms } {
            Orientation::Rotate90 => self.turned(true),
            Orientation::Rotate270 => self.turned(false),
            _ => self,
        }
    }

    /// The frame turned by a quarter, clockwise or the other way.
    fn turned(self, clockwise: bool) -> Self {
        let (width, height) = (self.height, self.width);
        let from = |k: usize| {
            let (x, y) = (k % width as usize, k / width as usize);
            let (x, y) = if clockwise { (y, self.height as usize - 1 - x) } else { (self.width as usize - 1 - y, x) };
            (y * self.width as usize + x) * self.channels
        };
        fn moved<T: Copy>(samples: &[T], pixels: usize, channels: usize, from: impl Fn(usize) -> usize) -> Vec<T> {
            (0..pixels).flat_map(|k| &samples[from(k)..][..channels]).copied().collect()
        }
        let pixels = width as usize * height as usize;
        let samples = match &self.samples {
            Samples::Bits8(samples) => Samples::Bits8(moved(samples, pixels, self.channels, from)),
            Samples::Bits16(samples) => Samples::Bits16(moved(samples, pixels, self.channels, from)),
        };
        Self { width, height, channels: self.channels, samples }
    }
}

impl Samples {
    /// How many there are.
    pub fn len(&self) -> usize {
        match self {
            Self::Bits8(samples) => samples.len(),
            Self::Bits16(samples) => samples.len(),
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// One of them, from 0 to 255.
    ///
    /// # Panics
    /// Beyond the last, as indexing a slice does.
    pub fn level(&self, index: usize) -> f32 {
        match self {
            Self::Bits8(samples) => samples[index].level(),
            Self::Bits16(samples) => samples[index].level(),
        }
    }
}

impl Frame {
    /// Channel `c` of the pixel in column `x`, row `y`, from 0 to 255.
    ///
    /// # Panics
    /// Outside the picture, as indexing a slice does.
    pub fn get(&self, x: u32, y: u32, c: usize) -> f32 {
        self.samples.level((y as usize * self.width as usize + x as usize) * self.channels + c)
    }

    /// From a decoded picture of 8 or 16 bits; alpha is dropped, and 10 or 12 bits that are written into 16 fill them. `None` for any other depth.
    pub fn from_image(image: DynamicImage) -> Option<Self> {
        let (width, height) = (image.width(), image.height());
        let (channels, samples) = match image {
            DynamicImage::ImageLuma8(p) => (1, Samples::Bits8(p.into_raw())),
            DynamicImage::ImageLumaA8(p) => (1, Samples::Bits8(without_alpha(&p, 1))),
            DynamicImage::ImageRgb8(p) => (3, Samples::Bits8(p.into_raw())),
            DynamicImage::ImageRgba8(p) => (3, Samples::Bits8(without_alpha(&p, 3))),
            DynamicImage::ImageLuma16(p) => (1, Samples::Bits16(p.into_raw())),
            DynamicImage::ImageLumaA16(p) => (1, Samples::Bits16(without_alpha(&p, 1))),
            DynamicImage::ImageRgb16(p) => (3, Samples::Bits16(p.into_raw())),
            DynamicImage::ImageRgba16(p) => (3, Samples::Bits16(without_alpha(&p, 3))),
            _ => return None,
        };
        let samples = match samples {
            Samples::Bits16(samples) => Samples::Bits16(filling_16_bits(samples)),
            samples => samples,
        };
        Some(Self { width, height, channels, samples })
    }
}

/// Numbers of 10 or 12 bits that are written into 16 as they are, shifted to the top; others as they are.
///
/// Derived: a picture of 16 bits none of whose pixels reaches 1/16 of white shows nothing, so that none that could be measured is changed.
fn filling_16_bits(mut samples: Vec<u16>) -> Vec<u16> {
    let brightest = samples.iter().copied().max().unwrap_or(0);
    let bits = [10, 12].into_iter().find(|bits| brightest < 1 << bits);
    if let Some(bits) = bits.filter(|_| brightest > 0) {
        samples.iter_mut().for_each(|sample| *sample <<= 16 - bits);
    }
    samples
}

/// The samples of pixels with so many channels and alpha after them.
fn without_alpha<T: Copy>(samples: &[T], channels: usize) -> Vec<T> {
    samples.chunks_exact(channels + 1).flat_map(|pixel| &pixel[..channels]).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_turned_as_its_mark_asks_only_if_the_camera_file_is_of_the_turned_size() {
        let stored = Frame { width: 2, height: 3, channels: 1, samples: Samples::Bits8(vec![1, 2, 3, 4, 5, 6]) };
        let lens = |width, height| Lens { width, height, ..crate::simulate::scene::Scene::default().lens };
        let turned = |mark| stored.clone().turned_for(&lens(3, 2), || mark);
        assert_eq!(turned(Orientation::Rotate90).samples, Samples::Bits8(vec![5, 3, 1, 6, 4, 2]));
        assert_eq!(turned(Orientation::Rotate270).samples, Samples::Bits8(vec![2, 4, 6, 1, 3, 5]));
        assert_eq!((turned(Orientation::Rotate90).width, turned(Orientation::Rotate90).height), (3, 2));
        assert_eq!(turned(Orientation::NoTransforms), stored);
        assert_eq!(stored.clone().turned_for(&lens(2, 3), || Orientation::Rotate90), stored);
    }
}
