//! experiment.toml: what belongs to one experiment and where it lies.

use super::log::LogKeys;
use super::source::{CameraSource, EncoderLog, Source};
use crate::bag::Bag;
use crate::camera::{FrameSource, Lens};
use crate::error::{Error, Result};
use crate::input::read_text;
use crate::observation::Wiring;
use serde::Deserialize;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// One experiment, its paths resolved against its folder.
#[derive(Debug, Clone, PartialEq)]
pub struct Experiment {
    /// The file it was read from.
    pub path: PathBuf,
    /// The robot's constants (a model.toml); Table I where absent.
    pub robot: Option<PathBuf>,
    /// The model to start from (a model.toml); the paper's where absent.
    pub model: Option<PathBuf>,
    /// The encoder log; measuring alone needs none.
    pub encoders: Option<EncoderLog>,
    /// What the log's columns mean, and in which units; as encoders.csv has them where absent.
    pub log: Option<LogKeys>,
    /// How the log's columns hold the readings; as they are named where absent.
    pub wiring: WiringKeys,
    /// The cameras.
    pub views: Vec<View>,
    /// The trackers; there is at least one view or tracker.
    pub trackers: Vec<Tracker>,
}

/// `[wiring]` of an experiment.toml: what it leaves out is as it stands in the log.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WiringKeys {
    columns: Option<Vec<usize>>,
    signs: Option<Vec<i8>>,
    scale: Option<f64>,
    #[serde(default)]
    index_shift: i64,
}

/// One camera's part of an experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// Its name, unique in the experiment: letters, digits, `-` and `_`.
    pub name: String,
    /// The camera file, a topic of `CameraInfo`, or its numbers.
    pub camera: CameraSource,
    /// The frames: a glob, a numbered pattern or a video, relative to the experiment's folder; or a topic of pictures.
    pub frames: Source<String>,
    /// Where grid and base are, or the picture that tells.
    pub rig: RigSource,
    /// Azimuth in {b} of the direction that points to this view's image right, degrees.
    pub delta_offset_deg: f64,
}

/// A tracker's part of an experiment: poses of a sensor on the snake's tip, instead of pictures, or in addition to them.
#[derive(Debug, Clone, PartialEq)]
pub struct Tracker {
    /// Its name, unique among views and trackers.
    pub name: String,
    /// The file with the poses, or a topic of them.
    pub poses: Source<PathBuf>,
    /// Index of a pose in which the snake is unbent.
    pub straight: u64,
    /// Azimuth in {b} of the tracker's x axis, degrees; the encoders tell where absent.
    pub delta_offset_deg: Option<f64>,
    /// Where the middle of the base disk's top face is in the tracker's frame, mm; the poses tell where absent.
    pub base_mm: Option<[f64; 3]>,
}

/// Where a view's rig comes from.
#[derive(Debug, Clone, PartialEq)]
pub enum RigSource {
    /// A rig.toml that `calibrate rig` wrote.
    File(PathBuf),
    /// A picture of the unbent snake, from which the rig is calibrated first.
    Straight {
        /// The picture.
        picture: PathBuf,
        /// Distance between neighbouring thin lines of the grid, mm.
        grid_pitch_mm: f64,
        /// Distance from the snake's axis back to the grid plane, mm.
        standoff_mm: f64,
    },
}

