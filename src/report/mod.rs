//! What a person looks at: overlays on frames, plots, the HTML page.

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
