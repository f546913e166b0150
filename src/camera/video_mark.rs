//! The mark by which a phone's video asks to be turned. OpenCV's versions read it differently (opencv#22088: 4.6 turns the other way round), so that
//! it is read here, of MP4 and MOV files.
//!
//! ISO/IEC 14496-12: a file is a row of boxes, each with its length (32 bits, big-endian) and kind before its content; `moov` holds a `trak` for each
//! track, and its `tkhd` ends in a matrix of nine fixed-point numbers and the picture's width and height. The first two numbers, a and b, are the
//! cosine and the sine of the clockwise turn.

use image::metadata::Orientation;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// The longest `moov` that is read, bytes.
///
/// Convention: an hour at 60 frames a second has some MB.
const MOST_BYTES: u64 = 64 << 20;
/// The bytes of the end of a `tkhd`: matrix, width and height.
///
/// Source: ISO/IEC 14496-12, 8.3.2.
const TAIL_BYTES: usize = 9 * 4 + 2 * 4;

/// How a video asks to be turned; not at all where it is of another kind, or says nothing.
pub(super) fn of(path: &Path) -> Orientation {
    let moov = || moov_of(&mut File::open(path).ok()?);
    moov().and_then(|moov| turn(&moov)).unwrap_or(Orientation::NoTransforms)
}

/// The content of the file's `moov`.
fn moov_of(file: &mut File) -> Option<Vec<u8>> {
    let end = file.metadata().ok()?.len();
    let mut at = 0;
    while at + 8 <= end {
        file.seek(SeekFrom::Start(at)).ok()?;
        let mut head = [0; 16];
        let read = file.by_ref().take(16).read(&mut head).ok()?;
        let (length, kind) = (u64::from(u32::from_be_bytes(head[..4].try_into().ok()?)), &head[4..8]);
        // A length of 1 stands for one of 64 bits behind the kind, one of 0 for all that is left.
        let (length, header) = match length {
            0 => (end - at, 8),
            1 if read == 16 => (u64::from_be_bytes(head[8..].try_into().ok()?), 16),
            other => (other, 8),
        };
        if kind == b"moov" && length <= MOST_BYTES {
            file.seek(SeekFrom::Start(at + header)).ok()?;
            let mut content = Vec::new();
            file.take(length.checked_sub(header)?).read_to_end(&mut content).ok()?;
            return Some(content);
        }
        at = at.checked_add(length.max(8))?;
    }
    None
}

/// The boxes of some content: kind and content of each.
fn boxes(mut content: &[u8]) -> impl Iterator<Item = (&[u8], &[u8])> {
    std::iter::from_fn(move || {
        let length = u32::from_be_bytes(content.get(..4)?.try_into().ok()?) as usize;
        let (this, rest) = (content.get(8..length)?, content.get(length..)?);
        let kind = &content[4..8];
        content = rest;
        Some((kind, this))
    })
}

/// The turn of the first track that has a picture.
fn turn(moov: &[u8]) -> Option<Orientation> {
    let tracks = boxes(moov).filter(|(kind, _)| *kind == b"trak");
    let headers = tracks.filter_map(|(_, track)| boxes(track).find(|(kind, _)| *kind == b"tkhd"));
    let tails = headers.filter_map(|(_, header)| header.get(header.len().checked_sub(TAIL_BYTES)?..));
    let number = |tail: &[u8], k: usize| tail.get(4 * k..4 * k + 4)?.try_into().ok().map(i32::from_be_bytes);
    let picture = tails.into_iter().find(|tail| number(tail, 9).is_some_and(|width| width != 0))?;
    Some(match (number(picture, 0)?.signum(), number(picture, 1)?.signum()) {
        (0, 1) => Orientation::Rotate90,
        (0, -1) => Orientation::Rotate270,
        (-1, 0) => Orientation::Rotate180,
        _ => Orientation::NoTransforms,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn boxed(kind: &[u8; 4], content: &[u8]) -> Vec<u8> {
        [&(content.len() as u32 + 8).to_be_bytes(), &kind[..], content].concat()
    }

    /// A video of one track of sound and one of pictures with this matrix's first two numbers.
    fn video(a: i32, b: i32) -> Vec<u8> {
        let header = |numbers: [i32; 2], width: i32| {
            let fields =
                [numbers[0], numbers[1], 0, -numbers[1], numbers[0], 0, 0, 0, 1 << 30, width << 16, width << 16];
            [vec![0; 40], fields.map(i32::to_be_bytes).concat()].concat()
        };
        let track = |header: Vec<u8>| boxed(b"trak", &boxed(b"tkhd", &header));
        let moov = boxed(b"moov", &[track(header([1 << 16, 0], 0)), track(header([a, b], 720))].concat());
        [boxed(b"ftyp", b"isom"), boxed(b"mdat", &[7; 99]), moov].concat()
    }

    #[test]
    fn the_turn_is_that_of_the_track_that_has_a_picture() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("v.mp4");
        let one = 1 << 16;
        for (a, b, expected) in [
            (one, 0, Orientation::NoTransforms),
            (0, one, Orientation::Rotate90),
            (0, -one, Orientation::Rotate270),
            (-one, 0, Orientation::Rotate180),
        ] {
            std::fs::write(&path, video(a, b)).unwrap();
            assert_eq!(of(&path), expected);
        }
        for end in 0..video(0, one).len() - 1 {
            std::fs::write(&path, &video(0, one)[..end]).unwrap();
            assert_eq!(of(&path), Orientation::NoTransforms, "cut at {end}");
        }
    }
}
