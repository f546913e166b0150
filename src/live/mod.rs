//! The loop while the robot moves: a camera and encoders in; η, λ, a fresh table and a dashboard out.
//!
//! ```text
//! source   ─ newest frame ─┐
//!                          ├→ pipeline → journal → learner → board → server, tui
//! encoders ─ by time ──────┘      └→ pictures (drawn beside the loop)      saver, finder (beside the loop)
//! ```
//!
//! Each is a thread of its own where it must not hold up another. They share the [`Board`], which is locked for moments only,
//! and hand on the newest there is, never a queue.

mod board;
mod clock;
mod door;
mod encoders;
mod finder;
mod gap;
pub mod journal;
mod latency;
mod learner;
mod metrics;
mod mjpeg;
mod outcome;
mod pace;
mod pictures;
mod pipeline;
mod quiet;
mod saver;
pub mod server;
mod source;
pub mod tui;

pub use board::{Board, DiscoveryStatus, EstimateStatus, Row, State, StemStatus};
pub use clock::{ClockState, Lag};
pub use door::Door;
pub use encoders::{EncoderSource, EncoderStatus, LineParser, Parsed};
pub use gap::{GapState, GapStatus};
pub use journal::JOURNAL;
pub use latency::{Histogram, LatencyStatus};
pub use pace::{PaceState, PaceStatus};
pub use pictures::Pictures;
pub use pipeline::{Answer, Command, Commands, EncoderInput, Live, Setup, View};
pub use source::{Source, SourceState, SourceStatus};
