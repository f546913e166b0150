//! The forward problem: the bend that a q̃ leads to, and its derivative, Eq. 26.
//!
//! n encoders command two angles. The snake settles where the lines' extensions agree with one set of forces; forces may
//! differ from the least-norm τ(ψ) by any that do no work on the snake (Qᵗf = 0), so q̃ is met by
//!
//! ```text
//! q̃ = q(ψ) + ε(ψ) + c,     Qᵗc = 0
//! ```
//!
//! in n unknowns: b and the n − 2 internal parts of c; with three backbones c is the same in all. Q⁺ removes c and leaves
//! b + Q⁺ε(b) = Q⁺q̃, solved by damped Newton; c is then the residual. Without effects and with η > 0 the left side is the gradient of
//! the convex ½|b|² + ηκ·2/(n r²)·E(b), so there is one solution and damped Newton finds it. c is the stretch that the redundancy takes
//! up as internal force c_i/κ in each backbone. Encoders' own errors are a function of q̃ and are taken off it first.

use super::PerBackbone;
use super::history::Motion;
use super::kinematics::MAX_THETA;
use super::mechanics::{Mechanics, Past};
use nalgebra::Vector2;

/// The most Newton steps.
///
/// Convention: a guard; the paper's model takes four or five, and each step doubles the digits.
const MOST_STEPS: usize = 50;
/// How often the directions of a single pose are asked for anew.
///
/// Convention: a guard; one is turned at a time, and a robot has eight backbones at most.
const DIRECTION_STEPS: usize = 8;
/// The smallest share of a Newton step that is tried before the solver gives up.
///
/// Convention: numerical; a function with the derivative that the step was made of falls within the first few halvings.
const LEAST_SHARE: f64 = 1e-3;
/// A misfit below this, times 1 + |Q⁺q̃|, is none, rad: a few hundred times what doubles resolve.
///
/// Convention: numerical.
const TOLERANCE_RAD: f64 = 1e-13;
/// The same where effects on the line make the derivative one by differences, rad: a millionth of what encoders can tell.
///
/// Convention: numerical.
const TOLERANCE_BY_DIFFERENCES_RAD: f64 = 1e-9;
/// A solver that no step improves has still converged within so many tolerances: then it is rounding that it cannot better.
///
/// Convention: numerical.
const ROUNDING: f64 = 1e3;
/// A step that leaves less than this share of the misfit was made with a derivative that is good for the next step as well.
///
/// Convention: the next step then leaves about as small a share, for a third of the price where the derivative is one by differences.
const CHORD: f64 = 0.01;
/// Step of differences by the bend, rad, and by q̃, mm: the square root of what doubles resolve, but for a digit and a half.
///
/// Convention: numerical.
const DIFFERENCE: f64 = 1e-6;
/// The least that a line is taken to move for a mm that its encoder reads.
///
/// Convention: a guard where an encoder's error all but stops the nut; [`Physics::largest_size`](super::Physics::largest_size)
/// keeps such models out.
const LEAST_TRAVEL_BY_READING: f64 = 0.05;

/// Where a q̃ leads to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForwardSolution {
    /// The bend vector, rad.
    pub bend: Vector2<f64>,
    /// c, the part of q̃ that the model does not explain, mm. It bends nothing: with three backbones it is the same in all of them.
    pub residual_mm: PerBackbone,
    /// Whether the bend meets q̃ but for c; else it is the nearest that was found.
    pub converged: bool,
}

/// The derivative of the line at one bend.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LineJacobian {
    /// ∂(q + ε)/∂b, mm per rad.
    pub line_by_bend: PerBackbone<Vector2<f64>>,
    /// ∂b/∂(q + ε), by columns, rad per mm: Eq. 26 in b.
    pub bend_by_line: PerBackbone<Vector2<f64>>,
}

