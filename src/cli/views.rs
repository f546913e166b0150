//! The views of an experiment, made ready to measure.

use super::checksum::Checksum;
use super::console::Console;
use super::overlays::jpeg;
use crate::bag::Topic;
use crate::camera::{Frame, FrameSource, Lens, PictureFile, SourceFrame, read_frame_for};
use crate::input::{PICTURE_BYTES, read_bytes};
use crate::measure::{Explanation, Eye, Rig, RigError, RigOptions, sketched_rig};
use crate::record::{Experiment, RigSource, View, write_atomically};
use crate::report::decimation;
use crate::report::overlay::Shape;
use crate::report::rig_picture::{draw_straight, rig_picture};
use crate::robot::{BendProfile, Robot};
use crate::verdict::{Code, Level, Reason};
use crate::{Error, Result};
use rayon::prelude::*;
use std::fs;
use std::path::{Path, PathBuf};
use tracing::{info, info_span};

/// Quality of the picture of what a calibration saw. Convention: a display choice.
const RIG_PICTURE_QUALITY: u8 = 85;

/// The most by which the sheet may bow, mm (rms).
///
/// Derived: what is known of paper before a sheet is seen, 1 mm over 40 mm to either side.
const MOST_BOW_MM: f64 = 1.0;
/// The most by which its two pitches may differ, as a share.
///
/// Derived: twice the 2 % of a printer.
const MOST_STRETCH: f64 = 0.04;

/// What helps against a sheet that is not flat.
const FLATTEN: &str = "lay the sheet flat, on a plate or held by tape all around, and print it at 100 %; see \"Take the straight picture\" in the book";
/// What helps where the calibration says no more.
const LOOK_AT_THE_RIG: &str =
    "`check -o FOLDER` draws what was seen into FOLDER/rig.jpg; see \"Take the straight picture\" in the book";

/// One view: where its frames are and the eye that measures them.
pub struct OpenView {
    name: String,
    eye: Eye,
    frames: FrameSource,
    checksum: String,
}

/// Reads cameras and rigs and finds the frames of every view; calibrates rigs that are given by a straight picture. Warns of views in which
/// the snake is small.
///
/// What the calibration of a rig saw is drawn into rig.jpg of a folder, into rig-NAME.jpg for each of several views.
pub fn open_views(console: &Console, experiment: &Experiment, robot: &Robot, folder: &Path) -> Result<Vec<OpenView>> {
    let open = |view| OpenView::open(view, experiment, robot, &folder.join(rig_picture_name(view, experiment)));
    let views: Vec<OpenView> = experiment.views.iter().map(open).collect::<Result<_>>()?;
    refuse_repeated(experiment, &views)?;
    let small = |view: &OpenView| Some(format!("view {}: {}", view.name, view.eye.small_picture()?));
    console.warn(views.iter().filter_map(small));
    Ok(views)
}

/// An error where two views begin with the same picture: seen once, it would count as seen twice.
fn refuse_repeated(experiment: &Experiment, views: &[OpenView]) -> Result<()> {
    let first = |view: &OpenView| match &view.frames {
        FrameSource::Pictures(files) => files.first().and_then(|file| read_bytes(&file.path, PICTURE_BYTES).ok()),
        _ => None,
    };
    if views.len() < 2 {
        return Ok(());
    }
    let pictures: Vec<Option<Vec<u8>>> = views.iter().map(first).collect();
    for (k, view) in views.iter().enumerate() {
        let same = |other: &usize| pictures[k].is_some() && pictures[k] == pictures[*other];
        if let Some(other) = (0..k).find(same) {
            let message = format!(
                "views {:?} and {:?} begin with the same picture; `frames` of each view names the pictures of one camera",
                views[other].name, view.name
            );
            return Err(Error::content(&experiment.path, message));
        }
    }
    Ok(())
}

/// What views' sheets say against a result.
pub fn reasons_of_sheets(views: &[OpenView]) -> impl Iterator<Item = Reason> {
    views.iter().filter_map(|view| sheet_reason(&view.name, view.eye.rig()))
}

/// What the sheets of an experiment's views say against a result, each drawn anew into a folder; views whose rig cannot be calibrated any more say
/// nothing.
pub fn reasons_of_sheets_again(experiment: &Experiment, robot: &Robot, folder: &Path) -> Vec<Reason> {
    let of_view = |view: &View| {
        let drawn = folder.join(rig_picture_name(view, experiment));
        let rig = rig_of(view, &view.lens().ok()?, robot, Some(&drawn)).ok()?;
        sheet_reason(&view.name, &rig)
    };
    experiment.views.iter().filter_map(of_view).collect()
}

/// The name of the picture of what a view's calibration saw.
pub fn rig_picture_name(view: &View, experiment: &Experiment) -> String {
    if experiment.views.len() == 1 { "rig.jpg".to_owned() } else { format!("rig-{}.jpg", view.name) }
}

