//! What stands in for OpenCV in a build without it: everything is refused.

use super::source::SourceFrame;
use crate::error::{Error, Result};
use std::path::Path;

/// A video that can never be opened.
pub enum Video {}

impl Video {
    pub fn open(path: &Path) -> Result<Self> {
        Err(Error::NoOpenCv { what: format!("{}: reading a video", path.display()) })
    }

    pub fn frame_count(&self) -> Option<usize> {
        match *self {}
    }
}

impl Iterator for Video {
    type Item = SourceFrame;

    fn next(&mut self) -> Option<SourceFrame> {
        match *self {}
    }
}
