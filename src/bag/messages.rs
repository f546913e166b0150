//! The messages that an experiment is made of: joint states, compressed pictures, a camera's lens, poses. Raw pictures are `camera`'s.
//! Those that recordings are written of have their [`Definition`] and their encoding beside.
//!
//! Source: the definitions of ROS 2's packages `sensor_msgs` and `geometry_msgs`.

use super::cdr::{Cdr, CdrResult, CdrWriter};
use nalgebra::{Quaternion, Vector3};

/// A kind of message that begins with a header.
pub trait Stamped: Sized {
    /// The types of ROS that it is read from.
    const KINDS: &'static [&'static str];

    /// What follows the header.
    ///
    /// # Errors
    /// Bytes that are no such message.
    fn body(stamp_s: f64, kind: &str, cdr: &mut Cdr) -> CdrResult<Self>;

    /// A message of a type from its bytes.
    ///
    /// # Errors
    /// Another type, or bytes that are no such message.
    fn decoded(kind: &str, bytes: &[u8]) -> CdrResult<Self> {
        // ROS 1 writes the types without `msg`, and some converters keep that.
        let kind = kind.replace("/msg/", "/");
        if !Self::KINDS.contains(&kind.as_str()) {
            return Err(format!("messages of type {kind}, expected {}", Self::KINDS.join(" or ")));
        }
        let mut cdr = Cdr::new(bytes)?;
        let stamp_s = header(&mut cdr)?;
        Self::body(stamp_s, &kind, &mut cdr)
    }
}

/// `std_msgs/Header`: its time, s.
fn header(cdr: &mut Cdr) -> CdrResult<f64> {
    let (seconds, nanoseconds) = (cdr.i32()?, cdr.u32()?);
    cdr.text()?;
    Ok(f64::from(seconds) + 1e-9 * f64::from(nanoseconds))
}

/// What readers must know of a kind of message to decode it. All kinds begin with a header.
#[derive(Debug, Clone, Copy)]
pub struct Definition<'a> {
    /// The type, such as `sensor_msgs/JointState`.
    pub kind: &'a str,
    /// Its fields behind the header, a line each.
    pub fields: &'a str,
}

/// The types that a header is made of, as ROS 2 writes them below the type that uses them.
const HEADER_DEFINITIONS: &str = "\
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
";

impl Definition<'_> {
    /// The type's full name in ROS 2, such as `sensor_msgs/msg/JointState`.
    pub fn name(&self) -> String {
        self.kind.replacen('/', "/msg/", 1)
    }

    /// The definition with those of the types in it, as a recording carries it (`ros2msg`).
    pub fn text(&self) -> String {
        format!("std_msgs/Header header\n{}{HEADER_DEFINITIONS}", self.fields)
    }
}

/// A message as far as its header: the time, ns, below 2^31 s, and the frame of reference.
pub fn begun(time_ns: u64, frame_id: &str) -> CdrWriter {
    let mut cdr = CdrWriter::begin();
    cdr.i32((time_ns / 1_000_000_000) as i32);
    cdr.u32((time_ns % 1_000_000_000) as u32);
    cdr.text(frame_id);
    cdr
}

/// The time of a message's header, s.
pub fn stamp_s(bytes: &[u8]) -> Option<f64> {
    header(&mut Cdr::new(bytes).ok()?).ok()
}

/// `sensor_msgs/JointState`.
#[derive(Debug, Clone, PartialEq)]
pub struct JointState {
    /// s.
    pub stamp_s: f64,
    /// The joints.
    pub names: Vec<String>,
    /// Their positions, rad or m.
    pub positions: Vec<f64>,
}

impl JointState {
    /// How it is recorded.
    pub const DEFINITION: Definition<'static> = Definition {
        kind: "sensor_msgs/JointState",
        fields: "string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
    };

    /// The message of joints at these positions, rad or m, and a time, ns. Velocities and efforts are not told.
    pub fn encoded(time_ns: u64, names: &[String], positions: &[f64]) -> Vec<u8> {
        let mut cdr = begun(time_ns, "");
        cdr.texts(names);
        for values in [positions, &[], &[]] {
            cdr.f64_sequence(values);
        }
        cdr.into_bytes()
    }
}

