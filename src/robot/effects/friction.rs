//! Play and friction: what depends on the load's direction or the motion's.

use super::{Acts, Instant, ParameterSpec, Physics, smooth_sign};
use crate::robot::PerBackbone;
use std::f64::consts::FRAC_2_PI;

/// Play that the load takes up: each backbone's line sits at the end of its play that its force presses it to.
pub(super) static LOAD_DIRECTED_BACKLASH: Physics = Physics {
    name: "load_directed_backlash",
    form: "",
    equation: "ε_i += a tanh(τ_i / 0.3 N)",
    reading: "play in the actuators that is taken up in the direction of each backbone's load",
    parameters: |_| const { &[ParameterSpec { name: "play_mm", unit: "mm", range: (-1.0, 1.0), typical: 0.05 }] },
    starts: &[&[0.0]],
    acts: Acts::Line(|at, p| at.tau_n.map(|tau| p[0] * smooth_sign(tau))),
    remembers: None,
};

static PLAY_AND_WIDTH: [ParameterSpec; 2] = [
    ParameterSpec { name: "play_mm", unit: "mm", range: (-1.0, 1.0), typical: 0.05 },
    ParameterSpec { name: "width_n", unit: "N", range: (0.02, 2.0), typical: 0.1 },
];

const fn load_directed(form: &'static str, equation: &'static str, acts: Acts) -> Physics {
    Physics {
        name: "load_directed_backlash",
        form,
        equation,
        reading: "play in the actuators that is taken up in the direction of each backbone's load",
        parameters: |_| &PLAY_AND_WIDTH,
        starts: &[&[0.05, 0.3]],
        acts,
        remembers: None,
    }
}

/// The same, over a width of its own.
pub(super) static LOAD_DIRECTED_WIDTH: Physics = load_directed(
    "own width",
    "ε_i += a tanh(τ_i / w)",
    Acts::Line(|at, p| at.tau_n.map(|tau| p[0] * (tau / p[1]).tanh())),
);

/// The same, taken up ever more slowly.
pub(super) static LOAD_DIRECTED_GRADUAL: Physics = load_directed(
    "gradual",
    "ε_i += a (2/π) arctan(τ_i / w)",
    Acts::Line(|at, p| at.tau_n.map(|tau| p[0] * FRAC_2_PI * (tau / p[1]).atan())),
);

/// Play that the motion takes up. s_i is the direction in which q_i last moved.
pub(super) static MOTION_DIRECTED_BACKLASH: Physics = Physics {
    name: "motion_directed_backlash",
    form: "",
    equation: "ε_i += a s_i, s_i = ±1 the direction in which q_i last moved",
    reading: "play in the actuators that is crossed whenever a backbone reverses; half the gap at a reversal",
    parameters: |_| const { &[ParameterSpec { name: "half_gap_mm", unit: "mm", range: (-1.0, 1.0), typical: 0.05 }] },
    starts: &[&[0.0]],
    acts: Acts::Line(|at, p| at.motion.direction * p[0]),
    remembers: Some(|memory, _| memory.direction = true),
};

/// The same play, crossed by the backbone's own travel: ε follows q until the play is taken up.
pub(super) static MOTION_DIRECTED_PLAY: Physics = Physics {
    name: "motion_directed_backlash",
    form: "crossed by travel",
    equation: "ε_i += x_i, x_i follows q_i between −a and a",
    reading: "play in the actuators that a backbone has to travel through whenever it reverses",
    parameters: |_| const { &[ParameterSpec { name: "half_gap_mm", unit: "mm", range: (0.0, 1.0), typical: 0.05 }] },
    starts: &[&[0.06]],
    acts: Acts::Line(|at, _| at.motion.taken_up_mm),
    remembers: Some(|memory, p| memory.half_play_mm = Some(p[0])),
};

