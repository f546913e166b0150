//! What a file is by its first bytes, whatever its name says.

/// A kind of file: the bytes that it has, where they stand, and what people call it.
struct Kind {
    at: usize,
    bytes: &'static [u8],
    name: &'static str,
}

const fn kind(at: usize, bytes: &'static [u8], name: &'static str) -> Kind {
    Kind { at, bytes, name }
}

/// Kinds of files that laboratories put in the place of another.
///
/// Source: the formats' own specifications, as collected in file(1)'s magic.
const KINDS: [Kind; 33] = [
    kind(0, b"\xff\xd8\xff", "a JPEG picture"),
    kind(0, b"\x89PNG\r\n\x1a\n", "a PNG picture"),
    kind(0, b"II*\0", "a TIFF picture"),
    kind(0, b"MM\0*", "a TIFF picture"),
    kind(0, b"II+\0", "a TIFF picture"),
    kind(0, b"MM\0+", "a TIFF picture"),
    kind(0, b"BM", "a BMP picture"),
    kind(0, b"GIF8", "a GIF picture"),
    kind(8, b"WEBP", "a WebP picture"),
    kind(4, b"ftyphei", "a HEIC picture, as iPhones take"),
    kind(4, b"ftypmif1", "a HEIC picture, as iPhones take"),
    kind(4, b"ftypavif", "an AVIF picture"),
    kind(0, b"FUJIFILM", "a raw picture of a camera"),
    kind(0, b"P5", "a PGM picture"),
    kind(0, b"P6", "a PPM picture"),
    kind(0, b"8BPS", "a Photoshop picture"),
    kind(0, b"SIMPLE  =", "a FITS picture"),
    kind(0, b"\x89MCAP0\r\n", "a ROS 2 recording (MCAP)"),
    kind(0, b"#ROSBAG V", "a ROS 1 recording"),
    kind(0, b"SQLite format 3", "an SQLite database, as ROS 2 records by default in older versions"),
    kind(0, b"PK\x03\x04", "a zip archive, such as an Excel workbook (.xlsx) or NumPy's .npz"),
    kind(0, b"\xd0\xcf\x11\xe0", "an old Excel workbook (.xls)"),
    kind(0, b"\x93NUMPY", "a NumPy array (.npy)"),
    kind(0, b"\x89HDF", "an HDF5 file, such as MATLAB's newer .mat"),
    kind(0, b"MATLAB 5.0", "a MATLAB file (.mat)"),
    kind(0, b"PAR1", "a Parquet table"),
    kind(0, b"\x80\x02", "a Python pickle"),
    kind(0, b"\x80\x03", "a Python pickle"),
    kind(0, b"\x80\x04", "a Python pickle"),
    kind(0, b"\x80\x05", "a Python pickle"),
    kind(0, b"\x1f\x8b", "a file packed by gzip"),
    kind(0, b"\x28\xb5\x2f\xfd", "a file packed by zstd"),
    kind(0, b"%PDF", "a PDF document"),
];

/// How many bytes of a file are enough to tell it.
///
/// Derived: three packets of a transport stream with stamps, 192 bytes each.
pub const HEAD_BYTES: usize = 3 * 192;

/// What a file with these first bytes is, in words with their article; `None` for text and for what is not known.
pub fn name_of(head: &[u8]) -> Option<&'static str> {
    if is_video(head) {
        return Some("a video");
    }
    if head.starts_with(&[0, 5, 0x16, 7]) || head.starts_with(&[0, 5, 0x16, 0]) {
        return Some("a file that macOS keeps beside another (AppleDouble)");
    }
    let is =
        |kind: &&Kind| head.get(kind.at..).is_some_and(|rest| rest.starts_with(kind.bytes)) && !is_text(head, kind);
    KINDS.iter().find(is).map(|kind| kind.name)
}

