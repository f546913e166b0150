//! Play and friction: what depends on the load's direction or the motion's.

use super::physics::{Changes, FREQUENT, Instant, LINEAR, ParameterSpec, Physics, Role, Starts, per_backbone};
use crate::robot::PerBackbone;
use crate::robot::history::{BendPlayOf, Play, PlayOf};
use std::f64::consts::FRAC_2_PI;

/// The force over which a sign changes smoothly, N (design.md, section 5).
///
/// Convention: the equations of these effects are defined with it.
const SIGN_WIDTH_N: f64 = 0.3;

/// The sign of a force, smooth through zero.
fn smooth_sign(force_n: f64) -> f64 {
    (force_n / SIGN_WIDTH_N).tanh()
}

const PLAY: ParameterSpec = ParameterSpec::positive("play_mm", "mm", (-1.0, 1.0), 0.05);
const WIDTH: ParameterSpec = ParameterSpec {
    name: "width_n",
    unit: "N",
    range: (0.02, 2.0),
    typical: 0.1,
    role: Role::Shape { example: SIGN_WIDTH_N, drawn: (0.1, 0.6) },
};

/// Play that the load takes up: each backbone's line sits at the end of its play that its force presses it to.
const LOAD_DIRECTED: Physics = Physics {
    log_prior: FREQUENT,
    name: "load_directed_backlash",
    equation: "ε_i += a tanh(τ_i / 0.3 N)",
    reading: "play in the actuators that is taken up in the direction of each backbone's load",
    parameters: |_| const { &[PLAY] },
    changes: Changes::Line(|at, p| at.tau_n.map(|tau| p[0] * smooth_sign(tau))),
    ..LINEAR
};

/// The form with the design's width.
pub(super) static LOAD_DIRECTED_BACKLASH: Physics = LOAD_DIRECTED;

/// The same, over a width of its own.
pub(super) static LOAD_DIRECTED_WIDTH: Physics = Physics {
    form: "own width",
    equation: "ε_i += a tanh(τ_i / w)",
    parameters: |_| const { &[PLAY, WIDTH] },
    starts: Starts::At(&[&[0.05, SIGN_WIDTH_N]]),
    changes: Changes::Line(|at, p| at.tau_n.map(|tau| p[0] * (tau / p[1]).tanh())),
    ..LOAD_DIRECTED
};

/// The same, taken up ever more slowly.
pub(super) static LOAD_DIRECTED_GRADUAL: Physics = Physics {
    form: "gradual",
    equation: "ε_i += a (2/π) arctan(τ_i / w)",
    parameters: |_| const { &[PLAY, WIDTH] },
    starts: Starts::At(&[&[0.05, SIGN_WIDTH_N]]),
    changes: Changes::Line(|at, p| at.tau_n.map(|tau| p[0] * FRAC_2_PI * (tau / p[1]).atan())),
    ..LOAD_DIRECTED
};

/// Play that the motion takes up. s_i is the direction in which q_i last moved.
const MOTION_DIRECTED: Physics = Physics {
    log_prior: FREQUENT,
    name: "motion_directed_backlash",
    equation: "ε_i += a s_i, s_i = ±1 the direction in which q_i last moved",
    reading: "play in the actuators that is crossed whenever a backbone reverses; half the gap at a reversal",
    parameters: |_| const { &[ParameterSpec::positive("half_gap_mm", "mm", (-1.0, 1.0), 0.05)] },
    changes: Changes::Line(|at, p| at.motion.direction * p[0]),
    history: Some(|history, _| history.direction = true),
    ..LINEAR
};

/// The form that is crossed at once.
pub(super) static MOTION_DIRECTED_BACKLASH: Physics = MOTION_DIRECTED;

/// The same play, crossed by the backbone's own travel: ε follows q until the play is taken up.
pub(super) static MOTION_DIRECTED_PLAY: Physics = Physics {
    form: "crossed by travel",
    equation: "ε_i += x_i, x_i follows q_i between −a and a",
    reading: "play in the actuators that a backbone has to travel through whenever it reverses",
    parameters: |_| const { &[HALF_GAP] },
    starts: GAPS,
    changes: Changes::Line(|at, _| at.arrival.hysteresis.play_mm[PlayOf::Actuator as usize]),
    history: Some(|history, p| {
        history.plays[PlayOf::Actuator as usize] = Some(Play { half_mm: p[0], half_mm_per_n: 0.0 });
    }),
    ..MOTION_DIRECTED
};