/// The file as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ExperimentFile {
    robot: Option<PathBuf>,
    model: Option<PathBuf>,
    encoders: Option<EncoderLog>,
    log: Option<LogKeys>,
    #[serde(default)]
    wiring: WiringKeys,
    #[serde(default)]
    view: Vec<toml::Spanned<ViewTable>>,
    #[serde(default)]
    tracker: Vec<toml::Spanned<TrackerTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TrackerTable {
    name: String,
    poses: Source<PathBuf>,
    straight: u64,
    delta_offset_deg: Option<f64>,
    base_mm: Option<[f64; 3]>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ViewTable {
    name: String,
    camera: Option<CameraSource>,
    frames: Source<String>,
    rig: Option<PathBuf>,
    straight: Option<PathBuf>,
    grid_pitch_mm: Option<f64>,
    standoff_mm: Option<f64>,
    #[serde(default)]
    delta_offset_deg: f64,
}

impl Experiment {
    /// Reads an experiment from its folder, or from the experiment.toml itself.
    ///
    /// # Errors
    /// A file that cannot be read or is not TOML, an unknown, missing or contradictory key, an implausible number;
    /// each with its line.
    pub fn read(path: &Path) -> Result<Self> {
        let path = if path.is_dir() { path.join("experiment.toml") } else { path.to_owned() };
        let text = read_text(&path)?;
        Self::parse(&path, &text)
    }

    /// The folder that the experiment's paths are relative to.
    pub fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new(""))
    }

    /// How the log of a robot of so many backbones is read.
    ///
    /// # Errors
    /// Columns or signs that are not those of as many backbones, a scale that is not positive.
    pub fn wiring(&self, backbones: usize) -> Result<Wiring> {
        let WiringKeys { columns, signs, scale, index_shift } = self.wiring.clone();
        let straight = Wiring::straight(backbones);
        let wiring = Wiring {
            columns: columns.unwrap_or(straight.columns),
            signs: signs.unwrap_or(straight.signs),
            scale: scale.unwrap_or(straight.scale),
            index_shift,
        };
        if wiring.fits(backbones) {
            return Ok(wiring);
        }
        let message = format!(
            "[wiring] columns = {:?}, signs = {:?}, scale = {}: expected each column from 1 to {backbones} once, {backbones} \
             signs of 1 or -1, and a positive scale (mm for one unit of the log)",
            wiring.columns, wiring.signs, wiring.scale
        );
        Err(Error::content(&self.path, message))
    }

    /// The files that it names, itself among them; the frames are told apart ([`frames`](Self::frames)).
    pub fn files(&self) -> Vec<PathBuf> {
        let of_views = self.views.iter().flat_map(|view| match &view.rig {
            RigSource::File(path) | RigSource::Straight { picture: path, .. } => {
                view.camera.path().map(Path::to_owned).into_iter().chain([path.clone()])
            }
        });
        let log = self.encoders.iter().map(|log| log.path().to_owned());
        let named = [&self.robot, &self.model].into_iter().flatten().cloned().chain(log);
        let of_trackers = self.trackers.iter().map(|tracker| tracker.poses.path().to_owned());
        std::iter::once(self.path.clone()).chain(named).chain(of_views).chain(of_trackers).collect()
    }

    /// The recordings that it names.
    pub fn bags(&self) -> impl Iterator<Item = Bag> {
        let log = self.encoders.iter().filter_map(|log| match log {
            EncoderLog::File(_) => None,
            EncoderLog::Joints(joints) => Some(joints.topic().bag),
        });
        let of_frames = self.views.iter().filter_map(|view| view.frames.topic());
        let of_poses = self.trackers.iter().filter_map(|tracker| tracker.poses.topic());
        log.chain(of_frames.chain(of_poses).map(|topic| topic.bag.clone()))
    }

    /// The frames of each view: a video, a recording, or a pattern of file names.
    pub fn frames(&self) -> impl Iterator<Item = PathBuf> {
        self.views.iter().map(|view| match &view.frames {
            Source::Files(pattern) => self.folder().join(pattern),
            Source::Topic(topic) => topic.bag.path().to_owned(),
        })
    }

    fn parse(path: &Path, text: &str) -> Result<Self> {
        let file: ExperimentFile = toml::from_str(text).map_err(|e| match e.span() {
            Some(span) => Error::at_line(path, line_at(text, span.start), e.message()),
            None => Error::content(path, e.message()),
        })?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let here = |relative: PathBuf| folder.join(relative);
        let mut views = Vec::new();
        let mut names = HashSet::new();
        for table in file.view {
            let line = line_at(text, table.span().start);
            let view = View::from_table(table.into_inner(), folder).map_err(|why| Error::at_line(path, line, why))?;
            if !names.insert(view.name.clone()) {
                return Err(Error::at_line(path, line, format!("two views are called {:?}; rename one", view.name)));
            }
            views.push(view);
        }
        let mut trackers = Vec::new();
        for table in file.tracker {
            let line = line_at(text, table.span().start);
            let tracker =
                Tracker::from_table(table.into_inner(), folder).map_err(|why| Error::at_line(path, line, why))?;
            if !names.insert(tracker.name.clone()) {
                let message = format!("another view or tracker is called {:?}; rename one", tracker.name);
                return Err(Error::at_line(path, line, message));
            }
            trackers.push(tracker);
        }
        if file.log.is_some() && !matches!(file.encoders, Some(EncoderLog::File(_))) {
            let message = "[log] says how a table is read, but `encoders` names no table; remove it";
            return Err(Error::content(path, message));
        }
        if views.is_empty() && trackers.is_empty() {
            return Err(Error::content(path, "no [[view]] and no [[tracker]]; an experiment needs one at least"));
        }
        Ok(Self {
            path: path.to_owned(),
            robot: file.robot.map(here),
            model: file.model.map(here),
            encoders: file.encoders.map(|log| log.within(folder)),
            log: file.log,
            wiring: file.wiring,
            views,
            trackers,
        })
    }
}

