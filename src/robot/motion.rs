//! The motion that a path of bends implies, and the bends that its frames show.

use super::PerBackbone;
use super::effects::Changes;
use super::history::{Before, Motion};
use super::mechanics::{Mechanics, Past};
use super::without_effects::Observation;
use crate::geometry::Configuration;
use nalgebra::Vector2;

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
        let q: Vec<PerBackbone> = bends.iter().map(|&bend| self.statics.q_mm(bend)).collect();
        let mut motions: Vec<Motion> = Vec::with_capacity(bends.len());
        // Where each backbone stood when its direction was last decided.
        let mut decided_at = q.first().copied().unwrap_or_default();
        for k in 0..bends.len() {
            let mut motion = motions.last().copied().unwrap_or_else(|| self.first_motion(bends[k], &q[k]));
            let read = travels.filter(|_| k > 0).map(|travels| travels[k] - travels[k - 1]);
            let clear = read.map(|read| self.clear_steps(&read));
            for i in 0..q[k].len() {
                let by_reading = read.zip(clear).filter(|(_, clear)| clear[i]);
                let step = by_reading.map_or(q[k][i] - decided_at[i], |(read, _)| read[i]);
                if self.moved(step) {
                    motion.direction[i] = step.signum();
                    decided_at[i] = q[k][i];
                }
            }
            motion.set_speeds(times_s, &q, k);
            motion.elapsed_s = times_s[k] - times_s[0];
            let step_s = if k == 0 { 0.0 } else { (times_s[k] - times_s[k - 1]).max(0.0) };
            if self.history.has_hysteresis() {
                if k > 0 {
                    let bend = self.statics.from_rest(bends[k - 1]);
                    motion.before = Before { q_mm: q[k - 1], bend, hysteresis: motion.hysteresis };
                }
                motion.hysteresis = self.hysteresis_at(&motion, bends[k]);
            }
            if let Some(time_constant_s) = self.history.creep_time_constant_s {
                let share = 1.0 - (-step_s / time_constant_s).exp();
                motion.crept_load_n += (self.forces_n(bends[k]) - motion.crept_load_n) * share;
            }
            motions.push(motion);
        }
        motions
    }

    /// The motion before the first reading: away from straight.
    fn first_motion(&self, bend: Vector2<f64>, q_mm: &PerBackbone) -> Motion {
        let mut motion = Motion::none(q_mm.len());
        motion.direction = q_mm.map(|q| if self.moved(q) { q.signum() } else { 0.0 });
        if self.history.creep_ended_before {
            motion.crept_load_n = self.forces_n(bend);
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
        let delays = self.effects.iter().map(|effect| match effect.physics.changes {
            Changes::Exposure(delay_s) => delay_s(&effect.values),
            _ => 0.0,
        });
        let delay_s: f64 = delays.sum();
        if delay_s == 0.0 {
            return bends.to_vec();
        }
        (0..bends.len()).map(|k| interpolated(times_s, bends, times_s[k] - delay_s, k)).collect()
    }
}

impl Motion {
    /// The speeds at sample k of a path of q (mm).
    pub(super) fn set_speeds(&mut self, times_s: &[f64], q_mm: &[PerBackbone], k: usize) {
        self.speed_mm_per_s = speed(times_s, q_mm, k);
        self.speed_before_mm_per_s = speed_before(times_s, q_mm, k);
    }
}

/// q̇ at sample k: the slope of the parabola through it and its neighbours, or of the one line at an end.
fn speed(times_s: &[f64], q: &[PerBackbone], k: usize) -> PerBackbone {
    let between = |a: usize, b: usize| {
        let span = times_s[b] - times_s[a];
        (span > 0.0).then(|| ((q[b] - q[a]) / span, span))
    };
    let before = if k > 0 { between(k - 1, k) } else { None };
    let after = if k + 1 < q.len() { between(k, k + 1) } else { None };
    match (before, after) {
        (Some((v, h)), Some((w, g))) => (v * g + w * h) / (g + h),
        (Some((v, _)), None) | (None, Some((v, _))) => v,
        (None, None) => q[k] * 0.0,
    }
}

/// q̇ between sample k and the one before it; 0 at the first.
fn speed_before(times_s: &[f64], q: &[PerBackbone], k: usize) -> PerBackbone {
    if k == 0 || times_s[k] <= times_s[k - 1] {
        return q[k] * 0.0;
    }
    (q[k] - q[k - 1]) / (times_s[k] - times_s[k - 1])
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
    fn the_speed_of_an_uneven_parabola_is_exact_within_and_a_chord_at_the_ends() {
        let times = [0.0, 0.3, 1.0, 1.2];
        let q: Vec<PerBackbone> = times.iter().map(|&t| PerBackbone::from([t * t, 2.0 * t, 1.0])).collect();
        assert!((speed(&times, &q, 1) - PerBackbone::from([0.6, 2.0, 0.0])).amax() < 1e-12);
        assert!((speed(&times, &q, 2) - PerBackbone::from([2.0, 2.0, 0.0])).amax() < 1e-12);
        assert!((speed(&times, &q, 0) - PerBackbone::from([0.3, 2.0, 0.0])).amax() < 1e-12);
        assert!((speed_before(&times, &q, 3) - PerBackbone::from([2.2, 2.0, 0.0])).amax() < 1e-12);
        assert_eq!(speed_before(&times, &q, 0), PerBackbone::repeat(3, 0.0));
    }

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
