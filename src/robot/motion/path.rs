//! Along a path: the motion that known bends imply, and the path that readings lead along with the motion that it implies.

use super::{ForwardSolution, LineJacobian, Mechanics, Motion};
use crate::robot::PerBackbone;
use crate::robot::effects::Changes;
use nalgebra::Vector2;

/// A move of q_i below this changes no direction, mm: encoders cannot tell it.
const DEAD_BAND_MM: f64 = 0.003;
/// A reading's step tells its backbone's direction where it is larger than encoders' noise ever makes it, mm, ...
const TOLD_MM: f64 = 0.01;
/// ... and at least this share of the largest of all: the lines' stretch mixes the backbones by less.
const TOLD_SHARE: f64 = 0.15;
/// How far off the bend that an eye saw at the first reading may be, rad, ...
const FIRST_BEND_RAD: f64 = 0.004;
/// ... and the common part, mm, while λ is not known well.
const FIRST_COMMON_MM: f64 = 0.01;
/// A path that moves by less than this in a pass has settled, rad: a fiftieth of what encoders can tell.
const SETTLED_RAD: f64 = 1e-5;
/// The most passes over a path. Speed feeds back by less than a half for any drag that a snake can work with.
const MOST_PASSES: usize = 8;
/// Repetitions of a first-order change where speed feeds back on the path.
const FEEDBACK_PASSES: usize = 5;

