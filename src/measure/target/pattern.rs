//! What is printed on the grid target, and how its coordinates are related to the phases of its two waves.
//!
//! Ruled lines one pitch apart are waves along the target's x and y axes, one pitch long. The squares of a checkerboard are waves
//! along its diagonals with phases (x + y)/2 and (x − y)/2, in cycles, for coordinates in pitches: √2 pitches long.

use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_1_SQRT_2;

/// The kinds of patterns that can be printed on the grid target.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PatternKind {
    /// Lines in two directions, one pitch apart.
    Lines,
    /// Squares of side one pitch, alternately dark and light.
    Checkerboard,
}

/// What is printed on the grid target, and in which mix of colours it shows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GridPattern {
    /// The kind of pattern.
    #[serde(rename = "pattern")]
    pub kind: PatternKind,
    /// Weight of each channel (one for grey, three for red, green, blue): the mix has its crests where the grid's
    /// coordinates are whole pitches.
    pub weights: Vec<f64>,
}

impl Default for GridPattern {
    /// Dark lines.
    fn default() -> Self {
        Self::dark(PatternKind::Lines)
    }
}

impl GridPattern {
    /// A pattern whose crests are dark in every colour.
    pub fn dark(kind: PatternKind) -> Self {
        Self { kind, weights: vec![-1.0; 3] }
    }

    /// The weights for a picture of this many channels. Where the numbers differ, all channels weigh the same.
    pub(crate) fn weights_for(&self, channels: usize) -> Vec<f64> {
        if self.weights.len() == channels {
            self.weights.clone()
        } else {
            vec![self.weights.iter().sum::<f64>() / channels as f64; channels]
        }
    }
}

impl PatternKind {
    /// Length of the pattern's waves, in pitches.
    pub(crate) fn wavelength(self) -> f64 {
        match self {
            Self::Lines => 1.0,
            Self::Checkerboard => 1.0 / FRAC_1_SQRT_2,
        }
    }

    /// Radius of the windows in which phases are measured, in wavelengths.
    ///
    /// Derived: a Hann window of radius R periods has its first zero 1/R cycles per period from its centre. At R = 5 the waves of a
    /// ruling five times as coarse, whose overtones lie every fifth of a cycle, do not leak into those of the finest; a
    /// checkerboard has no such neighbours, and R = 1.5 separates its waves from the mean grey and from the third overtone.
    pub(crate) fn window_radius(self) -> f64 {
        match self {
            Self::Lines => 5.0,
            Self::Checkerboard => 1.5,
        }
    }

    /// The two phases (cycles) at a place of the target (pitches).
    pub(crate) fn phases(self, place: Vector2<f64>) -> Vector2<f64> {
        match self {
            Self::Lines => place,
            Self::Checkerboard => Vector2::new(place.x + place.y, place.x - place.y) / 2.0,
        }
    }

    /// The place of the target (pitches) with these phases (cycles): the inverse of [`phases`](Self::phases).
    pub(crate) fn place(self, phases: Vector2<f64>) -> Vector2<f64> {
        match self {
            Self::Lines => phases,
            Self::Checkerboard => Vector2::new(phases.x + phases.y, phases.x - phases.y),
        }
    }

    /// The wave vectors (cycles per px) that belong to the gradients (rows, pitches per px) of the target's coordinates.
    pub(crate) fn waves(self, gradient: Matrix2<f64>) -> [Vector2<f64>; 2] {
        let (x, y) = (gradient.row(0).transpose(), gradient.row(1).transpose());
        match self {
            Self::Lines => [x, y],
            Self::Checkerboard => [(x + y) / 2.0, (x - y) / 2.0],
        }
    }

    /// Gradients of the target's x and y coordinates (pitches per px) from the wave vectors (cycles per px): the inverse of
    /// [`waves`](Self::waves).
    pub(crate) fn gradients(self, waves: [Vector2<f64>; 2]) -> [Vector2<f64>; 2] {
        match self {
            Self::Lines => waves,
            Self::Checkerboard => [waves[0] + waves[1], waves[0] - waves[1]],
        }
    }
}

/// A phase in cycles, brought into [−½, ½].
pub(crate) fn wrap_cycles(cycles: f64) -> f64 {
    cycles - cycles.round()
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    const KINDS: [PatternKind; 2] = [PatternKind::Lines, PatternKind::Checkerboard];

    proptest! {
        #[test]
        fn places_and_phases_are_inverses_and_waves_are_the_phases_gradients(
            x in -50.0..50.0f64, y in -50.0..50.0f64, entries in prop::array::uniform4(-0.2..0.2f64),
        ) {
            let gradient = Matrix2::from_column_slice(&entries);
            for kind in KINDS {
                let place = Vector2::new(x, y);
                prop_assert!((kind.place(kind.phases(place)) - place).norm() < 1e-12);
                let waves = kind.waves(gradient);
                let [along_x, along_y] = kind.gradients(waves);
                prop_assert!((Matrix2::from_rows(&[along_x.transpose(), along_y.transpose()]) - gradient).norm() < 1e-12);
                // Phases are linear in the place, so a step in the picture changes them by the waves exactly.
                let step = Vector2::new(0.7, -1.3);
                let change = kind.phases(gradient * step);
                prop_assert!((change - Vector2::new(waves[0].dot(&step), waves[1].dot(&step))).norm() < 1e-12);
            }
        }
    }

    #[test]
    fn the_crests_of_a_checkerboards_waves_are_a_diagonal_apart() {
        // One pitch along x and one along y, a square's diagonal of √2 pitches, is one cycle of the first wave and none of the
        // other.
        assert_relative_eq!(PatternKind::Checkerboard.phases(Vector2::new(1.0, 1.0)), Vector2::new(1.0, 0.0));
        assert_relative_eq!(PatternKind::Checkerboard.wavelength(), 2.0_f64.sqrt(), epsilon = 1e-15);
        assert_eq!(PatternKind::Lines.wavelength(), 1.0);
    }

    #[test]
    fn a_grey_picture_of_a_coloured_rig_weighs_its_one_channel_by_the_mean() {
        let pattern = GridPattern { kind: PatternKind::Lines, weights: vec![-0.5, -0.25, 0.0] };
        assert_eq!(pattern.weights_for(3), [-0.5, -0.25, 0.0]);
        assert_eq!(pattern.weights_for(1), [-0.75]);
    }
}
