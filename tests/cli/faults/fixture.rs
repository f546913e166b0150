//! A rendered experiment of small pictures, and what an uninterrupted run makes of it.

use crate::program::{ETA, LAMBDA_MM, Sandbox, all_said, text};
use crate::scenes::smaller;
use snakeloop::record::{encoders_csv, write_atomically};
use snakeloop::robot::Model;
use snakeloop::simulate::{BendingExperiment, FrameFormat, Plant, Scene, write_experiment};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Output;
use std::sync::OnceLock;

/// Frames of the experiment: two poses on each way of four sweeps.
pub const FRAMES: usize = 8;

/// A sandbox of a test's own with a copy of the experiment in `experiment`. Its rig is that of a file, calibrated once, which is most of
/// the work of so short a run.
pub fn sandbox() -> Sandbox {
    static RIG: OnceLock<String> = OnceLock::new();
    let sandbox = Sandbox::new();
    copy_folder(rendered(), &sandbox.join("experiment"));
    let settings = sandbox.read("experiment/experiment.toml");
    let of_picture = "straight = \"straight.png\"\ngrid_pitch_mm = 1.0\nstandoff_mm = 25.0\n";
    assert!(settings.contains(of_picture), "{settings}");
    sandbox.write("experiment/experiment.toml", &settings.replace(of_picture, "rig = \"rig.toml\"\n"));
    let rig = RIG.get_or_init(|| {
        let picture = "--camera experiment/camera.yaml --straight experiment/straight.png --grid-pitch 1 --standoff 25";
        sandbox.succeed(&format!("calibrate rig {picture} -o experiment/rig.toml --quiet"));
        sandbox.read("experiment/rig.toml")
    });
    sandbox.write("experiment/rig.toml", rig);
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

/// The folder of the experiment, whose frames have a third of the usual width and height; rendered once.
pub fn rendered() -> &'static Path {
    static RENDERED: OnceLock<tempfile::TempDir> = OnceLock::new();
    let folder = RENDERED.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        render_short(folder.path(), 3);
        folder
    });
    folder.path()
}

/// Renders the experiment into frames of 1/divisor of the usual width and height.
pub fn render_short(folder: &Path, divisor: u32) {
    render_short_seeded(folder, divisor, 1);
}

/// The same with this seed of all noise.
pub fn render_short_seeded(folder: &Path, divisor: u32, seed: u64) {
    let ride = BendingExperiment { sweep_poses: 2, round_poses: 0, ..BendingExperiment::default() };
    let mut scene = smaller(Scene::default(), divisor);
    (scene.sensor.rays_per_pixel, scene.sensor.noise) = (8, 1.0);
    assert_eq!(write_clean(folder, &ride, &scene, seed), FRAMES);
}

/// Renders an experiment in which nothing is wrong. How many frames it has.
pub fn write_clean(folder: &Path, ride: &BendingExperiment, scene: &Scene, seed: u64) -> usize {
    let model = Model { eta: ETA, lambda_mm: LAMBDA_MM, samples: Some(0), ..Model::default() };
    let samples = Plant { model, sd_encoder_mm: 0.0015 }.run(&ride.waypoints().unwrap(), seed);
    let readings: Vec<_> = samples.iter().map(|sample| sample.reading).collect();
    let truths: Vec<_> = samples.iter().map(|sample| sample.truth).collect();
    write_atomically(&folder.join("encoders.csv"), encoders_csv(&readings, 3).as_bytes()).unwrap();
    write_experiment(folder, scene, &truths, FrameFormat::Png, seed, &|| ()).unwrap();
    truths.len()
}

/// Copies a folder with all below it.
pub fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy_folder(&entry.path(), &target);
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
