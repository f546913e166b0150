//! The files of an experiment: what they hold, how they are read, checked and written.

pub mod c_header;
mod columns;
pub mod compensation;
mod covariance;
mod dialect;
mod effect_table;
pub mod encoders;
pub mod estimates;
pub mod experiment;
pub mod force;
pub mod friction;
mod interpolation;
mod joints;
pub mod journal;
mod log;
mod measurement_row;
pub mod measurements;
pub mod model;
mod output;
pub mod provenance;
pub mod recording;
mod rig;
mod source;
mod stale;
pub mod stem;
pub mod table;
mod torn;
mod tracker;
pub mod trajectory;
pub mod truth;
pub mod write;

pub use c_header::compensation_c_header;
pub use columns::csv_of;
pub use compensation::{Worth, compensation_csv, compensation_files, compensation_json, write_compensation_rows};
pub use effect_table::read_effects;
pub use encoders::{encoders_csv, read_encoders, read_encoders_kept};
pub use estimates::estimates_csv;
pub(crate) use experiment::line_at;
pub use experiment::{Experiment, RigSource, Tracker, View};
pub use force::forces_csv;
pub use friction::read_friction;
#[cfg(feature = "live")]
pub(crate) use interpolation::Interpolation;
pub use interpolation::Matched;
#[cfg(feature = "ros2")]
pub(crate) use interpolation::Neighbouring;
pub use joints::read_joints;
pub use journal::{JOURNAL, MeasurementJournal, difference};
pub use log::{LogKeys, LogProposal, ReadingUnit, TimeUnit, read_log};
pub use measurement_row::{MeasurementRow, NUMBERS};
pub use measurements::{MeasurementRows, measurement_line, measurements_csv, measurements_header, read_measurements};
pub use model::{learned_model_toml, model_json, model_toml, read_model, robot_of, write_model};
pub use output::OutputFolder;
pub use provenance::Provenance;
pub use recording::{Recorded, write_recording};
pub use source::{CameraSource, EncoderLog, JointTopic, Source};
pub use stale::{do_not_use_mark, mark_stale, stale_mark, tables_marked_stale, unmark_stale, verdict_mark};
pub use stem::stems_csv;
pub use table::{Checked, Fault, Warning};
pub use tracker::{read_tracker_poses, tracker_poses_of};
pub use trajectory::{read_trajectory, trajectory_csv};
pub use truth::{read_truth, truth_csv};
#[cfg(feature = "live")]
pub(crate) use write::is_at;
pub use write::{Files, PendingFile, remove_abandoned, write_atomically, write_together};
