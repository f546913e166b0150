//! The eye: where the camera's answer differs from the snake's bend.

use super::{Acts, ParameterSpec, Physics};
use nalgebra::Rotation2;

/// The grid's or the camera's axis is turned about the snake's.
pub(super) static PLANE_MISALIGNMENT: Physics = Physics {
    name: "plane_misalignment",
    equation: "measured δ = δ + a",
    reading: "a camera or grid that is turned about the snake's axis, so that every δ is off by the same angle",
    parameters: &[ParameterSpec { name: "angle_deg", unit: "deg", range: (-30.0, 30.0), typical: 2.0 }],
    starts: &[&[0.0]],
    acts: Acts::Eye(|bend, p| Rotation2::new(p[0].to_radians()) * bend),
};

/// The straight reference was not straight.
pub(super) static BEND_OFFSET: Physics = Physics {
    name: "bend_offset",
    equation: "measured θ = θ + a",
    reading: "a measured bend that is off by the same angle everywhere, as when the straight picture was not straight",
    parameters: &[ParameterSpec { name: "angle_deg", unit: "deg", range: (-15.0, 15.0), typical: 1.0 }],
    starts: &[&[0.0]],
    acts: Acts::Eye(|bend, p| {
        let theta = bend.norm();
        if theta > 0.0 { bend * ((theta + p[0].to_radians()) / theta) } else { bend }
    }),
};

/// The frame is older than the encoders' reading.
pub(super) static CAMERA_LATENCY: Physics = Physics {
    name: "camera_latency",
    equation: "measured ψ(t) = ψ(t − T)",
    reading: "frames that are older than the encoder readings of the same number",
    parameters: &[ParameterSpec { name: "latency_s", unit: "s", range: (-2.0, 2.0), typical: 0.05 }],
    starts: &[&[0.0]],
    acts: Acts::Delay(|p| p[0]),
};