/// Whether a file that begins as one of a kind does is text all the same: two letters are the beginning of many a table's header.
fn is_text(head: &[u8], kind: &Kind) -> bool {
    kind.bytes.len() == 2
        && kind.bytes.is_ascii()
        && !head.contains(&0)
        && !head.get(2).is_some_and(u8::is_ascii_whitespace)
}

/// Whether a file with these first bytes is a video: MP4 and its kin, AVI, Matroska, ASF, Flash, Ogg, or a stream of MPEG or H.264.
///
/// Source: the containers' specifications: ISO 14496-12 (brands), RIFF, EBML, ISO 13818-1 (sync bytes), H.264 annex B (start codes).
pub fn is_video(head: &[u8]) -> bool {
    let has = |at: usize, bytes: &[u8]| head.get(at..).is_some_and(|rest| rest.starts_with(bytes));
    let is_still = ["heic", "heix", "mif1", "msf1", "avif"].iter().any(|brand| has(8, brand.as_bytes()));
    // A program or elementary stream of MPEG, or H.264 and H.265 whose first units are their parameters.
    let unit = |at: usize| matches!(head.get(at), Some(0xba | 0xb3 | 0x67 | 0x27 | 0x47 | 0x09 | 0x40));
    let is_stream = (has(0, &[0, 0, 1]) && unit(3)) || (has(0, &[0, 0, 0, 1]) && unit(4));
    let is_binary = || head.iter().any(|byte| *byte == 0 || *byte >= 0x80);
    let is_transport =
        |first: usize, step: usize| (0..3).all(|k| head.get(first + k * step) == Some(&0x47)) && is_binary();
    // A box of MP4 has its length before its name, which is below 16 MB.
    let has_box = |name: &[u8]| has(0, &[0]) && has(4, name);
    (has_box(b"ftyp") && !is_still)
        || (has_box(b"moov") || has_box(b"mdat") || has_box(b"wide"))
        || (has(0, b"RIFF") && has(8, b"AVI "))
        || has(0, b"\x1a\x45\xdf\xa3")
        || has(0, b"\x30\x26\xb2\x75")
        || has(0, b"FLV\x01")
        || has(0, b"OggS")
        || is_stream
        || is_transport(0, 188)
        || is_transport(4, 192)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_told_by_their_first_bytes() {
        let packets = |first: usize, step: usize| {
            let mut bytes = vec![0; first + 3 * step];
            (0..3).for_each(|k| bytes[first + k * step] = 0x47);
            bytes
        };
        for video in [
            b"\0\0\0\x18ftypmp42".to_vec(),
            b"\0\0\0\x18ftyp3gp5".to_vec(),
            b"RIFF\0\0\0\0AVI LIST".to_vec(),
            b"\x1a\x45\xdf\xa3\x01".to_vec(),
            packets(0, 188),
            packets(4, 192),
            vec![0, 0, 0, 1, 0x67, 0x42],
            vec![0, 0, 0, 1, 0x09, 0xf0],
            vec![0, 0, 1, 0xba],
        ] {
            assert_eq!(name_of(&video), Some("a video"), "{video:?}");
        }
        for (head, name) in [
            (&b"\xff\xd8\xff\xe1"[..], Some("a JPEG picture")),
            (b"RIFF\0\0\0\0WEBPVP8 ", Some("a WebP picture")),
            (b"\0\0\0\x18ftypheic", Some("a HEIC picture, as iPhones take")),
            (b"\0\x05\x16\x07\0\x02", Some("a file that macOS keeps beside another (AppleDouble)")),
            (b"index,time_s", None),
            (b"BM1,BM2\n0,1\n", None),
            (b"P5,P6\n0,1\n", None),
            (b"BM\x36\x10\0\0\0\0\0\0", Some("a BMP picture")),
            (b"P5\n640 480\n255\n", Some("a PGM picture")),
            (b"", None),
        ] {
            assert_eq!(name_of(head), name);
        }
    }
}
