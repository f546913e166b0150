//! What is fuzzed: each function takes any bytes for a file, a line or a picture, and may do anything but panic, hang or take
//! all memory. `fuzz_targets/` gives them to libFuzzer; `tests/library/corpus.rs` replays what was found worth keeping.

use image::{DynamicImage, imageops};
use nalgebra::{Point3, Vector2};
use snakeloop::bag::Topic;
use snakeloop::bag::messages::JointState;
use snakeloop::camera::{CameraFormat, Frame, FrameSource, Lens, Samples, read_frame};
use snakeloop::geometry::Configuration;
use snakeloop::live::{LineParser, journal};
use snakeloop::measure::{Eye, FrameMeasurement, Rig, RigOptions, calibrate_rig};
use snakeloop::record::{
    Experiment, MeasurementJournal, model_toml, read_effects, read_encoders, read_friction, read_measurements,
    read_model, read_tracker_poses, read_trajectory, read_truth, tracker_poses_of,
};
use snakeloop::robot::Model;
use snakeloop::simulate::{Scene, render};
use std::io::{Seek, Write};
use std::path::Path;
use std::sync::LazyLock;
use tempfile::NamedTempFile;

/// What became of the bytes, once for each reader that they were given to: its name, and what it said.
pub type Outcomes = Vec<(&'static str, Result<(), String>)>;

/// Calls with the path of a file that holds these bytes.
fn in_file<T>(bytes: &[u8], read: impl FnOnce(&Path) -> T) -> T {
    thread_local! {
        static FILE: std::cell::RefCell<NamedTempFile> = std::cell::RefCell::new(NamedTempFile::new().unwrap());
    }
    FILE.with_borrow_mut(|file| {
        file.as_file().set_len(0).unwrap();
        file.rewind().unwrap();
        file.write_all(bytes).unwrap();
        read(file.path())
    })
}

fn outcome<T>(reader: &'static str, result: snakeloop::Result<T>) -> (&'static str, Result<(), String>) {
    (reader, result.map(|_| ()).map_err(|e| e.to_string()))
}

/// Every reader of a CSV file. What they accept must be finite.
pub fn tables(bytes: &[u8]) -> Outcomes {
    in_file(bytes, |path| {
        let encoders = read_encoders(path, 3);
        for reading in encoders.iter().flat_map(|checked| &checked.rows) {
            assert!(reading.time_s.is_finite() && reading.q_mm.iter().all(|q| q.is_finite()));
        }
        let truth = read_truth(path);
        for row in truth.iter().flat_map(|checked| &checked.rows) {
            assert!(row.configuration.theta.is_finite() && row.configuration.delta.is_finite());
        }
        let measurements = read_measurements(path);
        for measured in measurements.iter().flat_map(|checked| &checked.rows).filter_map(|row| row.measured) {
            assert!(measured.configuration.theta.is_finite() && measured.configuration.delta.is_finite());
        }
        let tracker = read_tracker_poses(path);
        for pose in tracker.iter().flat_map(|checked| &checked.rows) {
            assert!(pose.position_mm.is_none_or(|position| position.iter().all(|mm| mm.is_finite())));
            assert!(pose.orientation.is_none_or(|turn| (turn.norm() - 1.0).abs() < 1e-6));
        }
        vec![
            outcome("tracker", tracker),
            outcome("encoders", encoders),
            outcome("truth", truth),
            outcome("measurements", measurements),
            outcome("friction", read_friction(path)),
            outcome("trajectory", read_trajectory(path)),
        ]
    })
}

/// Every reader of a TOML file. A model that is accepted can be written, read back and asked what to command; a wiring that is accepted
/// is one of three backbones.
pub fn settings(bytes: &[u8]) -> Outcomes {
    in_file(bytes, |path| {
        let model = read_model(path);
        if let Ok(model) = &model {
            model_toml(model).unwrap();
            obey(model);
        }
        let experiment = Experiment::read(path);
        let wiring = experiment.as_ref().map_err(ToString::to_string).and_then(|experiment| {
            let wiring = experiment.wiring(3).map_err(|e| e.to_string())?;
            assert_eq!((wiring.columns.len(), wiring.signs.len()), (3, 3));
            if wiring.is_straight() { Err("no wiring".to_owned()) } else { Ok(()) }
        });
        vec![
            ("wiring", wiring),
            outcome("experiment", experiment),
            outcome("effects", read_effects(path)),
            outcome("rig", Rig::read(path)),
            outcome("model", model),
            outcome("scene", Scene::read(path)),
        ]
    })
}

/// Both ways through a model.
fn obey(model: &Model) {
    for (theta_deg, delta_deg) in [(0.0, 0.0), (45.0, 180.0), (90.0, -60.0)] {
        let q_tilde = model.command(Configuration::from_degrees(theta_deg, delta_deg));
        let _ = model.forward(&q_tilde);
    }
}

/// Camera files in YAML: OpenCV's and ROS's.
pub fn camera_yaml(bytes: &[u8]) -> Outcomes {
    if starts_like_xml(bytes) { Vec::new() } else { camera("yaml", bytes) }
}

/// Camera files in XML: OpenCV's.
pub fn camera_xml(bytes: &[u8]) -> Outcomes {
    if starts_like_xml(bytes) { camera("xml", bytes) } else { Vec::new() }
}

fn starts_like_xml(bytes: &[u8]) -> bool {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).trim_ascii_start().starts_with(b"<")
}

