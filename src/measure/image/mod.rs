//! A picture as the eye works with it: one plane of numbers, and the mix of colours in which snake and grid target differ most.

pub mod appearance;
pub mod exposure;
pub mod plane;
