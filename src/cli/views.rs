//! The views of an experiment, made ready to measure.

use super::checksum::Checksum;
use super::console::Console;
use crate::bag::Topic;
use crate::camera::{Frame, FrameSource, Lens, PictureFile, SourceFrame, read_frame};
use crate::input::{PICTURE_BYTES, read_bytes};
use crate::measure::{Explanation, Eye, Rig, RigOptions, calibrate_rig};
use crate::record::{Experiment, RigSource, View};
use crate::report::decimation;
use crate::report::overlay::Shape;
use crate::robot::{BendProfile, Robot};
use crate::{Error, Result};
use rayon::prelude::*;
use std::fs;
use std::path::Path;

/// One view: where its frames are and the eye that measures them.
pub struct OpenView {
    name: String,
    eye: Eye,
    frames: FrameSource,
    checksum: String,
}

/// Reads cameras and rigs and finds the frames of every view; calibrates rigs that are given by a straight picture. Warns of views in which
/// the snake is small.
pub fn open_views(console: &Console, experiment: &Experiment, robot: &Robot) -> Result<Vec<OpenView>> {
    let views: Vec<OpenView> =
        experiment.views.iter().map(|view| OpenView::open(view, experiment, robot)).collect::<Result<_>>()?;
    let small = |view: &OpenView| Some(format!("view {}: {}", view.name, view.eye.small_picture()?));
    console.warn(views.iter().filter_map(small));
    Ok(views)
}

/// The rig of a view: from its file, or calibrated from its straight picture.
pub fn rig_of(view: &View, lens: &Lens, robot: &Robot) -> Result<Rig> {
    let delta_offset = view.delta_offset_deg.to_radians();
    match &view.rig {
        RigSource::File(path) => Ok(Rig::read(path)?.looking_from(delta_offset)),
        RigSource::Straight { picture, grid_pitch_mm, standoff_mm } => {
            let options = RigOptions { grid_pitch_mm: *grid_pitch_mm, standoff_mm: *standoff_mm, delta_offset };
            calibrate_rig(&read_frame(picture)?, lens, robot, &options).map_err(Error::rig(picture))
        }
    }
}

impl OpenView {
    fn open(view: &View, experiment: &Experiment, robot: &Robot) -> Result<Self> {
        let frames = view.open_frames(experiment.folder())?;
        // First of all: a frame that is changed from here on is not the one that was refined from.
        let checksum = checksum_of(&frames)?;
        let lens = view.lens()?;
        let rig = rig_of(view, &lens, robot)?;
        // In order, so that sums over them are the same in every run.
        let sample = refining_frames(&frames)?.into_par_iter().filter_map(|frame| frame.read().ok());
        let eye = Eye::new(lens, rig, robot.clone()).refined(sample);
        Ok(Self { name: view.name.clone(), eye, frames, checksum })
    }

    /// The view's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The eye that measures its frames.
    pub fn eye(&self) -> &Eye {
        &self.eye
    }

    /// Where its frames are.
    pub fn source(&self) -> &FrameSource {
        &self.frames
    }

    /// Of which frames there are and of those that the rig was refined from.
    pub fn checksum(&self) -> &str {
        &self.checksum
    }

    /// The model's shape in this view's picture.
    pub fn shape(&self, profile: BendProfile) -> Shape {
        Shape::of(&self.eye.projection(), profile)
    }

    /// Measures one frame and tells every stage of it.
    pub fn explain(&self, frame: &Frame) -> Explanation {
        self.eye.explain(frame)
    }
}

/// Frames from which a view's rig is refined: enough to see the snake bent to all sides.
///
/// Convention: a limit on the time before the first measurement.
const REFINING: usize = 24;

/// The frames, spread over the whole sequence, from which a view's rig is refined.
fn refining_frames(source: &FrameSource) -> Result<Vec<SourceFrame>> {
    let count = source.count()?.unwrap_or(REFINING);
    let frames = source.frames()?.enumerate();
    Ok(frames.filter(|(i, _)| decimation::keeps(*i, REFINING, count)).map(|(_, frame)| frame).take(REFINING).collect())
}

/// Of the frames' indices and names, and of the content of those from which the rig is refined.
fn checksum_of(source: &FrameSource) -> Result<String> {
    let mut checksum = Checksum::default();
    match source {
        FrameSource::Pictures(files) => {
            for PictureFile { index, path, .. } in files {
                checksum.add(&index.to_le_bytes());
                checksum.add(path.file_name().unwrap_or_default().as_encoded_bytes());
            }
            for frame in refining_frames(source)? {
                // One that cannot be read is none that is refined from.
                let is_file = frame.path.is_file();
                let content = if is_file { read_bytes(&frame.path, PICTURE_BYTES) } else { Ok(Vec::new()) };
                checksum.add(&content.unwrap_or_default());
            }
        }
        FrameSource::Video(path) | FrameSource::Stack(path, _) => add_length(&mut checksum, path)?,
        FrameSource::Topic(Topic { bag, .. }) => {
            bag.files()?.iter().try_for_each(|path| add_length(&mut checksum, path))?
        }
    }
    Ok(checksum.to_string())
}

fn add_length(checksum: &mut Checksum, path: &Path) -> Result<()> {
    let length = fs::metadata(path).map_err(Error::io(path, "read"))?.len();
    checksum.add(&length.to_le_bytes());
    Ok(())
}