/// A lens that is accepted survives being written, and can be looked through.
fn camera(reader: &'static str, bytes: &[u8]) -> Outcomes {
    let lens = in_file(bytes, Lens::read);
    if let Ok(lens) = &lens {
        for format in [CameraFormat::OpenCvYaml, CameraFormat::OpenCvXml, CameraFormat::Ros] {
            let again = in_file(lens.to_file(format).as_bytes(), Lens::read).unwrap();
            assert_eq!(&again, lens, "{format:?}");
        }
        let pixel = lens.project(&Point3::new(1.0, -2.0, 100.0));
        lens.ray(&pixel);
        lens.ray(&lens.centre_px);
    }
    vec![outcome(reader, lens)]
}

/// Topics of the recording in the corpus, by what is in them.
const PICTURES: [&str; 5] = ["/camera/image_raw/compressed", "/raw/mono8", "/raw/bgr8", "/raw/rgb8", "/raw/bayer"];
const JOINTS: &str = "/joint_states";
const LENS: &str = "/camera/camera_info";
const POSES: [&str; 2] = ["/tip/pose", "/tip/transform"];

/// Recordings of ROS 2: the container, and the messages in it.
pub fn recording(bytes: &[u8]) -> Outcomes {
    in_file(bytes, |path| {
        let topic = |topic: &str| Topic { bag: path.to_owned().into(), topic: topic.to_owned() };
        let mut outcomes =
            vec![outcome("joints", topic(JOINTS).all::<JointState>()), outcome("lens", Lens::of_topic(&topic(LENS)))];
        for name in POSES {
            let poses = tracker_poses_of(&topic(name));
            for pose in poses.iter().flat_map(|poses| &poses.rows) {
                assert!(pose.position_mm.is_none_or(|position| position.iter().all(|mm| mm.is_finite())));
            }
            let faults = poses.iter().flat_map(|poses| &poses.warnings).map(|fault| Err(fault.message.clone()));
            outcomes.extend(faults.map(|fault| ("poses", fault)).collect::<Vec<_>>());
            outcomes.push(outcome("poses", poses));
        }
        outcomes.extend(PICTURES.map(|name| outcome("pictures", pictures(topic(name)))));
        outcomes
    })
}

/// The first pictures of a topic, decoded; each holds as many samples as its size says.
fn pictures(topic: Topic) -> snakeloop::Result<()> {
    let source = FrameSource::of_topic(topic)?;
    for frame in source.frames()?.take(4) {
        let frame = frame.read()?;
        assert_eq!(frame.samples.len(), frame.width as usize * frame.height as usize * frame.channels);
    }
    Ok(())
}

/// Messages of ROS 2 (CDR): the first byte says which, the rest is one. They stand in a recording without chunks, whose checksums would
/// keep most of what is tried from ever being decoded.
pub fn message(bytes: &[u8]) -> Outcomes {
    let kinds = [
        ("sensor_msgs/msg/JointState", JOINTS),
        ("sensor_msgs/msg/CameraInfo", LENS),
        ("geometry_msgs/msg/PoseStamped", POSES[0]),
        ("geometry_msgs/msg/TransformStamped", POSES[1]),
        ("sensor_msgs/msg/CompressedImage", PICTURES[0]),
        ("sensor_msgs/msg/Image", PICTURES[1]),
    ];
    let Some((&which, cdr)) = bytes.split_first() else { return Vec::new() };
    let (kind, topic) = kinds[usize::from(which) % kinds.len()];
    let missing = |outcome: &(_, Result<(), String>)| {
        outcome.1.as_ref().is_err_and(|why| why.contains("no message; the recording has"))
    };
    recording(&recorded(kind, topic, cdr)).into_iter().filter(|outcome| !missing(outcome)).collect()
}

