//! Where camera, grid target and base are: calibrated from the straight picture, kept in a file, watched for drift.

pub mod calibrate;
pub mod drift;
pub mod file;
pub mod locate;
pub mod refusal;
pub mod scale;
