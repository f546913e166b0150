//! A smooth correction where no effect explains the gap: ridge regression of the gap on powers of the bend, judged on held-out
//! sweeps.
//!
//! The correction is a summand of ε for each backbone, linear in its coefficients w. They minimise |r + A w|² + k |D w|² with the
//! whitened residuals r, their response A, and D⁻¹ the likely size of each coefficient (A. E. Hoerl and R. W. Kennard 1970, Ridge
//! regression, Technometrics 12:55). The ridge k is chosen by cross-validation over sweeps.

use super::data::Data;
use super::discovery::Discovery;
use super::fit::Fit;
use super::held_out::held_out_fits;
use super::noise::Noise;
use super::null_distribution::LEVEL;
use super::residuals::{Problem, Residual};
use super::verdict::Verdict;
use crate::robot::effects::{LEARNED_CORRECTION, POWERS, TERMS, basis};
use crate::robot::{Effect, Mechanics, Model, PerBackbone};
use crate::statistics::moments::mean;
use crate::statistics::sign_flip::sign_flip_test;
use nalgebra::{DMatrix, DVector};
use serde_json::{Value, json};

/// The ridges that are tried.
///
/// Convention: decades from no shrinkage to almost no correction; cross-validation chooses.
const RIDGES: [f64; 9] = [1e-2, 1e-1, 1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6];

/// The likely size of the coefficient of θᵐ is this over 2ᵐ, mm per radᵐ.
///
/// Convention: the unit of the ridge; cross-validation chooses the ridge.
const SIZE_MM: f64 = 0.1;

/// The largest coefficient that is written, mm per radᵐ.
///
/// Convention: the range of the effect's parameter.
const LARGEST_COEFFICIENT: f64 = 50.0;

/// The least and the largest bend to which the correction holds, degrees.
///
/// Convention: the range of the effect's parameter.
const LARGEST_BEND_DEG: (f64, f64) = (1.0, 120.0);

/// What came of learning a correction.
#[derive(Debug, Clone)]
pub struct Correction {
    /// The model with the correction; none where it would not help.
    pub model: Option<Model>,
    /// rms of the gap of ε without it, on held-out sweeps, mm.
    pub before_mm: f64,
    /// The same with it.
    pub after_mm: f64,
    /// What was done and why, in words.
    pub words: String,
}

/// Learns a correction where the verdict is `unexplained`, and keeps it where it shrinks the gap on held-out sweeps.
pub fn learn_correction(found: &Discovery, data: &Data) -> Correction {
    match found.verdict {
        Verdict::Unexplained | Verdict::Partly => learned(found, data),
        Verdict::None => unneeded(found, "the gap is noise, and there is nothing to gain"),
        Verdict::Named => unneeded(found, "the effects that were named account for the gap"),
    }
}

fn unneeded(found: &Discovery, reason: &str) -> Correction {
    let words = format!("no correction was learned: {reason}");
    Correction { model: None, before_mm: found.after.eps_mm, after_mm: found.after.eps_mm, words }
}

