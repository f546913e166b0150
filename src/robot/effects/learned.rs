//! What no physics here explains, learned as it is: a smooth function of the bend.

use super::physics::{Changes, LINEAR, ParameterSpec, Physics, Role, Starts};
use crate::robot::PerBackbone;
use nalgebra::Vector2;

/// Functions of the bend for each backbone: powers up to the fourth, and the direction of motion times powers up to the first.
///
/// Convention: what the effect's equation is.
pub const TERMS: usize = 18;

const fn term(name: &'static str, unit: &'static str) -> ParameterSpec {
    ParameterSpec::size(name, unit, 50.0, 0.05)
}

const EDGE: ParameterSpec = ParameterSpec {
    name: "largest_theta_deg",
    unit: "deg",
    range: (1.0, 120.0),
    typical: 10.0,
    role: Role::Shape { example: 90.0, drawn: (60.0, 90.0) },
};

macro_rules! terms {
    ($backbone:literal) => {
        [
            term(concat!($backbone, "_1_mm"), "mm"),
            term(concat!($backbone, "_x_mm_per_rad"), "mm/rad"),
            term(concat!($backbone, "_y_mm_per_rad"), "mm/rad"),
            term(concat!($backbone, "_x2_mm_per_rad2"), "mm/rad²"),
            term(concat!($backbone, "_xy_mm_per_rad2"), "mm/rad²"),
            term(concat!($backbone, "_y2_mm_per_rad2"), "mm/rad²"),
            term(concat!($backbone, "_x3_mm_per_rad3"), "mm/rad³"),
            term(concat!($backbone, "_x2y_mm_per_rad3"), "mm/rad³"),
            term(concat!($backbone, "_xy2_mm_per_rad3"), "mm/rad³"),
            term(concat!($backbone, "_y3_mm_per_rad3"), "mm/rad³"),
            term(concat!($backbone, "_x4_mm_per_rad4"), "mm/rad⁴"),
            term(concat!($backbone, "_x3y_mm_per_rad4"), "mm/rad⁴"),
            term(concat!($backbone, "_x2y2_mm_per_rad4"), "mm/rad⁴"),
            term(concat!($backbone, "_xy3_mm_per_rad4"), "mm/rad⁴"),
            term(concat!($backbone, "_y4_mm_per_rad4"), "mm/rad⁴"),
            term(concat!($backbone, "_s_mm"), "mm"),
            term(concat!($backbone, "_sx_mm_per_rad"), "mm/rad"),
            term(concat!($backbone, "_sy_mm_per_rad"), "mm/rad"),
        ]
    };
}

/// The edge, then the terms of backbone 1, of backbone 2, ...
static PARAMETERS: [ParameterSpec; 1 + 8 * TERMS] = {
    let backbones = [
        terms!("backbone_1"),
        terms!("backbone_2"),
        terms!("backbone_3"),
        terms!("backbone_4"),
        terms!("backbone_5"),
        terms!("backbone_6"),
        terms!("backbone_7"),
        terms!("backbone_8"),
    ];
    let mut all = [EDGE; 1 + 8 * TERMS];
    let mut k = 0;
    while k < 8 * TERMS {
        all[1 + k] = backbones[k / TERMS][k % TERMS];
        k += 1;
    }
    all
};

/// A smooth correction learned from a gap that no effect of the library explains. It is never searched for nor fitted again:
/// a model that has it keeps it.
pub static LEARNED_CORRECTION: Physics = Physics {
    name: "learned_correction",
    equation: "ε_i += Σ a_i,mn xᵐyⁿ (m + n ≤ 4) + s_i (c_i + c_i,x x + c_i,y y), (x, y) = θ (cos δ, sin δ), θ held at the largest \
               that was learned from; s_i = ±1 the direction in which q_i last moved",
    reading: "a gap without a name, taken off by a smooth function of the bend that was learned from it",
    parameters: |backbones| &PARAMETERS[..1 + backbones * TERMS],
    starts: Starts::Nowhere,
    changes: Changes::Line(|at, p| {
        PerBackbone::from_fn(at.q_mm.len(), |i| {
            let basis = basis(at.bend, at.motion.direction[i], p[0].to_radians());
            basis.iter().zip(&p[1 + i * TERMS..]).map(|(basis, weight)| basis * weight).sum()
        })
    }),
    history: Some(|history, _| history.direction = true),
    fitted: false,
    ..LINEAR
};

/// The functions at a bend vector (rad) and a direction of motion of the backbone, in the order of the parameters.
pub fn basis(bend: Vector2<f64>, direction: f64, largest_theta: f64) -> [f64; TERMS] {
    let theta = bend.norm();
    let held = if theta > largest_theta { bend * (largest_theta / theta) } else { bend };
    let (x, y, s) = (held.x, held.y, direction);
    let (xx, xy, yy) = (x * x, x * y, y * y);
    #[rustfmt::skip]
    let basis = [
        1.0, x, y, xx, xy, yy,
        xx * x, xx * y, x * yy, yy * y,
        xx * xx, xx * xy, xx * yy, xy * yy, yy * yy,
        s, s * x, s * y,
    ];
    basis
}

/// The power of the bend in each function: how rough it is.
pub const POWERS: [i32; TERMS] = [0, 1, 1, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 4, 0, 1, 1];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Configuration;
    use crate::robot::{Effect, Model};

    #[test]
    fn it_adds_what_it_says_and_stops_growing_where_nothing_was_learned() {
        let mut values = vec![0.0; 3 * TERMS + 1];
        (values[1 + TERMS + 3], values[0]) = (0.1, 60.0);
        let effect = Effect::of(&LEARNED_CORRECTION, values);
        let model = Model { effects: vec![effect], ..Model::default() };
        let added = |theta: f64| {
            let psi = Configuration::from_degrees(theta, 0.0);
            model.command(psi) - Model::default().command(psi)
        };
        let expected = 0.1 * 40f64.to_radians().powi(2);
        assert!((added(40.0) - PerBackbone::from([0.0, expected, 0.0])).norm() < 1e-9);
        assert!((added(80.0) - added(60.0)).norm() < 1e-9);
    }

    #[test]
    fn names_are_unique_and_powers_are_those_of_the_units() {
        for (k, spec) in PARAMETERS.iter().enumerate() {
            assert!(PARAMETERS[..k].iter().all(|other| other.name != spec.name));
        }
        let twice = basis(Vector2::new(0.6, 0.4), 1.0, 3.0);
        let once = basis(Vector2::new(0.3, 0.2), 1.0, 3.0);
        for (j, power) in POWERS.iter().enumerate() {
            assert!((twice[j] - once[j] * 2f64.powi(*power)).abs() < 1e-12, "{j}");
        }
    }
}
