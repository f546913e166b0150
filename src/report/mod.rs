//! What a person looks at: overlays on frames, plots, the HTML page.

pub mod bend_map;
pub mod course;
pub mod discovery;
pub mod explain;
pub mod html;
pub mod learning;
pub mod overlay;
pub mod plot;
pub mod reproduction;
