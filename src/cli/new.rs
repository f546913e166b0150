//! `new`: a folder for an experiment, with its files commented.

use super::console::Console;
use super::inputs::commonest_picture;
use crate::cli::failure::Failure;
use crate::record::{LogProposal, write_atomically};
use crate::{Error, Result};
use serde::Serialize;
use std::fs;
use std::io::{BufRead, IsTerminal, Write};
use std::path::{Path, PathBuf};

/// The robot of the paper, each key with its unit and meaning.
const ROBOT: &str = include_str!("../../calib/robot.toml");

/// Make a folder for an experiment: a commented experiment.toml, a robot.toml, and a README that says what goes where
///
/// Files that are already in the folder (frames/*.jpg or *.png, straight.*, camera.*) are kept, and experiment.toml names them. On a
/// terminal the command asks for values that no option gives.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop new lab --grid-pitch 1 --standoff 25")]
pub struct Args {
    /// The folder; created if it is missing
    folder: PathBuf,
    /// Distance between neighbouring thin lines of the grid target, mm [default: 1]
    #[arg(long, value_name = "MM")]
    grid_pitch: Option<f64>,
    /// Distance from the snake's axis back to the grid target, mm [default: 25]
    #[arg(long, value_name = "MM")]
    standoff: Option<f64>,
    /// Length of the snake, base disk's top face to end disk's far face, mm [default: 26, the paper's]
    #[arg(long, value_name = "MM")]
    length: Option<f64>,
    /// Diameter of its disks, mm [default: 4.2, the paper's]
    #[arg(long, value_name = "MM")]
    diameter: Option<f64>,
    /// Radius of the circle on which its secondary backbones stand, mm [default: 1.5, the paper's]
    #[arg(long, value_name = "MM")]
    radius: Option<f64>,
    /// How many secondary backbones it has [default: 3]
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u8).range(3..=8))]
    backbones: Option<u8>,
}

/// What the files are made from.
struct Answers {
    grid_pitch_mm: f64,
    standoff_mm: f64,
    length_mm: f64,
    diameter_mm: f64,
    radius_mm: f64,
    backbones: u8,
}

#[derive(Serialize)]
struct Summary {
    folder: PathBuf,
    /// The files that were written.
    written: Vec<PathBuf>,
    /// What is still missing for a run.
    missing: Vec<String>,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        let experiment = self.folder.join("experiment.toml");
        if experiment.exists() {
            let message = "exists already and is not replaced; `snakeloop check` says what is missing";
            return Err(Error::content(&experiment, message).into());
        }
        let answers = self.answers(std::io::stdin().is_terminal() && console.may_ask())?;
        let found = Found::in_folder(&self.folder, answers.backbones);
        fs::create_dir_all(self.folder.join("frames")).map_err(Error::io(&self.folder, "create"))?;
        let mut written = Vec::new();
        let files = [
            ("robot.toml", answers.robot_toml()),
            ("README.md", answers.readme(&found)),
            ("experiment.toml", answers.experiment_toml(&found)),
        ];
        for (name, text) in files {
            let path = self.folder.join(name);
            if !path.exists() {
                write_atomically(&path, text.as_bytes())?;
                written.push(path);
            }
        }
        let summary = Summary { folder: self.folder.clone(), written, missing: found.missing(&self.folder) };
        console.result(&summary, || summary.text());
        console.next(summary.next());
        Ok(())
    }

    /// What the flags tell; the rest is asked, or the default.
    fn answers(&self, ask: bool) -> Result<Answers, Failure> {
        let length = |flag: &str, given: Option<f64>, question: &str, default_mm: f64| {
            let value_mm = match given {
                Some(value_mm) => value_mm,
                None if ask => asked(question, default_mm)?,
                None => default_mm,
            };
            if value_mm > 0.0 && value_mm.is_finite() {
                return Ok(value_mm);
            }
            Err(Failure::Usage(format!("--{flag} {value_mm}: expected a length above 0 mm")))
        };
        let target = "grid target: distance between its thin lines, mm";
        Ok(Answers {
            grid_pitch_mm: length("grid-pitch", self.grid_pitch, target, 1.0)?,
            standoff_mm: length("standoff", self.standoff, "from the snake's axis back to the grid target, mm", 25.0)?,
            length_mm: length("length", self.length, "the snake's length, mm", 26.0)?,
            diameter_mm: length("diameter", self.diameter, "diameter of its disks, mm", 4.2)?,
            radius_mm: length("radius", self.radius, "radius of the circle of its secondary backbones, mm", 1.5)?,
            backbones: self.backbones.unwrap_or(3),
        })
    }
}

