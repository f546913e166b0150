//! The files of an experiment: what they hold, how they are read, checked and written.

pub mod measurement;
pub use measurement::{EncoderReading, Measured, Measurement, Quality, Status};
