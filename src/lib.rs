//! Measures a bending robot section in pictures, and corrects the motion that it loses between motors and tip.
//!
//! A section has three to eight backbones or tendons and any size. The model is that of Xu & Simaan, "Actuation Compensation for Flexible
//! Surgical Snake-like Robots with Redundant Remote Actuation" (ICRA 2006), called *the paper* throughout; "Eq. n" is an equation of it, and
//! its snake of Ø 4.2 mm is the default robot. The library measures the bend in pictures ([`measure`]), learns from the bends and the
//! encoders how much motion the actuation line takes up ([`estimate`]), and says what to command instead ([`robot`]).
//!
//! # Conventions
//!
//! Lengths are mm, forces N, stresses MPa, times s, angles radians (degrees in files, names end in `_deg`).
//! Frames, signs and the meaning of every symbol are fixed in [`geometry`] and [`robot`].
//!
//! # Modules
//!
//! [`prelude`] has what most programs need. Each module uses only those above it:
//!
//! | module | what it is |
//! | --- | --- |
//! | [`error`], [`geometry`], [`statistics`] | the error type; angles and poses; estimation tools under their textbook names |
//! | [`bag`] | ROS 2 recordings |
//! | [`robot`], [`camera`] | the snake: kinematics, statics, friction, ε; lenses and sources of frames |
//! | [`observation`] | measurements of frames and encoder readings, as plain values |
//! | [`measure`], [`estimate`] | frames → bend θ and azimuth δ; measurements → force scale η and backlash λ |
//! | [`verdict`] | whether a result can be relied on, and what to do if not |
//! | [`record`] | the files of an experiment: read, check, write |
//! | [`simulate`] | simulated robots and rendered frames |
//! | [`discover`] | which effect the model lacks |
//! | [`reproduce`] | the paper's tables and figures |
//! | [`closed_loop`] | controller and robot simulated together, through rendered frames |
//! | `report` (feature `report`) | overlays, plots, the HTML page |
//! | `live` (feature `live`) | the loop while the robot moves, with its dashboard |
#![doc = ""]
#![doc = include_str!("../docs/src/reference/library.md")]
#![warn(missing_docs)]

pub mod bag;
pub mod camera;
pub mod closed_loop;
mod content;
pub mod discover;
pub mod error;
pub mod estimate;
pub mod geometry;
mod input;
mod instant;
#[cfg(feature = "live")]
pub mod live;
pub mod measure;
pub mod observation;
#[cfg(feature = "report")]
mod quantity;
pub mod record;
#[cfg(feature = "report")]
pub mod report;
pub mod reproduce;
pub mod robot;
pub mod simulate;
pub mod statistics;
pub mod verdict;

#[cfg(feature = "commands")]
#[doc(hidden)]
pub mod cli;

/// The types and functions that most programs need: `use snakeloop::prelude::*`.
pub mod prelude {
    pub use crate::camera::{Frame, Lens, read_frame};
    pub use crate::discover::{Data, Discovery, discover};
    pub use crate::estimate::Estimator;
    pub use crate::geometry::Configuration;
    pub use crate::measure::{Eye, FrameMeasurement, Rig, RigOptions, calibrate_rig};
    pub use crate::observation::{EncoderReading, Measurement, Status};
    pub use crate::record::{read_measurements, read_model, write_model};
    pub use crate::robot::{Estimate, Grid, Model, Robot, compensation_table};
    pub use crate::verdict::Subject;
}

pub use error::{Error, Result};
