//! A build without OpenCV: videos, camera devices and lens calibration are refused.

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_build_without_opencv_says_so() {
        let frame = Frame::from_image(image::DynamicImage::new_luma8(8, 8)).unwrap();
        let board = Board::new(9, 6, 25.0).unwrap();
        let device = CaptureTarget::Device(0);
        let stream = CaptureTarget::Stream("rtsp://camera".to_owned());
        let settings = CaptureSettings::default();
        for (error, what) in [
            (Video::open(Path::new("run.MP4")).err(), "run.MP4: reading a video needs OpenCV"),
            (Capture::open(&device, &settings).err(), "camera 0 needs OpenCV"),
            (Capture::open(&stream, &settings).err(), "the stream rtsp://camera needs OpenCV"),
            (find_corners(&frame, &board).err(), "finding chessboards needs OpenCV"),
            (calibrate(&board, &[], (8, 8)).err(), "calibrating a lens needs OpenCV"),
        ] {
            let told = error.map(|error| error.to_string()).unwrap_or_default();
            assert!(told.starts_with(what), "{told}");
        }
    }
}
