//! From measurements to η and λ: the recursive estimator of Eq. 19–22, with an outlier gate and a forgetting factor; and how well a
//! model explains measurements.
//!
//! One measurement is one [`LinearisedMeasurement`]: what it says about x = (η, λ), and how well. An [`InformationFilter`] holds what
//! all measurements so far say, in square-root form. [`Consistency`] compares what the residuals scatter with what they promise, and
//! makes the reported standard deviations honest. The [`Estimator`] brings them together; [`estimate`] takes a whole sequence
//! through it. [`mod@gap`] is what a model leaves unexplained of measurements, and [`mod@accuracy`] how far measurements are from a known
//! truth. Where η and λ are known, [`Stem`] finds how far a flexible stem is bent, and [`tip_force`] which force on the tip explains a
//! deflection.

pub mod accuracy;
mod consistency;
mod effects;
mod estimator;
mod filter;
mod friction;
pub mod gap;
mod gate;
mod history;
mod initial;
mod linearised;
mod load;
mod one_gain;
mod options;
mod sequence;
mod sigmas;
mod stem;
mod usable;

pub use consistency::{Consistency, Whitened};
pub use effects::{Pair, pairs_without_effects, without_effects};
pub use estimator::{Estimator, Revision, Step};
pub use filter::InformationFilter;
pub use history::{EstimateRow, EtaLambda, Verdict};
pub(crate) use linearised::bend_covariance;
pub use linearised::{LinearisedMeasurement, Weighting};
pub use load::{BLIND_SD_N, ForceRow, MeasuredForce, TipForce, tip_force};
pub(crate) use one_gain::{NEW_POSE, line_share};
pub use one_gain::{Replaced, or_one_gain};
pub use options::Options;
pub use sequence::{estimate, estimate_each};
pub use sigmas::with_sigmas;
pub use stem::{Stem, StemAngle, StemOptions, StemRow, estimate_stem};
pub use usable::Reason;
pub(crate) use usable::usable;
