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

mod path;

use super::compensation::MAX_THETA;
use super::effects::{Changes, Effect, Instant};
use super::{Model, PerBackbone, Robot};
use crate::geometry::Configuration;
use nalgebra::{Matrix2, Vector2, Vector6};

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
pub struct ForwardSolution {
    /// The bend vector, rad.
    pub bend: Vector2<f64>,
    /// The part of q̃ that the model does not explain, mm. It bends nothing: with three backbones it is the same in all of them.
    pub residual_mm: PerBackbone,
}

/// The slope of the line at one bend.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LineJacobian {
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
            if let Changes::Snake(change) = effect.physics.changes {
                change(&mut snake, &effect.values);
            }
        }
        let q_by_bend = snake.azimuths.zip_map(&snake.radii_mm, |azimuth, radius_mm| {
            let (sin, cos) = azimuth.sin_cos();
            Vector2::new(cos, sin) * -radius_mm
        });
        let squared = q_by_bend.cross_gram(&q_by_bend).try_inverse().unwrap_or_else(Matrix2::zeros);
        let mut memory = Memory::default();
        for effect in &model.effects {
            if let Some(history) = effect.physics.history {
                history(&mut memory, &effect.values);
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
            if let Changes::Line(summand) = effect.physics.changes {
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
            if let Changes::Encoders(error) = effect.physics.changes {
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
    pub fn solve(&self, q_tilde: &PerBackbone, motion: Option<&Motion>, start: Vector2<f64>) -> ForwardSolution {
        let line = *q_tilde - self.encoder_errors(q_tilde);
        let misfit = |bend: Vector2<f64>| self.bend_by_q.tr_mul(&(self.line(bend, motion) - line));
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
        ForwardSolution { bend, residual_mm: self.robot.internal_part(&left) }
    }

    /// By how much the line moves for each mm that an encoder reads: what is left of a reading must be told in the units of the
    /// reading, or a scale that shrinks all readings would shrink their noise and explain anything.
    fn line_by_reading(&self, q_tilde: &PerBackbone) -> PerBackbone {
        if !self.effects.iter().any(|effect| matches!(effect.physics.changes, Changes::Encoders(_))) {
            return self.alike(1.0);
        }
        let h = 1e-6;
        let slope = (self.encoder_errors(&q_tilde.add_scalar(h)) - self.encoder_errors(q_tilde)) / h;
        slope.map(|slope| (1.0 - slope).max(0.05))
    }

    /// The slope of the line at a bend of a path.
    pub fn line_jacobian(&self, bend: Vector2<f64>, motion: &Motion) -> LineJacobian {
        let h = 1e-6;
        let at = self.line(bend, Some(motion));
        let columns = [0, 1].map(|axis| (self.line(bend + Vector2::ith(axis, h), Some(motion)) - at) / h);
        let line_by_bend = PerBackbone::from_columns(columns);
        let misfit_by_bend = self.bend_by_q.cross_gram(&line_by_bend);
        let bend_by_misfit = misfit_by_bend.try_inverse().unwrap_or_else(Matrix2::identity);
        LineJacobian { line_by_bend, bend_by_line: self.bend_by_q.map(|column| bend_by_misfit * column) }
    }

    /// The bend that an eye without noise measures in a frame that shows `bend`.
    pub fn apparent_bend(&self, bend: Vector2<f64>) -> Vector2<f64> {
        self.effects.iter().fold(bend, |bend, effect| match effect.physics.changes {
            Changes::Eye(distort) => distort(bend, &effect.values),
            _ => bend,
        })
    }

    /// The bend that a frame showed, from the measured one.
    fn true_bend(&self, measured: Vector2<f64>) -> Vector2<f64> {
        // The eye's errors are small and smooth: what they add at the answer is taken off.
        (0..20).fold(measured, |bend, _| bend + measured - self.apparent_bend(bend))
    }
}

/// The slope of a misfit, by differences.
fn slope(misfit: &impl Fn(Vector2<f64>) -> Vector2<f64>, bend: Vector2<f64>, gap: Vector2<f64>) -> Matrix2<f64> {
    let h = 1e-6;
    Matrix2::from_columns(&[0, 1].map(|axis| (misfit(bend + Vector2::ith(axis, h)) - gap) / h))
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
        let guess: Vec<_> = observations.iter().map(|o| mechanics.true_bend(o.configuration.bend_vector())).collect();
        let (path, _) = mechanics.solve_path_near(&times_s, &q_tilde, &guess, Some(first.configuration.bend_vector()));
        let bends: Vec<_> = path.iter().map(|solution| solution.bend).collect();
        let exposed = mechanics.exposed_bends(&times_s, &bends);
        let remains = observations.iter().zip(&path).zip(&exposed).map(|((observation, solution), exposed)| {
            let shown = mechanics.true_bend(observation.configuration.bend_vector());
            let q_mm = plain.command(Configuration::from_bend_vector(solution.bend)) + solution.residual_mm;
            let configuration = Configuration::from_bend_vector(shown + solution.bend - exposed);
            Observation { q_mm, configuration, ..*observation }
        });
        remains.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Estimate;
    use crate::robot::effects::{LIBRARY, ParameterSpec, Role};
    use proptest::prelude::*;

    pub fn with(name: &str, scale: f64) -> Model {
        on_a_robot_of(3, name, scale)
    }

    pub fn on_a_robot_of(backbones: u8, name: &str, scale: f64) -> Model {
        let physics = crate::robot::effects::physics(name).unwrap();
        let value = |spec: &ParameterSpec| match spec.role {
            Role::Size { .. } => spec.typical * scale,
            Role::Shape { example, .. } => example,
        };
        let values = (physics.parameters)(usize::from(backbones)).iter().map(value).collect();
        let estimate = Estimate { eta: 1.2, lambda_mm: 0.17, covariance: Matrix2::zeros(), samples: 9 };
        let effect = Effect::of(physics, values);
        let robot = Robot { backbones, ..Robot::default() };
        Model { robot, estimate: Some(estimate), effects: vec![effect], ..Model::default() }
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
    fn a_dead_force_sags_the_snake_towards_it() {
        let model = with("tip_load", 0.0);
        let mut loaded = model.clone();
        loaded.effects[0].values = vec![0.0, 2.0, 0.0];
        let q = model.command(Configuration::from_degrees(30.0, 0.0));
        let bend = Mechanics::new(&loaded).solve(&q, None, Vector2::zeros()).bend;
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
            let solution = mechanics.solve(&mechanics.command(psi.bend_vector(), None), None, Vector2::zeros());
            let smooth = !["motion_directed_backlash", "disc_friction", "cone_friction_reversal"].contains(&LIBRARY[k].name);
            // Directions of a single pose jump where a q_i passes zero; there the answer may be short of it.
            let tolerance = if smooth { 1e-8 } else { 0.1 };
            prop_assert!((solution.bend - psi.bend_vector()).norm() < tolerance);
        }
    }
}
