//! The files of an experiment: which it names, and what to do where one is missing.

use crate::Error;
use crate::camera::FrameSource;
use crate::cli::inputs::commonest_picture;
use crate::record::{Experiment, RigSource, Source, View};
use crate::report::decimation::keeps;
use std::path::{Path, PathBuf};

/// Frames of a view of which the size is looked at. Convention: headers only; a resource limit.
const SIZED: usize = 500;

/// The files that an experiment names, each with what to do where it is missing.
pub fn files_with_remedies(experiment: &Experiment) -> Vec<(PathBuf, String)> {
    let mut files = Vec::new();
    let constants = "`snakeloop new` writes a robot.toml to correct; without the key the paper's robot is taken";
    files.extend(
        [&experiment.robot, &experiment.model].into_iter().flatten().map(|path| (path.clone(), constants.to_owned())),
    );
    let log = "write one row a frame: index,time_s,q1_mm,q2_mm,q3_mm; without a log `snakeloop measure` measures the angles alone";
    files.extend(experiment.encoders.iter().map(|source| (source.path().to_owned(), log.to_owned())));
    for view in &experiment.views {
        let lens = "`snakeloop print chessboard`, take a dozen pictures of it, tilted differently, and `snakeloop calibrate camera boards/*.jpg \
                    --corners 9x6 -o camera.yaml`";
        files.extend(view.camera.path().map(|path| (path.to_owned(), lens.to_owned())));
        files.push(match &view.rig {
            RigSource::File(path) => {
                (path.clone(), "`snakeloop calibrate rig` writes it; or give `straight`".to_owned())
            }
            RigSource::Straight { picture, .. } => {
                let remedy =
                    "take a picture of the unbent snake before the grid target, with the camera at the place that it has in the frames";
                (picture.clone(), remedy.to_owned())
            }
        });
    }
    let poses = "write the tracker's poses, one row a pose: index,time_s,x_mm,y_mm,z_mm[,qw,qx,qy,qz]";
    files.extend(experiment.trackers.iter().map(|tracker| (tracker.poses.path().to_owned(), poses.to_owned())));
    files
}

/// A file that is there under the same name in other letters, or with another ending.
pub fn spelled_otherwise(missing: &Path) -> Option<String> {
    let lower = |path: &Path| path.file_stem().unwrap_or_default().to_string_lossy().to_lowercase();
    let folder = missing.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."));
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let found = entries.filter(|path| path.is_file() && lower(path) == lower(missing)).min()?;
    Some(found.file_name()?.to_string_lossy().into_owned())
}

/// What to do where a view's frames cannot be taken, by why: of those that are not found the pattern that would match what is there, if
/// anything is.
pub fn frames_remedy(experiment: &Experiment, view: &View, why: &Error) -> String {
    match why {
        Error::NoOpenCv { .. } => {
            return "use a build with OpenCV (tools/quickstart makes one), or take the pictures out: ffmpeg -i VIDEO frames/%05d.png"
                .to_owned();
        }
        Error::Content { message, .. } if message.starts_with("no number") => {
            return "number the frames' files as their rows of the log: frames/00001.png, …; or name one video, whose frames are counted"
                .to_owned();
        }
        Error::Content { path, .. } | Error::Io { path, .. } if path != experiment.folder() => {
            return format!("look at that file, or correct `frames` of view {}", view.name);
        }
        _ => {}
    }
    let pattern = match &view.frames {
        Source::Files(pattern) => pattern,
        Source::Topic(_) => return "name a topic of pictures that the recording has".to_owned(),
    };
    if pattern.contains('\\') {
        let slashes = pattern.replace('\\', "/");
        return format!("a backslash separates no folders here: write frames = \"{slashes}\" under view {}", view.name);
    }
    if let Error::Content { message, .. } = why
        && message.contains("is there twice")
    {
        return format!(
            "the last number in a name counts; where another is the frame's, write %05d (or %d) in its place, as in frames/%05d_left.jpg, under \
             view {}",
            view.name
        );
    }
    let named = experiment.folder().join(pattern);
    if let Some((extension, _)) = named.is_dir().then(|| commonest_picture(&named)).flatten() {
        let pattern = pattern.trim_end_matches('/');
        return format!("that is a folder: write frames = \"{pattern}/*.{extension}\" under view {}", view.name);
    }
    let folder = named.parent().unwrap_or(Path::new(""));
    match commonest_picture(folder) {
        Some((extension, count)) => format!(
            "there are {count} files *.{extension} in {}: correct `frames` of view {}",
            folder.display(),
            view.name
        ),
        None => format!("put the frames into {}, numbered in their names, or correct `frames`", folder.display()),
    }
}

/// The straight picture and some of the frames, where they are picture files.
pub fn pictures(experiment: &Experiment, view: &View) -> Vec<PathBuf> {
    let straight = match &view.rig {
        RigSource::Straight { picture, .. } => Some(picture.clone()),
        RigSource::File(_) => None,
    };
    let frames = match view.open_frames(experiment.folder()) {
        Ok(FrameSource::Pictures(files)) => files,
        _ => Vec::new(),
    };
    let count = frames.len();
    let some = frames.into_iter().enumerate().filter(|(k, _)| keeps(*k, SIZED, count)).map(|(_, file)| file.path);
    straight.into_iter().chain(some).collect()
}

/// A path as the experiment's folder shows it.
pub fn name_in(experiment: &Experiment, path: &Path) -> String {
    path.strip_prefix(experiment.folder()).unwrap_or(path).display().to_string()
}
