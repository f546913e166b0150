//! Which terms a law needs: forward selection and backward elimination by what is left of sweeps that the fit did not see.
//!
//! All terms are columns of one linear least-squares problem, beside those of η, λ and the model's effects, which every law has. Its
//! normal equations are summed over groups of sweeps, so that a fit to any groups and its cost on others are small dense solutions.

use super::terms::Shared;
use crate::discover::sweeps::FOLDS;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// The most terms of a law.
///
/// Convention: what a person can read.
const MOST_TERMS: usize = 8;

/// A term must take away this share of what is left on sweeps that the fit did not see.
///
/// Convention: less is not worth reading.
const LEAST_GAIN: f64 = 0.02;

/// The relative ridge that keeps solutions finite.
///
/// Convention: a numerical guard.
const RELATIVE_RIDGE: f64 = 1e-6;

/// Sums over samples: DᵗD, Dᵗr and rᵗr.
#[derive(Debug, Clone)]
pub struct Sums {
    information: DMatrix<f64>,
    gradient: DVector<f64>,
    squares: f64,
}

impl Sums {
    /// Of no samples, for so many columns.
    pub fn zero(columns: usize) -> Self {
        Self { information: DMatrix::zeros(columns, columns), gradient: DVector::zeros(columns), squares: 0.0 }
    }

    /// Takes in the rows of some samples and their residuals.
    pub fn add(&mut self, rows: &DMatrix<f64>, residuals: &DVector<f64>) {
        self.information.gemm_tr(1.0, rows, rows, 1.0);
        self.gradient.gemv_tr(1.0, rows, residuals, 1.0);
        self.squares += residuals.norm_squared();
    }

    fn plus(mut self, other: &Self) -> Self {
        self.information += &other.information;
        self.gradient += &other.gradient;
        self.squares += other.squares;
        self
    }

    /// The coefficients of some columns that leave least.
    pub fn solution(&self, columns: &[usize]) -> Option<DVector<f64>> {
        let k = columns.len();
        let ridge = |a: usize, b: usize| if a == b { 1.0 + RELATIVE_RIDGE } else { 1.0 };
        let entry = |a: usize, b: usize| self.information[(columns[a], columns[b])] * ridge(a, b);
        let gradient = DVector::from_fn(k, |a, _| -self.gradient[columns[a]]);
        Some(DMatrix::from_fn(k, k, entry).cholesky()?.solve(&gradient))
    }

    /// What these coefficients leave.
    fn cost(&self, columns: &[usize], x: &DVector<f64>) -> f64 {
        let linear: f64 = columns.iter().zip(x).map(|(&c, x)| self.gradient[c] * x).sum();
        let pair = |(&a, xa): (&usize, &f64)| -> f64 {
            xa * columns.iter().zip(x).map(|(&b, xb)| self.information[(a, b)] * xb).sum::<f64>()
        };
        self.squares + 2.0 * linear + columns.iter().zip(x).map(pair).sum::<f64>()
    }
}

/// The sums of every block of sweeps that follow each other.
pub type Blocks = [Sums; FOLDS];

fn total<'a>(columns: usize, blocks: impl Iterator<Item = &'a Sums>) -> Sums {
    blocks.fold(Sums::zero(columns), Sums::plus)
}

/// What a fit sees, and the block that it is judged on.
struct Split {
    seen: Sums,
    held_out: Sums,
}

/// A selection among the columns from `fixed` on; the first ones are in every fit.
pub struct Selection {
    fixed: usize,
    columns: usize,
    /// One for each block.
    splits: Vec<Split>,
    seen: Sums,
    /// The value of a shared parameter that a column has, none for those without.
    tried: Vec<Option<Tried>>,
}

/// A parameter that all terms of a law share, and which of the values that are tried it has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tried {
    /// Which parameter.
    pub shared: Shared,
    /// The place of its value among those that are tried.
    pub place: usize,
}

impl Selection {
    /// Of all blocks but the one `without`.
    pub fn new(blocks: &Blocks, (fixed, tried): (usize, &[Option<Tried>]), without: Option<usize>) -> Self {
        let columns = fixed + tried.len();
        let used = || (0..FOLDS).filter(|block| Some(*block) != without);
        let sum = |is_seen: &dyn Fn(usize) -> bool| {
            total(columns, used().filter(|block| is_seen(*block)).map(|block| &blocks[block]))
        };
        let split = |out: usize| Split { seen: sum(&|block| block != out), held_out: blocks[out].clone() };
        Self { fixed, columns, splits: used().map(split).collect(), seen: sum(&|_| true), tried: tried.to_vec() }
    }

