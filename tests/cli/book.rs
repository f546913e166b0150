//! Every `snakeloop` command of README.md and of the book, run as it stands, in the shell, in a folder that has what the page speaks of.

use crate::faults::fixture::{copy_folder, rendered};
use crate::program::Sandbox;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What a command that is not run begins with or contains, and why it is not.
const NOT_RUN: [(&str, &str); 12] = [
    ("--camera 0", "needs a camera"),
    ("live fixtures/bending", "runs until it is asked to end; tests/cli/live runs it"),
    ("$SLURM", "needs a cluster; tests/cli/run runs shards"),
    ("parallel snakeloop", "needs GNU parallel; tests/cli/run runs shards"),
    ("merge parts", "merges what the commands above made"),
    ("calibrate camera boards", "needs OpenCV and pictures; tests/cli/calibrate_camera runs it"),
    ("simulate --closed-loop", "takes a minute; closed_loop's own test runs a short one"),
    ("snakeloop reproduce", "takes half a minute; tests/golden holds its numbers"),
    ("discover", "takes up to a minute; tests/cli/discover runs it"),
    ("snakeloop completions", "writes into the home folder"),
    ("snakeloop manual", "writes into the system's folders"),
    ("render --poses", "takes a minute; tests/eye renders"),
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
        let text = fs::read_to_string(path).unwrap();
        let in_shell = text.split("```sh\n").skip(1).filter_map(|rest| rest.split("```").next()).flat_map(str::lines);
        // The examples of --help, on the page that holds its texts.
        let examples =
            text.split("Example:\n").skip(1).flat_map(|rest| rest.lines().take_while(|line| line.starts_with("  ")));
        let all = in_shell.chain(examples).map(str::trim).filter(|line| line.contains("snakeloop "));
        (path.strip_prefix(repository()).unwrap().display().to_string(), all.map(str::to_owned).collect())
    };
    pages.iter().map(commands).filter(|(_, commands): &(String, Vec<String>)| !commands.is_empty()).collect()
}

/// A folder with what pages speak of: the experiment, a run's outputs, tables and pictures under the names that they have there.
fn prepared() -> Sandbox {
    let sandbox = Sandbox::new();
    for name in ["EXPERIMENT", "fixtures/bending"] {
        copy_folder(rendered(), &sandbox.join(name));
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

#[test]
fn every_command_of_readme_and_book_runs_as_it_stands() {
    let program = Path::new(env!("CARGO_BIN_EXE_snakeloop"));
    let path = format!("{}:{}", program.parent().unwrap().display(), std::env::var("PATH").unwrap());
    let master = prepared();
    let mut passed_over = BTreeSet::new();
    let mut failed = Vec::new();
    let mut run = BTreeSet::new();
    for (page, commands) in pages() {
        for command in commands {
            if let Some((part, _)) = NOT_RUN.iter().find(|(part, _)| command.contains(part)) {
                passed_over.insert(*part);
                continue;
            }
            if !run.insert(command.clone()) {
                continue;
            }
            let sandbox = Sandbox::new();
            copy_folder(master.path(), sandbox.path());
            if command.contains("-o out")
                && ["snakeloop run", "snakeloop measure"].iter().any(|name| command.contains(name))
            {
                // It makes what the others of its page take.
                fs::remove_dir_all(sandbox.join("out")).unwrap();
            }
            let output =
                Command::new("sh").arg("-c").arg(&command).env("PATH", &path).current_dir(sandbox.path()).output();
            let output = output.unwrap();
            if !output.status.success() {
                failed.push(format!("{page}: {command}\n{}", String::from_utf8_lossy(&output.stderr)));
            }
        }
    }
    assert!(failed.is_empty(), "{}", failed.join("\n"));
    assert!(run.len() > 15, "only {} commands were found", run.len());
    let stale: Vec<_> = NOT_RUN.iter().filter(|(part, _)| !passed_over.contains(part)).collect();
    assert!(stale.is_empty(), "in no page any more: {stale:?}");
}
