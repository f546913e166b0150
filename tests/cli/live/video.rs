//! A video file, made here: played live, and measured as a whole.

use super::fixture::{FRAMES, Live, assert_learned, experiment};
use crate::program::Sandbox;
use opencv::core::{Mat, Size, Vec3b};
use opencv::videoio::{VideoWriter, VideoWriterTrait};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// The experiment's frames as a video at 4 frames/s.
fn write_video(path: &Path) {
    let fourcc = VideoWriter::fourcc('M', 'J', 'P', 'G').unwrap();
    let mut writer = VideoWriter::new(path.to_str().unwrap(), fourcc, 4.0, Size::new(640, 360), true).unwrap();
    for index in 0..FRAMES {
        let picture = image::open(experiment().join(format!("frames/{index:05}.jpg"))).unwrap().to_rgb8();
        let bgr: Vec<Vec3b> = picture.pixels().map(|pixel| Vec3b::from([pixel[2], pixel[1], pixel[0]])).collect();
        writer.write(&Mat::new_rows_cols_with_data(360, 640, &bgr).unwrap()).unwrap();
    }
    writer.release().unwrap();
}

#[test]
fn a_video_file_is_played_to_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let video = folder.path().join("ride.avi");
    write_video(&video);
    // The experiment's log is by index, and so is a video.
    let live = Live::start(&folder.path().join("out"), &["--source", video.to_str().unwrap()]);
    let state = live.until("the end", |state| state["ended"] == true);
    assert_eq!(state["source"]["frames"], FRAMES);
    assert_learned(&state);
    assert!(live.finish().success());
}

/// The files that a run wrote, without those drawn.
fn written(out: &Path) -> BTreeMap<String, Vec<u8>> {
    // rig.jpg is of the run that calibrated the rig; merging shards does not.
    let is_of_rows = |path: &PathBuf| path.is_file() && !path.ends_with("rig.jpg");
    let files = fs::read_dir(out).unwrap().map(|entry| entry.unwrap().path()).filter(is_of_rows);
    files.map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), fs::read(&path).unwrap())).collect()
}

#[test]
fn a_run_over_a_video_gives_the_same_with_any_threads_shared_out_and_after_a_kill() {
    let sandbox = Sandbox::new();
    let ride = sandbox.join("ride");
    fs::create_dir(&ride).unwrap();
    write_video(&ride.join("ride.avi"));
    for name in ["camera.yaml", "straight.jpg", "encoders.csv"] {
        fs::copy(experiment().join(name), ride.join(name)).unwrap();
    }
    let settings = fs::read_to_string(experiment().join("experiment.toml")).unwrap();
    fs::write(ride.join("experiment.toml"), settings.replace("frames/*.jpg", "ride.avi")).unwrap();
    let run = |out: &str, more: &str| {
        sandbox.succeed(&format!("run ride -o {out} {more}"));
        written(&sandbox.join(out))
    };
    let whole = run("one", "--jobs 1");
    let rows = String::from_utf8(whole["measurements.csv"].clone()).unwrap();
    assert_eq!(rows.lines().count() as u64, 1 + FRAMES);
    assert_eq!(rows.matches(",ok,").count() as u64, FRAMES, "{rows}");
    assert!(run("two", "--jobs 2") == whole);

    let mut child = sandbox.command("run ride -o killed --jobs 1").spawn().unwrap();
    let journal = sandbox.join("killed/measurements.journal");
    let deadline = Instant::now() + Duration::from_secs(60);
    while fs::read_to_string(&journal).unwrap_or_default().matches(",ok,").count() < 3 {
        assert!(Instant::now() < deadline, "no rows came");
        std::thread::sleep(Duration::from_millis(2));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(run("killed", "--resume --jobs 2") == whole);

    run("part1", "--shard 1/2");
    run("part2", "--shard 2/2");
    sandbox.succeed("merge part1 part2 -o merged");
    assert!(written(&sandbox.join("merged")) == whole);
}
