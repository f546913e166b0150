//! Cameras: the lens model, camera files, and where frames come from.

mod board;
pub mod calibrate;
pub mod capture;
mod file;
pub mod frame;
pub mod lens;
mod message;
#[cfg(feature = "opencv")]
mod opencv;
pub mod picture;
mod picture_files;
pub mod source;
mod stack;
mod stamps;
mod video_mark;
// Beside OpenCV it is there for its tests alone.
#[cfg(any(test, not(feature = "opencv")))]
#[cfg_attr(feature = "opencv", allow(dead_code))]
mod without_opencv;
pub use board::Board;
pub use calibrate::{CameraCalibration, calibrate_camera};
pub use capture::{CaptureSettings, CaptureTarget, FourCc};
pub use file::{CameraFormat, CameraNumbers};
pub use frame::{Frame, Sample, Samples};
pub use lens::Lens;
#[cfg(feature = "live")]
pub(crate) use message::Picture;
pub use opencv::Capture;
pub use picture::{decode_frame, decode_frame_for, picture_size_for, read_frame, read_frame_for};
pub use picture_files::PictureFile;
pub(crate) use picture_files::number_in_name;
pub use source::{FrameSource, SourceFrame};
#[cfg(not(feature = "opencv"))]
use without_opencv as opencv;
