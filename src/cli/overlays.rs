//! Overlays: which frames are drawn with the model on them, and where the pictures stand.

use super::flow::MeasuredFrames;
use crate::observation::Measurement;
use crate::record::{Experiment, write_atomically};
use crate::report::overlay::{angles, overlay};
use crate::report::run_history::is_drawn;
use crate::report::run_page::Picture;
use crate::{Error, Result};
use image::codecs::jpeg::JpegEncoder;
use image::imageops::FilterType;
use image::{RgbImage, imageops};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Width of the pictures in the report, px.
///
/// Convention: a display choice.
const THUMBNAIL_WIDTH: u32 = 640;

/// Which frames are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Overlays {
    /// Every frame
    All,
    /// The frames that failed and about two dozen spread over the run
    Sample,
    /// None
    None,
}

/// Draws what was measured into the folder, where it is to be drawn.
///
/// # Errors
/// A picture that cannot be written.
pub fn draw(overlays: Overlays, folder: &Path, measured: &MeasuredFrames) -> Result<()> {
    let wanted = match overlays {
        Overlays::None => false,
        Overlays::All => true,
        Overlays::Sample => is_drawn(measured.measurement, measured.rank, measured.count),
    };
    for (view, frame) in measured.frames.iter().filter(|_| wanted) {
        let shape = measured.measurement.profile().map(|profile| view.shape(profile));
        let picture = overlay(frame, measured.measurement, shape.as_ref());
        write_atomically(&picture_path(folder, view.name(), measured.measurement.index), &jpeg(&picture, 90)?)?;
    }
    Ok(())
}

/// Removes the overlays that an earlier run drew into the folder, so that none of frames that are no more stays behind.
///
/// # Errors
/// A picture that cannot be removed.
pub fn remove_former(folder: &Path) -> Result<()> {
    // A folder that is not there has nothing in it.
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.extension().is_some_and(|extension| extension == "jpg") {
            std::fs::remove_file(&path).map_err(Error::io(&path, "remove"))?;
        }
    }
    Ok(())
}

/// Where an overlay stands.
fn picture_path(folder: &Path, view: &str, index: u64) -> PathBuf {
    folder.join(format!("{view}_{index:05}.jpg"))
}

/// What was drawn of these frames, smaller, for the report. A frame that could not be read was not drawn.
///
/// # Errors
/// A picture that cannot be read any more.
pub fn pictures(experiment: &Experiment, folder: &Path, of: &[Measurement]) -> Result<Vec<Picture>> {
    let mut pictures = Vec::new();
    for measurement in of {
        for view in &experiment.views {
            let path = picture_path(folder, &view.name, measurement.index);
            if path.exists() {
                let drawn = image::open(&path).map_err(|e| Error::content(&path, e.to_string()))?;
                let jpeg = jpeg(&thumbnail(&drawn.into_rgb8()), 80)?;
                pictures.push(Picture { caption: caption(measurement), jpeg });
            }
        }
    }
    Ok(pictures)
}

fn caption(measurement: &Measurement) -> String {
    match &measurement.measured {
        Some(measured) => {
            let (theta, delta) = angles(measured);
            format!("frame {}: θ {theta}, δ {delta}", measurement.index)
        }
        None => format!("frame {}: {}", measurement.index, measurement.status),
    }
}

fn thumbnail(picture: &RgbImage) -> RgbImage {
    let width = picture.width().min(THUMBNAIL_WIDTH);
    let height = (u64::from(picture.height()) * u64::from(width) / u64::from(picture.width())).max(1) as u32;
    imageops::resize(picture, width, height, FilterType::Triangle)
}

fn jpeg(picture: &RgbImage, quality: u8) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut encoder = JpegEncoder::new_with_quality(&mut bytes, quality);
    encoder.encode_image(picture).map_err(Error::encode("a picture"))?;
    Ok(bytes)
}