impl View {
    /// The view's frames; `folder` is the experiment's.
    ///
    /// # Errors
    /// As [`FrameSource::open`] and [`FrameSource::of_topic`].
    pub fn open_frames(&self, folder: &Path) -> Result<FrameSource> {
        match &self.frames {
            Source::Files(pattern) => FrameSource::open(folder, pattern),
            Source::Topic(topic) => FrameSource::of_topic(topic.clone()),
        }
    }

    /// The view's lens.
    ///
    /// # Errors
    /// As [`Lens::read`], [`Lens::of_topic`] and [`Lens::of_numbers`]; a view that names no camera.
    pub fn lens(&self) -> Result<Lens> {
        match &self.camera {
            CameraSource::File(path) => Lens::read(path),
            CameraSource::Topic(topic) => Lens::of_topic(topic),
            CameraSource::Numbers(numbers) => Lens::of_numbers(numbers)
                .map_err(|error| Error::content(Path::new("experiment.toml"), error.to_string())),
            CameraSource::Untold => Err(Error::Unavailable {
                what: format!("the lens of view {:?}", self.name),
                message: "experiment.toml names no camera file, which only pictures of a ROS 2 topic do without; add camera = \"camera.yaml\""
                    .into(),
            }),
        }
    }

    fn from_table(table: ViewTable, folder: &Path) -> std::result::Result<Self, String> {
        let ViewTable { name, camera, frames, rig, straight, grid_pitch_mm, standoff_mm, delta_offset_deg } = table;
        check_name(&name)?;
        let frames = match frames {
            Source::Files(pattern) if pattern.is_empty() => {
                return Err(format!("view {name:?}: frames is empty, expected a pattern such as \"frames/*.png\""));
            }
            Source::Files(pattern) => Source::Files(pattern),
            Source::Topic(topic) => Source::Topic(topic.within(folder)),
        };
        let rig = match (rig, straight) {
            (Some(file), None) => RigSource::File(folder.join(file)),
            (None, Some(picture)) => RigSource::Straight {
                picture: folder.join(picture),
                grid_pitch_mm: length(&name, "grid_pitch_mm", grid_pitch_mm, 0.05, 100.0)?,
                standoff_mm: length(&name, "standoff_mm", standoff_mm, 0.0, 1000.0)?,
            },
            (Some(_), Some(_)) => return Err(format!("view {name:?} has both rig and straight; remove one")),
            (None, None) => {
                return Err(format!(
                    "view {name:?} has neither rig nor straight; give a rig.toml, or a picture of the unbent snake \
                     with grid_pitch_mm and standoff_mm"
                ));
            }
        };
        check_azimuth(&name, delta_offset_deg)?;
        let camera = camera.map_or(CameraSource::Untold, |camera| camera.within(folder));
        Ok(Self { name, camera, frames, rig, delta_offset_deg })
    }
}

impl Tracker {
    fn from_table(table: TrackerTable, folder: &Path) -> std::result::Result<Self, String> {
        let TrackerTable { name, poses, straight, delta_offset_deg, base_mm } = table;
        check_name(&name)?;
        delta_offset_deg.map_or(Ok(()), |azimuth| check_azimuth(&name, azimuth))?;
        if let Some(base_mm) = base_mm.filter(|base_mm| base_mm.iter().any(|mm| !mm.is_finite())) {
            return Err(format!("{name:?}: base_mm = {base_mm:?}, expected three numbers in mm"));
        }
        Ok(Self { name, poses: poses.within(folder), straight, delta_offset_deg, base_mm })
    }
}

fn check_name(name: &str) -> std::result::Result<(), String> {
    if name.is_empty() || !name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_') {
        return Err(format!("name = {name:?}, expected letters, digits, - and _"));
    }
    Ok(())
}

