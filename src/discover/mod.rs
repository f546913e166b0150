//! Where simulation and measurement disagree, which effect is missing, and whether the gap shrinks with it.
//!
//! 1. [`Data`]: samples in the order of time, cut into sweeps.
//! 2. [`Problem`]: the gap in units of its predicted noise, in what was measured; η and λ are fitted anew with every effect.
//! 3. `chance`: what the best of the library would gain on these poses if there were nothing but noise, and what η and λ hide.
//!    `search`: forward steps over the library, exchange, backward elimination; by Schwarz's criterion beyond chance, on sweeps
//!    left out and on sweeps drawn anew.
//! 4. [`Discovery`]: the verdict, held to noise and to what structure is left; nothing in it is judged on data that the fit saw.
//! 5. [`Whereabouts`]: where the gap lives; [`learn_correction`]: a smooth function in place of an explanation.
//! 6. [`next_experiment`]: the ride that would settle what these data leave open.

mod chance;
mod correction;
mod data;
mod fit;
mod next;
mod plans;
mod search;
mod verdict;
mod whereabouts;

pub use correction::{Correction, learn_correction};
pub use data::{Data, LEAST_SAMPLES};
pub use fit::{Fit, Problem};
pub use next::{Next, next_experiment};
pub use search::Named;
pub use verdict::{Discovery, Gap, Structure, Verdict, discover, discover_in_frames};
pub use whereabouts::{Part, Whereabouts};