/// A recording of one message.
///
/// Source: <https://mcap.dev/spec>.
fn recorded(kind: &str, topic: &str, cdr: &[u8]) -> Vec<u8> {
    const MAGIC: &[u8] = b"\x89MCAP0\r\n";
    let text = |text: &str| [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat();
    let record = |opcode: u8, body: &[u8]| [&[opcode][..], &(body.len() as u64).to_le_bytes(), body].concat();
    let one = 1u16.to_le_bytes();
    let schema = [&one[..], &text(kind), &text("ros2msg"), &text("")].concat();
    let channel = [&one[..], &one, &text(topic), &text("cdr"), &text("")].concat();
    // Number, sequence and two times.
    let message = [&one[..], &[0; 20], cdr].concat();
    let records =
        [record(1, &[text("ros2"), text("")].concat()), record(3, &schema), record(4, &channel), record(5, &message)];
    [MAGIC, &records.concat()].concat()
}

/// The journal of `live`, read to go on with a run.
pub fn journal(bytes: &[u8]) -> Outcomes {
    let mut entries = 0;
    let read = in_file(bytes, |path| journal::read(path, |_| entries += 1)).unwrap();
    assert!(read.0 <= bytes.len() as u64);
    let entry = if entries > 0 { Ok(()) } else { Err("no entry".to_owned()) };
    vec![("whole", read.1.map_or(Ok(()), Err)), ("entry", entry)]
}

/// The journal that `run --resume` and `measure --resume` go on with. What was cut off once is whole from then on, and nothing of
/// what was kept was changed.
pub fn run_journal(bytes: &[u8]) -> Outcomes {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("measurements.journal");
    std::fs::write(&path, bytes).unwrap();
    let origin = toml::Table::from_iter([("experiment".to_owned(), "a".into())]);
    let resumed = MeasurementJournal::resume(folder.path(), &origin).map(|journal| (journal.rows(), journal.last()));
    let kept = std::fs::read(&path).unwrap();
    assert!(bytes.starts_with(&kept));
    if let Ok(first) = resumed {
        let again = MeasurementJournal::resume(folder.path(), &origin).unwrap();
        assert_eq!((again.rows(), again.last()), first);
        assert_eq!(std::fs::read(&path).unwrap(), kept);
    }
    let rows = match &resumed {
        Ok((0, _)) => Err("no row".to_owned()),
        Ok(_) if kept.len() < bytes.len() => Err("cut off".to_owned()),
        _ => Ok(()),
    };
    vec![outcome("head", resumed), ("rows", rows)]
}

/// Lines of encoders as `live` takes them from a socket.
pub fn encoder_lines(bytes: &[u8]) -> Outcomes {
    let mut parser = LineParser::new(3);
    let mut outcomes = Outcomes::new();
    for line in bytes.split(|&byte| byte == b'\n') {
        match parser.parse(line) {
            Ok(Some((stamp_s, q_mm))) => {
                assert!(stamp_s.is_finite() && q_mm.iter().all(|q| q.is_finite()));
                outcomes.push(("reading", Ok(())));
            }
            Ok(None) => outcomes.push(("remark", Ok(()))),
            Err(why) => outcomes.push(("reading", Err(why))),
        }
    }
    outcomes
}

/// Files of pictures. What is accepted holds as many samples as its size says.
pub fn picture(bytes: &[u8]) -> Outcomes {
    let frame = in_file(bytes, read_frame);
    if let Ok(frame) = &frame {
        assert_eq!(frame.samples.len(), frame.width as usize * frame.height as usize * frame.channels);
    }
    vec![outcome("picture", frame)]
}

/// A calibrated view, small so that many pictures can be tried, and a good picture of it.
struct Lab {
    scene: Scene,
    eye: Eye,
    good: Frame,
}

static LAB: LazyLock<Lab> = LazyLock::new(|| {
    const SHRINK: u32 = 2;
    let mut scene = Scene::default();
    let whole = scene.lens.clone();
    scene.lens.width /= SHRINK;
    scene.lens.height /= SHRINK;
    scene.lens.focal_px /= f64::from(SHRINK);
    scene.lens.centre_px = (whole.centre_px.coords / f64::from(SHRINK)).into();
    let frame = |theta_deg, delta_deg| {
        let picture = render(&scene, Configuration::from_degrees(theta_deg, delta_deg), 7);
        Frame::from_image(DynamicImage::ImageRgb8(picture)).unwrap()
    };
    let options = RigOptions {
        grid_pitch_mm: scene.grid_pitch_mm().unwrap(),
        standoff_mm: scene.paper.standoff_mm,
        delta_offset: 0.0,
    };
    let rig = calibrate_rig(&frame(0.0, 0.0), &scene.lens, &scene.robot, &options).unwrap();
    let eye = Eye::new(scene.lens.clone(), rig, scene.robot.clone());
    let good = frame(40.0, 0.0);
    Lab { scene, eye, good }
});

/// The eye on any pixels. The first byte chooses between a good picture with blots upon it and a picture of any size, the
/// rest are blots or pixels.
pub fn measure(bytes: &[u8]) -> Outcomes {
    let Some((&kind, rest)) = bytes.split_first() else { return Vec::new() };
    let frame = match kind % 4 {
        0 => of_any_size(rest, 1),
        1 => of_any_size(rest, 3),
        2 => noise(rest),
        _ => blotted(rest),
    };
    let lab = &*LAB;
    let measurement = lab.eye.measure(&frame);
    check(&measurement);
    check(&lab.eye.track(&frame, Vector2::new(0.7, 0.0)));
    vec![("eye", measurement.measured.map(|_| ()).ok_or_else(|| measurement.status.to_string()))]
}

fn check(measurement: &FrameMeasurement) {
    let Some(measured) = measurement.measured else { return };
    assert!(measured.configuration.theta.is_finite() && measured.configuration.delta.is_finite());
    assert!(measured.sigma_theta > 0.0 && measured.sigma_delta > 0.0, "{measured:?}");
    assert!(measured.correlation.abs() <= 1.0, "{measured:?}");
}

/// Two bytes of size, then levels, repeated until the picture is full.
fn of_any_size(bytes: &[u8], channels: usize) -> Frame {
    let (size, levels) = bytes.split_at(bytes.len().min(2));
    let side = |k: usize| u32::from(size.get(k).copied().unwrap_or(0));
    let (width, height) = (side(0), side(1));
    let count = width as usize * height as usize * channels;
    let level = |k: usize| if levels.is_empty() { 0 } else { levels[k % levels.len()] };
    Frame { width, height, channels, samples: Samples::Bits8((0..count).map(level).collect()) }
}

/// Coarse levels, smoothed to the size of the lens's picture.
fn noise(levels: &[u8]) -> Frame {
    let side = levels.len().isqrt().clamp(1, 24) as u32;
    let level = |x: u32, y: u32| levels.get((y * side + x) as usize).copied().unwrap_or(127);
    let coarse = image::GrayImage::from_fn(side, side, |x, y| image::Luma([level(x, y)]));
    let lens = &LAB.scene.lens;
    let picture = imageops::resize(&coarse, lens.width, lens.height, imageops::FilterType::Triangle);
    Frame::from_image(DynamicImage::ImageLuma8(picture).to_rgb8().into()).unwrap()
}

/// The good picture with rectangles upon it: each takes six bytes, place, size, level and how it covers.
fn blotted(bytes: &[u8]) -> Frame {
    let mut frame = LAB.good.clone();
    let Samples::Bits8(samples) = &mut frame.samples else { return frame };
    for blot in bytes.chunks_exact(6).take(40) {
        let [x, y, w, h, level, how] = [0, 1, 2, 3, 4, 5].map(|k| u32::from(blot[k]));
        let (x, y) = (x * frame.width / 256, y * frame.height / 256);
        let level = level as u8;
        for row in y..(y + h).min(frame.height) {
            for column in x..(x + w).min(frame.width) {
                let at = ((row * frame.width + column) as usize) * frame.channels;
                for sample in &mut samples[at..at + 3] {
                    *sample = match how % 4 {
                        0 => level,
                        1 => sample.saturating_add(level),
                        2 => sample.saturating_sub(level),
                        _ => u8::MAX - *sample,
                    };
                }
            }
        }
    }
    frame
}