fn learned(found: &Discovery, data: &Data) -> Correction {
    // The discrepancy is what it is to take away, and so no noise here.
    let noise = Noise { discrepancy_rad: 0.0, discrepancy_mm: 0.0, ..found.noise };
    let problem = Problem::new(data, &noise, &found.model);
    let fit = problem.fit(&found.model, None, None);
    let regression = Regression::new(&problem, &fit);
    let fits = held_out_fits(&problem, &fit);
    let gap = |k: usize| problem.eps_gap_mm(&fits[data.fold(k)].residuals, k);
    let before: Vec<f64> = (0..data.len()).map(|k| mean_square(&gap(k))).collect();
    let held_out = |ridge: f64| -> Option<Vec<f64>> {
        let coefficients: Option<Vec<_>> =
            fits.iter().enumerate().map(|(fold, fit)| regression.fitted(fit, ridge, Some(fold))).collect();
        let coefficients = coefficients?;
        let left = |k: usize| mean_square(&(gap(k) - regression.correction_mm(k, &coefficients[data.fold(k)])));
        Some((0..data.len()).map(left).collect())
    };
    let best = RIDGES
        .into_iter()
        .filter_map(|ridge| Some((ridge, held_out(ridge)?)))
        .min_by(|a, b| a.1.iter().sum::<f64>().total_cmp(&b.1.iter().sum::<f64>()));
    let rms_mm = |squares: &[f64]| mean(squares.iter().copied()).sqrt();
    let before_mm = rms_mm(&before);
    let Some((ridge, after)) = best else { return refused(before_mm, before_mm) };
    let after_mm = rms_mm(&after);
    let coefficients = regression.fitted(&fit, ridge, None);
    match coefficients.filter(|_| sign_flip_test(&gains_by_sweep(data, &before, &after), 4) < LEVEL) {
        Some(coefficients) => {
            let mut model = found.model.clone();
            model.effects.push(regression.effect(&coefficients));
            let words = format!(
                "a smooth correction was learned: on held-out sweeps it leaves {after_mm:.4} mm of {before_mm:.4} mm. It is no \
                 explanation, and holds for this robot, these bends and a motion like the one it was learned from"
            );
            Correction { model: Some(model), before_mm, after_mm, words }
        }
        None => refused(before_mm, after_mm),
    }
}

fn refused(before_mm: f64, after_mm: f64) -> Correction {
    let words = format!(
        "no correction was kept: on held-out sweeps a smooth function of bend and direction leaves {after_mm:.4} mm of \
         {before_mm:.4} mm; the gap does not follow the bend"
    );
    Correction { model: None, before_mm, after_mm, words }
}

/// Over the backbones, mm².
fn mean_square(gap_mm: &PerBackbone) -> f64 {
    gap_mm.norm_squared() / gap_mm.len() as f64
}

/// By how much the squares of each sweep shrink, mm².
fn gains_by_sweep(data: &Data, before: &[f64], after: &[f64]) -> Vec<f64> {
    let mut gains = vec![0.0; data.sweep_count()];
    for (k, (before, after)) in before.iter().zip(after).enumerate() {
        gains[data.sweeps[k]] += before - after;
    }
    gains
}

/// The functions of the correction at every sample, and what a summand of ε does to the residuals there.
struct Regression<'a> {
    data: &'a Data,
    largest_theta: f64,
    /// The values of the functions for each backbone.
    basis: Vec<PerBackbone<[f64; TERMS]>>,
    /// The response of the residuals to ε of each backbone, 1/mm.
    response: Vec<PerBackbone<Residual>>,
}

impl<'a> Regression<'a> {
    fn new(problem: &Problem<'a>, fit: &Fit) -> Self {
        let data = problem.data;
        let log = &data.log;
        let motions = Mechanics::new(&fit.model).motions_from_readings(&log.times_s, &fit.path, &log.q_mm);
        let largest_theta = fit.path.iter().map(|bend| bend.norm()).fold(0.0, f64::max);
        let n = data.backbones();
        let at = |k: usize| {
            let at = log.samples[k];
            motions[at].direction.map(|direction| basis(fit.path[at], direction, largest_theta))
        };
        let response = |k: usize| PerBackbone::from_fn(n, |i| problem.response(k, &PerBackbone::ith(n, i)));
        let all = 0..data.len();
        Self { data, largest_theta, basis: all.clone().map(at).collect(), response: all.map(response).collect() }
    }

    /// The derivatives of the residuals of sample k by the coefficients, a row for each component.
    fn design(&self, k: usize) -> DMatrix<f64> {
        let (basis, response) = (&self.basis[k], &self.response[k]);
        let n = self.data.backbones();
        DMatrix::from_fn(n, n * TERMS, |c, j| response[j / TERMS][c] * basis[j / TERMS][j % TERMS])
    }

