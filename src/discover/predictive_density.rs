//! The held-out predictive density: how probable a structure makes what it was not fitted to.
//!
//! The samples are cut into stretches that follow each other. A structure (effects, with parameters to be fitted) is fitted without a stretch
//! and gives the joint density of the bends that were measured in it; the sum of the logarithms over the stretches is its score. A misfit
//! counts as often as it comes anew: what a structure leaves beyond the noise is a *discrepancy* that is correlated along the travel,
//! an Ornstein–Uhlenbeck process whose size and length are learned for each structure, without the stretch that is judged. Of dense rows one is used
//! for each [`SPACING`] of the travel, since between them any discrepancy is smooth.
//!
//! About a converged fit the refits without a stretch are linear steps. Their uncertainty is part of the density, which is Student's t:
//! the discrepancy of a stretch is not exactly as large as that of the others.

use super::fit::{Fit, prior_precision};
use super::noise::Noise;
use super::residuals::Problem;
use crate::statistics::moments::mean;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix2, Vector2};
use std::ops::AddAssign;

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

/// The least variance that a structure may claim to leave, as a share of the noise's. If the model as given leaves less of a component of the
/// bend, that component is not judged, because nothing is to be explained in it.
///
/// Convention: half the sigma; noise is learned before, and no structure may claim that there is hardly any.
const LEAST_VARIANCE: f64 = 0.25;

/// The samples that structures are judged on, the same for all.
#[derive(Debug, Clone)]
pub struct Judged {
    /// Of each row its sample, the travel of the command since the row before, and the stretch.
    rows: Vec<(usize, f64, usize)>,
    /// Half the range of the commands, rad.
    pub half_range: f64,
    /// Along and across the commands' main direction, from the axes of the bend.
    turn: Matrix2<f64>,
    /// The components of the bend in that frame that are judged.
    components: Vec<usize>,
}

/// How well a structure foretells each stretch that it was not fitted to.
#[derive(Debug, Clone)]
pub struct Density {
    /// The logarithm of each stretch's density, but for a constant that all structures share.
    pub stretches: [f64; STRETCHES],
    /// The squares that the refits without each stretch leave in it, rad².
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
    pub fn new(problem: &Problem, fit: &Fit) -> Self {
        let (data, model) = (problem.data, &fit.model);
        let by_q = model.robot.bend_by_displacement();
        let commands: Vec<Vector2<f64>> = data.log.own_q_mm(model).iter().map(|q| by_q.tr_mul(q)).collect();
        let (low, high) = commands.iter().fold((commands[0], commands[0]), |(low, high), u| (low.inf(u), high.sup(u)));
        let half_range = (0.5 * (high - low).amax()).max(f64::MIN_POSITIVE);
        let (mut rows, mut travel, mut at) = (Vec::new(), f64::INFINITY, data.log.samples[0]);
        for k in problem.noise.unknown_start..data.len() {
            for step in at..data.log.samples[k] {
                travel += (commands[step + 1] - commands[step]).norm() / half_range;
            }
            at = data.log.samples[k];
            if travel >= SPACING {
                rows.push((k, travel, 0));
                travel = 0.0;
            }
        }
        let count = rows.len().max(1);
        rows.iter_mut().enumerate().for_each(|(place, row)| row.2 = place * STRETCHES / count);
        let middle = commands.iter().sum::<Vector2<f64>>() / commands.len() as f64;
        let scatter: Matrix2<f64> = commands.iter().map(|u| (u - middle) * (u - middle).transpose()).sum();
        let turn = scatter.symmetric_eigen().eigenvectors.transpose();
        let (mut left, mut noise) = (Vector2::zeros(), Vector2::zeros());
        for &(k, ..) in &rows {
            let own = turn * problem.bend_unit(k) * Vector2::new(fit.residuals[k][0], fit.residuals[k][1]);
            left += own.component_mul(&own);
            noise += noise_variances(problem, &turn, k);
        }
        let components = (0..2).filter(|&c| left[c] > LEAST_VARIANCE * noise[c]).collect();
        Self { rows, half_range, turn, components }
    }

    /// The squares that noise alone leaves of the rows, rad².
    pub fn noise_squares(&self, problem: &Problem) -> f64 {
        let noise = Noise { discrepancy_rad: 0.0, ..problem.noise };
        self.rows.iter().map(|row| problem.bend_covariance(row.0, &noise).trace()).sum()
    }

