//! `live`: the loop while the robot moves.

mod summary;

use self::summary::Summary;
use super::checksum::Checksum;
use super::console::Console;
use super::estimator::EstimatorArgs;
use super::inputs::{encoders_of, files_read, maker, model_of, model_that_may_be_used, rows};
use super::topics::TopicArgs;
use super::verdict::VerdictArgs;
use super::views::rig_of;
use crate::camera::{CaptureSettings, CaptureTarget, FourCc, FrameSource, Lens};
use crate::cli::failure::Failure;
use crate::error::ArgumentError;
use crate::input::{PICTURE_BYTES, read_bytes};
use crate::live::ros2::{Node, Sink};
use crate::live::server::{AppState, Server};
use crate::live::{
    AccessControl, EncoderInput, EncoderSource, LineParser, Live, Setup, SharedState, Source, View, tui,
};
use crate::measure::{Eye, Rig, RigOptions};
use crate::record::{self, CameraSource, Experiment, OutputFolder, RigSource};
use crate::robot::{Model, Robot};
use crate::{Error, Result};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Run the loop while the robot moves: camera and encoders in; η, λ, a fresh table and a dashboard out
///
/// The experiment gives camera, rig and model. Frames come from its own files, or from a camera, a video or a stream.
/// Writes OUT/journal.jsonl with every measurement, OUT/model.toml and OUT/compensation.csv every few seconds, and at the end
/// OUT/measurements.csv and OUT/encoders.csv. Ctrl-C ends it.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  snakeloop live EXPERIMENT --camera 0 --size 1280x720 --encoders tcp://robot:5000 -o out\n  \
                  snakeloop live fixtures/bending --rate 2 --serve -o live\n  \
                  snakeloop live EXPERIMENT --ros2 --image-topic /camera/image_raw --joint-topic /joint_states --joints b1,b2,b3 -o out",
    group(clap::ArgGroup::new("readings").args(["encoders", "joint_topic"]))
)]
pub struct Args {
    /// The experiment: a folder with an experiment.toml, or that file
    experiment: PathBuf,
    /// The folder to write to; created if it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// The view that the camera shows; by default the first of the experiment
    #[arg(long, value_name = "NAME")]
    view: Option<String>,
    /// Take frames from this camera of the machine: its number, or its device, such as /dev/v4l/by-id/…
    #[arg(long, value_name = "NUMBER|DEVICE", conflicts_with = "source")]
    camera: Option<String>,
    /// Take frames from a video file, numbered pictures (frames/%05d.png) or a stream (http://…, rtsp://…)
    #[arg(long, value_name = "SOURCE")]
    source: Option<String>,
    /// Picture size to ask the camera for
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    size: Option<(u32, u32)>,
    /// Frames per second to ask the camera for, or to play pictures or a video at [default: 30 for pictures, a video's own]
    #[arg(long, visible_alias = "fps", value_name = "FPS", value_parser = positive)]
    rate: Option<f64>,
    /// How the camera packs its pictures, four letters such as MJPG; many cameras reach their full rate only with MJPG
    #[arg(long, value_name = "FOURCC")]
    fourcc: Option<FourCc>,
    /// Exposure to ask the camera for, in its own unit; switches automatic exposure off
    #[arg(long, value_name = "VALUE", allow_hyphen_values = true)]
    exposure: Option<f64>,
    /// Focus to ask the camera for, in its own unit; switches autofocus off
    #[arg(long, value_name = "VALUE")]
    focus: Option<f64>,
    /// Encoder readings, one a line (time_s,q1_mm,q2_mm,q3_mm, or JSON; [log] of the experiment gives other names and units): - (standard
    /// input), tcp://HOST:PORT, unix:PATH, or a file that grows. Without it the experiment's own log, matched by index, if the frames come from files
    #[arg(long, value_name = "FROM")]
    encoders: Option<EncoderSource>,
    /// Seconds to add to the encoders' times to get those of the frames; estimated by default
    #[arg(long, value_name = "SECONDS", allow_hyphen_values = true, requires = "readings")]
    encoder_offset: Option<f64>,
    /// The model to start from (model.toml); its effects are obeyed. Without it the experiment's, or the paper's
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    /// Time between two writings of model and table
    #[arg(long, value_name = "SECONDS", default_value_t = 10.0, value_parser = positive)]
    save_every: f64,
    /// Serve the dashboard and the machine interface at this address; continues after the end of a recording, until Ctrl-C
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = "127.0.0.1:8080")]
    serve: Option<SocketAddr>,
    /// A file with the token that visitors must know; needed if other machines can reach the address
    #[arg(long, value_name = "FILE", requires = "serve")]
    token_file: Option<PathBuf>,
    /// A host name that the dashboard may be called by, besides addresses and localhost; may be repeated
    #[arg(long, value_name = "NAME", requires = "serve")]
    allow_host: Vec<String>,
    /// Show the figures in the terminal
    #[arg(long)]
    tui: bool,
    /// Continue the run in OUT, with all its measurements
    #[arg(long)]
    resume: bool,
    /// Follow the total bending angle of a flexible stem instead, with η and λ of the model known: shows its angle and sigma with every
    /// measurement, writes a table for the current angle, and at the end OUT/stem.csv
    #[arg(long, conflicts_with_all = ["flat_sigma", "gate"])]
    stem: bool,
    #[command(flatten)]
    topics: TopicArgs,
    #[command(flatten)]
    estimator: EstimatorArgs,
    #[command(flatten)]
    verdict: VerdictArgs,
}

