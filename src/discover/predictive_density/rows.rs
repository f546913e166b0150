//! The rows that one structure is judged on, and what is learned of what it leaves.

use super::refit::Equations;
use super::{Judged, Kind, LEAST_VARIANCE, STRETCHES};
use crate::discover::residuals::{Problem, Residual};
use crate::statistics::moments::mean;
use crate::statistics::order::mad_scale;
use nalgebra::{DMatrix, DVector};

/// Residuals count as this many standard deviations at most, so that a few samples far out decide nothing.
///
/// Convention: twice the limit of the fit's loss.
const MOST_SIGMAS: f64 = 6.0;

/// What is learned of a component without a stretch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Learned {
    /// The place of the likeliest kind.
    pub(super) kind: usize,
    /// What its variances are multiplied by.
    pub(super) factor: f64,
}

/// The rows of one structure: components, with derivatives in the rows of each matrix and the residual in the last.
pub(super) struct Rows<'a> {
    pub(super) judged: &'a Judged,
    /// Of each component that is judged, a column for each row, rad or mm.
    pub(super) values: Vec<DMatrix<f64>>,
    /// The noise's variance of each component and row, rad² or mm².
    pub(super) noise: Vec<Vec<f64>>,
    /// The mean square that least squares leave of each component, the unit of its variances.
    pub(super) left: Vec<f64>,
}

/// One step of the Kalman filter of a discrepancy beside a noise.
#[derive(Debug, Clone, Copy)]
struct FilterStep {
    /// What is kept of the discrepancy since the row before.
    kept: f64,
    /// What the discrepancy takes of the innovation.
    gain: f64,
    /// The variance of the innovation.
    variance: f64,
}

impl<'a> Rows<'a> {
    pub(super) fn new(
        judged: &'a Judged,
        problem: &Problem,
        residuals: &[Residual],
        jacobian: &[&DMatrix<f64>],
    ) -> Option<Self> {
        let (n, p) = (problem.data.backbones(), jacobian.iter().map(|block| block.ncols()).sum::<usize>());
        let mut values = vec![DMatrix::zeros(p + 1, judged.rows.len()); judged.components.len()];
        let mut noise = vec![Vec::with_capacity(judged.rows.len()); judged.components.len()];
        for (place, row) in judged.rows.iter().enumerate() {
            let (k, units) = (row.sample, judged.units(problem, row.sample));
            let variances = judged.noise_variances(problem, k);
            for ((&c, values), noise) in judged.components.iter().zip(&mut values).zip(&mut noise) {
                let columns = jacobian.iter().flat_map(|block| block.column_iter());
                let slopes = columns.map(|column| units.component(&column.as_slice()[n * k..n * (k + 1)], c));
                let all = slopes.chain([units.component(&residuals[k], c)]);
                values.column_mut(place).iter_mut().zip(all).for_each(|(value, own)| *value = own);
                noise.push(variances[c]);
            }
        }
        values.iter_mut().for_each(clip);
        let is_finite = values.iter().all(|values| values.iter().all(|value| value.is_finite()));
        (judged.rows.len() > p && is_finite).then_some(Self { judged, values, noise, left: Vec::new() })
    }

    /// The mean square of a component after a step of the parameters, at the least that of hardly any noise.
    pub(super) fn mean_square(&self, place: usize, step: &DVector<f64>) -> f64 {
        let squares = self.residuals(place, step).iter().map(|r| r * r).sum::<f64>();
        (squares / self.judged.rows.len() as f64).max(LEAST_VARIANCE * self.mean_noise(place))
    }

    /// The mean variance of the noise of a component.
    pub(super) fn mean_noise(&self, place: usize) -> f64 {
        mean(self.noise[place].iter().copied())
    }

    /// The residuals of a component after a step of the parameters.
    fn residuals(&self, place: usize, step: &DVector<f64>) -> DVector<f64> {
        let p = step.len();
        let values = &self.values[place];
        values.rows(0, p).tr_mul(step) + values.row(p).transpose()
    }

    /// The step of the parameters that leaves least squares, each component in units of what is left of it.
    pub(super) fn least_squares_step(&self, precision: &DVector<f64>) -> Option<DVector<f64>> {
        let p = precision.len();
        let products: Vec<DMatrix<f64>> = self.values.iter().map(|values| values * values.transpose()).collect();
        let mut step = DVector::zeros(p);
        for _ in 0..2 {
            let mut all = Equations::zero(p + 1);
            for (place, products) in products.iter().enumerate() {
                all.products += products / self.mean_square(place, &step);
            }
            let factor = (all.information() + DMatrix::from_diagonal(precision)).cholesky()?;
            step = -factor.solve(&all.gradient());
        }
        Some(step)
    }