    /// Of a converged fit.
    pub fn of_fit(&self, problem: &Problem, fit: &Fit) -> Option<Density> {
        self.density(problem, &fit.residuals, &fit.jacobian, &prior_precision(&fit.model))
    }

    /// Of whitened residuals, their derivatives by the parameters, and how precisely these are known beforehand; none where the rows do not determine it.
    pub fn density(
        &self,
        problem: &Problem,
        residuals: &[super::residuals::Residual],
        jacobian: &DMatrix<f64>,
        precision: &DVector<f64>,
    ) -> Option<Density> {
        let rows = Rows::new(self, problem, residuals, jacobian, precision)?;
        let correlated = INDEPENDENT[1..].iter().flat_map(|&share| LENGTHS.map(|length| (length, share)));
        // Without a correlation the length is of no consequence.
        let kinds = [(LENGTHS[0], INDEPENDENT[0])].into_iter().chain(correlated);
        let each: Vec<Vec<Equations>> = kinds.map(|(length, share)| rows.equations(length, share)).collect();
        let mut density = Density { stretches: [0.0; STRETCHES], squares: 0.0 };
        for stretch in 0..STRETCHES {
            let fits = each
                .iter()
                .filter_map(|own| Some((Refit::without(own, stretch, precision, rows.least)?, &own[stretch])));
            let (best, held_out) = fits.max_by(|a, b| a.0.likelihood.total_cmp(&b.0.likelihood))?;
            density.stretches[stretch] = best.foretells(held_out)?;
            density.squares += rows.squares(stretch, 0, &best.step) + rows.squares(stretch, 1, &best.step);
        }
        density.total().is_finite().then_some(density)
    }
}

/// The rows of one structure: bends, with derivatives in the columns and the residual in the last.
struct Rows<'a> {
    judged: &'a Judged,
    /// Of each row and component of the bend, rad.
    values: [DMatrix<f64>; 2],
    /// The noise's variance of each row and component, rad².
    noise: Vec<Vector2<f64>>,
    /// The mean square that least squares leave of each component, rad²; the unit of its variances.
    left: [f64; 2],
    /// What these are multiplied by at the least, so that hardly less than the noise is claimed.
    least: f64,
}

impl<'a> Rows<'a> {
    fn new(
        judged: &'a Judged,
        problem: &Problem,
        residuals: &[super::residuals::Residual],
        jacobian: &DMatrix<f64>,
        precision: &DVector<f64>,
    ) -> Option<Self> {
        let (n, p) = (problem.data.backbones(), jacobian.ncols());
        let mut values = [0, 1].map(|_| DMatrix::zeros(p + 1, judged.rows.len()));
        let mut noise = Vec::with_capacity(judged.rows.len());
        for (place, &(k, ..)) in judged.rows.iter().enumerate() {
            let unit = judged.turn * problem.bend_unit(k);
            for column in 0..=p {
                let whitened = match column == p {
                    true => Vector2::new(residuals[k][0], residuals[k][1]),
                    false => Vector2::new(jacobian[(n * k, column)], jacobian[(n * k + 1, column)]),
                };
                let bend = unit * whitened;
                (values[0][(column, place)], values[1][(column, place)]) = (bend.x, bend.y);
            }
            noise.push(noise_variances(problem, &judged.turn, k));
        }
        let mut rows = Self { judged, values, noise, left: [0.0; 2], least: 0.0 };
        let step = rows.least_squares_step(precision)?;
        for &c in &judged.components {
            let squares: f64 = (0..STRETCHES).map(|stretch| rows.squares(stretch, c, &step)).sum();
            let least = LEAST_VARIANCE * rows.mean_noise(c);
            rows.left[c] = (squares / rows.noise.len() as f64).max(least);
            rows.least = rows.least.max(least / rows.left[c]);
        }
        (judged.rows.len() > p && rows.left.iter().all(|square| square.is_finite())).then_some(rows)
    }

    /// The mean variance of the noise of a component, rad².
    fn mean_noise(&self, component: usize) -> f64 {
        mean(self.noise.iter().map(|noise| noise[component]))
    }

