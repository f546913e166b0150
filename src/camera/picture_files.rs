//! Picture files among frames: which a glob or a numbered pattern means, and what number and time stand in their names.

use super::picture::read_frame;
use super::stamps;
use crate::content;
use crate::error::{Error, Result};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// A picture file among frames.
#[derive(Debug, Clone, PartialEq)]
pub struct PictureFile {
    /// The number in its name; of names that are times the position in their order, from 0.
    pub index: u64,
    /// The time in its name, s, where all names have one.
    pub time_s: Option<f64>,
    /// The file.
    pub path: PathBuf,
}

/// The first bytes of a file; `None` where it cannot be read.
pub fn head_of(path: &Path) -> Option<Vec<u8>> {
    let mut head = Vec::new();
    // A pipe is not waited at.
    let file = if path.is_file() { File::open(path).ok() } else { None };
    file?.take(content::HEAD_BYTES as u64).read_to_end(&mut head).ok()?;
    Some(head)
}

/// A file's name without its folder.
pub fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Whether a file is one that Windows keeps in folders of pictures, and hides there.
fn is_left_by_windows(path: &Path) -> bool {
    ["thumbs.db", "desktop.ini"].iter().any(|name| file_name(path).eq_ignore_ascii_case(name))
}

/// All that matches a glob below the folder, hidden files excepted. A link to nowhere, a pipe or a folder in a frame's place costs its row, and
/// is not passed over.
pub fn globbed(folder: &Path, pattern: &str) -> Result<Vec<PathBuf>> {
    let full = if Path::new(pattern).is_absolute() {
        pattern.to_owned()
    } else {
        let not_text = || {
            Error::content(
                folder,
                format!(
                    "the folder's name is not UTF-8, so that no pattern can be matched in it: rename it, or write frames/%05d.png for `{pattern}`"
                ),
            )
        };
        format!("{}/{pattern}", glob::Pattern::escape(folder.to_str().ok_or_else(not_text)?))
    };
    let wrong = |e: glob::PatternError| Error::content(folder, format!("frames = \"{pattern}\": {}", e.msg));
    let options = glob::MatchOptions { require_literal_leading_dot: true, ..glob::MatchOptions::new() };
    let mut paths = Vec::new();
    for entry in glob::glob_with(&full, options).map_err(wrong)? {
        let path = entry.map_err(|e| {
            let path = e.path().to_owned();
            Error::io(&path, "read")(e.into())
        })?;
        if is_left_by_windows(&path) {
            continue;
        }
        if path.is_file() || (path.extension().is_some() && last_number(&path).is_ok()) {
            paths.push(path);
        }
    }
    Ok(paths)
}

/// The files with their indices: the last numbers in their names, unless the names are times and these alone order them.
pub fn with_indices(paths: Vec<PathBuf>) -> Result<Vec<PictureFile>> {
    let names: Vec<&Path> = paths.iter().map(PathBuf::as_path).collect();
    let (stamps_s, is_decimal) = stamps::stamps_of(&names).unzip();
    let numbers: Result<Vec<u64>> = paths.iter().map(|path| last_number(path)).collect();
    let Some(stamps_s) = stamps_s else {
        let file = |(index, path)| PictureFile { index, time_s: None, path };
        return Ok(numbers?.into_iter().zip(paths).map(file).collect());
    };
    let mut order: Vec<usize> = (0..paths.len()).collect();
    order.sort_by(|&a, &b| stamps_s[a].total_cmp(&stamps_s[b]));
    let is_in_order = |values: &dyn Fn(usize, usize) -> bool| order.windows(2).all(|pair| values(pair[0], pair[1]));
    let are_times = is_in_order(&|a, b| stamps_s[a] < stamps_s[b]);
    let numbers =
        numbers.ok().filter(|numbers| is_decimal != Some(true) && is_in_order(&|a, b| numbers[a] < numbers[b]));
    let file = |(rank, k): (usize, &usize)| PictureFile {
        index: numbers.as_ref().map_or(rank as u64, |numbers| numbers[*k]),
        time_s: are_times.then_some(stamps_s[*k]),
        path: paths[*k].clone(),
    };
    Ok(order.iter().enumerate().map(file).collect())
}

/// The last run of digits in a file's name without its extension.
pub fn number_in_name(path: &Path) -> Option<u64> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let digits = stem.split(|c: char| !c.is_ascii_digit()).rfind(|run| !run.is_empty());
    digits.and_then(|digits| digits.parse().ok())
}

/// That number, or what is wrong with the name.
fn last_number(path: &Path) -> Result<u64> {
    number_in_name(path).ok_or_else(|| {
        const EXPECTED: &str = "no number in the file's name, expected one like 00012.png to tell the frame's index";
        let other = head_of(path).and_then(|head| content::name_of(&head)).filter(|_| read_frame(path).is_err());
        let message = other.map_or(EXPECTED.to_owned(), |found| {
            format!("{found}, expected pictures numbered in their names, a video or a TIFF stack")
        });
        Error::content(path, message)
    })
}

/// `before%05dafter`, the pattern that C's printf would fill in.
pub struct Numbered<'a> {
    before: &'a str,
    width: usize,
    after: &'a str,
}

/// Takes a numbered pattern apart; `None` if it is not one.
pub fn numbered(pattern: &str) -> Option<Numbered<'_>> {
    let (before, rest) = pattern.split_once('%')?;
    let (width, after) = rest.split_once('d')?;
    let padded = width.strip_prefix('0').unwrap_or_default();
    let width = if width.is_empty() { 1 } else { padded.parse().ok()? };
    (!after.contains(['/', '%'])).then_some(Numbered { before, width, after })
}

impl Numbered<'_> {
    /// All files in a folder whose names it fills.
    pub fn files(&self, folder: &Path) -> Result<Vec<PictureFile>> {
        let (subfolder, before) = self.before.rsplit_once('/').unwrap_or(("", self.before));
        let parent = match folder.join(subfolder) {
            here if here == Path::new("") => PathBuf::from("."),
            there => there,
        };
        let mut files = Vec::new();
        for entry in std::fs::read_dir(&parent).map_err(Error::io(&parent, "read"))? {
            let path = entry.map_err(Error::io(&parent, "read"))?.path();
            let name = file_name(&path);
            let Some(digits) = name.strip_prefix(before).and_then(|rest| rest.strip_suffix(self.after)) else {
                continue;
            };
            if let Some(index) = self.number(digits) {
                files.push(PictureFile { index, time_s: None, path });
            }
        }
        Ok(files)
    }

    /// The number that printf would have written as these digits.
    fn number(&self, digits: &str) -> Option<u64> {
        let exact = digits.len() == self.width || (digits.len() > self.width && !digits.starts_with('0'));
        (exact && digits.bytes().all(|b| b.is_ascii_digit())).then(|| digits.parse().ok()).flatten()
    }
}
