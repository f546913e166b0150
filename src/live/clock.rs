//! Two clocks: the frames' and the encoders'.
//!
//! A reading carries the encoders' time, and arrives at a time of the frames' clock. The least difference of the two over some
//! seconds is the offset between the clocks plus the quickest line's delay. Where it is small the clocks are one; where not,
//! the encoders have a clock of their own and the difference is taken off. Lines that come in a burst, as a file that was
//! complete beforehand, tell nothing of it.
//!
//! [`motion_lag`] tells the rest from the motion itself: by how much the picture is behind the encoders.

use nalgebra::{Matrix3, Matrix3x2, Vector2, Vector3};
use serde::Serialize;
use std::sync::{Mutex, PoisonError};

/// The frames' clock, as the source starts it.
#[derive(Debug, Default)]
pub struct FrameClock(Mutex<Option<f64>>);

impl FrameClock {
    /// Says that it is `time_s` now.
    pub fn set(&self, time_s: f64) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(super::source::unix_time_s() - time_s);
    }

    /// The time now, s; `None` before the first frame of a recording.
    pub fn now_s(&self) -> Option<f64> {
        let behind = *self.0.lock().unwrap_or_else(PoisonError::into_inner);
        behind.map(|behind| super::source::unix_time_s() - behind)
    }
}

/// What is known about the encoders' clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ClockState {
    /// Nothing yet.
    Unknown,
    /// The same as the frames', as far as can be told.
    Shared,
    /// One of its own; the offset is estimated.
    Foreign,
    /// The offset was given.
    Given,
}

/// Differences below this are a line's delay, not another clock, s.
const SHARED_WITHIN_S: f64 = 0.25;
/// Over this time the least difference is taken, s; twice as long while a window fills.
const WINDOW_S: f64 = 10.0;

/// Estimates by how much the encoders' clock is behind the frames'.
#[derive(Debug)]
pub struct Offset {
    given: Option<f64>,
    current: Option<Window>,
    last: Option<Window>,
}

#[derive(Debug, Clone, Copy)]
struct Window {
    first_arrival_s: f64,
    first_stamp_s: f64,
    arrival_s: f64,
    stamp_s: f64,
    least_s: f64,
}

impl Window {
    /// Whether lines came about as fast as they were stamped.
    fn is_paced(&self) -> bool {
        self.stamp_s - self.first_stamp_s < 1.5 * (self.arrival_s - self.first_arrival_s) + 0.5
    }
}

impl Offset {
    /// Nothing known, or an offset to take as it is, s.
    pub fn new(given: Option<f64>) -> Self {
        Self { given, current: None, last: None }
    }

    /// A line with this stamp came at this time of the frames' clock.
    pub fn observe(&mut self, stamp_s: f64, arrival_s: f64) {
        if let Some(window) = &mut self.current
            && arrival_s - window.first_arrival_s < WINDOW_S
        {
            window.arrival_s = arrival_s;
            window.stamp_s = stamp_s;
            window.least_s = window.least_s.min(arrival_s - stamp_s);
            return;
        }
        self.last = self.current.filter(Window::is_paced);
        self.current = Some(Window {
            first_arrival_s: arrival_s,
            first_stamp_s: stamp_s,
            arrival_s,
            stamp_s,
            least_s: arrival_s - stamp_s,
        });
    }

    /// The state, and what to add to a stamp to have the frames' time, s.
    pub fn estimate(&self) -> (ClockState, f64) {
        if let Some(given) = self.given {
            return (ClockState::Given, given);
        }
        let paced = [self.current.filter(Window::is_paced), self.last];
        let least = paced.iter().flatten().map(|window| window.least_s).reduce(f64::min);
        match (least, self.current) {
            (Some(least), _) if least.abs() > SHARED_WITHIN_S => (ClockState::Foreign, least),
            (_, Some(_)) => (ClockState::Shared, 0.0),
            (_, None) => (ClockState::Unknown, 0.0),
        }
    }
}

/// By how much the picture is behind the encoders.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Lag {
    /// Seconds; positive where the picture is late.
    pub seconds: f64,
    /// Its standard deviation, s.
    pub sd: f64,
}

/// Lags that are tried, s, and the step between them.
const MOST_LAG_S: f64 = 0.6;
const LAG_STEP_S: f64 = 0.02;
/// A lag less well known than this is none, s.
const MOST_SD_S: f64 = 0.02;

