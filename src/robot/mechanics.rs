//! The mechanics of a model: what its lines travel and what its encoders read at a bend, Eq. 18 and 23 with the model's effects.
//!
//! Without effects this is the paper's model. With effects Eq. 23 is q̃ = g(Q b + ε(b; how the snake got there)), g being what the
//! actuators' encoders add. Along a path the *how* is a [`Motion`]: in which direction each q_i last moved, how fast it moves, how far
//! the lines have crept, how much time has passed.
//!
//! For a single pose ([`Model::command`], tables) there is no path: each q_i is taken to have moved away from straight, slowly,
//! and to have been held until creep ended, at the time of the first reading.
//!
//! The other directions stand beside this file: from q̃ to the bend in [`forward`](super::forward), along paths in
//! [`path`](super::path).

use super::directions::LEAST_MOVE_MM;
use super::drive::Drive;
use super::effects::{Changes, Effect, Instant, Variable};
use super::history::{Arrival, Before, History, Hysteresis, Motion, Play, PlayOf, bouc_wen_after};
use super::line::Line;
use super::statics::{Snake, Statics};
use super::{Model, PerBackbone};
use nalgebra::Vector2;

/// A q_i nearer to 0 than this has not moved away from straight, mm: a nanometre, which no encoder resolves and the solver does.
///
/// Convention: numerical.
const STRAIGHT_MM: f64 = 1e-6;
/// Repetitions by which the encoders' errors, which are a function of what they read, and the reading agree, ...
///
/// Convention: errors of a slope of 0.75 shrink below [`ENCODER_TOLERANCE_MM`] in as many.
const ENCODER_STEPS: usize = 100;
/// ... and the step that is the last, mm.
///
/// Convention: numerical.
const ENCODER_TOLERANCE_MM: f64 = 1e-13;
/// Step of differences by η and by λ, mm.
///
/// Convention: numerical.
const DIFFERENCE: f64 = 1e-6;
/// Iterations that remove the effects of the measurement (turn, offset) from a measured bend. They are small and smooth.
///
/// Convention: of errors of a slope of 0.5, as a turn by 30° has, 1e-12 are left after as many.
const EYE_STEPS: usize = 40;

/// How the snake got to a bend.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Past<'m> {
    /// Along a path.
    Path(&'m Motion),
    /// Nobody knows, but that each q_i last moved in this direction.
    Pose(PerBackbone),
}

/// A model made ready to predict with its effects.
#[derive(Debug, Clone)]
pub struct Mechanics<'a> {
    /// Eq. 1 and 9–11 with the effects on the snake.
    pub(super) statics: Statics<'a>,
    /// Eq. 12–17.
    pub(super) line: Line,
    pub(super) effects: &'a [Effect],
    /// What the effects need to know of the path.
    pub(super) history: History,
    /// A move of q_i below this changes no direction, mm.
    pub(super) least_move_mm: f64,
    /// Q⁺ of the nominal geometry, by columns: what removes the internal parts.
    pub(super) bend_by_q: PerBackbone<Vector2<f64>>,
    /// Whether an effect adds to ε.
    pub(super) effects_on_line: bool,
    /// Whether an effect adds to what the encoders read.
    pub(super) effects_on_encoders: bool,
    /// What lies between the readings and the lines, unless that is rigid.
    pub(super) drive: Option<Drive>,
}

impl<'a> Mechanics<'a> {
    /// What Eq. 18 adds to all backbones alike without effects, mm: K_c⁻¹ e^{2μφ} f_s + λ.
    pub fn common_mm(&self) -> f64 {
        self.line.static_friction_mm + self.line.lambda_mm
    }

