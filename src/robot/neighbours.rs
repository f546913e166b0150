//! The neighbouring sections of a robot of several sections: what their encoders read, and what that does to the readings of this one.
//!
//! A neighbour's lines that run through this section, or this section's through the neighbour, tie the two together. The neighbour's own
//! geometry is not known here. Its readings q̃_j are taken as those of evenly spaced backbones at a_j = −(j−1)·360°/n, and
//! u = −(2/n) Σ_j q̃_j (cos a_j, sin a_j) is its bend vector times the radius of its circle, mm; what all its readings share is no bend.

use super::effects::Changes;
use super::{Model, PerBackbone};
use nalgebra::Vector2;
use std::f64::consts::TAU;

/// The most neighbours of a section.
///
/// Derived: one before it and one after it.
pub const NEIGHBOURS: usize = 2;

/// What the encoders of the neighbouring sections read at one instant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Neighbours {
    /// q̃ of each neighbour, mm; empty where there is none.
    pub q_mm: [PerBackbone; NEIGHBOURS],
}

impl Neighbours {
    /// How many there are.
    pub fn count(&self) -> usize {
        self.q_mm.iter().take_while(|q| !q.is_empty()).count()
    }

    /// u of each, mm; zero of one that is at rest or not there.
    pub fn bends_mm(&self) -> [Vector2<f64>; NEIGHBOURS] {
        self.q_mm.map(|q| {
            let count = q.len() as f64;
            let part = |(j, q): (usize, &f64)| {
                let azimuth = -TAU * j as f64 / count;
                Vector2::new(azimuth.cos(), azimuth.sin()) * (-2.0 * q / count)
            };
            q.iter().enumerate().map(part).sum()
        })
    }
}

impl Model {
    /// Up to which neighbour its effects follow the readings; 0 where they follow none.
    pub fn neighbours(&self) -> usize {
        let follows = |k: &usize| self.effects.iter().any(|effect| effect.physics.follows_neighbour[*k]);
        (0..NEIGHBOURS).rev().find(follows).map_or(0, |last| last + 1)
    }

    /// What is to be said of a log, by what stands beside each of its readings, where it lacks those of a neighbour that the effects follow.
    pub fn lacking_neighbours<'a>(&self, mut log: impl Iterator<Item = &'a Neighbours>) -> Option<String> {
        let needed = self.neighbours();
        let lacks = log.any(|neighbours| neighbours.count() < needed);
        lacks.then(|| {
            format!(
                "no readings of neighbouring section {needed}, which the model's section_coupling follows: give them in columns \
                 n{needed}_q1_mm, n{needed}_q2_mm, …, or take the effect out of the model"
            )
        })
    }

    /// What is to be said with an answer for a section alone, where effects follow neighbours.
    pub fn resting_neighbours(&self) -> Option<&'static str> {
        let words = "section_coupling: the neighbouring sections are taken to be at rest, with readings of 0";
        (self.neighbours() > 0).then_some(words)
    }

    /// What the neighbours add to the readings of this section, mm. Less that, the readings are those of a section alone, whose neighbours
    /// are at rest: of such everything else in this library speaks.
    pub fn by_neighbours_mm(&self, neighbours: &Neighbours) -> PerBackbone {
        let bends_mm = neighbours.bends_mm();
        let bend_mm: Vector2<f64> =
            self.effects.iter().fold(Vector2::zeros(), |sum, effect| match effect.physics.changes {
                Changes::Neighbours(led) => sum + led(&bends_mm, &effect.values),
                _ => sum,
            });
        self.robot.backbone_directions().map(|direction| -bend_mm.dot(&direction))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Configuration;
    use crate::robot::{Effect, Robot};

    #[test]
    fn readings_of_any_number_of_backbones_give_the_bend_times_the_radius_and_no_common_part() {
        for backbones in 3..=8 {
            let robot = Robot { backbones, backbone_circle_radius_mm: 4.0, ..Robot::default() };
            let bend = Configuration::from_degrees(37.0, 110.0).bend_vector();
            // Eq. 1 of the neighbour, by its own code, and a pretension besides.
            let q_mm = (robot.displacement_by_bend() * bend).add_scalar(0.7);
            let neighbours = Neighbours { q_mm: [q_mm, PerBackbone::default()] };
            let [first, second] = neighbours.bends_mm();
            assert!((first - bend * 4.0).norm() < 1e-12, "{backbones}");
            assert_eq!((second, neighbours.count()), (Vector2::zeros(), 1));
        }
    }

    #[test]
    fn lines_on_one_circle_through_both_sections_read_the_neighbours_bend_as_their_own() {
        // A coupling of 1 along and 0 across: Eq. 1 adds the bends of all that a line runs through.
        let robot = Robot::default();
        let bend = Configuration::from_degrees(20.0, -65.0).bend_vector();
        let q_mm = robot.displacement_by_bend() * bend;
        let effect = |text: &str| Effect::parse(text).unwrap();
        let with = |effect| Model { effects: vec![effect], ..Model::default() };
        let neighbours = Neighbours { q_mm: [q_mm, PerBackbone::default()] };
        let model = with(effect("section_coupling:n1_along=1,n1_across=0"));
        assert!((model.by_neighbours_mm(&neighbours) - q_mm).amax() < 1e-12);
        // Across: a neighbour whose backbones are numbered from a quarter of a turn earlier.
        let turned = Configuration::from_degrees(20.0, 25.0).bend_vector();
        let across = with(effect("section_coupling:n1_along=0,n1_across=1")).by_neighbours_mm(&neighbours);
        assert!((across - robot.displacement_by_bend() * turned).amax() < 1e-12);
        // Both neighbours add up, and one that is at rest adds nothing.
        let both = with(effect("section_coupling:n1_along=0.5,n1_across=0,n2_along=-0.25,n2_across=0"));
        let pair = Neighbours { q_mm: [q_mm, q_mm] };
        assert!((both.by_neighbours_mm(&pair) - q_mm * 0.25).amax() < 1e-12);
        assert!((both.by_neighbours_mm(&neighbours) - q_mm * 0.5).amax() < 1e-12);
        assert_eq!((both.neighbours(), model.neighbours(), Model::default().neighbours()), (2, 1, 0));
    }
}
