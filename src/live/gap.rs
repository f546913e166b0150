//! The watch on the gap between model and measurements, and what is kept for `discover` to look at.

use crate::estimate::{Consistency, Verdict};
use crate::observation::{EncoderReading, Measurement};
use serde::Serialize;
use std::collections::VecDeque;

/// Whether the model accounts for what is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum GapState {
    /// Too few measurements to say.
    Unknown,
    /// What is left is noise.
    Noise,
    /// More is left than noise.
    Above,
}

/// The figures of the watch.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GapStatus {
    /// The verdict.
    pub state: GapState,
    /// Mean square of the innovations in units of their predicted noise, bending part; 1 is noise.
    pub bending: f64,
    /// The same for the part common to all backbones.
    pub common: f64,
    /// Share of the last measurements that the gate rejected.
    pub rejected: f64,
}

/// Used measurements before anything is said.
const LEAST: usize = 50;
/// Above this the gap has left the noise, below that it is back.
const LEAVES: f64 = 2.5;
const RETURNS: f64 = 1.8;
/// The gate rejecting this share of the last measurements says the same.
const RECENT: usize = 100;
const MANY_REJECTED: f64 = 0.3;

/// Watches the innovations.
#[derive(Debug, Default)]
pub struct Watch {
    used: usize,
    rejected: VecDeque<bool>,
    above: bool,
}

impl Watch {
    /// Takes what became of a measurement.
    pub fn see(&mut self, verdict: Verdict, consistency: Option<&Consistency>) -> GapStatus {
        if verdict != Verdict::Skipped {
            self.used += usize::from(verdict == Verdict::Used);
            if self.rejected.len() == RECENT {
                self.rejected.pop_front();
            }
            self.rejected.push_back(verdict == Verdict::Rejected);
        }
        let share = self.rejected.iter().filter(|&&rejected| rejected).count() as f64 / RECENT as f64;
        let (bending, common) = consistency.map_or((1.0, 1.0), |c| (c.bending_chi_square(), c.common_chi_square()));
        let limit = if self.above { RETURNS } else { LEAVES };
        self.above = bending.max(common) > limit || share > MANY_REJECTED;
        let state = match self.above {
            _ if self.used < LEAST && share <= MANY_REJECTED => GapState::Unknown,
            true => GapState::Above,
            false => GapState::Noise,
        };
        GapStatus { state, bending, common, rejected: share }
    }
}

/// Samples spread evenly over all that came, never more than twice [`SPREAD`].
#[derive(Debug)]
pub struct Gathered {
    samples: Vec<(Measurement, EncoderReading)>,
    every: usize,
    skipped: usize,
}

/// Samples that `discover` gets, or up to twice as many.
const SPREAD: usize = 250;

impl Default for Gathered {
    fn default() -> Self {
        Self { samples: Vec::new(), every: 1, skipped: 0 }
    }
}

impl Gathered {
    /// Takes a sample, or not, so that those kept stay evenly spread.
    pub fn take(&mut self, measurement: &Measurement, reading: &EncoderReading) {
        self.skipped += 1;
        if self.skipped < self.every {
            return;
        }
        self.skipped = 0;
        self.samples.push((measurement.clone(), *reading));
        if self.samples.len() == 2 * SPREAD {
            let mut keep = false;
            self.samples.retain(|_| {
                keep = !keep;
                keep
            });
            // The last one is gone; the next that is kept follows the one before it.
            self.skipped = self.every;
            self.every *= 2;
        }
    }

    /// The samples so far.
    pub fn samples(&self) -> (Vec<Measurement>, Vec<EncoderReading>) {
        self.samples.iter().cloned().unzip()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation::Status;
    use crate::robot::PerBackbone;

    #[test]
    fn however_many_come_a_bounded_number_spread_over_all_is_kept() {
        let mut gathered = Gathered::default();
        for index in 0..20_000 {
            let measurement =
                Measurement { index, time_s: None, status: Status::Ok, measured: None, quality: None, view: None };
            gathered
                .take(&measurement, &EncoderReading { index, time_s: index as f64, q_mm: PerBackbone::repeat(3, 0.0) });
        }
        let (kept, _) = gathered.samples();
        assert!(kept.len() >= SPREAD && kept.len() < 2 * SPREAD);
        let steps: Vec<u64> = kept.windows(2).map(|pair| pair[1].index - pair[0].index).collect();
        assert!(steps.iter().all(|&step| step == 64), "{steps:?}");
        assert!(kept.last().unwrap().index > 19_900);
    }

    #[test]
    fn rejections_in_numbers_raise_the_watch() {
        let mut watch = Watch::default();
        assert_eq!(watch.see(Verdict::Used, None).state, GapState::Unknown);
        for _ in 0..60 {
            watch.see(Verdict::Used, None);
        }
        assert_eq!(watch.see(Verdict::Used, None).state, GapState::Noise);
        for _ in 0..40 {
            watch.see(Verdict::Rejected, None);
        }
        assert_eq!(watch.see(Verdict::Skipped, None).state, GapState::Above);
    }
}