    /// The columns that help, those of every fit first.
    pub fn columns(&self) -> Vec<usize> {
        let mut chosen: Vec<usize> = (0..self.fixed).collect();
        let Some(mut cost) = self.cost(&chosen) else { return chosen };
        while chosen.len() < self.fixed + MOST_TERMS {
            let candidates = (self.fixed..self.columns).filter(|column| self.admits(&chosen, *column));
            let candidates: Vec<usize> = candidates.collect();
            let with = |column: usize| {
                let longer = [&chosen[..], &[column]].concat();
                let own = self.cost(&longer)?;
                Some((longer, own))
            };
            let best = candidates.into_par_iter().filter_map(with).min_by(|a, b| a.1.total_cmp(&b.1));
            match best {
                Some((longer, own)) if own < (1.0 - LEAST_GAIN) * cost => (chosen, cost) = (longer, own),
                _ => break,
            }
        }
        self.without_the_superfluous(chosen, cost)
    }

    /// Whether a column may join: a law has one value of each shared parameter.
    fn admits(&self, chosen: &[usize], column: usize) -> bool {
        let tried = |column: usize| column.checked_sub(self.fixed).and_then(|own| self.tried[own]);
        let agrees = |other: Tried| tried(column).is_none_or(|own| own.shared != other.shared || own == other);
        !chosen.contains(&column) && chosen.iter().filter_map(|other| tried(*other)).all(agrees)
    }

    /// Drops columns that later ones have made superfluous.
    fn without_the_superfluous(&self, mut chosen: Vec<usize>, mut cost: f64) -> Vec<usize> {
        loop {
            let shorter = (self.fixed..chosen.len()).filter_map(|place| {
                let mut shorter = chosen.clone();
                shorter.remove(place);
                let own = self.cost(&shorter)?;
                Some((shorter, own))
            });
            let best = shorter.min_by(|a, b| a.1.total_cmp(&b.1));
            match best {
                Some((shorter, own)) if (1.0 - LEAST_GAIN) * own < cost => (chosen, cost) = (shorter, own),
                _ => return chosen,
            }
        }
    }

    /// What a set of columns leaves on what its fits did not see.
    fn cost(&self, columns: &[usize]) -> Option<f64> {
        let cost = |split: &Split| Some(split.held_out.cost(columns, &split.seen.solution(columns)?));
        self.splits.iter().map(cost).sum()
    }

    /// The coefficients of some columns, fitted to all that the selection saw.
    pub fn solution(&self, columns: &[usize]) -> Option<DVector<f64>> {
        self.seen.solution(columns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;

    /// 500 rows of 40 columns of noise; the residual is made of the columns `truth`, and noise.
    fn blocks(truth: &[(usize, f64)], seed: u64) -> Blocks {
        let mut random = StdRng::seed_from_u64(seed);
        let mut blocks: Blocks = std::array::from_fn(|_| Sums::zero(40));
        for k in 0..500 {
            let rows = DMatrix::from_fn(1, 40, |_, _| random.sample::<f64, _>(StandardNormal));
            let noise: f64 = random.sample(StandardNormal);
            let sum: f64 = truth.iter().map(|(column, weight)| weight * rows[(0, *column)]).sum();
            blocks[k / 100].add(&rows, &DVector::from_element(1, noise - sum));
        }
        blocks
    }

    #[test]
    fn the_columns_of_which_the_residuals_are_made_are_chosen_and_no_others() {
        for seed in 0..8 {
            let blocks = blocks(&[(0, 0.3), (17, 1.0), (31, -0.6)], seed);
            let selection = Selection::new(&blocks, (2, &[None; 38]), None);
            let mut columns = selection.columns();
            let x = selection.solution(&columns).unwrap();
            assert!((x[2] - 1.0).abs() < 0.2, "{x}");
            columns.sort_unstable();
            assert_eq!(columns, [0, 1, 17, 31], "seed {seed}");
        }
    }

    #[test]
    fn of_noise_nothing_is_made() {
        let laws =
            (0..20).filter(|seed| Selection::new(&blocks(&[], *seed), (1, &[None; 39]), None).columns().len() > 1);
        assert!(laws.count() <= 1);
    }

    #[test]
    fn a_law_has_one_width_of_play_and_one_scale() {
        let blocks = blocks(&[(10, 1.0), (11, 0.5), (12, 0.5), (13, 0.5)], 3);
        let mut tried = [None; 39];
        let of = |shared, place| Some(Tried { shared, place });
        (tried[9], tried[10], tried[11]) = (of(Shared::HalfGap, 0), of(Shared::HalfGap, 1), of(Shared::HalfGap, 0));
        tried[12] = of(Shared::Scale, 1);
        let mut columns = Selection::new(&blocks, (1, &tried), None).columns();
        columns.sort_unstable();
        assert_eq!(columns, [0, 10, 12, 13]);
    }
}
