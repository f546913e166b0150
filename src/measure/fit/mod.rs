//! From the picture's edges to the bend: candidates, matched edges, the fit, its certainty, and what of the snake is there to be seen.

pub mod bend;
pub mod certainty;
pub mod edges;
pub mod matches;
pub mod proof;
pub mod search;
pub mod shape;
pub mod solve;
