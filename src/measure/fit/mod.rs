//! From the picture's edges to the bend.
//!
//! Bottom up: `edges` (sub-pixel edges near a border point), `noise_model` (how far they may be off), `glancing` (faces of disks, which
//! mirror the target at a glancing angle), `state` (what is fitted), `shape_prior` (how far the snake departs from an arc), `blur` (the blur along
//! the snake, and the filters that suit it), `correspondences` (the model's outline matched with the picture's edges),
//! `uncertainty` (robust weights, covariance), `evidence` (what edges say for the snake), `linearised` (residuals and their derivatives), `visibility` (which parts are seen),
//! `bend` (the fit) and `schedule` (its rounds), `coarse` (candidates for it) and `alternatives` (selection among its minima).

mod alternatives;
mod bend;
mod blur;
mod coarse;
mod correspondences;
mod decision;
mod edges;
mod evidence;
mod glancing;
mod linearised;
mod noise_model;
mod schedule;
mod shape_prior;
mod state;
mod uncertainty;
mod visibility;

pub(super) use alternatives::mirrored;
pub(super) use bend::{BendFit, FINE_SEARCH_PX, ProfileCovariance, Start, fit_bend};
pub(super) use blur::Filters;
pub(super) use coarse::{CoarseSearch, Shrink};
pub(super) use correspondences::Correspondences;
pub(super) use decision::{Decision, EDGE_ON_RAD, SAME_MINIMUM_RAD, distinct, heaviest};
pub use edges::{Edge, EdgeFinder};
pub(super) use linearised::Linearised;
pub(super) use noise_model::noise_model;
pub(super) use schedule::FitSchedule;
pub use shape_prior::UNKNOWN_SHAPE_RAD;
pub(super) use shape_prior::learned_mode_sigmas;
pub use state::EdgeBias;
pub(super) use state::{BIASES, CONTRADICTION_OF_KNOWN_CHI2, CONTRADICTION_OF_UNKNOWN_CHI2, FramePrior, STATE, State};
pub(super) use uncertainty::{RobustPhase, excess, inliers, systematic_covariance};
pub use visibility::PartVisibility;
