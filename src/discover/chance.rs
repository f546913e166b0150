//! What chance alone would make of this data: the null distribution of the search, and what η and λ hide.

use super::fit::{Fit, Problem};
use super::search::{common_waves, screw_frequencies, screw_waves, starts};
use crate::robot::Physics;
use crate::robot::effects::Starts;
use nalgebra::DMatrix;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rayon::prelude::*;

/// Experiments of pure noise that are drawn.
const DRAWS: usize = 200;
/// The share of experiments with nothing hidden in which chance may name something.
const FALSE_NAMES: f64 = 0.01;
/// Components of the gap that the null distribution is drawn with; of more, every so many.
const MOST_ROWS: usize = 3000;

/// What chance does.
#[derive(Debug, Clone)]
pub struct Chance {
    /// The gain in Schwarz's criterion that the best of the library exceeds in one of a hundred experiments of pure noise,
    /// on this data's own poses and times.
    pub least_gain: f64,
    /// Parts of effects that η and λ take up: a change of 0.1 mm in q̃ of this kind could not be seen.
    pub hidden: Vec<&'static Physics>,
}

impl Chance {
    /// Draws noise on the poses of a fit, and lets every effect that it lacks take what it can of it.
    pub fn of(problem: &Problem, fit: &Fit) -> Self {
        let (n, rows) = (problem.data.backbones(), problem.data.numbers());
        let stride = rows.div_ceil(MOST_ROWS);
        let thin = |columns: DMatrix<f64>| -> DMatrix<f64> {
            let samples = problem.data.len().div_ceil(stride);
            DMatrix::from_fn(n * samples, columns.ncols(), |r, c| columns[(n * (r / n * stride) + r % n, c)])
        };
        let base = thin(fit.jacobian.clone());
        let p = base.ncols();
        let price = (rows as f64).ln();
        let mut families: Vec<(f64, DMatrix<f64>)> = Vec::new();
        let mut hidden: Vec<&'static Physics> = Vec::new();
        let seen: Vec<(&'static Physics, DMatrix<f64>)> = starts(problem, fit)
            .into_par_iter()
            .filter(|(physics, _)| matches!(physics.starts, Starts::At(_)))
            .map(|(physics, model)| (physics, thin(problem.prospect(&model, &fit.path).0)))
            .collect();
        for (physics, columns) in seen {
            let own = columns.columns(p, columns.ncols() - p).into_owned();
            let free = beyond(&base, &own);
            if is_hidden(&own, &free) && !hidden.contains(&physics) {
                hidden.push(physics);
            }
            families.push((price * (physics.parameters)(n).len() as f64, orthonormal(free)));
        }
        let screws: Vec<(f64, DMatrix<f64>)> = screw_frequencies(problem.data)
            .into_par_iter()
            .flat_map_iter(|frequency| {
                let waves = thin(screw_waves(problem, frequency));
                [(3.0 * price, common_waves(&waves)), ((2 + n) as f64 * price, waves)]
                    .map(|(price, own)| (price, orthonormal(beyond(&base, &own))))
            })
            .collect();
        families.extend(screws);
        Self { least_gain: least_gain(&families, base.nrows()), hidden }
    }
}

/// The quantile of the best gain over draws of noise.
fn least_gain(families: &[(f64, DMatrix<f64>)], rows: usize) -> f64 {
    let mut random = StdRng::seed_from_u64(2);
    let noise = DMatrix::from_fn(DRAWS, rows, |_, _| random.sample::<f64, _>(StandardNormal));
    let gains: Vec<DMatrix<f64>> = families.par_iter().map(|(_, columns)| &noise * columns).collect();
    let best: Vec<f64> = (0..DRAWS)
        .map(|draw| {
            let gain = |(own, (price, _)): (&DMatrix<f64>, &(f64, DMatrix<f64>))| own.row(draw).norm_squared() - price;
            gains.iter().zip(families).map(gain).fold(f64::NEG_INFINITY, f64::max)
        })
        .collect();
    // The best of many: Gumbel's distribution, by its moments.
    let mean = best.iter().sum::<f64>() / DRAWS as f64;
    let sd = (best.iter().map(|gain| (gain - mean).powi(2)).sum::<f64>() / DRAWS as f64).sqrt();
    let scale = sd * 6f64.sqrt() / std::f64::consts::PI;
    let gumbel = mean - 0.5772 * scale - scale * (-(1.0 - FALSE_NAMES).ln()).ln();
    gumbel.max(0.0)
}

/// What is left of columns beyond what a basis can take up.
fn beyond(basis: &DMatrix<f64>, columns: &DMatrix<f64>) -> DMatrix<f64> {
    let mut information = basis.transpose() * basis;
    for j in 0..information.nrows() {
        information[(j, j)] = information[(j, j)] * (1.0 + 1e-12) + 1e-12;
    }
    match information.cholesky() {
        Some(factor) => columns - basis * factor.solve(&(basis.transpose() * columns)),
        None => columns.clone(),
    }
}

/// Columns of unit length, at right angles to each other; what has no length stays out.
fn orthonormal(columns: DMatrix<f64>) -> DMatrix<f64> {
    let qr = columns.qr();
    let lengths = qr.r().diagonal().map(f64::abs);
    let mut q = qr.q();
    for (mut column, length) in q.column_iter_mut().zip(lengths.iter()) {
        if *length < 1e-9 {
            column.fill(0.0);
        }
    }
    q
}

/// Whether some mix of an effect's parameters is lost: of a change that the residuals would show ten standard deviations large
/// if nothing else could give way, less than what chance gives is left.
fn is_hidden(own: &DMatrix<f64>, free: &DMatrix<f64>) -> bool {
    let whole = own.transpose() * own;
    let left = free.transpose() * free;
    let Some(root) = whole.cholesky().and_then(|factor| factor.l().try_inverse()) else { return true };
    let share = (&root * left * root.transpose()).symmetric_eigenvalues().min();
    // Ten standard deviations in every component, and a gain of twenty to be seen.
    share * 100.0 * (own.nrows() as f64) < 20.0
}
