//! What a laboratory does to a long run: kills it, fills its disk, takes its input away, hands it half a picture. Nothing is lost
//! but the frames in hand, and every output is whole or absent.

mod calm;
pub mod fixture;
mod outputs;
mod unseen;
mod worth;

use crate::program::{Sandbox, all_said, text};
use fixture::{FRAMES, bytes_below, journal_rows, outputs, run, sandbox};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Frames that are measured at a time: what a kill may cost.
const IN_HAND: usize = 4;

/// Starts `run --resume` in the background, with so many threads.
fn start(sandbox: &Sandbox, out: &str, jobs: usize) -> Child {
    let mut command = sandbox.command(&format!("run experiment -o {out} --resume --jobs {jobs}"));
    command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

fn kill(mut child: Child) {
    child.kill().unwrap();
    child.wait().unwrap();
}

/// Waits until the journal has so many rows.
fn wait_for_rows(out: &Path, rows: usize) {
    let start = Instant::now();
    while journal_rows(out) < rows {
        assert!(start.elapsed() < Duration::from_secs(120), "no rows came");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Asserts that whatever stands in the folder is a whole file of the uninterrupted run, and that the journal's rows are the first
/// of its rows.
fn assert_nothing_is_half_written(out: &Path) {
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

/// Waits for a run until this moment, then kills it. Whether it was killed, and had not ended before.
fn killed_at(moment: Instant, mut child: Child) -> bool {
    while Instant::now() < moment {
        std::thread::sleep(Duration::from_millis(1));
        if child.try_wait().unwrap().is_some() {
            return false;
        }
    }
    kill(child);
    true
}

/// Kills runs so many times at random moments, resuming each until it is done, and asserts that no row is lost and that the
/// outputs are those of a run that was let alone.
fn kill_runs(times: usize) {
    let sandbox = sandbox();
    let out = sandbox.join("killed");
    let started = Instant::now();
    assert!(start(&sandbox, "killed", 2).wait_with_output().unwrap().status.success());
    let whole_run = started.elapsed();
    let mut random = StdRng::seed_from_u64(6);
    let mut kills = 0;
    while kills < times {
        let _ = fs::remove_dir_all(&out);
        let mut rows = 0;
        // From now and then at the very beginning to just before the end.
        while kills < times {
            let moment = Instant::now() + whole_run.mul_f64(random.random_range(0.0..1.1));
            if !killed_at(moment, start(&sandbox, "killed", 2)) {
                break;
            }
            kills += 1;
            if out.join("measurements.journal").exists() {
                let after = journal_rows(&out);
                assert!(after >= rows, "{rows}, then {after} rows");
                rows = after;
                // Every frame of so few is drawn once it is measured, and then its row is written.
                let drawn = bytes_below(&out).into_keys().filter(|name| name.ends_with(".jpg")).count();
                assert!((rows..=rows + IN_HAND).contains(&drawn), "{drawn} frames were measured, {rows} rows written");
            } else if out.join("report.html").exists() {
                // All was written; there was nothing left to do but to say so.
                break;
            }
            assert_nothing_is_half_written(&out);
        }
        run(&sandbox, "killed", "--resume --jobs 2");
        assert!(&bytes_below(&out) == outputs(), "not what the uninterrupted run wrote");
    }
}

#[test]
fn a_run_that_is_killed_again_and_again_ends_as_if_it_never_was() {
    kill_runs(5);
}

#[test]
#[ignore = "takes several minutes: cargo test --test cli two_hundred_kills -- --ignored"]
fn two_hundred_kills() {
    kill_runs(200);
}

/// Asserts that the run failed, said so in words with a file in them, and left nothing half written.
fn assert_refused(sandbox: &Sandbox, out: &str, output: &Output, expected: &[&str]) {
    let message = all_said(output);
    assert_eq!(output.status.code(), Some(1), "{message}");
    for part in expected.iter().chain(&[out, "error: ", "are kept in"]) {
        assert!(message.contains(part), "{part}: {message}");
    }
    assert_nothing_is_half_written(&sandbox.join(out));
    let left_behind = bytes_below(&sandbox.join(out)).into_keys().filter(|name| name.contains(".snakeloop-")).count();
    assert_eq!(left_behind, 0, "temporary files");
}

#[test]
fn a_file_that_may_not_grow_costs_nothing_that_was_measured() {
    let sandbox = sandbox();
    // Blocks of 1024 bytes: enough for the first rows, not for a picture.
    let limited = Command::new("bash")
        .current_dir(sandbox.path())
        .args(["-c", "trap '' XFSZ; ulimit -f 3; exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_snakeloop")])
        .args(["run", "experiment", "-o", "limited", "--jobs", "2"])
        .output()
        .unwrap();
    assert_refused(&sandbox, "limited", &limited, &["File too large"]);
    run(&sandbox, "limited", "--resume");
    assert!(&bytes_below(&sandbox.join("limited")) == outputs());
}

/// A file system in memory of a size of its own, unmounted when dropped.
struct Disk(String);

impl Disk {
    fn mount(folder: &Path, options: &str) -> Self {
        let output =
            Command::new("mount").args(["-t", "tmpfs", "-o", options, "tmpfs", text(folder)]).output().unwrap();
        assert!(output.status.success(), "mount: {}", all_said(&output));
        Self(text(folder).to_owned())
    }

    fn grow(&self) {
        let grown = Command::new("mount").args(["-o", "remount,size=16m", &self.0]).status().unwrap();
        assert!(grown.success(), "the disk does not grow");
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

#[test]
#[ignore = "needs the right to mount a file system (root): cargo test --test cli full_disk -- --ignored"]
fn a_full_disk_costs_nothing_that_was_measured() {
    let sandbox = sandbox();
    fs::create_dir(sandbox.join("disk")).unwrap();
    let disk = Disk::mount(&sandbox.join("disk"), "size=120k");
    let full = sandbox.call("run experiment -o disk/out --jobs 2");
    assert_refused(&sandbox, "disk/out", &full, &["No space left on device"]);
    disk.grow();
    run(&sandbox, "disk/out", "--resume");
    assert!(&bytes_below(&sandbox.join("disk/out")) == outputs());
}

#[test]
fn frames_that_are_taken_away_stop_the_run_and_it_goes_on_when_they_are_back() {
    let sandbox = sandbox();
    let out = sandbox.join("taken");
    let (frames, away) = (sandbox.join("experiment/frames"), sandbox.join("experiment/away"));
    let child = start(&sandbox, "taken", 1);
    wait_for_rows(&out, 2);
    fs::rename(&frames, &away).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_refused(&sandbox, "taken", &output, &["experiment/frames", "the folder is gone"]);
    assert!(journal_rows(&out) >= 2);
    fs::rename(&away, &frames).unwrap();
    run(&sandbox, "taken", "--resume");
    assert!(&bytes_below(&out) == outputs());
}

#[test]
fn an_output_folder_that_is_removed_during_a_run_is_written_anew_and_the_run_goes_well() {
    let sandbox = sandbox();
    let out = sandbox.join("removed");
    let child = start(&sandbox, "removed", 1);
    wait_for_rows(&out, 2);
    fs::remove_dir_all(&out).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", all_said(&output));
    let mut found = bytes_below(&out);
    for (name, content) in outputs() {
        // What was drawn before is gone with the folder, and from the report.
        if name.ends_with(".csv") || name.starts_with("compensation") || name == "model.toml" {
            assert!(found.remove(name).as_ref() == Some(content), "{name}");
        }
    }
    assert!(found.contains_key("report.html") && !found.contains_key("measurements.journal"));
}

#[test]
fn a_picture_that_is_still_being_written_costs_its_own_row_only() {
    let sandbox = sandbox();
    let path = sandbox.join("experiment/frames/00003.png");
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    let child = start(&sandbox, "half", 2);
    wait_for_rows(&sandbox.join("half"), 4);
    // The camera is done with it. What was read was half of it.
    fs::write(&path, &whole).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", all_said(&output));
    let rows = sandbox.measurements("half/measurements.csv");
    let statuses: Vec<String> = rows.iter().map(|row| row.status.to_string()).collect();
    let expected: Vec<&str> = (0..FRAMES).map(|index| if index == 3 { "unreadable" } else { "ok" }).collect();
    assert_eq!(statuses, expected);
}

#[test]
fn a_run_is_not_continued_with_other_inputs_or_options() {
    let sandbox = sandbox();
    let journal = sandbox.join("out/measurements.journal");
    let child = start(&sandbox, "out", 1);
    wait_for_rows(&sandbox.join("out"), 1);
    kill(child);
    let kept = fs::read(&journal).unwrap();
    let refused = |more: &str, why: &str| {
        let message = sandbox.fail(&format!("run experiment -o out --resume {more}"), 1);
        assert!(message.contains(why), "{message}");
        assert_eq!(fs::read(&journal).unwrap(), kept);
    };
    refused("--gate 3", "gate was 4.5 then and is 3.0 now");
    refused("--follow", "follow was false then and is true now");
    refused("--shard 1/2", "shard was \"1/1\" then and is \"1/2\" now");
    let log = sandbox.read("experiment/encoders.csv");
    sandbox.write("experiment/encoders.csv", &(log.clone() + "99,1.0,0.0,0.0,0.0\n"));
    refused("", "encoders.csv was ");
    sandbox.write("experiment/encoders.csv", &log);
    fs::copy(sandbox.join("experiment/frames/00000.png"), sandbox.join("experiment/frames/00002.png")).unwrap();
    refused("", "side was ");
    // Without --resume it begins anew.
    run(&sandbox, "out", "");
    assert!(!journal.exists());
}

#[test]
fn shards_are_merged_to_what_one_run_writes() {
    let sandbox = sandbox();
    run(&sandbox, "part1", "--shard 1/3 --jobs 1");
    run(&sandbox, "part3", "--shard 3/3 --jobs 2");
    assert!(sandbox.fail("merge part1 part3 -o merged", 2).contains("shards are missing: 2/3"));
    assert!(sandbox.fail("merge part1 part3 part1 -o merged", 1).contains("shard 1/3 is there twice"));

    // One is killed, and another has other options.
    let child = sandbox.command("run experiment -o part2 --shard 2/3 --jobs 1").spawn().unwrap();
    wait_for_rows(&sandbox.join("part2"), 1);
    kill(child);
    let merge = "merge part1 part2 part3 -o merged";
    assert!(sandbox.fail(merge, 1).contains("the shard is not done"));
    run(&sandbox, "part2", "--shard 2/3 --keep 0.9");
    assert!(sandbox.fail(merge, 1).contains("forgetting was "));
    assert!(!sandbox.join("merged").exists(), "nothing is written before all is checked");
    run(&sandbox, "part2", "--shard 2/3");

    sandbox.succeed("merge part3 part1 part2 -o merged");
    assert!(&bytes_below(&sandbox.join("merged")) == outputs());
    // A shard that is done is not measured again.
    assert!(all_said(&run(&sandbox, "part2", "--shard 2/3 --resume")).contains("3 frames"));
}

#[test]
fn shards_that_follow_the_camera_go_through_all_frames_and_merge_to_what_one_run_writes() {
    let sandbox = sandbox();
    // A camera that turns a little from frame to frame.
    for index in 0..FRAMES as u32 {
        let path = sandbox.join(&format!("experiment/frames/{index:05}.png"));
        let seen = image::open(&path).unwrap().into_rgb8();
        let (right, down) = (seen.width() - 1, seen.height() - 1);
        let turned = image::RgbImage::from_fn(seen.width(), seen.height(), |x, y| {
            *seen.get_pixel((x + 2 * index).min(right), (y + index).min(down))
        });
        turned.save(&path).unwrap();
    }
    run(&sandbox, "whole", "--follow");
    run(&sandbox, "part1", "--follow --shard 1/2 --jobs 1");
    run(&sandbox, "part2", "--follow --shard 2/2");
    sandbox.succeed("merge part2 part1 -o merged");
    assert!(bytes_below(&sandbox.join("merged")) == bytes_below(&sandbox.join("whole")));
    let rows = sandbox.read("whole/measurements.csv");
    // In pictures this small a bend towards the camera may be refused.
    assert!(rows.matches(",ok,").count() >= FRAMES - 1, "{rows}");
    // It is followed, and not merely near enough. The last frame is shifted by 16 px, further than the holder is looked for.
    let still = all_said(&sandbox.call("run experiment -o part1"));
    assert!(still.contains("frames measured  1 of 8") && still.contains("camera_moved 6"), "{still}");
}
