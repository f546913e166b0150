//! Frames and readings that other programs send, one after another, as the threads that read them see them.
//!
//! A stream is read on a thread of its own and waits for nobody: what is not taken in time is lost, and the sender never notices.

use crate::bag::Stamped;
use crate::camera::{Frame, Lens, Picture, decode_frame_for};
use crate::robot::PerBackbone;
use std::fmt;

/// What came next.
#[derive(Debug, Clone, PartialEq)]
pub enum Came<T> {
    /// What was waited for.
    One(T),
    /// Something that the user is to know of the sender.
    Remark(String),
}

/// Frames that are sent packed.
pub trait FrameStream: fmt::Debug + Send {
    /// The next one, waited for while `goes_on` says so; `None` where none came for a while.
    fn next(&mut self, goes_on: &dyn Fn() -> bool) -> Option<Came<SentFrame>>;

    /// Why none came, in words.
    fn trouble(&self) -> String;
}

/// Readings that are sent with a time each.
pub trait ReadingStream: fmt::Debug + Send {
    /// The next one, waited for while `goes_on` says so; `None` where none came for a while.
    fn next(&mut self, goes_on: &dyn Fn() -> bool) -> Option<Came<SentReading>>;

    /// Why none came, in words.
    fn trouble(&self) -> String;
}

/// A frame as it was sent.
#[derive(Debug, Clone, PartialEq)]
pub struct SentFrame {
    /// The picture.
    pub packed: Packed,
    /// When it was taken, by the sender's clock, s; where the sender does not say, it is the time of arrival.
    pub stamp_s: Option<f64>,
}

/// A reading as it was sent, by the sender's clock.
#[derive(Debug, Clone, PartialEq)]
pub enum SentReading {
    /// One for each column of the log.
    Reading {
        /// s.
        stamp_s: f64,
        /// mm, before the wiring.
        q_mm: PerBackbone,
    },
    /// The reading of this moment, s, was contradicted by another: neither is to be used.
    Contradicted {
        /// s.
        stamp_s: f64,
        /// What the two say.
        why: String,
    },
    /// No reading, and why.
    Bad(String),
}

/// A picture that is still to be decoded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Packed {
    /// A picture file.
    File(Vec<u8>),
    /// A message of ROS 2.
    Message {
        /// Its type, such as `sensor_msgs/Image`.
        kind: &'static str,
        /// Its bytes, as recordings have them.
        cdr: Vec<u8>,
    },
}

impl Packed {
    /// The picture as the camera's file knows it, turned under the same rule as those of files.
    ///
    /// # Errors
    /// Bytes that are no picture, or one of an encoding that is not read, in words.
    pub fn frame_for(&self, lens: &Lens) -> std::result::Result<Frame, String> {
        match self {
            Self::File(bytes) => decode_frame_for(bytes, lens),
            Self::Message { kind, cdr } => Picture::decoded(kind, cdr).map(|picture| picture.frame),
        }
    }
}
