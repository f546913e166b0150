//! Means: of values, of squares, and about the mean.

/// The arithmetic mean; 0 of nothing.
pub fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, count) = values.into_iter().fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    if count > 0.0 { sum / count } else { 0.0 }
}

/// The root mean square √(Σ x²/n); 0 of nothing.
pub fn rms(values: impl IntoIterator<Item = f64>) -> f64 {
    mean(values.into_iter().map(|value| value * value)).sqrt()
}

/// The standard deviation of a population, √(Σ (x − x̄)²/n); 0 of nothing. For the unbiased variance of a sample multiply by
/// √(n/(n − 1)).
pub fn standard_deviation(values: &[f64]) -> f64 {
    let centre = mean(values.iter().copied());
    rms(values.iter().map(|value| value - centre))
}

/// A sum of squares that grows one value at a time, where the values are too many to hold.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct RunningSquares {
    sum: f64,
    count: usize,
}

impl RunningSquares {
    /// Adds a value.
    pub fn add(&mut self, value: f64) {
        self.sum += value * value;
        self.count += 1;
    }

    /// How many values there are.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Their root mean square; 0 of nothing.
    pub fn rms(&self) -> f64 {
        if self.count > 0 { (self.sum / self.count as f64).sqrt() } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_of_the_numbers_one_to_n_are_the_closed_forms() {
        for n in [1, 2, 7, 100] {
            let values: Vec<f64> = (1..=n).map(f64::from).collect();
            let count = f64::from(n);
            assert!((mean(values.iter().copied()) - (count + 1.0) / 2.0).abs() < 1e-12);
            let square = (count + 1.0) * (2.0 * count + 1.0) / 6.0;
            assert!((rms(values.iter().copied()) - square.sqrt()).abs() < 1e-12);
            let mut running = RunningSquares::default();
            values.iter().for_each(|&value| running.add(value));
            assert!((running.rms() - square.sqrt()).abs() < 1e-12 && running.count() == values.len());
            let variance = (count * count - 1.0) / 12.0;
            assert!((standard_deviation(&values) - variance.sqrt()).abs() < 1e-12);
        }
    }

    #[test]
    fn of_nothing_they_are_zero() {
        assert_eq!((mean([]), rms([]), standard_deviation(&[]), RunningSquares::default().rms()), (0.0, 0.0, 0.0, 0.0));
    }
}