/// Asks a number on the terminal; an empty line is the default.
fn asked(question: &str, default: f64) -> Result<f64, Failure> {
    let failed = |e: std::io::Error| Failure::Usage(format!("cannot ask on this terminal ({e}); give the flags"));
    loop {
        let mut out = std::io::stderr();
        write!(out, "{question} [{default}]: ").and_then(|()| out.flush()).map_err(failed)?;
        let mut line = String::new();
        let length = std::io::stdin().lock().read_line(&mut line).map_err(failed)?;
        match line.trim() {
            "" => return Ok(default),
            text => match text.parse() {
                Ok(number) => return Ok(number),
                Err(_) if length == 0 => return Ok(default),
                Err(_) => {}
            },
        }
    }
}

/// What stands in the folder already, relative to it; else the names that the files are to have.
struct Found {
    camera: String,
    straight: String,
    frames: String,
    encoders: String,
    /// How the log's columns are to be read, where its header is another.
    log: Option<LogProposal>,
}

impl Found {
    fn in_folder(folder: &Path, backbones: u8) -> Self {
        let first = |names: &[&str]| {
            let there = names.iter().find(|name| folder.join(name).is_file());
            (*there.unwrap_or(&names[0])).to_owned()
        };
        let most = commonest_picture(&folder.join("frames")).map_or("jpg".to_owned(), |(extension, _)| extension);
        let straight =
            [format!("straight.{most}"), "straight.jpg".into(), "straight.png".into(), "straight.tif".into()];
        let encoders = log_in(folder, usize::from(backbones));
        Self {
            camera: first(&["camera.yaml", "camera.yml", "camera.xml", "camera.json", "camera.toml"]),
            straight: first(&straight.each_ref().map(String::as_str)),
            frames: format!("frames/*.{most}"),
            log: LogProposal::of_file(&folder.join(&encoders), usize::from(backbones)),
            encoders,
        }
    }

    /// What a run still needs.
    fn missing(&self, folder: &Path) -> Vec<String> {
        let files = [&self.camera, &self.straight, &self.encoders];
        let files = files.into_iter().filter(|name| !folder.join(name).is_file()).cloned();
        let has_frames = fs::read_dir(folder.join("frames")).is_ok_and(|mut entries| entries.next().is_some());
        files.chain((!has_frames).then(|| self.frames.clone())).collect()
    }
}

/// The encoder log in a folder: encoders.csv, or the first table whose header looks like one.
fn log_in(folder: &Path, backbones: usize) -> String {
    let usual = "encoders.csv".to_owned();
    if folder.join(&usual).is_file() {
        return usual;
    }
    let entries = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let is_table = |path: &PathBuf| {
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        ["csv", "tsv", "txt"].contains(&extension.as_str()) && LogProposal::of_file(path, backbones).is_some()
    };
    let mut tables: Vec<PathBuf> = entries.filter(is_table).collect();
    tables.sort();
    let name = tables.first().and_then(|path| Some(path.file_name()?.to_string_lossy().into_owned()));
    name.unwrap_or(usual)
}

