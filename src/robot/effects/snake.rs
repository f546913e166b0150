//! The snake itself: its geometry, its stiffness, what hangs on it.

use super::actuator::summing_to_zero;
use super::physics::{Changes, Confounded, EXPECTED, FREQUENT, LINEAR, ParameterSpec, Physics, Poses, per_backbone};
use crate::robot::PerBackbone;
use nalgebra::{Vector2, Vector3, Vector6};

/// The form of effects on the geometry that leaves the forces as they were. It contradicts virtual work, which ties q and τ to one
/// geometry, so that the data must ask for it.
const IN_Q_ALONE: Physics = Physics { form: "in Eq. 1 alone", prior_penalty: AGAINST_VIRTUAL_WORK, ..LINEAR };

/// What such a form must gain in Schwarz's criterion beyond the price of its parameters.
///
/// Convention: a prior is a choice; 12 is e^(12/2), odds of 400 to 1.
const AGAINST_VIRTUAL_WORK: f64 = 12.0;

const fn force(name: &'static str) -> ParameterSpec {
    ParameterSpec::size(name, "N", 20.0, 0.3)
}

const fn azimuth(name: &'static str) -> ParameterSpec {
    ParameterSpec::size(name, "deg", 30.0, 2.0)
}

static AZIMUTHS: [ParameterSpec; 8] = per_backbone!(azimuth, "azimuth_error_", "_deg");

const fn radius(name: &'static str) -> ParameterSpec {
    ParameterSpec::size(name, "mm", 0.4, 0.04)
}

/// Super-elastic NiTi softens as its strain, and so θ, grows.
pub(super) static SUPERELASTIC_SOFTENING: Physics = Physics {
    log_prior: FREQUENT,
    name: "superelastic_softening",
    equation: "∇E → (1 − k θ²) ∇E",
    reading: "backbones that soften as they bend, as super-elastic NiTi does",
    parameters: |_| const { &[ParameterSpec::positive("softening_per_rad2", "1/rad²", (0.0, 0.5), 0.03)] },
    changes: Changes::Snake(|snake, p| snake.softening_per_rad2 += p[0]),
    ..LINEAR
};

/// The opposite of softening: the snake grows stiffer as it bends.
pub(super) static CUBIC_STIFFNESS: Physics = Physics {
    log_prior: FREQUENT,
    name: "cubic_stiffness",
    equation: "∇E → (1 + k θ²) ∇E",
    reading: "a snake that grows stiffer as it bends",
    parameters: |_| const { &[ParameterSpec::positive("stiffening_per_rad2", "1/rad²", (0.0, 5.0), 0.03)] },
    changes: Changes::Snake(|snake, p| snake.softening_per_rad2 -= p[0]),
    ..LINEAR
};

const fn threefold(name: &'static str) -> ParameterSpec {
    ParameterSpec::size(name, "1/rad", 3.0, 0.1)
}

/// A stiffness that differs from one azimuth to another as three backbones do.
pub(super) static THREEFOLD_STIFFNESS: Physics = Physics {
    name: "threefold_stiffness",
    equation: "E += K/3 [a (x³ − 3xy²) + b (3x²y − y³)], (x, y) = θ (cos δ, sin δ), K the straight snake's stiffness",
    reading: "a stiffness that changes with the azimuth three times a turn",
    parameters: |_| const { &[threefold("a_per_rad"), threefold("b_per_rad")] },
    changes: Changes::Snake(|snake, p| snake.threefold_per_rad += Vector2::new(p[0], p[1])),
    ..LINEAR
};

const fn rest(name: &'static str) -> ParameterSpec {
    ParameterSpec::size(name, "deg", 45.0, 2.0)
}

