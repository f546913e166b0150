//! In which directions the backbones moved, decided along a path where an effect depends on them.
//!
//! A reversal's jump of q̃ has the sign of the reversal, so that a clear step of a reading tells its backbone's direction. Others keep
//! theirs unless that contradicts itself: a backbone would have moved against its direction, or the part of q̃ that no bend changes
//! would jump. Then the directions that contradict themselves least are taken.

use super::forward::ForwardSolution;
use super::mechanics::Mechanics;
use super::{BACKBONES, PerBackbone};
use nalgebra::Vector2;

/// A move of q_i below this changes no direction, mm: twice the encoders' σ of 1.5 µm.
///
/// Fitted: on the project's simulated experiments (`tests/library/sealed.rs`), whose encoders have that σ; not judged elsewhere.
pub(super) const LEAST_MOVE_MM: f64 = 0.003;
/// The same in standard deviations of a reading.
///
/// Derived: [`LEAST_MOVE_MM`] over 1.5 µm.
const LEAST_MOVE_IN_SDS: f64 = 2.0;
/// A reading's step tells its backbone's direction where it is larger than encoders' noise makes it, in least moves, ...
///
/// Fitted: as [`LEAST_MOVE_MM`].
const CLEAR_STEP_IN_MOVES: f64 = 10.0 / 3.0;
/// ... and at least this share of the largest of all: the lines' stretch mixes the backbones by less.
///
/// Fitted: as [`LEAST_MOVE_MM`].
const CLEAR_STEP_SHARE: f64 = 0.15;
/// How far off the bend that an eye measured at the first reading may be, rad, ...
///
/// Fitted: as [`LEAST_MOVE_MM`]; twice the simulated eye's σ_θ of 0.12°.
const FIRST_BEND_RAD: f64 = 0.004;
/// ... and the common part, mm, while λ is not known well.
///
/// Fitted: as [`LEAST_MOVE_MM`].
const FIRST_COMMON_MM: f64 = 0.01;

/// Which backbones' steps are large enough to show a direction; moves below `least_move_mm` do not count.
fn clear_steps(step_mm: &PerBackbone, least_move_mm: f64) -> PerBackbone<bool> {
    let least = (CLEAR_STEP_IN_MOVES * least_move_mm).max(CLEAR_STEP_SHARE * step_mm.amax());
    step_mm.map(|step| step.abs() >= least)
}

/// A forward solution under assumed directions.
pub(super) type Assumed = (ForwardSolution, PerBackbone);

/// What is known of the directions when the next reading comes.
pub(super) struct Previous {
    /// The directions so far.
    pub direction: PerBackbone,
    /// The furthest q that each backbone came to in its direction, mm.
    pub extreme_mm: PerBackbone,
    /// The residual of the reading before, mm.
    pub residual_mm: PerBackbone,
}

impl Previous {
    /// The extremes after a reading; `before` is `None` at the first.
    pub(super) fn extremes(before: Option<&Self>, q_mm: &PerBackbone, direction: &PerBackbone) -> PerBackbone {
        let Some(before) = before else { return *q_mm };
        PerBackbone::from_fn(q_mm.len(), |i| {
            let reversed = direction[i] != before.direction[i];
            let further = (q_mm[i] - before.extreme_mm[i]) * direction[i] > 0.0;
            if reversed || further { q_mm[i] } else { before.extreme_mm[i] }
        })
    }
}

