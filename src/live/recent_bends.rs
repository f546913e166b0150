//! The latest measured bends with their times, from which the lag between picture and encoders is estimated.

use nalgebra::Vector2;
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Bends kept: at least 18 s of motion. Convention: a resource limit; more of them cost time and hardly sharpen the lag.
const MAX_BENDS: usize = 600;
/// Least time between two of them, s. Convention: a frame of a camera of 30 frames/s.
const MIN_STEP_S: f64 = 0.03;

/// Bend vectors, rad, with their times, s, oldest first.
#[derive(Debug, Default)]
pub struct RecentBends(Mutex<VecDeque<(f64, Vector2<f64>)>>);

impl RecentBends {
    /// Adds a bend, unless it comes too soon after the last.
    pub fn add(&self, time_s: f64, bend: Vector2<f64>) {
        let mut bends = self.lock();
        if bends.back().is_none_or(|(last_s, _)| time_s - last_s >= MIN_STEP_S) {
            if bends.len() == MAX_BENDS {
                bends.pop_front();
            }
            bends.push_back((time_s, bend));
        }
    }

    /// A copy of them.
    pub fn copy(&self) -> Vec<(f64, Vector2<f64>)> {
        self.lock().iter().copied().collect()
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<(f64, Vector2<f64>)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bends_are_spaced_and_the_oldest_make_room() {
        let bends = RecentBends::default();
        (0..2000).for_each(|k| bends.add(f64::from(k) / 60.0, Vector2::new(f64::from(k), 0.0)));
        let kept = bends.copy();
        assert_eq!(kept.len(), MAX_BENDS);
        assert!(kept.windows(2).all(|pair| pair[1].0 - pair[0].0 >= MIN_STEP_S));
        assert_eq!(kept.last().unwrap().1.x, 1998.0);
    }
}
