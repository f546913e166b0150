//! A small rendered experiment, and what an uninterrupted run makes of it.

use crate::program::{ETA, LAMBDA_MM, Sandbox, all_said, text};
use snakeloop::record::{encoders_csv, write_atomically};
use snakeloop::robot::{Estimate, Model};
use snakeloop::simulate::{BendingExperiment, FrameFormat, Plant, Scene, write_experiment};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Output;
use std::sync::OnceLock;

/// Frames of the experiment: two poses on each way of four sweeps.
pub const FRAMES: usize = 8;

/// A sandbox of a test's own with a copy of the experiment in `experiment`.
pub fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new();
    copy(rendered(), &sandbox.join("experiment"));
    sandbox
}

/// Runs the experiment to its end, which must go well.
pub fn run(sandbox: &Sandbox, out: &str, more: &str) -> Output {
    let output = sandbox.call(&format!("run experiment -o {out} {more}"));
    assert!(output.status.success(), "{}", all_said(&output));
    output
}

/// The files of an uninterrupted run, by name.
pub fn outputs() -> &'static BTreeMap<String, Vec<u8>> {
    static OUTPUTS: OnceLock<BTreeMap<String, Vec<u8>>> = OnceLock::new();
    OUTPUTS.get_or_init(|| {
        let sandbox = sandbox();
        run(&sandbox, "uninterrupted", "");
        bytes_below(&sandbox.join("uninterrupted"))
    })
}

/// The folder of the experiment's small frames, rendered once.
fn rendered() -> &'static Path {
    static RENDERED: OnceLock<tempfile::TempDir> = OnceLock::new();
    let folder = RENDERED.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let estimate = Estimate { eta: ETA, lambda_mm: LAMBDA_MM, covariance: Default::default(), samples: 0 };
        let model = Model { estimate: Some(estimate), ..Model::default() };
        let ride = BendingExperiment { sweep_poses: 2, round_poses: 0, ..BendingExperiment::default() };
        let samples = Plant { model, sd_encoder_mm: 0.0015 }.run(&ride.waypoints().unwrap(), 1);
        assert_eq!(samples.len(), FRAMES);
        let readings: Vec<_> = samples.iter().map(|sample| sample.reading).collect();
        let truths: Vec<_> = samples.iter().map(|sample| sample.truth).collect();
        write_atomically(&folder.path().join("encoders.csv"), encoders_csv(&readings, 3).as_bytes()).unwrap();
        let mut scene = Scene::default();
        // Half the size: pixel centres are at integers.
        (scene.lens.width, scene.lens.height) = (640, 360);
        scene.lens.focal_px /= 2.0;
        scene.lens.centre_px.coords.apply(|c| *c = (*c - 0.5) / 2.0);
        scene.sensor.rays_per_pixel = 4;
        write_experiment(folder.path(), &scene, &truths, FrameFormat::Png, 1, &|| ()).unwrap();
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

/// Rows in a folder's journal; 0 without one.
pub fn journal_rows(out: &Path) -> usize {
    let journal = fs::read_to_string(out.join("measurements.journal")).unwrap_or_default();
    let lines = journal.split_inclusive('\n').skip_while(|line| !line.starts_with("index,")).skip(1);
    lines.filter(|line| line.ends_with('\n')).count()
}

/// The content of all files below a folder, by their path in it; but for the folder's record, which names where the experiment is.
pub fn bytes_below(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let pattern = format!("{}/**/*", glob::Pattern::escape(text(folder)));
    let hidden = format!("{}/**/.*", glob::Pattern::escape(text(folder)));
    let paths = [pattern, hidden].into_iter().flat_map(|pattern| glob::glob(&pattern).unwrap());
    let files = paths.map(Result::unwrap).filter(|path| path.is_file() && !path.ends_with(".snakeloop.toml"));
    files
        .map(|path| (path.strip_prefix(folder).unwrap().to_str().unwrap().to_owned(), fs::read(&path).unwrap()))
        .collect()
}
