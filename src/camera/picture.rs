//! How a picture is read from a file.

use super::{Frame, Lens, stack};
use crate::content;
use crate::error::{Error, Result};
use crate::input::{PICTURE_BYTES, read_bytes};
use image::metadata::Orientation;
use image::{ColorType, DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Seek};
use std::path::Path;

/// The largest picture that is read, in pixels; larger ones are taken for a mistake or an attack.
///
/// Convention: a limit on what is decoded.
const MAX_PIXELS: u64 = 100_000_000;
/// The longest side, px.
///
/// Convention: a limit on what is decoded.
const MAX_SIDE: u32 = 65_535;
/// The most that a decoder may allocate: four channels of 16 bits.
///
/// Convention: a limit on what is decoded.
const MAX_BYTES: u64 = 8 * MAX_PIXELS;

/// Reads a picture: PNG, JPEG, TIFF or BMP (told by content, not by name), 8 or 16 bits, grey or colour.
///
/// The pixels are taken as they are stored; an orientation mark (EXIF) is not obeyed, because the camera file knows the
/// sensor's own rows and columns; see [`read_frame_for`]. What follows the end of a JPEG picture, such as a phone's clip, is no part of it.
///
/// # Errors
/// Something that is no file (a pipe is not waited for), cannot be read, has another format, is damaged or cut short, has more than 100
/// megapixels or 65,535 px in a row or column, or would take more memory than such a picture does.
pub fn read_frame(path: &Path) -> Result<Frame> {
    if !std::fs::metadata(path).map_err(Error::io(path, "read"))?.is_file() {
        return Err(Error::content(path, "no file, expected a picture"));
    }
    let bytes = read_bytes(path, PICTURE_BYTES)?;
    decode_frame(&bytes).map_err(|message| Error::content(path, message))
}

/// Width and height, px, that a picture file's header tells, without decoding it; `None` where it tells none.
pub fn picture_size(path: &Path) -> Option<(u32, u32)> {
    header_of(path)?.with_guessed_format().ok()?.into_dimensions().ok()
}

/// Where a picture is read from. Decoders are large, and are compiled once for all of these.
pub(super) trait PictureSource: BufRead + Seek {}

impl<T: BufRead + Seek> PictureSource for T {}

/// A reader of a picture.
type PictureReader<'a> = ImageReader<Box<dyn PictureSource + 'a>>;

/// A reader of a picture's bytes.
fn reader_of(bytes: &[u8]) -> PictureReader<'_> {
    ImageReader::new(Box::new(Cursor::new(bytes)))
}

/// A reader of a picture's file, for its header; `None` for what is no file.
fn header_of(path: &Path) -> Option<PictureReader<'static>> {
    let file = if path.is_file() { File::open(path).ok()? } else { return None };
    Some(ImageReader::new(Box::new(BufReader::new(file))))
}

/// A picture as a camera file knows it: as it is stored, or turned as its mark (EXIF) asks if only that gives it the camera's width and height.
///
/// # Errors
/// Those of [`read_frame`].
pub fn read_frame_for(path: &Path, lens: &Lens) -> Result<Frame> {
    Ok(read_frame(path)?.turned_for(lens, || rotation_mark(path)))
}

/// Width and height, px, that [`read_frame_for`] gives a picture file, without decoding it; `None` where its header tells none.
pub fn picture_size_for(path: &Path, lens: &Lens) -> Option<(u32, u32)> {
    let (width, height) = picture_size(path)?;
    let is_turned = (width, height) == (lens.height, lens.width)
        && matches!(rotation_mark(path), Orientation::Rotate90 | Orientation::Rotate270);
    Some(if is_turned { (height, width) } else { (width, height) })
}

/// How a picture file asks to be turned (EXIF).
pub fn rotation_mark(path: &Path) -> Orientation {
    header_of(path).map_or(Orientation::NoTransforms, mark_in)
}

/// How a picture asks to be turned.
fn mark_in(reader: PictureReader) -> Orientation {
    let read = || reader.with_guessed_format().ok()?.into_decoder().ok()?.orientation().ok();
    read().unwrap_or(Orientation::NoTransforms)
}

/// [`decode_frame`], turned as [`read_frame_for`] turns a file.
///
/// # Errors
/// Those of [`decode_frame`].
pub fn decode_frame_for(bytes: &[u8], lens: &Lens) -> std::result::Result<Frame, String> {
    Ok(decode_frame(bytes)?.turned_for(lens, || mark_in(reader_of(bytes))))
}

