//! The snake's own tilt, out of the plane parallel to the grid: what a jig leaves of it, and what light adds to what edges show.

use super::placement::{Placement, TILT};
use nalgebra::DMatrix;
use std::f64::consts::PI;

/// How far the snake may be from parallel to the grid, rad (1σ): in a jig that was made for it, and where an eye set it. Either is as likely.
///
/// Convention: a jig's precision, 0.05 mm over the snake's length; and half a millimetre.
pub const TILT_SIGMAS: [f64; 2] = [0.1 * PI / 180.0, 1.0 * PI / 180.0];
/// How far from its own tilt the light on the disks' faces makes a straight snake seem tilted, rad (1σ): all faces are seen at nearly the same
/// glancing angle, so that no number of disks averages it away. Bent snakes, whose faces are seen at many angles, do not share it.
///
/// Fitted: by maximum likelihood to the seventeen photo-real rigs of even number, whose snakes are parallel to the grid and seemed tilted by
/// 0.106° (rms) where edges said 0.06°; their log-likelihood grows by 12. Judged by the thirteen of odd number: it grows by 36, and is
/// largest at the same value.
const SEEMING_TILT_SIGMA: f64 = 0.085 * PI / 180.0;

/// How far from parallel a snake may seem before its edges are asked, rad (1σ): in the wider jig, and with what light adds.
pub fn seeming_tilt_sigma() -> f64 {
    TILT_SIGMAS[1].hypot(SEEMING_TILT_SIGMA)
}

/// A placement whose tilt is what the edges show, and its covariance, with the tilt that the snake itself has: mean and variance of the
/// mixture of what either jig would have, each as likely as the tilt that is shown makes it. Of what edges show a part is light's doing.
pub fn of_its_own_tilt(seeming: &Placement, covariance: DMatrix<f64>) -> (Placement, DMatrix<f64>) {
    let shown = seeming.tilt();
    // The fit knew the wider jig's variance.
    let known = seeming_tilt_sigma().powi(2);
    let fitted = covariance[(TILT, TILT)];
    let (shown, noise) = if fitted < known {
        let edges = fitted * known / (known - fitted);
        (shown * (edges + known) / known, edges + SEEMING_TILT_SIGMA.powi(2))
    } else {
        (0.0, f64::INFINITY)
    };
    let jigs = TILT_SIGMAS.map(|sigma| {
        let (own, all) = (sigma * sigma, sigma * sigma + noise);
        let weight = if all.is_finite() { (-0.5 * shown * shown / all).exp() / all.sqrt() } else { 1.0 };
        let share = if all.is_finite() { own / all } else { 0.0 };
        (weight, share * shown, own - share * own)
    });
    let total: f64 = jigs.iter().map(|(weight, ..)| weight).sum();
    let mean = jigs.iter().map(|(weight, mean, _)| weight * mean).sum::<f64>() / total;
    let variance =
        jigs.iter().map(|(weight, own, variance)| weight * (variance + (own - mean).powi(2))).sum::<f64>() / total;
    // The rest of the placement goes with the tilt as it went with the one that was fitted.
    let share = if seeming.tilt() == 0.0 { 0.0 } else { mean / seeming.tilt() };
    let mut by_seeming = DMatrix::identity(covariance.nrows(), covariance.ncols());
    by_seeming[(TILT, TILT)] = share;
    let mut own = seeming.0.clone();
    own[TILT] = mean;
    let mut covariance = &by_seeming * covariance * &by_seeming;
    covariance[(TILT, TILT)] = variance;
    (Placement(own), covariance)
}

#[cfg(test)]
mod tests {
    use super::super::placement::PLACEMENT;
    use super::*;
    use nalgebra::DVector;

    /// Against sums over a grid of tilts: the snake's own, of either jig, light's and the edges' noise.
    #[test]
    fn of_a_tilt_that_edges_show_the_snakes_own_part_is_what_bayes_says() {
        let degree = PI / 180.0;
        let noise = 0.05 * degree;
        for shown_deg in [-0.8, 0.05, 0.2, 0.4, 0.9] {
            let shown = shown_deg * degree;
            let normal = |x: f64, variance: f64| (-0.5 * x * x / variance).exp() / variance.sqrt();
            let prior = |t: f64| TILT_SIGMAS.iter().map(|sigma| normal(t, sigma * sigma)).sum::<f64>();
            let likelihood = |t: f64| normal(shown - t, SEEMING_TILT_SIGMA.powi(2) + noise * noise);
            let tilts: Vec<f64> = (-4000..=4000).map(|k| f64::from(k) * 1e-3 * degree).collect();
            let sum =
                |value: &dyn Fn(f64) -> f64| tilts.iter().map(|&t| value(t) * prior(t) * likelihood(t)).sum::<f64>();
            let mean = sum(&|t| t) / sum(&|_| 1.0);
            let variance = sum(&|t| (t - mean).powi(2)) / sum(&|_| 1.0);
            // What the fit of the seeming tilt makes of it, whose prior has the wider jig's and light's variance.
            let known = TILT_SIGMAS[1].powi(2) + SEEMING_TILT_SIGMA.powi(2);
            let seeming = known / (known + noise * noise);
            let mut placement = DVector::zeros(PLACEMENT);
            (placement[0], placement[TILT]) = (3.0, seeming * shown);
            let mut covariance = DMatrix::zeros(PLACEMENT, PLACEMENT);
            (covariance[(0, 0)], covariance[(TILT, TILT)]) = (1.0, seeming * noise * noise);
            let (placement, covariance) = of_its_own_tilt(&Placement(placement), covariance);
            assert!((placement.tilt() - mean).abs() < 1e-3 * degree, "{shown_deg}: {} for {mean}", placement.tilt());
            assert!((covariance[(TILT, TILT)] / variance - 1.0).abs() < 0.02, "{shown_deg}");
            assert_eq!((placement.0[0], covariance[(0, 0)]), (3.0, 1.0));
        }
    }
}
