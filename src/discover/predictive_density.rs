//! The held-out predictive density: how probable a structure makes what it was not fitted to.
//!
//! The samples are cut into stretches that follow each other. A structure (effects, with parameters to be fitted) is fitted without a stretch
//! and gives the joint density of what was measured in it: both components of the bend, and the parts of q̃ that bend nothing, each with a
//! variance of its own that is learned without the stretch. The sum of the logarithms over the stretches is the structure's score.
//!
//! Where more than noise is expected [beside](Beside) the effects, a misfit counts as often as it comes anew: what a structure leaves of a component
//! beyond the noise is a *discrepancy* that is correlated along the travel, an Ornstein–Uhlenbeck process whose size and length are learned for each
//! component, also without the stretch that is judged. Of dense rows one is then used for each [`SPACING`] of the travel, since between them any
//! discrepancy is smooth.
//!
//! About a converged fit the refits without a stretch are linear steps. Their uncertainty is part of the density, which is Student's t:
//! the variances of a stretch are not exactly those of the others.

use super::fit::{Fit, prior_precision};
use super::noise::Noise;
use super::residuals::{Problem, Residual};
use crate::statistics::moments::mean;
use crate::statistics::order::mad_scale;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix2, Vector2};
use std::collections::BTreeMap;

/// Stretches that are left out, one after the other.
///
/// Convention: 5 to 10 folds are usual (Hastie, Tibshirani and Friedman, The Elements of Statistical Learning, 2nd ed., 7.10.1).
pub const STRETCHES: usize = 6;

/// One row is used for so much of half the range of the commands.
///
/// Convention: a discrepancy that changes more quickly is taken for noise.
const SPACING: f64 = 0.05;

/// The lengths along which a discrepancy may be correlated, in halves of the range.
///
/// Convention: from the [`SPACING`] to the whole range, each about twice the one before. What goes on for longer is a bend at rest, or a gain.
const LENGTHS: [f64; 6] = [0.05, 0.1, 0.2, 0.45, 1.0, 2.0];

/// The shares of the variance that may be independent from row to row; the rest is correlated.
///
/// Convention: from all of it to hardly any, as of a tracker that filters, each about a third of the one before.
const INDEPENDENT: [f64; 5] = [1.0, 0.3, 0.1, 0.03, 0.01];

/// Degrees of freedom of Student's t.
///
/// Convention: the usual choice for a robust error model (Lange, Little and Taylor 1989, J. Am. Stat. Assoc. 84:881, estimate 4 in several sets).
const DEGREES_OF_FREEDOM: f64 = 4.0;

/// The least variance that a structure may claim to leave, as a share of the noise's. If the model as given leaves less of a component,
/// that component is not judged, because nothing is to be explained in it.
///
/// Convention: half the sigma; noise is learned before, and no structure may claim that there is hardly any.
const LEAST_VARIANCE: f64 = 0.25;

/// Residuals count as this many standard deviations at most, so that a few samples far out decide nothing.
///
/// Convention: twice the limit of the fit's loss.
const MOST_SIGMAS: f64 = 6.0;

/// What is expected beside the effects of a structure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Beside {
    /// Noise alone: the machine lies in the library.
    Noise,
    /// A discrepancy as well: no library holds the machine.
    Discrepancy,
}

/// A row that structures are judged on.
#[derive(Debug, Clone, Copy)]
struct Row {
    sample: usize,
    /// The travel of the command since the row before, in halves of its range.
    travel: f64,
    stretch: usize,
}

/// A discrepancy beside a noise.
#[derive(Debug, Clone, Copy)]
struct Kind {
    /// The length of its correlation, in halves of the range.
    length: f64,
    /// The share of the variance that is independent from row to row.
    independent: f64,
}

/// The samples that structures are judged on, the same for all.
#[derive(Debug, Clone)]
pub struct Judged {
    rows: Vec<Row>,
    /// Half the range of the commands, rad.
    pub half_range: f64,
    /// Along and across the commands' main direction, from the axes of the bend.
    turn: Matrix2<f64>,
    /// The components that are judged: of the bend in that frame, then of what bends nothing.
    components: Vec<usize>,
    /// The noise's mean variance, of both components of the bend together and of each other: the units of squares.
    units: Vec<f64>,
    kinds: Vec<Kind>,
}