    /// What is learned of a component's residuals after a step of so many parameters, without each stretch.
    pub(super) fn learned(&self, place: usize, step: &DVector<f64>, parameters: usize) -> [Learned; STRETCHES] {
        let residuals = self.residuals(place, step);
        let share = parameters as f64 / (self.judged.components.len() * self.judged.rows.len()) as f64;
        // Of each kind and stretch the whitened squares, the logarithms of the variances, and the count.
        let each: Vec<[[f64; 3]; STRETCHES]> =
            self.judged.kinds.iter().map(|kind| self.likelihoods(place, *kind, &residuals)).collect();
        let least = LEAST_VARIANCE * self.mean_noise(place) / self.left[place];
        std::array::from_fn(|stretch| {
            let of_kind = |kind: usize| {
                let others = each[kind].iter().enumerate().filter(|(own, _)| *own != stretch);
                let [squares, log_variances, count] =
                    others.fold([0.0; 3], |sum, (_, own)| std::array::from_fn(|k| sum[k] + own[k]));
                let factor = (squares / (count * (1.0 - share)).max(1.0)).max(least);
                let likelihood = -0.5 * (count * factor.ln() + log_variances + squares / factor);
                (Learned { kind, factor }, likelihood)
            };
            let kinds = (0..self.judged.kinds.len()).map(of_kind);
            kinds.max_by(|a, b| a.1.total_cmp(&b.1)).map_or(Learned { kind: 0, factor: 1.0 }, |(learned, _)| learned)
        })
    }

    /// The steps of the filter of a component.
    fn filter(&self, place: usize, kind: Kind) -> Vec<FilterStep> {
        let discrepancy = (1.0 - kind.independent) * self.left[place];
        let white = kind.independent * self.left[place] / self.mean_noise(place);
        let (mut variance, mut last) = (discrepancy, None);
        let steps = self.judged.rows.iter().zip(&self.noise[place]).map(|(row, noise)| {
            let kept = if last == Some(row.stretch) { (-row.travel / kind.length).exp() } else { 0.0 };
            last = Some(row.stretch);
            variance = kept * kept * variance + (1.0 - kept * kept) * discrepancy;
            let expected = variance + white * noise;
            let gain = variance / expected;
            variance *= 1.0 - gain;
            FilterStep { kept, gain, variance: expected }
        });
        steps.collect()
    }

    /// Of each stretch the whitened squares of a component's residuals, the logarithms of the variances, and the count.
    pub(super) fn likelihoods(&self, place: usize, kind: Kind, residuals: &DVector<f64>) -> [[f64; 3]; STRETCHES] {
        let (mut each, mut state) = ([[0.0; 3]; STRETCHES], 0.0);
        for ((row, step), residual) in self.judged.rows.iter().zip(self.filter(place, kind)).zip(residuals.iter()) {
            state *= step.kept;
            let innovation = residual - state;
            state += step.gain * innovation;
            let own = &mut each[row.stretch];
            *own = [own[0] + innovation * innovation / step.variance, own[1] + step.variance.ln(), own[2] + 1.0];
        }
        each
    }

    /// The normal equations of each stretch of a component.
    pub(super) fn equations(&self, place: usize, kind: Kind) -> Vec<Equations> {
        let values = &self.values[place];
        let mut each = vec![Equations::zero(values.nrows()); STRETCHES];
        let (mut state, mut innovation) = (DVector::zeros(values.nrows()), DVector::zeros(values.nrows()));
        for (at, (row, step)) in self.judged.rows.iter().zip(self.filter(place, kind)).enumerate() {
            state *= step.kept;
            innovation.copy_from(&values.column(at));
            innovation -= &state;
            state.axpy(step.gain, &innovation, 1.0);
            each[row.stretch].add(&innovation, step.variance);
        }
        each
    }

    /// What a step of the parameters leaves in a stretch, in units of the noise's squares.
    pub(super) fn squares(&self, stretch: usize, step: &DVector<f64>) -> f64 {
        let of_component = |place: usize| {
            let residuals = self.residuals(place, step);
            let own = self.judged.rows.iter().zip(residuals.iter()).filter(|(row, _)| row.stretch == stretch);
            own.map(|(_, r)| r * r).sum::<f64>() / self.judged.units[self.judged.components[place]]
        };
        (0..self.values.len()).map(of_component).sum()
    }
}

/// Lets no residual count as more than [`MOST_SIGMAS`] of what the others scatter by.
fn clip(values: &mut DMatrix<f64>) {
    let last = values.nrows() - 1;
    let most = MOST_SIGMAS * mad_scale(values.row(last).iter().copied());
    for mut column in values.column_iter_mut().filter(|column| most > 0.0 && column[last].abs() > most) {
        let share = most / column[last].abs();
        column *= share;
    }
}