/// A picture from the bytes of its file; see [`read_frame`].
///
/// # Errors
/// Bytes that are no such picture, in words.
pub fn decode_frame(bytes: &[u8]) -> std::result::Result<Frame, String> {
    if bytes.is_empty() {
        return Err("empty file, expected a picture".to_owned());
    }
    let bytes = match image::guess_format(bytes) {
        Ok(ImageFormat::Jpeg) => &bytes[..jpeg_end(bytes).ok_or("the JPEG file is cut short")?],
        Ok(ImageFormat::Tiff) => match stack::pages(&mut Cursor::new(bytes)) {
            Ok(pages) if pages.len() > 1 => {
                return Err(format!(
                    "a stack of {} pages, expected one picture; if its pages are the frames, name it alone as `frames`",
                    pages.len()
                ));
            }
            _ => bytes,
        },
        Ok(ImageFormat::Png | ImageFormat::Bmp) => bytes,
        _ => {
            let found = content::name_of(bytes).unwrap_or("no picture that is known");
            return Err(format!("{found}, expected PNG, JPEG, TIFF or BMP"));
        }
    };
    let mut reader = reader_of(bytes).with_guessed_format().map_err(|e| format!("unreadable picture: {e}"))?;
    reader.limits(limits());
    decoded(reader.into_decoder().map_err(unreadable)?)
}

fn limits() -> Limits {
    let mut limits = Limits::no_limits();
    limits.max_alloc = Some(MAX_BYTES);
    limits
}

/// What a picture may have at most, in words.
fn expected() -> String {
    format!("expected at most {} megapixels and {MAX_SIDE} px a side", MAX_PIXELS / 1_000_000)
}

/// Why a picture cannot be decoded, in words.
pub(super) fn unreadable(e: image::ImageError) -> String {
    match e {
        image::ImageError::Limits(_) => format!("takes more than {MAX_BYTES} bytes to decode, {}", expected()),
        e => format!("unreadable picture (expected PNG, JPEG, TIFF or BMP): {e}"),
    }
}

/// The picture of a decoder that has read the header alone.
///
/// # Errors
/// A picture that is too large or damaged, in words.
pub(super) fn decoded(mut decoder: impl ImageDecoder) -> std::result::Result<Frame, String> {
    // Sizes are checked here, and not by the decoder, so that the message can name them.
    let (expected, mut limits) = (expected(), limits());
    let (width, height) = decoder.dimensions();
    if u64::from(width) * u64::from(height) > MAX_PIXELS || width.max(height) > MAX_SIDE {
        return Err(format!("{width}×{height} px, {expected}"));
    }
    if decoder.total_bytes() > MAX_BYTES {
        let (found, kind) = (decoder.total_bytes(), decoder.color_type());
        return Err(format!("{width}×{height} px of {kind:?} take {found} bytes, expected at most {MAX_BYTES}"));
    }
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    decoder.set_limits(limits).map_err(unreadable)?;
    let colour: ColorType = decoder.color_type();
    let image = DynamicImage::from_decoder(decoder).map_err(unreadable)?;
    let other = || format!("{colour:?} pixels, whose white is not defined; write 8 or 16 bits, grey or colour");
    Frame::from_image(image).ok_or_else(other)
}