    /// The step of the parameters that leaves least squares, whatever the noise.
    fn least_squares_step(&self, precision: &DVector<f64>) -> Option<DVector<f64>> {
        let mut all = Equations::zero(self.values[0].nrows());
        let unit = mean(self.noise.iter().map(|noise| noise.mean()));
        let values = self.judged.components.iter().map(|&c| &self.values[c]);
        values.for_each(|values| all.products += values * values.transpose() / unit);
        let factor = (all.information() + DMatrix::from_diagonal(precision)).cholesky()?;
        Some(-factor.solve(&all.gradient()))
    }

    /// The normal equations of each stretch, whitened by the Kalman filter of a discrepancy of this length beside a noise that has this share of
    /// the variance.
    fn equations(&self, length: f64, share: f64) -> Vec<Equations> {
        let columns = self.values[0].nrows();
        let mut each = vec![Equations::zero(columns); STRETCHES];
        for &component in &self.judged.components {
            let values = &self.values[component];
            let mut state = DVector::zeros(columns);
            let discrepancy = (1.0 - share) * self.left[component];
            let white = share * self.left[component] / self.mean_noise(component);
            let mut variance = discrepancy;
            let mut last = None;
            for (place, &(_, travel, stretch)) in self.judged.rows.iter().enumerate() {
                let kept = if last == Some(stretch) { (-travel / length).exp() } else { 0.0 };
                last = Some(stretch);
                state *= kept;
                variance = kept * kept * variance + (1.0 - kept * kept) * discrepancy;
                let noise = white * self.noise[place][component];
                let expected = variance + noise;
                let innovation = values.column(place) - &state;
                state.axpy(variance / expected, &innovation, 1.0);
                variance *= noise / expected;
                each[stretch].add(&innovation, expected);
            }
        }
        each
    }

    /// What a step of the parameters leaves of a component in a stretch, rad².
    fn squares(&self, stretch: usize, component: usize, step: &DVector<f64>) -> f64 {
        let own = self.judged.rows.iter().enumerate().filter(|(_, row)| row.2 == stretch);
        let left = own.map(|(place, _)| {
            let column = self.values[component].column(place);
            (column[step.len()] + column.rows(0, step.len()).dot(step)).powi(2)
        });
        left.sum()
    }
}

