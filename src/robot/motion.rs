//! The motion that a path of bends implies, and the bends that its frames show.

use super::PerBackbone;
use super::effects::Changes;
use super::history::Motion;
use super::mechanics::{Mechanics, Past};
use crate::geometry::Configuration;
use nalgebra::Vector2;

/// One instant of an experiment: what encoders read and what the eye measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Time, s.
    pub time_s: f64,
    /// q̃, mm.
    pub q_mm: PerBackbone,
    /// The measured configuration.
    pub configuration: Configuration,
}

impl Mechanics<'_> {
    /// The motion along a known path of bends at these times.
    pub fn motions(&self, times_s: &[f64], bends: &[Vector2<f64>]) -> Vec<Motion> {
        let mut motions = self.motions_of(times_s, bends, None);
        if self.drive.is_some() {
            let mut state = self.drive_at_rest();
            for (motion, &bend) in motions.iter_mut().zip(bends) {
                let line_mm = self.travel(bend, Past::Path(motion));
                motion.ahead_mm = self.driving(&mut state, &line_mm) - line_mm;
            }
        }
        motions
    }

    /// The motion along a path that readings imply.
    ///
    /// Directions come from the readings where their steps are clear: what a reversal adds to a reading has the reversal's sign,
    /// while an error of the path's bend mixes the backbones. Only a backbone that hardly moves beside the others is left to the path.
    pub fn motions_from_readings(
        &self,
        times_s: &[f64],
        bends: &[Vector2<f64>],
        q_tilde: &[PerBackbone],
    ) -> Vec<Motion> {
        let travels: Vec<_> = q_tilde.iter().map(|q| *q - self.encoder_errors(q)).collect();
        let mut motions = self.motions_of(times_s, bends, Some(&travels));
        for (motion, ahead_mm) in motions.iter_mut().zip(self.ahead_along(q_tilde).into_iter().flatten()) {
            motion.ahead_mm = ahead_mm;
        }
        motions
    }

    fn motions_of(&self, times_s: &[f64], bends: &[Vector2<f64>], travels: Option<&[PerBackbone]>) -> Vec<Motion> {
        let mut motions: Vec<Motion> = Vec::with_capacity(bends.len());
        // Where each backbone stood when its direction was last decided.
        let mut decided_at = bends.first().map(|bend| self.statics.q_mm(*bend)).unwrap_or_default();
        for k in 0..bends.len() {
            let q_mm = self.statics.q_mm(bends[k]);
            let mut motion = match motions.last() {
                None => Motion { direction: self.away_from_straight(&q_mm), ..self.first_motion() },
                Some(last) => {
                    let mut next = Motion { before: self.behind(last, bends[k - 1]), ..*last };
                    next.go_on(times_s[k] - times_s[k - 1]);
                    next
                }
            };
            let read = travels.filter(|_| k > 0).map(|travels| travels[k] - travels[k - 1]);
            let clear = read.map(|read| self.clear_steps(&read));
            for i in 0..q_mm.len() {
                let by_reading = read.zip(clear).filter(|(_, clear)| clear[i]);
                let step = by_reading.map_or(q_mm[i] - decided_at[i], |(read, _)| read[i]);
                if self.moved(step) {
                    motion.direction[i] = step.signum();
                    decided_at[i] = q_mm[i];
                }
            }
            motions.push(motion);
        }
        motions
    }

    /// The directions of a snake that came from straight to q (mm).
    pub(super) fn away_from_straight(&self, q_mm: &PerBackbone) -> PerBackbone {
        q_mm.map(|q| if self.moved(q) { q.signum() } else { 0.0 })
    }

    /// The motion to the first reading, from rest.
    pub(super) fn first_motion(&self) -> Motion {
        let mut motion = Motion::none(self.statics.robot().backbone_count());
        if self.history.creep_ended_before {
            motion.before.crept_load_n = None;
        }
        motion
    }

    /// What encoders and an eye without noise observe while the snake takes these bends.
    pub fn observations(&self, times_s: &[f64], bends: &[Vector2<f64>]) -> Vec<Observation> {
        let motions = self.motions(times_s, bends);
        let exposed = self.exposed_bends(times_s, bends);
        let at = |k: usize| Observation {
            time_s: times_s[k],
            q_mm: self.command(bends[k], Some(&motions[k])),
            configuration: Configuration::from_bend_vector(self.apparent_bend(exposed[k])),
        };
        (0..bends.len()).map(at).collect()
    }

    /// The bend that the frame shows at each instant of a path: that of some time ago, where the camera is late.
    pub fn exposed_bends(&self, times_s: &[f64], bends: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
        let delay_s = self.exposed_before_s();
        if delay_s == 0.0 {
            return bends.to_vec();
        }
        (0..bends.len()).map(|k| interpolated(times_s, bends, times_s[k] - delay_s, k)).collect()
    }

    /// How long before its reading a frame was exposed, s.
    pub(super) fn exposed_before_s(&self) -> f64 {
        let delays = self.effects.iter().map(|effect| match effect.physics.changes {
            Changes::Exposure(delay_s) => delay_s(&effect.values),
            _ => 0.0,
        });
        delays.sum()
    }
}

/// A path's bend at a time near sample k, on the straight line between samples; the end's beyond the ends.
fn interpolated(times_s: &[f64], bends: &[Vector2<f64>], time_s: f64, k: usize) -> Vector2<f64> {
    let mut low = k;
    while low > 0 && times_s[low] > time_s {
        low -= 1;
    }
    while low + 1 < bends.len() && times_s[low + 1] < time_s {
        low += 1;
    }
    let high = (low + 1).min(bends.len() - 1);
    let span = times_s[high] - times_s[low];
    let share = if span > 0.0 { ((time_s - times_s[low]) / span).clamp(0.0, 1.0) } else { 0.0 };
    bends[low] + (bends[high] - bends[low]) * share
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_frame_shows_the_bend_between_the_samples_and_the_first_one_before_them() {
        let times = [0.0, 1.0, 3.0];
        let bends = [0.0, 1.0, 2.0].map(|x| Vector2::new(x, -x));
        assert_eq!(interpolated(&times, &bends, 2.0, 2), Vector2::new(1.5, -1.5));
        assert_eq!(interpolated(&times, &bends, 0.25, 1), Vector2::new(0.25, -0.25));
        assert_eq!(interpolated(&times, &bends, -1.0, 0), bends[0]);
        assert_eq!(interpolated(&times, &bends, 9.0, 1), bends[2]);
    }
}
