//! What an answer for a single pose, such as a row of the table, takes for granted: nothing stands there of how the snake came to it.

use super::PerBackbone;
use super::effects::{Changes, Effect};
use super::mechanics::Mechanics;
use super::model::Model;
use crate::geometry::Configuration;
use nalgebra::Vector2;

/// Poses on the way from straight to the furthest bend, a second apart. Convention: an unhurried sweep, finer than any play.
const POSES: u32 = 24;
/// Directions in which the snake is sent there and back. Convention: every 60°, two for each of three backbones.
const DIRECTIONS: u32 = 6;
/// The furthest bend of the way where nobody says how far the model was learned, degrees. Convention: near the end of the paper's experiments.
const FURTHEST_DEG: f64 = 75.0;
/// A bend that depends on the way by less than this is not told, rad. Convention: what one decimal of a degree shows.
const LEAST_TOLD: f64 = 0.05 * std::f64::consts::PI / 180.0;

impl Model {
    /// What has to be so for an answer for a single pose to hold, in sentences; none where every answer holds.
    pub fn conditions_of_single_poses(&self) -> Vec<String> {
        let neighbours = self.resting_neighbours().map(str::to_owned);
        neighbours.into_iter().chain(self.outwards_only()).collect()
    }

    /// The names of the effects by which a command depends on how the snake came to its pose.
    pub(crate) fn remembering_effects(&self) -> Vec<&'static str> {
        // When a frame was exposed changes no command.
        let remembers =
            |effect: &&Effect| !effect.physics.is_static() && !matches!(effect.physics.changes, Changes::Exposure(_));
        self.effects.iter().filter(remembers).map(|effect| effect.physics.name).collect()
    }

    /// That a command is for a bend that is come to from straight and where the snake rests, where effects remember the way.
    fn outwards_only(&self) -> Option<String> {
        let names = self.remembering_effects();
        if names.is_empty() {
            return None;
        }
        let off = self.off_on_the_way_back();
        (off > LEAST_TOLD).then(|| {
            format!(
                "{}: a command holds where the bend is come to from straight without turning back, and the snake rests there; on the way back from \
                 {:.0}° in a slow sweep the same command bends it up to {:.1}° otherwise",
                names.join(", "),
                self.furthest().to_degrees(),
                off.to_degrees()
            )
        })
    }

    /// The furthest bend of the sweep, rad.
    fn furthest(&self) -> f64 {
        self.learned.map_or(FURTHEST_DEG.to_radians(), |learned| learned.theta_max())
    }

    /// By how much, rad, the bends that a sweep comes back through differ from those that the same commands are for.
    fn off_on_the_way_back(&self) -> f64 {
        let mechanics = Mechanics::new(self);
        let times_s: Vec<f64> = (0..2 * POSES).map(f64::from).collect();
        let there_and_back = |direction: u32| -> Vec<Vector2<f64>> {
            let delta = std::f64::consts::TAU * f64::from(direction) / f64::from(DIRECTIONS);
            let share = |k: u32| f64::from(POSES - k.abs_diff(POSES)) / f64::from(POSES);
            let theta = |k: u32| self.furthest() * share(k);
            (0..2 * POSES).map(|k| Configuration { theta: theta(k), delta }.bend_vector()).collect()
        };
        let off = |direction: u32| {
            let bends = there_and_back(direction);
            let commands: Vec<PerBackbone> = bends.iter().map(|bend| mechanics.command(*bend, None)).collect();
            let path = mechanics.solve_path(&times_s, &commands, Some(&bends), bends.first().copied());
            let missed = path.iter().zip(&bends).map(|(point, bend)| (point.solution.bend - bend).norm());
            missed.skip(POSES as usize).filter(|off| off.is_finite()).fold(0.0, f64::max)
        };
        (0..DIRECTIONS).map(off).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(effect: &str) -> Vec<String> {
        Model { effects: vec![Effect::parse(effect).unwrap()], ..Model::default() }.conditions_of_single_poses()
    }

    #[test]
    fn play_of_a_gap_is_as_many_degrees_as_its_crossing_bends() {
        // Out and back differ by twice the half gap in each backbone, which is a bend of 2 · 0.1 mm · √(Σ sign²)/(r √(n/2)) at the least, and less
        // where the line yields.
        let [text] = told("motion_directed_backlash:half_gap_mm=0.1").try_into().unwrap();
        let deg: f64 = text.rsplit_once("up to ").unwrap().1.split('°').next().unwrap().parse().unwrap();
        assert!((3.0..9.0).contains(&deg), "{text}");
        assert!(text.starts_with("motion_directed_backlash: ") && text.contains("from 75°"), "{text}");
    }

    #[test]
    fn what_the_pose_alone_decides_has_no_condition() {
        for effect in ["rest_bend:x_deg=2,y_deg=1", "creep:share=1e-5,time_constant_s=30"] {
            assert_eq!(told(effect), [] as [&str; 0], "{effect}");
        }
        assert!(told("creep:share=0.2,time_constant_s=30")[0].starts_with("creep: "));
        assert!(Model::default().conditions_of_single_poses().is_empty());
    }
}
