//! The snake and its actuation line: parameters, kinematics, statics, friction and the compensation ε.
//!
//! Symbols are the paper's. i = 1 … n counts the secondary backbones, of which the paper's robot has three; vectors over them are
//! [`PerBackbone`], element 0 being backbone 1.

pub mod backbones;
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

pub use backbones::{BACKBONES, PerBackbone};
pub use compensation::{MAX_THETA, Response};
pub use curve::{BendProfile, Curve, MODES, PROFILE};
pub use effects::{Effect, LIBRARY, Physics};
pub use friction::{Friction, FrictionFit, FrictionSample};
pub use model::{Estimate, Model};
pub use motion::{Mechanics, Motion, Observation};
pub use parameters::{Body, Robot};
pub use redundancy::{ForceLimits, Sharing};
pub use table::{Grid, GridAxis, TableRow, compensation_table};