/// The variances of the noise alone of a sample's bend in a turned frame, rad².
fn noise_variances(problem: &Problem, turn: &Matrix2<f64>, k: usize) -> Vector2<f64> {
    let covariance = problem.bend_covariance(k, &Noise { discrepancy_rad: 0.0, ..problem.noise });
    (turn * covariance * turn.transpose()).diagonal()
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

impl AddAssign<&Self> for Equations {
    fn add_assign(&mut self, other: &Self) {
        self.products += &other.products;
        self.log_variances += other.log_variances;
        self.count += other.count;
    }
}

/// A fit to all stretches but one, to first order.
struct Refit {
    information: DMatrix<f64>,
    factor: Cholesky<f64, Dyn>,
    step: DVector<f64>,
    /// What the variances are multiplied by.
    variance: f64,
    /// The logarithm of the likelihood of the rows that were seen.
    likelihood: f64,
}

impl Refit {
    fn without(each: &[Equations], stretch: usize, precision: &DVector<f64>, least: f64) -> Option<Self> {
        let mut rest = Equations::zero(each[0].products.nrows());
        each.iter().enumerate().filter(|(own, _)| *own != stretch).for_each(|(_, own)| rest += own);
        let p = rest.products.nrows() - 1;
        let information = rest.information() + DMatrix::from_diagonal(precision);
        let factor = information.clone().cholesky()?;
        let gradient = rest.gradient();
        let step = -factor.solve(&gradient);
        let squares = (rest.squares() + gradient.dot(&step)).max(0.0);
        let variance = (squares / (rest.count - p as f64).max(1.0)).max(least);
        let likelihood = -0.5 * (rest.count * variance.ln() + rest.log_variances + squares / variance);
        Some(Self { information, factor, step, variance, likelihood })
    }

    /// The logarithm of the density of a stretch that it did not see, but for a constant.
    fn foretells(&self, stretch: &Equations) -> Option<f64> {
        let own = stretch.information();
        let (gradient, step) = (stretch.gradient(), &self.step);
        let left = stretch.squares() + 2.0 * gradient.dot(step) + step.dot(&(&own * step));
        let slope = gradient + &own * step;
        let both = (&self.information + own).cholesky()?;
        let squares = (left - slope.dot(&both.solve(&slope))).max(0.0) / self.variance;
        let log_determinant = stretch.count * self.variance.ln() + stretch.log_variances + log_determinant(&both)
            - log_determinant(&self.factor);
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

    /// Thirty rows of two parameters and a residual, in stretches of five.
    fn rows(judged: &Judged) -> Rows<'_> {
        let mut random = StdRng::seed_from_u64(3);
        let mut matrix = || DMatrix::from_fn(3, 30, |_, _| random.sample::<f64, _>(StandardNormal));
        let noise = (0..30).map(|k| Vector2::new(0.1 + 0.01 * f64::from(k), 0.2)).collect();
        Rows { judged, values: [matrix(), matrix()], noise, left: [0.9, 0.7], least: 0.1 }
    }

    fn judged() -> Judged {
        let rows = (0..30).map(|k| (k, 0.05 + 0.02 * (k % 3) as f64, k / 5)).collect();
        Judged { rows, half_range: 1.0, turn: Matrix2::identity(), components: vec![0, 1] }
    }

    /// The covariance of a stretch's rows under a discrepancy of this length, written out.
    fn covariance(rows: &Rows, stretch: usize, component: usize, length: f64) -> DMatrix<f64> {
        let places: Vec<f64> = rows
            .judged
            .rows
            .iter()
            .scan(0.0, |at, row| {
                *at += row.1;
                Some(*at)
            })
            .collect();
        DMatrix::from_fn(5, 5, |a, b| {
            let (a, b) = (5 * stretch + a, 5 * stretch + b);
            let relative = rows.noise[a][component] / rows.noise.iter().map(|n| n[component]).sum::<f64>() * 30.0;
            let noise = if a == b { 0.4 * relative } else { 0.0 };
            rows.left[component] * (0.6 * (-(places[a] - places[b]).abs() / length).exp() + noise)
        })
    }

    #[test]
    fn the_filter_whitens_by_the_covariance_of_noise_and_discrepancy() {
        let judged = judged();
        let rows = rows(&judged);
        let length = 0.3;
        for (stretch, own) in rows.equations(length, 0.4).iter().enumerate() {
            let (mut products, mut log_determinant) = (DMatrix::zeros(3, 3), 0.0);
            for component in 0..2 {
                let covariance = covariance(&rows, stretch, component, length);
                let values = rows.values[component].columns(5 * stretch, 5).into_owned();
                log_determinant += covariance.determinant().ln();
                products += &values * covariance.try_inverse().unwrap() * values.transpose();
            }
            assert!((&own.products - products).amax() < 1e-10);
            assert!((own.log_variances - log_determinant).abs() < 1e-10 && own.count == 10.0);
        }
    }

    #[test]
    fn a_stretch_is_foretold_by_the_density_of_students_t_with_the_uncertainty_of_the_parameters() {
        let judged = judged();
        let rows = rows(&judged);
        let each = rows.equations(1.0, 1.0);
        let precision = DVector::repeat(2, 1e-4);
        let refit = Refit::without(&each, 2, &precision, rows.least).unwrap();
        // Whitened rows of the stretch: without a correlation each by its own variance.
        let whitened = |component: usize, place: usize| {
            let variance = rows.left[component] * rows.noise[place][component] / rows.mean_noise(component);
            rows.values[component].column(place) / variance.sqrt()
        };
        let columns: Vec<DVector<f64>> = (0..2)
            .flat_map(|component| (10..15).map(move |place| (component, place)))
            .map(|(c, k)| whitened(c, k))
            .collect();
        let slopes = DMatrix::from_fn(10, 2, |row, column| columns[row][column]);
        let left = DVector::from_fn(10, |row, _| columns[row][2]) + &slopes * &refit.step;
        let spread = DMatrix::identity(10, 10) + &slopes * refit.factor.inverse() * slopes.transpose();
        let squares = left.dot(&(spread.clone().try_inverse().unwrap() * &left)) / refit.variance;
        let log_determinant = 10.0 * refit.variance.ln() + spread.determinant().ln() + each[2].log_variances;
        let expected =
            -0.5 * log_determinant - 0.5 * (DEGREES_OF_FREEDOM + 10.0) * (1.0 + squares / DEGREES_OF_FREEDOM).ln();
        assert!((refit.foretells(&each[2]).unwrap() - expected).abs() < 1e-9);
    }
}
