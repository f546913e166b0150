//! A fit's normal equations, sweep by sweep: with them a fit to any selection of sweeps is one linear step away.

use super::data::Data;
use super::fit::{Fit, cost, normal_equations};
use super::sweeps::FOLDS;
use crate::statistics::bootstrap::block_counts;
use nalgebra::{DMatrix, DVector};

/// Bootstrap resamples of the sweeps.
///
/// Derived: a share of 0.9 then has a standard error of 0.02.
pub const RESAMPLES: usize = 200;

/// The weight of all sweeps together on a direction that the selected ones do not determine.
///
/// Convention: a numerical guard.
const RELATIVE_RIDGE: f64 = 1e-6;

/// The same where no sweep determines it.
///
/// Convention: a numerical guard.
const RIDGE: f64 = 1e-9;

/// Cost, information and gradient of each sweep at a fit.
#[derive(Debug, Clone)]
pub struct SweepEquations {
    cost: Vec<f64>,
    information: Vec<DMatrix<f64>>,
    gradient: Vec<DVector<f64>>,
}

impl SweepEquations {
    /// Of a fit.
    pub fn new(data: &Data, fit: &Fit) -> Self {
        let n = data.backbones();
        let mut equations = Self { cost: Vec::new(), information: Vec::new(), gradient: Vec::new() };
        let mut first = 0;
        for sweep in 0..data.sweep_count() {
            let count = data.sweeps[first..].iter().take_while(|s| **s == sweep).count();
            let rows = fit.jacobian.rows(n * first, n * count).into_owned();
            let residuals = &fit.residuals[first..first + count];
            let (information, gradient) = normal_equations(&rows, residuals);
            equations.cost.push(cost(residuals));
            equations.information.push(information);
            equations.gradient.push(gradient);
            first += count;
        }
        equations
    }

    /// The Gauss–Newton step from the fit to all sweeps to one in which each sweep counts so often.
    fn step(&self, counts: &[f64]) -> DVector<f64> {
        let p = self.gradient[0].len();
        let mut information = DMatrix::identity(p, p) * RIDGE;
        let mut gradient = DVector::zeros(p);
        for ((own, right), &count) in self.information.iter().zip(&self.gradient).zip(counts) {
            information += own * count;
            gradient.axpy(-count, right, 1.0);
        }
        for j in 0..p {
            let all: f64 = self.information.iter().map(|own| own[(j, j)]).sum();
            information[(j, j)] += RELATIVE_RIDGE * all;
        }
        information.cholesky().map_or(DVector::zeros(p), |factor| factor.solve(&gradient))
    }

    /// What a sweep costs after a step.
    fn cost_after(&self, sweep: usize, step: &DVector<f64>) -> f64 {
        self.cost[sweep] + 2.0 * self.gradient[sweep].dot(step) + step.dot(&(&self.information[sweep] * step))
    }

    /// What sweeps that count so often cost under a fit to them.
    fn cost_of(&self, counts: &[f64]) -> f64 {
        let step = self.step(counts);
        counts.iter().enumerate().map(|(sweep, count)| count * self.cost_after(sweep, &step)).sum()
    }

    /// The cost of all sweeps, those of each fold under a fit to the others.
    pub fn held_out_cost(&self) -> f64 {
        self.held_out_costs(|sweep| sweep % FOLDS).iter().sum()
    }

    /// The cost of each fold under a fit to the others, `fold` saying to which a sweep belongs.
    pub fn held_out_costs(&self, fold: impl Fn(usize) -> usize) -> Vec<f64> {
        let sweeps = 0..self.cost.len();
        let fold_cost = |held_out: usize| {
            let counts: Vec<f64> = sweeps.clone().map(|sweep| f64::from(u8::from(fold(sweep) != held_out))).collect();
            let step = self.step(&counts);
            let own = sweeps.clone().filter(|&sweep| fold(sweep) == held_out);
            own.map(|sweep| self.cost_after(sweep, &step)).sum::<f64>()
        };
        (0..FOLDS).map(fold_cost).collect()
    }
}

/// The share of bootstrap resamples of the sweeps in which each of several fits is the best by the Bayesian information
/// criterion, all of them fitted to the resample to first order.
pub fn selection_shares(residual_count: usize, fits: &[SweepEquations]) -> Vec<f64> {
    let sweeps = fits[0].cost.len();
    let per_parameter = (residual_count as f64).ln();
    let mut wins = vec![0; fits.len()];
    for counts in block_counts(sweeps, RESAMPLES, 1) {
        let criteria = fits.iter().map(|fit| fit.cost_of(&counts) + fit.gradient[0].len() as f64 * per_parameter);
        if let Some((best, _)) = criteria.enumerate().min_by(|a, b| a.1.total_cmp(&b.1)) {
            wins[best] += 1;
        }
    }
    wins.iter().map(|&wins| f64::from(wins) / RESAMPLES as f64).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A mean fitted to values, each a sweep of its own: at the value 0, residual y, derivative 1.
    fn mean_of(values: &[f64]) -> SweepEquations {
        SweepEquations {
            cost: values.iter().map(|y| y * y).collect(),
            information: values.iter().map(|_| DMatrix::identity(1, 1)).collect(),
            gradient: values.iter().map(|y| DVector::from_element(1, *y)).collect(),
        }
    }

    /// The values themselves: no parameter.
    fn zero_for(values: &[f64]) -> SweepEquations {
        SweepEquations {
            information: vec![DMatrix::zeros(0, 0); values.len()],
            gradient: vec![DVector::zeros(0); values.len()],
            ..mean_of(values)
        }
    }

    #[test]
    fn held_out_squares_of_a_mean_are_those_of_the_closed_form() {
        // Five values in five folds: yᵢ less the mean of the others is n (yᵢ − ȳ) / (n − 1).
        let values = [1.0, 2.0, 4.0, 4.5, 7.0];
        let mean = values.iter().sum::<f64>() / 5.0;
        let expected: f64 = values.iter().map(|y| (1.25 * (y - mean)).powi(2)).sum();
        let held_out = mean_of(&values).held_out_cost();
        assert!((held_out - expected).abs() < 1e-4 * expected, "{held_out} {expected}");
    }

    #[test]
    fn a_selection_is_fitted_to_itself() {
        // The sum of squares of 1, 1, 4 about their mean 2.
        let cost = mean_of(&[1.0, 4.0, 9.0]).cost_of(&[2.0, 1.0, 0.0]);
        assert!((cost - 6.0).abs() < 1e-4, "{cost}");
    }

    #[test]
    fn a_mean_is_selected_where_the_values_have_one() {
        let far = [5.0, 6.0, 5.5, 4.5, 5.2, 6.1, 4.9];
        assert_eq!(selection_shares(7, &[mean_of(&far), zero_for(&far)]), [1.0, 0.0]);
        let near = [0.5, -0.6, 0.1, -0.2, 0.4, -0.3, 0.05];
        let shares = selection_shares(7, &[zero_for(&near), mean_of(&near)]);
        assert!(shares[0] > 0.9 && (shares[0] + shares[1] - 1.0).abs() < 1e-12, "{shares:?}");
    }
}
