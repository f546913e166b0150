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
    form: "",
    equation: "q̃_i += k_i q̃_i",
    reading: "encoders that count too much or too little travel, each actuator by its own share",
    parameters: &[scale("scale_1"), scale("scale_2"), scale("scale_3")],
    starts: &[&[0.0; 3]],
    acts: Acts::Actuator(|q, p| q.component_mul(&Vector3::new(p[0], p[1], p[2]))),
    remembers: None,
};

/// Each actuator's zero is off. The mean of the three is λ itself, so the offsets sum to zero.
pub(super) static ACTUATOR_OFFSET: Physics = Physics {
    name: "actuator_offset",
    form: "",
    equation: "q̃_i += o_i, o_3 = −o_1 − o_2 (their mean is λ)",
    reading: "actuators whose zeros differ from each other",
    parameters: &[offset("offset_1_mm"), offset("offset_2_mm")],
    starts: &[&[0.0; 2]],
    acts: Acts::Actuator(|_, p| Vector3::new(p[0], p[1], -p[0] - p[1])),
    remembers: None,
};

const AMPLITUDE: ParameterSpec = ParameterSpec { name: "amplitude_mm", unit: "mm", range: (-0.5, 0.5), typical: 0.03 };
const PITCH: ParameterSpec = ParameterSpec { name: "pitch_mm", unit: "mm", range: (0.2, 6.0), typical: 0.1 };

const fn phase(name: &'static str) -> ParameterSpec {
    ParameterSpec { name, unit: "deg", range: (-720.0, 720.0), typical: 30.0 }
}

const fn screw(
    form: &'static str,
    equation: &'static str,
    parameters: &'static [ParameterSpec],
    acts: Acts,
) -> Physics {
    Physics {
        name: "screw_periodic",
        form,
        equation,
        reading: "a lead-screw error that repeats with the screw's pitch",
        parameters,
        starts: &[],
        acts,
        remembers: None,
    }
}

const ONE_PHASE: &[ParameterSpec] = &[AMPLITUDE, PITCH, phase("phase_deg")];
const PHASES: &[ParameterSpec] = &[AMPLITUDE, PITCH, phase("phase_1_deg"), phase("phase_2_deg"), phase("phase_3_deg")];

/// A sin(2π x_i / p + φ_i), with one phase for all or one each.
fn wave(x: &Vector3<f64>, p: &[f64]) -> Vector3<f64> {
    Vector3::from_fn(|i, _| {
        let phase_deg = if p.len() == 3 { p[2] } else { p[2 + i] };
        p[0] * (TAU * x[i] / p[1] + phase_deg.to_radians()).sin()
    })
}

/// The lead screws' error, periodic in what their encoders read.
pub(super) static SCREW_PERIODIC: Physics = screw("", "q̃_i += A sin(2π q̃_i / p + φ)", ONE_PHASE, Acts::Actuator(wave));

/// The same, each screw with its own phase.
pub(super) static SCREW_PHASES: Physics =
    screw("own phases", "q̃_i += A sin(2π q̃_i / p + φ_i)", PHASES, Acts::Actuator(wave));

/// The same, periodic in what the nuts travel.
pub(super) static SCREW_TRAVEL: Physics =
    screw("travel", "q̃_i += A sin(2π (q_i + ε_i) / p + φ)", ONE_PHASE, Acts::Line(|at, p| wave(&at.line_mm, p)));

/// The same, each screw with its own phase.
pub(super) static SCREW_TRAVEL_PHASES: Physics = screw(
    "travel, own phases",
    "q̃_i += A sin(2π (q_i + ε_i) / p + φ_i)",
    PHASES,
    Acts::Line(|at, p| wave(&at.line_mm, p)),
);