fn check_azimuth(name: &str, delta_offset_deg: f64) -> std::result::Result<(), String> {
    if delta_offset_deg.is_nan() || delta_offset_deg.abs() > 360.0 {
        return Err(format!("{name:?}: delta_offset_deg = {delta_offset_deg}, expected −360 to 360"));
    }
    Ok(())
}

/// A length that `straight` needs, within what a laboratory can have.
fn length(
    view: &str,
    key: &str,
    value_mm: Option<f64>,
    least_mm: f64,
    most_mm: f64,
) -> std::result::Result<f64, String> {
    match value_mm {
        Some(value_mm) if (least_mm..=most_mm).contains(&value_mm) => Ok(value_mm),
        Some(value_mm) => Err(format!("view {view:?}: {key} = {value_mm}, expected {least_mm} to {most_mm}")),
        None => Err(format!("view {view:?}: {key} is missing; straight needs it")),
    }
}

/// The line, counted from 1, that a byte of the text stands in.
pub(crate) fn line_at(text: &str, byte: usize) -> u64 {
    1 + text.bytes().take(byte).filter(|&b| b == b'\n').count() as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bag::Topic;
    use proptest::prelude::*;

    const GOOD: &str = r#"encoders = "encoders.csv"

[[view]]
name = "side"
camera = "camera.yaml"
frames = "frames/*.jpg"
straight = "straight.jpg"
grid_pitch_mm = 1.0
standoff_mm = 25
"#;

    fn parse(text: &str) -> Result<Experiment> {
        Experiment::parse(Path::new("lab/experiment.toml"), text)
    }

    #[test]
    fn paths_are_relative_to_the_file() {
        let experiment = parse(GOOD).unwrap();
        assert_eq!(experiment.encoders, Some(EncoderLog::File(PathBuf::from("lab/encoders.csv"))));
        assert_eq!(experiment.folder(), Path::new("lab"));
        let [view] = &experiment.views[..] else { panic!("one view") };
        assert_eq!((view.name.as_str(), view.frames.to_string().as_str()), ("side", "frames/*.jpg"));
        assert_eq!(view.delta_offset_deg, 0.0);
        let picture = PathBuf::from("lab/straight.jpg");
        assert_eq!(view.rig, RigSource::Straight { picture, grid_pitch_mm: 1.0, standoff_mm: 25.0 });
    }

    #[test]
    fn a_wiring_is_what_is_written_and_else_straight() {
        assert_eq!(parse(GOOD).unwrap().wiring(4).unwrap(), Wiring::straight(4));
        let with = |keys: &str| parse(&format!("{GOOD}\n[wiring]\n{keys}\n"));
        let written = with("columns = [1, 3, 2]\nscale = 1000\nindex_shift = -1").unwrap().wiring(3).unwrap();
        let expected = Wiring { columns: vec![1, 3, 2], scale: 1000.0, index_shift: -1, ..Wiring::straight(3) };
        assert_eq!(written, expected);
        for (keys, backbones) in
            [("columns = [1, 3, 2]", 4), ("columns = [1, 1, 2]", 3), ("signs = [1, 2, 1]", 3), ("scale = 0.0", 3)]
        {
            let message = with(keys).unwrap().wiring(backbones).unwrap_err().to_string();
            assert!(message.contains("lab/experiment.toml: [wiring]"), "{message}");
        }
        assert!(with("sign = [1, 1, 1]").unwrap_err().to_string().contains("unknown field `sign`"));
    }

    #[test]
    fn frames_camera_and_encoders_may_be_topics_of_a_recording() {
        let text = GOOD
            .replace("\"frames/*.jpg\"", "{ bag = \"run.mcap\", topic = \"/image\" }")
            .replace("\"camera.yaml\"", "{ bag = \"run.mcap\", topic = \"/info\" }")
            .replace(
                "\"encoders.csv\"",
                "{ bag = \"run.mcap\", topic = \"/joints\", joints = [\"b1\"], mm_per_unit = 1e3 }",
            );
        let experiment = parse(&text).unwrap();
        let topic = |name: &str| Topic { bag: PathBuf::from("lab/run.mcap").into(), topic: name.to_owned() };
        let [view] = &experiment.views[..] else { panic!("one view") };
        assert_eq!(
            (&view.frames, &view.camera),
            (&Source::Topic(topic("/image")), &CameraSource::Topic(topic("/info")))
        );
        let Some(EncoderLog::Joints(joints)) = &experiment.encoders else { panic!("{:?}", experiment.encoders) };
        assert_eq!((joints.topic(), joints.mm_per_unit), (topic("/joints"), 1e3));
        assert!(experiment.files().contains(&PathBuf::from("lab/run.mcap")));
        let wrong = parse(&text.replace("topic = \"/image\"", "topics = 1")).unwrap_err().to_string();
        assert!(wrong.contains(":6: expected a file, or a table such as"), "{wrong}");
    }

    #[test]
    fn a_tracker_stands_beside_a_view_or_alone() {
        let tracker = "[[tracker]]\nname = \"em\"\nposes = \"tip.csv\"\nstraight = 3\n";
        let alone = parse(&format!("encoders = \"e.csv\"\n{tracker}")).unwrap();
        let poses = PathBuf::from("lab/tip.csv");
        assert!(alone.files().contains(&poses));
        let expected = Tracker {
            name: "em".into(),
            poses: Source::Files(poses),
            straight: 3,
            delta_offset_deg: None,
            base_mm: None,
        };
        assert_eq!((alone.views.len(), alone.trackers), (0, vec![expected]));
        assert_eq!(parse(&format!("{GOOD}{tracker}")).unwrap().trackers.len(), 1);
        let same_name = parse(&format!("{GOOD}{}", tracker.replace("em", "side"))).unwrap_err().to_string();
        assert!(same_name.contains(":10: another view or tracker is called \"side\""), "{same_name}");
        let without = parse(&tracker.replace("straight = 3\n", "")).unwrap_err().to_string();
        assert!(without.contains("missing field `straight`"), "{without}");
    }

    #[test]
    fn a_folder_stands_for_its_experiment_toml() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("experiment.toml"), GOOD).unwrap();
        assert_eq!(Experiment::read(folder.path()).unwrap().views.len(), 1);
        let missing = Experiment::read(&folder.path().join("nowhere")).unwrap_err().to_string();
        assert!(missing.contains("nowhere: cannot read"), "{missing}");
    }

    #[test]
    fn a_view_that_names_no_camera_has_a_lens_only_from_ros_2() {
        let experiment = parse(&GOOD.replace("camera = \"camera.yaml\"\n", "")).unwrap();
        assert_eq!(experiment.views[0].camera, CameraSource::Untold);
        let message = experiment.views[0].lens().unwrap_err().to_string();
        assert!(message.contains("the lens of view \"side\": experiment.toml names no camera file"), "{message}");
    }

    #[test]
    fn faults_are_named_with_their_line() {
        for (from, to, message) in [
            ("standoff_mm = 25", "stand_off_mm = 25", "lab/experiment.toml:9: unknown field `stand_off_mm`"),
            ("encoders =", "encoder =", "lab/experiment.toml:1: unknown field `encoder`"),
            ("grid_pitch_mm = 1.0", "grid_pitch_mm = \"1\"", "lab/experiment.toml:8: invalid type"),
            ("grid_pitch_mm = 1.0", "grid_pitch_mm = nan", "grid_pitch_mm = NaN, expected 0.05 to 100"),
            ("standoff_mm = 25", "", "lab/experiment.toml:3: view \"side\": standoff_mm is missing"),
            ("standoff_mm = 25", "rig = \"rig.toml\"", "both rig and straight"),
            ("straight = \"straight.jpg\"", "", "neither rig nor straight"),
            ("name = \"side\"", "name = \"a/b\"", "expected letters, digits"),
            ("frames/*.jpg", "", "frames is empty"),
            ("[[view]]", "[[view]", "lab/experiment.toml:3: "),
        ] {
            let error = parse(&GOOD.replace(from, to)).unwrap_err().to_string();
            assert!(error.contains(message), "{to:?} gave {error:?}, expected {message:?}");
        }
        let twice = format!("{GOOD}{}", &GOOD[GOOD.find("[[").unwrap()..]);
        assert!(parse(&twice).unwrap_err().to_string().contains(":10: two views are called \"side\""));
        assert!(parse("encoders = \"e.csv\"").unwrap_err().to_string().contains("no [[view]] and no [[tracker]]"));
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in "\\PC{0,120}") {
            let _ = parse(&text);
        }
    }
}
