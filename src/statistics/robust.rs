//! Robust losses and iteratively reweighted least squares (IRLS).
//!
//! A fit by least squares minimises Σ r²; a robust one Σ ρ(r) with a loss ρ that grows more slowly. The fit that minimises
//! Σ w r² with the weights w = ρ′(r)/(2 r) of its own residuals is the same, so reweighted least squares, repeated, arrive at it.
//! All losses are r² near zero, so that Σ ρ compares with χ².
//!
//! Source: P. J. Huber, E. M. Ronchetti, *Robust Statistics*, 2nd ed., Wiley 2009, ch. 7; P. W. Holland, R. E. Welsch, "Robust
//! regression using iteratively reweighted least-squares", Communications in Statistics A6, 1977.

use super::normal_equations::normal_equations;
use super::order::mad_scale;
use nalgebra::{DMatrix, DVector};

/// Where Huber's loss turns linear, in standard deviations, for 95 % efficiency on normal errors.
///
/// Source: Holland and Welsch 1977, table 1.
pub const HUBER_LIMIT: f64 = 1.345;
/// Where Tukey's biweight stops to count, in standard deviations, for 95 % efficiency on normal errors.
///
/// Source: Holland and Welsch 1977, table 1.
pub const TUKEY_LIMIT: f64 = 4.685;

/// What a residual costs. Limits are in the residuals' own unit, which is their standard deviation where they are whitened.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// r²: least squares.
    Squares,
    /// Huber's: r² up to the limit k, 2 k |r| − k² beyond. Outliers go on pulling, each no more than one at the limit.
    Huber(f64),
    /// Tukey's biweight: k²/3 · (1 − (1 − r²/k²)³) up to the limit k, k²/3 beyond, where a residual pulls no more.
    Tukey(f64),
    /// Talwar's: r² up to the limit k, k² beyond; a residual counts in full or not at all.
    Talwar(f64),
}

impl Loss {
    /// ρ(r).
    pub fn rho(self, residual: f64) -> f64 {
        let square = residual * residual;
        match self {
            Self::Squares => square,
            Self::Huber(limit) if residual.abs() <= limit => square,
            Self::Huber(limit) => limit * (2.0 * residual.abs() - limit),
            Self::Tukey(limit) => {
                let left = (1.0 - square / (limit * limit)).max(0.0);
                limit * limit / 3.0 * (1.0 - left.powi(3))
            }
            Self::Talwar(limit) => square.min(limit * limit),
        }
    }

    /// The weight w(r) = ρ′(r)/(2 r) of a residual in reweighted least squares, 0 to 1.
    pub fn weight(self, residual: f64) -> f64 {
        match self {
            Self::Squares => 1.0,
            Self::Huber(limit) => (limit / residual.abs().max(f64::MIN_POSITIVE)).min(1.0),
            Self::Tukey(limit) => (1.0 - (residual / limit).powi(2)).max(0.0).powi(2),
            Self::Talwar(limit) => f64::from(u8::from(residual.abs() <= limit)),
        }
    }

    /// Weights of residuals, the loss's limit taken in units of their own scale: that of the MAD, and never less than
    /// `least_scale`.
    pub fn weights(self, residuals: &[f64], least_scale: f64) -> Vec<f64> {
        let scale = mad_scale(residuals.iter().copied()).max(least_scale);
        residuals.iter().map(|residual| self.weight(residual / scale)).collect()
    }
}

/// How a linear model is fitted by reweighted least squares.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Irls {
    /// The loss, whose limit is in units of the residuals' scale.
    pub loss: Loss,
    /// The least scale of the residuals; 1 where they are whitened by an error that is certain.
    pub least_scale: f64,
    /// The most rounds.
    pub rounds: usize,
    /// A round that moves the parameters by less (Euclidean norm) is the last; 0 takes all rounds.
    pub tolerance: f64,
}

/// A linear model fitted robustly.
#[derive(Debug, Clone, PartialEq)]
pub struct RobustFit {
    /// x̂.
    pub parameters: DVector<f64>,
    /// The weight of each row, of the residuals before the last step.
    pub weights: DVector<f64>,
}

