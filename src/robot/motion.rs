//! Predictions that obey a model's effects: for one pose, and along a path on which what came before matters.
//!
//! With effects, Eq. 23 is q̃ = g(Q b + ε(b; how the snake got there)), g being what the actuators' encoders add. Along a path
//! the *how* is a [`Motion`]: in which direction each q_i last moved, how fast it moves, how far the lines have crept, how much
//! time has passed. It follows from the bends of the whole path, so the forward problem along a path is solved in passes:
//! bends without history, the motion along them, bends with it, once more. Encoders tell the bend far better than an eye does, and
//! a reversal's jump of q̃ has the sign of the reversal, so directions settle at once.
//!
//! For a single pose ([`Model::command`], tables) there is no path: each q_i is taken to have moved away from straight, slowly,
//! and to have been held until creep ended, at the time of the first reading.

use super::compensation::MAX_THETA;
use super::effects::{Acts, Effect, Instant};
use super::{Model, PerBackbone, Robot};
use crate::geometry::Configuration;
use nalgebra::{Matrix2, Vector2, Vector6};

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

/// How the snake got to where it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// The direction in which each q_i last moved: −1 or 1, 0 where it never moved.
    pub direction: PerBackbone,
    /// q̇, mm/s, at the instant.
    pub speed_mm_per_s: PerBackbone,
    /// q̇, mm/s, from the sample before.
    pub speed_before_mm_per_s: PerBackbone,
    /// q as a play of given width follows it, mm from the play's middle.
    pub taken_up_mm: PerBackbone,
    /// τ as a creeping line has followed it so far, N.
    pub relaxed_n: PerBackbone,
    /// Time since the first reading, s.
    pub elapsed_s: f64,
}

/// The snake's and its line's constants, with the effects on them applied.
#[derive(Debug, Clone)]
pub struct Snake {
    /// η.
    pub eta: f64,
    /// λ, mm.
    pub lambda_mm: f64,
    /// Distance r_i of each backbone from the middle, mm.
    pub radii_mm: PerBackbone,
    /// Azimuths of the backbones, rad.
    pub azimuths: PerBackbone,
    /// k in ∇E (1 − k θ²).
    pub softening_per_rad2: f64,
    /// Force (N) and moment (N·mm) on the end disk, in {b}.
    pub wrench: Option<Vector6<f64>>,
    /// κ, mm/N.
    pub line_compliance_mm_per_n: f64,
    /// K_c⁻¹, mm/N.
    pub cone_compliance_mm_per_n: f64,
    /// f_s, N.
    pub static_force_n: f64,
    /// 2μφ.
    pub capstan_exponent: f64,
}

/// What effects remember of a path, beyond the direction of the motion.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Memory {
    /// T of creep, s.
    pub creep_s: Option<f64>,
    /// Whether creep had ended under the first reading's load; else it begins there.
    pub settled: bool,
    /// Half the width of a play that q crosses at a reversal, mm.
    pub half_play_mm: Option<f64>,
    /// Whether speed matters: then a path feeds back on itself.
    pub speed: bool,
    /// Whether the direction of the motion matters.
    pub direction: bool,
}

impl Memory {
    /// Whether the path matters by more than its direction.
    fn is_long(&self) -> bool {
        self.creep_s.is_some() || self.half_play_mm.is_some() || self.speed
    }
}

/// A model made ready to predict with its effects.
#[derive(Debug, Clone)]
pub struct Mechanics<'a> {
    robot: &'a Robot,
    effects: &'a [Effect],
    snake: Snake,
    static_friction_mm: f64,
    /// Q.
    q_by_bend: PerBackbone<Vector2<f64>>,
    /// Q (QᵗQ)⁻¹.
    forces_by_generalised: PerBackbone<Vector2<f64>>,
    /// Q⁺ of the nominal geometry, by columns: what removes the internal parts.
    bend_by_q: PerBackbone<Vector2<f64>>,
    /// What the effects remember of the path.
    memory: Memory,
}

