//! Latencies, in a histogram of fixed size.

use super::status::LatencyStatus;

/// Factor between the ends of neighbouring buckets, the eighth root of 2. Convention: quantiles are then right to 5 %.
const GROWTH: f64 = 1.0905077326652577;
/// Upper end of the smallest latencies that are told apart, s. Convention.
///
/// Convention: a display choice.
const FIRST_S: f64 = 0.25e-3;
/// Number of buckets. Derived: FIRST_S · GROWTH^160 = 0.25 ms · 2²⁰ = 262 s.
const BUCKETS: usize = 160;
/// The end of a bucket counts as within a limit up to this factor. Convention: a guard against rounding.
const ROUNDING: f64 = 1.0001;

/// Counts of latencies in buckets that grow geometrically, from 0.25 ms to 4 minutes.
#[derive(Debug, Clone, PartialEq)]
pub struct Histogram {
    counts: [u64; BUCKETS],
    total: u64,
    sum_s: f64,
    most_s: f64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { counts: [0; BUCKETS], total: 0, sum_s: 0.0, most_s: 0.0 }
    }
}

impl Histogram {
    /// Adds a latency.
    pub fn add(&mut self, seconds: f64) {
        let bucket = ((seconds / FIRST_S).max(1.0).ln() / GROWTH.ln()) as usize;
        self.counts[bucket.min(BUCKETS - 1)] += 1;
        self.total += 1;
        self.sum_s += seconds;
        self.most_s = self.most_s.max(seconds);
    }

    /// The number of latencies.
    pub fn total(&self) -> u64 {
        self.total
    }

    /// Their sum, s.
    pub fn sum_s(&self) -> f64 {
        self.sum_s
    }

    /// The latency, s, that this share is below, to 5 %.
    pub fn quantile(&self, share: f64) -> f64 {
        let wanted = share * self.total as f64;
        let mut below = 0.0;
        for (bucket, &count) in self.counts.iter().enumerate() {
            if count > 0 && below + count as f64 >= wanted {
                let within = (wanted - below) / count as f64;
                return (FIRST_S * GROWTH.powf(bucket as f64 + within)).min(self.most_s);
            }
            below += count as f64;
        }
        self.most_s
    }

    /// The number of latencies up to so many seconds, to a bucket.
    pub fn at_most(&self, seconds: f64) -> u64 {
        let end = |bucket: usize| FIRST_S * GROWTH.powi(bucket as i32 + 1);
        self.counts.iter().enumerate().take_while(|(k, _)| end(*k) <= seconds * ROUNDING).map(|(_, count)| count).sum()
    }

    /// The figures to show.
    pub fn status(&self, last_ms: f64) -> LatencyStatus {
        let [p50_ms, p99_ms] = [0.5, 0.99].map(|share| 1000.0 * self.quantile(share));
        LatencyStatus { last_ms, p50_ms, p99_ms, most_ms: 1000.0 * self.most_s }
    }

    /// The histogram as text, a line for each doubling.
    pub fn text(&self) -> String {
        /// Characters of the longest bar. Convention: a display choice.
        const BAR: f64 = 50.0;
        let mut lines = String::new();
        let mut end_ms = 0.5;
        let mut before = 0;
        while before < self.total {
            let below = self.at_most(end_ms / 1000.0);
            let count = below - before;
            if before > 0 || count > 0 {
                let bar = "#".repeat((BAR * count as f64 / self.total as f64).ceil() as usize);
                lines += &format!("{:>8} to {end_ms} ms {count:>8} {bar}\n", end_ms / 2.0);
            }
            (before, end_ms) = (below, 2.0 * end_ms);
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_the_sorted_values() {
        let mut values: Vec<f64> = (0..5000).map(|k| 0.002 * (1.0 + f64::from(k * 7919 % 5000) / 500.0)).collect();
        let mut histogram = Histogram::default();
        values.iter().for_each(|&value| histogram.add(value));
        values.sort_by(f64::total_cmp);
        for share in [0.1, 0.5, 0.99] {
            let exact = values[(share * 5000.0) as usize];
            assert!((histogram.quantile(share) / exact - 1.0).abs() < 0.05, "{share}");
        }
        assert_eq!(histogram.at_most(1000.0), 5000);
        let lines = histogram.text();
        assert!(lines.contains("to 4 ms") && lines.contains("to 32 ms") && !lines.contains("to 64 ms"), "{lines}");
    }

    #[test]
    fn nothing_and_the_absurd_are_counted_too() {
        let mut histogram = Histogram::default();
        assert_eq!(histogram.quantile(0.5), 0.0);
        assert_eq!(histogram.text(), "");
        histogram.add(1e9);
        histogram.add(0.0);
        assert_eq!(histogram.total(), 2);
        assert!(histogram.text().lines().count() > 5);
    }
}
