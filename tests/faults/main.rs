//! What a laboratory does to a long run: kills it, fills its disk, takes its input away, hands it half a picture. Nothing is lost
//! but the frames in hand, and every output is whole or absent.

mod lab;

use lab::{Lab, bytes_below, journal_rows, outputs, said, text};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Frames that are measured at a time: what a kill may cost.
const IN_HAND: usize = 4;

/// Starts `run --resume` in the background, with two threads.
fn start(lab: &Lab, out: &Path) -> Child {
    lab.command()
        .args(["run", "experiment", "-o", text(out), "--resume", "--jobs", "2"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// Waits until the journal has so many rows.
fn wait_for_rows(out: &Path, rows: usize) {
    let start = Instant::now();
    while journal_rows(out) < rows {
        assert!(start.elapsed() < Duration::from_secs(120), "no rows came");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Whatever stands in the folder is a whole file of the uninterrupted run; the journal's rows are the first of its rows.
fn nothing_is_half_written(out: &Path) {
    let whole = outputs();
    for (name, content) in bytes_below(out) {
        if name == "measurements.journal" {
            let rows = String::from_utf8(content).unwrap();
            let rows: Vec<&str> = rows.split_inclusive('\n').skip_while(|line| !line.starts_with("index,")).collect();
            let expected = String::from_utf8(whole["measurements.csv"].clone()).unwrap();
            assert!(expected.starts_with(&rows.concat()), "{rows:?}");
        } else if !name.contains(".snakeloop-") {
            assert!(whole.get(&name) == Some(&content), "{name} is not what the uninterrupted run wrote");
        }
    }
}

/// Kills runs so many times at random moments, resuming each until it is done, and counts what it cost.
fn kill(times: usize) {
    let lab = Lab::new();
    let out = lab.folder.path().join("killed");
    let started = Instant::now();
    assert!(start(&lab, &out).wait_with_output().unwrap().status.success());
    let whole_run = started.elapsed();
    let mut random = StdRng::seed_from_u64(6);
    let (mut kills, mut runs, mut lost, mut most_lost) = (0, 0, 0, 0);
    while kills < times {
        let _ = fs::remove_dir_all(&out);
        runs += 1;
        let mut rows = 0;
        // From now and then at the very beginning to just before the end.
        while kills < times {
            let mut child = start(&lab, &out);
            let moment = Instant::now() + whole_run.mul_f64(random.random_range(0.0..1.1));
            let mut finished = false;
            while !finished && Instant::now() < moment {
                std::thread::sleep(Duration::from_millis(1));
                finished = child.try_wait().unwrap().is_some();
            }
            if finished {
                break;
            }
            let before = journal_rows(&out);
            child.kill().unwrap();
            child.wait().unwrap();
            kills += 1;
            let after = journal_rows(&out);
            if out.join("measurements.journal").exists() {
                assert!(after >= before && after >= rows, "{rows}, then {before} and {after} rows");
                rows = after;
                // Every frame of so few is drawn once it is measured, and then its row is written.
                let drawn = bytes_below(&out).into_keys().filter(|name| name.ends_with(".jpg")).count();
                assert!((rows..=rows + IN_HAND).contains(&drawn), "{drawn} frames were measured, {rows} rows written");
                (lost, most_lost) = (lost + drawn - rows, most_lost.max(drawn - rows));
            }
            nothing_is_half_written(&out);
        }
        let last = start(&lab, &out).wait_with_output().unwrap();
        assert!(last.status.success(), "{}", said(&last));
        assert!(&bytes_below(&out) == outputs(), "not what the uninterrupted run wrote");
    }
    println!(
        "{kills} kills in {runs} runs of {} frames: no row was lost, and {lost} measured frames in hand, at most {most_lost} at a time",
        lab.frames
    );
}

#[test]
fn a_run_that_is_killed_again_and_again_ends_as_if_it_never_was() {
    kill(10);
}

#[test]
#[ignore = "takes several minutes; run it with --ignored"]
fn two_hundred_kills() {
    kill(200);
}

/// The run failed, said so in words with a file in them, and left nothing half written.
fn refused(out: &Path, output: &Output, expected: &[&str]) {
    let message = said(output);
    assert_eq!(output.status.code(), Some(1), "{message}");
    for part in expected.iter().chain(&[text(out), "error: ", "are kept in"]) {
        assert!(message.contains(part), "{part}: {message}");
    }
    nothing_is_half_written(out);
    let left_behind = bytes_below(out).into_keys().filter(|name| name.contains(".snakeloop-")).count();
    assert_eq!(left_behind, 0, "temporary files");
}

#[test]
fn a_file_that_may_not_grow_costs_nothing_that_was_measured() {
    let lab = Lab::new();
    let out = lab.folder.path().join("limited");
    // Blocks of 1024 bytes: enough for the first rows, not for a picture.
    let limited = Command::new("bash")
        .current_dir(lab.folder.path())
        .args(["-c", "trap '' XFSZ; ulimit -f 3; exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_snakeloop")])
        .args(["run", "experiment", "-o", text(&out), "--jobs", "2"])
        .output()
        .unwrap();
    refused(&out, &limited, &["File too large"]);
    lab.run(&out, &["--resume"]);
    assert!(&bytes_below(&out) == outputs());
}

#[test]
fn a_full_disk_costs_nothing_that_was_measured() {
    let lab = Lab::new();
    let disk = lab.folder.path().join("disk");
    fs::create_dir(&disk).unwrap();
    let mount = |options: &str| {
        let mut mount = Command::new("mount");
        let done = mount.args(["-t", "tmpfs", "-o", options, "tmpfs", text(&disk)]).output();
        done.is_ok_and(|output| output.status.success())
    };
    if !mount("size=120k") {
        println!("no file system may be mounted here: not tested");
        return;
    }
    let out = disk.join("out");
    let full = lab.snakeloop(&["run", "experiment", "-o", text(&out), "--jobs", "2"]);
    let checked = std::panic::catch_unwind(|| {
        refused(&out, &full, &["No space left on device"]);
        assert!(mount("remount,size=16m"), "the disk does not grow");
        lab.run(&out, &["--resume"]);
        assert!(&bytes_below(&out) == outputs());
    });
    assert!(Command::new("umount").arg(&disk).status().unwrap().success());
    checked.unwrap();
}

#[test]
fn frames_that_are_taken_away_stop_the_run_and_it_goes_on_when_they_are_back() {
    let lab = Lab::new();
    let out = lab.folder.path().join("taken");
    let (frames, away) = (lab.experiment.join("frames"), lab.experiment.join("away"));
    let child = start(&lab, &out);
    wait_for_rows(&out, 2);
    fs::rename(&frames, &away).unwrap();
    let output = child.wait_with_output().unwrap();
    refused(&out, &output, &["experiment/frames", "the folder is gone"]);
    assert!(journal_rows(&out) >= 2);
    fs::rename(&away, &frames).unwrap();
    lab.run(&out, &["--resume"]);
    assert!(&bytes_below(&out) == outputs());
}

#[test]
fn a_picture_that_is_still_being_written_costs_its_own_row_only() {
    let lab = Lab::new();
    let out = lab.folder.path().join("half");
    let path = lab.experiment.join("frames/00003.png");
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    let child = start(&lab, &out);
    wait_for_rows(&out, 4);
    // The camera is done with it. What was read was half of it.
    fs::write(&path, &whole).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
    let rows = snakeloop::record::read_measurements(&out.join("measurements.csv")).unwrap().rows;
    let statuses: Vec<String> = rows.iter().map(|row| row.status.to_string()).collect();
    let expected: Vec<&str> = (0..lab.frames).map(|index| if index == 3 { "unreadable" } else { "ok" }).collect();
    assert_eq!(statuses, expected);
}

#[test]
fn a_run_is_not_continued_with_other_inputs_or_options() {
    let lab = Lab::new();
    let out = lab.folder.path().join("out");
    let mut child = start(&lab, &out);
    wait_for_rows(&out, 1);
    child.kill().unwrap();
    child.wait().unwrap();
    let kept = fs::read(out.join("measurements.journal")).unwrap();
    let resume = |more: &[&str]| {
        let output = lab.snakeloop(&[&["run", "experiment", "-o", text(&out), "--resume"], more].concat());
        assert_eq!(output.status.code(), Some(1), "{}", said(&output));
        assert_eq!(fs::read(out.join("measurements.journal")).unwrap(), kept);
        said(&output)
    };
    assert!(resume(&["--gate", "3"]).contains("gate was 4.5 then and is 3.0 now"));
    assert!(resume(&["--follow"]).contains("follow was false then and is true now"));
    assert!(resume(&["--shard", "1/2"]).contains("shard was \"1/1\" then and is \"1/2\" now"));
    let encoders = lab.experiment.join("encoders.csv");
    let log = fs::read_to_string(&encoders).unwrap();
    fs::write(&encoders, log.clone() + "99,1.0,0.0,0.0,0.0\n").unwrap();
    assert!(resume(&[]).contains("encoders.csv was "));
    fs::write(&encoders, log).unwrap();
    let frame = lab.experiment.join("frames/00002.png");
    fs::copy(lab.experiment.join("frames/00000.png"), &frame).unwrap();
    assert!(resume(&[]).contains("side was "));
    // Without --resume it begins anew.
    lab.run(&out, &[]);
    assert!(!out.join("measurements.journal").exists());
}

#[test]
fn shards_are_merged_to_what_one_run_writes() {
    let lab = Lab::new();
    let folder = |part: usize| lab.folder.path().join(format!("part{part}"));
    let [one, two, three] = [1, 2, 3].map(folder);
    let merged = lab.folder.path().join("merged");
    lab.run(&one, &["--shard", "1/3", "--jobs", "1"]);
    lab.run(&three, &["--shard", "3/3", "--jobs", "2"]);
    let merge = |shards: &[&Path]| {
        let shards: Vec<&str> = shards.iter().map(|shard| text(shard)).collect();
        lab.snakeloop(&[&["merge"], &shards[..], &["-o", text(&merged)]].concat())
    };
    let missing = merge(&[&one, &three]);
    assert_eq!((missing.status.code(), said(&missing).contains("shards are missing: 2/3")), (Some(2), true));
    let twice = merge(&[&one, &three, &one]);
    assert!(said(&twice).contains("shard 1/3 is there twice"));

    // One is killed, and another has other options.
    let arguments = ["run", "experiment", "-o", text(&two), "--shard", "2/3"];
    let mut child = lab.command().args(arguments).spawn().unwrap();
    wait_for_rows(&two, 1);
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(said(&merge(&[&one, &two, &three])).contains("the shard is not done"));
    lab.run(&two, &["--shard", "2/3", "--keep", "0.9"]);
    assert!(said(&merge(&[&one, &two, &three])).contains("keep was "));
    assert!(!merged.exists(), "nothing is written before all is checked");
    lab.run(&two, &["--shard", "2/3"]);

    let done = merge(&[&three, &one, &two]);
    assert!(done.status.success(), "{}", said(&done));
    assert!(&bytes_below(&merged) == outputs());
    // A shard that is done is not measured again.
    assert!(said(&lab.run(&two, &["--shard", "2/3", "--resume"])).contains("3 frames"));
}

#[test]
fn shards_that_follow_the_camera_go_through_all_frames_and_merge_to_what_one_run_writes() {
    let lab = Lab::new();
    // A camera that turns a little from frame to frame.
    for index in 0..lab.frames as u32 {
        let path = lab.experiment.join(format!("frames/{index:05}.png"));
        let seen = image::open(&path).unwrap().into_rgb8();
        let (right, down) = (seen.width() - 1, seen.height() - 1);
        let turned = image::RgbImage::from_fn(seen.width(), seen.height(), |x, y| {
            *seen.get_pixel((x + 3 * index).min(right), (y + 2 * index).min(down))
        });
        turned.save(&path).unwrap();
    }
    let [whole, one, two, merged] = ["whole", "one", "two", "merged"].map(|name| lab.folder.path().join(name));
    lab.run(&whole, &["--follow"]);
    lab.run(&one, &["--follow", "--shard", "1/2", "--jobs", "1"]);
    lab.run(&two, &["--follow", "--shard", "2/2"]);
    let done = lab.snakeloop(&["merge", text(&two), text(&one), "-o", text(&merged)]);
    assert!(done.status.success(), "{}", said(&done));
    assert!(bytes_below(&merged) == bytes_below(&whole));
    let rows = String::from_utf8(bytes_below(&whole)["measurements.csv"].clone()).unwrap();
    assert_eq!(rows.matches(",ok,").count(), lab.frames, "{rows}");
    // It is followed, and not merely near enough.
    let still = said(&lab.snakeloop(&["run", "experiment", "-o", text(&one)]));
    assert!(still.contains("camera_moved 7"), "{still}");
}