/// The snake is bent where its lines are at zero.
pub(super) static REST_BEND: Physics = Physics {
    log_prior: EXPECTED,
    name: "rest_bend",
    equation: "q = Q (b − b_0), ∇E = ∇E(b − b_0)",
    reading: "a snake that is bent at rest",
    parameters: |_| const { &[rest("x_deg"), rest("y_deg")] },
    changes: Changes::Snake(|snake, p| snake.rest_bend += Vector2::new(p[0], p[1]).map(f64::to_radians)),
    ..LINEAR
};

const fn weight(name: &'static str) -> ParameterSpec {
    ParameterSpec::size(name, "N", 100.0, 0.6)
}

/// The weight of the snake, or another load of fixed direction that is spread along it.
pub(super) static DEAD_WEIGHT: Physics = Physics {
    log_prior: FREQUENT,
    name: "dead_weight",
    equation: "Qᵗτ = ∇E − (1/L) ∫ J_xb(s)ᵗ (W, 0) ds",
    reading: "a weight of constant direction that is spread along the snake",
    parameters: |_| const { &[weight("wx_n"), weight("wy_n"), weight("wz_n")] },
    changes: Changes::Snake(|snake, p| {
        snake.weight_n = Some(snake.weight_n.unwrap_or_default() + Vector3::new(p[0], p[1], p[2]));
    }),
    ..LINEAR
};

/// The central backbone gives way lengthwise to what the lines pull, and a shorter snake bends further.
pub(super) static BACKBONE_SHORTENING: Physics = Physics {
    log_prior: FREQUENT,
    name: "backbone_shortening",
    equation: "q̃_i −= k q̃_i Σ_j max(−q̃_j, 0)",
    reading: "a central backbone that shortens as the pulls add up, so that the same travel bends it further",
    parameters: |_| const { &[ParameterSpec::positive("shortening_per_mm", "1/mm", (-0.2, 0.2), 0.02)] },
    changes: Changes::Encoders(|q, p| *q * (-p[0] * q.map(|q| (-q).max(0.0)).sum())),
    ..LINEAR
};

/// A dead force on the tip, constant in {b}.
pub(super) static TIP_LOAD: Physics = Physics {
    log_prior: FREQUENT,
    name: super::TIP_LOAD,
    equation: "Qᵗτ = ∇E − J_xbᵗ (F, 0)",
    reading: "a force of constant size and direction that pulls at the tip",
    parameters: |_| const { &[force("fx_n"), force("fy_n"), force("fz_n")] },
    changes: Changes::Snake(|snake, p| {
        snake.add_wrench(Vector6::new(p[0], p[1], p[2], 0.0, 0.0, 0.0));
    }),
    ..LINEAR
};

const fn moment(name: &'static str) -> ParameterSpec {
    ParameterSpec::size(name, "N·mm", 200.0, 3.0)
}

/// A dead force and moment on the end disk, constant in {b}. It is given, not searched for: one more force explains as much as a moment.
pub(super) static TIP_WRENCH: Physics = Physics {
    name: super::TIP_LOAD,
    form: "with moment",
    equation: "Qᵗτ = ∇E − J_xbᵗ (F, M)",
    reading: "a force and a moment of constant size and direction at the tip",
    parameters: |_| {
        const { &[force("fx_n"), force("fy_n"), force("fz_n"), moment("mx_n_mm"), moment("my_n_mm"), moment("mz_n_mm")] }
    },
    changes: Changes::Snake(|snake, p| {
        snake.add_wrench(Vector6::new(p[0], p[1], p[2], p[3], p[4], p[5]));
    }),
    ..LINEAR
};

/// The circle of backbones has another radius than Table I says.
pub(super) static BACKBONE_RADIUS: Physics = Physics {
    name: "backbone_radius",
    form: "common",
    equation: "r → r + Δr",
    reading: "backbones that lie on a larger or smaller circle than the model says",
    parameters: |_| const { &[radius("radius_error_mm")] },
    changes: Changes::Snake(|snake, p| snake.radii_mm = snake.radii_mm.add_scalar(p[0])),
    confounded_with: &[Confounded { with: "eta", on: Poses::Any }],
    ..LINEAR
};

