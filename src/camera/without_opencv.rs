//! What stands in for OpenCV in a build without it: everything is refused.

use super::capture::{CaptureSettings, CaptureTarget};
use super::{Board, Frame, Lens};
use crate::error::{Error, Result};
use crate::geometry::Pose;
use nalgebra::Point2;
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
    type Item = (Option<f64>, Frame);

    fn next(&mut self) -> Option<Self::Item> {
        match *self {}
    }
}

/// A camera or stream that can never be opened.
#[derive(Debug)]
pub enum Capture {}

impl Capture {
    /// Always refuses.
    ///
    /// # Errors
    /// [`Error::NoOpenCv`].
    pub fn open(target: &CaptureTarget, _: &CaptureSettings) -> Result<Self> {
        let what = match target {
            CaptureTarget::Device(number) => format!("camera {number}"),
            CaptureTarget::Stream(address) => format!("the stream {address}"),
        };
        Err(Error::NoOpenCv { what })
    }

    /// The next frame.
    pub fn read(&mut self) -> Option<Frame> {
        match *self {}
    }

    /// The settings as they are.
    pub fn settings(&self) -> CaptureSettings {
        match *self {}
    }
}

pub fn find_corners(_: &Frame, _: &Board) -> Result<Option<Vec<Point2<f64>>>> {
    Err(Error::NoOpenCv { what: "finding chessboards".into() })
}

pub fn calibrate(_: &Board, _: &[&[Point2<f64>]], _: (u32, u32)) -> Result<(Lens, Vec<Pose>)> {
    Err(Error::NoOpenCv { what: "calibrating a lens".into() })
}