    /// Makes a model ready.
    pub fn new(model: &'a Model) -> Self {
        let robot = &model.robot;
        let (mut snake, mut history, mut drive) = (Snake::of(robot), History::default(), Drive::default());
        let (mut effects_on_line, mut effects_on_encoders) = (false, false);
        for effect in &model.effects {
            match effect.physics.changes {
                Changes::Snake(change) => change(&mut snake, &effect.values),
                Changes::Line(_) | Changes::Formula(_) => effects_on_line = true,
                Changes::Encoders(_) => effects_on_encoders = true,
                Changes::Drive(change) => change(&mut drive, &effect.values),
                Changes::Eye(_) | Changes::Exposure(_) | Changes::Neighbours(_) => {}
            }
            effect.physics.note_history(&mut history, &effect.values);
        }
        Self {
            statics: Statics::new(robot, snake),
            line: model.line(),
            effects: &model.effects,
            history,
            least_move_mm: LEAST_MOVE_MM,
            bend_by_q: robot.bend_by_displacement(),
            effects_on_line,
            effects_on_encoders,
            drive: Some(drive).filter(|drive| !drive.is_rigid()),
        }
    }

    /// τ at a bend vector, N, before η.
    pub fn forces_n(&self, bend: Vector2<f64>) -> PerBackbone {
        self.statics.forces_n(bend)
    }

    /// H = ∂ε/∂(η, λ) at a bend vector, mm: a row block of Eq. 20.
    pub fn epsilon_by_parameters(&self, bend: Vector2<f64>) -> PerBackbone<Vector2<f64>> {
        (self.forces_n(bend) * self.line.compliance_mm_per_n).map(|elastic| Vector2::new(elastic, 1.0))
    }

    /// The derivative of the lines' travel by (η, λ) at a bend of a path, mm: H, and what the effects make of it besides.
    pub(crate) fn travel_by_parameters(&self, bend: Vector2<f64>, motion: &Motion) -> PerBackbone<Vector2<f64>> {
        if !self.effects_on_line {
            return self.epsilon_by_parameters(bend);
        }
        let travel = |eta: f64, lambda_mm: f64| {
            let (mut moved, line) = (self.clone(), &self.line);
            (moved.line.eta, moved.line.lambda_mm) = (line.eta + eta, line.lambda_mm + lambda_mm);
            moved.travel(bend, Past::Path(motion))
        };
        let here = travel(0.0, 0.0);
        PerBackbone::from_columns(
            [travel(DIFFERENCE, 0.0), travel(0.0, DIFFERENCE)].map(|there| (there - here) / DIFFERENCE),
        )
    }

    /// What a reading leaves at a bend of a path: the lines' travel by the reading less that by the bend, mm.
    pub(crate) fn misfit_mm(&self, q_tilde: &PerBackbone, bend: Vector2<f64>, motion: &Motion) -> PerBackbone {
        self.line_of(q_tilde, Past::Path(motion)) - self.travel(bend, Past::Path(motion))
    }

    /// The part of displacements that bends nothing, (1 − Q Q⁺) q; Q is n r²/2 times the transpose of Q⁺.
    pub(super) fn internal_part(&self, q_mm: &PerBackbone) -> PerBackbone {
        let robot = self.statics.robot();
        let squares = 0.5 * robot.backbone_count() as f64 * robot.backbone_circle_radius_mm.powi(2);
        *q_mm - self.bend_by_q * (self.bend_by_q.tr_mul(q_mm) * squares)
    }

    /// The same for every backbone.
    pub(super) fn alike(&self, value: f64) -> PerBackbone {
        PerBackbone::repeat(self.statics.robot().backbone_count(), value)
    }