/// Where a JPEG picture ends: behind the end-of-image marker of its own, whatever follows. `None` where it is cut short; the decoder itself
/// fills what is missing with grey.
///
/// Segments are passed over by their lengths, so that the marker of a preview in one of them does not count. Within a scan 0xff is followed by 0
/// or a restart marker.
///
/// Source: ITU-T T.81, section B.1.1.
fn jpeg_end(bytes: &[u8]) -> Option<usize> {
    /// Source: T.81, table B.1: end of image.
    const END: u8 = 0xd9;
    /// Source: T.81, table B.1: start of scan.
    const SCAN: u8 = 0xda;
    let mut at = 2;
    loop {
        // Fill bytes may stand before a marker.
        let marker = match bytes.get(at..at + 2)? {
            [0xff, 0xff] => {
                at += 1;
                continue;
            }
            [0xff, marker] => *marker,
            _ => return None,
        };
        at += 2;
        match marker {
            END => return Some(at),
            0x01 | 0xd0..=0xd8 => continue,
            _ => {}
        }
        let length = bytes.get(at..at + 2)?;
        at += usize::from(u16::from_be_bytes([length[0], length[1]]));
        if marker == SCAN {
            let is_marker = |pair: &[u8]| pair[0] == 0xff && !matches!(pair[1], 0x00 | 0xd0..=0xd7);
            at += bytes.get(at..)?.windows(2).position(is_marker)?;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayAlphaImage, GrayImage, ImageBuffer, Luma, Rgb, RgbImage, RgbaImage};

    fn encoded(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn every_depth_and_layout_gives_the_same_grey_levels() {
        let level = |x: u32, y: u32, c: u32| (40 * x + 10 * y + c) as u8;
        let grey = GrayImage::from_fn(5, 4, |x, y| Luma([level(x, y, 0)]));
        let rgb = RgbImage::from_fn(5, 4, |x, y| Rgb([0, 1, 2].map(|c| level(x, y, c))));
        let rgb16 = ImageBuffer::from_fn(5, 4, |x, y| Rgb([0, 1, 2].map(|c| u16::from(level(x, y, c)) * 257)));
        let grey16 = ImageBuffer::from_fn(5, 4, |x, y| Luma([u16::from(level(x, y, 0)) * 257]));
        let pictures = [
            (1, DynamicImage::from(grey.clone())),
            (3, rgb.clone().into()),
            (1, DynamicImage::ImageLuma16(grey16)),
            (3, DynamicImage::ImageRgb16(rgb16)),
            (1, DynamicImage::ImageLumaA8(GrayAlphaImage::from(DynamicImage::from(grey).to_luma_alpha8()))),
            (3, DynamicImage::ImageRgba8(RgbaImage::from(DynamicImage::from(rgb).to_rgba8()))),
        ];
        for (channels, picture) in &pictures {
            for format in [ImageFormat::Png, ImageFormat::Tiff] {
                if format == ImageFormat::Tiff && picture.color() == ColorType::La8 {
                    continue; // the encoder does not write it
                }
                let frame = decode_frame(&encoded(picture, format)).unwrap();
                assert_eq!((frame.width, frame.height, frame.channels), (5, 4, *channels));
                for (x, y) in [(0, 0), (4, 0), (3, 2), (4, 3)] {
                    for c in 0..*channels {
                        assert_eq!(frame.get(x, y, c), f32::from(level(x, y, c as u32)), "{:?}", picture.color());
                    }
                }
            }
        }
    }

    #[test]
    fn jpeg_is_read() {
        let picture = DynamicImage::from(RgbImage::from_pixel(16, 8, Rgb([200, 100, 50])));
        let frame = decode_frame(&encoded(&picture, ImageFormat::Jpeg)).unwrap();
        assert_eq!((frame.width, frame.height, frame.channels), (16, 8, 3));
        for (c, level) in [200.0, 100.0, 50.0].into_iter().enumerate() {
            assert!((frame.get(7, 7, c) - level).abs() < 4.0);
        }
    }

    #[test]
    fn damaged_files_are_errors() {
        let picture = DynamicImage::from(RgbImage::from_fn(64, 64, |x, y| Rgb([(x * y) as u8, x as u8, y as u8])));
        for format in [ImageFormat::Png, ImageFormat::Jpeg, ImageFormat::Tiff] {
            let whole = encoded(&picture, format);
            decode_frame(&whole).unwrap();
            for kept in [0, 1, 10, whole.len() / 4, whole.len() / 2, whole.len() * 9 / 10] {
                assert!(decode_frame(&whole[..kept]).is_err(), "{format:?} cut to {kept} of {} bytes", whole.len());
            }
        }
        assert!(decode_frame(b"this is no picture").unwrap_err().contains("expected PNG, JPEG, TIFF or BMP"));
        assert!(decode_frame(b"\0\0\0\x18ftypheic").unwrap_err().contains("a HEIC picture"));
    }

    #[test]
    fn what_follows_a_jpeg_is_no_part_of_it() {
        let picture = DynamicImage::from(RgbImage::from_fn(64, 64, |x, y| Rgb([(x * y) as u8, x as u8, y as u8])));
        let jpeg = encoded(&picture, ImageFormat::Jpeg);
        let expected = decode_frame(&jpeg).unwrap();
        for trailer in [&b"\xff\xda and \xff\xd8 of a clip"[..], &jpeg[..jpeg.len() / 2], b"\0\0\0\x18ftypmp42"] {
            assert_eq!(decode_frame(&[&jpeg[..], trailer].concat()).unwrap(), expected);
        }
        // A preview in a segment of its own has its own end of image, which is not the picture's.
        let preview = [&[0xff, 0xe1, 0, 8][..], &[0xff, 0xd8, 0xff, 0xd9, 0, 0]].concat();
        let with_preview = [&jpeg[..2], &preview, &jpeg[2..]].concat();
        assert_eq!(decode_frame(&with_preview).unwrap(), expected);
        assert!(decode_frame(&with_preview[..with_preview.len() * 2 / 3]).unwrap_err().contains("cut short"));
    }

    #[test]
    fn ten_and_twelve_bits_in_sixteen_fill_them() {
        let picture = |white: u16| {
            let image = ImageBuffer::from_fn(8, 1, |x, _| Luma([(u32::from(white) * x / 7) as u16]));
            decode_frame(&encoded(&DynamicImage::ImageLuma16(image), ImageFormat::Png)).unwrap()
        };
        for (white, least) in [(1023, 250.0), (4095, 250.0), (65_535, 254.9), (16_000, 62.0)] {
            let brightest = picture(white).get(7, 0, 0);
            assert!((brightest - least).abs() < 6.0, "{white}: {brightest}");
        }
    }

    #[test]
    fn a_bmp_is_read_and_a_stack_is_named_by_its_pages() {
        let picture = DynamicImage::from(RgbImage::from_fn(5, 4, |x, y| Rgb([x as u8, y as u8, 7])));
        let (bmp, png) = (encoded(&picture, ImageFormat::Bmp), encoded(&picture, ImageFormat::Png));
        assert_eq!(decode_frame(&bmp).unwrap(), decode_frame(&png).unwrap());
        let float = DynamicImage::ImageRgb32F(picture.to_rgb32f());
        assert!(decode_frame(&encoded(&float, ImageFormat::Tiff)).unwrap_err().contains("whose white is not defined"));
    }

    #[test]
    fn a_picture_bomb_is_refused_before_it_is_decoded() {
        for (width, height) in [(60_000u32, 60_000u32), (1, 70_000), (70_000, 1)] {
            // A PNG header that claims so many pixels, its checksum computed as PNG wants it.
            let mut bytes = encoded(&DynamicImage::from(GrayImage::new(1, 1)), ImageFormat::Png);
            bytes[16..20].copy_from_slice(&width.to_be_bytes());
            bytes[20..24].copy_from_slice(&height.to_be_bytes());
            let crc = crc32(&bytes[12..29]);
            bytes[29..33].copy_from_slice(&crc.to_be_bytes());
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("bomb.png");
            std::fs::write(&path, &bytes).unwrap();
            let message = read_frame(&path).unwrap_err().to_string();
            for part in ["bomb.png: ", &format!("{width}×{height} px"), "at most 100 megapixels and 65535 px"] {
                assert!(message.contains(part), "{message}");
            }
        }
    }

    #[test]
    fn what_a_picture_inflates_to_is_limited_too() {
        // 90 megapixels of four 32-bit channels pass as pixels and not as memory. TIFF: a header of ten tags, no pixels.
        let tag = |id: u16, kind: u16, count: u32, value: u32| {
            [&id.to_le_bytes()[..], &kind.to_le_bytes(), &count.to_le_bytes(), &value.to_le_bytes()].concat()
        };
        let (bits, end) = (8 + 2 + 10 * 12 + 4, 8 + 2 + 10 * 12 + 4 + 16);
        let mut bytes = [&b"II"[..], &42u16.to_le_bytes(), &8u32.to_le_bytes(), &10u16.to_le_bytes()].concat();
        for (id, kind, count, value) in [
            (256, 4, 1, 9_000),
            (257, 4, 1, 10_000),
            (258, 3, 4, bits),
            (259, 3, 1, 1),
            (262, 3, 1, 2),
            (273, 4, 1, end),
            (277, 3, 1, 4),
            (278, 4, 1, 10_000),
            (279, 4, 1, 1_440_000_000),
            (339, 3, 4, bits + 8),
        ] {
            bytes.extend(tag(id, kind, count, value));
        }
        bytes.extend(0u32.to_le_bytes());
        bytes.extend([32u16, 32, 32, 32, 3, 3, 3, 3].iter().flat_map(|value| value.to_le_bytes()));
        let message = decode_frame(&bytes).unwrap_err();
        assert!(message.contains("1440000000 bytes, expected at most 800000000"), "{message}");
    }

    fn crc32(bytes: &[u8]) -> u32 {
        let step = |crc: u32| if crc & 1 == 1 { (crc >> 1) ^ 0xedb8_8320 } else { crc >> 1 };
        !bytes.iter().fold(!0, |crc, &byte| (0..8).fold(crc ^ u32::from(byte), |crc, _| step(crc)))
    }
}
