//! Everything that is done through OpenCV. No other module knows it.

use super::capture::{CaptureSettings, CaptureTarget, FourCc, cameras_there};
use super::{Board, Frame, Lens, Samples};
use crate::error::{Error, Result};
use crate::geometry::Pose;
use nalgebra::{Point2, Translation3, UnitQuaternion, Vector2, Vector3};
use opencv::calib3d::{CALIB_CB_ADAPTIVE_THRESH, CALIB_CB_NORMALIZE_IMAGE, calibrate_camera, find_chessboard_corners};
use opencv::core::{
    Mat, MatTraitConst, MatTraitConstManual, Point2f, Point3f, Size, TermCriteria, TermCriteria_COUNT,
    TermCriteria_EPS, Vector,
};
use opencv::imgproc::corner_sub_pix;
use opencv::videoio::{
    CAP_ANY, CAP_FFMPEG, CAP_PROP_AUTO_EXPOSURE, CAP_PROP_AUTOFOCUS, CAP_PROP_BUFFERSIZE, CAP_PROP_EXPOSURE,
    CAP_PROP_FOCUS, CAP_PROP_FOURCC, CAP_PROP_FPS, CAP_PROP_FRAME_COUNT, CAP_PROP_FRAME_HEIGHT, CAP_PROP_FRAME_WIDTH,
    CAP_PROP_OPEN_TIMEOUT_MSEC, CAP_PROP_ORIENTATION_AUTO, CAP_PROP_POS_MSEC, CAP_PROP_READ_TIMEOUT_MSEC, VideoCapture,
    VideoCaptureTrait, VideoCaptureTraitConst,
};
use std::path::Path;

/// A video file being decoded, frame by frame.
pub struct Video {
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
        let mut capture = VideoCapture::from_file(path, CAP_ANY).map_err(failed(action()))?;
        if !capture.is_opened().map_err(failed(action()))? {
            return Err(Error::content(path, "not a video that OpenCV can decode"));
        }
        // Frames are taken as they are stored: the camera file knows the sensor's own rows and columns, and OpenCV's versions turn pictures
        // differently. A backend that knows no such mark refuses, and turns nothing.
        let _ = capture.set(CAP_PROP_ORIENTATION_AUTO, 0.0);
        Ok(Self { capture, position: 0 })
    }

    /// How many frames the file says that it has.
    pub fn frame_count(&self) -> Option<usize> {
        let count = self.capture.get(CAP_PROP_FRAME_COUNT).ok()?;
        (count >= 1.0).then_some(count as usize)
    }
}

impl Iterator for Video {
    type Item = (Option<f64>, Frame);

    /// The next frame and its time, s; `None` at the end, or where the rest of the file cannot be decoded.
    fn next(&mut self) -> Option<Self::Item> {
        let mut picture = Mat::default();
        if !self.capture.read(&mut picture).ok()? {
            return None;
        }
        let frame = frame_from(&picture).ok()??;
        let first = self.position == 0;
        self.position += 1;
        // A container without timestamps reads as 0 throughout.
        let time_ms = self.capture.get(CAP_PROP_POS_MSEC).ok();
        let time_s = time_ms.filter(|&t| t > 0.0 || first).map(|t| t / 1000.0);
        Some((time_s, frame))
    }
}

/// A camera or a stream, frame by frame as they come.
pub struct Capture {
    capture: VideoCapture,
    picture: Mat,
}

/// How long opening a stream, and waiting for its next frame, may take, ms.
///
/// Convention: a timeout.
const OPEN_TIMEOUT_MS: i32 = 3000;
/// Convention: a timeout.
const READ_TIMEOUT_MS: i32 = 1000;

impl Capture {
    /// Opens a camera or a stream. What a camera cannot be set to it leaves alone; [`settings`](Self::settings) tells.
    ///
    /// # Errors
    /// A camera or stream that is not there or does not answer.
    pub fn open(target: &CaptureTarget, settings: &CaptureSettings) -> Result<Self> {
        let name = match target {
            CaptureTarget::Device(number) => format!("open camera {number}"),
            CaptureTarget::Stream(address) => format!("open the stream {address}"),
        };
        // What OpenCV itself would print of a camera that is not there, at every try, stands in the error.
        let _ = opencv::core::set_log_level(opencv::core::LogLevel::LOG_LEVEL_ERROR);
        let open = || match target {
            CaptureTarget::Device(number) => VideoCapture::new(*number as i32, CAP_ANY),
            CaptureTarget::Stream(address) => {
                let timeouts =
                    [CAP_PROP_OPEN_TIMEOUT_MSEC, OPEN_TIMEOUT_MS, CAP_PROP_READ_TIMEOUT_MSEC, READ_TIMEOUT_MS];
                VideoCapture::from_file_with_params(address, CAP_FFMPEG, &Vector::from_slice(&timeouts))
            }
        };
        let capture = open().map_err(failed(name.clone()))?;
        if !capture.is_opened().map_err(failed(name.clone()))? {
            let others = if matches!(target, CaptureTarget::Device(_)) { cameras_there() } else { String::new() };
            let message = format!("it is not there, or does not answer{others}");
            return Err(Error::OpenCv { action: name, message });
        }
        let mut opened = Self { capture, picture: Mat::default() };
        opened.set(settings);
        Ok(opened)
    }

