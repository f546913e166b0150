//! The forward problem along a path of readings, on which what came before matters.
//!
//! The history follows from the bends of the whole path, so that it is solved in passes: bends without history, the motion along them,
//! bends with it, once more. Encoders tell the bend far better than an eye does, so that two passes nearly always do.

use super::PerBackbone;
use super::directions::Previous;
use super::forward::{ForwardSolution, LineJacobian};
use super::history::Motion;
use super::mechanics::{Mechanics, Past};
use nalgebra::Vector2;

/// A path that moves by less than this in a pass has converged, rad: a fiftieth of what encoders can tell.
///
/// Convention: numerical.
const CONVERGED_RAD: f64 = 1e-5;
/// The most passes over a path.
///
/// Convention: a guard; speed leaves about a third of a pass's error to the next.
const MOST_PASSES: usize = 12;
/// Repetitions of a first-order change where speed feeds back on the path.
///
/// Derived: a third of the error is left by each, and so 0.4 % of the change.
const FEEDBACK_PASSES: usize = 5;
/// The share of a step that a bend takes in a pass where speed feeds back on the path.
///
/// Derived: a drag couples neighbours with opposite signs, by f. Successive over-relaxation by ω then leaves 1 − ω of the error where
/// f ≤ √((2/ω − 1)² − 1), 1.6 here, and |1 − ω − ω f| where a bend's own speed feeds back, as since the sample before (Young 1971,
/// Iterative Solution of Large Linear Systems, chapter 6).
const RELAXATION: f64 = 0.7;

