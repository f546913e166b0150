//! The frames of a view, each a message beside its measurement.

use super::recorder::Recorder;
use crate::bag::messages::CompressedImage;
use crate::camera::{FrameSource, PictureFile};
use crate::error::{Error, Result};
use crate::input::{PICTURE_BYTES, read_bytes};
use crate::record::View;
use image::ImageFormat;
use std::iter::Peekable;
use std::path::Path;
use std::vec::IntoIter;

/// A view's frames, gone through in order of their index.
pub struct Camera<'a> {
    view: &'a str,
    channel: u16,
    files: Peekable<IntoIter<PictureFile>>,
    pub missed: usize,
}

impl<'a> Camera<'a> {
    /// A view's frames; in words, why there are none.
    pub fn open(view: &'a View, folder: &Path, recorder: &mut Recorder) -> Result<std::result::Result<Self, String>> {
        let files = match view.open_frames(folder) {
            Ok(FrameSource::Pictures(files)) => files,
            Ok(FrameSource::Stack(..)) => return Ok(Err("its frames are the pages of a TIFF stack".to_owned())),
            Ok(FrameSource::Video(_)) | Err(Error::NoOpenCv { .. }) => {
                return Ok(Err("its frames are a video".to_owned()));
            }
            Ok(FrameSource::Topic(topic)) => return Ok(Err(format!("its frames are in a recording already, {topic}"))),
            Err(error) => return Ok(Err(error.to_string())),
        };
        let files = files.into_iter().peekable();
        let mut camera = Self { view: &view.name, channel: 0, files, missed: 0 };
        camera.channel = recorder.channel(&camera.topic().0, CompressedImage::DEFINITION)?;
        Ok(Ok(camera))
    }

    /// The topic and its channel. Viewers take the last part for the way in which pictures are packed. A name in ROS has no `-` and begins
    /// with no digit.
    pub fn topic(&self) -> (String, u16) {
        let prefix = if self.view.starts_with(|first: char| first.is_ascii_digit()) { "view_" } else { "" };
        (format!("/camera/{prefix}{}/compressed", self.view.replace('-', "_")), self.channel)
    }

    /// Writes the frame of this index, where there is one that is still to come.
    pub fn write(&mut self, index: u64, time_ns: u64, recorder: &mut Recorder) -> Result<()> {
        while self.files.next_if(|file| file.index < index).is_some() {}
        let Some(PictureFile { path, .. }) = self.files.next_if(|file| file.index == index) else { return Ok(()) };
        let bytes = read_bytes(&path, PICTURE_BYTES).unwrap_or_default();
        let format = match image::guess_format(&bytes) {
            Ok(ImageFormat::Png) => "png",
            Ok(ImageFormat::Jpeg) => "jpeg",
            _ => {
                self.missed += 1;
                return Ok(());
            }
        };
        let picture = CompressedImage { format: format.to_owned(), data: &bytes };
        recorder.write(self.channel, time_ns, &picture.encoded(time_ns, self.view))
    }
}
