//! The snake and its actuation line: parameters, kinematics, statics, friction and the compensation ε.
//!
//! Symbols are the paper's. i = 1 … n counts the secondary backbones, of which the paper's robot has three; vectors over them are
//! [`PerBackbone`], element 0 being backbone 1.

pub mod backbones;
pub mod compensation;
pub mod curve;
pub mod data_range;
mod directions;
pub mod drive;
pub mod effects;
pub mod forward;
pub mod friction;
pub mod history;
pub mod kinematics;
pub mod limits;
pub mod line;
pub mod mechanics;
pub mod model;
mod motion;
pub mod neighbours;
pub mod parameters;
pub mod path;
pub mod predictor;
pub mod redundancy;
mod single_pose;
pub mod statics;
pub mod table;
pub mod uncertainty;

pub use backbones::{BACKBONES, PerBackbone};
pub use compensation::Response;
pub use curve::{BendProfile, Curve, MODES, PROFILE};
pub use data_range::DataRange;
pub use effects::{COUPLINGS, DRIVE, Effect, LIBRARY, Physics};
pub use forward::{ForwardSolution, LineJacobian};
pub use friction::{Friction, FrictionFit, FrictionSample};
pub use history::{Motion, Play};
pub use kinematics::MAX_THETA;
pub use limits::OutOfRange;
pub use mechanics::Mechanics;
pub use model::{Estimate, Model};
pub use motion::Observation;
pub use neighbours::{NEIGHBOURS, Neighbours};
pub use parameters::{Body, Robot, Tool};
pub use path::PathPoint;
pub use predictor::{Predicted, Predictor};
pub use redundancy::{ForceLimits, Sharing};
pub use table::{Grid, GridAxis, TableRow, compensation_table};
