//! The predictor of a running log: readings in, one at a time; bends out. It holds what the model's effects remember, and nothing else of the
//! past, so that a program that waits for the next reading and one that has the whole file see the same.

use super::PerBackbone;
use super::forward::LineJacobian;
use super::mechanics::Mechanics;
use super::path::PathPoint;
use nalgebra::Vector2;
use std::collections::VecDeque;

/// The longest that a frame can be older than its reading, s.
///
/// Derived: the range of the effect `camera_latency`.
const LONGEST_DELAY_S: f64 = 2.0;
/// Bends that are remembered for frames that are older than their readings. Convention: a resource limit, beyond a thousand readings a second.
const MOST_BENDS: usize = 4096;

/// What a model predicts of a reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Predicted {
    /// Where the reading leads, and how the snake came there.
    pub point: PathPoint,
    /// The bend that the frame of this reading shows, rad: that of some time ago, where the camera is late.
    pub shown: Vector2<f64>,
}

/// What is remembered of the readings so far.
#[derive(Debug, Clone, Default)]
pub struct Predictor {
    /// The point of the reading before the latest.
    before: Option<PathPoint>,
    /// The latest reading, and its point.
    latest: Option<(f64, PerBackbone, PathPoint)>,
    /// Times and bends before the latest reading, where frames show them later.
    trail: VecDeque<(f64, Vector2<f64>)>,
}

impl Predictor {
    /// What a model predicts of a reading (time in s, q̃ in mm) after those before it. The same reading again is answered as it was.
    /// `seen` is the bend that the eye measured at it, if it measured any: near it the bend is looked for.
    pub fn predict(
        &mut self,
        mechanics: &Mechanics,
        time_s: f64,
        q_tilde: &PerBackbone,
        seen: Option<Vector2<f64>>,
    ) -> Predicted {
        let near = seen.map(|seen| mechanics.true_bend(seen));
        self.lead(mechanics, time_s, q_tilde, |before| mechanics.step(before.as_ref(), time_s, q_tilde, near, seen))
    }

    /// What a model predicts of a reading that leads to `near`, with its derivative there, by one that is hardly another; to first order. The
    /// memory is this model's own: every reading must have been predicted by it.
    pub fn predict_near(
        &mut self,
        mechanics: &Mechanics,
        time_s: f64,
        q_tilde: &PerBackbone,
        near: (&PathPoint, &LineJacobian),
    ) -> Predicted {
        self.lead(mechanics, time_s, q_tilde, |before| match near.0.solution.converged {
            true => mechanics.step_near(before, time_s, q_tilde, near),
            // A reading that leads nowhere leads both models to the same.
            false => *near.0,
        })
    }

    /// Goes on to a reading, to which `step` leads from the point before.
    fn lead(
        &mut self,
        mechanics: &Mechanics,
        time_s: f64,
        q_tilde: &PerBackbone,
        step: impl FnOnce(Option<PathPoint>) -> PathPoint,
    ) -> Predicted {
        let is_new = self.latest.is_none_or(|(time, q, _)| (time, q) != (time_s, *q_tilde));
        let delay_s = mechanics.exposed_before_s();
        if is_new && let Some((time, _, point)) = self.latest.take() {
            self.before = Some(point);
            if delay_s != 0.0 {
                self.remember(time, point.solution.bend);
            }
        }
        let point = step(self.before);
        self.latest = Some((time_s, *q_tilde, point));
        Predicted { point, shown: self.shown(time_s, time_s - delay_s, point.solution.bend) }
    }

    fn remember(&mut self, time_s: f64, bend: Vector2<f64>) {
        let is_old = |&(then, _): &(f64, Vector2<f64>)| time_s - then > LONGEST_DELAY_S;
        // One that is older than all delays stays, to come from.
        while self.trail.get(1).is_some_and(is_old) || self.trail.len() >= MOST_BENDS {
            self.trail.pop_front();
        }
        self.trail.push_back((time_s, bend));
    }

