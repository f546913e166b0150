//! The actuators and their encoders: errors that are a function of q̃ alone.

use super::{Acts, ParameterSpec, Physics};
use crate::robot::PerBackbone;
use std::f64::consts::TAU;

const fn scale(name: &'static str) -> ParameterSpec {
    ParameterSpec { name, unit: "1", range: (-0.5, 0.5), typical: 0.03 }
}

const fn offset(name: &'static str) -> ParameterSpec {
    ParameterSpec { name, unit: "mm", range: (-2.0, 2.0), typical: 0.05 }
}

static SCALES: [ParameterSpec; 8] = [
    scale("scale_1"),
    scale("scale_2"),
    scale("scale_3"),
    scale("scale_4"),
    scale("scale_5"),
    scale("scale_6"),
    scale("scale_7"),
    scale("scale_8"),
];

static OFFSETS: [ParameterSpec; 7] = [
    offset("offset_1_mm"),
    offset("offset_2_mm"),
    offset("offset_3_mm"),
    offset("offset_4_mm"),
    offset("offset_5_mm"),
    offset("offset_6_mm"),
    offset("offset_7_mm"),
];

/// Each actuator's travel per count is off by its own share.
pub(super) static ACTUATOR_SCALE: Physics = Physics {
    name: "actuator_scale",
    form: "",
    equation: "q̃_i += k_i q̃_i",
    reading: "encoders that count too much or too little travel, each actuator by its own share",
    parameters: |backbones| &SCALES[..backbones],
    starts: &[&[]],
    acts: Acts::Actuator(|q, p| PerBackbone::from_fn(q.len(), |i| q[i] * p[i])),
    remembers: None,
};

/// Errors of the backbones of which the last is what makes their sum zero.
pub(super) fn summing_to_zero(p: &[f64]) -> PerBackbone {
    PerBackbone::from_fn(p.len() + 1, |i| p.get(i).copied().unwrap_or_else(|| -p.iter().sum::<f64>()))
}

/// Each actuator's zero is off. Their mean is λ itself, so the offsets sum to zero.
pub(super) static ACTUATOR_OFFSET: Physics = Physics {
    name: "actuator_offset",
    form: "",
    equation: "q̃_i += o_i, Σ o_i = 0 (their mean is λ)",
    reading: "actuators whose zeros differ from each other",
    parameters: |backbones| &OFFSETS[..backbones - 1],
    starts: &[&[]],
    acts: Acts::Actuator(|_, p| summing_to_zero(p)),
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
    parameters: fn(usize) -> &'static [ParameterSpec],
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

static ONE_PHASE: [ParameterSpec; 3] = [AMPLITUDE, PITCH, phase("phase_deg")];
static PHASES: [ParameterSpec; 10] = [
    AMPLITUDE,
    PITCH,
    phase("phase_1_deg"),
    phase("phase_2_deg"),
    phase("phase_3_deg"),
    phase("phase_4_deg"),
    phase("phase_5_deg"),
    phase("phase_6_deg"),
    phase("phase_7_deg"),
    phase("phase_8_deg"),
];

/// A sin(2π x_i / p + φ_i), with one phase for all or one each.
fn wave(x: &PerBackbone, p: &[f64]) -> PerBackbone {
    PerBackbone::from_fn(x.len(), |i| {
        let phase_deg = if p.len() == 3 { p[2] } else { p[2 + i] };
        p[0] * (TAU * x[i] / p[1] + phase_deg.to_radians()).sin()
    })
}

/// The lead screws' error, periodic in what their encoders read.
pub(super) static SCREW_PERIODIC: Physics =
    screw("", "q̃_i += A sin(2π q̃_i / p + φ)", |_| &ONE_PHASE, Acts::Actuator(wave));

/// The same, each screw with its own phase.
pub(super) static SCREW_PHASES: Physics =
    screw("own phases", "q̃_i += A sin(2π q̃_i / p + φ_i)", |backbones| &PHASES[..2 + backbones], Acts::Actuator(wave));

/// The same, periodic in what the nuts travel.
pub(super) static SCREW_TRAVEL: Physics =
    screw("travel", "q̃_i += A sin(2π (q_i + ε_i) / p + φ)", |_| &ONE_PHASE, Acts::Line(|at, p| wave(&at.line_mm, p)));

/// The same, each screw with its own phase.
pub(super) static SCREW_TRAVEL_PHASES: Physics = screw(
    "travel, own phases",
    "q̃_i += A sin(2π (q_i + ε_i) / p + φ_i)",
    |backbones| &PHASES[..2 + backbones],
    Acts::Line(|at, p| wave(&at.line_mm, p)),
);
