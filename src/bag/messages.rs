//! The messages that an experiment is made of: joint states, a camera's lens, poses. Pictures are `camera`'s.
//!
//! Source: the definitions of ROS 2's packages `sensor_msgs` and `geometry_msgs`.

use super::cdr::{Cdr, CdrResult};
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

impl Stamped for JointState {
    const KINDS: &'static [&'static str] = &["sensor_msgs/JointState"];

    fn body(stamp_s: f64, _: &str, cdr: &mut Cdr) -> CdrResult<Self> {
        Ok(Self { stamp_s, names: cdr.texts()?, positions: cdr.f64_sequence()? })
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
}

impl Stamped for CameraInfo {
    const KINDS: &'static [&'static str] = &["sensor_msgs/CameraInfo"];

    fn body(_: f64, _: &str, cdr: &mut Cdr) -> CdrResult<Self> {
        Ok(Self {
            height: cdr.u32()?,
            width: cdr.u32()?,
            distortion_model: cdr.text()?,
            distortion: cdr.f64_sequence()?,
            matrix: cdr.f64s()?,
        })
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
