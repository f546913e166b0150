//! The bending experiment: where the snake is led, and when.

use crate::error::{ArgumentError, Result};
use crate::geometry::Configuration;
use crate::observation::Waypoint;
use crate::robot::MAX_THETA;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

/// The most poses of an experiment. Convention: a resource limit, a day at a hundred a second.
const MOST_POSES: usize = 10_000_000;

/// The paper's bending experiment: sweeps of θ up and down at fixed δ (its Fig. 10), then δ once round at a fixed θ (Fig. 11).
#[derive(Debug, Clone, PartialEq)]
pub struct BendingExperiment {
    /// δ of each sweep, degrees.
    pub sweep_delta_deg: Vec<f64>,
    /// Least and largest θ of a sweep, degrees.
    pub sweep_theta_deg: (f64, f64),
    /// Poses on the way up, and as many down.
    pub sweep_poses: usize,
    /// θ of the round, degrees.
    pub round_theta_deg: f64,
    /// Poses of the round; 0 for no round.
    pub round_poses: usize,
    /// Mean time from one pose to the next, s. The pace is uneven, by ± 40 %, so that what depends on speed can be told
    /// from what depends on time.
    pub interval_s: f64,
    /// Standard deviation by which θ and δ of the poses miss their nominal values, degrees.
    pub jitter_deg: f64,
    /// Seed of the jitter.
    pub seed: u64,
}

impl Default for BendingExperiment {
    /// 36 poses: θ 5 → 76 → 5° at δ = 0° and at 120° in six steps each, then twelve poses round at θ = 30°.
    fn default() -> Self {
        Self {
            sweep_delta_deg: vec![0.0, 120.0],
            sweep_theta_deg: (5.0, 76.0),
            sweep_poses: 6,
            round_theta_deg: 30.0,
            round_poses: 12,
            interval_s: 0.35,
            jitter_deg: 0.0,
            seed: 1,
        }
    }
}

impl BendingExperiment {
    /// The poses in order of time.
    ///
    /// # Errors
    /// [`ArgumentError`] for angles outside the workspace, no poses at all, or an interval that is not positive.
    pub fn waypoints(&self) -> Result<Vec<Waypoint>> {
        self.check()?;
        let (least, largest) = self.sweep_theta_deg;
        let last = (self.sweep_poses.max(2) - 1) as f64;
        let up = (0..self.sweep_poses).map(|k| least + (largest - least) * k as f64 / last);
        let there_and_back: Vec<f64> = up.clone().chain(up.rev()).collect();
        let sweeps =
            self.sweep_delta_deg.iter().flat_map(|&delta| there_and_back.iter().map(move |&theta| (theta, delta)));
        let round = (0..self.round_poses).map(|k| (self.round_theta_deg, 360.0 * k as f64 / self.round_poses as f64));

        let mut random = StdRng::seed_from_u64(self.seed);
        let mut time_s = 0.0;
        let waypoints = sweeps.chain(round).enumerate().map(|(k, (theta_deg, delta_deg))| {
            time_s += self.interval_s * (1.0 + 0.4 * (0.7 * k as f64).sin());
            let mut jitter_deg = || -> f64 { self.jitter_deg * random.sample::<f64, _>(StandardNormal) };
            let theta = (theta_deg + jitter_deg()).to_radians().clamp(0.0, MAX_THETA);
            let delta = (delta_deg + jitter_deg()).to_radians();
            Waypoint::new(time_s, Configuration::new(theta, delta))
        });
        Ok(waypoints.collect())
    }

    fn check(&self) -> Result<()> {
        let out_of_range = |quantity: &str, value, unit, expected: &str| {
            Err(ArgumentError::out_of_range(quantity, value, unit, expected).into())
        };
        let of_sweeps = self.sweep_poses.saturating_mul(2).saturating_mul(self.sweep_delta_deg.len());
        let poses = of_sweeps.saturating_add(self.round_poses);
        if poses > MOST_POSES {
            return out_of_range("number of poses", poses as f64, "", &format!("at most {MOST_POSES}"));
        }
        let workspace = 0.0..=MAX_THETA.to_degrees() + 1e-9;
        let (least, largest) = self.sweep_theta_deg;
        for (name, theta_deg) in [("least θ", least), ("largest θ", largest), ("θ of the round", self.round_theta_deg)]
        {
            if !workspace.contains(&theta_deg) {
                return out_of_range(name, theta_deg, "°", &format!("0 to {:.0}", workspace.end()));
            }
        }
        if let Some(delta_deg) = self.sweep_delta_deg.iter().find(|delta| !delta.is_finite()) {
            return out_of_range("δ of a sweep", *delta_deg, "", "a number of degrees");
        }
        if self.sweep_delta_deg.len() * self.sweep_poses + self.round_poses == 0 {
            return Err(ArgumentError::NoPoses.into());
        }
        if !(self.interval_s > 0.0 && self.interval_s.is_finite()) {
            return out_of_range("the interval", self.interval_s, " s", "more than 0");
        }
        if !(0.0..=30.0).contains(&self.jitter_deg) {
            return out_of_range("the jitter", self.jitter_deg, "°", "0 to 30");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sweeps_go_up_and_down_and_the_round_goes_round() {
        let waypoints = BendingExperiment::default().waypoints().unwrap();
        assert_eq!(waypoints.len(), 36);
        let theta: Vec<f64> = waypoints.iter().map(|w| w.configuration.theta_deg()).collect();
        assert!((theta[0] - 5.0).abs() < 1e-9 && (theta[5] - 76.0).abs() < 1e-9 && (theta[11] - 5.0).abs() < 1e-9);
        assert!((waypoints[12].configuration.delta_deg() - 120.0).abs() < 1e-9);
        assert!((waypoints[35].configuration.delta_deg() + 30.0).abs() < 1e-9);
        assert!(waypoints.windows(2).all(|pair| pair[1].time_s > pair[0].time_s));
    }

    #[test]
    fn the_same_seed_gives_the_same_jitter_and_another_another() {
        let of = |seed| BendingExperiment { jitter_deg: 2.0, seed, ..Default::default() }.waypoints().unwrap();
        assert_eq!(of(7), of(7));
        assert_ne!(of(7), of(8));
        assert!(of(7).iter().all(|w| w.configuration.theta <= MAX_THETA));
    }

    #[test]
    fn what_cannot_be_is_an_error() {
        let good = BendingExperiment::default();
        for bad in [
            BendingExperiment { sweep_theta_deg: (5.0, 130.0), ..good.clone() },
            BendingExperiment { round_theta_deg: f64::NAN, ..good.clone() },
            BendingExperiment { sweep_poses: 0, round_poses: 0, ..good.clone() },
            BendingExperiment { interval_s: 0.0, ..good.clone() },
            BendingExperiment { jitter_deg: -1.0, ..good.clone() },
        ] {
            assert!(matches!(bad.waypoints(), Err(crate::Error::Argument(_))), "{bad:?}");
        }
    }
}
