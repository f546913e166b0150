//! The gap in units of its noise, and the parameters that make it least.
//!
//! q̃ stands on both sides of ε = q̃ − q(ψ), and a column that holds q̃ would explain any data. So the gap is taken where
//! something was measured: the forward problem leads from q̃ to a bend, and from there to what the eye should have seen;
//! the residual is the eye's answer less that, whitened by the eye's covariance and the encoders' through the forward problem. Its
//! further components are the parts of q̃ that no bend changes and encoders alone tell: with three backbones the one that is common to
//! all, with n of them n − 2. They are independent of the bend, since Q⁺ takes nothing from them.
//!
//! Directions of loads and motions are taken from the bend that the encoders imply, not from the eye's, which is noisy.

use super::data::Data;
use crate::observation::Measured;

use crate::robot::{ForwardSolution, LineJacobian, Mechanics, Model, Motion, PerBackbone};
use nalgebra::{DMatrix, DVector, Matrix2, Rotation2, Vector2};
use std::f64::consts::PI;

/// Whitened residuals beyond this count linearly (Huber): a few samples at a sign's edge must not name an effect.
const HUBER: f64 = 3.0;
/// The most Gauss-Newton steps.
const MOST_STEPS: usize = 16;
/// A step that lowers the cost by less than this is the last.
const SETTLED: f64 = 0.02;
/// The same, as a share of the cost: of no use where a model is far off.
const SETTLED_SHARE: f64 = 1e-4;

/// A sample's whitened residuals, as many as there are backbones: two of the bend, then the internal parts, the common one first.
pub type Residual = PerBackbone;

/// One sample's noise.
#[derive(Debug, Clone)]
struct Noise {
    /// Whitens the bend residual.
    whitening: Matrix2<f64>,
    /// Of the line at the sample's bend.
    slope: LineJacobian,
    /// Variance of ε that the eye's and the encoders' noise leave, mean over the backbones, mm².
    floor_mm2: f64,
}

/// The data with their noise, ready to be fitted.
#[derive(Debug, Clone)]
pub struct Problem<'a> {
    /// The samples.
    pub data: &'a Data,
    noise: Vec<Noise>,
    sd_internal_mm: f64,
    /// What bends nothing.
    internal: Vec<PerBackbone>,
    /// The path that the model without anything new implies: where every forward problem starts.
    start: Vec<Vector2<f64>>,
}

/// What a model makes of the readings.
#[derive(Debug, Clone)]
struct Run {
    solutions: Vec<ForwardSolution>,
    motions: Vec<Motion>,
    residuals: Vec<Residual>,
}

impl Run {
    fn path(&self) -> Vec<Vector2<f64>> {
        self.solutions.iter().map(|solution| solution.bend).collect()
    }

    fn vector(&self) -> DVector<f64> {
        stacked(&self.residuals)
    }
}

/// Residuals in a row.
pub fn stacked(residuals: &[Residual]) -> DVector<f64> {
    DVector::from_vec(residuals.iter().flat_map(|r| r.iter().copied()).collect())
}

/// A model fitted to the data.
#[derive(Debug, Clone)]
pub struct Fit {
    /// The model, with η, λ and its effects at their best.
    pub model: Model,
    /// Whitened residuals of each sample.
    pub residuals: Vec<Residual>,
    /// The bends that the encoders imply.
    pub path: Vec<Vector2<f64>>,
    /// Sum of the robust squares.
    pub cost: f64,
    /// Number of parameters.
    pub parameters: usize,
    /// Derivatives of the residuals by the parameters in units of their scales, η and λ first.
    pub jacobian: DMatrix<f64>,
}

impl Fit {
    /// Schwarz's criterion: less is better.
    pub fn bic(&self) -> f64 {
        let price: f64 = self.model.effects.iter().map(|effect| effect.physics.prior_penalty).sum();
        self.cost + self.parameters as f64 * (self.jacobian.nrows() as f64).ln() + price
    }

    /// The robust square of one sample.
    pub fn loss(&self, k: usize) -> f64 {
        self.residuals[k].iter().map(|&r| rho(r)).sum()
    }
}

