//! Autocorrelation of errors, and how many independent ones they are worth; how much of some values follows a quantity.
//!
//! The mean of n errors with autocorrelations ρ_k has the variance σ²/n · D, where D is the *design effect*
//!
//! ```text
//! D = 1 + 2 Σ_k ρ_k          (k = 1, 2, …; n large)
//! D = (1 + ρ)/(1 − ρ)        where ρ_k = ρᵏ (first-order autoregression),
//! ```
//!
//! so that n/D is the *effective sample size*. Errors are taken for a first-order autoregression here.
//!
//! Source: G. V. Bayley, J. M. Hammersley, "The 'Effective' Number of Independent Observations in an Autocorrelated Time Series",
//! Suppl. J. Royal Stat. Soc. 8, 1946.

use super::moments::mean;
use nalgebra::SVector;

/// The largest first autocorrelation that is believed.
///
/// Convention: errors that hardly change at all would else inflate a variance without bound; at 0.9 the design effect is 19.
const MOST_AUTOCORRELATION: f64 = 0.9;

/// The design effect of a first-order autoregression of correlation ρ, with ρ between 0 and 0.9.
pub fn autoregressive_design_effect(rho: f64) -> f64 {
    let rho = rho.clamp(0.0, MOST_AUTOCORRELATION);
    (1.0 + rho) / (1.0 - rho)
}

/// The sum of the squares of values that come in order, and of the products of each with the next: the second over the first is their first
/// autocorrelation about zero.
pub fn squares_and_products(values: &[f64]) -> [f64; 2] {
    let products: f64 = values.windows(2).map(|pair| pair[0] * pair[1]).sum();
    [values.iter().map(|value| value * value).sum(), products]
}

/// Running sums over whitened residuals of D numbers each, with a forgetting factor: their reduced χ² and first autocorrelation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SerialScatter<const D: usize> {
    squares: f64,
    degrees_of_freedom: f64,
    products_with_the_last: f64,
    last: SVector<f64, D>,
}

impl<const D: usize> SerialScatter<D> {
    /// Of residuals to come, which a fit of so many parameters has made smaller.
    pub fn new(parameters: usize) -> Self {
        Self {
            squares: 0.0,
            degrees_of_freedom: -(parameters as f64),
            products_with_the_last: 0.0,
            last: SVector::zeros(),
        }
    }

    /// Adds the next residual, in units of its standard deviation.
    pub fn add(&mut self, residual: SVector<f64, D>) {
        self.squares += residual.norm_squared();
        self.degrees_of_freedom += D as f64;
        self.products_with_the_last += residual.dot(&self.last);
        self.last = residual;
    }

    /// Multiplies all sums so far by a forgetting factor in (0, 1].
    pub fn forget(&mut self, factor: f64) {
        self.squares *= factor;
        self.degrees_of_freedom *= factor;
        self.products_with_the_last *= factor;
    }

    /// Σ r²/(degrees of freedom); 1 where there are none.
    pub fn reduced_chi_square(&self) -> f64 {
        if self.degrees_of_freedom > 0.0 { self.squares / self.degrees_of_freedom } else { 1.0 }
    }

    /// The correlation of one residual with the next; 0 before there are two.
    pub fn autocorrelation(&self) -> f64 {
        if self.squares > 0.0 { self.products_with_the_last / self.squares } else { 0.0 }
    }

    /// The design effect of the first autocorrelation, 1 to 19.
    pub fn design_effect(&self) -> f64 {
        autoregressive_design_effect(self.autocorrelation())
    }

    /// What the variance of a mean must be multiplied by: the reduced χ² where that is above 1, times the design effect of the first
    /// autocorrelation.
    pub fn variance_inflation(&self) -> f64 {
        self.reduced_chi_square().max(1.0) * self.design_effect()
    }
}

