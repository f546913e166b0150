//! `discover` as its users meet it: what is hidden is named, and what cannot be decided is said.

mod bad_input;
mod naming;
mod neighbours;
mod next;
mod own_effects;
mod real;
mod sealed_frames;
mod unexplained;
