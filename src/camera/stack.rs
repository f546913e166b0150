//! TIFF files of several pages, as ImageJ and Micro-Manager write a sequence.
//!
//! Source: TIFF 6.0, section 2 (header and directories); the BigTIFF design of Aware Systems.

use super::frame::Frame;
use super::picture::{PictureSource, decoded, unreadable};
use crate::error::{Error, Result};
use image::{ImageFormat, ImageReader};
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// More pages are no sequence that a person took.
///
/// Convention: a limit on what is read.
const MOST_PAGES: usize = 1_000_000;

/// How a file's numbers are written.
#[derive(Clone, Copy)]
struct Form {
    is_little_endian: bool,
    is_big: bool,
}

impl Form {
    /// That of a file; leaves it behind the header's first four bytes.
    fn of(file: &mut impl Read) -> io::Result<Self> {
        let mut magic = [0; 4];
        file.read_exact(&mut magic)?;
        let (is_little_endian, is_big) = match &magic {
            b"II*\0" => (true, false),
            b"MM\0*" => (false, false),
            b"II+\0" => (true, true),
            b"MM\0+" => (false, true),
            _ => return Err(io::ErrorKind::InvalidData.into()),
        };
        Ok(Self { is_little_endian, is_big })
    }

    /// A number of so many bytes.
    fn number(self, file: &mut impl Read, bytes: usize) -> io::Result<u64> {
        let mut read = [0; 8];
        file.read_exact(&mut read[..bytes])?;
        Ok(if self.is_little_endian { u64::from_le_bytes(read) } else { u64::from_be_bytes(read) >> (64 - 8 * bytes) })
    }

    /// Bytes of an offset.
    fn offset_bytes(self) -> usize {
        if self.is_big { 8 } else { 4 }
    }

    /// Where the header has the offset of the first page.
    fn first_page_at(self) -> u64 {
        if self.is_big { 8 } else { 4 }
    }
}

/// The positions of the directories of a TIFF file's pages, without those of reduced copies (previews).
///
/// # Errors
/// A file that is no TIFF file, or ends within a directory.
pub fn pages(file: &mut (impl Read + Seek)) -> io::Result<Vec<u64>> {
    file.rewind()?;
    let form = Form::of(file)?;
    file.seek(SeekFrom::Start(form.first_page_at()))?;
    let mut next = form.number(file, form.offset_bytes())?;
    let mut pages = Vec::new();
    let mut passed = 0;
    while next != 0 && passed < MOST_PAGES {
        let (at, is_reduced);
        (at, (next, is_reduced)) = (next, directory(form, file, next)?);
        // A chain that goes in a circle ends at the limit.
        passed += 1;
        if !is_reduced {
            pages.push(at);
        }
    }
    if passed == MOST_PAGES { Err(io::ErrorKind::InvalidData.into()) } else { Ok(pages) }
}

/// Where the next directory is, 0 after the last, and whether this one is of a reduced copy.
fn directory(form: Form, file: &mut (impl Read + Seek), at: u64) -> io::Result<(u64, bool)> {
    /// Source: TIFF 6.0, section 8: the tag of what kind of picture a directory has; its lowest bit is that of a reduced copy.
    const NEW_SUBFILE_TYPE: u64 = 254;
    let (count_bytes, entry_bytes) = if form.is_big { (8, 20) } else { (2, 12) };
    file.seek(SeekFrom::Start(at))?;
    let count = form.number(file, count_bytes)?;
    let mut is_reduced = false;
    // Tags are in order, and this is the least that is in use.
    if count > 0 && form.number(file, 2)? == NEW_SUBFILE_TYPE {
        let value_at = if form.is_big { 10 } else { 6 };
        file.seek(SeekFrom::Current(value_at))?;
        is_reduced = form.number(file, 4)? & 1 == 1;
    }
    let end = count.checked_mul(entry_bytes).and_then(|bytes| at.checked_add(count_bytes as u64)?.checked_add(bytes));
    file.seek(SeekFrom::Start(end.ok_or(io::ErrorKind::InvalidData)?))?;
    Ok((form.number(file, form.offset_bytes())?, is_reduced))
}

/// The pages of a file, where there are several.
///
/// # Errors
/// A file that cannot be opened.
pub fn pages_of(path: &Path) -> Result<Option<Vec<u64>>> {
    let file = File::open(path).map_err(Error::io(path, "read"))?;
    Ok(pages(&mut BufReader::new(file)).ok().filter(|pages| pages.len() > 1))
}