    /// The coefficients that explain most of a fit's residuals; samples of the fold `held_out` have no part in it.
    fn fitted(&self, fit: &Fit, ridge: f64, held_out: Option<usize>) -> Option<DVector<f64>> {
        let count = self.data.backbones() * TERMS;
        let (mut information, mut gradient) = (DMatrix::zeros(count, count), DVector::zeros(count));
        for k in (0..self.data.len()).filter(|&k| held_out != Some(self.data.fold(k))) {
            let design = self.design(k);
            information += design.tr_mul(&design);
            gradient += design.tr_mul(&DVector::from_iterator(design.nrows(), fit.residuals[k].iter().copied()));
        }
        let inverse_sizes = DVector::from_fn(count, |j, _| 2f64.powi(POWERS[j % TERMS]) / SIZE_MM);
        ridge_solution(information, &gradient, &(inverse_sizes * ridge.sqrt()))
    }

    /// The correction of ε at sample k, mm.
    fn correction_mm(&self, k: usize, coefficients: &DVector<f64>) -> PerBackbone {
        PerBackbone::from_fn(self.data.backbones(), |i| {
            self.basis[k][i].iter().enumerate().map(|(j, value)| value * coefficients[i * TERMS + j]).sum()
        })
    }

    fn effect(&self, coefficients: &DVector<f64>) -> Effect {
        let mut values = vec![self.largest_theta.to_degrees().clamp(LARGEST_BEND_DEG.0, LARGEST_BEND_DEG.1)];
        values.extend(coefficients.iter().map(|value| value.clamp(-LARGEST_COEFFICIENT, LARGEST_COEFFICIENT)));
        let found = format!("discover --correction, {} samples", self.data.len());
        Effect { found, ..Effect::of(&LEARNED_CORRECTION, values) }
    }
}

/// w that minimises |r + A w|² + |D w|², from AᵗA, Aᵗr and the diagonal of D.
fn ridge_solution(
    mut information: DMatrix<f64>,
    gradient: &DVector<f64>,
    penalty: &DVector<f64>,
) -> Option<DVector<f64>> {
    for (j, penalty) in penalty.iter().enumerate() {
        information[(j, j)] += penalty * penalty;
    }
    information.cholesky().map(|factor| -factor.solve(gradient))
}

impl Correction {
    /// The entry `correction` of discrepancy.json.
    pub fn json(&self) -> Value {
        json!({
            "kept": self.model.is_some(),
            "before_mm": self.before_mm,
            "after_mm": self.after_mm,
            "words": self.words,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ridge_solution_is_least_squares_with_the_penalty_as_further_rows() {
        // Hastie, Tibshirani and Friedman, 2nd ed., exercise 3.12; solved by QR in place of the normal equations.
        let design = DMatrix::from_fn(12, 3, |row, c| ((row + 1) as f64 * (c + 1) as f64 * 0.7).sin());
        let r = DVector::from_fn(12, |row, _| (row as f64 * 1.3).cos());
        let penalty = DVector::from_column_slice(&[0.3, 2.0, 0.01]);
        let rows = DMatrix::from_fn(15, 3, |row, c| match row.checked_sub(12) {
            None => design[(row, c)],
            Some(own) => {
                if own == c {
                    penalty[c]
                } else {
                    0.0
                }
            }
        });
        let target = DVector::from_fn(15, |row, _| if row < 12 { -r[row] } else { 0.0 });
        let qr = rows.qr();
        let expected = qr.r().solve_upper_triangular(&qr.q().tr_mul(&target)).unwrap();
        let solution = ridge_solution(design.tr_mul(&design), &design.tr_mul(&r), &penalty).unwrap();
        assert!((&solution - &expected).norm() < 1e-9 * expected.norm(), "{solution} {expected}");
    }

    #[test]
    fn a_penalty_without_data_keeps_the_coefficients_at_zero() {
        let solution = ridge_solution(DMatrix::zeros(2, 2), &DVector::zeros(2), &DVector::from_element(2, 1.0));
        assert_eq!(solution, Some(DVector::zeros(2)));
    }
}