/// JᵗWJ and JᵗWr, each sample weighted by how far out it is and by `share`.
pub fn normal_equations(
    jacobian: &DMatrix<f64>,
    residuals: &[Residual],
    share: impl Fn(usize) -> f64,
) -> (DMatrix<f64>, DVector<f64>) {
    let mut weighted = jacobian.clone();
    let weights = residuals.iter().enumerate().map(|(k, r)| r.map(|r| weight(r) * share(k)));
    let weights = stacked(&weights.collect::<Vec<_>>());
    for mut column in weighted.column_iter_mut() {
        column.component_mul_assign(&weights);
    }
    (jacobian.transpose() * &weighted, weighted.transpose() * stacked(residuals))
}

fn rho(r: f64) -> f64 {
    if r.abs() <= HUBER { r * r } else { HUBER * (2.0 * r.abs() - HUBER) }
}

fn weight(r: f64) -> f64 {
    if r.abs() <= HUBER { 1.0 } else { HUBER / r.abs() }
}

impl<'a> Problem<'a> {
    /// Prepares data for fits near a model.
    pub fn new(data: &'a Data, model: &Model) -> Self {
        let mechanics = Mechanics::new(model);
        let start: Vec<_> =
            mechanics.solve_path(&data.times_s, &data.q_mm, None).iter().map(|solution| solution.bend).collect();
        let motions = mechanics.motions_from_readings(&data.times_s, &start, &data.q_mm);
        let variance = data.sd_encoder_mm.powi(2);
        let noise = data.measured.iter().zip(start.iter().zip(&motions)).map(|(measured, (&bend, motion))| {
            let slope = mechanics.line_jacobian(bend, motion);
            let eye = bend_covariance(measured, bend);
            let covariance = eye + slope.bend_by_line.cross_gram(&slope.bend_by_line) * variance;
            let whitening = covariance.cholesky().and_then(|factor| factor.l().try_inverse());
            let floor = slope.line_by_bend.map(|by| by.dot(&(eye * by))).mean() + variance;
            Noise { whitening: whitening.unwrap_or_else(Matrix2::zeros), slope, floor_mm2: floor }
        });
        let internal = model.robot.internal_parts().collect();
        Self { data, noise: noise.collect(), sd_internal_mm: data.sd_encoder_mm.max(1e-5), internal, start }
    }

    /// A residual of whitened bend and internal parts, mm.
    fn residual(&self, bend: Vector2<f64>, residual_mm: &PerBackbone) -> Residual {
        let internal = |part: usize| self.internal[part].dot(residual_mm) / self.sd_internal_mm;
        Residual::from_fn(residual_mm.len(), |c| if c < 2 { bend[c] } else { internal(c - 2) })
    }

    /// Whitened residuals of predicted bends and internal parts.
    fn whitened(&self, mechanics: &Mechanics, solutions: &[ForwardSolution]) -> Vec<Residual> {
        let path: Vec<_> = solutions.iter().map(|solution| solution.bend).collect();
        let exposed = mechanics.exposed_bends(&self.data.times_s, &path);
        let residuals = (0..path.len()).map(|k| {
            let gap = self.data.measured[k].configuration.bend_vector() - mechanics.apparent_bend(exposed[k]);
            self.residual(self.noise[k].whitening * gap, &solutions[k].residual_mm)
        });
        residuals.collect()
    }

    fn run(&self, model: &Model, guess: &[Vector2<f64>]) -> Run {
        let mechanics = Mechanics::new(model);
        let first = self.data.measured[0].configuration.bend_vector();
        let (solutions, motions) = mechanics.solve_path_near(&self.data.times_s, &self.data.q_mm, guess, Some(first));
        let residuals = self.whitened(&mechanics, &solutions);
        Run { solutions, motions, residuals }
    }