/// How well a structure foretells each stretch that it was not fitted to.
#[derive(Debug, Clone)]
pub struct Density {
    /// The logarithm of each stretch's density, but for a constant that all structures share.
    pub stretches: [f64; STRETCHES],
    /// The squares that the refits without each stretch leave in it, in units of the noise's.
    pub squares: f64,
}

impl Density {
    /// The sum over all stretches.
    pub fn total(&self) -> f64 {
        self.stretches.iter().sum()
    }
}

impl Judged {
    /// Of a problem's samples, after a start that nobody knows; `fit` is that of the model as given.
    pub fn new(problem: &Problem, fit: &Fit, beside: Beside) -> Self {
        let (data, model) = (problem.data, &fit.model);
        let by_q = model.robot.bend_by_displacement();
        let commands: Vec<Vector2<f64>> = data.log.own_q_mm(model).iter().map(|q| by_q.tr_mul(q)).collect();
        let (low, high) = commands.iter().fold((commands[0], commands[0]), |(low, high), u| (low.inf(u), high.sup(u)));
        let half_range = (0.5 * (high - low).amax()).max(f64::MIN_POSITIVE);
        let spacing = if beside == Beside::Noise { 0.0 } else { SPACING };
        let (mut rows, mut travel, mut at) = (Vec::new(), f64::INFINITY, data.log.samples[0]);
        for sample in problem.noise.unknown_start..data.len() {
            for step in at..data.log.samples[sample] {
                travel += (commands[step + 1] - commands[step]).norm() / half_range;
            }
            at = data.log.samples[sample];
            if travel >= spacing {
                rows.push(Row { sample, travel, stretch: 0 });
                travel = 0.0;
            }
        }
        let count = rows.len().max(1);
        rows.iter_mut().enumerate().for_each(|(place, row)| row.stretch = place * STRETCHES / count);
        let middle = commands.iter().sum::<Vector2<f64>>() / commands.len() as f64;
        let scatter: Matrix2<f64> = commands.iter().map(|u| (u - middle) * (u - middle).transpose()).sum();
        let turn = scatter.symmetric_eigen().eigenvectors.transpose();
        let n = data.backbones();
        let mut judged =
            Self { rows, half_range, turn, components: (0..n).collect(), units: Vec::new(), kinds: kinds(beside) };
        let (mut left, mut noise) = (vec![0.0; n], vec![0.0; n]);
        for row in &judged.rows {
            let own = judged.components_of(problem, row.sample, &fit.residuals[row.sample]);
            let variances = judged.noise_variances(problem, row.sample);
            for c in 0..n {
                left[c] += own[c] * own[c];
                noise[c] += variances[c];
            }
        }
        let count = judged.rows.len().max(1) as f64;
        judged.units = (0..n).map(|c| if c < 2 { 0.5 * (noise[0] + noise[1]) } else { noise[c] } / count).collect();
        judged.components.retain(|&c| left[c] > LEAST_VARIANCE * noise[c] && (c < 2 || beside == Beside::Noise));
        judged
    }

    /// The components of a sample's whitened residual, rad and mm.
    fn components_of(&self, problem: &Problem, sample: usize, whitened: &Residual) -> Residual {
        let bend = self.turn * problem.bend_unit(sample) * Vector2::new(whitened[0], whitened[1]);
        let internal = problem.internal_unit_mm(sample);
        Residual::from_fn(whitened.len(), |c| if c < 2 { bend[c] } else { whitened[c] * internal })
    }

    /// The variances of the noise alone of each component of a sample, rad² and mm².
    fn noise_variances(&self, problem: &Problem, sample: usize) -> Residual {
        let covariance = problem.bend_covariance(sample, &Noise { discrepancy_rad: 0.0, ..problem.noise });
        let bend = (self.turn * covariance * self.turn.transpose()).diagonal();
        let internal = problem.noise_internal_mm().powi(2);
        Residual::from_fn(problem.data.backbones(), |c| if c < 2 { bend[c] } else { internal })
    }

