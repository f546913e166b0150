//! The program as its users meet it: commands and files go in; files, words and exit codes come out.

#[path = "../harness/program.rs"]
mod program;

mod backbones;
mod book;
#[cfg(feature = "opencv")]
mod calibrate_camera;
mod commands;
mod discover;
mod faults;
mod first_hour;
mod live;
mod run;
mod several_views;
mod verdict;