impl Stamped for JointState {
    const KINDS: &'static [&'static str] = &[Self::DEFINITION.kind];

    fn body(stamp_s: f64, _: &str, cdr: &mut Cdr) -> CdrResult<Self> {
        Ok(Self { stamp_s, names: cdr.texts()?, positions: cdr.f64_sequence()? })
    }
}

/// `sensor_msgs/CompressedImage` behind its header.
#[derive(Debug, Clone, PartialEq)]
pub struct CompressedImage<'a> {
    /// Such as `jpeg` or `png`.
    pub format: String,
    /// A picture file.
    pub data: &'a [u8],
}

impl<'a> CompressedImage<'a> {
    /// How it is recorded.
    pub const DEFINITION: Definition<'static> =
        Definition { kind: "sensor_msgs/CompressedImage", fields: "string format\nuint8[] data\n" };

    /// What follows the header.
    ///
    /// # Errors
    /// A message that is cut short.
    pub fn read(cdr: &mut Cdr<'a>) -> CdrResult<Self> {
        Ok(Self { format: cdr.text()?, data: cdr.bytes()? })
    }

    /// The message of a camera's picture taken at a time, ns.
    pub fn encoded(&self, time_ns: u64, camera: &str) -> Vec<u8> {
        let mut cdr = begun(time_ns, camera);
        cdr.text(&self.format);
        cdr.bytes(self.data);
        cdr.into_bytes()
    }
}

/// `sensor_msgs/CameraInfo`, as far as a lens needs it.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraInfo {
    /// px.
    pub height: u32,
    /// px.
    pub width: u32,
    /// Such as `plumb_bob`.
    pub distortion_model: String,
    /// The coefficients, in OpenCV's order.
    pub distortion: Vec<f64>,
    /// The camera matrix by rows.
    pub matrix: [f64; 9],
    /// How many columns and rows of the sensor are one of a picture; 0 is one.
    pub binning: [u32; 2],
    /// The first column and row of the sensor in a picture.
    pub offset: [u32; 2],
    /// Columns and rows of the sensor in a picture; all of them where both are 0.
    pub window: [u32; 2],
}

impl Stamped for CameraInfo {
    const KINDS: &'static [&'static str] = &["sensor_msgs/CameraInfo"];

    fn body(_: f64, _: &str, cdr: &mut Cdr) -> CdrResult<Self> {
        let (height, width, distortion_model) = (cdr.u32()?, cdr.u32()?, cdr.text()?);
        let (distortion, matrix) = (cdr.f64_sequence()?, cdr.f64s()?);
        let _rectification: [f64; 9] = cdr.f64s()?;
        let _projection: [f64; 12] = cdr.f64s()?;
        let binning = [cdr.u32()?, cdr.u32()?];
        let [x, y, window_height, window_width] = [cdr.u32()?, cdr.u32()?, cdr.u32()?, cdr.u32()?];
        let window = [window_width, window_height];
        Ok(Self { height, width, distortion_model, distortion, matrix, binning, offset: [x, y], window })
    }
}

/// `geometry_msgs/PoseStamped` or `TransformStamped`: a pose in the frame of its header.
#[derive(Debug, Clone, PartialEq)]
pub struct StampedPose {
    /// s.
    pub stamp_s: f64,
    /// m.
    pub position_m: Vector3<f64>,
    /// From the moved frame's axes to the header's.
    pub orientation: Quaternion<f64>,
}

impl Stamped for StampedPose {
    const KINDS: &'static [&'static str] = &["geometry_msgs/PoseStamped", "geometry_msgs/TransformStamped"];

    fn body(stamp_s: f64, kind: &str, cdr: &mut Cdr) -> CdrResult<Self> {
        if kind == "geometry_msgs/TransformStamped" {
            cdr.text()?;
        }
        let ([x, y, z], [i, j, k, w]) = (cdr.f64s()?, cdr.f64s()?);
        Ok(Self { stamp_s, position_m: Vector3::new(x, y, z), orientation: Quaternion::new(w, i, j, k) })
    }
}
