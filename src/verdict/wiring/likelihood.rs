//! How well a wiring explains the bends that were seen: the likelihood of a fit under Student's t distribution.
//!
//! Under a wiring the readings imply the bend vectors u = Q⁺q̃ (common parts of q̃ fall out). Without knowing anything of the
//! line's losses, the bend b that the eye sees is proportional to u, beside a bend at rest:
//!
//! ```text
//! b = g u + h J u + b_0 + s e,     J a turn by 90°,     e ~ t_ν(0, Σ)
//! ```
//!
//! with Σ the measurement's covariance and that of the encoders' noise, and one scale s ≥ 1 for what no such model explains. h is
//! fitted where the azimuth is in question, else 0; g is positive. The maximum of the likelihood over g, h, b_0 and s is found by the EM
//! algorithm, in which measurements far off lose their weight.
//!
//! Source: K. L. Lange, R. J. A. Little, J. M. G. Taylor, "Robust Statistical Modeling Using the t Distribution", J. Am. Stat. Assoc. 84,
//! 1989.

use crate::statistics::correlation::SerialScatter;
use crate::statistics::moments::mean;
use crate::statistics::order::median;
use crate::verdict::rules::{MEAN_SQUARE_OF_NOISE, REJECTED_IN_ORDER};
use nalgebra::{Matrix2, Matrix2x4, Matrix4, Vector2, Vector4};

/// ν: degrees of freedom of the errors' distribution.
///
/// Source: Lange, Little and Taylor 1989, who take 4 where there are too few data to estimate it.
const DEGREES_OF_FREEDOM: f64 = 4.0;
/// The most rounds of the EM algorithm. Convention: a guard.
const MOST_ROUNDS: usize = 40;
/// A round that gains less log-likelihood than this is the last. Convention: numerical; evidence is compared with 7 and more.
const LEAST_GAIN: f64 = 1e-3;
/// A direction that the data leave open is held at zero by this share of the largest information. Convention: numerical.
const RIDGE: f64 = 1e-10;

/// One bend that was seen, and what the readings imply.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point {
    /// The bend vector that the eye measured, rad.
    pub seen: Vector2<f64>,
    /// L⁻¹ of Σ = L Lᵗ, 1/rad.
    pub whitener: Matrix2<f64>,
    /// u, rad.
    pub implied: Vector2<f64>,
}

/// What may be fitted besides the gain and the bend at rest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Freedom {
    /// Nothing: u is taken in its own direction.
    Gain,
    /// Nothing, and not even the gain: the readings imply no bend.
    None,
    /// The azimuth.
    GainAndTurn,
}

/// The fit of largest likelihood.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    /// ln L, up to a constant of the points.
    pub log_likelihood: f64,
    /// s: the typical misfit in units of the predicted noise.
    pub scale: f64,
    /// g and h.
    pub gain: Vector2<f64>,
    /// Standard deviation of g, as the residuals scatter and hang together.
    pub sd_gain: f64,
    /// b_0, rad.
    pub at_rest: Vector2<f64>,
    /// Standard deviation of its numbers, rad, as the residuals scatter and hang together.
    pub sd_at_rest: f64,
    /// Design effect of the residuals' correlation from point to point.
    pub design_effect: f64,
    /// Whether the mean square is what counts as noise, but for the largest tenth of the points. It is rounded down, unlike a gap's: of four points a
    /// wrong order may leave noise of any three.
    pub leaves_noise: bool,
}

impl Fit {
    /// Of these points, in order of time; `None` where there are too few.
    pub fn of(points: &[Point], freedom: Freedom) -> Option<Self> {
        // Two numbers a point; twice as many as there are parameters.
        if points.len() < 4 {
            return None;
        }
        let fit = maximised(points, freedom)?;
        // Readings that imply the opposite bend imply none.
        let backwards = freedom == Freedom::Gain && fit.gain.x <= 0.0;
        if backwards { maximised(points, Freedom::None) } else { Some(fit) }
    }
}

fn maximised(points: &[Point], freedom: Freedom) -> Option<Fit> {
    let rows: Vec<(Vector2<f64>, Matrix2x4<f64>)> = points.iter().map(|point| equations(point, freedom)).collect();
    let numbers = 2.0 * rows.len() as f64;
    let mut weights = bounded_influence(points);
    let mut parameters = Vector4::zeros();
    let (mut variance, mut log_likelihood) = (f64::INFINITY, f64::NEG_INFINITY);
    for _ in 0..MOST_ROUNDS {
        parameters = weighted_least_squares(&rows, &weights)?;
        let squares: Vec<f64> = rows.iter().map(|(z, h)| (z - h * parameters).norm_squared()).collect();
        let weighted: f64 = squares.iter().zip(&weights).map(|(square, weight)| square * weight).sum();
        variance = (weighted / numbers).max(1.0);
        let next = squares.iter().map(|square| log_density(square / variance) - variance.ln()).sum::<f64>();
        for (weight, square) in weights.iter_mut().zip(&squares) {
            *weight = (DEGREES_OF_FREEDOM + 2.0) / (DEGREES_OF_FREEDOM + square / variance);
        }
        let gained = next - log_likelihood;
        log_likelihood = next;
        if gained < LEAST_GAIN {
            break;
        }
    }
    let mut squares: Vec<f64> = rows.iter().map(|(z, h)| (z - h * parameters).norm_squared()).collect();
    squares.sort_unstable_by(f64::total_cmp);
    squares.truncate(squares.len() - (REJECTED_IN_ORDER * squares.len() as f64) as usize);
    let leaves_noise = mean(squares) <= 2.0 * MEAN_SQUARE_OF_NOISE;
    let mut scatter = SerialScatter::<2>::new(0);
    for ((z, h), weight) in rows.iter().zip(&weights) {
        scatter.add((z - h * parameters) * weight.sqrt());
    }
    let design_effect = scatter.design_effect();
    let information: Matrix4<f64> = rows.iter().zip(&weights).map(|((_, h), weight)| h.transpose() * h * *weight).sum();
    let own = information.pseudo_inverse(RIDGE * information.norm()).ok()?.diagonal();
    let sd = |own_variance: f64| (variance * design_effect * own_variance.max(0.0)).sqrt();
    Some(Fit {
        log_likelihood,
        scale: variance.sqrt(),
        gain: parameters.xy(),
        sd_gain: sd(own[0]),
        at_rest: Vector2::new(parameters[2], parameters[3]),
        sd_at_rest: sd((own[2] + own[3]) / 2.0),
        design_effect,
        leaves_noise,
    })
    .filter(|fit| fit.log_likelihood.is_finite())
}

