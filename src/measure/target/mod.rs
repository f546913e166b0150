//! The grid target behind the snake: its pattern, its lines, the sheet that they are printed on, and the camera's pose to it.
//!
//! A grid is a sum of plane waves, and the phase of a wave tells where the lines are from every pixel of a window at once,
//! whatever the lines' colour or width; heavier lines every 5 or 10 mm lie on the same lattice and add to the same waves. The files
//! are the stages of the method:
//!
//! 1. `seed`: FFTs of parts of the picture show the waves of its rulings.
//! 2. `phases`: their phases are demodulated in windows all over the picture and counted from window to window as far as the sheet goes, which
//!    gives places of the lattice with their pixels.
//! 3. `sheet`, `sheet_fit`: the sheet's pose and shape (two pitches, shear, bow) from such places, both of its two possible leans tried.
//! 4. `lines`: the lines themselves, placed one by one where the sheet puts them, refine it.
//!
//! `grid` calls them in this order. `phase_monitor` tells frame by frame whether the target is still in its place, from
//! phases in a few windows of sparsely sampled pixels (`sparse_window`).

mod grid;
mod lines;
mod pattern;
mod phase_monitor;
mod phases;
mod print_profile;
mod region;
mod robust_linear;
mod seed;
mod sheet;
mod sheet_fit;
mod sparse_window;

pub use grid::{Grid, SheetHypothesis, SheetSearch};
pub use pattern::{GridPattern, PatternKind};
pub use phase_monitor::{DETECTION_SIGMAS, GridPhaseMonitor, GridShift, PHASE_SIGMA_PX};
pub use print_profile::{PrintProfile, look_through};
pub use region::PictureRegion;
pub use robust_linear::RobustLinear;
pub use sheet::{Sheet, SheetShape};
