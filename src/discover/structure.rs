//! The structure of residuals: whether they exceed noise, and what they follow.
//!
//! Whitened residuals of a model that lacks nothing are independent and of unit variance. Three statistics are compared with
//! their null distribution: the mean square, the correlation of successive samples, and the share that families of functions of
//! bend, motion and time explain. A mean square above noise alone may come from sigmas that are stated too small, so something is
//! only said to be missing where the residuals have an order as well. Noise is learned from what changes from one sample to the next, and the noise of a
//! tracker that filters does not: residuals that are no larger than the noise that is stated are that noise, whatever their order.

use super::data::Data;
use super::fit::Fit;
use super::noise::Noise;
use super::residuals::{Problem, Residual, stacked};
use crate::robot::{Mechanics, PerBackbone};
use crate::statistics::correlation::{autoregressive_design_effect, squares_and_products};
use crate::statistics::null_distribution::NullDistribution;
use crate::statistics::{chi_square, normal};
use nalgebra::{DMatrix, DVector, DVectorView, Vector2};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::{ChiSquared, StandardNormal};

/// Residuals count as this many standard deviations at most, so that a few samples far out make no structure.
///
/// Convention: twice the limit of the fit's loss.
const MOST_SIGMAS: f64 = 6.0;

/// The share of experiments without any missing effect in which something may be said to be missing.
///
/// Convention: the level of the test.
const LEVEL: f64 = 0.01;

/// Draws of what the families explain of noise.
///
/// Derived: ten of them lie beyond the quantile at half of [`LEVEL`], which is then known to 5 % of its value.
const DRAWS: usize = 2000;

/// Columns shorter than this share of their length after orthogonalisation depend on the others.
///
/// Convention: a numerical guard.
const LEAST_INDEPENDENT: f64 = 1e-6;

/// The variance of residuals that a family explains wholly.
///
/// Convention: a numerical guard.
const LEAST_VARIANCE: f64 = 1e-12;

/// The components of a residual that belong to the bend; the others are parts of q̃ that bend nothing.
///
/// Derived: a bend vector has two.
const BEND: usize = 2;

/// What residuals of a fit still hold.
#[derive(Debug, Clone, PartialEq)]
pub struct Structure {
    /// Mean square of the whitened residuals of the bend, and of what bends nothing; 1 is noise.
    pub mean_square: [f64; 2],
    /// Correlation of successive residuals in standard errors: bend along and across, then what bends nothing.
    pub successive: Vec<f64>,
    /// How much of the residuals each family of functions explains beyond what it would of noise, in standard errors; the largest
    /// first.
    pub follows: Vec<(&'static str, f64)>,
    /// Whether the bend, and what bends nothing, are no larger than the noise that is stated.
    pub is_as_stated: [bool; 2],
    /// What noise alone reaches.
    pub noise: NoiseQuantiles,
}

/// What the statistics exceed in a share of experiments of pure noise: `LEVEL` for the mean squares, half of it for each of the
/// two statistics of order, of which one suffices (Bonferroni).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoiseQuantiles {
    /// Of the mean squares.
    pub mean_square: [f64; 2],
    /// Of the largest correlation of successive residuals, for the bend and for what bends nothing.
    pub successive: [f64; 2],
    /// Of the largest of what the families explain.
    pub follows: f64,
}

