//! Whether the gap between model and measurements has left the noise.
//!
//! Where the model holds, the innovations divided by their predicted standard deviations are standard normal. Three CUSUM tests
//! ([`Cusum`]) watch them: the mean square of the bending part (two degrees of freedom), that of the part common to all backbones
//! (one), and the share of measurements that the gate rejects.
//!
//! The tests take independent values, but the error of a measured bend hardly changes while the snake stands still. So a measurement is taken only
//! once the snake has moved on from the last one taken, and the design figures count such poses. With 10⁶ poses between false alarms
//! by Lorden's bound (10⁷ for the bending part by Brook and Evans' Markov chain), the mean delay is
//!
//! | test | change | alarm after | and back to noise after |
//! | --- | --- | --- | --- |
//! | bending | mean square 2.5 | 25 poses | 43 poses |
//! | bending | mean square 4 | 11 poses | 43 poses |
//! | common | mean square 2.5 | 49 poses | 86 poses |
//! | rejections | 30 % | 88 poses | |
//!
//! (Monte-Carlo with independent values; tested in `cusum.rs`.)

use super::cusum::{Cusum, event_log_ratio, variance_log_ratio};
use super::publication::POSES;
use super::status::{GapState, GapStatus};
use crate::estimate::{Consistency, NewPoses, Verdict, Whitened};
use crate::verdict::{MEAN_SQUARE_OF_NOISE, REJECTED_IN_ORDER};
use nalgebra::Vector2;
use std::collections::VecDeque;

/// Mean number of poses between two false alarms of each test. Convention: a false alarm costs one needless search of
/// `discover`; at ten new poses a second each test gives one in 28 hours.
const POSES_BETWEEN_FALSE_ALARMS: f64 = 1e6;
/// Share of rejected measurements that is to be found.
///
/// Convention: three times the share that may be rejected although all is in order.
const REJECTED_TOO_MANY: f64 = 0.3;
/// Measurements over which the share of rejected ones is shown. Convention: a display choice.
const RECENT: usize = 100;

/// Watches the innovations.
#[derive(Debug, Clone)]
pub struct GapMonitor {
    bending: Cusum,
    common: Cusum,
    rejections: Cusum,
    used: usize,
    poses: NewPoses,
    recent_rejected: VecDeque<bool>,
}

impl Default for GapMonitor {
    fn default() -> Self {
        let cusum = Cusum::new(POSES_BETWEEN_FALSE_ALARMS);
        Self {
            bending: cusum,
            common: cusum,
            rejections: cusum,
            used: 0,
            poses: NewPoses::default(),
            recent_rejected: VecDeque::new(),
        }
    }
}

impl GapMonitor {
    /// Takes what became of a measurement: the bend vector (rad) that its encoders imply, the estimator's verdict and innovation, and
    /// the innovations' running mean squares.
    pub fn add(
        &mut self,
        pose: Option<Vector2<f64>>,
        verdict: Verdict,
        innovation: Option<&Whitened>,
        consistency: Option<&Consistency>,
    ) -> GapStatus {
        if verdict != Verdict::Skipped {
            self.used += usize::from(verdict == Verdict::Used);
            if self.recent_rejected.len() == RECENT {
                self.recent_rejected.pop_front();
            }
            self.recent_rejected.push_back(verdict == Verdict::Rejected);
            if pose.is_some_and(|pose| self.poses.is_new(pose)) {
                self.test(verdict, innovation);
            }
        }
        let rejected = self.recent_rejected.iter().filter(|&&rejected| rejected).count() as f64 / RECENT as f64;
        let (bending, common) = consistency.map_or((1.0, 1.0), |c| (c.bending_chi_square(), c.common_chi_square()));
        GapStatus { state: self.state(), bending, common, rejected }
    }