impl Mechanics<'_> {
    /// The motion along a known path of bends at these times.
    pub fn motions(&self, times_s: &[f64], bends: &[Vector2<f64>]) -> Vec<Motion> {
        self.motions_of(times_s, bends, None)
    }

    /// The motion along a path that readings imply.
    ///
    /// Directions come from the readings where they tell them: what a reversal adds to a reading has the reversal's sign,
    /// while an error of the path's bend mixes the backbones. Only a backbone that hardly moves beside the others is left to the path.
    pub fn motions_from_readings(
        &self,
        times_s: &[f64],
        bends: &[Vector2<f64>],
        q_tilde: &[PerBackbone],
    ) -> Vec<Motion> {
        let lines: Vec<_> = q_tilde.iter().map(|q| *q - self.encoder_errors(q)).collect();
        self.motions_of(times_s, bends, Some(&lines))
    }

    fn motions_of(&self, times_s: &[f64], bends: &[Vector2<f64>], lines: Option<&[PerBackbone]>) -> Vec<Motion> {
        let q: Vec<PerBackbone> = bends.iter().map(|&bend| self.q_by_bend * bend).collect();
        let mut motions: Vec<Motion> = Vec::with_capacity(bends.len());
        let mut moved_from = q.first().copied().unwrap_or_default();
        for k in 0..bends.len() {
            let mut motion = motions.last().copied().unwrap_or(Motion {
                direction: q[k].map(|q| if q.abs() < DEAD_BAND_MM { 0.0 } else { q.signum() }),
                speed_mm_per_s: self.alike(0.0),
                speed_before_mm_per_s: self.alike(0.0),
                taken_up_mm: self.alike(0.0),
                relaxed_n: if self.memory.settled { self.forces(bends[k], q[k]) } else { self.alike(0.0) },
                elapsed_s: 0.0,
            });
            let read = lines.filter(|_| k > 0).map(|lines| lines[k] - lines[k - 1]);
            for i in 0..q[k].len() {
                let told = read.filter(|read| read[i].abs() >= TOLD_MM.max(TOLD_SHARE * read.amax()));
                let step = told.map_or(q[k][i] - moved_from[i], |read| read[i]);
                if step.abs() >= DEAD_BAND_MM {
                    motion.direction[i] = step.signum();
                    moved_from[i] = q[k][i];
                }
            }
            motion.speed_mm_per_s = speed(times_s, &q, k);
            motion.speed_before_mm_per_s = speed_before(times_s, &q, k);
            if let Some(half) = self.memory.half_play_mm
                && k > 0
            {
                motion.taken_up_mm = (motion.taken_up_mm + q[k] - q[k - 1]).map(|up| up.clamp(-half, half));
            }
            motion.elapsed_s = times_s[k] - times_s[0];
            if let Some(time_constant_s) = self.memory.creep_s {
                let step_s = if k == 0 { 0.0 } else { (times_s[k] - times_s[k - 1]).max(0.0) };
                let share = 1.0 - (-step_s / time_constant_s).exp();
                motion.relaxed_n += (self.forces(bends[k], q[k]) - motion.relaxed_n) * share;
            }
            motions.push(motion);
        }
        motions
    }

    /// The path that readings q̃ at these times lead along. `guess` is a path near it.
    pub fn solve_path(
        &self,
        times_s: &[f64],
        q_tilde: &[PerBackbone],
        guess: Option<&[Vector2<f64>]>,
    ) -> Vec<ForwardSolution> {
        let without_history;
        let guess = match guess {
            Some(guess) => guess,
            None => {
                let mut start = Vector2::zeros();
                let bends = q_tilde.iter().map(|q| {
                    start = self.solve(q, None, start).bend;
                    start
                });
                without_history = bends.collect::<Vec<_>>();
                &without_history
            }
        };
        self.solve_path_near(times_s, q_tilde, guess, None).0
    }

    /// Passes until the path and the history that it implies agree, and that history. `first` is the bend that an eye saw at the
    /// first reading, where there is one: it tells which way the backbones had moved before.
    pub fn solve_path_near(
        &self,
        times_s: &[f64],
        q_tilde: &[PerBackbone],
        guess: &[Vector2<f64>],
        first: Option<Vector2<f64>>,
    ) -> (Vec<ForwardSolution>, Vec<Motion>) {
        let mut before = guess.to_vec();
        let mut motions = self.motions_from_readings(times_s, guess, q_tilde);
        let mut path = self.pass(q_tilde, guess, &mut motions, first);
        for _ in 1..MOST_PASSES {
            let bends: Vec<_> = path.iter().map(|solution| solution.bend).collect();
            let moved = bends.iter().zip(&before).map(|(a, b)| (a - b).amax()).fold(0.0, f64::max);
            if moved < SETTLED_RAD || !self.memory.is_long() {
                break;
            }
            motions = self.motions_from_readings(times_s, &bends, q_tilde);
            path = self.pass(q_tilde, &bends, &mut motions, first);
            before = bends;
        }
        (path, motions)
    }

    /// One pass: the bends under a given history. Where directions matter they are decided on the way, and put into the history.
    fn pass(
        &self,
        q_tilde: &[PerBackbone],
        guess: &[Vector2<f64>],
        motions: &mut [Motion],
        first: Option<Vector2<f64>>,
    ) -> Vec<ForwardSolution> {
        if !self.memory.direction {
            return (0..guess.len()).map(|k| self.solve(&q_tilde[k], Some(&motions[k]), guess[k])).collect();
        }
        let mut path: Vec<ForwardSolution> = Vec::with_capacity(guess.len());
        let mut turned_at = self.alike(0.0);
        for k in 0..guess.len() {
            let led_in = |direction: PerBackbone| {
                (self.solve(&q_tilde[k], Some(&Motion { direction, ..motions[k] }), guess[k]), direction)
            };
            let (solution, direction) = match path.last() {
                None => self.first_direction(led_in, motions[k].direction, first),
                Some(last) => {
                    let turning = Turning {
                        read: self.line_step(q_tilde, k),
                        direction: motions[k - 1].direction,
                        turned_at,
                        residual_mm: last.residual_mm,
                    };
                    self.next_direction(led_in, &turning)
                }
            };
            let q = self.q_by_bend * solution.bend;
            for i in 0..q.len() {
                let same = k > 0 && direction[i] == motions[k - 1].direction[i];
                let further = (q[i] - turned_at[i]) * direction[i] > 0.0;
                if !same || further {
                    turned_at[i] = q[i];
                }
            }
            motions[k].direction = direction;
            path.push(solution);
        }
        path
    }

    /// What the line moved from the reading before, mm.
    fn line_step(&self, q_tilde: &[PerBackbone], k: usize) -> PerBackbone {
        let line = |k: usize| q_tilde[k] - self.encoder_errors(&q_tilde[k]);
        line(k) - line(k - 1)
    }

    /// The directions before the first reading: those that lead where the eye saw the snake.
    fn first_direction(
        &self,
        led_in: impl Fn(PerBackbone) -> (ForwardSolution, PerBackbone),
        away: PerBackbone,
        first: Option<Vector2<f64>>,
    ) -> (ForwardSolution, PerBackbone) {
        let Some(seen) = first else { return led_in(away) };
        // The eye cannot see a direction that all share; the common part tells it.
        let miss = |solution: &ForwardSolution| {
            (self.apparent_bend(solution.bend) - seen).norm() / FIRST_BEND_RAD
                + rms(&solution.residual_mm) / FIRST_COMMON_MM
        };
        let mut best = led_in(away);
        for direction in any_direction(away.len()) {
            let next = led_in(direction);
            if miss(&next.0) < miss(&best.0) {
                best = next;
            }
        }
        best
    }

    /// The directions at the next reading.
    ///
    /// A reading's step tells its backbone's direction where it is large enough: what a reversal adds to it mostly has the
    /// reversal's sign. Others keep theirs. Where that contradicts itself, since a backbone would have moved the other way, or the
    /// part common to all readings, which no bend changes, would jump, the directions that contradict themselves least are taken.
    fn next_direction(
        &self,
        led_in: impl Fn(PerBackbone) -> (ForwardSolution, PerBackbone),
        turning: &Turning,
    ) -> (ForwardSolution, PerBackbone) {
        let told = turning.read.map(|read| read.abs() >= TOLD_MM.max(TOLD_SHARE * turning.read.amax()));
        let kept =
            PerBackbone::from_fn(told.len(), |i| if told[i] { turning.read[i].signum() } else { turning.direction[i] });
        let doubt = |(solution, direction): &(ForwardSolution, PerBackbone)| {
            let q = self.q_by_bend * solution.bend;
            let jump = (rms(&(solution.residual_mm - turning.residual_mm)) / DEAD_BAND_MM).powi(2);
            let against = (0..q.len()).map(|i| {
                let same = direction[i] == kept[i];
                let back = ((turning.turned_at[i] - q[i]) * direction[i]).max(0.0) / DEAD_BAND_MM;
                let back = if direction[i] == 0.0 { (q[i] - turning.turned_at[i]).abs() / DEAD_BAND_MM } else { back };
                back.powi(2) + if same { 0.0 } else { 1.0 }
            });
            jump + against.sum::<f64>()
        };
        let mut best = led_in(kept);
        let mut least = doubt(&best);
        if least < 1.0 {
            return best;
        }
        // One backbone otherwise, or all that have a direction.
        let turned = (0..kept.len()).flat_map(|i| [-1.0, 1.0].map(|sign| (i, sign))).map(|(i, sign)| {
            let mut direction = kept;
            direction[i] = sign;
            direction
        });
        for direction in turned.chain([-kept]).filter(|direction| *direction != kept) {
            let next = led_in(direction);
            let doubt = doubt(&next);
            if doubt < least {
                (best, least) = (next, doubt);
            }
        }
        best
    }

    /// How a change of the model near a path changes what it predicts, to first order: the implied bends and the common part's
    /// change. `settled` and `motions` are this model's path, and `slopes` its [`LineJacobian`]s.
    ///
    /// Nothing is solved anew: at the bends of the path the changed model leaves a misfit, and the slope says which step of
    /// the bend takes it up. Where the history feeds back on the path, the step is repeated with the history that it implies.
    pub fn perturbed_path(
        &self,
        changed: &Mechanics,
        data: (&[f64], &[PerBackbone]),
        path: (&[ForwardSolution], &[Motion], &[LineJacobian]),
    ) -> Vec<ForwardSolution> {
        let (times_s, q_tilde) = data;
        let (settled, motions, slopes) = path;
        let long = self.memory.is_long() || changed.memory.is_long();
        let mut bends: Vec<_> = settled.iter().map(|solution| solution.bend).collect();
        let mut next: Vec<ForwardSolution> = Vec::new();
        for _ in 0..if self.memory.speed || changed.memory.speed { FEEDBACK_PASSES } else { 1 } {
            let mut history = if long { Some(changed.motions_from_readings(times_s, &bends, q_tilde)) } else { None };
            for (motion, known) in history.iter_mut().flatten().zip(motions) {
                motion.direction = known.direction;
            }
            next = (0..settled.len())
                .map(|k| {
                    let motion = history.as_ref().map_or(&motions[k], |history| &history[k]);
                    let line = q_tilde[k] - changed.encoder_errors(&q_tilde[k]);
                    let left = line - changed.line(settled[k].bend, Some(motion));
                    let step = slopes[k].bend_by_line.tr_mul(&left);
                    let left = left - slopes[k].line_by_bend * step;
                    let left = left.component_div(&changed.line_by_reading(&q_tilde[k]));
                    ForwardSolution { bend: settled[k].bend + step, residual_mm: self.robot.internal_part(&left) }
                })
                .collect();
            bends = next.iter().map(|solution| solution.bend).collect();
        }
        next
    }

    /// The bend that the frame shows at each instant of a path: that of some time ago, where the camera is late.
    pub fn exposed_bends(&self, times_s: &[f64], bends: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
        let mut delay_s = 0.0;
        for effect in self.effects {
            if let Changes::Exposure(delay) = effect.physics.changes {
                delay_s += delay(&effect.values);
            }
        }
        if delay_s == 0.0 {
            return bends.to_vec();
        }
        (0..bends.len()).map(|k| interpolated(times_s, bends, times_s[k] - delay_s, k)).collect()
    }
}