    /// Eq. 18 with the effects on the line, plus q: what the lines travel at a bend, q + ε, mm.
    pub(super) fn travel(&self, bend: Vector2<f64>, past: Past) -> PerBackbone {
        let (q_mm, tau_n, line) = (self.statics.q_mm(bend), self.forces_n(bend), &self.line);
        let paper =
            q_mm + tau_n * (line.eta * line.compliance_mm_per_n) + self.alike(line.static_friction_mm + line.lambda_mm);
        if !self.effects_on_line {
            return paper;
        }
        let of_pose;
        let motion = match past {
            Past::Path(motion) => motion,
            Past::Pose(direction) => {
                let none = Motion::none(q_mm.len());
                of_pose = Motion { direction, before: Before { crept_load_n: None, ..none.before }, ..none };
                &of_pose
            }
        };
        let arrival = &self.arrival(motion, bend, &q_mm, &tau_n);
        let snake = self.statics.snake();
        let mut at = Instant { snake, line: &self.line, bend, q_mm, tau_n, line_mm: paper, motion, arrival };
        let mut formula_plays = PlayOf::COUNT..;
        for effect in self.effects {
            match effect.physics.changes {
                Changes::Line(summand) => at.line_mm += summand(&at, &effect.values),
                Changes::Formula(formula) => {
                    let play = if formula.has(Variable::Play) { formula_plays.next() } else { None };
                    at.line_mm += formula.summand_mm(&at, &effect.values, play.unwrap_or(0));
                }
                _ => {}
            }
        }
        at.line_mm
    }

    /// What a function gives of the snake at a bend of a path, as effects on the line see it.
    pub fn instant<T>(&self, bend: Vector2<f64>, motion: &Motion, of: impl FnOnce(&Instant) -> T) -> T {
        let (q_mm, tau_n) = (self.statics.q_mm(bend), self.forces_n(bend));
        let (snake, arrival) = (self.statics.snake(), &self.arrival(motion, bend, &q_mm, &tau_n));
        of(&Instant { snake, line: &self.line, bend, q_mm, tau_n, line_mm: q_mm, motion, arrival })
    }

    /// What a motion has come to at a bend. `q_mm` and `tau_n` are q and τ there.
    fn arrival(&self, motion: &Motion, bend: Vector2<f64>, q_mm: &PerBackbone, tau_n: &PerBackbone) -> Arrival {
        let before = &motion.before;
        let hysteresis =
            if self.history.has_hysteresis() { self.crossed(before, bend, q_mm, tau_n) } else { before.hysteresis };
        let speed_mm_per_s = if motion.step_s > 0.0 { (*q_mm - before.q_mm) / motion.step_s } else { self.alike(0.0) };
        let crept_load_n = match (before.crept_load_n, self.history.creep_time_constant_s) {
            (Some(crept), Some(time_constant_s)) => {
                crept + (*tau_n - crept) * (1.0 - (-motion.step_s / time_constant_s).exp())
            }
            (Some(crept), None) => crept,
            (None, _) => *tau_n,
        };
        Arrival { hysteresis, speed_mm_per_s, crept_load_n }
    }

    /// Whether a single pose is beyond the domain of an effect; none where no effect has a domain.
    pub fn is_beyond_data(&self, bend: Vector2<f64>) -> Option<bool> {
        let rest = Motion::none(self.statics.robot().backbone_count());
        let beyond = self.effects.iter().filter_map(|effect| match effect.physics.changes {
            Changes::Formula(formula) => self.instant(bend, &rest, |at| formula.is_beyond_domain(at)),
            _ => None,
        });
        beyond.reduce(|any, other| any || other)
    }

