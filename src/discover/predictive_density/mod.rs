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

mod refit;
mod rows;
#[cfg(test)]
mod tests;

use refit::{Equations, Refit};
use rows::{Learned, Rows};

use super::fit::{Fit, prior_precision};
use super::noise::Noise;
use super::residuals::{Problem, Residual};
use nalgebra::{DMatrix, DVector, Matrix2, Rotation2, Vector2};
use std::collections::BTreeMap;

/// Stretches that are left out, one after the other.
///
/// Convention: 5 to 10 folds are usual (Hastie, Tibshirani and Friedman, The Elements of Statistical Learning, 2nd ed., 7.10.1).
pub const STRETCHES: usize = 6;

/// One row is used for so much of half the range of the commands.
///
/// Convention: a discrepancy that changes more quickly is taken for noise.
const SPACING: f64 = 0.05;

/// Standard deviations of a reading to which a travel is known, as a displacement of the backbones: one that is short of the [`SPACING`] by less has come to
/// it. Quantised or evenly stepped commands come to it exactly, but for rounding, which would decide at every row.
///
/// Derived: √(2 · 2/3), a travel being the difference of two bends, each the mean of three readings with the weights ⅔ cos of their azimuths.
const READING_SDS: f64 = 1.154_7;

/// The lengths along which a discrepancy may be correlated, in halves of the range.
///
/// Convention: from the [`SPACING`] to the whole range, each about twice the one before. What goes on for longer is a bend at rest, or a gain.
const LENGTHS: [f64; 6] = [0.05, 0.1, 0.2, 0.45, 1.0, 2.0];

/// The shares of the variance that may be independent from row to row; the rest is correlated.
///
/// Convention: from all of it to hardly any, as of a tracker that filters, each about a third of the one before.
const INDEPENDENT: [f64; 5] = [1.0, 0.3, 0.1, 0.03, 0.01];

/// The least variance that a structure may claim to leave, as a share of the noise's. If the model as given leaves less of a component,
/// that component is not judged, because nothing is to be explained in it.
///
/// Convention: half the sigma; noise is learned before, and no structure may claim that there is hardly any.
const LEAST_VARIANCE: f64 = 0.25;

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

/// What turns a sample's whitened residual into its components.
#[derive(Debug, Clone, Copy)]
struct Units {
    /// Of the bend, rad.
    bend: Matrix2<f64>,
    /// Of each part that bends nothing, mm.
    internal_mm: f64,
}

impl Units {
    /// Component c of a whitened residual.
    fn component(&self, whitened: &[f64], c: usize) -> f64 {
        match c {
            0 | 1 => self.bend[(c, 0)] * whitened[0] + self.bend[(c, 1)] * whitened[1],
            _ => self.internal_mm * whitened[c],
        }
    }
}

/// The samples that structures are judged on, the same for all.
#[derive(Debug, Clone)]
pub struct Judged {
    rows: Vec<Row>,
    /// Half the range of the commands, rad.
    pub half_range: f64,
    /// Along and across the commands' main direction, from the axes of the bend, if a discrepancy hangs together from row to row; noise alone is largest
    /// across each sample's own bend.
    main_direction: Option<Matrix2<f64>>,
    /// The components that are judged: of the bend in these directions, then of what bends nothing.
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
        let known_to = READING_SDS * data.sd_encoder_mm / (model.robot.backbone_circle_radius_mm * half_range);
        let (mut rows, mut travel, mut at) = (Vec::new(), f64::INFINITY, data.log.samples[0]);
        for sample in problem.noise.unknown_start..data.len() {
            for step in at..data.log.samples[sample] {
                travel += (commands[step + 1] - commands[step]).norm() / half_range;
            }
            at = data.log.samples[sample];
            if travel + known_to >= spacing {
                rows.push(Row { sample, travel, stretch: 0 });
                travel = 0.0;
            }
        }
        let count = rows.len().max(1);
        rows.iter_mut().enumerate().for_each(|(place, row)| row.stretch = place * STRETCHES / count);
        let middle = commands.iter().sum::<Vector2<f64>>() / commands.len() as f64;
        let scatter: Matrix2<f64> = commands.iter().map(|u| (u - middle) * (u - middle).transpose()).sum();
        let main_direction =
            (beside == Beside::Discrepancy).then(|| scatter.symmetric_eigen().eigenvectors.transpose());
        let n = data.backbones();
        let components = (0..n).collect();
        let mut judged = Self { rows, half_range, main_direction, components, units: Vec::new(), kinds: kinds(beside) };
        let (mut left, mut noise) = (vec![0.0; n], vec![0.0; n]);
        for row in &judged.rows {
            let (units, residual) = (judged.units(problem, row.sample), &fit.residuals[row.sample]);
            let variances = judged.noise_variances(problem, row.sample);
            for c in 0..n {
                left[c] += units.component(residual, c).powi(2);
                noise[c] += variances[c];
            }
        }
        let count = judged.rows.len().max(1) as f64;
        judged.units = (0..n).map(|c| if c < 2 { 0.5 * (noise[0] + noise[1]) } else { noise[c] } / count).collect();
        judged.components.retain(|&c| left[c] > LEAST_VARIANCE * noise[c] && (c < 2 || beside == Beside::Noise));
        judged
    }

    /// The directions of the components of a sample's bend, from the axes of the bend.
    fn directions(&self, problem: &Problem, sample: usize) -> Matrix2<f64> {
        let own = || Rotation2::new(-problem.data.measured[sample].configuration.delta).into_inner();
        self.main_direction.unwrap_or_else(own)
    }

    /// What turns a sample's whitened residual into its components, rad and mm.
    fn units(&self, problem: &Problem, sample: usize) -> Units {
        let bend = self.directions(problem, sample) * problem.bend_unit(sample);
        Units { bend, internal_mm: problem.internal_unit_mm(sample) }
    }

    /// The variances of the noise alone of each component of a sample, rad² and mm².
    fn noise_variances(&self, problem: &Problem, sample: usize) -> Residual {
        let covariance = problem.bend_covariance(sample, &Noise { discrepancy_rad: 0.0, ..problem.noise });
        let directions = self.directions(problem, sample);
        let bend = (directions * covariance * directions.transpose()).diagonal();
        let internal = problem.noise.sd_internal_mm().powi(2);
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
        self.density(problem, &fit.residuals, &[&fit.jacobian], &prior_precision(&fit.model))
    }

    /// Of whitened residuals, their derivatives by the parameters, in blocks of columns, and how precisely these are known beforehand; none where the rows do
    /// not determine it.
    pub fn density(
        &self,
        problem: &Problem,
        residuals: &[Residual],
        jacobian: &[&DMatrix<f64>],
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
