//! Overlays: which frames are drawn with the model on them, and where the pictures stand.

use super::flow::MeasuredFrames;
use crate::observation::Measurement;
use crate::record::{Experiment, write_atomically};
use crate::report::overlay::{angles, is_drawn_on, narrowed, overlay};
use crate::report::run_history::is_drawn;
use crate::report::run_page::{Part, Picture};
use crate::{Error, Result};
use image::codecs::jpeg::JpegEncoder;
use image::{RgbImage, imageops};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Width of the pictures in the report, px. Convention: a display choice.
const PICTURE_WIDTH: u32 = 960;
/// Width of the one that is cut to the snake, px. Convention: a display choice.
const CLOSEUP_WIDTH: u32 = 900;
/// Free room about the snake, as a share of its size. Convention: a display choice.
const ROOM: f64 = 0.12;
/// Width over height of parts that are cut out; report.css has it too (`.crop`).
///
/// Convention: a display choice; square, because the snake bends to all sides.
const ASPECT: f64 = 1.0;

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
    let picture = |(measurement, view): (&Measurement, &str)| {
        let path = picture_path(folder, view, measurement.index);
        let drawn = image::open(&path).map_err(|e| Error::content(&path, e.to_string()))?.into_rgb8();
        let snake = snake_in(&drawn);
        let jpeg = jpeg(&narrowed(drawn, PICTURE_WIDTH), 80)?;
        let file = picture_path(Path::new("overlays"), view, measurement.index).display().to_string();
        Ok(Picture { caption: caption(measurement), jpeg, file, snake })
    };
    let of_views = |measurement| experiment.views.iter().map(move |view| (measurement, view.name.as_str()));
    let drawn: Vec<(&Measurement, &str)> = of.iter().flat_map(of_views).collect();
    let is_there = |(measurement, view): &(&Measurement, &str)| picture_path(folder, view, measurement.index).exists();
    drawn.into_par_iter().filter(is_there).map(picture).collect()
}

/// The frame of the largest bend among these, as it was drawn, cut to the snake: its caption and the JPEG file.
///
/// # Errors
/// A picture that cannot be read any more.
pub fn closeup(experiment: &Experiment, folder: &Path, of: &[Measurement]) -> Result<Option<(String, Vec<u8>)>> {
    let theta = |measurement: &Measurement| measurement.measured.map(|measured| measured.configuration.theta);
    let bent = of.iter().filter(|measurement| theta(measurement).is_some());
    let Some(most) = bent.max_by(|a, b| theta(a).unwrap_or(0.0).total_cmp(&theta(b).unwrap_or(0.0))) else {
        return Ok(None);
    };
    let mut paths = experiment.views.iter().map(|view| picture_path(folder, &view.name, most.index));
    let Some(path) = paths.find(|path| path.exists()) else { return Ok(None) };
    let drawn = image::open(&path).map_err(|e| Error::content(&path, e.to_string()))?.into_rgb8();
    let Part { left, top, width, height } = snake_in(&drawn);
    let px = |share: f64, of: u32| (share * f64::from(of)).round() as u32;
    let (wide, high) = (drawn.width(), drawn.height());
    let part = imageops::crop_imm(&drawn, px(left, wide), px(top, high), px(width, wide), px(height, high)).to_image();
    Ok(Some((format!("{}.", caption(most)), jpeg(&narrowed(part, CLOSEUP_WIDTH), 88)?)))
}

/// The part of a picture with the model drawn on it, with room about it; all of it where no model is drawn.
fn snake_in(drawn: &RgbImage) -> Part {
    let (wide, high) = (f64::from(drawn.width()), f64::from(drawn.height()));
    let mut from = (f64::INFINITY, f64::INFINITY);
    let mut to = (0.0f64, 0.0f64);
    for (x, y, _) in drawn.enumerate_pixels().filter(|(_, _, pixel)| is_drawn_on(pixel)) {
        from = (from.0.min(f64::from(x)), from.1.min(f64::from(y)));
        to = (to.0.max(f64::from(x)), to.1.max(f64::from(y)));
    }
    if from.0 >= to.0 || from.1 >= to.1 {
        return Part::WHOLE;
    }
    let room = ROOM * (to.0 - from.0).max(to.1 - from.1);
    let (width, height) = (to.0 - from.0 + 2.0 * room, to.1 - from.1 + 2.0 * room);
    let width = width.max(ASPECT * height).min(wide).min(ASPECT * high);
    let height = width / ASPECT;
    let start = |from: f64, to: f64, size: f64, of: f64| ((from + to - size) / 2.0).clamp(0.0, of - size);
    Part {
        left: start(from.0, to.0, width, wide) / wide,
        top: start(from.1, to.1, height, high) / high,
        width: width / wide,
        height: height / high,
    }
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

pub fn jpeg(picture: &RgbImage, quality: u8) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut encoder = JpegEncoder::new_with_quality(&mut bytes, quality);
    encoder.encode_image(picture).map_err(Error::encode("a picture"))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::overlay::paint_for_test;

    #[test]
    fn the_part_with_the_model_is_found_and_keeps_its_aspect() {
        let mut picture = RgbImage::from_pixel(640, 360, image::Rgb([120, 130, 140]));
        assert_eq!(snake_in(&picture), Part::WHOLE);
        paint_for_test(&mut picture, 300..340, 100..200);
        let part = snake_in(&picture);
        let (left, right) = (640.0 * part.left, 640.0 * (part.left + part.width));
        let (top, bottom) = (360.0 * part.top, 360.0 * (part.top + part.height));
        assert!(left < 300.0 && right > 340.0 && top < 90.0 && bottom > 210.0, "{part:?}");
        assert!(((right - left) / (bottom - top) - ASPECT).abs() < 1e-6 && right - left < 250.0, "{part:?}");
    }
}