    fn test(&mut self, verdict: Verdict, innovation: Option<&Whitened>) {
        let rejected = verdict == Verdict::Rejected;
        self.rejections.add(event_log_ratio(rejected, REJECTED_IN_ORDER, REJECTED_TOO_MANY));
        // What is rejected is an outlier, and says nothing of the others' scatter.
        if let Some(innovation) = innovation.filter(|_| !rejected) {
            self.bending.add(variance_log_ratio(innovation.bending.norm_squared(), 2.0, MEAN_SQUARE_OF_NOISE));
            self.common.add(variance_log_ratio(innovation.common.powi(2), 1.0, MEAN_SQUARE_OF_NOISE));
        }
    }

    fn state(&self) -> GapState {
        let tests = [self.bending, self.common, self.rejections];
        match tests.iter().any(Cusum::is_changed) {
            _ if self.used < POSES && !self.rejections.is_changed() => GapState::Unknown,
            true => GapState::Above,
            false => GapState::Noise,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::NEW_POSE;
    use rand::SeedableRng;
    use rand::rngs::StdRng;
    use rand_distr::{Distribution, StandardNormal};

    /// A monitor that sees innovations of a variance, and the snake moving by this much at each, rad.
    struct Scenario {
        monitor: GapMonitor,
        random: StdRng,
        theta: f64,
    }

    impl Scenario {
        fn new() -> Self {
            Self { monitor: GapMonitor::default(), random: StdRng::seed_from_u64(11), theta: 0.0 }
        }

        fn see(&mut self, count: usize, step: f64, variance: f64) -> GapState {
            let mut state = GapState::Unknown;
            for _ in 0..count {
                self.theta += step;
                let [x, y, common] = [(); 3].map(|()| {
                    let standard: f64 = StandardNormal.sample(&mut self.random);
                    variance.sqrt() * standard
                });
                let innovation = Whitened { bending: Vector2::new(x, y), common };
                let pose = Some(Vector2::new(self.theta, 0.0));
                state = self.monitor.add(pose, Verdict::Used, Some(&innovation), None).state;
            }
            state
        }

        fn reject(&mut self, count: usize, step: f64) -> GapState {
            let mut state = GapState::Unknown;
            for _ in 0..count {
                self.theta += step;
                state = self.monitor.add(Some(Vector2::new(self.theta, 0.0)), Verdict::Rejected, None, None).state;
            }
            state
        }
    }

    #[test]
    fn noise_is_noise_and_a_gap_is_found_within_a_hundred_poses() {
        let mut scenario = Scenario::new();
        assert_eq!(scenario.see(POSES - 1, NEW_POSE, 1.0), GapState::Unknown);
        assert_eq!(scenario.see(20_000, NEW_POSE, 1.0), GapState::Noise);
        assert_eq!(scenario.see(2000, NEW_POSE, 1.3), GapState::Noise, "sigmas slightly too small are no gap");
        assert_eq!(scenario.see(100, NEW_POSE, MEAN_SQUARE_OF_NOISE), GapState::Above);
        assert_eq!(scenario.see(400, NEW_POSE, 1.0), GapState::Noise);
    }

    #[test]
    fn an_error_that_stands_still_with_the_snake_is_counted_once() {
        let mut scenario = Scenario::new();
        scenario.see(POSES, NEW_POSE, 1.0);
        assert_eq!(scenario.see(10_000, 0.0, 9.0), GapState::Noise);
        assert_eq!(scenario.see(60, NEW_POSE, 9.0), GapState::Above);
    }

    #[test]
    fn rejections_in_numbers_raise_an_alarm() {
        let mut scenario = Scenario::new();
        scenario.see(POSES, NEW_POSE, 1.0);
        assert_eq!(scenario.reject(1000, 0.0), GapState::Noise, "at one pose");
        assert_eq!(scenario.reject(20, NEW_POSE), GapState::Above);
        let shown = scenario.monitor.add(None, Verdict::Skipped, None, None);
        assert_eq!((shown.state, shown.rejected), (GapState::Above, 1.0));
        assert_eq!(scenario.see(200, NEW_POSE, 1.0), GapState::Noise);
    }
}