/// Where a q̃ leads to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Led {
    /// The bend vector, rad.
    pub bend: Vector2<f64>,
    /// The part of q̃ that the model does not explain, mm. It bends nothing: with three backbones it is the same in all of them.
    pub left_mm: PerBackbone,
}

/// The slope of the line at one bend.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slope {
    /// ∂(Q b + ε)/∂b, mm per rad.
    pub line_by_bend: PerBackbone<Vector2<f64>>,
    /// ∂b/∂q̃ without the encoders' own errors, by columns, rad per mm.
    pub bend_by_line: PerBackbone<Vector2<f64>>,
}

impl<'a> Mechanics<'a> {
    /// Makes a model ready.
    pub fn new(model: &'a Model) -> Self {
        let robot = &model.robot;
        let x = model.parameters();
        let mut snake = Snake {
            eta: x.x,
            lambda_mm: x.y,
            radii_mm: PerBackbone::repeat(robot.backbone_count(), robot.backbone_circle_radius_mm),
            azimuths: robot.backbone_azimuths(),
            softening_per_rad2: 0.0,
            wrench: None,
            line_compliance_mm_per_n: model.line_compliance_mm_per_n(),
            cone_compliance_mm_per_n: robot.cone_compliance_mm_per_n(),
            static_force_n: model.friction.static_force_n,
            capstan_exponent: 2.0 * model.friction.mu * robot.line.cone_bend_angle(),
        };
        for effect in &model.effects {
            if let Acts::Snake(change) = effect.physics.acts {
                change(&mut snake, &effect.values);
            }
        }
        let q_by_bend = snake.azimuths.zip_map(&snake.radii_mm, |azimuth, radius_mm| {
            let (sin, cos) = azimuth.sin_cos();
            Vector2::new(cos, sin) * -radius_mm
        });
        let squared = q_by_bend.squared_with(&q_by_bend).try_inverse().unwrap_or_else(Matrix2::zeros);
        let mut memory = Memory::default();
        for effect in &model.effects {
            if let Some(remembers) = effect.physics.remembers {
                remembers(&mut memory, &effect.values);
            }
        }
        Self {
            robot,
            effects: &model.effects,
            static_friction_mm: model.static_friction_mm(),
            q_by_bend,
            forces_by_generalised: q_by_bend * squared,
            bend_by_q: robot.bend_by_displacement(),
            memory,
            snake,
        }
    }

    /// τ at a bend vector, N, before η.
    fn forces(&self, bend: Vector2<f64>, q_mm: PerBackbone) -> PerBackbone {
        let stiffness = self.robot.secondary.bending_stiffness_n_mm2();
        let squared = bend.norm_squared();
        let mut gradient = bend * (self.robot.primary.bending_stiffness_n_mm2() / self.robot.length_mm);
        for (q, row) in q_mm.iter().zip(&self.q_by_bend) {
            let per_length = stiffness / (self.robot.length_mm + q);
            gradient += bend * per_length - row * (0.5 * per_length * squared / (self.robot.length_mm + q));
        }
        gradient *= 1.0 - self.snake.softening_per_rad2 * squared;
        if let Some(wrench) = &self.snake.wrench {
            gradient -= self.robot.tip_jacobian_bend(bend).transpose() * wrench;
        }
        self.forces_by_generalised * gradient
    }

    /// τ at a bend vector, N, before η, with the effects on the snake.
    pub fn forces_at(&self, bend: Vector2<f64>) -> PerBackbone {
        self.forces(bend, self.q_by_bend * bend)
    }

    /// The same for every backbone.
    fn alike(&self, value: f64) -> PerBackbone {
        PerBackbone::repeat(self.robot.backbone_count(), value)
    }