/// What stands in experiment.toml where the log's header says all.
const NO_LOG: &str = r#"# Meaning of the log's columns, if its header is not the one above.
# [log]
# index = "frame"             # if it is left out, rows are matched to frames by time
# time = "timestamp_ms"
# time_unit = "ms"            # s, ms, us, ns
# q = Q_NAMES      # a column for each backbone
# unit = "mm"                 # mm, m, um, inch; deg or rad with drum_radius_mm; counts with counts_per_unit
"#;

/// What stands above the keys that were read off a log's header.
const LOG_SEEN: &str = "# Meaning of the log's columns, guessed from its header: check it. unit is mm, m, um, inch, deg, rad (both with drum_radius_mm) or counts\n\
     # (with counts_per_unit).\n";

impl Answers {
    fn experiment_toml(&self, found: &Found) -> String {
        let Found { camera, straight, frames, encoders, log } = found;
        let (columns, numbers) = (self.columns(), self.each(|k| k.to_string()));
        let (signs, names) = (self.each(|_| "1".to_owned()), self.each(|k| format!("\"m{k}\"")));
        let log = log.as_ref().map_or_else(
            || NO_LOG.replace("Q_NAMES", &format!("[{names}]")),
            |log| format!("{LOG_SEEN}{}", log.toml()),
        );
        let (pitch, standoff) = (self.grid_pitch_mm, self.standoff_mm);
        format!(
            r#"# One experiment. Paths are relative to this file; `snakeloop check` says what is missing or does not fit.

robot = "robot.toml"          # the robot's constants
# model = "model.toml"        # a model that an earlier run learned, to start from
encoders = "{encoders}"     # {columns}: what the encoders read at each frame

{log}
# Which column holds which backbone, if the header is wrong; `check` and `run` say what to write.
# [wiring]
# columns = [{numbers}]         # backbone i is in column columns[i]
# signs = [{signs}]           # -1 if an encoder counts the other way
# scale = 1.0                 # mm for one unit of the log
# index_shift = 0             # frame k's reading is in row k + index_shift

[[view]]                      # one camera; a second camera is a second [[view]]
name = "side"
camera = "{camera}"        # lens, from `snakeloop calibrate camera`, OpenCV or ROS
frames = "{frames}"       # the number in a frame's name is its index
straight = "{straight}"     # the unbent snake before the same grid target, camera and robot at the place that they have in the frames
grid_pitch_mm = {pitch:?}           # distance between the grid target's thin lines: measure it on the print
standoff_mm = {standoff:?}            # from the snake's axis back to the grid target, to half a millimetre
# delta_offset_deg = 0.0      # azimuth in the base frame that points to this view's image right

# [[tracker]]                 # poses of a sensor on the tip, instead of pictures, or in addition to them
# name = "em"
# poses = "tip.csv"           # index,time_s,x_mm,y_mm,z_mm[,qw,qx,qy,qz]
# straight = 0                # index of a pose in which the snake is unbent
# base_mm = [0.0, 0.0, 0.0]   # the middle of the base disk's top face in the tracker's frame, if a pointer was used to find it
"#
        )
    }

    /// Something of each backbone, counted from 1, side by side.
    fn each(&self, of: impl Fn(u8) -> String) -> String {
        (1..=self.backbones).map(of).collect::<Vec<_>>().join(", ")
    }

    /// The header of the encoder log.
    fn columns(&self) -> String {
        let backbones = (1..=self.backbones).map(|k| format!(",q{k}_mm"));
        std::iter::once("index,time_s".to_owned()).chain(backbones).collect()
    }

    /// The README of the folder.
    fn readme(&self, found: &Found) -> String {
        let columns = self.columns();
        let Found { camera, straight, frames, encoders, .. } = found;
        format!(
            "# An experiment for snakeloop\n\n\
             | file | what it is |\n| --- | --- |\n\
             | experiment.toml | which files belong to the experiment; each key has a comment |\n\
             | robot.toml | the robot's constants: correct what differs from the paper |\n\
             | {camera} | the lens: `snakeloop print chessboard`, take pictures of it, `snakeloop calibrate camera boards/*.jpg --corners 9x6 -o {camera}` |\n\
             | {straight} | the unbent snake before the grid target (`snakeloop print grid`) |\n\
             | {frames} | a picture at each pose; the number in the name is the frame's index |\n\
             | {encoders} | one row a frame: `{columns}`, a column for each backbone, mm |\n\n\
             Then, from the folder above:\n\n\
             ```sh\nsnakeloop check THIS_FOLDER            # seconds: what is missing, does not fit, or will be learned\n\
             snakeloop run THIS_FOLDER -o out       # θ and δ of every frame, η and λ, what to command, out/report.html\n```\n"
        )
    }