impl Irls {
    /// Minimises Σ ρ(r_i) of r = `offset` + `design` x over x. Only the first `reweighted` rows are subject to the loss; those after
    /// them (priors, written as rows) keep the weight 1.
    ///
    /// `None` where the rows do not determine x.
    pub fn fit(&self, design: &DMatrix<f64>, offset: &DVector<f64>, reweighted: usize) -> Option<RobustFit> {
        let mut parameters = DVector::zeros(design.ncols());
        let mut weights = DVector::from_element(design.nrows(), 1.0);
        for _ in 0..self.rounds {
            let residuals = offset + design * &parameters;
            let own = self.loss.weights(&residuals.as_slice()[..reweighted], self.least_scale);
            weights.rows_mut(0, reweighted).copy_from_slice(&own);
            let (information, slope) = normal_equations(design, offset, &weights);
            let next = -information.cholesky()?.solve(&slope);
            let moved = (&next - &parameters).norm();
            parameters = next;
            if moved < self.tolerance {
                break;
            }
        }
        Some(RobustFit { parameters, weights })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ALL: [Loss; 3] = [Loss::Squares, Loss::Huber(HUBER_LIMIT), Loss::Tukey(TUKEY_LIMIT)];

    proptest! {
        #[test]
        fn a_weight_is_the_slope_of_its_loss(r in -8.0..8.0f64) {
            for loss in ALL {
                prop_assume!(r.abs() > 1e-3);
                let step = 1e-6;
                let slope = (loss.rho(r + step) - loss.rho(r - step)) / (2.0 * step);
                prop_assert!((loss.weight(r) - slope / (2.0 * r)).abs() < 1e-5, "{loss:?} at {r}");
            }
        }
    }

    #[test]
    fn losses_agree_with_squares_near_zero_and_are_bounded_where_they_should_be() {
        for loss in ALL {
            assert!((loss.rho(0.01) - 1e-4).abs() < 1e-9, "{loss:?}");
            assert_eq!(loss.weight(0.0), 1.0, "{loss:?}");
        }
        assert_eq!(Loss::Huber(2.0).rho(5.0), 2.0 * 2.0 * 5.0 - 4.0);
        assert_eq!(Loss::Tukey(3.0).rho(1e9), 3.0);
    }

    /// The stack-loss data, K. A. Brownlee, *Statistical Theory and Methodology*, 2nd ed., Wiley 1965: air flow, water
    /// temperature, acid concentration, stack loss.
    const STACK_LOSS: [[f64; 4]; 21] = [
        [80.0, 27.0, 89.0, 42.0],
        [80.0, 27.0, 88.0, 37.0],
        [75.0, 25.0, 90.0, 37.0],
        [62.0, 24.0, 87.0, 28.0],
        [62.0, 22.0, 87.0, 18.0],
        [62.0, 23.0, 87.0, 18.0],
        [62.0, 24.0, 93.0, 19.0],
        [62.0, 24.0, 93.0, 20.0],
        [58.0, 23.0, 87.0, 15.0],
        [58.0, 18.0, 80.0, 14.0],
        [58.0, 18.0, 89.0, 14.0],
        [58.0, 17.0, 88.0, 13.0],
        [58.0, 18.0, 82.0, 11.0],
        [58.0, 19.0, 93.0, 12.0],
        [50.0, 18.0, 89.0, 8.0],
        [50.0, 18.0, 86.0, 7.0],
        [50.0, 19.0, 72.0, 8.0],
        [50.0, 19.0, 79.0, 8.0],
        [50.0, 20.0, 80.0, 9.0],
        [56.0, 20.0, 82.0, 15.0],
        [70.0, 20.0, 91.0, 15.0],
    ];

    #[test]
    fn huber_and_least_squares_of_the_stack_loss_data_are_the_published_ones() {
        let design = DMatrix::from_fn(21, 4, |r, c| if c == 0 { 1.0 } else { STACK_LOSS[r][c - 1] });
        let offset = DVector::from_fn(21, |r, _| -STACK_LOSS[r][3]);
        let fit =
            |loss| Irls { loss, least_scale: 0.0, rounds: 200, tolerance: 1e-9 }.fit(&design, &offset, 21).unwrap();
        // R: lm(stack.loss ~ ., stackloss) and MASS::rlm (Huber's ψ at 1.345, scale by the MAD), as printed by Venables and
        // Ripley, Modern Applied Statistics with S, 4th ed., 2002.
        let squares = [-39.9197, 0.7156, 1.2953, -0.1521];
        let huber = [-41.0265, 0.8294, 0.9261, -0.1278];
        for (loss, expected) in [(Loss::Squares, squares), (Loss::Huber(HUBER_LIMIT), huber)] {
            let found = fit(loss).parameters;
            for (found, expected) in found.iter().zip(expected) {
                assert!((found / expected - 1.0).abs() < 2e-3, "{loss:?}: {found} for {expected}");
            }
        }
        // Of the rows that Daniel and Wood (Fitting Equations to Data, 1980) call outliers, 1, 3, 4 and 21, Tukey's biweight that
        // starts from least squares finds three.
        let weights = fit(Loss::Tukey(TUKEY_LIMIT)).weights;
        let mut order: Vec<usize> = (0..21).collect();
        order.sort_by(|&a, &b| weights[a].total_cmp(&weights[b]));
        assert!([3, 4, 21].iter().all(|row| order[..4].contains(&(row - 1))), "{order:?}");
    }

    #[test]
    fn a_prior_row_is_never_reweighted() {
        // One number measured as 0, 0 and 0 with a prior at 10 of the same weight: 2.5, whatever the loss thinks of 10.
        let design = DMatrix::from_element(4, 1, 1.0);
        let offset = DVector::from_column_slice(&[0.0, 0.0, 0.0, -10.0]);
        let irls = Irls { loss: Loss::Tukey(TUKEY_LIMIT), least_scale: 10.0, rounds: 50, tolerance: 1e-12 };
        let fit = irls.fit(&design, &offset, 3).unwrap();
        assert_eq!(fit.weights[3], 1.0);
        let weight = fit.weights[0];
        assert!((fit.parameters[0] - 10.0 / (1.0 + 3.0 * weight)).abs() < 1e-9);
    }
}
