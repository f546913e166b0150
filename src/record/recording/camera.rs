//! The frames of a view, each a message beside its measurement.

use super::recorder::Recorder;
use crate::camera::FrameSource;
use crate::error::{Error, Result};
use crate::input::{PICTURE_BYTES, read_bytes};
use crate::record::View;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::ImageFormat;
use serde::Serialize;
use std::iter::Peekable;
use std::path::{Path, PathBuf};
use std::vec::IntoIter;

/// The part of Foxglove's schema that a frame needs.
const PICTURE_SCHEMA: &str = r#"{"title":"foxglove.CompressedImage","type":"object","properties":{"timestamp":{"type":"object","title":"time","properties":{"sec":{"type":"integer"},"nsec":{"type":"integer"}}},"frame_id":{"type":"string"},"format":{"type":"string"},"data":{"type":"string","contentEncoding":"base64"}}}"#;

/// A view's frames, gone through in order of their index.
pub struct Camera<'a> {
    view: &'a str,
    channel: u16,
    files: Peekable<IntoIter<(u64, PathBuf)>>,
    pub missed: usize,
}

#[derive(Serialize)]
struct Picture<'a> {
    timestamp: Timestamp,
    frame_id: &'a str,
    format: &'a str,
    data: String,
}

#[derive(Serialize)]
struct Timestamp {
    sec: u64,
    nsec: u64,
}

impl<'a> Camera<'a> {
    /// A view's frames; in words, why there are none.
    pub fn open(view: &'a View, folder: &Path, recorder: &mut Recorder) -> Result<std::result::Result<Self, String>> {
        let files = match view.open_frames(folder) {
            Ok(FrameSource::Pictures(files)) => files,
            Ok(FrameSource::Video(_)) | Err(Error::NoOpenCv { .. }) => {
                return Ok(Err("its frames are a video".to_owned()));
            }
            Ok(FrameSource::Topic(topic)) => return Ok(Err(format!("its frames are in a recording already, {topic}"))),
            Err(error) => return Ok(Err(error.to_string())),
        };
        let files = files.into_iter().peekable();
        let mut camera = Self { view: &view.name, channel: 0, files, missed: 0 };
        camera.channel = recorder.channel(&camera.topic().0, "foxglove.CompressedImage", PICTURE_SCHEMA)?;
        Ok(Ok(camera))
    }

    /// The topic and its channel.
    pub fn topic(&self) -> (String, u16) {
        (format!("/camera/{}", self.view), self.channel)
    }

    /// Writes the frame of this index, where there is one that is still to come.
    pub fn write(&mut self, index: u64, time_ns: u64, recorder: &mut Recorder) -> Result<()> {
        while self.files.next_if(|(before, _)| *before < index).is_some() {}
        let Some((_, path)) = self.files.next_if(|(at, _)| *at == index) else { return Ok(()) };
        let bytes = read_bytes(&path, PICTURE_BYTES).unwrap_or_default();
        let format = match image::guess_format(&bytes) {
            Ok(ImageFormat::Png) => "png",
            Ok(ImageFormat::Jpeg) => "jpeg",
            _ => {
                self.missed += 1;
                return Ok(());
            }
        };
        let timestamp = Timestamp { sec: time_ns / 1_000_000_000, nsec: time_ns % 1_000_000_000 };
        let picture = Picture { timestamp, frame_id: self.view, format, data: STANDARD.encode(bytes) };
        let json = serde_json::to_vec(&picture).map_err(|e| Error::content(&path, e.to_string()))?;
        recorder.write(self.channel, time_ns, &json)
    }
}