    /// The bend at a time, on straight lines between readings: the first one before all of them, and beyond the latest as it went on.
    fn shown(&self, now_s: f64, at_s: f64, bend: Vector2<f64>) -> Vector2<f64> {
        let mut later = (now_s, bend);
        for &earlier in self.trail.iter().rev() {
            let span = later.0 - earlier.0;
            if at_s >= earlier.0 && span > 0.0 {
                return earlier.1 + (later.1 - earlier.1) * ((at_s - earlier.0) / span);
            }
            later = earlier;
        }
        later.1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{Effect, Model};

    /// A swing in a plane that turns, at uneven times, and its readings by a model.
    fn swing(model: &Model) -> (Vec<f64>, Vec<Vector2<f64>>, Vec<PerBackbone>) {
        let times: Vec<f64> = (0..80).map(|k| 0.2 * f64::from(k) + 0.05 * (0.9 * f64::from(k)).sin()).collect();
        let bend = |t: &f64| Vector2::new(0.6 + 0.5 * (0.7 * t).sin(), 0.3 * (0.4 * t).sin());
        let bends: Vec<_> = times.iter().map(bend).collect();
        let mechanics = Mechanics::new(model);
        let motions = mechanics.motions(&times, &bends);
        let q = bends.iter().zip(&motions).map(|(bend, motion)| mechanics.command(*bend, Some(motion))).collect();
        (times, bends, q)
    }

    #[test]
    fn one_reading_at_a_time_is_the_path_of_all_of_them() {
        for effect in
            ["play_at_bend:half_gap_mm=0.1", "creep:share=0.2,time_constant_s=3", "disc_friction:coefficient=0.1"]
        {
            let model = Model { effects: vec![Effect::parse(effect).unwrap()], ..Model::default() };
            let (times, bends, q) = swing(&model);
            let (mechanics, mut predictor) = (Mechanics::new(&model), Predictor::default());
            let path = mechanics.solve_path(&times, &q, Some(&bends), Some(bends[0]));
            for k in 0..times.len() {
                let own = predictor.predict(&mechanics, times[k], &q[k], Some(bends[k]));
                assert_eq!(own.point, path[k], "{effect} {k}");
                assert_eq!(predictor.predict(&mechanics, times[k], &q[k], Some(bends[k])), own, "asked again");
            }
        }
    }

    #[test]
    fn a_model_that_is_hardly_another_is_followed_as_solving_anew_does_through_a_gross_reading() {
        for effect in
            ["play_at_bend:half_gap_mm=0.1", "creep:share=0.2,time_constant_s=3", "camera_latency:latency_s=0.1"]
        {
            let model = Model { effects: vec![Effect::parse(effect).unwrap()], ..Model::default() };
            let (times, bends, mut q) = swing(&model);
            q[30].iter_mut().for_each(|q| *q = -99.0);
            q[50][0] = 1e200;
            let (nudged, step) = model.nudged(2);
            let (mechanics, changed) = (Mechanics::new(&model), Mechanics::new(&nudged));
            let [mut own, mut near, mut anew] = [(); 3].map(|()| Predictor::default());
            for k in 0..times.len() {
                let point = own.predict(&mechanics, times[k], &q[k], Some(bends[k])).point;
                let line = mechanics.line_jacobian(point.solution.bend, &point.motion);
                let near = near.predict_near(&changed, times[k], &q[k], (&point, &line));
                let anew = anew.predict(&changed, times[k], &q[k], Some(bends[k]));
                let off = (near.shown - anew.shown).norm();
                // At the gross readings neither leads anywhere.
                let is_sound = ![30, 31, 50, 51].contains(&k);
                assert!(off < 0.05 * step || !is_sound, "{effect} {k}: {off} {step}");
            }
        }
    }

    #[test]
    fn a_late_frame_shows_the_bend_of_then_and_an_early_one_what_comes_next() {
        for latency_s in [0.3, -0.1] {
            let effect = format!("camera_latency:latency_s={latency_s}");
            let model = Model { effects: vec![Effect::parse(&effect).unwrap()], ..Model::default() };
            let (times, bends, q) = swing(&model);
            let (mechanics, mut predictor) = (Mechanics::new(&model), Predictor::default());
            let exposed = mechanics.exposed_bends(&times, &bends);
            for k in 0..times.len() {
                let shown = predictor.predict(&mechanics, times[k], &q[k], None).shown;
                // What comes next is known only as it goes on.
                let tolerance = if latency_s > 0.0 || k == 0 { 1e-9 } else { 0.03 };
                assert!(k == 0 || (shown - exposed[k]).norm() < tolerance, "{k}: {shown} {}", exposed[k]);
            }
        }
    }
}
