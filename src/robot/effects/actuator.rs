//! The actuators and their encoders: errors that are a function of q̃ alone.

use super::{Acts, ParameterSpec, Physics};
use nalgebra::Vector3;
use std::f64::consts::TAU;

const fn scale(name: &'static str) -> ParameterSpec {
    ParameterSpec { name, unit: "1", range: (-0.5, 0.5), typical: 0.03 }
}

const fn offset(name: &'static str) -> ParameterSpec {
    ParameterSpec { name, unit: "mm", range: (-2.0, 2.0), typical: 0.05 }
}

/// Each actuator's travel per count is off by its own share.
pub(super) static ACTUATOR_SCALE: Physics = Physics {
    name: "actuator_scale",
    equation: "q̃_i += k_i q̃_i",
    reading: "encoders that count too much or too little travel, each actuator by its own share",
    parameters: &[scale("scale_1"), scale("scale_2"), scale("scale_3")],
    starts: &[&[0.0; 3]],
    acts: Acts::Actuator(|q, p| q.component_mul(&Vector3::new(p[0], p[1], p[2]))),
};

/// Each actuator's zero is off. The mean of the three is λ itself, so the offsets sum to zero.
pub(super) static ACTUATOR_OFFSET: Physics = Physics {
    name: "actuator_offset",
    equation: "q̃_i += o_i, o_3 = −o_1 − o_2 (their mean is λ)",
    reading: "actuators whose zeros differ from each other",
    parameters: &[offset("offset_1_mm"), offset("offset_2_mm")],
    starts: &[&[0.0; 2]],
    acts: Acts::Actuator(|_, p| Vector3::new(p[0], p[1], -p[0] - p[1])),
};

/// The lead screws' error, periodic in their travel.
pub(super) static SCREW_PERIODIC: Physics = Physics {
    name: "screw_periodic",
    equation: "q̃_i += A sin(2π q̃_i / p + φ)",
    reading: "a lead-screw error that repeats with the screw's pitch",
    parameters: &[
        ParameterSpec { name: "amplitude_mm", unit: "mm", range: (-0.5, 0.5), typical: 0.03 },
        ParameterSpec { name: "pitch_mm", unit: "mm", range: (0.2, 5.0), typical: 0.1 },
        ParameterSpec { name: "phase_deg", unit: "deg", range: (-720.0, 720.0), typical: 30.0 },
    ],
    starts: &[],
    acts: Acts::Actuator(|q, p| q.map(|q| p[0] * (TAU * q / p[1] + p[2].to_radians()).sin())),
};