    /// ∂(residuals)/∂(parameter / its scale), a row for each component of each sample.
    fn jacobian(&self, model: &Model, run: &Run) -> DMatrix<f64> {
        let mechanics = Mechanics::new(model);
        let slopes: Vec<LineJacobian> = run
            .solutions
            .iter()
            .zip(&run.motions)
            .map(|(solution, motion)| mechanics.line_jacobian(solution.bend, motion))
            .collect();
        let data = (&self.data.times_s[..], &self.data.q_mm[..]);
        let (scales, ranges) = scales_and_ranges(model);
        let x = model.parameter_values();
        let n = self.data.backbones();
        let mut jacobian = DMatrix::zeros(self.data.numbers(), x.len());
        for j in 0..x.len() {
            // Inwards, where the range ends.
            let h = 1e-3 * if x[j] + 1e-3 * scales[j] > ranges[j].1 { -1.0 } else { 1.0 };
            let mut nudged = x.clone();
            nudged[j] += h * scales[j];
            let nudged = model.with_parameter_values(&nudged);
            let changed = Mechanics::new(&nudged);
            let solutions = mechanics.perturbed_path(&changed, data, (&run.solutions, &run.motions, &slopes));
            let moved = self.whitened(&changed, &solutions);
            for (k, (after, before)) in moved.iter().zip(&run.residuals).enumerate() {
                for c in 0..n {
                    jacobian[(n * k + c, j)] = (after[c] - before[c]) / h;
                }
            }
        }
        jacobian
    }

    /// Fits η, λ and all parameters of the model's effects, starting from their values. Samples of the fold `without` have
    /// no part in it.
    pub fn fit(&self, start: &Model, guess: Option<&[Vector2<f64>]>, without: Option<usize>) -> Fit {
        let counts = |k: usize| without != Some(self.data.fold(k));
        let total = |residuals: &[Residual]| -> f64 {
            let counted = residuals.iter().enumerate().filter(|(k, _)| counts(*k));
            counted.map(|(_, r)| r.iter().map(|&r| rho(r)).sum::<f64>()).sum()
        };
        let (scales, ranges) = scales_and_ranges(start);
        let mut x = start.parameter_values();
        let mut model = start.clone();
        let mut run = self.run(&model, guess.unwrap_or(&self.start));
        let mut cost = total(&run.residuals);
        let mut jacobian = DMatrix::zeros(self.data.numbers(), x.len());
        let mut damping = 1e-6;
        for _ in 0..MOST_STEPS {
            jacobian = self.jacobian(&model, &run);
            let (information, gradient) =
                normal_equations(&jacobian, &run.residuals, |k| if counts(k) { 1.0 } else { 0.0 });
            let before = cost;
            let mut improved = false;
            for _ in 0..6 {
                let mut damped = information.clone();
                for j in 0..x.len() {
                    damped[(j, j)] += damping * information[(j, j)] + 1e-9;
                }
                let Some(factor) = damped.cholesky() else {
                    damping *= 10.0;
                    continue;
                };
                let step = factor.solve(&gradient);
                let next: Vec<f64> =
                    (0..x.len()).map(|j| (x[j] - step[j] * scales[j]).clamp(ranges[j].0, ranges[j].1)).collect();
                let candidate = model.with_parameter_values(&next);
                let next_run = self.run(&candidate, &run.path());
                let next_cost = total(&next_run.residuals);
                if next_cost < cost {
                    (x, model, run, cost) = (next, candidate, next_run, next_cost);
                    damping = (damping * 0.1).max(1e-9);
                    improved = true;
                    break;
                }
                damping = (damping * 10.0).max(1e-4);
            }
            if !improved || before - cost < SETTLED.max(SETTLED_SHARE * cost) {
                break;
            }
        }
        let path = run.path();
        Fit { model, residuals: run.residuals, path, cost, parameters: x.len(), jacobian }
    }

    /// A start, seen from a fit: the derivatives there, and the sum of squares that one step from it promises.
    pub fn prospect(&self, start: &Model, guess: &[Vector2<f64>]) -> (DMatrix<f64>, f64) {
        let run = self.run(start, guess);
        let jacobian = self.jacobian(start, &run);
        let r = run.vector();
        let gradient = jacobian.transpose() * &r;
        let mut information = jacobian.transpose() * &jacobian;
        for j in 0..information.nrows() {
            information[(j, j)] *= 1.0 + 1e-6;
        }
        let gain = information.cholesky().map_or(0.0, |factor| gradient.dot(&factor.solve(&gradient)));
        (jacobian, r.norm_squared() - gain)
    }

