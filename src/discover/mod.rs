//! Which effect the model lacks, whether the gap shrinks with it, and what to measure next.
//!
//! The method, one stage a file, in the order in which they run:
//!
//! 1. `clock`, `sweeps`, [`data`](Data): readings and measurements are paired, put on one clock and cut into sweeps.
//! 2. `residuals`: what was measured less what a model predicts, in units of the predicted noise. [`noise`](Noise): how large that
//!    noise is, learned from the residuals.
//! 3. `fit`: robust least squares over η, λ and the parameters of the model's effects.
//! 4. `periodogram`, `hypotheses`: every effect of the library that the model lacks, at the values where its fit begins.
//!    `confounding`: which effects η and λ could imitate.
//! 5. `predictive_density`: how probable a structure (set of effects) makes stretches of the log that it was not fitted to.
//!    `structure_weights`: how probable structures are that were compared by it.
//! 6. [`search`](Named): the structure of the highest density, beside noise alone; [`posterior`](Candidate): what the choice between
//!    structures adds to the covariance.
//! 7. `held_out`, `structure`, [`verdict`](Verdict): the gap on sweeps that the fit did not see, what the residuals still follow,
//!    and the answer.
//! 8. `partial`: where more than noise is left, the same search beside a discrepancy; `start`: whether the log begins in a state that nobody knows.
//! 9. `discovery` runs the stages so far; `discrepancy` writes the answer down.
//! 10. [`localisation`](Localisation): in which backbone, at which bends and when the gap is. [`effect_trace`](EffectTrace): what each
//!     effect found does over the motion.
//! 11. [`law`](propose_law): a formula proposed in place of an explanation.
//! 12. `candidate_trajectories`, [`next_experiment`]: the trajectory that would decide what these data leave open.
//! 13. [`bank`](Bank): how probabilities and numbers go on as samples come.

mod bank;
mod candidate_trajectories;
mod clock;
mod confounding;
mod data;
mod discovery;
mod discrepancy;
mod effect_trace;
mod fit;
#[cfg(test)]
mod fixture;
mod held_out;
mod hypotheses;
mod law;
mod localisation;
mod next_experiment;
mod noise;
mod partial;
mod periodogram;
mod posterior;
mod predictive_density;
mod residuals;
mod search;
mod start;
mod structure;
mod structure_weights;
mod sweeps;
mod verdict;

pub use bank::{Bank, Followed, Moved, Number};
pub use data::{Data, LEAST_SAMPLES, Log};
pub use discovery::{Discovery, Tell, discover, discover_in_frames, discover_telling};
pub use discrepancy::nothing_named;
pub use effect_trace::{EffectTrace, effect_traces};
pub use held_out::Gap;
pub use law::{PROPOSED_LAW, ProposedLaw, propose_law};
pub use localisation::{Localisation, Part};
pub use next_experiment::{NextExperiment, next_experiment};
pub use noise::Noise;
pub use posterior::Candidate;
pub use search::{Evidence, Named};
pub use structure::{NoiseQuantiles, Structure};
pub use verdict::Verdict;