    /// The squares that noise alone leaves, in its units.
    pub fn noise_squares(&self, problem: &Problem) -> f64 {
        let of_row = |row: &Row| {
            let noise = self.noise_variances(problem, row.sample);
            self.components.iter().map(|&c| noise[c] / self.units[c]).sum::<f64>()
        };
        self.rows.iter().map(of_row).sum()
    }

    /// Of a converged fit.
    pub fn of_fit(&self, problem: &Problem, fit: &Fit) -> Option<Density> {
        self.density(problem, &fit.residuals, &fit.jacobian, &prior_precision(&fit.model))
    }

    /// Of whitened residuals, their derivatives by the parameters, and how precisely these are known beforehand; none where the rows do not determine it.
    pub fn density(
        &self,
        problem: &Problem,
        residuals: &[Residual],
        jacobian: &DMatrix<f64>,
        precision: &DVector<f64>,
    ) -> Option<Density> {
        let mut rows = Rows::new(self, problem, residuals, jacobian)?;
        let step = rows.least_squares_step(precision)?;
        rows.left = (0..self.components.len()).map(|place| rows.mean_square(place, &step)).collect();
        let learned: Vec<[Learned; STRETCHES]> =
            (0..self.components.len()).map(|place| rows.learned(place, &step, precision.len())).collect();
        let mut whitened: BTreeMap<(usize, usize), Vec<Equations>> = BTreeMap::new();
        let mut density = Density { stretches: [0.0; STRETCHES], squares: 0.0 };
        for stretch in 0..STRETCHES {
            let (mut rest, mut held_out) = (Equations::zero(precision.len() + 1), Equations::zero(precision.len() + 1));
            for (place, learned) in learned.iter().enumerate() {
                let Learned { kind, factor } = learned[stretch];
                let each = whitened.entry((place, kind)).or_insert_with(|| rows.equations(place, self.kinds[kind]));
                for (own, equations) in each.iter().enumerate() {
                    let side = if own == stretch { &mut held_out } else { &mut rest };
                    side.add_scaled(equations, factor);
                }
            }
            let refit = Refit::new(&rest, precision)?;
            density.stretches[stretch] = refit.foretells(&held_out)?;
            density.squares += rows.squares(stretch, &refit.step);
        }
        density.total().is_finite().then_some(density)
    }
}

/// What may be left beside the effects.
fn kinds(beside: Beside) -> Vec<Kind> {
    // Without a correlation the length is of no consequence.
    let noise = Kind { length: LENGTHS[0], independent: INDEPENDENT[0] };
    let correlated =
        INDEPENDENT[1..].iter().flat_map(|&independent| LENGTHS.map(|length| Kind { length, independent }));
    match beside {
        Beside::Noise => vec![noise],
        Beside::Discrepancy => [noise].into_iter().chain(correlated).collect(),
    }
}

/// What is learned of a component without a stretch.
#[derive(Debug, Clone, Copy)]
struct Learned {
    /// The place of the likeliest kind.
    kind: usize,
    /// What its variances are multiplied by.
    factor: f64,
}

