//! The grid target behind the snake: its pattern, its lines, and the camera's pose to it.
//!
//! A grid is a sum of plane waves, and the phase of a wave tells where the lines are from every pixel of a window at once,
//! whatever the lines' colour or width; heavier lines every 5 or 10 mm lie on the same lattice and add to the same waves. The files
//! are the stages of the method:
//!
//! 1. `seed`: an FFT of a part of the picture shows the two waves of the pattern.
//! 2. `phases`: their phases are demodulated in windows all over the picture and unwrapped from window to window, which gives
//!    places of the target with their pixels.
//! 3. `planar_pose`: the pose of a plane from such places, both of its two possible leans tried.
//! 4. `lines`: the lines themselves, placed one by one where the pose puts them, refine it.
//!
//! `grid` calls them in this order. `phase_monitor` tells frame by frame whether the target is still in its place, from
//! phases in a few windows of sparsely sampled pixels (`sparse_window`).

mod grid;
mod lines;
mod pattern;
mod phase_monitor;
mod phases;
mod planar_pose;
mod robust_linear;
mod seed;
mod sparse_window;

pub use grid::{Grid, find_grid};
pub use pattern::{GridPattern, PatternKind};
pub use phase_monitor::{DETECTION_SIGMAS, GridPhaseMonitor, GridShift, PHASE_SIGMA_PX};
pub use planar_pose::project_target;
pub use robust_linear::RobustLinear;
