//! The files of an experiment: what they hold, how they are read, checked and written.

pub mod measurement;
pub mod write;

pub use measurement::{EncoderReading, Measured, Measurement, Quality, Status};
pub use write::{PendingFile, write_atomically};