/// The rows of one structure: components, with derivatives in the rows of each matrix and the residual in the last.
struct Rows<'a> {
    judged: &'a Judged,
    /// Of each component that is judged, a column for each row, rad or mm.
    values: Vec<DMatrix<f64>>,
    /// The noise's variance of each component and row, rad² or mm².
    noise: Vec<Vec<f64>>,
    /// The mean square that least squares leave of each component, the unit of its variances.
    left: Vec<f64>,
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
    fn new(judged: &'a Judged, problem: &Problem, residuals: &[Residual], jacobian: &DMatrix<f64>) -> Option<Self> {
        let (n, p) = (problem.data.backbones(), jacobian.ncols());
        let mut values = vec![DMatrix::zeros(p + 1, judged.rows.len()); judged.components.len()];
        let mut noise = vec![Vec::with_capacity(judged.rows.len()); judged.components.len()];
        for (place, row) in judged.rows.iter().enumerate() {
            let k = row.sample;
            for column in 0..=p {
                let whitened = match column == p {
                    true => residuals[k],
                    false => Residual::from_fn(n, |c| jacobian[(n * k + c, column)]),
                };
                let own = judged.components_of(problem, k, &whitened);
                judged.components.iter().zip(&mut values).for_each(|(&c, values)| values[(column, place)] = own[c]);
            }
            let variances = judged.noise_variances(problem, k);
            judged.components.iter().zip(&mut noise).for_each(|(&c, noise)| noise.push(variances[c]));
        }
        values.iter_mut().for_each(clip);
        let is_finite = values.iter().all(|values| values.iter().all(|value| value.is_finite()));
        (judged.rows.len() > p && is_finite).then_some(Self { judged, values, noise, left: Vec::new() })
    }

    /// The mean square of a component after a step of the parameters, at the least that of hardly any noise.
    fn mean_square(&self, place: usize, step: &DVector<f64>) -> f64 {
        let squares = self.residuals(place, step).iter().map(|r| r * r).sum::<f64>();
        (squares / self.judged.rows.len() as f64).max(LEAST_VARIANCE * self.mean_noise(place))
    }

    /// The mean variance of the noise of a component.
    fn mean_noise(&self, place: usize) -> f64 {
        mean(self.noise[place].iter().copied())
    }

    /// The residuals of a component after a step of the parameters.
    fn residuals(&self, place: usize, step: &DVector<f64>) -> DVector<f64> {
        let p = step.len();
        let values = &self.values[place];
        values.rows(0, p).tr_mul(step) + values.row(p).transpose()
    }

    /// The step of the parameters that leaves least squares, each component in units of what is left of it.
    fn least_squares_step(&self, precision: &DVector<f64>) -> Option<DVector<f64>> {
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
    fn learned(&self, place: usize, step: &DVector<f64>, parameters: usize) -> [Learned; STRETCHES] {
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
    fn likelihoods(&self, place: usize, kind: Kind, residuals: &DVector<f64>) -> [[f64; 3]; STRETCHES] {
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
    fn equations(&self, place: usize, kind: Kind) -> Vec<Equations> {
        let values = &self.values[place];
        let mut each = vec![Equations::zero(values.nrows()); STRETCHES];
        let mut state = DVector::zeros(values.nrows());
        for (at, (row, step)) in self.judged.rows.iter().zip(self.filter(place, kind)).enumerate() {
            state *= step.kept;
            let innovation = values.column(at) - &state;
            state.axpy(step.gain, &innovation, 1.0);
            each[row.stretch].add(&innovation, step.variance);
        }
        each
    }

    /// What a step of the parameters leaves in a stretch, in units of the noise's squares.
    fn squares(&self, stretch: usize, step: &DVector<f64>) -> f64 {
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

/// Normal equations of whitened rows, the residual as their last column.
#[derive(Debug, Clone)]
struct Equations {
    products: DMatrix<f64>,
    log_variances: f64,
    count: f64,
}

impl Equations {
    fn zero(columns: usize) -> Self {
        Self { products: DMatrix::zeros(columns, columns), log_variances: 0.0, count: 0.0 }
    }

    fn add(&mut self, innovation: &DVector<f64>, variance: f64) {
        self.products.ger(1.0 / variance, innovation, innovation, 1.0);
        self.log_variances += variance.ln();
        self.count += 1.0;
    }

    /// Adds others whose variances are so many times what they were whitened by.
    fn add_scaled(&mut self, other: &Self, factor: f64) {
        self.products += &other.products / factor;
        self.log_variances += other.log_variances + other.count * factor.ln();
        self.count += other.count;
    }

    fn information(&self) -> DMatrix<f64> {
        let p = self.products.nrows() - 1;
        self.products.view((0, 0), (p, p)).into_owned()
    }

    fn gradient(&self) -> DVector<f64> {
        let p = self.products.nrows() - 1;
        self.products.view((0, p), (p, 1)).column(0).into_owned()
    }

    fn squares(&self) -> f64 {
        let p = self.products.nrows() - 1;
        self.products[(p, p)]
    }
}

/// A fit to all stretches but one, to first order.
struct Refit {
    information: DMatrix<f64>,
    factor: Cholesky<f64, Dyn>,
    step: DVector<f64>,
}

impl Refit {
    fn new(rest: &Equations, precision: &DVector<f64>) -> Option<Self> {
        let information = rest.information() + DMatrix::from_diagonal(precision);
        let factor = information.clone().cholesky()?;
        let step = -factor.solve(&rest.gradient());
        Some(Self { information, factor, step })
    }

    /// The logarithm of the density of a stretch that it did not see, but for a constant.
    fn foretells(&self, stretch: &Equations) -> Option<f64> {
        let own = stretch.information();
        let (gradient, step) = (stretch.gradient(), &self.step);
        let left = stretch.squares() + 2.0 * gradient.dot(step) + step.dot(&(&own * step));
        let slope = gradient + &own * step;
        let both = (&self.information + own).cholesky()?;
        let squares = (left - slope.dot(&both.solve(&slope))).max(0.0);
        let log_determinant = stretch.log_variances + log_determinant(&both) - log_determinant(&self.factor);
        let nu = DEGREES_OF_FREEDOM;
        Some(-0.5 * log_determinant - 0.5 * (nu + stretch.count) * (squares / nu).ln_1p())
    }
}

fn log_determinant(factor: &Cholesky<f64, Dyn>) -> f64 {
    2.0 * factor.l_dirty().diagonal().iter().map(|x| x.ln()).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;

    /// Thirty rows of two components, two parameters and a residual, in stretches of five.
    fn rows(judged: &Judged) -> Rows<'_> {
        let mut random = StdRng::seed_from_u64(3);
        let mut matrix = || DMatrix::from_fn(3, 30, |_, _| random.sample::<f64, _>(StandardNormal));
        let noise = vec![(0..30).map(|k| 0.1 + 0.01 * f64::from(k)).collect(), vec![0.2; 30]];
        Rows { judged, values: vec![matrix(), matrix()], noise, left: vec![0.9, 0.7] }
    }

    fn judged() -> Judged {
        let row = |k: usize| Row { sample: k, travel: 0.05 + 0.02 * (k % 3) as f64, stretch: k / 5 };
        let (components, units) = (vec![0, 1], vec![1.0; 2]);
        let kinds = kinds(Beside::Discrepancy);
        Judged {
            rows: (0..30).map(row).collect(),
            half_range: 1.0,
            turn: Matrix2::identity(),
            components,
            units,
            kinds,
        }
    }

    const KIND: Kind = Kind { length: 0.3, independent: 0.4 };

    /// The covariance of a stretch's rows under a discrepancy, written out.
    fn covariance(rows: &Rows, stretch: usize, place: usize) -> DMatrix<f64> {
        let places: Vec<f64> = rows
            .judged
            .rows
            .iter()
            .scan(0.0, |at, row| {
                *at += row.travel;
                Some(*at)
            })
            .collect();
        DMatrix::from_fn(5, 5, |a, b| {
            let (a, b) = (5 * stretch + a, 5 * stretch + b);
            let relative = rows.noise[place][a] / rows.noise[place].iter().sum::<f64>() * 30.0;
            let noise = if a == b { KIND.independent * relative } else { 0.0 };
            let shared = (1.0 - KIND.independent) * (-(places[a] - places[b]).abs() / KIND.length).exp();
            rows.left[place] * (shared + noise)
        })
    }

    #[test]
    fn the_filter_whitens_by_the_covariance_of_noise_and_discrepancy() {
        let judged = judged();
        let rows = rows(&judged);
        for place in 0..2 {
            let residuals = rows.values[place].row(2).transpose();
            let likelihoods = rows.likelihoods(place, KIND, &residuals);
            for (stretch, own) in rows.equations(place, KIND).iter().enumerate() {
                let covariance = covariance(&rows, stretch, place);
                let log_determinant = covariance.determinant().ln();
                let values = rows.values[place].columns(5 * stretch, 5).into_owned();
                let products = &values * covariance.try_inverse().unwrap() * values.transpose();
                assert!((&own.products - &products).amax() < 1e-10);
                assert!((own.log_variances - log_determinant).abs() < 1e-10 && own.count == 5.0);
                let [squares, log_variances, count] = likelihoods[stretch];
                assert!((squares - products[(2, 2)]).abs() < 1e-10 && (log_variances - log_determinant).abs() < 1e-10);
                assert_eq!(count, 5.0);
            }
        }
    }

    #[test]
    fn a_stretch_is_foretold_by_the_density_of_students_t_with_the_uncertainty_of_the_parameters() {
        let judged = judged();
        let rows = rows(&judged);
        let white = Kind { length: 1.0, independent: 1.0 };
        let factors = [1.3, 0.6];
        let (mut rest, mut held_out) = (Equations::zero(3), Equations::zero(3));
        for (place, factor) in factors.into_iter().enumerate() {
            for (stretch, own) in rows.equations(place, white).iter().enumerate() {
                if stretch == 2 { held_out.add_scaled(own, factor) } else { rest.add_scaled(own, factor) }
            }
        }
        let refit = Refit::new(&rest, &DVector::repeat(2, 1e-4)).unwrap();
        // Rows of the stretch, each by its own variance.
        let (mut columns, mut log_variances) = (Vec::new(), 0.0);
        for (place, factor) in factors.into_iter().enumerate() {
            for k in 10..15 {
                let variance = factor * rows.left[place] * rows.noise[place][k] / rows.mean_noise(place);
                columns.push(rows.values[place].column(k) / variance.sqrt());
                log_variances += variance.ln();
            }
        }
        let slopes = DMatrix::from_fn(10, 2, |row, column| columns[row][column]);
        let left = DVector::from_fn(10, |row, _| columns[row][2]) + &slopes * &refit.step;
        let spread = DMatrix::identity(10, 10) + &slopes * refit.factor.inverse() * slopes.transpose();
        let squares = left.dot(&(spread.clone().try_inverse().unwrap() * &left));
        let log_determinant = spread.determinant().ln() + log_variances;
        let expected =
            -0.5 * log_determinant - 0.5 * (DEGREES_OF_FREEDOM + 10.0) * (1.0 + squares / DEGREES_OF_FREEDOM).ln();
        assert!((refit.foretells(&held_out).unwrap() - expected).abs() < 1e-9);
    }

    #[test]
    fn of_noise_and_of_a_walk_the_kind_is_learned() {
        let mut random = StdRng::seed_from_u64(5);
        let row = |k: usize| Row { sample: k, travel: 0.05, stretch: k / 50 };
        let mut judged = Judged { rows: (0..300).map(row).collect(), ..judged() };
        judged.components = vec![0];
        let noise: Vec<f64> = (0..300).map(|_| random.sample::<f64, _>(StandardNormal)).collect();
        let kept = (-0.05f64 / 0.45).exp();
        let walk: Vec<f64> = noise
            .iter()
            .scan(0.0, |at, own| {
                *at = kept * *at + (1.0 - kept * kept).sqrt() * own;
                Some(*at)
            })
            .collect();
        for (values, is_walk) in [(&noise, false), (&walk, true)] {
            let values = vec![DMatrix::from_row_slice(1, 300, values)];
            let rows = Rows { judged: &judged, values, noise: vec![vec![1.0; 300]], left: vec![1.0] };
            for Learned { kind, factor } in rows.learned(0, &DVector::zeros(0), 0) {
                let Kind { length, independent } = judged.kinds[kind];
                assert_eq!(independent <= 0.03 && (0.2..=1.0).contains(&length), is_walk, "{length} {independent}");
                assert_eq!(independent == 1.0, !is_walk, "{length} {independent}");
                assert!((0.6..1.7).contains(&factor), "{factor}");
            }
        }
    }
}
