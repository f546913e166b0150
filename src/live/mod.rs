//! The loop while the robot moves: a camera and encoders in; η, λ, a fresh table and a dashboard out.
//!
//! ```text
//! source   ─ newest frame ─┐
//!                          ├→ pipeline → journal → online_estimator → shared_state → server, tui
//! encoders ─ by time ──────┘      └→ annotated_video                      └→ autosave, discovery_worker → bank_worker
//! ```
//!
//! In a ROS 2 network (feature `ros2`) topics are such a source, such encoders, and one more reader of the shared state: [`ros2`].
//!
//! What must not hold up another has a thread of its own. The threads share [`SharedState`], which is locked for moments only, and hand
//! on the newest value there is, never a queue that grows. Whatever decides something is apart from the threads and does no input or
//! output, so that it can be tested by itself: `frame_queue`, `frame_timing`, `frame_stamps`, `multipart`, the parser and readings of `encoders`,
//! `clock_offset`, `motion_lag`, `cusum` and `gap_monitor`.

mod access_control;
mod annotated_video;
mod autosave;
mod bank_worker;
mod clock;
mod clock_offset;
mod commands;
mod confirmation;
mod cusum;
mod discovery_worker;
mod encoders;
mod final_tables;
mod frame_queue;
mod frame_stamps;
mod frame_timing;
mod gap_monitor;
pub mod journal;
mod latency;
mod low_priority;
mod metrics;
mod motion_jpeg;
mod motion_lag;
mod multipart;
mod online_estimator;
mod pipeline;
mod publication;
mod recent_bends;
#[cfg(feature = "ros2")]
pub mod ros2;
#[cfg(not(feature = "ros2"))]
#[path = "without_ros2.rs"]
pub mod ros2;
pub mod server;
mod session;
mod setup;
mod shared_state;
mod silence;
mod source;
mod standstill;
mod status;
mod straight_reference;
mod stream;
pub mod tui;
mod verdict_worker;

pub use access_control::AccessControl;
pub use annotated_video::AnnotatedVideo;
pub use commands::{Answer, Command, Commands};
pub use encoders::{EncoderSource, LineParser, Parsed};
pub use journal::JOURNAL;
pub use latency::Histogram;
pub use session::Live;
pub use setup::{EncoderInput, Setup, View};
pub use shared_state::SharedState;
pub use source::Source;
pub use status::{
    ClockState, DiscoveryStatus, EncoderStatus, EstimateStatus, FrameTimingState, FrameTimingStatus, GapState,
    GapStatus, Lag, LatencyStatus, PublicationState, PublicationStatus, Row, SourceState, SourceStatus, State,
    StemStatus,
};
pub use stream::{Came, FrameStream, Packed, ReadingStream, SentFrame, SentReading};