/// What a live run writes into its folder.
const OUTPUTS: [&str; 12] = [
    "journal.jsonl",
    "measurements.csv",
    "encoders.csv",
    "stem.csv",
    "model.toml",
    "compensation.csv",
    "compensation.json",
    "publication.json",
    "live.log",
    "rig.toml",
    "discrepancy.json",
    "discovered.toml",
];

/// Forgetting factor: the share of earlier information kept at each measurement. Convention: the user's choice (`--keep`); 0.9995 is a
/// memory of 2000 measurements, half a minute at 60 frames/s.
const KEEP: f64 = 0.9995;

/// Rates and times beyond this are slips, frames/s or s. Convention: a limit that keeps durations representable.
const LARGEST: f64 = 1e6;
/// Exit code of a run that was asked to end a second time, while it was ending. Convention: a shell's for a program ended by Ctrl-C.
const ASKED_TWICE: i32 = 130;
/// Time between two looks at whether the run is over. Convention.
///
/// Convention: how often the terminal is asked.
const POLL: Duration = Duration::from_millis(50);

fn size(text: &str) -> std::result::Result<(u32, u32), String> {
    let parts =
        text.split_once(['x', '×']).and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    parts.filter(|&(width, height)| width > 0 && height > 0).ok_or_else(|| "expected a size such as 1280x720".into())
}

