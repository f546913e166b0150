//! Where camera, grid target and snake are: the rig, and all that is done with it.
//!
//! | file | what it does |
//! | --- | --- |
//! | `parameters` | the rig as data (its file, rig.toml, is `record`'s) |
//! | `error` | why a rig could not be calibrated |
//! | `body_template`, `unlike`, `snake_search` | find the straight snake before a sheet whose scale is known |
//! | `alignment` | moves it along its axis to where its disks and ends are |
//! | `sketch` | what a calibration saw, for a person to look at |
//! | `placement`, `base_problem`, `base_fit`, `tilt`, `scale` | fit the straight snake before its grid, and check the scale that was stated |
//! | `colours` | what tells snake from target, and looks through the printed lines |
//! | `calibrate` | the calibration from the straight picture, which calls these in order |
//! | `base_monitor`, `drift` | whether holder and target are still where the rig says |
//! | `refine` | the rig once more, from frames of bent snakes |
//! | `follow` | the rig of a camera that moves |
//!
//! Nothing here knows the eye, which stands on top.

mod alignment;
mod base_fit;
mod base_monitor;
mod base_problem;
mod body_template;
mod calibrate;
mod colours;
mod drift;
mod error;
mod follow;
mod parameters;
mod placement;
mod refine;
mod scale;
mod sketch;
mod snake_search;
mod tilt;
mod unlike;

pub use base_fit::STRAIGHT;
pub(super) use base_fit::StraightPicture;
pub(super) use calibrate::find_rig;
pub(super) use colours::lit_region;
pub(super) use drift::{DriftCheck, RigDriftMonitor};
pub use error::{CalibrationStep, RigError, SnakePart};
pub(super) use follow::{Followed, RigFollower};
pub use parameters::{Rig, RigOptions};
pub(super) use refine::{SnakePlane, refined_rig};
pub use sketch::RigSketch;
