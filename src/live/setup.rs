//! What a run of `live` is started with.

use super::clock::FrameClock;
use super::encoders::{EncoderSource, Encoders, LineParser};
use super::source::Source;
use super::stream::ReadingStream;
use crate::camera::Lens;
use crate::estimate::{Options, StemOptions};
use crate::measure::{Eye, RigOptions};
use crate::observation::{EncoderReading, Wiring};
use crate::record::OutputFolder;
use crate::robot::{Model, Robot};
use std::sync::Arc;
use std::time::Duration;

/// All that a run needs.
#[derive(Debug)]
pub struct Setup {
    /// The camera's view.
    pub view: View,
    /// Where frames come from.
    pub source: Source,
    /// That in words.
    pub source_name: String,
    /// Where encoder readings come from.
    pub encoders: EncoderInput,
    /// The model to start from; its effects are obeyed.
    pub model: Model,
    /// The estimator's settings.
    pub options: Options,
    /// Settings to follow a flexible stem with, in place of η and λ.
    pub stem: Option<StemOptions>,
    /// The folder to write to.
    pub folder: OutputFolder,
    /// Whether to go on with the journal that is there.
    pub resume: bool,
    /// How often model and table are written.
    pub save_every: Duration,
}

/// One camera, ready to measure.
#[derive(Debug)]
pub struct View {
    /// Its name.
    pub name: String,
    /// Its lens.
    pub lens: Lens,
    /// The robot that it sees.
    pub robot: Robot,
    /// What a new straight reference is calibrated with.
    pub rig_options: RigOptions,
    /// What measures its frames.
    pub eye: Eye,
}

/// Where encoder readings come from.
#[derive(Debug)]
pub enum EncoderInput {
    /// From nowhere.
    None,
    /// From a finished log, matched by the frames' index.
    Log(Vec<EncoderReading>),
    /// As lines that come.
    Lines {
        /// Where from.
        source: EncoderSource,
        /// What they look like.
        parser: LineParser,
        /// What to add to a time stamp to get the frames' time, s; estimated where it is not given.
        offset_s: Option<f64>,
        /// How their columns hold the readings.
        wiring: Wiring,
    },
    /// From a stream that is there already.
    Stream {
        /// The stream.
        stream: Box<dyn ReadingStream>,
        /// What to add to a time stamp to get the frames' time, s; estimated where it is not given.
        offset_s: Option<f64>,
        /// How its columns hold the readings.
        wiring: Wiring,
    },
}

impl EncoderInput {
    /// Opens it.
    pub fn open(self, clock: Arc<FrameClock>) -> Encoders {
        match self {
            Self::None => Encoders::None,
            Self::Log(readings) => Encoders::log(readings),
            Self::Lines { source, parser, offset_s, wiring } => {
                Encoders::lines(source, (parser, wiring), clock, offset_s)
            }
            Self::Stream { stream, offset_s, wiring } => Encoders::stream(stream, wiring, clock, offset_s),
        }
    }
}
