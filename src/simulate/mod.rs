//! The other way round, for tests: pictures of a snake whose bend is known.

mod body;
pub mod render;
pub mod scene;
pub mod score;
pub use render::{coverage, hidden_fraction, render};
pub use scene::Scene;
