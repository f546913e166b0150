//! The snake itself: its geometry, its stiffness, what hangs on it.

use super::{Acts, ParameterSpec, Physics};
use nalgebra::{Vector3, Vector6};

const fn force(name: &'static str) -> ParameterSpec {
    ParameterSpec { name, unit: "N", range: (-20.0, 20.0), typical: 0.3 }
}

const fn azimuth(name: &'static str) -> ParameterSpec {
    ParameterSpec { name, unit: "deg", range: (-30.0, 30.0), typical: 2.0 }
}

/// Super-elastic NiTi softens as its strain, and so θ, grows.
pub(super) static SUPERELASTIC_SOFTENING: Physics = Physics {
    name: "superelastic_softening",
    equation: "∇E → (1 − k θ²) ∇E",
    reading: "backbones that soften as they bend, as super-elastic NiTi does",
    parameters: &[ParameterSpec { name: "softening_per_rad2", unit: "1/rad²", range: (-0.5, 0.5), typical: 0.03 }],
    starts: &[&[0.0]],
    acts: Acts::Snake(|snake, p| snake.softening_per_rad2 += p[0]),
};

/// A dead force on the tip, constant in {b}.
pub(super) static TIP_LOAD: Physics = Physics {
    name: "tip_load",
    equation: "Qᵗτ = ∇E − J_xbᵗ (F, 0)",
    reading: "a force of constant size and direction that pulls at the tip",
    parameters: &[force("fx_n"), force("fy_n"), force("fz_n")],
    starts: &[&[0.0; 3]],
    acts: Acts::Snake(|snake, p| {
        let wrench = Vector6::new(p[0], p[1], p[2], 0.0, 0.0, 0.0);
        snake.wrench = Some(snake.wrench.unwrap_or_default() + wrench);
    }),
};

/// The circle of backbones has another radius than Table I says.
pub(super) static BACKBONE_RADIUS: Physics = Physics {
    name: "backbone_radius",
    equation: "r → r + Δr",
    reading: "backbones that lie on a larger or smaller circle than the model says",
    parameters: &[ParameterSpec { name: "radius_error_mm", unit: "mm", range: (-0.4, 0.4), typical: 0.04 }],
    starts: &[&[0.0]],
    acts: Acts::Snake(|snake, p| snake.radius_mm += p[0]),
};

/// Each backbone stands at another azimuth than −(i−1)β.
pub(super) static BACKBONE_AZIMUTH: Physics = Physics {
    name: "backbone_azimuth",
    equation: "a_i → −(i−1)β + Δa_i",
    reading: "backbones that are not 120° apart",
    parameters: &[azimuth("azimuth_error_1_deg"), azimuth("azimuth_error_2_deg"), azimuth("azimuth_error_3_deg")],
    starts: &[&[0.0; 3]],
    acts: Acts::Snake(|snake, p| snake.azimuths += Vector3::new(p[0], p[1], p[2]).map(f64::to_radians)),
};

/// The central backbone, and all that holds it, gives way under the sum of the forces.
pub(super) static PRIMARY_COMPRESSION: Physics = Physics {
    name: "primary_compression",
    equation: "ε_i += C Σ_j |τ_j|, the same for all i",
    reading: "a central backbone that is compressed by the sum of the forces on the others",
    parameters: &[ParameterSpec { name: "compliance_mm_per_n", unit: "mm/N", range: (-0.1, 0.1), typical: 0.002 }],
    starts: &[&[0.0]],
    acts: Acts::Line(|at, p| Vector3::repeat(p[0] * at.tau_n.lp_norm(1))),
};