impl Mechanics<'_> {
    /// The path that readings q̃ at these times lead along. `guess` is a path near it.
    pub fn solve_path(
        &self,
        times_s: &[f64],
        q_tilde: &[PerBackbone],
        guess: Option<&[Vector2<f64>]>,
    ) -> Vec<ForwardSolution> {
        let without_history = || {
            let mut start = Vector2::zeros();
            let bends = q_tilde.iter().map(|q| {
                start = self.solve(q, None, start).bend;
                start
            });
            bends.collect()
        };
        let guess: Vec<_> = guess.map_or_else(without_history, <[_]>::to_vec);
        self.solve_path_near(times_s, q_tilde, &guess, None).0
    }

    /// Passes until the path and the history that it implies agree, and that history. `first` is the bend that an eye measured at the
    /// first reading, where there is one: it tells which way the backbones had moved before.
    pub fn solve_path_near(
        &self,
        times_s: &[f64],
        q_tilde: &[PerBackbone],
        guess: &[Vector2<f64>],
        first: Option<Vector2<f64>>,
    ) -> (Vec<ForwardSolution>, Vec<Motion>) {
        let mut before = guess.to_vec();
        let mut motions = self.motions_that_matter(times_s, guess, q_tilde);
        let mut path = self.pass((times_s, q_tilde), guess, &mut motions, first);
        for _ in 1..MOST_PASSES {
            let bends: Vec<_> = path.iter().map(|solution| solution.bend).collect();
            let moved = bends.iter().zip(&before).map(|(a, b)| (a - b).amax()).fold(0.0, f64::max);
            if moved < CONVERGED_RAD || !self.history.is_long() {
                break;
            }
            motions = self.motions_that_matter(times_s, &bends, q_tilde);
            path = self.pass((times_s, q_tilde), &bends, &mut motions, first);
            before = bends;
        }
        (path, motions)
    }

    /// The motions along a path, as far as the effects depend on them: of the time alone where there is no history.
    fn motions_that_matter(&self, times_s: &[f64], bends: &[Vector2<f64>], q_tilde: &[PerBackbone]) -> Vec<Motion> {
        let history = &self.history;
        if history.direction || history.is_long() || history.has_hysteresis() || self.drive.is_some() {
            return self.motions_from_readings(times_s, bends, q_tilde);
        }
        let none = Motion::none(self.statics.robot().backbone_count());
        times_s.iter().map(|time_s| Motion { elapsed_s: time_s - times_s[0], ..none }).collect()
    }

    /// One pass: the bends under a given history. Where directions or speeds matter they are decided on the way, and put into the history.
    fn pass(
        &self,
        (times_s, q_tilde): (&[f64], &[PerBackbone]),
        guess: &[Vector2<f64>],
        motions: &mut [Motion],
        first: Option<Vector2<f64>>,
    ) -> Vec<ForwardSolution> {
        if !self.history.direction && !self.history.speed && !self.history.has_hysteresis() {
            return (0..guess.len()).map(|k| self.solve(&q_tilde[k], Some(&motions[k]), guess[k])).collect();
        }
        let travel = |k: usize| q_tilde[k] - self.encoder_errors(&q_tilde[k]);
        let mut path: Vec<ForwardSolution> = Vec::with_capacity(guess.len());
        let mut previous: Option<Previous> = None;
        let mut q_mm = self.q_along(guess.iter());
        for k in 0..guess.len() {
            if self.history.speed {
                motions[k].set_speeds(times_s, &q_mm, k);
            }
            if self.history.has_hysteresis() && k > 0 {
                motions[k].before = self.behind(&motions[k - 1], path[k - 1].bend);
            }
            let solve = |motion: &Motion| self.relaxed(self.solve(&q_tilde[k], Some(motion), guess[k]), guess[k]);
            let solve_with = |direction: PerBackbone| (solve(&Motion { direction, ..motions[k] }), direction);
            let (solution, direction) = match &previous {
                _ if !self.history.direction => (solve(&motions[k]), motions[k].direction),
                None => self.first_direction(solve_with, motions[k].direction, first),
                Some(previous) => self.next_direction(solve_with, &(travel(k) - travel(k - 1)), previous),
            };
            let own_mm = self.statics.q_mm(solution.bend);
            if self.history.speed {
                q_mm[k] = own_mm;
            }
            let extreme_mm = Previous::extremes(previous.as_ref(), &own_mm, &direction);
            previous = Some(Previous { direction, extreme_mm, residual_mm: solution.residual_mm });
            motions[k].direction = direction;
            path.push(solution);
        }
        path
    }

    /// How a change of the model near a path changes what it predicts, to first order: the implied bends and the residuals'
    /// change. `path` and `motions` are this model's, and `jacobians` its derivatives there.
    ///
    /// Nothing is solved anew: at the bends of the path the changed model leaves a misfit, and the derivative says which step of
    /// the bend takes it up. Where the history feeds back on the path, the step is repeated with the history that it implies.
    pub fn perturbed_path(
        &self,
        changed: &Mechanics,
        (times_s, q_tilde): (&[f64], &[PerBackbone]),
        (path, motions, jacobians): (&[ForwardSolution], &[Motion], &[LineJacobian]),
    ) -> Vec<ForwardSolution> {
        let mut bends: Vec<_> = path.iter().map(|solution| solution.bend).collect();
        let long = self.history.is_long() || changed.history.is_long();
        let mut history = if long { Some(changed.motions_from_readings(times_s, &bends, q_tilde)) } else { None };
        for (motion, known) in history.iter_mut().flatten().zip(motions) {
            motion.direction = known.direction;
        }
        let history = history.as_deref().unwrap_or(motions);
        let ahead_mm = changed.ahead_along(q_tilde);
        let mut q_mm = changed.q_along(bends.iter());
        let mut next: Vec<ForwardSolution> = Vec::with_capacity(path.len());
        for _ in 0..if changed.history.speed { FEEDBACK_PASSES } else { 1 } {
            next.clear();
            let mut behind = None;
            for k in 0..path.len() {
                let mut motion = &history[k];
                let mut moved;
                if changed.history.speed
                    || changed.history.has_hysteresis()
                    || ahead_mm.is_some()
                    || self.drive.is_some()
                {
                    // A hysteresis is crossed from where the changed path left it.
                    let ahead_mm = ahead_mm.as_ref().map_or(q_tilde[k] * 0.0, |ahead_mm| ahead_mm[k]);
                    moved = Motion { before: behind.unwrap_or(motion.before), ahead_mm, ..*motion };
                    if changed.history.speed {
                        moved.set_speeds(times_s, &q_mm, k);
                    }
                    motion = &moved;
                }
                let solution = changed.one_step(&q_tilde[k], motion, &path[k], &jacobians[k]);
                let solution = changed.relaxed(solution, bends[k]);
                if changed.history.speed {
                    (bends[k], q_mm[k]) = (solution.bend, changed.statics.q_mm(solution.bend));
                }
                behind = changed.history.has_hysteresis().then(|| changed.behind(motion, solution.bend));
                next.push(solution);
            }
        }
        next
    }

    /// q along bends, where the speed is made of it; else nothing.
    fn q_along<'b>(&self, bends: impl Iterator<Item = &'b Vector2<f64>>) -> Vec<PerBackbone> {
        bends.take_while(|_| self.history.speed).map(|bend| self.statics.q_mm(*bend)).collect()
    }

    /// A solution on the way from the bend before, where speed feeds back.
    fn relaxed(&self, solution: ForwardSolution, before: Vector2<f64>) -> ForwardSolution {
        if !self.history.speed {
            return solution;
        }
        ForwardSolution { bend: before + (solution.bend - before) * RELAXATION, ..solution }
    }

    /// One Newton step from a solution, with a derivative that is nearly this model's.
    fn one_step(
        &self,
        q_tilde: &PerBackbone,
        motion: &Motion,
        near: &ForwardSolution,
        jacobian: &LineJacobian,
    ) -> ForwardSolution {
        let misfit = self.line_of(q_tilde, Past::Path(motion)) - self.travel(near.bend, Past::Path(motion));
        let step = jacobian.bend_by_line.tr_mul(&misfit);
        let residual = (misfit - jacobian.line_by_bend * step).component_div(&self.travel_by_reading(q_tilde));
        ForwardSolution {
            bend: near.bend + step,
            residual_mm: self.statics.robot().internal_part(&residual),
            converged: near.converged,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Configuration;
    use crate::robot::effects::LIBRARY;
    use crate::robot::model::fixtures::with_example;
    use crate::robot::{Model, Observation};

    /// Up and down between 5° and 75° in a slowly turning plane, at uneven times.
    fn sweep() -> (Vec<f64>, Vec<Vector2<f64>>) {
        (0..60)
            .map(|k| {
                let phase = f64::from(k);
                let theta = 5.0 + 70.0 * (phase / 15.0 * std::f64::consts::PI).sin().powi(2);
                let bend = Configuration::from_degrees(theta, 40.0 + 0.3 * phase).bend_vector();
                (0.3 * phase + 0.1 * (phase * 0.7).sin(), bend)
            })
            .unzip()
    }

    /// How far the path that the commands of a sweep lead along is from the sweep, at the worst, rad.
    fn furthest_from_the_path(model: &Model) -> f64 {
        let (times, bends) = sweep();
        let mechanics = Mechanics::new(model);
        let motions = mechanics.motions(&times, &bends);
        let q: Vec<_> = bends.iter().zip(&motions).map(|(b, m)| mechanics.command(*b, Some(m))).collect();
        let path = mechanics.solve_path(&times, &q, None);
        path.iter().zip(&bends).map(|(solution, b)| (solution.bend - b).norm()).fold(0.0, f64::max)
    }

    #[test]
    fn the_path_that_a_command_leads_along_is_the_one_it_was_made_for() {
        let more_backbones = LIBRARY.iter().filter(|physics| physics.form.is_empty()).map(|physics| (4, physics));
        for (backbones, physics) in LIBRARY.iter().map(|physics| (3, physics)).chain(more_backbones) {
            let model = with_example(physics, backbones, 1.0);
            let worst = furthest_from_the_path(&model);
            // A path with a history ends when a pass moves it by less than CONVERGED_RAD. Of what is left a pass leaves up to 0.8: within
            // a play ε follows q one to one. That makes 0.8/(1 − 0.8) of the last move.
            let tolerance = if Mechanics::new(&model).history.is_long() { 4.0 * CONVERGED_RAD } else { 1e-8 };
            assert!(worst < tolerance, "{} {} on {backbones}: {worst} rad", physics.name, physics.form);
        }
    }

    #[test]
    fn what_the_effects_did_can_be_taken_off() {
        let (times, bends) = sweep();
        for physics in LIBRARY {
            let model = with_example(physics, 3, 1.0);
            let mechanics = Mechanics::new(&model);
            let motions = mechanics.motions(&times, &bends);
            let exposed = mechanics.exposed_bends(&times, &bends);
            let observations: Vec<_> = (0..bends.len())
                .map(|k| Observation {
                    time_s: times[k],
                    q_mm: mechanics.command(bends[k], Some(&motions[k])),
                    configuration: Configuration::from_bend_vector(mechanics.apparent_bend(exposed[k])),
                })
                .collect();
            let plain = model.plain();
            let gap = |observations: &[Observation]| {
                observations.iter().map(|o| (o.q_mm - plain.command(o.configuration)).norm()).fold(0.0, f64::max)
            };
            assert!(gap(&observations) > 0.01, "{} does nothing", physics.name);
            let left = gap(&model.without_effects(&observations));
            // What the path is off by, times |∂q̃/∂b|, which is about 8 mm per rad.
            let tolerance = if mechanics.history.is_long() { 16.0 * CONVERGED_RAD } else { 1e-7 };
            assert!(left < tolerance, "{} {}: {left} mm", physics.name, physics.form);
        }
    }

    #[test]
    fn a_small_change_of_a_parameter_changes_the_path_as_solving_anew_does() {
        let (times, bends) = sweep();
        for physics in LIBRARY {
            let model = with_example(physics, 3, 1.0);
            let mechanics = Mechanics::new(&model);
            let motions = mechanics.motions(&times, &bends);
            let q: Vec<_> = bends.iter().zip(&motions).map(|(b, m)| mechanics.command(*b, Some(m))).collect();
            let (path, motions) = mechanics.solve_path_near(&times, &q, &bends, Some(bends[0]));
            let jacobians: Vec<_> =
                path.iter().zip(&motions).map(|(s, m)| mechanics.line_jacobian(s.bend, m)).collect();
            let mut changed = model.clone();
            changed.effects[0].values[0] *= 1.001;
            let changed = Mechanics::new(&changed);
            let first_order = mechanics.perturbed_path(&changed, (&times, &q), (&path, &motions, &jacobians));
            let (anew, _) = changed.solve_path_near(&times, &q, &bends, Some(bends[0]));
            for (first_order, anew) in first_order.iter().zip(&anew) {
                let off = (first_order.bend - anew.bend).norm();
                assert!(off < 2.0 * CONVERGED_RAD, "{} {}: {off} rad", physics.name, physics.form);
            }
        }
    }

    #[test]
    fn play_is_crossed_at_a_reversal_and_nowhere_else() {
        let model = with_example(crate::robot::effects::physics("motion_directed_backlash").unwrap(), 3, 1.0);
        let mechanics = Mechanics::new(&model);
        let plain = model.plain();
        let thetas = [10.0, 20.0, 30.0, 20.0, 10.0];
        let bends: Vec<_> = thetas.iter().map(|&t| Configuration::from_degrees(t, 0.0).bend_vector()).collect();
        let motions = mechanics.motions(&[0.0, 1.0, 2.0, 3.0, 4.0], &bends);
        for (k, sign) in [-1.0, -1.0, -1.0, 1.0, 1.0].into_iter().enumerate() {
            let added = mechanics.command(bends[k], Some(&motions[k]))
                - plain.command(Configuration::from_bend_vector(bends[k]));
            let expected = PerBackbone::from([sign, -sign, -sign]) * 0.05;
            assert!((added - expected).norm() < 1e-9, "{k}: {added:?}");
        }
    }
}
