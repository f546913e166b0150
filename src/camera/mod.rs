//! Cameras: the lens model, camera files, and where frames come from.

pub mod lens;
pub use lens::Lens;
