//! Whether a result can be relied on, in words: *good*, *look at this* or *do not use*, with ranked reasons and what to do about each.
//!
//! The assessment goes once through measurements and readings with the model that is to be judged, and applies rules that are tests of
//! hypotheses: each asks whether what is seen could come about where all is in order, and speaks only if that is improbable
//! ([`LEVEL_OF_TESTS`]). What a rule allows besides chance (sigmas that are somewhat too small, a share of frames that hands spoil) are the
//! conventions of `rules`.
//!
//! [`wiring`] asks before all physics whether the encoder log was wired, numbered, scaled and timed as the model takes it: it fits the
//! bends that were seen under every mistake of a small group and compares the likelihoods. Nothing is corrected here; the verdict
//! says how to write the correction down ([`Wiring`](crate::observation::Wiring)).

mod cause;
mod encoders;
mod estimated;
mod evidence;
mod health;
mod inputs;
mod one_cause;
mod reason;
mod rules;
mod scale;
mod shared_force;
mod stem;
mod systematic;
mod tip_force;
pub mod wiring;
mod words;

pub use estimated::JudgedEstimate;
pub use evidence::{Evidence, Subject, ViewOffset};
#[cfg(feature = "commands")]
pub use inputs::doubts_of_times;
pub use reason::{Code, Level, Reason, Suggestion, Verdict};
#[cfg(feature = "commands")]
pub(crate) use rules::doubt_of_parameters;
pub use rules::{LEVEL_OF_TESTS, MEAN_SQUARE_OF_NOISE, MOST_LAMBDA_MM, REJECTED_IN_ORDER};
#[cfg(feature = "commands")]
pub(crate) use shared_force::without_shared_force;
pub use stem::JudgedStem;
pub use tip_force::JudgedForce;