    /// Asks for settings, in the order in which drivers take them. What is refused stays as it was.
    fn set(&mut self, settings: &CaptureSettings) {
        // V4L2's "manual"; with automatic exposure on, a set value is ignored.
        ///
        /// Convention: the value that OpenCV's Video4Linux backend takes for it.
        const MANUAL_EXPOSURE: f64 = 1.0;
        let mut ask = |property: i32, value: Option<f64>| {
            if let Some(value) = value {
                let _ = self.capture.set(property, value);
            }
        };
        // Queued frames are stale frames.
        ask(CAP_PROP_BUFFERSIZE, Some(1.0));
        // Before the size: without it many cameras offer large pictures at few frames a second only.
        ask(CAP_PROP_FOURCC, settings.fourcc.map(|kind| f64::from(u32::from_le_bytes(kind.0))));
        ask(CAP_PROP_FRAME_WIDTH, settings.size.map(|(width, _)| f64::from(width)));
        ask(CAP_PROP_FRAME_HEIGHT, settings.size.map(|(_, height)| f64::from(height)));
        ask(CAP_PROP_FPS, settings.rate_fps);
        ask(CAP_PROP_AUTO_EXPOSURE, settings.exposure.map(|_| MANUAL_EXPOSURE));
        ask(CAP_PROP_EXPOSURE, settings.exposure);
        ask(CAP_PROP_AUTOFOCUS, settings.focus.map(|_| 0.0));
        ask(CAP_PROP_FOCUS, settings.focus);
    }

    /// The next frame, waited for; `None` where the camera or stream is gone or silent.
    pub fn read(&mut self) -> Option<Frame> {
        if !self.capture.read(&mut self.picture).ok()? {
            return None;
        }
        frame_from(&self.picture).ok()?
    }

    /// The settings as the camera or stream reports them.
    pub fn settings(&self) -> CaptureSettings {
        let ask = |property: i32| self.capture.get(property).ok().filter(|value| value.is_finite());
        let positive = |property: i32| ask(property).filter(|&value| value > 0.0);
        // Streams and drivers without a control answer 0 or −1.
        let control = |property: i32| ask(property).filter(|&value| value != 0.0 && value != -1.0);
        let size = positive(CAP_PROP_FRAME_WIDTH).zip(positive(CAP_PROP_FRAME_HEIGHT));
        CaptureSettings {
            size: size.map(|(width, height)| (width as u32, height as u32)),
            rate_fps: positive(CAP_PROP_FPS),
            fourcc: positive(CAP_PROP_FOURCC).map(|kind| FourCc((kind as u32).to_le_bytes())),
            autofocus: ask(CAP_PROP_AUTOFOCUS).filter(|value| *value >= 0.0).map(|value| value > 0.0),
            exposure: control(CAP_PROP_EXPOSURE),
            focus: control(CAP_PROP_FOCUS),
        }
    }
}

/// OpenCV's 8-bit picture, grey or BGR. `None` for any other kind.
fn frame_from(picture: &Mat) -> opencv::Result<Option<Frame>> {
    let channels = picture.channels() as usize;
    if picture.depth() != opencv::core::CV_8U || ![1, 3].contains(&channels) {
        return Ok(None);
    }
    let bytes = picture.data_bytes()?;
    let mut samples = bytes.to_vec();
    if channels == 3 {
        samples.as_chunks_mut::<3>().0.iter_mut().for_each(|bgr| bgr.reverse());
    }
    let (width, height) = (picture.cols() as u32, picture.rows() as u32);
    Ok(Some(Frame { width, height, channels, samples: Samples::Bits8(samples) }))
}

/// The inner corners of a chessboard, row by row, to a fraction of a pixel; `None` where the whole board is not found.
///
/// # Errors
/// Whatever OpenCV refuses.
pub fn find_corners(frame: &Frame, board: &Board) -> Result<Option<Vec<Point2<f64>>>> {
    let corners = || -> opencv::Result<Option<Vec<Point2<f64>>>> {
        let grey = grey_bytes(frame);
        let picture = Mat::new_rows_cols_with_data(frame.height as i32, frame.width as i32, &grey)?;
        let mut corners = Vector::<Point2f>::new();
        let pattern = Size::new(board.columns as i32, board.rows as i32);
        let flags = CALIB_CB_ADAPTIVE_THRESH | CALIB_CB_NORMALIZE_IMAGE;
        if !find_chessboard_corners(&picture, pattern, &mut corners, flags)? {
            return Ok(None);
        }
        // The window must not reach the neighbouring corners.
        let half = (smallest_distance(&corners) / 2.0).floor().clamp(2.0, 5.0) as i32;
        let stop = TermCriteria::new(TermCriteria_COUNT + TermCriteria_EPS, 30, 0.01)?;
        corner_sub_pix(&picture, &mut corners, Size::new(half, half), Size::new(-1, -1), stop)?;
        Ok(Some(corners.iter().map(|c| Point2::new(f64::from(c.x), f64::from(c.y))).collect()))
    };
    corners().map_err(failed("find the chessboard's corners".into()))
}