/// What is known of the directions when the next reading comes.
struct Turning {
    /// The reading's step, mm.
    read: PerBackbone,
    /// The directions so far.
    direction: PerBackbone,
    /// The furthest that each backbone came in its direction, mm.
    turned_at: PerBackbone,
    /// What was left at the reading before, mm.
    residual_mm: PerBackbone,
}

/// All directions that so many backbones can have.
fn any_direction(backbones: usize) -> impl Iterator<Item = PerBackbone> {
    let digit = |number: u32, place: usize| number / 3u32.pow(place as u32) % 3;
    (0..3u32.pow(backbones as u32))
        .map(move |number| PerBackbone::from_fn(backbones, |i| f64::from(digit(number, i)) - 1.0))
}

/// Root of the mean square.
fn rms(values: &PerBackbone) -> f64 {
    values.norm() / (values.len() as f64).sqrt()
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
    use super::super::tests::{on_a_robot_of, with};
    use super::*;
    use crate::geometry::Configuration;
    use crate::robot::effects::LIBRARY;
    use crate::robot::{Model, Observation};

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
        for physics in LIBRARY {
            let worst = furthest_from_the_path(&with(physics.name, 1.0));
            // Speeds and creep come from the path of the pass before; that costs a little.
            assert!(worst < 2e-4, "{}: {worst} rad", physics.name);
        }
    }

    #[test]
    fn it_is_so_with_more_backbones_as_well() {
        for physics in LIBRARY.iter().filter(|physics| physics.form.is_empty()) {
            let worst = furthest_from_the_path(&on_a_robot_of(4, physics.name, 1.0));
            assert!(worst < 2e-4, "{}: {worst} rad", physics.name);
        }
    }

    #[test]
    fn what_the_effects_did_can_be_taken_off() {
        let (times, bends) = sweep();
        for physics in LIBRARY {
            let model = with(physics.name, 1.0);
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
            assert!(gap(&model.without_effects(&observations)) < 1e-3, "{}", physics.name);
        }
    }

    #[test]
    fn play_is_crossed_at_a_reversal_and_nowhere_else() {
        let model = with("motion_directed_backlash", 1.0);
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
