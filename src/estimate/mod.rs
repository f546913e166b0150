//! From measurements to η and λ: the recursive estimator of Eq. 19–22, with a gate and fading memory.
//!
//! One measurement is one [`Row`]: what it says about x = (η, λ), and how well. A [`Filter`] holds what all rows so far
//! say, in square-root form. [`Consistency`] compares what the rows scatter with what they promise, and makes the
//! reported standard deviations honest. The [`Estimator`] brings them together.
//! Where η and λ are known, [`Stem`] finds how far a flexible stem is bent, and
//! [`tip_force`] which force on the tip explains a deflection.

mod consistency;
mod effects;
mod estimator;
mod filter;
mod history;
mod load;
mod row;
mod sigmas;
mod stem;

pub use consistency::{Consistency, Whitened};
pub use effects::{Pair, pairs_without_effects, without_effects};
pub use estimator::{Estimator, Options, Reason, Revision, Step, estimate, estimate_each};
pub use filter::Filter;
pub use history::{EstimateRow, EtaLambda, Verdict};
pub use load::{BLIND_SD_N, ForceRow, MeasuredForce, TipForce, tip_force};
pub use row::{Row, Weighting};
pub use sigmas::with_sigmas;
pub use stem::{Stem, StemAngle, StemOptions, StemRow, estimate_stem};
