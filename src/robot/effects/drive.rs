//! The drive: backlash and friction on the side of the motors, and the gain of a command (see [`Drive`](crate::robot::drive::Drive)).

use super::physics::{Changes, Confounded, FREQUENT, LINEAR, OPEN, ParameterSpec, Physics, Poses, Role, Starts, USUAL};
use nalgebra::Vector2;

/// Half the width of a backlash, up to the whole travel of such robots.
const HALF_GAP: ParameterSpec = ParameterSpec::positive("half_gap_mm", "mm", (0.0, 20.0), 0.05);

/// What the forms of a backlash have in common.
const OF_THE_DRIVE: Physics = Physics {
    log_prior: USUAL,
    name: "backlash",
    reading: "backlash in the drive: whenever the motors reverse, they turn through it while nothing behind it moves",
    parameters: |_| const { &[HALF_GAP] },
    starts: Starts::At(&[&[0.06], &[0.25], &[1.0], &[4.0]]),
    history: Some(|history, _| history.drive = true),
    ..LINEAR
};

/// Of the bend as a whole.
pub(super) static BACKLASH: Physics = Physics {
    equation: "y ← u + (y − u) min(1, w / |y − u|), w = a / r: the lines bend by y where the readings command u",
    changes: Changes::Drive(|drive, p| drive.bend_half_mm += p[0]),
    ..OF_THE_DRIVE
};

/// Of each backbone by itself.
pub(super) static BACKLASH_PER_BACKBONE: Physics = Physics {
    form: "per backbone",
    equation: "y_i ← clamp(y_i, q̃_i − a, q̃_i + a), the lines travel y_i",
    changes: Changes::Drive(|drive, p| drive.backbone_half_mm += p[0]),
    ..OF_THE_DRIVE
};

const GROWTH: ParameterSpec = ParameterSpec {
    name: "growth_per_rad",
    unit: "1/rad",
    range: (0.0, 10.0),
    typical: 0.2,
    role: Role::Shape { example: 1.0, drawn: (0.5, 2.0) },
};

/// Of the bend, and wider the further the snake is bent: by the capstan's law a bent sheath holds back a share of the force.
pub(super) static BACKLASH_GROWING: Physics = Physics {
    log_prior: FREQUENT,
    form: "grows with the bend",
    equation: "the same with w = (a / r) (1 + g |y|)",
    parameters: |_| const { &[HALF_GAP, GROWTH] },
    starts: Starts::At(&[&[0.06, 1.0], &[0.25, 1.0], &[1.0, 1.0], &[4.0, 1.0]]),
    changes: Changes::Drive(|drive, p| (drive.bend_half_mm, drive.growth_per_rad) = (p[0], p[1])),
    ..OF_THE_DRIVE
};

/// Where a straight snake at rest stands in its backlash, from the middle, in half widths. Two parts of 0.7 lie within the end.
const AT_REST: [ParameterSpec; 2] = {
    const fn along(name: &'static str) -> ParameterSpec {
        let role = Role::Shape { example: 0.4, drawn: (0.2, 0.6) };
        ParameterSpec { name, unit: "1", range: (-0.7, 0.7), typical: 0.1, role }
    }
    [along("at_rest_x"), along("at_rest_y")]
};

/// Of the bend, and wider to one side of a straight snake at rest than to the other: one cable has more slack than the one against it. A log of
/// few cycles shows it as a bend at rest, but for its start, which it then contradicts.
pub(super) static BACKLASH_UNEVEN: Physics = Physics {
    log_prior: FREQUENT,
    form: "wider to one side",
    equation: "y follows only as far as |u − y + w s| ≤ w asks, w = a / r, from y = 0 at u = 0",
    parameters: |_| const { &[HALF_GAP, AT_REST[0], AT_REST[1]] },
    includes: &["rest_bend"],
    starts: Starts::At(&[
        &[0.25, 0.4, 0.0],
        &[1.0, 0.4, 0.0],
        &[0.25, -0.4, 0.0],
        &[1.0, -0.4, 0.0],
        &[0.25, 0.0, 0.4],
        &[1.0, 0.0, 0.4],
        &[0.25, 0.0, -0.4],
        &[1.0, 0.0, -0.4],
    ]),
    changes: Changes::Drive(|drive, p| (drive.bend_half_mm, drive.at_rest) = (p[0], Vector2::new(p[1], p[2]))),
    ..OF_THE_DRIVE
};

const SPREAD: ParameterSpec = ParameterSpec {
    name: "spread",
    unit: "1",
    range: (0.0, 1.0),
    typical: 0.1,
    role: Role::Shape { example: 0.6, drawn: (0.3, 0.9) },
};

/// Of the bend, in several places: the lines follow through plays whose widths differ.
pub(super) static BACKLASH_SPREAD: Physics = Physics {
    log_prior: FREQUENT,
    form: "spread widths",
    equation: "the mean of the same over widths that are spread evenly from (1 − s) a to (1 + s) a",
    parameters: |_| const { &[HALF_GAP, SPREAD] },
    starts: Starts::At(&[&[0.06, 0.6], &[0.25, 0.6], &[1.0, 0.6], &[4.0, 0.6]]),
    changes: Changes::Drive(|drive, p| (drive.bend_half_mm, drive.spread) = (p[0], p[1])),
    ..OF_THE_DRIVE
};

const TRAVEL: ParameterSpec = ParameterSpec {
    name: "travel_mm",
    unit: "mm",
    range: (0.02, 40.0),
    typical: 0.1,
    role: Role::Shape { example: 0.4, drawn: (0.3, 1.0) },
};

/// A friction that turns round gradually as the command moves on: its loop begins at a reversal with the whole of the gap's slope, which a
/// backlash does not have, and never quite ends.
pub(super) static FRICTION_OF_THE_COMMAND: Physics = Physics {
    log_prior: FREQUENT,
    name: "bouc_wen",
    form: "of the command",
    reading: "friction that turns round gradually after a reversal, the more slowly the further it has turned",
    equation: "y = u − (a/r) z, u_0 ż = r (u̇ − z |u̇|): the lines bend by y where the readings command u (Bouc–Wen, n = 1, β = γ)",
    parameters: |_| const { &[HALF_GAP, TRAVEL] },
    starts: Starts::At(&[&[0.06, 0.25], &[0.25, 1.0], &[1.0, 4.0]]),
    changes: Changes::Drive(|drive, p| (drive.friction_half_mm, drive.friction_travel_mm) = (p[0], p[1])),
    ..OF_THE_DRIVE
};

const GAIN: ParameterSpec = ParameterSpec {
    name: "gain_less_1",
    unit: "1",
    range: (-0.9, 20.0),
    typical: 0.03,
    role: Role::Size { either_sign: true },
};

/// The command is in other units than the model's: every linear conversion of a laboratory's own is a gain. η is nearly another name of it, but
/// stays above zero.
pub(super) static COMMAND_GAIN: Physics = Physics {
    log_prior: OPEN,
    name: "command_gain",
    equation: "the lines bend by g u where the readings command u, g = 1 + gain_less_1",
    reading: "a gain between what is commanded and what the lines travel",
    parameters: |_| const { &[GAIN] },
    changes: Changes::Drive(|drive, p| drive.gain += p[0]),
    confounded_with: &[Confounded { with: "eta", on: Poses::Any }],
    ..LINEAR
};
