//! The eye against rendered pictures whose truth is known. The renderer casts rays at the body's surfaces and shares no
//! code with the outlines that the eye fits.

mod bending_experiments;
mod drift;
mod measuring;
mod rigs;
mod robustness;
#[path = "../harness/scenes.rs"]
mod scenes;
mod shape;
mod uncertainty;
