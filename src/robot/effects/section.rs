//! Neighbouring sections: what their motion does to this section's lines.

use super::physics::{Changes, FREQUENT, LINEAR, ParameterSpec, Physics};
use nalgebra::Vector2;

const fn share(name: &'static str) -> ParameterSpec {
    ParameterSpec::size(name, "1", 3.0, 0.05)
}

static SHARES: [ParameterSpec; 4] = [share("n1_along"), share("n1_across"), share("n2_along"), share("n2_across")];

/// c u + d ẑ × u for a neighbour's bend u, mm.
fn led(bend_mm: Vector2<f64>, shares: &[f64]) -> Vector2<f64> {
    bend_mm * shares[0] + Vector2::new(-bend_mm.y, bend_mm.x) * shares[1]
}

/// Sections that share lines, or whose lines run through each other, bend along with each other.
///
/// To first order a displacement of the lines and a moment on the section do the same to q̃, through geometry or through the lines' stretch, so
/// that there is one form of it for each neighbour. The map of the bends is a scaled rotation, the only one that prefers no azimuth: the
/// rotation is the angle between the sections' first backbones, and a twist.
pub(super) static SECTION_COUPLING: Physics = Physics {
    log_prior: FREQUENT,
    name: "section_coupling",
    equation: "q̃_i −= (c u + d ẑ × u)·(cos a_i, sin a_i), u = −(2/n) Σ_j q̃_j (cos a_j, sin a_j) of the neighbour's n backbones",
    reading: "lines that are led along where a neighbouring section bends",
    parameters: |_| &SHARES[..2],
    changes: Changes::Neighbours(|bends_mm, p| led(bends_mm[0], p)),
    follows_neighbour: [true, false],
    ..LINEAR
};

/// The same of the second neighbour alone.
pub(super) static SECTION_COUPLING_SECOND: Physics = Physics {
    form: "second neighbour",
    equation: "the same with u of the second neighbour",
    parameters: |_| &SHARES[2..],
    changes: Changes::Neighbours(|bends_mm, p| led(bends_mm[1], p)),
    follows_neighbour: [false, true],
    ..SECTION_COUPLING
};

/// The same of both.
pub(super) static SECTION_COUPLING_BOTH: Physics = Physics {
    form: "both neighbours",
    equation: "the sum of both",
    parameters: |_| &SHARES,
    changes: Changes::Neighbours(|bends_mm, p| led(bends_mm[0], &p[..2]) + led(bends_mm[1], &p[2..])),
    follows_neighbour: [true, true],
    ..SECTION_COUPLING
};