impl Mechanics<'_> {
    /// With encoders of this standard deviation, mm: a direction is not taken from their noise.
    pub fn with_reading_noise(self, sd_mm: f64) -> Self {
        Self { least_move_mm: LEAST_MOVE_IN_SDS * sd_mm, ..self }
    }

    /// With the directions of the motion, whether or not an effect depends on them.
    pub fn keeping_directions(mut self) -> Self {
        self.history.direction = true;
        self
    }

    /// Whether a step of q_i (mm) is one at all.
    pub(super) fn moved(&self, step_mm: f64) -> bool {
        step_mm.abs() >= self.least_move_mm
    }

    /// Which steps of a reading tell their backbones' directions.
    pub(super) fn clear_steps(&self, step_mm: &PerBackbone) -> PerBackbone<bool> {
        clear_steps(step_mm, self.least_move_mm)
    }

    /// The directions before the first reading: those that lead to the bend that an eye measured there. `away` are those of a snake
    /// that came from straight.
    pub(super) fn first_direction(
        &self,
        solve_with: impl Fn(PerBackbone) -> Assumed,
        away: PerBackbone,
        measured: Option<Vector2<f64>>,
    ) -> Assumed {
        let away = solve_with(away);
        let Some(measured) = measured else { return away };
        // The eye cannot see a direction that all share; the common part tells it.
        let misfit = |(solution, _): &Assumed| {
            (self.apparent_bend(solution.bend) - measured).norm() / FIRST_BEND_RAD
                + rms(&solution.residual_mm) / FIRST_COMMON_MM
        };
        let others = any_direction(away.1.len()).map(solve_with);
        least(away, others, misfit)
    }

    /// The directions at the next reading, whose step from the one before is `step_mm`.
    pub(super) fn next_direction(
        &self,
        solve_with: impl Fn(PerBackbone) -> Assumed,
        step_mm: &PerBackbone,
        previous: &Previous,
    ) -> Assumed {
        let clear = self.clear_steps(step_mm);
        let expected =
            PerBackbone::from_fn(clear.len(), |i| if clear[i] { step_mm[i].signum() } else { previous.direction[i] });
        let contradiction = |(solution, direction): &Assumed| {
            let q = self.statics.q_mm(solution.bend);
            let jump = rms(&(solution.residual_mm - previous.residual_mm)) / self.least_move_mm;
            let backbones = (0..q.len()).map(|i| {
                let back = (previous.extreme_mm[i] - q[i]) / self.least_move_mm;
                let against = if direction[i] == 0.0 { back.abs() } else { (back * direction[i]).max(0.0) };
                against.powi(2) + f64::from(u8::from(direction[i] != expected[i]))
            });
            jump.powi(2) + backbones.sum::<f64>()
        };
        let first = solve_with(expected);
        // Another direction alone contradicts what is expected by 1.
        if contradiction(&first) < 1.0 {
            return first;
        }
        // One backbone otherwise, or all that have a direction.
        let turned = (0..expected.len()).flat_map(|i| [-1.0, 1.0].map(|sign| (i, sign))).map(|(i, sign)| {
            let mut direction = expected;
            direction[i] = sign;
            direction
        });
        let others = turned.chain([-expected]).filter(|direction| *direction != expected).map(solve_with);
        least(first, others, contradiction)
    }
}

/// The first of those for which a measure is least.
fn least(first: Assumed, others: impl Iterator<Item = Assumed>, measure: impl Fn(&Assumed) -> f64) -> Assumed {
    let start = (measure(&first), first);
    let lesser = |best: (f64, Assumed), next: Assumed| {
        let value = measure(&next);
        if value < best.0 { (value, next) } else { best }
    };
    others.fold(start, lesser).1
}

/// All directions that so many backbones can have.
fn any_direction(backbones: usize) -> impl Iterator<Item = PerBackbone> {
    debug_assert!(BACKBONES.contains(&backbones));
    let digit = |number: u32, place: usize| number / 3u32.pow(place as u32) % 3;
    (0..3u32.pow(backbones as u32))
        .map(move |number| PerBackbone::from_fn(backbones, |i| f64::from(digit(number, i)) - 1.0))
}

/// Root of the mean square.
fn rms(values: &PerBackbone) -> f64 {
    values.norm() / (values.len() as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_clear_where_it_is_large_and_not_small_beside_the_largest() {
        assert_eq!(*clear_steps(&PerBackbone::from([0.1, 0.02, -0.014]), LEAST_MOVE_MM), [true, true, false]);
        assert_eq!(*clear_steps(&PerBackbone::from([0.009, -0.011, 0.0]), LEAST_MOVE_MM), [false, true, false]);
    }

    #[test]
    fn there_are_three_directions_for_each_backbone() {
        let all: Vec<_> = any_direction(4).collect();
        assert_eq!(all.len(), 81);
        assert!(all.iter().enumerate().all(|(k, one)| !all[..k].contains(one) && one.amax() <= 1.0));
    }
}
