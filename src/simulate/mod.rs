//! Simulated robots: encoder readings and rendered pictures of a snake whose bend is known, for tests and for those who have no robot.

mod body;
pub mod experiment;
pub mod plant;
pub mod render;
pub mod scene;
pub mod sealed;
pub mod trajectory;

pub use experiment::{FrameFormat, out_of_picture, write_experiment};
pub use plant::{Plant, Sample, SimulatedEye};
pub use render::{coverage, hidden_fraction, render};
pub use scene::Scene;
pub use sealed::Sealed;
pub use trajectory::BendingExperiment;
