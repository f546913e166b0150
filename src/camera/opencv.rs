//! Everything that is done through OpenCV. No other module knows it.

use super::frame::Frame;
use super::source::SourceFrame;
use crate::error::{Error, Result};
use opencv::core::{Mat, MatTraitConst, MatTraitConstManual};
use opencv::videoio::{
    CAP_ANY, CAP_PROP_FRAME_COUNT, CAP_PROP_POS_MSEC, VideoCapture, VideoCaptureTrait, VideoCaptureTraitConst,
};
use std::path::{Path, PathBuf};

/// A video file being decoded, frame by frame.
pub struct Video {
    path: PathBuf,
    capture: VideoCapture,
    position: u64,
}

impl Video {
    /// Opens a video file.
    ///
    /// # Errors
    /// A file that is not there, or that OpenCV knows no decoder for.
    pub fn open(path: &Path) -> Result<Self> {
        std::fs::metadata(path).map_err(Error::io(path, "read"))?;
        let action = || format!("open the video {}", path.display());
        let capture = VideoCapture::from_file(path, CAP_ANY).map_err(failed(action()))?;
        if !capture.is_opened().map_err(failed(action()))? {
            return Err(Error::content(path, "not a video that OpenCV can decode"));
        }
        Ok(Self { path: path.to_owned(), capture, position: 0 })
    }

    /// How many frames the file says that it has.
    pub fn frame_count(&self) -> Option<usize> {
        let count = self.capture.get(CAP_PROP_FRAME_COUNT).ok()?;
        (count >= 1.0).then_some(count as usize)
    }
}

impl Iterator for Video {
    type Item = SourceFrame;

    /// The next frame; `None` at the end, or where the rest of the file cannot be decoded.
    fn next(&mut self) -> Option<SourceFrame> {
        let mut picture = Mat::default();
        if !self.capture.read(&mut picture).ok()? {
            return None;
        }
        let frame = frame_from(&picture).ok()??;
        let index = self.position;
        self.position += 1;
        // A container without timestamps reads as 0 throughout.
        let time_ms = self.capture.get(CAP_PROP_POS_MSEC).ok();
        let time_s = time_ms.filter(|&t| t > 0.0 || index == 0).map(|t| t / 1000.0);
        Some(SourceFrame { index, time_s, path: self.path.clone(), decoded: Some(frame) })
    }
}

/// OpenCV's 8-bit picture, grey or BGR. `None` for any other kind.
fn frame_from(picture: &Mat) -> opencv::Result<Option<Frame>> {
    let channels = picture.channels() as usize;
    if picture.depth() != opencv::core::CV_8U || ![1, 3].contains(&channels) {
        return Ok(None);
    }
    let bytes = picture.data_bytes()?;
    let data = bytes.chunks_exact(channels).flat_map(|pixel| pixel.iter().rev()).map(|&v| f32::from(v)).collect();
    Ok(Some(Frame { width: picture.cols() as u32, height: picture.rows() as u32, channels, data }))
}

fn failed(action: String) -> impl FnOnce(opencv::Error) -> Error {
    move |e| Error::OpenCv { action, message: e.message }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::FrameSource;
    use opencv::core::{CV_8UC3, Rect, Scalar, Size};
    use opencv::imgproc::{FILLED, LINE_8, rectangle};
    use opencv::videoio::{VideoWriter, VideoWriterTrait};

    /// Ten frames at 20 per second: an orange picture with a black square that moves 8 px a frame.
    fn write_video(path: &Path) {
        let fourcc = VideoWriter::fourcc('M', 'J', 'P', 'G').unwrap();
        let mut writer = VideoWriter::new(path, fourcc, 20.0, Size::new(128, 64), true).unwrap();
        for k in 0..10 {
            let mut picture =
                Mat::new_rows_cols_with_default(64, 128, CV_8UC3, Scalar::new(40.0, 120.0, 220.0, 0.0)).unwrap();
            let square = Rect::new(8 * k, 24, 16, 16);
            rectangle(&mut picture, square, Scalar::default(), FILLED, LINE_8, 0).unwrap();
            writer.write(&picture).unwrap();
        }
        writer.release().unwrap();
    }

    #[test]
    fn a_video_gives_its_frames_with_position_and_time() {
        let folder = tempfile::tempdir().unwrap();
        write_video(&folder.path().join("run.avi"));
        let source = FrameSource::open(folder.path(), "run.avi").unwrap();
        assert_eq!(source.count().unwrap(), Some(10));
        let frames: Vec<SourceFrame> = source.frames().unwrap().collect();
        assert_eq!(frames.len(), 10);
        for (k, frame) in frames.into_iter().enumerate() {
            assert_eq!(frame.index, k as u64);
            assert!((frame.time_s.unwrap() - k as f64 / 20.0).abs() < 1e-6, "frame {k} at {:?} s", frame.time_s);
            let picture = frame.read().unwrap();
            assert_eq!((picture.width, picture.height, picture.channels), (128, 64, 3));
            // Red, green, blue; JPEG is off by a few levels.
            for (c, level) in [220.0, 120.0, 40.0].into_iter().enumerate() {
                assert!((picture.get(100, 5, c) - level).abs() < 12.0, "channel {c}: {}", picture.get(100, 5, c));
                assert!(picture.get(8 * k as u32 + 8, 32, c) < 12.0);
            }
        }
    }

    #[test]
    fn what_is_no_video_is_an_error_that_names_it() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("text.mp4"), "no video at all").unwrap();
        for (name, expected) in [("text.mp4", "not a video"), ("none.avi", "cannot read")] {
            let message = FrameSource::open(folder.path(), name).unwrap_err().to_string();
            assert!(message.contains(name) && message.contains(expected), "{message}");
        }
        let whole = folder.path().join("whole.avi");
        write_video(&whole);
        let bytes = std::fs::read(&whole).unwrap();
        std::fs::write(folder.path().join("cut.avi"), &bytes[..bytes.len() / 2]).unwrap();
        if let Ok(source) = FrameSource::open(folder.path(), "cut.avi") {
            assert!((1..10).contains(&source.frames().unwrap().count()));
        }
    }
}
