//! Every `snakeloop` command of README.md and of the book, run as it stands, in the shell, in a folder that has what the page speaks of.

use crate::faults::fixture::{copy_folder, rendered, write_clean};
use crate::program::Sandbox;
use crate::scenes::smaller;
use snakeloop::simulate::{BendingExperiment, Scene};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What a command contains that is not run here, and why it is not.
const NOT_RUN: [(&str, &str); 6] = [
    ("docker ", "needs Docker"),
    ("--camera 0", "needs a camera"),
    ("$SLURM", "needs a cluster; tools/cluster runs it on a Slurm of one machine"),
    ("parallel snakeloop", "needs GNU parallel; tools/cluster runs it"),
    ("--ros2", "needs a build with ROS 2, and topics; tests/cli/live/ros2.rs runs it"),
    ("calibrate camera boards", "needs OpenCV and pictures; tests/cli/calibrate_camera runs it"),
];
/// What a command contains that takes long: the test of these is ignored.
const SLOW: [&str; 6] = [
    "live fixtures/bending",
    "merge parts",
    "simulate --closed-loop",
    "snakeloop reproduce",
    "snakeloop discover",
    "render --poses",
];

fn repository() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// The pages in which commands stand, each with its commands in order.
fn pages() -> Vec<(String, Vec<String>)> {
    let mut pages = vec![repository().join("README.md")];
    for pattern in ["docs/src/*.md", "docs/src/*/*.md"] {
        pages.extend(glob::glob(repository().join(pattern).to_str().unwrap()).unwrap().map(Result::unwrap));
    }
    let commands = |path: &PathBuf| {
        let text = fs::read_to_string(path).unwrap().replace("\\\n", " ");
        let in_shell = text.split("```sh\n").skip(1).filter_map(|rest| rest.split("```").next()).flat_map(str::lines);
        // The examples of --help, on the page that holds its texts.
        let examples =
            text.split("Example:\n").skip(1).flat_map(|rest| rest.lines().take_while(|line| line.starts_with("  ")));
        let all = in_shell.chain(examples).map(str::trim).filter(|line| line.contains("snakeloop "));
        (path.strip_prefix(repository()).unwrap().display().to_string(), all.map(str::to_owned).collect())
    };
    pages.iter().map(commands).filter(|(_, commands): &(String, Vec<String>)| !commands.is_empty()).collect()
}

/// A folder with what pages speak of: an experiment of PNG files, a run's outputs, tables and pictures under the names that they have there.
fn prepared(experiment: &Path) -> Sandbox {
    let sandbox = Sandbox::new();
    for name in ["EXPERIMENT", "fixtures/bending"] {
        copy_folder(experiment, &sandbox.join(name));
    }
    fs::create_dir_all(sandbox.join("loaded")).unwrap();
    copy_folder(&repository().join("calib"), &sandbox.join("calib"));
    copy_folder(&repository().join("fixtures/real"), &sandbox.join("fixtures/real"));
    sandbox.succeed("run EXPERIMENT -o out --quiet");
    fs::create_dir_all(sandbox.join("found")).unwrap();
    let copies = [
        ("out/measurements.csv", "m.csv"),
        ("out/model.toml", "found/model.toml"),
        ("out/measurements.csv", "loaded/measurements.csv"),
        ("EXPERIMENT/encoders.csv", "e.csv"),
        ("EXPERIMENT/encoders.csv", "loaded/encoders.csv"),
        ("EXPERIMENT/camera.yaml", "camera.yaml"),
        ("EXPERIMENT/straight.png", "straight.png"),
    ];
    for (from, to) in copies {
        fs::copy(sandbox.join(from), sandbox.join(to)).unwrap();
    }
    sandbox.write_hidden_model();
    sandbox
}

/// Runs a page's command in a copy of the folder; `None` where it went well, else what it said.
fn failure_of(command: &str, page: &str, master: &Sandbox) -> Option<String> {
    let program = Path::new(env!("CARGO_BIN_EXE_snakeloop")).parent().unwrap();
    let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap());
    let sandbox = Sandbox::new();
    copy_folder(master.path(), sandbox.path());
    fs::create_dir_all(sandbox.join(".local/share/bash-completion/completions")).unwrap();
    if command.contains("-o out")
        && ["snakeloop run", "snakeloop measure", "snakeloop merge"].iter().any(|name| command.contains(name))
    {
        // It makes what the others of its page take.
        fs::remove_dir_all(sandbox.join("out")).unwrap();
    }
    // What runs until it is asked to end is asked after a while, once: a second signal would end it without its tables.
    let line = if command.contains("snakeloop live") {
        "exec timeout --foreground --preserve-status -s INT 15 sh -c \"exec $0\""
    } else {
        "sh -c \"$0\""
    };
    let mut call = Command::new("sh");
    call.arg("-c").arg(line).arg(command);
    let output = call.env("PATH", &path).env("HOME", sandbox.path()).current_dir(sandbox.path()).output().unwrap();
    (!output.status.success()).then(|| format!("{page}: {command}\n{}", String::from_utf8_lossy(&output.stderr)))
}

