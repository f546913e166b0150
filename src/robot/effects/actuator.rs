//! The actuators and their encoders: errors that are a function of q̃ alone.

use super::physics::{Changes, Confounded, LINEAR, ParameterSpec, Phases, Physics, Poses, Role, Starts, per_backbone};
use crate::robot::PerBackbone;
use std::f64::consts::TAU;

const fn scale(name: &'static str) -> ParameterSpec {
    ParameterSpec::size(name, "1", 0.5, 0.03)
}

const fn offset(name: &'static str) -> ParameterSpec {
    ParameterSpec::size(name, "mm", 2.0, 0.05)
}

static SCALES: [ParameterSpec; 8] = per_backbone!(scale, "scale_", "");
static OFFSETS: [ParameterSpec; 8] = per_backbone!(offset, "offset_", "_mm");

/// Each actuator's travel per count is off by its own share.
pub(super) static ACTUATOR_SCALE: Physics = Physics {
    name: "actuator_scale",
    equation: "q̃_i += k_i q̃_i",
    reading: "encoders that count too much or too little travel, each actuator by its own share",
    parameters: |backbones| &SCALES[..backbones],
    changes: Changes::Encoders(|q, p| PerBackbone::from_fn(q.len(), |i| q[i] * p[i])),
    confounded_with: &[Confounded { with: "primary_compression", on: Poses::OnePlane }],
    ..LINEAR
};

/// Errors of the backbones of which the last is what makes their sum zero.
pub(super) fn summing_to_zero(p: &[f64]) -> PerBackbone {
    PerBackbone::from_fn(p.len() + 1, |i| p.get(i).copied().unwrap_or_else(|| -p.iter().sum::<f64>()))
}

/// Each actuator's zero is off. Their mean is λ itself, so the offsets sum to zero.
pub(super) static ACTUATOR_OFFSET: Physics = Physics {
    name: "actuator_offset",
    equation: "q̃_i += o_i, Σ o_i = 0 (their mean is λ)",
    reading: "actuators whose zeros differ from each other",
    parameters: |backbones| &OFFSETS[..backbones - 1],
    changes: Changes::Encoders(|_, p| summing_to_zero(p)),
    ..LINEAR
};

const AMPLITUDE: ParameterSpec = ParameterSpec::positive("amplitude_mm", "mm", (-0.5, 0.5), 0.03);
const PITCH: ParameterSpec = ParameterSpec {
    name: "pitch_mm",
    unit: "mm",
    range: (0.2, 6.0),
    typical: 0.1,
    role: Role::Shape { example: 1.0, drawn: (0.5, 2.0) },
};

const fn phase(name: &'static str) -> ParameterSpec {
    let role = Role::Shape { example: 30.0, drawn: (-180.0, 180.0) };
    ParameterSpec { name, unit: "deg", range: (-720.0, 720.0), typical: 30.0, role }
}

/// What the forms have in common. Beyond A = p / 2π the nut runs back while its screw turns.
const SCREW: Physics = Physics {
    name: "screw_periodic",
    reading: "a lead-screw error that repeats with the screw's pitch",
    largest_size: Some(|p| p[1] / TAU),
    ..LINEAR
};

static ONE_PHASE: [ParameterSpec; 3] = [AMPLITUDE, PITCH, phase("phase_deg")];
static PHASES: [ParameterSpec; 10] = per_backbone!([AMPLITUDE, PITCH,] phase, "phase_", "_deg");

/// A sin(2π x_i / p + φ_i).
fn wave(x_mm: &PerBackbone, p: &[f64], phase_deg: impl Fn(usize) -> f64) -> PerBackbone {
    PerBackbone::from_fn(x_mm.len(), |i| p[0] * (TAU * x_mm[i] / p[1] + phase_deg(i).to_radians()).sin())
}

/// The lead screws' error, periodic in what their encoders read.
pub(super) static SCREW_PERIODIC: Physics = Physics {
    equation: "q̃_i += A sin(2π q̃_i / p + φ)",
    parameters: |_| &ONE_PHASE,
    starts: Starts::Periodogram(Phases::Common),
    changes: Changes::Encoders(|q, p| wave(q, p, |_| p[2])),
    ..SCREW
};

/// The same, each screw with its own phase.
pub(super) static SCREW_PHASES: Physics = Physics {
    form: "own phases",
    equation: "q̃_i += A sin(2π q̃_i / p + φ_i)",
    parameters: |backbones| &PHASES[..2 + backbones],
    starts: Starts::Periodogram(Phases::PerBackbone),
    changes: Changes::Encoders(|q, p| wave(q, p, |i| p[2 + i])),
    ..SCREW
};

/// The same, periodic in what the nuts travel.
pub(super) static SCREW_TRAVEL: Physics = Physics {
    form: "travel",
    equation: "q̃_i += A sin(2π (q_i + ε_i) / p + φ)",
    parameters: |_| &ONE_PHASE,
    starts: Starts::Periodogram(Phases::Common),
    changes: Changes::Line(|at, p| wave(&at.line_mm, p, |_| p[2])),
    ..SCREW
};

/// The same, each screw with its own phase.
pub(super) static SCREW_TRAVEL_PHASES: Physics = Physics {
    form: "travel, own phases",
    equation: "q̃_i += A sin(2π (q_i + ε_i) / p + φ_i)",
    parameters: |backbones| &PHASES[..2 + backbones],
    starts: Starts::Periodogram(Phases::PerBackbone),
    changes: Changes::Line(|at, p| wave(&at.line_mm, p, |i| p[2 + i])),
    ..SCREW
};
