//! Cameras and streams: what may be set, and what came of it.

use serde::Serialize;

/// What to open.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CaptureTarget {
    /// A camera of this machine, by its number.
    Device(u32),
    /// A stream, by its address: `http://…`, `rtsp://…`.
    Stream(String),
}

/// What a camera is asked for; what is `None` stays as it is.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct CaptureSettings {
    /// Width and height, px.
    pub size: Option<(u32, u32)>,
    /// Frames per second.
    pub rate_fps: Option<f64>,
    /// Exposure, in the camera's own unit; setting it switches automatic exposure off.
    pub exposure: Option<f64>,
    /// Focus, in the camera's own unit; setting it switches autofocus off.
    pub focus: Option<f64>,
}