/// Every command that is run, once, with its page; the slow ones or the others.
fn commands(slow: bool) -> Vec<(String, String)> {
    let mut seen = BTreeSet::new();
    let all = pages().into_iter().flat_map(|(page, commands)| commands.into_iter().map(move |c| (page.clone(), c)));
    all.filter(|(_, command)| {
        let is_run = !NOT_RUN.iter().any(|(part, _)| command.contains(part));
        is_run && SLOW.iter().any(|part| command.contains(part)) == slow && seen.insert(command.clone())
    })
    .collect()
}

#[test]
fn every_command_of_readme_and_book_runs_as_it_stands() {
    let master = prepared(rendered());
    let commands = commands(false);
    let failed: Vec<_> = commands.iter().filter_map(|(page, command)| failure_of(command, page, &master)).collect();
    assert!(failed.is_empty(), "{}", failed.join("\n"));
    assert!(commands.len() > 15, "only {} commands were found", commands.len());
    let all: Vec<String> = pages().into_iter().flat_map(|(_, commands)| commands).collect();
    let parts = NOT_RUN.iter().map(|(part, _)| *part).chain(SLOW);
    let stale: Vec<_> = parts.filter(|part| !all.iter().any(|command| command.contains(part))).collect();
    assert!(stale.is_empty(), "in no page any more: {stale:?}");
}

/// `cargo test --release --no-default-features --features cli --test cli slow_commands -- --ignored`
#[test]
#[ignore = "takes minutes: discover, reproduce, the closed loop, live, rendered frames"]
fn slow_commands_of_readme_and_book_run_as_they_stand() {
    // `discover` asks for more samples than the others do.
    let experiment = tempfile::tempdir().unwrap();
    let mut scene = smaller(Scene::default(), 3);
    (scene.sensor.rays_per_pixel, scene.sensor.noise) = (8, 1.0);
    write_clean(experiment.path(), &BendingExperiment::default(), &scene, 1);
    let master = prepared(experiment.path());
    for shard in 1..=2 {
        master.succeed(&format!("run EXPERIMENT -o parts/{shard} --shard {shard}/2 --quiet"));
    }
    let page = fs::read_to_string(repository().join("docs/src/how-to/discover.md")).unwrap();
    let effects = page.split("```toml\n# own.toml\n").nth(1).and_then(|rest| rest.split("```").next());
    master.write("own.toml", effects.unwrap());
    let commands = commands(true);
    let failed: Vec<_> = commands.iter().filter_map(|(page, command)| failure_of(command, page, &master)).collect();
    assert!(failed.is_empty(), "{}", failed.join("\n"));
    assert!(commands.len() >= SLOW.len());
}

/// The names of tests that the book gives to `cargo test` are names of tests.
#[test]
fn tests_that_the_book_names_are_there() {
    let sources = glob::glob(repository().join("tests/**/*.rs").to_str().unwrap()).unwrap();
    let tests: String = sources
        .map(|path| {
            format!("mod {}\n{}", path.as_ref().unwrap().display(), fs::read_to_string(path.as_ref().unwrap()).unwrap())
        })
        .collect();
    let names = tests.lines().filter(|line| line.trim_start().starts_with("fn ") || line.starts_with("mod "));
    let names: Vec<&str> = names.collect();
    let mut found = 0;
    for path in glob::glob(repository().join("docs/src/**/*.md").to_str().unwrap()).unwrap().map(Result::unwrap) {
        let text = fs::read_to_string(&path).unwrap();
        for line in text.lines().filter(|line| line.starts_with("cargo test ") && line.contains("--test ")) {
            let words: Vec<&str> = line.split_whitespace().collect();
            let is_option = |k: usize| words[k].starts_with('-') || ["--features", "--test"].contains(&words[k - 1]);
            for word in (2..words.len()).filter(|&k| !is_option(k)).map(|k| words[k]) {
                assert!(names.iter().any(|name| name.contains(word)), "{}: no test {word}", path.display());
                found += 1;
            }
        }
    }
    assert!(found > 0);
}