impl Structure {
    /// Of a fit's residuals.
    pub fn new(problem: &Problem, fit: &Fit) -> Self {
        let data = problem.data;
        let clipped: Vec<Residual> =
            fit.residuals.iter().map(|r| r.map(|r| r.clamp(-MOST_SIGMAS, MOST_SIGMAS))).collect();
        let n = data.backbones();
        let clipped = DMatrix::from_row_slice(data.len(), n, stacked(&clipped).as_slice());
        let families = families(data, fit);
        let mut follows: Vec<(&'static str, f64)> =
            families.iter().map(|family| (family.name, family.explained(&clipped))).collect();
        follows.sort_by(|a, b| b.1.total_cmp(&a.1));
        // The parameters have taken their share of the degrees of freedom.
        let count = data.residual_count() as f64;
        let freedom = count / (count - fit.parameter_count() as f64).max(1.0);
        let mean_square = |first: usize, count: usize| {
            clipped.columns(first, count).norm_squared() / (data.len() * count) as f64 * freedom
        };
        Self {
            mean_square: [mean_square(0, BEND), mean_square(BEND, n - BEND)],
            successive: clipped.as_slice().chunks(data.len()).map(successive).collect(),
            follows,
            is_as_stated: is_as_stated(problem, fit, freedom),
            noise: NoiseQuantiles::new(data, &families),
        }
    }

    /// Whether a part (0 the bend, 1 what bends nothing) is more than noise: than the one that was learned, and the one that is stated.
    pub fn exceeds_noise(&self, part: usize) -> bool {
        !self.is_as_stated[part] && self.exceeds_learned(part)
    }

    /// Whether a part is more than the noise that was learned: larger, and with an order.
    pub fn exceeds_learned(&self, part: usize) -> bool {
        let own = if part == 0 { &self.successive[..BEND] } else { &self.successive[BEND..] };
        let largest = own.iter().fold(0.0f64, |most, correlation| most.max(correlation.abs()));
        let follows = self.follows.first().map_or(0.0, |(_, explained)| *explained);
        let has_order = largest > self.noise.successive[part] || follows > self.noise.follows;
        self.mean_square[part] > self.noise.mean_square[part] && has_order
    }

    /// By how much the mean square of a part exceeds that of noise.
    pub fn excess(&self, part: usize) -> f64 {
        (self.mean_square[part] - 1.0).max(0.0)
    }
}

/// Whether the bend, and what bends nothing, are no larger than a stated noise that is as alike from one sample to the next as they are; `freedom` is the
/// share of their squares that the parameters took.
fn is_as_stated(problem: &Problem, fit: &Fit, freedom: f64) -> [bool; 2] {
    let (data, stated) = (problem.data, Noise::stated(problem.data));
    let is_as_large = |columns: &[Vec<f64>]| {
        let known = columns.iter().map(|column| &column[problem.noise.unknown_start..]);
        let clipped: Vec<Vec<f64>> =
            known.map(|column| column.iter().map(|r| r.clamp(-MOST_SIGMAS, MOST_SIGMAS)).collect()).collect();
        let count = clipped.iter().map(Vec::len).sum::<usize>() as f64;
        let sums = clipped.iter().map(|column| squares_and_products(column));
        let [squares, products] = sums.fold([0.0; 2], |sum, own| [sum[0] + own[0], sum[1] + own[1]]);
        // The squares of a first-order autoregression are one of the correlation's square.
        let independent = count / autoregressive_design_effect((products / squares).powi(2));
        squares / count * freedom <= mean_square_quantile(independent)
    };
    let internal = |part: usize| problem.internal_mm(&fit.residuals, part).map(|mm| mm / stated.sd_internal_mm());
    let internal: Vec<Vec<f64>> = (0..data.backbones() - BEND).map(|part| internal(part).collect()).collect();
    [is_as_large(&problem.bend_whitened_by(&stated, &fit.residuals)), is_as_large(&internal)]
}

impl NoiseQuantiles {
    /// The largest of what the families explain is simulated within the span of their functions, since nothing else of noise is explained. What the fit takes of
    /// noise is left in it, which makes the quantiles larger by a little. The correlation of successive values of noise is normal, of unit variance, and that of
    /// one component independent of the others'.
    fn new(data: &Data, families: &[Family]) -> Self {
        let (samples, n) = (data.len(), data.backbones());
        let bases: Vec<_> = families.iter().flat_map(|family| family.basis.column_iter()).collect();
        let bases = DMatrix::from_columns(&bases);
        let span = orthonormal(&bases, &(&bases * 0.0), 0.0);
        let within: Vec<DMatrix<f64>> = families.iter().map(|family| family.basis.tr_mul(&span)).collect();
        let beyond = ChiSquared::new(samples.saturating_sub(span.ncols()).max(1) as f64);
        let mut random = StdRng::seed_from_u64(3);
        let mut explained = || {
            let noise = DVector::from_fn(span.ncols(), |_, _| random.sample::<f64, _>(StandardNormal));
            let all = noise.norm_squared() + beyond.as_ref().map_or(0.0, |beyond| random.sample(beyond));
            within.iter().map(|own| in_standard_errors(&(own * &noise), all, samples)).fold(0.0, f64::max)
        };
        let largest = (0..DRAWS).map(|_| (0..n).map(|_| explained()).fold(0.0, f64::max)).collect();
        // One of both signs for each component.
        let successive =
            |count: usize| normal::upper_quantile(0.5 * (1.0 - (1.0 - 0.5 * LEVEL).powf(1.0 / count as f64)));
        let mean_square = |count: usize| mean_square_quantile((count * samples) as f64);
        Self {
            mean_square: [mean_square(BEND), mean_square(n - BEND)],
            successive: [BEND, n - BEND].map(successive),
            follows: NullDistribution::new(largest).quantile(1.0 - 0.5 * LEVEL),
        }
    }
}

/// The quantile of χ²_f / f at 1 − [`LEVEL`].
pub fn mean_square_quantile(freedom: f64) -> f64 {
    chi_square::quantile(freedom, normal::upper_quantile(LEVEL)) / freedom
}

/// The correlation of successive values in standard errors, √n times the lag-one autocorrelation about zero.
fn successive(values: &[f64]) -> f64 {
    let [squares, products] = squares_and_products(values);
    if squares > 0.0 { products / squares * (values.len() as f64).sqrt() } else { 0.0 }
}

/// Functions that residuals may follow.
#[derive(Debug, Clone)]
struct Family {
    name: &'static str,
    /// An orthonormal basis of the functions and a constant, a row for each sample.
    basis: DMatrix<f64>,
}

impl Family {
    /// Of functions with these values at each sample, and `noisier` with the readings' noise once more. `samples` is the number of the residuals that will be
    /// held against them.
    fn new(name: &'static str, [rows, noisier]: [&[Vec<f64>]; 2], samples: usize) -> Self {
        let functions = rows.first().map_or(0, Vec::len);
        let of = |rows: &[Vec<f64>]| {
            DMatrix::from_fn(rows.len(), functions + 1, |k, c| if c == 0 { 1.0 } else { rows[k][c - 1] })
        };
        let values = of(rows);
        let noise = of(noisier) - &values;
        Self { name, basis: orthonormal(&values, &noise, samples as f64) }
    }

