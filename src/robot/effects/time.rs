//! What depends on time and speed.

use super::{Acts, Instant, Memory, ParameterSpec, Physics};
use crate::robot::PerBackbone;

/// Everything warms up: a common drift.
pub(super) static THERMAL_DRIFT: Physics = Physics {
    name: "thermal_drift",
    form: "",
    equation: "ε_i += d t, the same for all i, t from the first reading",
    reading: "a slow drift that all backbones share, as of a machine that warms up",
    parameters: |_| const { &[ParameterSpec { name: "rate_mm_per_s", unit: "mm/s", range: (-0.1, 0.1), typical: 0.0005 }] },
    starts: &[&[0.0]],
    acts: Acts::Line(|at, p| PerBackbone::repeat(at.q_mm.len(), p[0] * at.motion.elapsed_s)),
    remembers: None,
};

const SHARE: ParameterSpec = ParameterSpec { name: "share", unit: "1", range: (-2.0, 2.0), typical: 0.05 };
const TIME_CONSTANT: ParameterSpec =
    ParameterSpec { name: "time_constant_s", unit: "s", range: (0.05, 1000.0), typical: 0.5 };
const SHORT_AND_LONG: &[&[f64]] = &[&[0.02, 0.5], &[0.02, 2.0], &[0.02, 8.0], &[0.02, 30.0], &[0.02, 120.0]];

const fn creep(
    form: &'static str,
    equation: &'static str,
    acts: Acts,
    remembers: Option<fn(&mut Memory, &[f64])>,
) -> Physics {
    Physics {
        name: "creep",
        form,
        equation,
        reading: "lines that go on stretching for a while under load",
        parameters: |_| const { &[SHARE, TIME_CONSTANT] },
        starts: SHORT_AND_LONG,
        acts,
        remembers,
    }
}

/// ε of a share of a load, mm.
fn stretch(at: &Instant, share: f64, load_n: PerBackbone) -> PerBackbone {
    load_n * (share * at.snake.line_compliance_mm_per_n)
}

/// The lines go on stretching for a while under load: a first-order lag beside the spring.
pub(super) static CREEP: Physics = creep(
    "",
    "ε_i += κ c x_i, T ẋ_i = τ_i − x_i, x = 0 at the first reading",
    Acts::Line(|at, p| stretch(at, p[0], at.motion.relaxed_n)),
    Some(|memory, p| memory.creep_s = Some(p[1])),
);

/// The same of a snake that was held before the first reading.
pub(super) static CREEP_SETTLED: Physics = creep(
    "settled before",
    "ε_i += κ c x_i, T ẋ_i = τ_i − x_i, x = τ at the first reading",
    Acts::Line(|at, p| stretch(at, p[0], at.motion.relaxed_n)),
    Some(|memory, p| (memory.creep_s, memory.settled) = (Some(p[1]), true)),
);

/// Lines that grow softer from the first reading on, towards an end.
pub(super) static CREEP_SOFTENING: Physics = creep(
    "from the first reading",
    "ε_i += κ c τ_i (1 − e^{−t/T}), t from the first reading",
    Acts::Line(|at, p| stretch(at, p[0] * (1.0 - (-at.motion.elapsed_s / p[1]).exp()), at.tau_n)),
    None,
);

/// Lines that grow softer from the first reading on, ever more slowly.
pub(super) static CREEP_LOGARITHMIC: Physics = creep(
    "logarithmic",
    "ε_i += κ c τ_i ln(1 + t/T), t from the first reading",
    Acts::Line(|at, p| stretch(at, p[0] * (at.motion.elapsed_s / p[1]).ln_1p(), at.tau_n)),
    None,
);

const fn drag(form: &'static str, equation: &'static str, acts: Acts) -> Physics {
    Physics {
        name: "viscous_drag",
        form,
        equation,
        reading: "a drag on the backbones that grows with their speed",
        parameters: |_| {
            const { &[ParameterSpec { name: "drag_n_s_per_mm", unit: "N·s/mm", range: (-200.0, 200.0), typical: 0.5 }] }
        },
        starts: &[&[0.0]],
        acts,
        remembers: Some(|memory, _| memory.speed = true),
    }
}

/// A drag on the backbones proportional to their speed.
pub(super) static VISCOUS_DRAG: Physics =
    drag("", "ε_i += κ c q̇_i", Acts::Line(|at, p| stretch(at, p[0], at.motion.speed_mm_per_s)));

/// The same of the speed with which the snake came, from the sample before.
pub(super) static VISCOUS_DRAG_BEFORE: Physics = drag(
    "speed since the sample before",
    "ε_i += κ c Δq_i / Δt, from the sample before",
    Acts::Line(|at, p| stretch(at, p[0], at.motion.speed_before_mm_per_s)),
);