    /// Puts the fit's covariance into its model.
    pub fn with_covariance(&self, fit: &Fit) -> Model {
        let mut model = fit.model.clone();
        let (information, _) = normal_equations(&fit.jacobian, &fit.residuals, |_| 1.0);
        let (scales, _) = scales_and_ranges(&model);
        // A direction that the data do not pin gets an sd of a hundred typical sizes, not infinity.
        let damped = &information + DMatrix::identity(scales.len(), scales.len()) * 1e-4;
        let Some(inverse) = damped.cholesky().map(|factor| factor.inverse()) else { return model };
        if let Some(estimate) = &mut model.estimate {
            estimate.samples = self.data.len();
        }
        model.set_covariance(&DMatrix::from_fn(scales.len(), scales.len(), |a, b| {
            inverse[(a, b)] * scales[a] * scales[b]
        }));
        model
    }

    /// What a summand of q̃ (mm, at each sample) would do to the whitened residuals, to first order.
    pub fn response(&self, k: usize, summand: &PerBackbone) -> Residual {
        let noise = &self.noise[k];
        self.residual(noise.whitening * noise.slope.bend_by_line.tr_mul(summand), &-*summand)
    }

    /// The gap of ε at sample k, mm: what is left between q̃ and the model at the measured bend.
    pub fn eps_gap_mm(&self, fit: &Fit, k: usize) -> PerBackbone {
        let noise = &self.noise[k];
        let r = fit.residuals[k];
        let unwhitened = noise.whitening.try_inverse().unwrap_or_else(Matrix2::zeros) * Vector2::new(r[0], r[1]);
        let by_bend = -noise.slope.line_by_bend * unwhitened;
        let internal = self.internal.iter().zip(&r[2..]);
        internal.fold(by_bend, |sum, (part, r)| sum + *part * (r * self.sd_internal_mm))
    }

    /// The gap of the bend at sample k, rad, along and across the bend.
    pub fn bend_gap(&self, fit: &Fit, k: usize) -> Vector2<f64> {
        let r = fit.residuals[k];
        let whitening = &self.noise[k].whitening;
        let gap = whitening.try_inverse().unwrap_or_else(Matrix2::zeros) * Vector2::new(r[0], r[1]);
        Rotation2::new(-self.data.measured[k].configuration.delta) * gap
    }

    /// The mean variance of ε that noise alone leaves at sample k, mm².
    pub fn floor_mm2(&self, k: usize) -> f64 {
        self.noise[k].floor_mm2
    }
}

/// Covariance of the measured bend vector, rad², at a bend: σ_θ along it, θ σ_δ across it, where δ is never worse than
/// wholly unknown.
fn bend_covariance(measured: &Measured, bend: Vector2<f64>) -> Matrix2<f64> {
    let sigma_delta = measured.sigma_delta.min(PI / 3f64.sqrt());
    // σ_δ goes with the measured θ: near straight their product is well known, while neither of them is.
    let theta = measured.configuration.theta;
    let along = measured.sigma_theta.powi(2) + theta.powi(2) * sigma_delta.powi(4) / 2.0;
    let across = (theta.powi(2) + measured.sigma_theta.powi(2)) * sigma_delta.powi(2);
    let cross = measured.correlation * measured.sigma_theta * theta * sigma_delta;
    let turn = Rotation2::new(bend.y.atan2(bend.x));
    turn * Matrix2::new(along, cross, cross, across) * turn.inverse()
}

/// The size of each parameter that matters, and its range.
fn scales_and_ranges(model: &Model) -> (Vec<f64>, Vec<(f64, f64)>) {
    model.parameter_specs().iter().map(|spec| (spec.typical, spec.range)).unzip()
}