    /// Where the hystereses stand once the bend is this: they follow it from the reading before, as far as they give way. `q_mm` and
    /// `tau_n` are q and τ at the bend.
    fn crossed(&self, before: &Before, bend: Vector2<f64>, q_mm: &PerBackbone, tau_n: &PerBackbone) -> Hysteresis {
        let History { plays, half_bend_plays_mm, bouc_wen_travel_mm, bend_bouc_wen_travel_mm, .. } = &self.history;
        let mut here = before.hysteresis;
        let moved_mm = *q_mm - before.q_mm;
        for (stands_mm, play) in here.play_mm.iter_mut().zip(plays) {
            let Some(play) = play else { continue };
            let half = if play.half_mm_per_n == 0.0 {
                self.alike(play.half_mm)
            } else {
                tau_n.map(|tau| (play.half_mm + play.half_mm_per_n * tau.abs()).max(0.0))
            };
            *stands_mm = Play::crossed(*stands_mm, moved_mm, &half);
        }
        let moved = self.statics.from_rest(bend) - before.bend;
        let radius_mm = self.statics.robot().backbone_circle_radius_mm;
        for (stands, half_mm) in here.bend_play.iter_mut().zip(half_bend_plays_mm) {
            let Some(half_mm) = half_mm else { continue };
            *stands = Play::crossed_by_vector(*stands, moved, half_mm / radius_mm);
        }
        if let Some(travel_mm) = bouc_wen_travel_mm {
            let along = |x: f64| Vector2::new(x, 0.0);
            here.bouc_wen =
                here.bouc_wen.zip_map(&moved_mm, |held, moved| bouc_wen_after(along(held), along(moved), *travel_mm).x);
        }
        if let Some(travel_mm) = bend_bouc_wen_travel_mm {
            here.bend_bouc_wen = bouc_wen_after(here.bend_bouc_wen, moved, travel_mm / radius_mm);
        }
        here
    }

    /// Where a motion to a bend leaves the snake for the next reading.
    pub(super) fn behind(&self, motion: &Motion, bend: Vector2<f64>) -> Before {
        let (q_mm, tau_n) = (self.statics.q_mm(bend), self.forces_n(bend));
        let Arrival { hysteresis, crept_load_n, .. } = self.arrival(motion, bend, &q_mm, &tau_n);
        Before { q_mm, bend: self.statics.from_rest(bend), hysteresis, crept_load_n: Some(crept_load_n) }
    }

    /// The past of a single pose: each q_i moved away from straight.
    pub(super) fn pose(&self, bend: Vector2<f64>) -> Past<'static> {
        Past::Pose(self.statics.q_mm(bend).map(|q| if q.abs() < STRAIGHT_MM { 0.0 } else { q.signum() }))
    }

    /// What the encoders read beyond the lines' travel, mm.
    pub(super) fn encoder_errors(&self, q_tilde: &PerBackbone) -> PerBackbone {
        let mut sum = self.alike(0.0);
        if self.effects_on_encoders {
            for effect in self.effects {
                if let Changes::Encoders(error) = effect.physics.changes {
                    sum += error(q_tilde, &effect.values);
                }
            }
        }
        sum
    }

    /// Eq. 23: q̃ of a bend, mm; without a motion, that of a single pose.
    pub fn command(&self, bend: Vector2<f64>, motion: Option<&Motion>) -> PerBackbone {
        let line_mm = self.travel(bend, motion.map_or_else(|| self.pose(bend), Past::Path));
        let travel = self.reading_of(&line_mm, motion);
        let mut q_tilde = travel;
        if self.effects_on_encoders {
            for _ in 0..ENCODER_STEPS {
                let next = travel + self.encoder_errors(&q_tilde);
                let step = (next - q_tilde).amax();
                q_tilde = next;
                if step < ENCODER_TOLERANCE_MM {
                    break;
                }
            }
        }
        q_tilde
    }

    /// The bend that an eye without noise measures in a frame that shows `bend`.
    pub fn apparent_bend(&self, bend: Vector2<f64>) -> Vector2<f64> {
        self.effects.iter().fold(bend, |bend, effect| match effect.physics.changes {
            Changes::Eye(distort) => distort(bend, &effect.values),
            _ => bend,
        })
    }

    /// The bend that a frame showed, from the one that an eye without noise measured in it.
    pub fn true_bend(&self, apparent: Vector2<f64>) -> Vector2<f64> {
        (0..EYE_STEPS).fold(apparent, |bend, _| bend + apparent - self.apparent_bend(bend))
    }
}
