//! Pages and pictures for people: overlays on frames, plots, HTML reports, sheets to print.

mod axis;
pub mod bend_map;
pub mod decimation;
pub mod discovery;
pub mod explain;
pub mod learning;
pub mod overlay;
mod page;
pub mod plot;
pub mod reproduction;
pub mod rig_picture;
mod run_course;
pub mod run_history;
pub mod run_page;
mod run_plots;
pub mod sheet;
pub mod verdict;