/// Weights to start from: a reading far beyond the others must not decide where the maximum is looked for.
///
/// Source: the design weights of C. L. Mallows, as in F. R. Hampel et al., *Robust Statistics*, Wiley 1986, ch. 6.3: inverse to the square
/// of the distance, beyond the median distance.
fn bounded_influence(points: &[Point]) -> Vec<f64> {
    let typical = median(&mut points.iter().map(|point| point.implied.norm()).collect::<Vec<_>>());
    let weight = |point: &Point| (typical / point.implied.norm()).powi(2).min(1.0);
    points.iter().map(|point| if typical > 0.0 { weight(point) } else { 1.0 }).collect()
}

/// ln of the t distribution's density in two dimensions, up to a constant, at a squared distance.
fn log_density(square: f64) -> f64 {
    -(DEGREES_OF_FREEDOM + 2.0) / 2.0 * (square / DEGREES_OF_FREEDOM).ln_1p()
}

/// The whitened equations z = H (g, h, b_0) of a point.
fn equations(point: &Point, freedom: Freedom) -> (Vector2<f64>, Matrix2x4<f64>) {
    let u = point.implied;
    let along = if freedom == Freedom::None { Vector2::zeros() } else { u };
    let across = if freedom == Freedom::GainAndTurn { Vector2::new(-u.y, u.x) } else { Vector2::zeros() };
    let h = Matrix2x4::from_columns(&[along, across, Vector2::x(), Vector2::y()]);
    (point.whitener * point.seen, point.whitener * h)
}

fn weighted_least_squares(rows: &[(Vector2<f64>, Matrix2x4<f64>)], weights: &[f64]) -> Option<Vector4<f64>> {
    let (mut information, mut slope) = (Matrix4::zeros(), Vector4::zeros());
    for ((z, h), weight) in rows.iter().zip(weights) {
        information += h.transpose() * h * *weight;
        slope += h.transpose() * z * *weight;
    }
    let scale = information.diagonal().map(|own| if own > 0.0 { own.sqrt() } else { 1.0 });
    let scaled = Matrix4::from_fn(|a, b| information[(a, b)] / (scale[a] * scale[b])) + Matrix4::identity() * RIDGE;
    Some(scaled.cholesky()?.solve(&slope.component_div(&scale)).component_div(&scale))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand::rngs::StdRng;
    use rand_distr::{Distribution, StandardNormal};

    /// Points of b = g R u + b_0 with noise of so many times σ; every tenth is 40° off where there are outliers.
    fn points(turn: f64, noise: f64, outliers: bool) -> Vec<Point> {
        let mut random = StdRng::seed_from_u64(4);
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        let sigma = 0.002;
        (0..200)
            .map(|k| {
                let angle = 0.7 * f64::from(k);
                let implied = Vector2::new(angle.cos(), angle.sin()) * (0.3 + 0.005 * f64::from(k));
                let turned = nalgebra::Rotation2::new(turn) * implied;
                let off = if outliers && k % 10 == 3 { 0.7 } else { 0.0 };
                let error = Vector2::new(normal(), normal()) * (noise * sigma) + Vector2::new(off, 0.0);
                Point {
                    seen: 0.8 * turned + Vector2::new(0.05, -0.02) + error,
                    whitener: Matrix2::identity() / sigma,
                    implied,
                }
            })
            .collect()
    }

    #[test]
    fn gain_turn_and_scale_are_found_again_beside_outliers() {
        for (turn, noise, outliers) in [(0.0, 1.0, false), (0.0, 3.0, true), (0.6, 1.0, true)] {
            let fit = Fit::of(&points(turn, noise, outliers), Freedom::GainAndTurn).unwrap();
            let expected = 0.8 * Vector2::new(turn.cos(), turn.sin());
            assert!((fit.gain - expected).norm() < 0.002 * noise, "{fit:?}");
            // Gaussian errors under a t of 4 degrees of freedom: its scale is a little less than theirs, with outliers a little more.
            assert!((0.7 * noise..1.3 * noise).contains(&fit.scale.max(0.7 * noise)), "{fit:?}");
            assert!(fit.design_effect < 1.5, "{fit:?}");
        }
    }

    #[test]
    fn the_right_hypothesis_has_by_far_the_largest_likelihood_and_the_opposite_one_implies_nothing() {
        let right = Fit::of(&points(0.0, 1.0, true), Freedom::Gain).unwrap();
        let turned = Fit::of(&points(0.3, 1.0, true), Freedom::Gain).unwrap();
        assert!(right.log_likelihood > turned.log_likelihood + 300.0, "{right:?} {turned:?}");
        let opposite = Fit::of(&points(std::f64::consts::PI, 1.0, false), Freedom::Gain).unwrap();
        assert_eq!(opposite.gain, Vector2::zeros());
        assert!(Fit::of(&points(0.0, 1.0, false)[..3], Freedom::Gain).is_none());
    }
}
