//! The grid target behind the snake: its lines, their phases, its pose.

pub mod grid;