/// The lag at which the measured bends (with their times) are nearest to a linear function of the readings' bends.
///
/// `at` interpolates Q⁺q̃ at a time. `None` where the motion is too little or too even to tell.
pub fn motion_lag(bends: &[(f64, Vector2<f64>)], at: impl Fn(f64) -> Option<Vector2<f64>>) -> Option<Lag> {
    const LEAST: usize = 60;
    let steps = (MOST_LAG_S / LAG_STEP_S).round() as i32;
    // Only times that all lags can be tried at, so that all are judged by the same measurements.
    let inside = |t: f64| at(t - MOST_LAG_S).is_some() && at(t + MOST_LAG_S).is_some();
    let bends: Vec<_> = bends.iter().filter(|(t, _)| inside(*t)).collect();
    if bends.len() < LEAST {
        return None;
    }
    let cost = |lag: f64| -> Option<f64> {
        let (mut uu, mut ub, mut bb) = (Matrix3::zeros(), Matrix3x2::zeros(), 0.0);
        for (t, bend) in &bends {
            let u = at(t - lag)?;
            let u = Vector3::new(u.x, u.y, 1.0);
            uu += u * u.transpose();
            ub += u * bend.transpose();
            bb += bend.norm_squared();
        }
        // A little of the identity where all motion lies in one plane.
        let fit = (uu + Matrix3::identity() * 1e-9).cholesky()?.solve(&ub);
        Some((bb - fit.dot(&ub)).max(0.0))
    };
    let costs: Vec<f64> = (-steps..=steps).map(|k| cost(f64::from(k) * LAG_STEP_S)).collect::<Option<_>>()?;
    let best = (1..costs.len() - 1).min_by(|&a, &b| costs[a].total_cmp(&costs[b]))?;
    let [before, least, after] = [costs[best - 1], costs[best], costs[best + 1]];
    let curvature = (before - 2.0 * least + after) / LAG_STEP_S.powi(2);
    if !(curvature > 0.0 && before >= least && after >= least) {
        return None;
    }
    let step = (before - after) / (2.0 * LAG_STEP_S) / curvature;
    let variance = least / (2.0 * bends.len() as f64 - 6.0);
    let sd = (2.0 * variance / curvature).sqrt();
    (sd < MOST_SD_S).then_some(Lag { seconds: (best as i32 - steps) as f64 * LAG_STEP_S + step, sd })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// Lines at 200 Hz whose clock is behind by `offset` and that take 1 to 30 ms.
    fn observed(offset: f64, drift: f64) -> Offset {
        let mut random = rand::rngs::StdRng::seed_from_u64(1);
        let mut clock = Offset::new(None);
        for k in 0..6000 {
            let true_s = 1000.0 + f64::from(k) / 200.0;
            clock.observe(true_s * (1.0 + drift) - offset, true_s + random.random_range(0.001..0.03));
        }
        clock
    }

    #[test]
    fn a_shared_clock_is_left_alone_and_a_foreign_one_found() {
        assert_eq!(observed(0.0, 0.0).estimate(), (ClockState::Shared, 0.0));
        for offset in [-0.5, 3.25, 1_760_000_000.0] {
            let (state, found) = observed(offset, 0.0).estimate();
            assert_eq!(state, ClockState::Foreign);
            assert!((found - offset - 0.001).abs() < 2e-3, "{found} for {offset}");
        }
    }

    #[test]
    fn a_burst_of_old_lines_says_nothing_about_the_clock() {
        let mut clock = Offset::new(None);
        for k in 0..10_000 {
            clock.observe(f64::from(k) / 100.0, 5.0 + f64::from(k) * 1e-6);
        }
        assert_eq!(clock.estimate().0, ClockState::Shared);
        // What then comes as it happens does.
        for k in 10_000..14_000 {
            let stamp = f64::from(k) / 100.0;
            clock.observe(stamp, stamp + 50.0);
        }
        let (state, found) = clock.estimate();
        assert_eq!(state, ClockState::Foreign);
        assert!((found - 50.0).abs() < 1e-6);
    }

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
        let still: Vec<_> = (0..600).map(|k| (f64::from(k) / 30.0, Vector2::new(0.3, 0.1))).collect();
        assert_eq!(motion_lag(&still, |_| Some(Vector2::new(0.3, 0.1))), None);
    }
}
