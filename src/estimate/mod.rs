//! From measurements to the force scale η and the backlash λ: the recursive estimator of Eq. 19–22, with an outlier gate and a forgetting
//! factor. The module also tells how well a model explains measurements.
//!
//! Each measurement becomes a [`LinearisedMeasurement`]: linear equations for x, which is η, λ and what is uncertain of the model's effects, with their
//! covariance. An [`InformationFilter`] in square-root form holds the sum of their information. [`Consistency`] compares the scatter of the residuals with their covariance, and
//! scales the reported standard deviations accordingly. The [`Estimator`] combines these; [`estimate`] takes a whole sequence through it.
//!
//! [`mod@gap`] is the part of the measurements that a model leaves unexplained, [`mod@accuracy`] the error of measurements against a known
//! truth. If η and λ are known, [`Stem`] finds the bending angle of a flexible stem, and [`tip_force`] the force on the tip that explains a
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
mod poses;
mod sample;
mod sequence;
mod sigmas;
mod stem;
mod usable;

pub use consistency::{Consistency, Whitened};
pub use estimator::{Estimator, Revision, Step};
pub use filter::InformationFilter;
pub use history::{EstimateRow, EtaLambda, Verdict};
pub use linearised::{LinearisedMeasurement, Weighting};
pub use load::{BLIND_SD_N, ForceRow, MeasuredForce, TipForce, tip_force};
pub(crate) use one_gain::{MOST_JUDGED, line_share};
pub use one_gain::{Replaced, or_one_gain};
pub use options::Options;
pub(crate) use poses::{NEW_POSE, NewPoses};
pub(crate) use sample::Sample;
pub use sample::{Pair, PlainSample, pairs_without_effects};
pub use sequence::estimate;
pub use sigmas::with_sigmas;
pub use stem::{Stem, StemAngle, StemOptions, StemRow, estimate_stem};
pub use usable::Reason;
pub(crate) use usable::usable;
