//! Outputs and inputs that are not what they should be: an output that is an input, a folder of another call, a place that takes nothing,
//! and things in a frame's place that are none.

use super::fixture::{FRAMES, sandbox};
use crate::program::{Sandbox, all_said, data, text};
use std::fs;
use std::process::{Command, Output, Stdio};

/// Calls the program through a shell, which redirects its output.
fn in_shell(sandbox: &Sandbox, line: &str, redirected: &str) -> Output {
    let script = format!("exec \"$0\" {line} {redirected}");
    let program = env!("CARGO_BIN_EXE_snakeloop");
    Command::new("bash").current_dir(sandbox.path()).args(["-c", &script, program]).output().unwrap()
}

#[test]
fn no_output_replaces_an_input_and_no_call_mixes_with_another() {
    let sandbox = Sandbox::new();
    sandbox.copy_bending(&[2]);
    sandbox.write_hidden_model();
    fs::rename(sandbox.join("hidden.toml"), sandbox.join("bending/model.toml")).unwrap();
    let settings = sandbox.read("bending/experiment.toml");
    sandbox.write("bending/experiment.toml", &format!("model = \"model.toml\"\n{settings}"));
    let inputs = ["model.toml", "encoders.csv"].map(|name| sandbox.read(&format!("bending/{name}")));
    for (line, input) in [
        ("run bending -o bending", "model.toml"),
        ("live bending -o bending", "model.toml"),
        ("live bending --model out/model.toml -o out", "model.toml"),
        ("discover bending -o bending/../bending", "model.toml"),
        ("estimate --measurements m.csv --encoders e.csv --model bending/model.toml -o bending", "model.toml"),
    ] {
        fs::create_dir_all(sandbox.join("out")).unwrap();
        let message = sandbox.fail(line, 1);
        assert!(message.contains(input) && message.contains("would replace it"), "{line}: {message}");
    }
    assert_eq!(["model.toml", "encoders.csv"].map(|name| sandbox.read(&format!("bending/{name}"))), inputs);

    sandbox.simulate("ride", "");
    sandbox.succeed(&format!("discover {} -o found --quiet", data("ride")));
    for line in ["run bending -o found", "live bending -o found"] {
        let message = sandbox.fail(line, 1);
        assert!(message.contains("`discover` made this") && message.contains("another folder"), "{line}: {message}");
    }
}

#[test]
fn of_two_runs_started_together_one_gets_in() {
    let sandbox = sandbox();
    // A call waits 0.4 s for another one to let go: the run must last longer than that.
    let frame = |index: usize| sandbox.join(&format!("experiment/frames/{index:05}.png"));
    for index in FRAMES..8 * FRAMES {
        fs::copy(frame(index % FRAMES), frame(index)).unwrap();
    }
    for round in 0..3 {
        let start = || {
            let mut command = sandbox.command(&format!("run experiment -o out{round} --jobs 1 --overlays none"));
            command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
        };
        let both = [start(), start()].map(|child| all_said(&child.wait_with_output().unwrap()));
        let refused = both.iter().filter(|said| said.contains("another call of snakeloop is working")).count();
        assert_eq!(refused, 1, "{both:?}");
    }
    // One frame gives no estimate: nothing that looks like one stands beside what an earlier run left.
    for index in 1..8 * FRAMES {
        fs::remove_file(frame(index)).unwrap();
    }
    fs::create_dir(sandbox.join("out")).unwrap();
    fs::write(sandbox.join("out/model.toml"), "an earlier run's").unwrap();
    assert!(sandbox.fail("run experiment -o out", 1).contains("give no estimate"));
    assert!(!sandbox.join("out/estimate.csv").exists());
}

#[test]
fn words_that_nobody_takes_cost_no_work_and_a_result_that_is_lost_is_no_success() {
    let sandbox = Sandbox::new();
    for redirected in ["2>&-", "2>/dev/full"] {
        assert_eq!(
            in_shell(&sandbox, "invert --model nowhere.toml --theta-deg 3 --delta-deg 0", redirected).status.code(),
            Some(1)
        );
        let output = in_shell(&sandbox, "table --force-limits=-1,1 --theta-deg 0:60:30 -o table", redirected);
        assert_eq!(output.status.code(), Some(0), "with warnings: {}", all_said(&output));
    }
    let line = "invert --theta-deg 30 --delta-deg 0 --json";
    let full = in_shell(&sandbox, line, ">/dev/full");
    assert_eq!(full.status.code(), Some(1));
    assert!(all_said(&full).contains("the result was not written: No space left"), "{}", all_said(&full));
    assert_eq!(in_shell(&sandbox, line, "| head -c 1; exit ${PIPESTATUS[0]}").status.code(), Some(0));
}

#[cfg(unix)]
#[test]
fn what_is_no_picture_in_a_frames_place_has_its_row() {
    let sandbox = Sandbox::new();
    sandbox.copy_bending(&[2]);
    let frame = |index: u32| sandbox.join(&format!("bending/frames/{index:05}.jpg"));
    std::os::unix::fs::symlink("nowhere", frame(3)).unwrap();
    fs::create_dir(frame(4)).unwrap();
    assert!(Command::new("mkfifo").arg(text(&frame(5))).status().unwrap().success());
    // Far more pixels than the camera has are not decoded.
    image::GrayImage::new(4000, 2000).save(frame(6)).unwrap();
    sandbox.succeed("measure bending -o out --quiet");
    let rows = sandbox.measurements("out/measurements.csv");
    let statuses: Vec<String> = rows.iter().map(|row| row.status.to_string()).collect();
    assert_eq!(statuses, ["ok", "unreadable", "unreadable", "unreadable", "wrong_size"]);
}
