//! Which effect the model lacks, whether the gap shrinks with it, and what to measure next.
//!
//! The method, one stage a file, in the order in which they run:
//!
//! 1. `clock`, `sweeps`, [`data`](Data): readings and measurements are paired, put on one clock and cut into sweeps.
//! 2. `residuals`: what was measured less what a model predicts, in units of the predicted noise. [`noise`](Noise): how large that
//!    noise is, learned from the residuals.
//! 3. `fit`: robust least squares over η, λ and the parameters of the model's effects.
//! 4. `periodogram`, `hypotheses`: every effect of the library that the model lacks, at the values where its fit begins.
//! 5. `tangent_spaces`: what each hypothesis can do to the residuals beyond what η and λ can, to first order.
//! 6. `null_distribution`: what the best hypothesis gains on noise alone. `confounding`: which effects η and λ could imitate.
//! 7. `sweep_equations`, `comparison`: the evidence for an effect (information criterion, share of the gap, held-out sweeps,
//!    bootstrap of the sweeps), and the criteria that it must fulfil.
//! 8. `search`: stepwise selection over a beam of models, with exchange and backward elimination. [`posterior`](Candidate): how probable
//!    what was found and each of its rivals is, and what the choice between them adds to the covariance.
//! 9. `held_out`, `structure`, [`verdict`](Verdict): the gap on sweeps that the fit did not see, what the residuals still follow,
//!    and the answer. `partial`: where more than noise is left, the effects that help all the same, compared by their
//!    `predictive_density`, with `structure_weights` for how probable each is; `start`: whether the log begins in a state that nobody knows. `discovery` runs the stages so far; `discrepancy` writes the answer down.
//! 10. [`localisation`](Localisation): in which backbone, at which bends and when the gap is. [`effect_trace`](EffectTrace): what each
//!     effect found does over the motion.
//! 11. [`law`](propose_law): a formula proposed in place of an explanation.
//! 12. `candidate_trajectories`, [`next_experiment`]: the trajectory that would decide what these data leave open.
//! 13. [`bank`](Bank): how probabilities and numbers go on as samples come.

mod bank;
mod candidate_trajectories;
mod clock;
mod comparison;
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
mod null_distribution;
mod partial;
mod periodogram;
mod posterior;
mod predictive_density;
mod residuals;
mod search;
mod start;
mod structure;
mod structure_weights;
mod sweep_equations;
mod sweeps;
mod tangent_spaces;
mod verdict;

pub use bank::{Bank, Followed, Moved, Number};
pub use comparison::Evidence;
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
pub use search::Named;
pub use structure::{NoiseQuantiles, Structure};
pub use verdict::Verdict;
