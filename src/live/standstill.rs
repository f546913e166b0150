//! Whether the encoders stand still while the snake moves: an encoder that lost its counter, a driver that repeats its last line.

use crate::estimate::{NEW_POSE, PlainSample};
use crate::observation::Measured;

/// Readings stand still that change by no more than so many standard deviations of a difference of two.
///
/// Derived: normal noise exceeds it once in 5·10⁸ differences.
const STILL_SDS: f64 = 6.0;
/// The bend is looked at once the readings have stood still for this time, s. Convention: longer than a picture is behind its encoders.
const SETTLE_S: f64 = 1.0;
/// Measurements that must have moved. Convention: one or two may be wrong, by a hand or a reflection in the picture.
const LEAST_MOVED: usize = 3;

/// Compares what readings and bends do.
#[derive(Debug, Clone)]
pub struct Standstill {
    still_mm: f64,
    /// The sample since which the readings stand still.
    since: Option<PlainSample>,
    /// Whether the bend has moved since, be it only because pictures come after their encoders.
    is_suspect: bool,
    /// The bend once they had settled.
    settled: Option<Measured>,
    moved: usize,
}

impl Standstill {
    /// Before the first reading, of this standard deviation, mm.
    pub fn new(sd_encoder_mm: f64) -> Self {
        let still_mm = STILL_SDS * 2f64.sqrt() * sd_encoder_mm;
        Self { still_mm, since: None, is_suspect: false, settled: None, moved: 0 }
    }

    /// Takes the next sample, and says whether the readings have moved.
    pub fn add(&mut self, sample: &PlainSample) -> bool {
        let is_still = |since: &PlainSample| (sample.q_mm - since.q_mm).amax() <= self.still_mm;
        let Some(since) = self.since.filter(is_still) else {
            *self = Self { since: Some(*sample), is_suspect: false, settled: None, moved: 0, ..*self };
            return true;
        };
        // A clock that was set back begins anew.
        let since_s = since.time_s.min(sample.time_s);
        self.since = Some(PlainSample { time_s: since_s, ..since });
        self.is_suspect |= has_moved(&since.measured, &sample.measured);
        if sample.time_s - since_s >= SETTLE_S {
            let settled = self.settled.get_or_insert(sample.measured);
            self.moved += usize::from(has_moved(settled, &sample.measured));
        }
        false
    }

    /// Whether the snake may have moved while the readings stood still: too early to tell, and too late to trust what is learned.
    pub fn is_suspect(&self) -> bool {
        self.is_suspect
    }

    /// Whether the snake moved while the readings stood still.
    pub fn is_stuck(&self) -> bool {
        self.moved >= LEAST_MOVED
    }
}

/// Whether two bends differ by a pose, and by more than their errors.
fn has_moved(from: &Measured, to: &Measured) -> bool {
    let step = to.configuration.bend_vector() - from.configuration.bend_vector();
    step.norm() >= NEW_POSE && from.has_moved(to)
}
