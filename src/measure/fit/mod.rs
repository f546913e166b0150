//! From the picture's edges to the bend: candidates, matched edges, the fit, its uncertainty, and which parts of the snake are
//! visible.

mod bend;
mod coarse;
mod correspondences;
mod edges;
mod shape;
pub mod solve;
mod uncertainty;
mod visibility;

pub(super) use bend::{ALTERNATIVE_COST_RATIO, BendFit, FINE_SEARCH_PX, FitSchedule, Start, fit_bend};
pub(super) use coarse::CoarseSearch;
pub use correspondences::EdgeBias;
pub(super) use correspondences::{BIASES, BiasPrior, Correspondences, Linearised, State, fine_filter, predict_blur};
pub use edges::{Edge, EdgeFinder};
pub(super) use uncertainty::{clustered_covariance, inliers, robust_weights, systematic_covariance};
pub use visibility::PartVisibility;
