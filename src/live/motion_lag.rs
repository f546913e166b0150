//! By how much the picture is behind the encoders, from the motion that both show.
//!
//! For each lag on a grid the measured bends are fitted, by least squares, with a linear function of the readings' bends taken
//! that much earlier. The lag with the least sum of squares, refined by the parabola through its neighbours, is the answer; the
//! parabola's curvature gives its standard deviation.

use super::status::Lag;
use nalgebra::{Matrix3, Matrix3x2, Vector2};

/// Lags from −this to +this are tried, s. Convention: longer than any camera or network delays a frame that is still of use.
const MAX_LAG_S: f64 = 0.6;
/// Step between the lags that are tried, s. Convention: the parabola finds the place between two of them.
const STEP_S: f64 = 0.02;
/// A lag with a larger standard deviation is not told, s. Convention: a display choice, one step.
const MAX_SD_S: f64 = STEP_S;
/// Readings that leave more than this share of the motion's squares are of another time.
///
/// Convention: a tenth; a play of a tenth of the travel leaves a hundredth.
const MOST_LEFT: f64 = 0.1;
/// Fewer measured bends tell nothing. Convention: ten for each of the six numbers that are fitted.
const MIN_BENDS: usize = 60;
/// Parameters of the linear function: three for each of the two components of the bend.
///
/// Convention: a count.
const PARAMETERS: f64 = 6.0;
/// Added to the diagonal of the normal equations, rad², where all motion lies in one plane. Convention: a numerical guard.
const RIDGE: f64 = 1e-9;

/// The lag at which the measured bends (times in s, bend vectors in rad) are nearest to a linear function of the readings' bends.
///
/// `at` interpolates the bend vector Q⁺q̃ at a time. `None` where the motion is too little or too even to tell.
pub fn motion_lag(bends: &[(f64, Vector2<f64>)], mut at: impl FnMut(f64) -> Option<Vector2<f64>>) -> Option<Lag> {
    // Only times at which every lag can be tried, so that all lags are compared on the same measurements.
    let mut inside = |t: f64| at(t - MAX_LAG_S).is_some() && at(t + MAX_LAG_S).is_some();
    let bends: Vec<_> = bends.iter().copied().filter(|(t, _)| inside(*t)).collect();
    if bends.len() < MIN_BENDS {
        return None;
    }
    let steps = (MAX_LAG_S / STEP_S).round() as i32;
    let squares = (-steps..=steps).map(|k| sum_of_squares(&bends, |t| at(t - f64::from(k) * STEP_S)));
    let squares: Vec<f64> = squares.collect::<Option<_>>()?;
    let best = (1..squares.len() - 1).min_by(|&a, &b| squares[a].total_cmp(&squares[b]))?;
    let [before, least, after] = [squares[best - 1], squares[best], squares[best + 1]];
    let curvature = (before - 2.0 * least + after) / STEP_S.powi(2);
    if !(curvature > 0.0 && before >= least && after >= least) {
        return None;
    }
    // Readings that are more than the largest lag away fit at some lag by chance.
    let mean = bends.iter().map(|(_, bend)| bend).sum::<Vector2<f64>>() / bends.len() as f64;
    let motion: f64 = bends.iter().map(|(_, bend)| (bend - mean).norm_squared()).sum();
    if least > MOST_LEFT * motion {
        return None;
    }
    let from_best = (before - after) / (2.0 * STEP_S) / curvature;
    let variance = least / (2.0 * bends.len() as f64 - PARAMETERS);
    let sd = (2.0 * variance / curvature).sqrt();
    (sd < MAX_SD_S).then_some(Lag { seconds: f64::from(best as i32 - steps) * STEP_S + from_best, sd })
}

/// What the best linear function of the readings' bends leaves of the measured ones, rad².
fn sum_of_squares(bends: &[(f64, Vector2<f64>)], mut reading: impl FnMut(f64) -> Option<Vector2<f64>>) -> Option<f64> {
    let (mut uu, mut ub, mut bb) = (Matrix3::zeros(), Matrix3x2::zeros(), 0.0);
    for (t, bend) in bends {
        let u = reading(*t)?.push(1.0);
        uu += u * u.transpose();
        ub += u * bend.transpose();
        bb += bend.norm_squared();
    }
    let fit = (uu + Matrix3::identity() * RIDGE).cholesky()?.solve(&ub);
    Some((bb - fit.dot(&ub)).max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn the_motion_tells_the_cameras_lag() {
        let path = |t: f64| Vector2::new(0.8 * (0.9 * t).sin(), 0.5 * (0.6 * t + 1.0).cos());
        let mut random = rand::rngs::StdRng::seed_from_u64(2);
        for lag in [0.0, 0.083, -0.21] {
            let bends: Vec<_> = (0..600)
                .map(|k| {
                    let t = f64::from(k) / 30.0;
                    let noise = Vector2::new(random.random_range(-1e-3..1e-3), random.random_range(-1e-3..1e-3));
                    (t, path(t - lag) * 0.9 + noise)
                })
                .collect();
            let found = motion_lag(&bends, |t| Some(path(t))).unwrap();
            assert!((found.seconds - lag).abs() < (4.0 * found.sd).max(1e-3), "{found:?} for {lag}");
            assert!(found.sd < 0.002);
        }
        // Readings of another part of the motion: at some lag of the grid they fit best, and it means nothing.
        let bends: Vec<_> = (0..600).map(|k| (f64::from(k) / 30.0, path(f64::from(k) / 30.0))).collect();
        assert_eq!(motion_lag(&bends, |t| Some(path(t - 2.0))), None);
        let still: Vec<_> = (0..600).map(|k| (f64::from(k) / 30.0, Vector2::new(0.3, 0.1))).collect();
        assert_eq!(motion_lag(&still, |_| Some(Vector2::new(0.3, 0.1))), None);
    }
}
