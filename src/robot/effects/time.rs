//! What depends on time and speed.

use super::physics::{Changes, Instant, LINEAR, ParameterSpec, Physics, Role, Starts};
use crate::robot::PerBackbone;

/// Everything warms up: a common drift.
pub(super) static THERMAL_DRIFT: Physics = Physics {
    name: "thermal_drift",
    equation: "ε_i += d t, the same for all i, t from the first reading",
    reading: "a slow drift that all backbones share, as of a machine that warms up",
    parameters: |_| const { &[ParameterSpec::size("rate_mm_per_s", "mm/s", 0.1, 0.0005)] },
    changes: Changes::Line(|at, p| PerBackbone::repeat(at.q_mm.len(), p[0] * at.motion.elapsed_s)),
    in_time: true,
    ..LINEAR
};

const SHARE: ParameterSpec = ParameterSpec::positive("share", "1", (-2.0, 2.0), 0.05);
const TIME_CONSTANT: ParameterSpec = ParameterSpec {
    name: "time_constant_s",
    unit: "s",
    range: (0.05, 1000.0),
    typical: 0.5,
    role: Role::Shape { example: 3.0, drawn: (1.0, 20.0) },
};

/// What the forms have in common.
const CREEPING: Physics = Physics {
    name: "creep",
    reading: "lines that go on stretching for a while under load",
    parameters: |_| const { &[SHARE, TIME_CONSTANT] },
    in_time: true,
    // Short to long, each about four times the one before: the fit finds its way within a factor of two.
    starts: Starts::At(&[&[0.02, 0.5], &[0.02, 2.0], &[0.02, 8.0], &[0.02, 30.0], &[0.02, 120.0]]),
    ..LINEAR
};

/// ε of a share of a load, mm.
fn stretch(at: &Instant, share: f64, load_n: PerBackbone) -> PerBackbone {
    load_n * (share * at.line.compliance_mm_per_n)
}

/// The lines go on stretching for a while under load: a first-order lag beside the spring.
pub(super) static CREEP: Physics = Physics {
    equation: "ε_i += κ c x_i, T ẋ_i = τ_i − x_i, x = 0 at the first reading",
    changes: Changes::Line(|at, p| stretch(at, p[0], at.arrival.crept_load_n)),
    history: Some(|history, p| history.creep_time_constant_s = Some(p[1])),
    ..CREEPING
};

/// The same of a snake that was held before the first reading.
pub(super) static CREEP_SETTLED: Physics = Physics {
    form: "settled before",
    equation: "ε_i += κ c x_i, T ẋ_i = τ_i − x_i, x = τ at the first reading",
    changes: Changes::Line(|at, p| stretch(at, p[0], at.arrival.crept_load_n)),
    history: Some(|history, p| {
        (history.creep_time_constant_s, history.creep_ended_before) = (Some(p[1]), true);
    }),
    ..CREEPING
};

/// Lines that grow softer from the first reading on, towards an end.
pub(super) static CREEP_SOFTENING: Physics = Physics {
    form: "from the first reading",
    equation: "ε_i += κ c τ_i (1 − e^{−t/T}), t from the first reading",
    changes: Changes::Line(|at, p| stretch(at, p[0] * (1.0 - (-at.motion.elapsed_s / p[1]).exp()), at.tau_n)),
    ..CREEPING
};

/// Lines that grow softer from the first reading on, ever more slowly.
pub(super) static CREEP_LOGARITHMIC: Physics = Physics {
    form: "logarithmic",
    equation: "ε_i += κ c τ_i ln(1 + t/T), t from the first reading",
    changes: Changes::Line(|at, p| stretch(at, p[0] * (at.motion.elapsed_s / p[1]).ln_1p(), at.tau_n)),
    ..CREEPING
};

/// A drag on the backbones proportional to their speed.
pub(super) static VISCOUS_DRAG: Physics = Physics {
    name: "viscous_drag",
    equation: "ε_i += κ c Δq_i / Δt, from the reading before",
    reading: "a drag on the backbones that grows with their speed",
    parameters: |_| const { &[ParameterSpec::positive("drag_n_s_per_mm", "N·s/mm", (-200.0, 200.0), 0.5)] },
    changes: Changes::Line(|at, p| stretch(at, p[0], at.arrival.speed_mm_per_s)),
    history: Some(|history, _| history.speed = true),
    ..LINEAR
};