/// One page of a stack.
///
/// # Errors
/// As [`read_frame`](super::read_frame).
pub fn read_page(path: &Path, page: u64) -> Result<Frame> {
    let open = || -> io::Result<Page> {
        let mut file = File::open(path)?;
        let form = Form::of(&mut file)?;
        file.rewind()?;
        let bytes = form.offset_bytes();
        let first = if form.is_little_endian { page.to_le_bytes() } else { (page << (64 - 8 * bytes)).to_be_bytes() };
        Ok(Page { file, at: 0, patch_at: form.first_page_at(), patch: first[..bytes].to_vec() })
    };
    let file: Box<dyn PictureSource> = Box::new(BufReader::new(open().map_err(Error::io(path, "read"))?));
    let frame = ImageReader::with_format(file, ImageFormat::Tiff).into_decoder().map_err(unreadable).and_then(decoded);
    frame.map_err(|why| Error::content(path, why))
}

/// A TIFF file whose header names another page as its first, so that any decoder reads that.
struct Page {
    file: File,
    at: u64,
    patch_at: u64,
    patch: Vec<u8>,
}

impl Read for Page {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.file.read(buffer)?;
        for (place, byte) in (self.at..).zip(&mut buffer[..read]) {
            let patched = place.checked_sub(self.patch_at).and_then(|k| self.patch.get(usize::try_from(k).ok()?));
            *byte = patched.copied().unwrap_or(*byte);
        }
        self.at += read as u64;
        Ok(read)
    }
}

impl Seek for Page {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.at = self.file.seek(to)?;
        Ok(self.at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A TIFF file of grey pages of 2×1 px, each of one level; the second is a reduced copy where `preview` says so.
    fn stack(levels: &[u8], preview: bool, is_little_endian: bool) -> Vec<u8> {
        let number = |value: u32, bytes: usize| match is_little_endian {
            true => value.to_le_bytes()[..bytes].to_vec(),
            false => value.to_be_bytes()[4 - bytes..].to_vec(),
        };
        let mut file = if is_little_endian { b"II*\0".to_vec() } else { b"MM\0*".to_vec() };
        file.extend(number(8, 4));
        for (k, &level) in levels.iter().enumerate() {
            let start = file.len() as u32;
            let pixels = start + 2 + 8 * 12 + 4;
            let kind = u32::from(preview && k == 1);
            let entries = [
                (254, 4, kind),
                (256, 4, 2),
                (257, 4, 1),
                (258, 3, 8),
                (259, 3, 1),
                (262, 3, 1),
                (273, 4, pixels),
                (279, 4, 2),
            ];
            file.extend(number(entries.len() as u32, 2));
            for (tag, form, value) in entries {
                file.extend([number(tag, 2), number(form, 2), number(1, 4)].concat());
                let value = if form == 3 { [number(value, 2), vec![0; 2]].concat() } else { number(value, 4) };
                file.extend(value);
            }
            let next = if k + 1 < levels.len() { pixels + 2 } else { 0 };
            file.extend(number(next, 4));
            file.extend([level; 2]);
        }
        file
    }

    #[test]
    fn the_pages_of_a_stack_are_read_one_by_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run_001.tif");
        for is_little_endian in [true, false] {
            std::fs::write(&path, stack(&[10, 20, 30], false, is_little_endian)).unwrap();
            let pages = pages_of(&path).unwrap().unwrap();
            let levels: Vec<f32> = pages.iter().map(|&page| read_page(&path, page).unwrap().get(1, 0, 0)).collect();
            assert_eq!(levels, [10.0, 20.0, 30.0]);
        }
        let said = super::super::read_frame(&path).unwrap_err().to_string();
        assert!(said.contains("run_001.tif: a stack of 3 pages"), "{said}");
    }

    #[test]
    fn a_preview_is_no_page_and_any_bytes_end() {
        let bytes = stack(&[10, 20], true, true);
        assert_eq!(pages(&mut io::Cursor::new(&bytes)).unwrap().len(), 1);
        for kept in 0..bytes.len() {
            let _ = pages(&mut io::Cursor::new(&bytes[..kept]));
        }
        // A directory that names itself as the next.
        let mut circle = stack(&[10], false, true);
        let at = circle.len() - 6;
        circle[at..at + 4].copy_from_slice(&8u32.to_le_bytes());
        assert!(pages(&mut io::Cursor::new(circle)).is_err());
    }
}
