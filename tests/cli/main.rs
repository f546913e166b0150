//! The program as its users meet it: commands and files go in; files, words and exit codes come out.

#[path = "../harness/program.rs"]
mod program;
#[path = "../harness/scenes.rs"]
#[allow(dead_code, reason = "the rest is for the tests of the eye")]
mod scenes;

mod backbones;
mod book;
#[cfg(feature = "opencv")]
mod calibrate_camera;
mod commands;
mod discover;
mod faults;
mod first_hour;
mod inputs;
mod live;
mod log;
mod recordings;
mod run;
mod several_views;
mod verdict;