    /// Q b + ε: what the lines move at a bend, mm; without a motion, that of a single pose.
    fn line(&self, bend: Vector2<f64>, motion: Option<&Motion>) -> PerBackbone {
        let q_mm = self.q_by_bend * bend;
        let tau_n = self.forces(bend, q_mm);
        let held;
        let motion = match motion {
            Some(motion) => motion,
            None => {
                held = Motion {
                    direction: q_mm.map(|q| if q.abs() < 1e-9 { 0.0 } else { q.signum() }),
                    speed_mm_per_s: self.alike(0.0),
                    speed_before_mm_per_s: self.alike(0.0),
                    taken_up_mm: self.memory.half_play_mm.map_or(q_mm, |half| q_mm.map(|q| q.clamp(-half, half))),
                    relaxed_n: tau_n,
                    elapsed_s: 0.0,
                };
                &held
            }
        };
        let mut sum = q_mm
            + tau_n * (self.snake.eta * self.snake.line_compliance_mm_per_n)
            + self.alike(self.static_friction_mm + self.snake.lambda_mm);
        for effect in self.effects {
            if let Acts::Line(summand) = effect.physics.acts {
                let at = Instant { snake: &self.snake, bend, q_mm, tau_n, line_mm: sum, motion };
                sum += summand(&at, &effect.values);
            }
        }
        sum
    }

    /// What the encoders read beyond the lines' motion, mm.
    fn encoder_errors(&self, q_tilde: &PerBackbone) -> PerBackbone {
        let mut sum = self.alike(0.0);
        for effect in self.effects {
            if let Acts::Actuator(error) = effect.physics.acts {
                sum += error(q_tilde, &effect.values);
            }
        }
        sum
    }

    /// q̃ of a bend, mm.
    pub fn command(&self, bend: Vector2<f64>, motion: Option<&Motion>) -> PerBackbone {
        let line = self.line(bend, motion);
        let mut q_tilde = line;
        for _ in 0..100 {
            let next = line + self.encoder_errors(&q_tilde);
            let step = (next - q_tilde).amax();
            q_tilde = next;
            if step < 1e-13 {
                break;
            }
        }
        q_tilde
    }

    /// The bend that a q̃ leads to, by damped Newton from `start`; the nearest found where the model has no answer.
    pub fn led(&self, q_tilde: &PerBackbone, motion: Option<&Motion>, start: Vector2<f64>) -> Led {
        let line = *q_tilde - self.encoder_errors(q_tilde);
        let misfit = |bend: Vector2<f64>| self.bend_by_q.weighted(&(self.line(bend, motion) - line));
        let (mut bend, mut gap) = (start, misfit(start));
        for _ in 0..30 {
            if gap.norm() < 1e-9 {
                break;
            }
            let Some(inverse) = slope(&misfit, bend, gap).try_inverse() else { break };
            let step = inverse * gap;
            let mut share = 1.0;
            let (next, next_gap) = loop {
                let next = bend - step * share;
                let next_gap = misfit(next);
                if (next.norm() < 2.0 * MAX_THETA && next_gap.norm() < gap.norm()) || share < 1e-3 {
                    break (next, next_gap);
                }
                share *= 0.5;
            };
            if next_gap.norm() >= gap.norm() {
                break;
            }
            (bend, gap) = (next, next_gap);
        }
        let left = (line - self.line(bend, motion)).component_div(&self.line_by_reading(q_tilde));
        Led { bend, left_mm: self.robot.internal_part(&left) }
    }

    /// By how much the line moves for each mm that an encoder reads: what is left of a reading must be told in the units of the
    /// reading, or a scale that shrinks all readings would shrink their noise and explain anything.
    fn line_by_reading(&self, q_tilde: &PerBackbone) -> PerBackbone {
        if !self.effects.iter().any(|effect| matches!(effect.physics.acts, Acts::Actuator(_))) {
            return self.alike(1.0);
        }
        let h = 1e-6;
        let slope = (self.encoder_errors(&q_tilde.add_scalar(h)) - self.encoder_errors(q_tilde)) / h;
        slope.map(|slope| (1.0 - slope).max(0.05))
    }