static RADII: [ParameterSpec; 8] = per_backbone!(radius, "radius_error_", "_mm");

/// Each backbone stands at its own radius. Their mean is all but η, so the errors sum to zero.
pub(super) static BACKBONE_RADII: Physics = Physics {
    name: "backbone_radius",
    equation: "r_i → r + Δr_i, Σ Δr_i = 0 (their mean is not told from η)",
    reading: "backbones that do not lie on one circle",
    parameters: |backbones| &RADII[..backbones - 1],
    changes: Changes::Snake(|snake, p| snake.radii_mm += summing_to_zero(p)),
    ..LINEAR
};

/// Each backbone stands at its own radius, so far off that their mean is told from η as well.
pub(super) static BACKBONE_RADII_AND_MEAN: Physics = Physics {
    name: "backbone_radius",
    form: "with their mean",
    equation: "r_i → r + Δr_i",
    reading: "backbones that do not lie on one circle",
    parameters: |backbones| &RADII[..backbones],
    changes: Changes::Snake(|snake, p| snake.radii_mm += PerBackbone::from_fn(p.len(), |i| p[i])),
    ..LINEAR
};

/// The same in Eq. 1 alone, as where the end disk's holes are off and the forces are not.
pub(super) static BACKBONE_RADII_IN_Q: Physics = Physics {
    name: "backbone_radius",
    equation: "q_i = −(r + Δr_i) θ cos δ_i with τ as without, Σ Δr_i = 0",
    reading: "backbones that do not lie on one circle",
    parameters: |backbones| &RADII[..backbones - 1],
    changes: Changes::Line(|at, p| summing_to_zero(p).component_mul(&at.q_mm).component_div(&at.snake.radii_mm)),
    ..IN_Q_ALONE
};

fn in_radians(angles_deg: &[f64]) -> PerBackbone {
    PerBackbone::from_fn(angles_deg.len(), |i| angles_deg[i].to_radians())
}

/// Each backbone stands at another azimuth than −(i−1)β.
pub(super) static BACKBONE_AZIMUTH: Physics = Physics {
    name: "backbone_azimuth",
    equation: "a_i → −(i−1)β + Δa_i",
    reading: "backbones that are not evenly spaced",
    parameters: |backbones| &AZIMUTHS[..backbones],
    changes: Changes::Snake(|snake, p| snake.turn_backbones(&in_radians(p))),
    ..LINEAR
};

/// The same in Eq. 1 alone.
pub(super) static BACKBONE_AZIMUTH_IN_Q: Physics = Physics {
    name: "backbone_azimuth",
    equation: "q_i = −r θ cos(δ_i − Δa_i) with τ as without",
    reading: "backbones that are not evenly spaced",
    parameters: |backbones| &AZIMUTHS[..backbones],
    changes: Changes::Line(|at, p| {
        let mut turned = at.snake.clone();
        turned.turn_backbones(&in_radians(p));
        turned.q_by_bend() * at.bend - at.q_mm
    }),
    ..IN_Q_ALONE
};

/// The central backbone, and all that holds it, gives way under the sum of the forces.
pub(super) static PRIMARY_COMPRESSION: Physics = Physics {
    name: "primary_compression",
    equation: "ε_i += C Σ_j |τ_j|, the same for all i",
    reading: "a central backbone that is compressed by the sum of the forces on the others",
    parameters: |_| const { &[ParameterSpec::positive("compliance_mm_per_n", "mm/N", (-0.1, 0.1), 0.002)] },
    changes: Changes::Line(|at, p| PerBackbone::repeat(at.tau_n.len(), p[0] * at.tau_n.map(f64::abs).sum())),
    confounded_with: &[Confounded { with: "actuator_scale", on: Poses::OnePlane }],
    ..LINEAR
};