/// The correlation ratio η² of values with a quantity: the share of their squares about the mean that the means of so many classes of the
/// quantity, of equal count, explain. 0 where there is nothing to explain.
///
/// Source: K. Pearson, "On the General Theory of Skew Correlation and Non-linear Regression", Drapers' Company Research Memoirs II, 1905.
pub fn correlation_ratio(quantity: &[f64], values: &[f64], classes: usize) -> f64 {
    let mut order: Vec<usize> = (0..quantity.len()).collect();
    order.sort_by(|&a, &b| quantity[a].total_cmp(&quantity[b]));
    let all = mean(values.iter().copied());
    let total: f64 = values.iter().map(|value| (value - all).powi(2)).sum();
    let within = order.chunks(order.len().div_ceil(classes).max(1)).map(|class| {
        let own = mean(class.iter().map(|&k| values[k]));
        class.iter().map(|&k| (values[k] - own).powi(2)).sum::<f64>()
    });
    if total > 0.0 { 1.0 - within.sum::<f64>() / total } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector1;
    use rand::SeedableRng;
    use rand::rngs::StdRng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn a_parabola_follows_its_argument_wholly_and_a_mixed_order_hardly() {
        let x: Vec<f64> = (0..400).map(|k| f64::from(k) / 200.0 - 1.0).collect();
        let y: Vec<f64> = x.iter().map(|x| x * x).collect();
        // Within a class of width 1/8 at x the parabola has the variance (2x)²/12/64: 0.0017 of 0.0889 on average.
        assert!((correlation_ratio(&x, &y, 16) - 0.981).abs() < 0.004, "{}", correlation_ratio(&x, &y, 16));
        let mixed: Vec<f64> = (0..400).map(|k| f64::from(k * 173 % 400)).collect();
        // Classes take their degrees of freedom: 15 of 399.
        assert!(correlation_ratio(&mixed, &y, 16) < 0.12);
        assert_eq!(correlation_ratio(&x, &[2.0; 400], 16), 0.0);
    }

    /// A first-order autoregression of unit variance.
    fn autoregression(rho: f64, count: usize, random: &mut StdRng) -> Vec<f64> {
        let mut value: f64 = StandardNormal.sample(random);
        let fresh = (1.0 - rho * rho).sqrt();
        (0..count)
            .map(|_| {
                value = rho * value + fresh * Distribution::<f64>::sample(&StandardNormal, random);
                value
            })
            .collect()
    }

    #[test]
    fn the_variance_of_a_mean_grows_by_the_design_effect() {
        // What the design effect is for, by drawing means.
        let mut random = StdRng::seed_from_u64(7);
        let (rho, count, draws) = (0.6, 400, 3000);
        let squares: f64 = (0..draws)
            .map(|_| (autoregression(rho, count, &mut random).iter().sum::<f64>() / count as f64).powi(2))
            .sum();
        let ratio = squares / f64::from(draws) * count as f64 / autoregressive_design_effect(rho);
        // 3000 squares scatter by 2.6 %, and 400 is not infinity by 0.5 %.
        assert!((ratio - 1.0).abs() < 0.09, "{ratio}");
    }

    #[test]
    fn the_variance_of_a_mean_square_grows_by_the_design_effect_of_the_correlations_square() {
        let mut random = StdRng::seed_from_u64(4);
        let (rho, count) = (0.6f64, 200);
        let squares = |series: Vec<f64>| mean(series.iter().map(|e| e * e));
        let all: Vec<f64> = (0..2000).map(|_| squares(autoregression(rho, count, &mut random))).collect();
        let middle = mean(all.iter().copied());
        let variance = mean(all.iter().map(|own| (own / middle - 1.0).powi(2)));
        let expected = 2.0 / count as f64 * autoregressive_design_effect(rho.powi(2));
        assert!((variance / expected - 1.0).abs() < 0.15, "{variance} {expected}");
    }

    #[test]
    fn running_sums_say_the_same_as_the_whole_series() {
        let mut random = StdRng::seed_from_u64(8);
        let mut scatter = SerialScatter::<1>::new(1);
        let series = autoregression(0.6, 20_000, &mut random);
        series.iter().for_each(|&value| scatter.add(Vector1::new(2.0 * value)));
        // The autocorrelation's standard error is √((1 − ρ²)/n), 0.006.
        assert!((scatter.autocorrelation() - 0.6).abs() < 0.025);
        assert!((scatter.reduced_chi_square() - 4.0).abs() < 0.25);
        assert!((scatter.variance_inflation() - 16.0).abs() < 1.5, "{}", scatter.variance_inflation());
    }

    #[test]
    fn forgetting_leaves_the_last_series_alone() {
        let mut scatter = SerialScatter::<1>::new(0);
        for k in 0..200 {
            scatter.forget(0.8);
            scatter.add(Vector1::new(if k < 100 { 10.0 } else { 1.0 }));
        }
        assert!((scatter.reduced_chi_square() - 1.0).abs() < 1e-6);
        assert_eq!(SerialScatter::<2>::new(1).variance_inflation(), 1.0);
    }
}