/// The rig of a view: from its file, or calibrated from its straight picture. What the calibration saw is drawn into a file, if one is
/// named.
pub fn rig_of(view: &View, lens: &Lens, robot: &Robot, drawn: Option<&Path>) -> Result<Rig> {
    let delta_offset = view.delta_offset_deg.to_radians();
    match &view.rig {
        RigSource::File(path) => Ok(Rig::read(path)?.looking_from(delta_offset)),
        RigSource::Straight { picture, grid_pitch_mm, standoff_mm } => {
            let options = RigOptions { grid_pitch_mm: *grid_pitch_mm, standoff_mm: *standoff_mm, delta_offset };
            calibrated(picture, lens, robot, &options, drawn)
        }
    }
}

/// The rig that a straight picture shows. What the calibration saw is drawn into a file, if one is named: also where it is refused.
pub fn calibrated(
    picture: &Path,
    lens: &Lens,
    robot: &Robot,
    options: &RigOptions,
    drawn: Option<&Path>,
) -> Result<Rig> {
    let _stage = info_span!("calibrate_rig", picture = %picture.display()).entered();
    let frame = read_frame_for(picture, lens)?;
    let (rig, sketch) = sketched_rig(&frame, lens, robot, options);
    let said = match &rig {
        Ok(rig) => format!("the rig was found: {}", sheet_text(rig)),
        Err(error) => error.to_string(),
    };
    info!(seen = %sketch.text(), "{said}");
    if let Some(path) = drawn {
        let mut picture = rig_picture(&frame, &sketch, &said);
        if let Ok(rig) = &rig {
            draw_straight(&mut picture, rig, lens, robot);
        }
        write_atomically(path, &jpeg(&picture, RIG_PICTURE_QUALITY)?)?;
    }
    rig.map_err(|error| {
        Error::rig(picture)(RigRefused { error, seen: sketch.text(), shown: drawn.map(Path::to_owned) })
    })
}

/// A straight picture that gives no rig, and where what was seen in it is drawn.
#[derive(Debug, thiserror::Error)]
#[error("{error}{}", self.sight())]
pub struct RigRefused {
    /// Why.
    pub error: RigError,
    seen: String,
    shown: Option<PathBuf>,
}

impl RigRefused {
    /// What was seen, and where it is drawn.
    fn sight(&self) -> String {
        let seen = if self.seen.is_empty() { String::new() } else { format!(" (seen: {})", self.seen) };
        match &self.shown {
            Some(path) => format!("{seen}; {} shows what was seen", path.display()),
            None => seen,
        }
    }
}

/// What the sheet of a rig is like, in words.
pub fn sheet_text(rig: &Rig) -> String {
    let (shape, pitch_mm) = (&rig.sheet_shape, rig.grid_pitch_mm);
    let [across_mm, along_mm] = [1.0, -1.0].map(|sign| pitch_mm * (1.0 + sign * shape.anisotropy / 2.0));
    format!(
        "lines {across_mm:.3} mm apart across and {along_mm:.3} mm along, meeting at {:.2}°, on a sheet that bows by {:.2} mm (rms)",
        90.0 - shape.shear.to_degrees(),
        shape.rms_mm()
    )
}

/// A sheet that is further from flat and square than paper and printers are: measured, but doubtful.
pub fn sheet_reason(view: &str, rig: &Rig) -> Option<Reason> {
    let shape = &rig.sheet_shape;
    (shape.rms_mm() > MOST_BOW_MM || shape.anisotropy.abs() > MOST_STRETCH).then(|| {
        let text = format!("view {view}: {}", sheet_text(rig));
        Reason::new(Code::SheetNotFlat, Level::Look, text, FLATTEN)
    })
}

/// The reason that a view's straight picture gives no rig.
pub fn rig_reason(error: &Error) -> Reason {
    let is_of_the_sheet = matches!(error, Error::Rig { source, .. }
        if matches!(source.downcast_ref(), Some(RigRefused { error: RigError::SheetNotFlat { .. }, .. })));
    let (code, remedy) = if is_of_the_sheet { (Code::SheetNotFlat, FLATTEN) } else { (Code::Files, LOOK_AT_THE_RIG) };
    Reason::new(code, Level::DoNotUse, error.to_string(), remedy)
}

impl OpenView {
    fn open(view: &View, experiment: &Experiment, robot: &Robot, drawn: &Path) -> Result<Self> {
        let frames = view.open_frames(experiment.folder())?;
        let _stage = info_span!("open_view", view = %view.name).entered();
        // First of all: a frame that is changed from here on is not the one that was refined from.
        let checksum = checksum_of(&frames)?;
        let lens = view.lens()?;
        let rig = rig_of(view, &lens, robot, Some(drawn))?;
        // In order, so that sums over them are the same in every run.
        let eye = Eye::new(lens, rig, robot.clone());
        let _stage = info_span!("refine_rig").entered();
        let sample = refining_frames(&frames)?.into_par_iter().filter_map(|frame| frame.read_for(eye.lens()).ok());
        let eye = eye.clone().refined(sample);
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
                // A frame that cannot be read does not refine the rig, and counts as empty.
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
