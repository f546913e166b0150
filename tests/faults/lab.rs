//! A small experiment, what an uninterrupted run makes of it, and the program.

use snakeloop::record::{encoders_csv, write_atomically};
use snakeloop::robot::{Estimate, Model};
use snakeloop::simulate::{BendingExperiment, FrameFormat, Plant, Scene, write_experiment};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

/// A copy of the experiment of one test.
pub struct Lab {
    pub folder: tempfile::TempDir,
    pub experiment: PathBuf,
    pub frames: usize,
}

impl Lab {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let experiment = folder.path().join("experiment");
        copy(&original().join("experiment"), &experiment);
        let frames = fs::read_dir(experiment.join("frames")).unwrap().count();
        Self { folder, experiment, frames }
    }

    /// The program, called beside the experiment, so that it has the same name in every lab.
    pub fn command(&self) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_snakeloop"));
        command.current_dir(self.folder.path());
        command
    }

    pub fn snakeloop(&self, arguments: &[&str]) -> Output {
        self.command().args(arguments).output().unwrap()
    }

    /// Runs the experiment to the end.
    pub fn run(&self, out: &Path, more: &[&str]) -> Output {
        let output = self.snakeloop(&[&["run", "experiment", "-o", text(out)], more].concat());
        assert!(output.status.success(), "{}", said(&output));
        output
    }
}

/// The files of an uninterrupted run, by name.
pub fn outputs() -> &'static BTreeMap<String, Vec<u8>> {
    static OUTPUTS: OnceLock<BTreeMap<String, Vec<u8>>> = OnceLock::new();
    OUTPUTS.get_or_init(|| {
        let lab = Lab::new();
        let out = lab.folder.path().join("uninterrupted");
        lab.run(&out, &[]);
        bytes_below(&out)
    })
}

/// A folder with an experiment of eight small frames, rendered once.
fn original() -> &'static Path {
    static ORIGINAL: OnceLock<tempfile::TempDir> = OnceLock::new();
    let folder = ORIGINAL.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let estimate = Estimate { eta: 1.2, lambda_mm: 0.17, covariance: Default::default(), samples: 0 };
        let model = Model { estimate: Some(estimate), ..Model::default() };
        let ride = BendingExperiment { sweep_poses: 2, round_poses: 0, ..BendingExperiment::default() };
        let samples = Plant { model, sd_encoder_mm: 0.0015 }.run(&ride.waypoints().unwrap(), 1);
        let readings: Vec<_> = samples.iter().map(|sample| sample.reading).collect();
        let truths: Vec<_> = samples.iter().map(|sample| sample.truth).collect();
        let experiment = folder.path().join("experiment");
        write_atomically(&experiment.join("encoders.csv"), encoders_csv(&readings, 3).as_bytes()).unwrap();
        let mut scene = Scene::default();
        // Half the size: pixel centres are at integers.
        (scene.lens.width, scene.lens.height) = (640, 360);
        scene.lens.focal_px /= 2.0;
        scene.lens.centre_px.coords.apply(|c| *c = (*c - 0.5) / 2.0);
        scene.sensor.rays_per_pixel = 4;
        write_experiment(&experiment, &scene, &truths, FrameFormat::Png, 1, &|| ()).unwrap();
        folder
    });
    folder.path()
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// All that was printed.
pub fn said(output: &Output) -> String {
    String::from_utf8_lossy(&[&output.stdout[..], &output.stderr[..]].concat()).into_owned()
}

pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Rows in a folder's journal; 0 without one.
pub fn journal_rows(out: &Path) -> usize {
    let journal = fs::read_to_string(out.join("measurements.journal")).unwrap_or_default();
    let lines = journal.split_inclusive('\n').skip_while(|line| !line.starts_with("index,")).skip(1);
    lines.filter(|line| line.ends_with('\n')).count()
}

/// The content of all files below a folder, by their path in it.
pub fn bytes_below(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let pattern = format!("{}/**/*", glob::Pattern::escape(text(folder)));
    let hidden = format!("{}/**/.*", glob::Pattern::escape(text(folder)));
    let paths = [pattern, hidden].into_iter().flat_map(|pattern| glob::glob(&pattern).unwrap());
    let files = paths.map(Result::unwrap).filter(|path| path.is_file());
    files
        .map(|path| (path.strip_prefix(folder).unwrap().to_str().unwrap().to_owned(), fs::read(&path).unwrap()))
        .collect()
}
