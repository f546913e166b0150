//! The start of a log: whether something that moved the snake before it still holds the snake there.
//!
//! Friction keeps a snake where it was left until its lines have moved far enough, and no reading tells where that was. The first samples
//! then lie outside what all others follow, by less and less. They are told from a gap of the model by the others alone: how the measured
//! bend follows from the one that the model implies is fitted without the first block of sweeps, robustly and with more freedom than an
//! effect has (any linear map and a shift), and the samples at the start that lie outside of that, one after the other without a break,
//! are the start. Where they do not end within the block, they are no start but a gap.

use super::fit::Fit;
use super::residuals::Problem;
use crate::statistics::moments::rms;
use crate::statistics::order::mad_scale;
use crate::statistics::robust::{Irls, Loss, TUKEY_LIMIT};
use nalgebra::{DMatrix, DVector, Rotation2, Vector2};

/// A sample is outside where its residual is longer than this many standard deviations of the others' components.
///
/// Derived: √(2 ln 1000), which one in a thousand normal vectors of the plane exceeds.
const OUTSIDE: f64 = 3.717;

/// Rounds of reweighting.
///
/// Convention: an iteration cap.
const ROUNDS: usize = 50;

/// How many samples at the start of the log lie outside what the others follow.
pub fn unknown_start(problem: &Problem, fit: &Fit) -> usize {
    let blocks = problem.data.blocks();
    let samples = problem.data.sweeps.iter().zip(&problem.data.measured).enumerate();
    let (mut first_block, mut measured, mut implied) = (0, Vec::new(), Vec::new());
    for (k, (&sweep, own)) in samples {
        first_block += usize::from(blocks[sweep] == blocks[0]);
        let gap = Rotation2::new(own.configuration.delta) * problem.bend_gap(&fit.residuals, k);
        measured.push(own.configuration.bend_vector());
        implied.push(own.configuration.bend_vector() - gap);
    }
    outside(&measured, &implied, first_block)
}

/// How many of the measured bends at the start lie outside of what those after the first `begin_with` imply; none where all of these do.
fn outside(measured: &[Vector2<f64>], implied: &[Vector2<f64>], begin_with: usize) -> usize {
    let irls = Irls { loss: Loss::Tukey(TUKEY_LIMIT), least_scale: f64::MIN_POSITIVE, rounds: ROUNDS, tolerance: 1e-9 };
    let rest = measured.len() - begin_with;
    let design = DMatrix::from_fn(measured.len(), 3, |k, c| if c < 2 { implied[k][c] } else { 1.0 });
    let residuals = [0, 1].map(|axis| {
        let values = DVector::from_fn(measured.len(), |k, _| -measured[k][axis]);
        let (own_design, own) =
            (design.rows(begin_with, rest).into_owned(), values.rows(begin_with, rest).into_owned());
        irls.fit(&own_design, &own, rest).map(|fit| values + &design * fit.parameters)
    });
    let [Some(x), Some(y)] = residuals else { return 0 };
    // Of each axis by itself: in one plane the other has hardly any, and the median of both together would lie at the edge between them.
    let scale = rms([&x, &y].map(|own| mad_scale(own.iter().skip(begin_with).copied())));
    let is_outside = |k: &usize| x[*k].hypot(y[*k]) > OUTSIDE * scale;
    let count = (0..begin_with).take_while(is_outside).count();
    if count < begin_with { count } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;

    /// A hundred bends of a model that is turned, too short and rests elsewhere, with noise, and with what `start` adds.
    fn bends(start: impl Fn(usize) -> f64, seed: u64) -> (Vec<Vector2<f64>>, Vec<Vector2<f64>>) {
        let mut random = StdRng::seed_from_u64(seed);
        let mut noise = || Vector2::new(random.sample(StandardNormal), random.sample(StandardNormal)) * 0.03;
        let implied = |k: usize| Vector2::new((0.3 * k as f64).sin(), (0.19 * k as f64).cos()) * 0.8;
        let of = |k: usize| Rotation2::new(0.2) * implied(k) * 0.7 + Vector2::new(0.1 + start(k), 0.2) + noise();
        ((0..100).map(of).collect(), (0..100).map(implied).collect())
    }

    #[test]
    fn a_start_that_settles_is_told_and_its_length() {
        for seed in 0..10 {
            let (measured, implied) = bends(|k| 0.6 * (-(k as f64) / 4.0).exp(), seed);
            // It falls to the 0.11 of the limit after 6.8 samples, give or take the noise.
            let count = outside(&measured, &implied, 20);
            assert!((5..=9).contains(&count), "{count}");
        }
    }

    #[test]
    fn in_one_plane_the_start_is_told_by_what_scatters_in_it() {
        let of_start = |start: f64, seed: u64| {
            let mut random = StdRng::seed_from_u64(seed);
            let implied = |k: usize| Vector2::new(0.8 * (0.3 * k as f64).sin(), 1e-9 * (7.0 * k as f64).sin());
            let measured = |k: usize| {
                let noise: f64 = random.sample(StandardNormal);
                let moved = if k < 6 { start } else { 0.0 };
                Vector2::new(0.7 * implied(k).x + 0.1 + moved + 0.03 * noise, 1e-9 * (k as f64).cos())
            };
            let measured: Vec<_> = (0..100).map(measured).collect();
            outside(&measured, &(0..100).map(implied).collect::<Vec<_>>(), 20)
        };
        assert!((0..200).map(|seed| of_start(0.0, seed)).sum::<usize>() <= 6);
        assert!((0..10).all(|seed| (6..=7).contains(&of_start(0.6, seed))));
    }

    #[test]
    fn without_one_hardly_a_sample_is_left_out_and_what_goes_on_is_no_start() {
        let left_out: usize = (0..200)
            .map(|seed| {
                let (measured, implied) = bends(|_| 0.0, seed);
                outside(&measured, &implied, 20)
            })
            .sum();
        assert!(left_out <= 3, "{left_out} of 200 first samples");
        let (measured, implied) = bends(|k| if k < 30 { 0.5 } else { 0.0 }, 1);
        assert_eq!(outside(&measured, &implied, 20), 0);
    }
}