/// Half the width of a play, up to the whole travel of such robots.
const HALF_GAP: ParameterSpec = ParameterSpec::positive("half_gap_mm", "mm", (0.0, 20.0), 0.05);

/// Each about four times the one before: the fit finds its way within a factor of two.
const GAPS: Starts = Starts::At(&[&[0.06], &[0.25], &[1.0], &[4.0]]);

/// Play between the lines and the bend as a whole, which the bend vector has to cross whichever way it turns.
pub(super) static PLAY_AT_BEND: Physics = Physics {
    log_prior: FREQUENT,
    name: "play_at_bend",
    equation: "ε += Q x, x follows the bend vector within a disk of radius a / r",
    reading: "play between the lines and the bend, which the bend lags behind by whenever it turns",
    parameters: |_| const { &[HALF_GAP] },
    starts: GAPS,
    changes: Changes::Line(|at, _| at.snake.q_by_bend() * at.arrival.hysteresis.bend_play[BendPlayOf::Bend as usize]),
    history: Some(|history, p| history.half_bend_plays_mm[BendPlayOf::Bend as usize] = Some(p[0])),
    ..LINEAR
};

/// Play that grows with the load: what friction along a bent sheath holds back, by the capstan's law, is a share of the force.
pub(super) static CAPSTAN_PLAY: Physics = Physics {
    log_prior: FREQUENT,
    name: "capstan_play",
    equation: "ε_i += x_i, x_i follows q_i between −w_i and w_i, w_i = b |τ_i|",
    reading: "sheath friction: a play that a backbone has to travel through whenever it reverses, and that grows with its load",
    parameters: |_| const { &[ParameterSpec::positive("half_gap_mm_per_n", "mm/N", (0.0, 10.0), 0.01)] },
    starts: Starts::At(&[&[0.001], &[0.003], &[0.01], &[0.03], &[0.1], &[0.5]]),
    changes: Changes::Line(|at, _| at.arrival.hysteresis.play_mm[PlayOf::Sheath as usize]),
    history: Some(|history, p| {
        history.plays[PlayOf::Sheath as usize] = Some(Play { half_mm: 0.0, half_mm_per_n: p[0] });
    }),
    ..LINEAR
};

/// The travel over which slack and dead bands change smoothly, mm.
///
/// Convention: the equations of these effects are defined with it.
const SMOOTH_TRAVEL_MM: f64 = 0.05;

const fn slack(name: &'static str) -> ParameterSpec {
    ParameterSpec::positive(name, "mm", (0.0, 10.0), 0.05)
}

static SLACKS: [ParameterSpec; 8] = per_backbone!(slack, "slack_", "_mm");
static DEAD_BANDS: [ParameterSpec; 8] = per_backbone!(slack, "dead_band_", "_mm");

/// Lines that only pull: the first part of each pull takes up slack. The same slack s in all lines is λ − s/2 and a dead band of s/2 in each.
pub(super) static TENDON_SLACK: Physics = Physics {
    log_prior: FREQUENT,
    name: "tendon_slack",
    equation: "ε_i −= s_i (1 − tanh(q_i / 0.05 mm)) / 2",
    reading: "slack in the lines, which the first part of a pull takes up without effect",
    parameters: |backbones| &SLACKS[..backbones],
    changes: Changes::Line(|at, p| {
        PerBackbone::from_fn(p.len(), |i| -0.5 * p[i] * (1.0 - (at.q_mm[i] / SMOOTH_TRAVEL_MM).tanh()))
    }),
    ..LINEAR
};

/// A part of the travel on either side of rest that moves nothing. The same band in all actuators is one backlash that the load takes up.
pub(super) static DEAD_BAND: Physics = Physics {
    log_prior: FREQUENT,
    name: "dead_band",
    equation: "ε_i += d_i tanh(q_i / 0.05 mm)",
    reading: "a dead band in each actuator on either side of rest, in which its travel moves nothing",
    parameters: |backbones| &DEAD_BANDS[..backbones],
    changes: Changes::Line(|at, p| PerBackbone::from_fn(p.len(), |i| p[i] * (at.q_mm[i] / SMOOTH_TRAVEL_MM).tanh())),
    ..LINEAR
};

