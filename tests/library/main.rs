//! The library through its public interface, where a unit test would see too little or take too long.

#[cfg(feature = "live")]
mod corpus;
mod estimator;
mod extremes;
mod house;
mod laws;
mod machines;
mod numbers;
mod real;
mod sealed;
mod section_coupling;