    /// The motion along a known path of bends at these times.
    pub fn motions(&self, times_s: &[f64], bends: &[Vector2<f64>]) -> Vec<Motion> {
        self.motions_of(times_s, bends, None)
    }

    /// The motion along a path that readings imply.
    ///
    /// Directions come from the readings where they tell them: what a reversal adds to a reading has the reversal's sign,
    /// while an error of the path's bend mixes the backbones. Only a backbone that hardly moves beside the others is left to the path.
    pub fn motions_read(&self, times_s: &[f64], bends: &[Vector2<f64>], q_tilde: &[PerBackbone]) -> Vec<Motion> {
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
    pub fn path(&self, times_s: &[f64], q_tilde: &[PerBackbone], guess: Option<&[Vector2<f64>]>) -> Vec<Led> {
        let without_history;
        let guess = match guess {
            Some(guess) => guess,
            None => {
                let mut start = Vector2::zeros();
                let bends = q_tilde.iter().map(|q| {
                    start = self.led(q, None, start).bend;
                    start
                });
                without_history = bends.collect::<Vec<_>>();
                &without_history
            }
        };
        self.settled(times_s, q_tilde, guess, None).0
    }

    /// Passes until the path and the history that it implies agree, and that history. `first` is the bend that an eye saw at the
    /// first reading, where there is one: it tells which way the backbones had moved before.
    pub fn settled(
        &self,
        times_s: &[f64],
        q_tilde: &[PerBackbone],
        guess: &[Vector2<f64>],
        first: Option<Vector2<f64>>,
    ) -> (Vec<Led>, Vec<Motion>) {
        let mut before = guess.to_vec();
        let mut motions = self.motions_read(times_s, guess, q_tilde);
        let mut path = self.pass(q_tilde, guess, &mut motions, first);
        for _ in 1..MOST_PASSES {
            let bends: Vec<_> = path.iter().map(|led| led.bend).collect();
            let moved = bends.iter().zip(&before).map(|(a, b)| (a - b).amax()).fold(0.0, f64::max);
            if moved < SETTLED_RAD || !self.memory.is_long() {
                break;
            }
            motions = self.motions_read(times_s, &bends, q_tilde);
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
    ) -> Vec<Led> {
        if !self.memory.direction {
            return (0..guess.len()).map(|k| self.led(&q_tilde[k], Some(&motions[k]), guess[k])).collect();
        }
        let mut path: Vec<Led> = Vec::with_capacity(guess.len());
        let mut turned_at = self.alike(0.0);
        for k in 0..guess.len() {
            let led_in = |direction: PerBackbone| {
                (self.led(&q_tilde[k], Some(&Motion { direction, ..motions[k] }), guess[k]), direction)
            };
            let (led, direction) = match path.last() {
                None => self.first_direction(led_in, motions[k].direction, first),
                Some(last) => {
                    let turning = Turning {
                        read: self.line_step(q_tilde, k),
                        direction: motions[k - 1].direction,
                        turned_at,
                        left_mm: last.left_mm,
                    };
                    self.next_direction(led_in, &turning)
                }
            };
            let q = self.q_by_bend * led.bend;
            for i in 0..q.len() {
                let same = k > 0 && direction[i] == motions[k - 1].direction[i];
                let further = (q[i] - turned_at[i]) * direction[i] > 0.0;
                if !same || further {
                    turned_at[i] = q[i];
                }
            }
            motions[k].direction = direction;
            path.push(led);
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
        led_in: impl Fn(PerBackbone) -> (Led, PerBackbone),
        away: PerBackbone,
        first: Option<Vector2<f64>>,
    ) -> (Led, PerBackbone) {
        let Some(seen) = first else { return led_in(away) };
        // The eye cannot see a direction that all share; the common part tells it.
        let miss =
            |led: &Led| (self.seen(led.bend) - seen).norm() / FIRST_BEND_RAD + rms(&led.left_mm) / FIRST_COMMON_MM;
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
        led_in: impl Fn(PerBackbone) -> (Led, PerBackbone),
        turning: &Turning,
    ) -> (Led, PerBackbone) {
        let told = turning.read.map(|read| read.abs() >= TOLD_MM.max(TOLD_SHARE * turning.read.amax()));
        let kept =
            PerBackbone::from_fn(told.len(), |i| if told[i] { turning.read[i].signum() } else { turning.direction[i] });
        let doubt = |(led, direction): &(Led, PerBackbone)| {
            let q = self.q_by_bend * led.bend;
            let jump = (rms(&(led.left_mm - turning.left_mm)) / DEAD_BAND_MM).powi(2);
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
    /// change. `settled` and `motions` are this model's path, and `slopes` its [`Slope`]s.
    ///
    /// Nothing is solved anew: at the bends of the path the changed model leaves a misfit, and the slope says which step of
    /// the bend takes it up. Where the history feeds back on the path, the step is repeated with the history that it implies.
    pub fn changed(
        &self,
        changed: &Mechanics,
        data: (&[f64], &[PerBackbone]),
        path: (&[Led], &[Motion], &[Slope]),
    ) -> Vec<Led> {
        let (times_s, q_tilde) = data;
        let (settled, motions, slopes) = path;
        let long = self.memory.is_long() || changed.memory.is_long();
        let mut bends: Vec<_> = settled.iter().map(|led| led.bend).collect();
        let mut next: Vec<Led> = Vec::new();
        for _ in 0..if self.memory.speed || changed.memory.speed { FEEDBACK_PASSES } else { 1 } {
            let mut history = if long { Some(changed.motions_read(times_s, &bends, q_tilde)) } else { None };
            for (motion, known) in history.iter_mut().flatten().zip(motions) {
                motion.direction = known.direction;
            }
            next = (0..settled.len())
                .map(|k| {
                    let motion = history.as_ref().map_or(&motions[k], |history| &history[k]);
                    let line = q_tilde[k] - changed.encoder_errors(&q_tilde[k]);
                    let left = line - changed.line(settled[k].bend, Some(motion));
                    let step = slopes[k].bend_by_line.weighted(&left);
                    let left = left - slopes[k].line_by_bend * step;
                    let left = left.component_div(&changed.line_by_reading(&q_tilde[k]));
                    Led { bend: settled[k].bend + step, left_mm: self.robot.internal_part(&left) }
                })
                .collect();
            bends = next.iter().map(|led| led.bend).collect();
        }
        next
    }

    /// The slope of the line at a bend of a path.
    pub fn slope(&self, bend: Vector2<f64>, motion: &Motion) -> Slope {
        let h = 1e-6;
        let at = self.line(bend, Some(motion));
        let columns = [0, 1].map(|axis| (self.line(bend + Vector2::ith(axis, h), Some(motion)) - at) / h);
        let line_by_bend = PerBackbone::from_columns(columns);
        let misfit_by_bend = self.bend_by_q.squared_with(&line_by_bend);
        let bend_by_misfit = misfit_by_bend.try_inverse().unwrap_or_else(Matrix2::identity);
        Slope { line_by_bend, bend_by_line: self.bend_by_q.map(|column| bend_by_misfit * column) }
    }

    /// The bend that the frame shows at each instant of a path: that of some time ago, where the camera is late.
    pub fn pictured(&self, times_s: &[f64], bends: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
        let mut delay_s = 0.0;
        for effect in self.effects {
            if let Acts::Delay(delay) = effect.physics.acts {
                delay_s += delay(&effect.values);
            }
        }
        if delay_s == 0.0 {
            return bends.to_vec();
        }
        (0..bends.len()).map(|k| interpolated(times_s, bends, times_s[k] - delay_s, k)).collect()
    }

    /// The bend that an eye without noise measures in a frame that shows `bend`.
    pub fn seen(&self, bend: Vector2<f64>) -> Vector2<f64> {
        self.effects.iter().fold(bend, |bend, effect| match effect.physics.acts {
            Acts::Eye(distort) => distort(bend, &effect.values),
            _ => bend,
        })
    }

    /// The bend that a frame showed, from the measured one.
    fn unseen(&self, measured: Vector2<f64>) -> Vector2<f64> {
        // The eye's errors are small and smooth: what they add at the answer is taken off.
        (0..20).fold(measured, |bend, _| bend + measured - self.seen(bend))
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
    left_mm: PerBackbone,
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

/// The slope of a misfit, by differences.
fn slope(misfit: &impl Fn(Vector2<f64>) -> Vector2<f64>, bend: Vector2<f64>, gap: Vector2<f64>) -> Matrix2<f64> {
    let h = 1e-6;
    Matrix2::from_columns(&[0, 1].map(|axis| (misfit(bend + Vector2::ith(axis, h)) - gap) / h))
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

impl Model {
    /// This model without its effects.
    pub fn plain(&self) -> Self {
        Self { effects: Vec::new(), ..self.clone() }
    }

    /// The experiment as it would have been without the model's effects: what its effects did to q̃ and to the measured
    /// bend is taken off, so that the [plain](Self::plain) model leaves the same gap of these as the model does of the
    /// given ones. Observations come in the order of time.
    pub fn without_effects(&self, observations: &[Observation]) -> Vec<Observation> {
        if self.effects.is_empty() {
            return observations.to_vec();
        }
        let mechanics = Mechanics::new(self);
        let plain = self.plain();
        let times_s: Vec<f64> = observations.iter().map(|o| o.time_s).collect();
        let q_tilde: Vec<PerBackbone> = observations.iter().map(|o| o.q_mm).collect();
        let Some(first) = observations.first() else { return Vec::new() };
        // Where the eye saw the snake: of several bends that a steep screw error allows, the one that it had.
        let guess: Vec<_> = observations.iter().map(|o| mechanics.unseen(o.configuration.bend_vector())).collect();
        let (path, _) = mechanics.settled(&times_s, &q_tilde, &guess, Some(first.configuration.bend_vector()));
        let bends: Vec<_> = path.iter().map(|led| led.bend).collect();
        let pictured = mechanics.pictured(&times_s, &bends);
        let remains = observations.iter().zip(&path).zip(&pictured).map(|((observation, led), pictured)| {
            let shown = mechanics.unseen(observation.configuration.bend_vector());
            let q_mm = plain.command(Configuration::from_bend_vector(led.bend)) + led.left_mm;
            let configuration = Configuration::from_bend_vector(shown + led.bend - pictured);
            Observation { q_mm, configuration, ..*observation }
        });
        remains.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Estimate;
    use crate::robot::effects::LIBRARY;
    use proptest::prelude::*;

    fn with(name: &str, scale: f64) -> Model {
        on_a_robot_of(3, name, scale)
    }

    fn on_a_robot_of(backbones: u8, name: &str, scale: f64) -> Model {
        let physics = crate::robot::effects::physics(name).unwrap();
        let specs = (physics.parameters)(usize::from(backbones));
        let mut values: Vec<f64> = specs.iter().map(|p| p.typical * scale).collect();
        match name {
            "screw_periodic" => values[1] = 1.0,
            "creep" => values[1] = 3.0,
            _ => {}
        }
        let estimate = Estimate { eta: 1.2, lambda_mm: 0.17, covariance: Matrix2::zeros(), samples: 9 };
        let effect = Effect::of(physics, values);
        let robot = Robot { backbones, ..Robot::default() };
        Model { robot, estimate: Some(estimate), effects: vec![effect], ..Model::default() }
    }

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

    #[test]
    fn without_effects_nothing_changes() {
        let model = Model { effects: vec![], ..with("creep", 1.0) };
        for (theta, delta) in [(0.0, 0.0), (3.0, 50.0), (80.0, -130.0)] {
            let psi = Configuration::from_degrees(theta, delta);
            let command = Mechanics::new(&model).command(psi.bend_vector(), None);
            assert!((command - model.command(psi)).norm() < 1e-12);
        }
    }

    #[test]
    fn the_path_that_a_command_leads_along_is_the_one_it_was_made_for() {
        let (times, bends) = sweep();
        for physics in LIBRARY {
            let model = with(physics.name, 1.0);
            let mechanics = Mechanics::new(&model);
            let motions = mechanics.motions(&times, &bends);
            let q: Vec<_> = bends.iter().zip(&motions).map(|(b, m)| mechanics.command(*b, Some(m))).collect();
            let path = mechanics.path(&times, &q, None);
            let worst = path.iter().zip(&bends).map(|(led, b)| (led.bend - b).norm()).fold(0.0, f64::max);
            // Speeds and creep come from the path of the pass before; that costs a little.
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
            let pictured = mechanics.pictured(&times, &bends);
            let observations: Vec<_> = (0..bends.len())
                .map(|k| Observation {
                    time_s: times[k],
                    q_mm: mechanics.command(bends[k], Some(&motions[k])),
                    configuration: Configuration::from_bend_vector(mechanics.seen(pictured[k])),
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
    fn it_is_so_with_more_backbones_as_well() {
        let (times, bends) = sweep();
        for physics in LIBRARY.iter().filter(|physics| physics.form.is_empty()) {
            let model = on_a_robot_of(4, physics.name, 1.0);
            let mechanics = Mechanics::new(&model);
            let motions = mechanics.motions(&times, &bends);
            let q: Vec<_> = bends.iter().zip(&motions).map(|(b, m)| mechanics.command(*b, Some(m))).collect();
            let path = mechanics.path(&times, &q, None);
            let worst = path.iter().zip(&bends).map(|(led, b)| (led.bend - b).norm()).fold(0.0, f64::max);
            assert!(worst < 2e-4, "{}: {worst} rad", physics.name);
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

    #[test]
    fn a_dead_force_sags_the_snake_towards_it() {
        let model = with("tip_load", 0.0);
        let mut loaded = model.clone();
        loaded.effects[0].values = vec![0.0, 2.0, 0.0];
        let q = model.command(Configuration::from_degrees(30.0, 0.0));
        let bend = Mechanics::new(&loaded).led(&q, None, Vector2::zeros()).bend;
        assert!(bend.y > 0.02, "{bend}");
        // The same by statics: the forces less the load's part.
        let wrench = Vector6::new(0.0, 2.0, 0.0, 0.0, 0.0, 0.0);
        let forces = Mechanics::new(&loaded).forces(bend, model.robot.displacement_by_bend() * bend);
        assert!((forces - model.robot.actuation_forces(bend, Some(&wrench))).norm() < 1e-9);
    }

    proptest! {
        #[test]
        fn a_single_pose_is_found_back_with_any_effect(
            k in 0..LIBRARY.len(), scale in 0.2..1.5f64, theta in 2.0..100.0f64, delta in -180.0..180.0f64, backbones in 3..7u8
        ) {
            let model = on_a_robot_of(backbones, LIBRARY[k].name, scale);
            let psi = Configuration::from_degrees(theta, delta);
            let mechanics = Mechanics::new(&model);
            let led = mechanics.led(&mechanics.command(psi.bend_vector(), None), None, Vector2::zeros());
            let smooth = !["motion_directed_backlash", "disc_friction", "cone_friction_reversal"].contains(&LIBRARY[k].name);
            // Directions of a single pose jump where a q_i passes zero; there the answer may be short of it.
            let tolerance = if smooth { 1e-8 } else { 0.1 };
            prop_assert!((led.bend - psi.bend_vector()).norm() < tolerance);
        }
    }
}