/// Friction in the disks' holes: a share of the backbone's own force, against the motion.
pub(super) static DISC_FRICTION: Physics = Physics {
    log_prior: FREQUENT,
    name: "disc_friction",
    equation: "ε_i += κ c |τ_i| s_i",
    reading: "friction between backbones and disks: a share of each backbone's force, always against its motion",
    parameters: |_| const { &[ParameterSpec::positive("coefficient", "1", (-2.0, 2.0), 0.05)] },
    changes: Changes::Line(|at, p| {
        at.tau_n.map(f64::abs).component_mul(&at.motion.direction) * (p[0] * at.line.compliance_mm_per_n)
    }),
    history: Some(|history, _| history.direction = true),
    ..LINEAR
};

/// What the forms have in common.
const CONE: Physics = Physics {
    log_prior: FREQUENT,
    name: "cone_friction_reversal",
    reading: "friction in the snake cone that turns round with the motion instead of always adding (w = 1: all of it)",
    parameters: |_| const { &[ParameterSpec::positive("share", "1", (-10.0, 20.0), 0.5)] },
    history: Some(|history, _| history.direction = true),
    ..LINEAR
};

/// What Eq. 16's cone adds with a capstan exponent and an f_s of each backbone's own, beyond what Eq. 18 adds, mm.
fn in_the_cone(at: &Instant, share: f64, own: impl Fn(usize) -> (f64, f64)) -> PerBackbone {
    let line = at.line;
    PerBackbone::from_fn(at.tau_n.len(), |i| {
        let force = line.eta * at.tau_n[i];
        let (exponent, static_force_n) = own(i);
        let paper = (force + line.static_force_n) * line.capstan_exponent.exp();
        share * line.cone_compliance_mm_per_n * (force * exponent.exp() + static_force_n - paper)
    })
}

/// Friction in the cone turns round with the motion: where τ_i and the motion agree the actuator pushes harder than the
/// backbone by the capstan factor, where they differ it pushes less; f_s acts against the motion.
pub(super) static CONE_FRICTION_REVERSAL: Physics = Physics {
    equation: "ε_i += w K_c⁻¹ [(η τ_i + s_i f_s) e^{2μφ s_i sign τ_i} − (η τ_i + f_s) e^{2μφ}]",
    changes: Changes::Line(|at, p| {
        in_the_cone(at, p[0], |i| {
            let along = at.motion.direction[i];
            let exponent = at.line.capstan_exponent * along * smooth_sign(at.tau_n[i]);
            (exponent, along * at.line.static_force_n * exponent.exp())
        })
    }),
    ..CONE
};

/// The same, with f_s magnified by the paper's capstan factor whatever the motion.
pub(super) static CONE_FRICTION_STATIC: Physics = Physics {
    form: "static part as in Eq. 13",
    equation: "ε_i += w K_c⁻¹ [η τ_i e^{2μφ s_i sign τ_i} + s_i f_s e^{2μφ} − (η τ_i + f_s) e^{2μφ}]",
    changes: Changes::Line(|at, p| {
        in_the_cone(at, p[0], |i| {
            let (line, along) = (at.line, at.motion.direction[i]);
            let exponent = line.capstan_exponent * along * smooth_sign(at.tau_n[i]);
            (exponent, along * line.static_force_n * line.capstan_exponent.exp())
        })
    }),
    ..CONE
};

/// The same, with a capstan factor that follows the motion alone, whatever the load.
pub(super) static CONE_FRICTION_MOTION: Physics = Physics {
    form: "by motion alone",
    equation: "ε_i += w K_c⁻¹ [(η τ_i + s_i f_s) e^{2μφ s_i} − (η τ_i + f_s) e^{2μφ}]",
    changes: Changes::Line(|at, p| {
        in_the_cone(at, p[0], |i| {
            let along = at.motion.direction[i];
            let exponent = at.line.capstan_exponent * along;
            (exponent, along * at.line.static_force_n * exponent.exp())
        })
    }),
    ..CONE
};
