//! Samples spread evenly over a run, for `discover`: a buffer of bounded size that keeps every 2ᵏ-th sample.

use crate::observation::{EncoderReading, Measurement};

/// Samples that are kept at least once so many came; there are never twice as many. Convention: a resource limit;
/// `discover` takes the longer the more there are.
const MIN_KEPT: usize = 250;

/// Samples spread evenly over all that came.
#[derive(Debug)]
pub struct SampleBuffer {
    samples: Vec<(Measurement, EncoderReading)>,
    every: usize,
    skipped: usize,
}

impl Default for SampleBuffer {
    fn default() -> Self {
        Self { samples: Vec::new(), every: 1, skipped: 0 }
    }
}

impl SampleBuffer {
    /// Takes a sample, or passes over it so that those kept stay evenly spread.
    pub fn add(&mut self, measurement: &Measurement, reading: &EncoderReading) {
        self.skipped += 1;
        if self.skipped < self.every {
            return;
        }
        self.skipped = 0;
        self.samples.push((measurement.clone(), *reading));
        if self.samples.len() == 2 * MIN_KEPT {
            let mut keep = false;
            self.samples.retain(|_| {
                keep = !keep;
                keep
            });
            // The last one was dropped; the next that is kept follows the one before it.
            self.skipped = self.every;
            self.every *= 2;
        }
    }

    /// Forgets the samples from this index on.
    pub fn forget_from(&mut self, index: u64) {
        self.samples.retain(|(measurement, _)| measurement.index < index);
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
        let mut buffer = SampleBuffer::default();
        for index in 0..20_000 {
            let measurement =
                Measurement { index, time_s: None, status: Status::Ok, measured: None, quality: None, view: None };
            let reading = EncoderReading::new(index, index as f64, PerBackbone::repeat(3, 0.0));
            buffer.add(&measurement, &reading);
        }
        let (kept, _) = buffer.samples();
        assert!(kept.len() >= MIN_KEPT && kept.len() < 2 * MIN_KEPT);
        let steps: Vec<u64> = kept.windows(2).map(|pair| pair[1].index - pair[0].index).collect();
        assert!(steps.iter().all(|&step| step == 64), "{steps:?}");
        assert!(kept.last().unwrap().index > 19_900);
    }
}
