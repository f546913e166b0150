//! The eye: where the camera's answer differs from the snake's bend.

use super::physics::{Changes, FREQUENT, LINEAR, OPEN, ParameterSpec, Physics};
use nalgebra::Rotation2;

/// The grid's or the camera's axis is turned about the snake's.
pub(super) static PLANE_MISALIGNMENT: Physics = Physics {
    log_prior: OPEN,
    name: "plane_misalignment",
    equation: "measured δ = δ + a",
    reading: "a camera or grid that is turned about the snake's axis, so that every δ is off by the same angle",
    parameters: |_| const { &[ParameterSpec::size("angle_deg", "deg", 30.0, 2.0)] },
    changes: Changes::Eye(|bend, p| Rotation2::new(p[0].to_radians()) * bend),
    ..LINEAR
};

/// The straight reference was not straight.
pub(super) static BEND_OFFSET: Physics = Physics {
    log_prior: FREQUENT,
    name: "bend_offset",
    equation: "measured θ = θ + a",
    reading: "a measured bend that is off by the same angle everywhere, as when the straight picture was not straight",
    parameters: |_| const { &[ParameterSpec::size("angle_deg", "deg", 15.0, 1.0)] },
    changes: Changes::Eye(|bend, p| {
        let theta = bend.norm();
        if theta > 0.0 { bend * ((theta + p[0].to_radians()) / theta) } else { bend }
    }),
    ..LINEAR
};

/// The snake is no circle, and the less so the more it bends.
///
/// With θ and δ alone a curvature that varies along the snake leaves q as it is (Eq. 1 needs no circle) and scales the elastic
/// energy, which η does already. What is left is the eye that fits a circle to it: it is off by more than in proportion.
pub(super) static NON_CIRCULAR_SHAPE: Physics = Physics {
    log_prior: FREQUENT,
    name: "non_circular_shape",
    equation: "measured θ = θ + k θ²",
    reading: "a snake whose curvature varies along it, so that the fitted arc bends differently from its tip",
    parameters: |_| const { &[ParameterSpec::positive("shape_per_rad", "1/rad", (-0.3, 0.3), 0.02)] },
    changes: Changes::Eye(|bend, p| bend * (1.0 + p[0] * bend.norm())),
    ..LINEAR
};

/// The frame is older than the encoders' reading.
pub(super) static CAMERA_LATENCY: Physics = Physics {
    name: "camera_latency",
    equation: "measured ψ(t) = ψ(t − T)",
    reading: "frames that are older than the encoder readings of the same number",
    parameters: |_| const { &[ParameterSpec::positive("latency_s", "s", (-2.0, 2.0), 0.05)] },
    changes: Changes::Exposure(|p| p[0]),
    in_time: true,
    ..LINEAR
};
