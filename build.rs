//! Gives the program its version as reports and files state it: in a release build of a checkout with the commit that it is built from, and
//! `+changes` if the sources are not those of the commit. Other builds have the version alone, so that a commit does not make them anew.

use std::env;
use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let version = env::var("CARGO_PKG_VERSION").unwrap_or_default();
    let commit = env::var("PROFILE").is_ok_and(|profile| profile == "release").then(commit).flatten();
    let commit = commit.map(|commit| format!(" (commit {commit})")).unwrap_or_default();
    println!("cargo::rustc-env=SNAKELOOP_VERSION={version}{commit}");
}

/// The commit that is checked out; `None` if this is no checkout of its own.
fn commit() -> Option<String> {
    if !git(&["rev-parse", "--show-prefix"])?.is_empty() {
        return None;
    }
    for path in [git(&["rev-parse", "--git-path", "logs/HEAD"])?, "src".to_owned()] {
        println!("cargo::rerun-if-changed={path}");
    }
    let changes = git(&["status", "--porcelain", "--", "src", "Cargo.toml", "Cargo.lock", "build.rs"])?;
    Some(git(&["rev-parse", "--short=12", "HEAD"])? + if changes.is_empty() { "" } else { "+changes" })
}

/// What git says to these arguments in the package's folder.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}