    /// How much of the residuals it explains, in the component of which it explains most.
    fn explained(&self, residuals: &DMatrix<f64>) -> f64 {
        let of_component =
            |own: DVectorView<f64>| in_standard_errors(&self.basis.tr_mul(&own), own.norm_squared(), residuals.nrows());
        residuals.column_iter().map(of_component).fold(0.0, f64::max)
    }
}

/// What projections on f functions explain of the squares of so many samples, in standard errors of what they would explain of noise:
/// (χ² − f) / √(2 f).
fn in_standard_errors(projections: &DVector<f64>, all: f64, samples: usize) -> f64 {
    let (squares, freedom) = (projections.norm_squared(), projections.len() as f64);
    let variance = (all - squares) / samples as f64;
    (squares / variance.max(LEAST_VARIANCE) - freedom) / (2.0 * freedom).sqrt()
}

/// An orthonormal basis of columns; those that depend on columns before them are left out, and those of which nothing but the readings' `noise` is new.
/// That noise is in the residuals too, which would seem to follow it: with a share f of noise in a column, n residuals follow it by up to n f, where
/// chance makes 1.
fn orthonormal(columns: &DMatrix<f64>, noise: &DMatrix<f64>, samples: f64) -> DMatrix<f64> {
    let mut basis: Vec<[DVector<f64>; 2]> = Vec::new();
    for (column, noise) in columns.column_iter().zip(noise.column_iter()) {
        let (mut own, mut own_noise) = (column.into_owned(), noise.into_owned());
        // Twice, since one pass of Gram and Schmidt loses digits.
        for _ in 0..2 {
            for [other, other_noise] in &basis {
                let share = other.dot(&own);
                own.axpy(-share, other, 1.0);
                own_noise.axpy(-share, other_noise, 1.0);
            }
        }
        let is_noise = samples * own_noise.norm_squared() > own.norm_squared();
        if own.norm() > LEAST_INDEPENDENT * column.norm() && !is_noise {
            let norm = own.norm();
            basis.push([own / norm, own_noise / norm]);
        }
    }
    if basis.is_empty() {
        return DMatrix::zeros(columns.nrows(), 0);
    }
    DMatrix::from_columns(&basis.into_iter().map(|[own, _]| own).collect::<Vec<_>>())
}

/// The families at the samples of a fit.
fn families(data: &Data, fit: &Fit) -> Vec<Family> {
    let mut random = StdRng::seed_from_u64(5);
    let mut noise = || data.sd_encoder_mm * random.sample::<f64, _>(StandardNormal);
    let log = &data.log;
    let mechanics = Mechanics::new(&fit.model);
    let q_mm = log.own_q_mm(&fit.model);
    let noisier_mm: Vec<PerBackbone> = q_mm.iter().map(|q| PerBackbone::from_fn(q.len(), |i| q[i] + noise())).collect();
    let noisier = mechanics.solve_path(&log.times_s, &noisier_mm, Some(&fit.path), None);
    let noisier: Vec<Vector2<f64>> = noisier.iter().map(|point| point.solution.bend).collect();
    let [own, noisier] = [(&q_mm[..], &fit.path[..]), (&noisier_mm[..], &noisier[..])]
        .map(|(q_mm, path)| functions(data, &mechanics, (q_mm, path)));
    let each = own.into_iter().zip(noisier);
    each.map(|((name, rows), (_, noisier))| {
        // Noise turns no direction: one that it might turn is held.
        let noisier = if name == DIRECTION { &rows } else { &noisier };
        Family::new(name, [&rows, noisier], data.len())
    })
    .collect()
}

/// The name of the family that follows the direction of each backbone's motion.
const DIRECTION: &str = "the direction of motion";

/// The values of each family's functions at every sample, from readings (mm) and the bends that they lead to (rad).
fn functions(
    data: &Data,
    mechanics: &Mechanics,
    (q_mm, path): (&[PerBackbone], &[Vector2<f64>]),
) -> Vec<(&'static str, Vec<Vec<f64>>)> {
    let log = &data.log;
    let list = |of: &PerBackbone| of.iter().copied().collect::<Vec<f64>>();
    let motions = mechanics.motions_from_readings(&log.times_s, path, q_mm);
    let (bend, motion) = (|k: usize| path[log.samples[k]], |k: usize| &motions[log.samples[k]]);
    let speed = |k: usize| mechanics.instant(bend(k), motion(k), |at| list(&at.arrival.speed_mm_per_s));
    let first_s = data.times_s[0];
    let duration_s = data.times_s[data.len() - 1] - first_s;
    let theta = |k: usize| {
        let theta = bend(k).norm();
        vec![theta, theta.powi(2), theta.powi(3)]
    };
    let delta = |k: usize| {
        let delta = bend(k).y.atan2(bend(k).x);
        (1..=3).map(|order| (f64::from(order) * delta).sin_cos()).flat_map(|(sin, cos)| [sin, cos]).collect()
    };
    // A drift, and a swing of about one and a half periods.
    let time = |k: usize| {
        let t = (data.times_s[k] - first_s) / duration_s;
        vec![t, t * t, (9.0 * t).sin(), (9.0 * t).cos()]
    };
    let q_tilde = |k: usize| q_mm[log.samples[k]].iter().flat_map(|q| [q.powi(2), q.powi(3)]).collect();
    let family = |name: &'static str, functions: &dyn Fn(usize) -> Vec<f64>| {
        (name, (0..data.len()).map(functions).collect::<Vec<_>>())
    };
    vec![
        family("the bend θ", &theta),
        family("the azimuth δ", &delta),
        family(DIRECTION, &|k| list(&motion(k).direction)),
        family("the speed", &speed),
        family("time", &time),
        family("q̃", &q_tilde),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(samples: usize, seed: u64) -> DMatrix<f64> {
        let mut random = StdRng::seed_from_u64(seed);
        DMatrix::from_fn(samples, 1, |_, _| random.sample::<f64, _>(StandardNormal))
    }

    fn sine(samples: usize) -> Family {
        let rows: Vec<Vec<f64>> = (0..samples).map(|k| vec![(0.1 * k as f64).sin()]).collect();
        Family::new("a sine", [&rows, &rows], samples)
    }

    #[test]
    fn the_mean_squares_quantile_is_that_of_chi_square() {
        // χ² at 0.99: 23.209 for 10, 135.807 for 100 degrees of freedom (any table).
        assert!((mean_square_quantile(10.0) - 2.3209).abs() < 0.005);
        assert!((mean_square_quantile(100.0) - 1.35807).abs() < 0.0005);
    }

    #[test]
    fn a_family_explains_of_noise_what_chi_square_says() {
        let family = sine(300);
        let explained: Vec<f64> = (0..2000).map(|seed| family.explained(&noise(300, seed))).collect();
        // With two functions (χ² − 2) / 2 exceeds 3.605 in 1 % (χ² at 0.99: 9.210).
        let beyond = explained.iter().filter(|z| **z > 3.605).count();
        assert!((8..=36).contains(&beyond), "{beyond} of 2000");
    }

    #[test]
    fn a_family_finds_its_own_function() {
        let residuals = noise(300, 1) + DMatrix::from_fn(300, 1, |k, _| (0.1 * k as f64).sin());
        // χ² is about 300 · ½ on two degrees of freedom.
        let explained = sine(300).explained(&residuals);
        assert!((60.0..95.0).contains(&explained), "{explained}");
    }

    #[test]
    fn successive_values_that_alternate_are_anticorrelated_and_noise_is_not() {
        let alternating: Vec<f64> = (0..100).map(|k| if k % 2 == 0 { 1.0 } else { -1.0 }).collect();
        assert!((successive(&alternating) + 9.9).abs() < 1e-9);
        let of_noise: Vec<f64> = (0..400).map(|seed| successive(noise(300, seed).as_slice())).collect();
        let square = of_noise.iter().map(|z| z * z).sum::<f64>() / 400.0;
        assert!((square - 1.0).abs() < 0.25, "{square}");
    }

    #[test]
    fn a_column_that_depends_on_others_adds_no_freedom() {
        let rows: Vec<Vec<f64>> = (0..50).map(|k| vec![f64::from(k), 3.0 - 2.0 * f64::from(k)]).collect();
        assert_eq!(Family::new("a line twice", [&rows, &rows], 50).basis.ncols(), 2);
    }

    #[test]
    fn a_column_of_which_noise_alone_is_new_adds_no_freedom() {
        // A line, and the same line read with a noise of 0.01.
        let mut random = StdRng::seed_from_u64(2);
        let mut read = |x: f64| x + 0.01 * random.sample::<f64, _>(StandardNormal);
        let rows: Vec<Vec<f64>> = (0..50).map(|k| vec![f64::from(k), read(f64::from(k))]).collect();
        let noisier: Vec<Vec<f64>> = rows.iter().map(|row| vec![row[0], read(row[1])]).collect();
        assert_eq!(Family::new("a line twice", [&rows, &rows], 50).basis.ncols(), 3);
        assert_eq!(Family::new("a line twice", [&rows, &noisier], 50).basis.ncols(), 2);
        // What is larger than the noise by far stays.
        let curved = |rows: &[Vec<f64>]| rows.iter().map(|row| vec![row[0], row[1].powi(2)]).collect::<Vec<_>>();
        assert_eq!(Family::new("a parabola", [&curved(&rows), &curved(&noisier)], 50).basis.ncols(), 3);
    }
}