/// A number above 0.
pub fn positive(text: &str) -> std::result::Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|value| *value > 0.0 && *value < LARGEST);
    value.ok_or_else(|| "expected a number above 0".into())
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        // Address and folder before the long work of calibrating the rig.
        let server = self.access_control()?.map(Server::bind).transpose().map_err(Failure::of_call)?;
        let node = self.topics.domain()?.map(Node::join).transpose().map_err(Failure::of_call)?;
        let experiment = Experiment::read(&self.experiment)?;
        let folder = self.claim(&experiment)?;
        let live = Live::start(self.setup(console, &experiment, folder, node.as_ref())?)?;
        let shown = || (Arc::clone(&live.shared), Arc::clone(&live.video));
        let sink = node.as_ref().map(|node| Sink::start(node, shown().0, shown().1)).transpose()?;
        if let Some(server) = server {
            let has_token = self.token_file.is_some();
            let (shared, video) = shown();
            let address = server.start(AppState { shared, video, commands: live.commands() });
            if !self.tui {
                console.say(format!("dashboard: http://{address}/{}", if has_token { "?token=TOKEN" } else { "" }));
            }
        }
        self.wait(console, &live)?;
        live.stop();
        let shared = Arc::clone(&live.shared);
        let latencies = live.finish();
        sink.into_iter().for_each(Sink::finish);
        let latencies = latencies?;
        let summary = Summary::new(&shared.state(), &latencies, self.output.clone());
        console.result(&summary, || summary.text());
        self.verdict.check(&summary.verdict)
    }

    /// Waits until the user ends the run; without a dashboard also until a recording has ended.
    fn wait(&self, console: &Console, live: &Live) -> Result<(), Failure> {
        let asked = Arc::new(AtomicBool::new(false));
        let theirs = Arc::clone(&asked);
        // Whoever asks again does not want to wait for the tables.
        let ask = move || match theirs.swap(true, Ordering::Relaxed) {
            false => {}
            true => std::process::exit(ASKED_TWICE),
        };
        ctrlc::set_handler(ask)
            .map_err(|e| Error::Unavailable { what: "cannot listen for Ctrl-C".into(), message: e.to_string() })?;
        let failed = || live.is_over() && !live.shared.lock().state.ended;
        let over = || asked.load(Ordering::Relaxed) || failed() || (live.is_over() && self.serve.is_none());
        if self.tui {
            return tui::show(&live.shared, &live.commands(), over).map_err(Failure::of_call);
        }
        let mut told = 0;
        while !over() {
            self.tell(console, &live.shared, &mut told);
            std::thread::sleep(POLL);
        }
        // What came with the last frames.
        self.tell(console, &live.shared, &mut told);
        Ok(())
    }

    /// Says the notices that were not said yet; OUT/live.log has them too.
    fn tell(&self, console: &Console, shared: &SharedState, told: &mut u64) {
        let (notices, all) = shared.lock().notices_after(*told);
        *told = all;
        console.warn(notices);
    }

    fn access_control(&self) -> Result<Option<AccessControl>, Failure> {
        let Some(address) = self.serve else { return Ok(None) };
        let token = match &self.token_file {
            Some(path) => Some(std::fs::read_to_string(path).map_err(Error::io(path, "read"))?.trim().to_owned()),
            None => None,
        };
        AccessControl::new(address, token, self.allow_host.clone()).map(Some).map_err(|error| match error {
            Error::Argument(ArgumentError::OpenToAll { .. }) => {
                Failure::Usage(format!("{error}; --token-file gives one"))
            }
            error => error.into(),
        })
    }

    /// Takes the folder to write to.
    fn claim(&self, experiment: &Experiment) -> Result<OutputFolder, Failure> {
        let lines = match &self.encoders {
            Some(EncoderSource::File(path)) => Some(path),
            _ => None,
        };
        let source = self.source.as_ref().map(PathBuf::from);
        let inputs = files_read(experiment, &[self.model.as_ref(), lines, source.as_ref()]);
        let mut out = OutputFolder::claim(&self.output, &OUTPUTS, &inputs)?;
        let view = self.chosen_view(experiment)?;
        let maker = format!("{}, view {}, of {}", maker("live", experiment), view.name, settings_of(experiment, view)?);
        out.made_by(&maker, &OUTPUTS)?;
        Ok(out)
    }

    fn setup(
        &self,
        console: &Console,
        experiment: &Experiment,
        folder: OutputFolder,
        node: Option<&Node>,
    ) -> Result<Setup, Failure> {
        let view = self.chosen_view(experiment)?;
        let mut model = model_of(console, experiment)?;
        if let Some(path) = &self.model {
            model = model_that_may_be_used(console, path)?;
        }
        if model.neighbours() > 0 {
            return Err(Failure::Usage(
                "the model has section_coupling, and `live` reads no neighbouring section's encoders: take the effect out of the model"
                    .into(),
            ));
        }
        let lens = self.lens(view, node)?;
        let (source, source_name) = self.source(experiment, view, node)?;
        let encoders = self.encoder_input(console, experiment, &model, &source, node)?;
        Ok(Setup {
            view: self.open(view, lens, &model.robot)?,
            source,
            source_name,
            encoders,
            model,
            options: self.estimator.options(KEEP),
            stem: self.stem.then(|| self.estimator.stem_options()),
            folder,
            resume: self.resume,
            save_every: Duration::from_secs_f64(self.save_every),
        })
    }

    /// The view's lens: by the experiment, or, where that names none, by the camera itself.
    fn lens(&self, view: &record::View, node: Option<&Node>) -> Result<Lens, Failure> {
        match (node, &self.topics.image_topic, &view.camera) {
            (Some(node), Some(topic), CameraSource::Untold) => Ok(node.lens_beside(topic)?),
            _ => Ok(view.lens()?),
        }
    }

    /// Where encoder readings come from.
    fn encoder_input(
        &self,
        console: &Console,
        experiment: &Experiment,
        model: &Model,
        source: &Source,
        node: Option<&Node>,
    ) -> Result<EncoderInput, Failure> {
        let backbones = model.robot.backbone_count();
        let offset_s = self.encoder_offset;
        if let Some(from) = &self.encoders {
            let columns = experiment.log.clone().unwrap_or_default().columns(backbones);
            let columns = columns.map_err(|why| Error::content(&experiment.path, format!("[log] {why}")))?;
            let (parser, wiring) = (LineParser::of_columns(columns), experiment.wiring(backbones)?);
            return Ok(EncoderInput::Lines { source: from.clone(), parser, offset_s, wiring });
        }
        if let Some(stream) = node.map(|node| self.topics.joints(node, backbones)).transpose()?.flatten() {
            return Ok(EncoderInput::Stream { stream, offset_s, wiring: experiment.wiring(backbones)? });
        }
        match source.is_recording() && experiment.encoders.is_some() {
            true => Ok(EncoderInput::Log(rows(console, encoders_of(experiment, model)?))),
            false => Ok(EncoderInput::None),
        }
    }

    fn chosen_view<'a>(&self, experiment: &'a Experiment) -> Result<&'a record::View, Failure> {
        let wanted = |view: &&record::View| self.view.as_ref().is_none_or(|name| *name == view.name);
        experiment.views.iter().find(wanted).ok_or_else(|| {
            let names: Vec<&str> = experiment.views.iter().map(|view| view.name.as_str()).collect();
            Failure::Usage(format!(
                "--view {}: the experiment has {}",
                self.view.as_deref().unwrap_or_default(),
                names.join(", ")
            ))
        })
    }

    /// Where frames come from, and that in words.
    fn source(
        &self,
        experiment: &Experiment,
        view: &record::View,
        node: Option<&Node>,
    ) -> Result<(Source, String), Failure> {
        let settings = CaptureSettings {
            size: self.size,
            rate_fps: self.rate,
            fourcc: self.fourcc,
            autofocus: None,
            exposure: self.exposure,
            focus: self.focus,
        };
        if let Some(name) = &self.camera {
            let target =
                CaptureTarget::camera(name).map_err(|why| Failure::Usage(format!("--camera {name}: {why}")))?;
            return Ok((Source::Device { target, settings }, format!("camera {name}")));
        }
        if self.size.is_some() || self.fourcc.is_some() || self.exposure.is_some() || self.focus.is_some() {
            return Err(Failure::Usage("--size, --fourcc, --exposure and --focus are for --camera".into()));
        }
        if let (Some(node), Some(topic)) = (node, &self.topics.image_topic) {
            return Ok((Source::Stream(node.pictures(topic)?), format!("ROS 2 topic {topic}")));
        }
        match &self.source {
            Some(address) if address.contains("://") => {
                let target = CaptureTarget::Stream(address.clone());
                Ok((Source::Device { target, settings }, without_secrets(address)))
            }
            Some(pattern) => {
                let frames = FrameSource::open(Path::new(""), pattern)?;
                Ok((Source::Recording { frames, rate_fps: self.rate }, pattern.clone()))
            }
            None => {
                let frames = view.open_frames(experiment.folder())?;
                Ok((Source::Recording { frames, rate_fps: self.rate }, view.frames.to_string()))
            }
        }
    }

    /// The view's eye, by the rig of an earlier run where that is gone on with.
    fn open(&self, view: &record::View, lens: Lens, robot: &Robot) -> Result<View> {
        let retaken = self.output.join("rig.toml");
        let rig =
            if self.resume && retaken.exists() { Rig::read(&retaken)? } else { rig_of(view, &lens, robot, None)? };
        let (grid_pitch_mm, standoff_mm) = match view.rig {
            RigSource::Straight { grid_pitch_mm, standoff_mm, .. } => (grid_pitch_mm, standoff_mm),
            // The grid's z points away from the camera, and the base stands before it.
            RigSource::File(_) => {
                (rig.grid_pitch_mm, -(rig.camera_from_grid.inverse() * rig.camera_from_base).translation.z)
            }
        };
        let rig_options = RigOptions { grid_pitch_mm, standoff_mm, delta_offset: view.delta_offset_deg.to_radians() };
        let eye = Eye::new(lens.clone(), rig, robot.clone());
        // Frames that come meanwhile would be dropped.
        eye.prepare();
        Ok(View { name: view.name.clone(), lens, robot: robot.clone(), rig_options, eye })
    }
}