    /// The paper's robot.toml with these figures.
    fn robot_toml(&self) -> String {
        let line = |line: &str| {
            let key = line.split('=').next().unwrap_or_default().trim();
            let value = match key {
                "length_mm" => format!("{:?}", self.length_mm),
                "backbone_circle_radius_mm" => format!("{:?}", self.radius_mm),
                "backbones" => self.backbones.to_string(),
                "disk_diameter_mm" => format!("{:?}", self.diameter_mm),
                _ => return line.to_owned(),
            };
            let comment = line.find('#').map_or("", |at| &line[at..]);
            format!("{:<33} {comment}", format!("{key} = {value}")).trim_end().to_owned()
        };
        let head = "# The robot: measure it, and correct these figures. Those that were not given are the paper's.\n";
        let keys = ROBOT.lines().skip_while(|line| line.starts_with('#')).map(line);
        keys.fold(head.to_owned(), |text, line| text + &line + "\n")
    }
}

impl Summary {
    fn text(&self) -> String {
        self.written.iter().map(|path| format!("{}\n", path.display())).collect()
    }

    fn next(&self) -> String {
        let folder = self.folder.display();
        match &self.missing[..] {
            [] => format!("snakeloop check {folder}"),
            missing => format!("put {} there, then snakeloop check {folder}", missing.join(", ")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::{Experiment, read_model};

    #[test]
    fn what_is_written_is_an_experiment_of_the_robot_that_was_told() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("frames")).unwrap();
        fs::write(folder.path().join("frames/1.png"), "").unwrap();
        let found = Found::in_folder(folder.path(), 4);
        let answers = Answers {
            grid_pitch_mm: 2.0,
            standoff_mm: 30.5,
            length_mm: 35.0,
            diameter_mm: 5.6,
            radius_mm: 2.0,
            backbones: 4,
        };
        fs::write(folder.path().join("robot.toml"), answers.robot_toml()).unwrap();
        fs::write(folder.path().join("experiment.toml"), answers.experiment_toml(&found)).unwrap();
        let experiment = Experiment::read(folder.path()).unwrap();
        assert_eq!((experiment.views.len(), experiment.trackers.len()), (1, 0));
        // What stands there as a comment can be taken out of it as it is.
        let key = |line: &str| {
            line.strip_prefix("# ").filter(|rest| rest.starts_with('[') || rest.contains(" = ")).map(str::to_owned)
        };
        let with_all: Vec<_> =
            answers.experiment_toml(&found).lines().map(|line| key(line).unwrap_or(line.to_owned())).collect();
        fs::write(folder.path().join("experiment.toml"), with_all.join("\n")).unwrap();
        let experiment = Experiment::read(folder.path()).unwrap();
        assert_eq!(experiment.trackers[0].base_mm, Some([0.0; 3]));
        let robot = read_model(&folder.path().join("robot.toml")).unwrap().robot;
        assert_eq!((robot.length_mm, robot.backbone_count(), robot.body.disk_diameter_mm), (35.0, 4, 5.6));
        for text in [answers.readme(&found), answers.experiment_toml(&found)] {
            assert!(text.contains("index,time_s,q1_mm,q2_mm,q3_mm,q4_mm"), "{text}");
        }
        assert_eq!(found.frames, "frames/*.png");
        assert_eq!(found.missing(folder.path()), ["camera.yaml", "straight.png", "encoders.csv"]);
    }
}