fn grey_bytes(frame: &Frame) -> Vec<u8> {
    // Weights of ITU-R BT.601, as OpenCV's own conversion has.
    let level = |pixel: usize, c: usize| frame.samples.level(pixel * frame.channels + c);
    let grey = |pixel: usize| match frame.channels {
        3 => 0.299 * level(pixel, 0) + 0.587 * level(pixel, 1) + 0.114 * level(pixel, 2),
        _ => level(pixel, 0),
    };
    (0..frame.samples.len() / frame.channels).map(|pixel| grey(pixel).round() as u8).collect()
}

fn smallest_distance(corners: &Vector<Point2f>) -> f32 {
    let neighbours = corners.iter().zip(corners.iter().skip(1));
    neighbours.map(|(a, b)| (a.x - b.x).hypot(a.y - b.y)).fold(f32::INFINITY, f32::min)
}

/// The lens with five distortion coefficients, and the poses `camera_from_board`, that bring the boards' corners nearest
/// to where they were seen (least squares).
///
/// # Errors
/// Whatever OpenCV refuses.
pub fn calibrate(board: &Board, views: &[&[Point2<f64>]], size: (u32, u32)) -> Result<(Lens, Vec<Pose>)> {
    let fit = || -> opencv::Result<(Lens, Vec<Pose>)> {
        let (on_boards, seen) = opencv_points(board, views.iter().copied());
        let (mut matrix, mut distortion) = (Mat::default(), Mat::default());
        let (mut rotations, mut translations) = (Vector::<Mat>::new(), Vector::<Mat>::new());
        // Far beyond OpenCV's default of 30 steps and 2e-16, which may stop short of the least squares.
        let stop = TermCriteria::new(TermCriteria_COUNT + TermCriteria_EPS, 200, f64::EPSILON)?;
        calibrate_camera(
            &on_boards,
            &seen,
            Size::new(size.0 as i32, size.1 as i32),
            &mut matrix,
            &mut distortion,
            &mut rotations,
            &mut translations,
            0,
            stop,
        )?;
        let k = |row, column| matrix.at_2d::<f64>(row, column).copied();
        let mut lens = Lens {
            width: size.0,
            height: size.1,
            focal_px: Vector2::new(k(0, 0)?, k(1, 1)?),
            centre_px: Point2::new(k(0, 2)?, k(1, 2)?),
            distortion: [0.0; 12],
            fisheye: None,
        };
        for (to, from) in lens.distortion.iter_mut().zip(distortion.data_typed::<f64>()?) {
            *to = *from;
        }
        let vector = |mat: Mat| -> opencv::Result<Vector3<f64>> { Ok(Vector3::from_column_slice(mat.data_typed()?)) };
        let poses = rotations.iter().zip(translations.iter()).map(|(rotation, translation)| {
            Ok(Pose::from_parts(
                Translation3::from(vector(translation)?),
                UnitQuaternion::from_scaled_axis(vector(rotation)?),
            ))
        });
        Ok((lens, poses.collect::<opencv::Result<_>>()?))
    };
    fit().map_err(failed("calibrate the lens".into()))
}

/// The boards' corners and where they were seen, as OpenCV takes them.
fn opencv_points<'a>(
    board: &Board,
    views: impl Iterator<Item = &'a [Point2<f64>]>,
) -> (Vector<Vector<Point3f>>, Vector<Vector<Point2f>>) {
    let on_board: Vector<Point3f> =
        board.corners().iter().map(|c| Point3f::new(c.x as f32, c.y as f32, c.z as f32)).collect();
    views
        .map(|view| {
            let seen: Vector<Point2f> = view.iter().map(|c| Point2f::new(c.x as f32, c.y as f32)).collect();
            (on_board.clone(), seen)
        })
        .unzip()
}

/// OpenCV's own sigmas of the nine parameters, for comparison.
#[cfg(test)]
pub fn own_sigmas(board: &Board, views: &[Vec<Point2<f64>>], size: (u32, u32)) -> nalgebra::SVector<f64, 9> {
    let (on_boards, seen) = opencv_points(board, views.iter().map(Vec::as_slice));
    let size = Size::new(size.0 as i32, size.1 as i32);
    let mut out: [Mat; 7] = Default::default();
    let [matrix, distortion, rotations, translations, sigmas, pose_sigmas, errors] = &mut out;
    opencv::calib3d::calibrate_camera_extended_def(
        &on_boards,
        &seen,
        size,
        matrix,
        distortion,
        rotations,
        translations,
        sigmas,
        pose_sigmas,
        errors,
    )
    .unwrap();
    nalgebra::SVector::from_column_slice(&sigmas.data_typed::<f64>().unwrap()[..9])
}

fn failed(action: String) -> impl FnOnce(opencv::Error) -> Error {
    move |e| Error::OpenCv { action, message: e.message }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{FrameSource, SourceFrame};
    use opencv::core::{CV_8UC3, Rect, Scalar};
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