/// The files by which measurements and readings are made, each with its checksum: what is written by others does not go on with them.
fn settings_of(experiment: &Experiment, view: &record::View) -> Result<String> {
    let rig = match &view.rig {
        RigSource::File(path) | RigSource::Straight { picture: path, .. } => path.as_path(),
    };
    let camera = match &view.camera {
        CameraSource::File(path) => Some(path.as_path()),
        CameraSource::Topic(_) | CameraSource::Numbers(_) | CameraSource::Untold => None,
    };
    let files = [Some(experiment.path.as_path()), experiment.robot.as_deref(), camera, Some(rig)];
    let named = files.into_iter().flatten().map(|path| {
        let mut checksum = Checksum::default();
        checksum.add(&read_bytes(path, PICTURE_BYTES)?);
        Ok(format!("{} {checksum}", path.file_name().unwrap_or_default().display()))
    });
    Ok(named.collect::<Result<Vec<_>>>()?.join(", "))
}

/// An address without the name and password that it may carry.
fn without_secrets(address: &str) -> String {
    match address.split_once("://") {
        Some((scheme, rest)) => {
            let host = rest.find('/').unwrap_or(rest.len());
            let from = rest[..host].rfind('@').map_or(0, |at| at + 1);
            format!("{scheme}://{}", &rest[from..])
        }
        None => address.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_addresss_password_is_not_shown() {
        assert_eq!(without_secrets("rtsp://me:secret@cam:554/a@b"), "rtsp://cam:554/a@b");
        assert_eq!(without_secrets("http://cam/stream"), "http://cam/stream");
    }

    #[test]
    fn sizes_and_rates_are_checked() {
        assert_eq!(size("1280x720"), Ok((1280, 720)));
        assert!(size("1280").is_err() && size("0x3").is_err() && positive("-1").is_err() && positive("nan").is_err());
    }
}