/// Friction in the disks' holes: a share of the backbone's own force, against the motion.
pub(super) static DISC_FRICTION: Physics = Physics {
    name: "disc_friction",
    form: "",
    equation: "ε_i += κ c |τ_i| s_i",
    reading: "friction between backbones and disks: a share of each backbone's force, always against its motion",
    parameters: |_| const { &[ParameterSpec { name: "coefficient", unit: "1", range: (-2.0, 2.0), typical: 0.05 }] },
    starts: &[&[0.0]],
    acts: Acts::Line(|at, p| {
        at.tau_n.map(f64::abs).component_mul(&at.motion.direction) * (p[0] * at.snake.line_compliance_mm_per_n)
    }),
    remembers: Some(|memory, _| memory.direction = true),
};

const fn cone(form: &'static str, equation: &'static str, acts: Acts) -> Physics {
    Physics {
        name: "cone_friction_reversal",
        form,
        equation,
        reading: "friction in the snake cone that turns round with the motion instead of always adding (w = 1: all of it)",
        parameters: |_| const { &[ParameterSpec { name: "share", unit: "1", range: (-10.0, 20.0), typical: 0.5 }] },
        starts: &[&[0.0]],
        acts,
        remembers: Some(|memory, _| memory.direction = true),
    }
}

/// What Eq. 16's cone adds with a capstan exponent and an f_s of each backbone's own, beyond what Eq. 18 adds, mm.
fn in_the_cone(at: &Instant, share: f64, own: impl Fn(usize) -> (f64, f64)) -> PerBackbone {
    let snake = at.snake;
    PerBackbone::from_fn(at.tau_n.len(), |i| {
        let force = snake.eta * at.tau_n[i];
        let (exponent, static_force_n) = own(i);
        let paper = (force + snake.static_force_n) * snake.capstan_exponent.exp();
        share * snake.cone_compliance_mm_per_n * (force * exponent.exp() + static_force_n - paper)
    })
}

/// Friction in the cone turns round with the motion: where τ_i and the motion agree the actuator pushes harder than the
/// backbone by the capstan factor, where they differ it pushes less; f_s acts against the motion.
pub(super) static CONE_FRICTION_REVERSAL: Physics = cone(
    "",
    "ε_i += w K_c⁻¹ [(η τ_i + s_i f_s) e^{2μφ s_i sign τ_i} − (η τ_i + f_s) e^{2μφ}]",
    Acts::Line(|at, p| {
        in_the_cone(at, p[0], |i| {
            let along = at.motion.direction[i];
            let exponent = at.snake.capstan_exponent * along * smooth_sign(at.tau_n[i]);
            (exponent, along * at.snake.static_force_n * exponent.exp())
        })
    }),
);

/// The same, with f_s magnified by the paper's capstan factor whatever the motion.
pub(super) static CONE_FRICTION_STATIC: Physics = cone(
    "static part as in Eq. 13",
    "ε_i += w K_c⁻¹ [η τ_i e^{2μφ s_i sign τ_i} + s_i f_s e^{2μφ} − (η τ_i + f_s) e^{2μφ}]",
    Acts::Line(|at, p| {
        in_the_cone(at, p[0], |i| {
            let (snake, along) = (at.snake, at.motion.direction[i]);
            let exponent = snake.capstan_exponent * along * smooth_sign(at.tau_n[i]);
            (exponent, along * snake.static_force_n * snake.capstan_exponent.exp())
        })
    }),
);

/// The same, with a capstan factor that follows the motion alone, whatever the load.
pub(super) static CONE_FRICTION_MOTION: Physics = cone(
    "by motion alone",
    "ε_i += w K_c⁻¹ [(η τ_i + s_i f_s) e^{2μφ s_i} − (η τ_i + f_s) e^{2μφ}]",
    Acts::Line(|at, p| {
        in_the_cone(at, p[0], |i| {
            let along = at.motion.direction[i];
            let exponent = at.snake.capstan_exponent * along;
            (exponent, along * at.snake.static_force_n * exponent.exp())
        })
    }),
);
