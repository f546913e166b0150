//! Friction that is spread over the travel: a reversal turns it round bit by bit, and not in one play.
//!
//! Along a sheath each piece of a line begins to slide at another travel. A density of plays (Prandtl and Ishlinskii) and a rate equation
//! (Bouc and Wen) are two descriptions of it: after a reversal the first follows a parabola and comes to an end, the second an
//! exponential that never quite does. Both act either on the bend as a whole or on each backbone by itself.

use super::physics::{Changes, FREQUENT, Instant, LINEAR, ParameterSpec, Physics, Role, Starts};
use crate::robot::PerBackbone;
use crate::robot::history::{BendPlayOf, DISTRIBUTED_PLAYS, Play, PlayOf, distributed_half_widths_mm};
use nalgebra::Vector2;

/// Half the gap between both ways once all slides.
const HALF_GAP: ParameterSpec = ParameterSpec::positive("half_gap_mm", "mm", (0.0, 20.0), 0.05);

/// A travel that shapes the loop.
const fn travel(name: &'static str) -> ParameterSpec {
    let role = Role::Shape { example: 0.4, drawn: (0.3, 1.0) };
    ParameterSpec { name, unit: "mm", range: (0.02, 40.0), typical: 0.1, role }
}

/// Each about four times the one before, and as many travels for each half gap as differ from a single play.
const LOOPS: Starts = Starts::At(&[&[0.06, 0.25], &[0.06, 1.0], &[0.25, 1.0], &[1.0, 4.0]]);

/// What the mean of the plays is multiplied by, so that all of them at their ends make the half gap.
fn share(p: &[f64]) -> f64 {
    // Evenly spread widths are half the widest on average.
    2.0 * p[0] / (p[1] * DISTRIBUTED_PLAYS as f64)
}

/// What the forms have in common.
const DISTRIBUTED: Physics = Physics {
    log_prior: FREQUENT,
    name: "distributed_friction",
    reading: "friction that is spread along the lines: after a reversal one part after another slides the other way",
    parameters: |_| const { &[HALF_GAP, travel("widest_mm")] },
    starts: LOOPS,
    ..LINEAR
};

/// On the bend as a whole.
pub(super) static DISTRIBUTED_FRICTION: Physics = Physics {
    equation: "ε += (2a/w) Q ⟨x⟩, x follows the bend vector within disks whose radii are spread evenly up to w / r (Prandtl–Ishlinskii)",
    changes: Changes::Line(|at, p| {
        let plays = &at.arrival.hysteresis.bend_play[BendPlayOf::Distributed as usize..];
        at.snake.q_by_bend() * (plays.iter().sum::<Vector2<f64>>() * share(p))
    }),
    history: Some(|history, p| {
        let plays = &mut history.half_bend_plays_mm[BendPlayOf::Distributed as usize..];
        plays.iter_mut().zip(distributed_half_widths_mm(p[1])).for_each(|(play, half)| *play = Some(half));
    }),
    ..DISTRIBUTED
};

/// On each backbone by itself.
pub(super) static DISTRIBUTED_PER_BACKBONE: Physics = Physics {
    form: "per backbone",
    equation: "ε_i += (2a/w) ⟨x_i⟩, x_i follows q_i within half widths that are spread evenly up to w (Prandtl–Ishlinskii)",
    changes: Changes::Line(|at, p| {
        let plays = &at.arrival.hysteresis.play_mm[PlayOf::Distributed as usize..][..DISTRIBUTED_PLAYS];
        plays.iter().fold(at.q_mm * 0.0, |sum, play| sum + *play) * share(p)
    }),
    history: Some(|history, p| {
        let plays = &mut history.plays[PlayOf::Distributed as usize..][..DISTRIBUTED_PLAYS];
        let widths = distributed_half_widths_mm(p[1]).into_iter();
        plays.iter_mut().zip(widths).for_each(|(play, half_mm)| *play = Some(Play { half_mm, half_mm_per_n: 0.0 }));
    }),
    ..DISTRIBUTED
};

/// What the forms have in common.
const RATE_EQUATION: Physics = Physics {
    log_prior: FREQUENT,
    name: "bouc_wen",
    reading: "friction that turns round gradually after a reversal, the more slowly the further it has turned",
    parameters: |_| const { &[HALF_GAP, travel("travel_mm")] },
    starts: LOOPS,
    ..LINEAR
};

/// On the bend as a whole.
pub(super) static BOUC_WEN: Physics = Physics {
    equation: "ε += (a/r) Q z, u ż = r (ḃ − z |ḃ|), b the bend vector (Bouc–Wen, n = 1, β = γ)",
    changes: Changes::Line(|at, p| {
        at.snake.q_by_bend() * (at.arrival.hysteresis.bend_bouc_wen * (p[0] / radius_mm(at)))
    }),
    history: Some(|history, p| history.bend_bouc_wen_travel_mm = Some(p[1])),
    ..RATE_EQUATION
};

/// On each backbone by itself.
pub(super) static BOUC_WEN_PER_BACKBONE: Physics = Physics {
    form: "per backbone",
    equation: "ε_i += a z_i, u ż_i = q̇_i − z_i |q̇_i| (Bouc–Wen, n = 1, β = γ)",
    changes: Changes::Line(|at, p| at.arrival.hysteresis.bouc_wen * p[0]),
    history: Some(|history, p| history.bouc_wen_travel_mm = Some(p[1])),
    ..RATE_EQUATION
};

/// r, mm: the mean radius, as an error of one backbone's leaves the friction what it is.
fn radius_mm(at: &Instant) -> f64 {
    let radii: &PerBackbone = &at.snake.radii_mm;
    radii.sum() / radii.len() as f64
}
