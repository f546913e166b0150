//! A straight line through pairs of numbers, by least squares.

use super::moments::mean;

/// The line y = intercept + slope x.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Its slope; not a number where all x are the same.
    pub slope: f64,
    /// y at x = 0.
    pub intercept: f64,
    /// The mean of x.
    pub mean_x: f64,
    /// Σ (x − mean x)², by which the slope's variance is that of y.
    pub spread_x: f64,
}

impl Line {
    /// Through pairs (x, y).
    pub fn through(pairs: impl Iterator<Item = (f64, f64)> + Clone) -> Self {
        let [mean_x, mean_y] = [mean(pairs.clone().map(|(x, _)| x)), mean(pairs.clone().map(|(_, y)| y))];
        let spread_x: f64 = pairs.clone().map(|(x, _)| (x - mean_x).powi(2)).sum();
        let slope = pairs.map(|(x, y)| (x - mean_x) * (y - mean_y)).sum::<f64>() / spread_x;
        Self { slope, intercept: mean_y - slope * mean_x, mean_x, spread_x }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_is_that_of_the_normal_equations() {
        // Σx = 10, Σy = 11, Σx² = 30, Σxy = 32: slope (4 · 32 − 10 · 11) / (4 · 30 − 10²) = 18 / 20.
        let line = Line::through([(1.0, 2.0), (2.0, 1.0), (3.0, 4.0), (4.0, 4.0)].into_iter());
        assert!((line.slope - 0.9).abs() < 1e-12 && (line.intercept - 0.5).abs() < 1e-12);
        assert!((line.mean_x - 2.5).abs() < 1e-12 && (line.spread_x - 5.0).abs() < 1e-12);
    }
}