impl Mechanics<'_> {
    /// The bend that a q̃ leads to, by damped Newton from `start`; the nearest found where the model has no answer. Without a motion,
    /// that of a single pose: the directions that follow from the bend are found with it.
    pub fn solve(&self, q_tilde: &PerBackbone, motion: Option<&Motion>, start: Vector2<f64>) -> ForwardSolution {
        if let Some(motion) = motion {
            return self.newton(q_tilde, Past::Path(motion), start);
        }
        let mut past = self.pose(start);
        let mut solution = self.newton(q_tilde, past, start);
        if !self.history.direction {
            return solution;
        }
        // A direction that the bend contradicts turns: where friction opposes the motion, q_i moves further from what was assumed.
        for _ in 0..DIRECTION_STEPS {
            let own = self.pose(solution.bend);
            if own == past {
                return solution;
            }
            past = own;
            solution = self.newton(q_tilde, past, solution.bend);
        }
        ForwardSolution { converged: false, ..solution }
    }

    /// Damped Newton under a given past.
    fn newton(&self, q_tilde: &PerBackbone, past: Past, start: Vector2<f64>) -> ForwardSolution {
        let target = self.line_of(q_tilde, past);
        let at = |bend: Vector2<f64>| {
            let travel = self.travel(bend, past);
            (bend, travel, self.bend_by_q.tr_mul(&(travel - target)))
        };
        let tolerance = if self.effects_on_line {
            TOLERANCE_BY_DIFFERENCES_RAD
        } else {
            TOLERANCE_RAD * (1.0 + self.bend_by_q.tr_mul(&target).norm())
        };
        let mut point = at(start);
        let mut converged = false;
        // The inverse of the derivative at the step before, where that step went as it foretold.
        let mut chord = None;
        for _ in 0..MOST_STEPS {
            let (bend, travel, misfit) = point;
            converged = misfit.norm() <= tolerance;
            if converged {
                break;
            }
            let newton = || {
                let line_by_bend = self.travel_by_bend(bend, past, &travel);
                self.bend_by_q.cross_gram(&line_by_bend).try_inverse()
            };
            let Some(inverse) = chord.or_else(newton) else { break };
            let step = inverse * misfit;
            // Full steps nearly always; a shorter one where the misfit would grow or the bend leave all reason.
            let shares = std::iter::successors(Some(1.0), |share| Some(0.5 * share));
            let better = shares.take_while(|share| *share > LEAST_SHARE).map(|share| at(bend - step * share));
            let mut better = better.filter(|next| next.0.norm() <= 2.0 * MAX_THETA && next.2.norm() < misfit.norm());
            let Some(next) = better.next() else {
                if chord.take().is_some() {
                    continue;
                }
                converged = misfit.norm() <= ROUNDING * tolerance;
                break;
            };
            let foretold = self.effects_on_line && next.2.norm() < CHORD * misfit.norm();
            chord = foretold.then_some(inverse);
            point = next;
        }
        let residual = (target - point.1).component_div(&self.travel_by_reading(q_tilde));
        ForwardSolution { bend: point.0, residual_mm: self.internal_part(&residual), converged }
    }

    /// ∂(q + ε)/∂b at a bend whose travel is known, mm per rad; by differences where effects add to ε.
    fn travel_by_bend(&self, bend: Vector2<f64>, past: Past, travel: &PerBackbone) -> PerBackbone<Vector2<f64>> {
        if self.effects_on_line {
            let ahead = |axis| self.travel(bend + Vector2::ith(axis, DIFFERENCE), past);
            return PerBackbone::from_columns([0, 1].map(|axis| (ahead(axis) - *travel) / DIFFERENCE));
        }
        let stretch = self.line.eta * self.line.compliance_mm_per_n;
        *self.statics.q_by_bend() + self.statics.forces_by_bend(bend) * stretch
    }

    /// The same of a travel that is not known yet.
    pub(super) fn line_by_bend(&self, bend: Vector2<f64>, past: Past) -> PerBackbone<Vector2<f64>> {
        self.travel_by_bend(bend, past, &self.travel(bend, past))
    }

    /// ∂b/∂(q + ε) from its inverse, by columns, rad per mm; `None` where that is singular.
    pub(super) fn bend_by_line(&self, line_by_bend: &PerBackbone<Vector2<f64>>) -> Option<PerBackbone<Vector2<f64>>> {
        let inverse = self.bend_by_q.cross_gram(line_by_bend).try_inverse()?;
        Some(self.bend_by_q.map(|column| inverse * column))
    }

    /// The derivative of the line at a bend of a path; where it is singular, as if the lines did not stretch.
    pub fn line_jacobian(&self, bend: Vector2<f64>, motion: &Motion) -> LineJacobian {
        let line_by_bend = self.line_by_bend(bend, Past::Path(motion));
        let bend_by_line = self.bend_by_line(&line_by_bend).unwrap_or(self.bend_by_q);
        LineJacobian { line_by_bend, bend_by_line }
    }

    /// By how much the line moves for each mm that an encoder reads: what is left of a reading must be said in the units of the
    /// reading, or a scale that shrinks all readings would shrink their noise and explain anything.
    pub(super) fn travel_by_reading(&self, q_tilde: &PerBackbone) -> PerBackbone {
        if !self.effects_on_encoders {
            return self.alike(1.0);
        }
        let slope = (self.encoder_errors(&q_tilde.add_scalar(DIFFERENCE)) - self.encoder_errors(q_tilde)) / DIFFERENCE;
        slope.map(|slope| (1.0 - slope).max(LEAST_TRAVEL_BY_READING))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Model;
    use crate::robot::effects::LIBRARY;
    use crate::robot::model::fixtures::with_example;
    use nalgebra::Matrix2;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]
        #[test]
        fn the_derivative_is_that_of_differences_with_any_effect(
            k in 0..LIBRARY.len(), theta in 0.1..1.8f64, delta in -PI..PI, backbones in 3..7u8
        ) {
            let model = with_example(LIBRARY[k], backbones, 1.0);
            let mechanics = Mechanics::new(&model);
            let bend = Vector2::new(theta * delta.cos(), theta * delta.sin());
            // Held, as along a path: the motion of a single pose jumps where a q_i passes zero.
            let motion = Motion { direction: mechanics.alike(1.0), ..Motion::none(usize::from(backbones)) };
            let jacobian = mechanics.line_jacobian(bend, &motion);
            let h = 1e-4;
            let travel = |axis, by| mechanics.travel(bend + Vector2::ith(axis, by), Past::Path(&motion));
            for axis in 0..2 {
                let column = jacobian.line_by_bend.column(axis);
                // Where a load changes its sign within a step, the derivative is that of one side.
                let off = [(h, -h), (h, 0.0), (0.0, -h)]
                    .map(|(to, from)| ((travel(axis, to) - travel(axis, from)) / (to - from) - column).norm());
                // A difference to one side is off by half its step times the curvature.
                prop_assert!(off.into_iter().fold(f64::INFINITY, f64::min) < 2e-4, "{}: {off:?}", LIBRARY[k].name);
            }
            let product = jacobian.bend_by_line.cross_gram(&jacobian.line_by_bend);
            prop_assert!((product - Matrix2::identity()).norm() < 1e-9);
        }
    }

    proptest! {
        #[test]
        fn a_single_pose_is_found_back_with_any_effect(
            k in 0..LIBRARY.len(), scale in 0.2..1.5f64, theta in 2.0..100.0f64, delta in -180.0..180.0f64, backbones in 3..7u8
        ) {
            let model = with_example(LIBRARY[k], backbones, scale);
            let bend = crate::geometry::Configuration::from_degrees(theta, delta).bend_vector();
            let mechanics = Mechanics::new(&model);
            let solution = mechanics.solve(&mechanics.command(bend, None), None, Vector2::zeros());
            // The tolerance is the misfit's; the lines' stretch shrinks a misfit on the way to the bend.
            prop_assert!((solution.bend - bend).norm() < 2.0 * TOLERANCE_BY_DIFFERENCES_RAD, "{}", LIBRARY[k].name);
            prop_assert!(solution.residual_mm.amax() < 1e-8);
        }
    }

    #[test]
    fn a_load_and_a_softening_have_a_derivative_in_closed_form() {
        for name in ["tip_load", "superelastic_softening", "backbone_azimuth", "backbone_radius"] {
            let physics = crate::robot::effects::physics(name).unwrap();
            let model = Model { effects: with_example(physics, 3, 1.0).effects, ..Model::default() };
            let mechanics = Mechanics::new(&model);
            assert!(!mechanics.effects_on_line, "{name}");
            let (bend, h) = (Vector2::new(0.9, -0.4), 1e-5);
            let numeric = PerBackbone::from_columns([0, 1].map(|axis| {
                let step = Vector2::ith(axis, h);
                (mechanics.command(bend + step, None) - mechanics.command(bend - step, None)) / (2.0 * h)
            }));
            assert!((numeric - mechanics.line_by_bend(bend, mechanics.pose(bend))).norm() < 1e-8, "{name}");
        }
    }
}
