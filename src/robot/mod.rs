//! The snake and its actuation line: parameters, kinematics, statics, friction and the compensation ε.
//!
//! Symbols are the paper's. i = 1, 2, 3 counts the secondary backbones; vectors over them are `Vector3<f64>`, element 0
//! being backbone 1.

pub mod compensation;
pub mod curve;
pub mod effects;
pub mod friction;
pub mod kinematics;
pub mod model;
pub mod motion;
pub mod parameters;
pub mod redundancy;
pub mod statics;
pub mod table;

pub use compensation::{MAX_THETA, Response};
pub use curve::Curve;
pub use effects::{Effect, LIBRARY, Physics};
pub use friction::{Friction, FrictionFit, FrictionSample};
pub use model::{Estimate, Model};
pub use motion::{Mechanics, Motion, Observation};
pub use parameters::{Body, Robot};
pub use redundancy::{ForceLimits, Sharing};
pub use table::{Grid, GridAxis, TableRow, compensation_table};
