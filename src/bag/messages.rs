//! The messages that an experiment is made of: joint states, compressed pictures, a camera's lens, poses; and those that `live` publishes.
//! Raw pictures are `camera`'s.
//! Those that recordings are written of have their [`Definition`] and their encoding beside.
//!
//! Source: the definitions of ROS 2's packages `sensor_msgs`, `geometry_msgs`, `std_msgs` and `diagnostic_msgs`.

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

/// The time and frame of reference of a message, s, below 2^31 s. What begins with a header is dated so.
pub fn begun_s(time_s: f64, frame_id: &str) -> CdrWriter {
    begun((time_s.max(0.0) * 1e9).round() as u64, frame_id)
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

/// `geometry_msgs/Vector3Stamped`.
#[derive(Debug, Clone, PartialEq)]
pub struct StampedVector {
    /// s.
    pub stamp_s: f64,
    /// In the unit that the topic says.
    pub vector: [f64; 3],
}

impl StampedVector {
    /// The type of ROS.
    pub const KIND: &'static str = "geometry_msgs/Vector3Stamped";

    /// The message, with the frame of reference that it is in.
    pub fn encoded(&self, frame_id: &str) -> Vec<u8> {
        let mut cdr = begun_s(self.stamp_s, frame_id);
        self.vector.into_iter().for_each(|value| cdr.f64(value));
        cdr.into_bytes()
    }
}

impl Stamped for StampedVector {
    const KINDS: &'static [&'static str] = &[Self::KIND];

    fn body(stamp_s: f64, _: &str, cdr: &mut Cdr) -> CdrResult<Self> {
        Ok(Self { stamp_s, vector: cdr.f64s()? })
    }
}

/// `std_msgs/Float64MultiArray` of one dimension, whose label names its numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Numbers<'a> {
    /// What the numbers are, as the head of a table: names with commas between.
    pub label: &'a str,
    /// The numbers.
    pub values: &'a [f64],
}

impl Numbers<'_> {
    /// The type of ROS.
    pub const KIND: &'static str = "std_msgs/Float64MultiArray";

    /// The message. It has no header.
    pub fn encoded(&self) -> Vec<u8> {
        let mut cdr = CdrWriter::begin();
        // One dimension: its label, size and stride.
        cdr.length(1);
        cdr.text(self.label);
        cdr.length(self.values.len());
        cdr.length(self.values.len());
        // The data begin at once.
        cdr.u32(0);
        cdr.f64_sequence(self.values);
        cdr.into_bytes()
    }
}

/// How a component is, by `diagnostic_msgs/DiagnosticStatus`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DiagnosticLevel {
    /// All is well.
    Ok = 0,
    /// Something is to be looked at.
    Warn = 1,
    /// It must not be used.
    Error = 2,
    /// Nothing is known yet.
    Stale = 3,
}

/// `diagnostic_msgs/DiagnosticArray` of one status.
#[derive(Debug, Clone, PartialEq)]
pub struct Diagnostic<'a> {
    /// s.
    pub stamp_s: f64,
    /// How it is.
    pub level: DiagnosticLevel,
    /// What it is about.
    pub name: &'a str,
    /// How it is, in a sentence.
    pub message: &'a str,
    /// Further values by their names.
    pub values: &'a [(String, String)],
}

impl Diagnostic<'_> {
    /// The type of ROS.
    pub const KIND: &'static str = "diagnostic_msgs/DiagnosticArray";

    /// The message.
    pub fn encoded(&self) -> Vec<u8> {
        let mut cdr = begun_s(self.stamp_s, "");
        cdr.length(1);
        cdr.u8(self.level as u8);
        cdr.text(self.name);
        cdr.text(self.message);
        // The hardware has no name.
        cdr.text("");
        cdr.length(self.values.len());
        for (key, value) in self.values {
            cdr.text(key);
            cdr.text(value);
        }
        cdr.into_bytes()
    }
}
