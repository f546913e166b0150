//! The whitened residuals: what was measured less what a model predicts, in units of the predicted noise.
//!
//! ε = q̃ − q(ψ) has q̃ on both sides, so that a column that holds q̃ would explain any data. The residual is therefore taken where
//! something was measured: the forward problem leads from q̃ to a bend, and from there to the bend that the eye should have seen.
//! The residual of the bend is the measured bend vector less that one, whitened by its covariance and by the encoders'
//! noise propagated through the forward problem. Its further components are the parts of q̃ that bend nothing (the null space of
//! Q⁺), which encoders alone tell: with three backbones the mean of all, with n of them n − 2 parts. They are independent of the
//! bend.
//!
//! Directions of loads and motions are taken from the bend that the encoders imply, not from the measured one, which is noisier.

use super::data::Data;
use super::noise::Noise;
use crate::geometry::Configuration;
use crate::robot::effects::Role;
use crate::robot::{ForwardSolution, LineJacobian, Mechanics, Model, PathPoint, PerBackbone};
use crate::statistics::moments::mean;
use nalgebra::{DMatrix, DVector, Matrix2, Rotation2, Vector2};
use std::ops::Range;

/// The weight of samples at a start that nobody knows.
///
/// Convention: numerical; none, but so that their gap can be had back from their residuals.
const NO_WEIGHT: f64 = 1e-9;

/// A sample's whitened residuals, as many as there are backbones: two of the bend, then the parts that bend nothing, their mean
/// first.
pub type Residual = PerBackbone;

/// The noise of one sample.
#[derive(Debug, Clone)]
struct SampleNoise {
    /// The eye's stated covariance of the bend, rad².
    eye: Matrix2<f64>,
    /// What all its residuals are multiplied by.
    weight: f64,
    /// L⁻¹ of the covariance L Lᵗ of the bend residual, 1/rad.
    whitening: Matrix2<f64>,
    /// The derivatives of the line's displacement at the sample's bend.
    line: LineJacobian,
    /// Variance of ε that the noise of eye and encoders leaves, mean over the backbones, mm².
    floor_mm2: f64,
}

/// The samples with their noise: everything that the residuals of a model need.
#[derive(Debug, Clone)]
pub struct Problem<'a> {
    /// The samples.
    pub data: &'a Data,
    /// What the residuals are whitened by.
    pub noise: Noise,
    samples: Vec<SampleNoise>,
    sd_internal_mm: f64,
    /// Orthonormal directions of q̃ that bend nothing.
    internal: Vec<PerBackbone>,
    /// The path that the model at hand implies at every reading, rad: where every forward problem starts.
    start: Vec<Vector2<f64>>,
}

/// What a model predicts from the readings.
#[derive(Debug, Clone)]
pub struct Prediction {
    /// At every reading.
    points: Vec<PathPoint>,
    /// The whitened residuals of each sample.
    pub residuals: Vec<Residual>,
}

impl Prediction {
    /// The bends that the encoders imply at every reading, rad.
    pub fn path(&self) -> Vec<Vector2<f64>> {
        self.points.iter().map(|point| point.solution.bend).collect()
    }
}

/// A path with the derivatives of the lines along it.
#[derive(Debug, Clone)]
pub struct Linearised {
    points: Vec<PathPoint>,
    lines: Vec<LineJacobian>,
    residuals: Vec<Residual>,
}

/// The residuals of all samples as one vector.
pub fn stacked(residuals: &[Residual]) -> DVector<f64> {
    DVector::from_vec(residuals.iter().flat_map(|r| r.iter().copied()).collect())
}

impl<'a> Problem<'a> {
    /// The noise at the bends that a model implies.
    pub fn new(data: &'a Data, noise: &Noise, model: &Model) -> Self {
        let (mechanics, log) = (Mechanics::new(model).with_reading_noise(noise.sd_encoder_mm), &data.log);
        let q_mm = log.own_q_mm(model);
        let path = mechanics.solve_path(&log.times_s, &q_mm, None, None);
        let start: Vec<_> = path.iter().map(|point| point.solution.bend).collect();
        let exposed = mechanics.exposed_bends(&log.times_s, &start);
        let samples = data.measured.iter().zip(&log.samples).enumerate().map(|(k, (measured, &at))| {
            let weight = if k < noise.unknown_start { NO_WEIGHT } else { 1.0 };
            let bend = path[at].solution.bend;
            let line = mechanics.line_jacobian(bend, &path[at].motion);
            let seen = mechanics.apparent_bend(exposed[at]);
            let eye = measured.bend_covariance(Configuration::from_bend_vector(seen));
            let scattered = eye * noise.eye_factor.powi(2);
            let floor = line.line_by_bend.map(|by| by.dot(&(scattered * by))).mean() + noise.sd_encoder_mm.powi(2);
            SampleNoise { eye, weight, whitening: whitening(&eye, &line, noise), line, floor_mm2: floor }
        });
        Self {
            data,
            noise: *noise,
            samples: samples.collect(),
            sd_internal_mm: noise.sd_internal_mm().hypot(noise.discrepancy_mm),
            internal: model.robot.internal_parts().collect(),
            start,
        }
    }

    /// A model made ready to predict from readings of this noise.
    fn mechanics<'m>(&self, model: &'m Model) -> Mechanics<'m> {
        Mechanics::new(model).with_reading_noise(self.noise.sd_encoder_mm)
    }

    /// What a model predicts. `guess` is a path near its own; without one, that of the model that the noise was taken at.
    pub fn predict(&self, model: &Model, guess: Option<&[Vector2<f64>]>) -> Prediction {
        let (mechanics, log) = (self.mechanics(model), &self.data.log);
        // What the eye saw at the first reading, if it saw anything.
        let first = (log.samples[0] == 0).then(|| self.data.measured[0].configuration.bend_vector());
        let guess = guess.unwrap_or(&self.start);
        let points = mechanics.solve_path(&log.times_s, &log.own_q_mm(model), Some(guess), first);
        let residuals = self.whitened(&mechanics, points.iter().map(|point| &point.solution));
        Prediction { points, residuals }
    }

    /// ∂(residuals)/∂(parameter / its scale) by forward differences: a row for each component of each sample, a column for each of some of
    /// the model's parameters.
    pub fn jacobian(&self, model: &Model, prediction: &Prediction, parameters: Range<usize>) -> DMatrix<f64> {
        let lines = self.lines(&self.mechanics(model), &prediction.points);
        self.differences(model, (&prediction.points, &lines), &prediction.residuals, parameters)
    }

    /// A model's path with the derivatives along it, from which models that are near it are told to first order.
    pub fn linearised(&self, model: &Model, guess: &[Vector2<f64>]) -> Linearised {
        let (mechanics, log) = (self.mechanics(model).keeping_directions(), &self.data.log);
        let first = (log.samples[0] == 0).then(|| self.data.measured[0].configuration.bend_vector());
        let points = mechanics.solve_path(&log.times_s, &log.own_q_mm(model), Some(guess), first);
        let residuals = self.whitened(&mechanics, points.iter().map(|point| &point.solution));
        Linearised { lines: self.lines(&mechanics, &points), points, residuals }
    }

    /// The residuals of a model that has these parameters beyond the one of a path, and their derivatives by them over their scales, to first order.
    pub fn near(&self, path: &Linearised, model: &Model, parameters: Range<usize>) -> (Vec<Residual>, DMatrix<f64>) {
        let about = (&path.points[..], &path.lines[..]);
        let (values, specs) = (model.parameter_values(), model.parameter_specs());
        let changes_nothing =
            parameters.clone().all(|j| values[j] == 0.0 || !matches!(specs[j].role, Role::Size { .. }));
        let residuals = if changes_nothing { path.residuals.clone() } else { self.first_order(model, about) };
        let columns = self.differences(model, about, &residuals, parameters);
        (residuals, columns)
    }

    fn lines(&self, mechanics: &Mechanics, points: &[PathPoint]) -> Vec<LineJacobian> {
        points.iter().map(|point| mechanics.line_jacobian(point.solution.bend, &point.motion)).collect()
    }

    /// The residuals of a model near the one of these points, to first order.
    fn first_order(&self, model: &Model, about: (&[PathPoint], &[LineJacobian])) -> Vec<Residual> {
        let (mechanics, log) = (self.mechanics(model), &self.data.log);
        let moved = Mechanics::perturbed_path(&mechanics, (&log.times_s, &log.own_q_mm(model)), about);
        self.whitened(&mechanics, moved.iter())
    }

    /// Difference quotients from the residuals of a model.
    fn differences(
        &self,
        model: &Model,
        about: (&[PathPoint], &[LineJacobian]),
        residuals: &[Residual],
        parameters: Range<usize>,
    ) -> DMatrix<f64> {
        let (specs, n) = (model.parameter_specs(), self.data.backbones());
        let mut jacobian = DMatrix::zeros(self.data.residual_count(), parameters.len());
        for (column, j) in parameters.enumerate() {
            let (nudged, step) = model.nudged(j);
            let h = step / specs[j].typical;
            let moved = self.first_order(&nudged, about);
            for (k, (after, before)) in moved.iter().zip(residuals).enumerate() {
                for c in 0..n {
                    jacobian[(n * k + c, column)] = (after[c] - before[c]) / h;
                }
            }
        }
        jacobian
    }

    /// What a summand of ε at sample k (mm) does to its residuals, to first order: the predicted bend gives way, and what bends
    /// nothing is no longer left of q̃.
    pub fn response(&self, k: usize, summand_mm: &PerBackbone) -> Residual {
        let noise = &self.samples[k];
        let left_mm = if self.data.is_driven { *summand_mm * 0.0 } else { -*summand_mm };
        self.residual(k, noise.line.bend_by_line.tr_mul(summand_mm), &left_mm)
    }

    /// The gap of ε at sample k, mm: what the model leaves of q̃ at the measured bend.
    pub fn eps_gap_mm(&self, residuals: &[Residual], k: usize) -> PerBackbone {
        let by_bend = -self.samples[k].line.line_by_bend * self.bend_residual(residuals, k);
        let internal = self.internal.iter().zip(&residuals[k][2..]);
        let unit_mm = self.sd_internal_mm / self.samples[k].weight;
        internal.fold(by_bend, |sum, (part, r)| sum + *part * (r * unit_mm))
    }

    /// The gap of the bend vector at sample k, rad, along and across the measured bend.
    pub fn bend_gap(&self, residuals: &[Residual], k: usize) -> Vector2<f64> {
        Rotation2::new(-self.data.measured[k].configuration.delta) * self.bend_residual(residuals, k)
    }

    /// The rms of ε that noise alone leaves, over all samples and backbones, mm.
    pub fn noise_floor_mm(&self) -> f64 {
        let sum: f64 = self.samples.iter().map(|noise| noise.floor_mm2).sum();
        (sum / self.samples.len() as f64).sqrt()
    }

    /// The variance of each component of the bend that noise alone leaves, mean over the samples, rad².
    pub fn bend_noise_rad2(&self) -> f64 {
        let noise = Noise { discrepancy_rad: 0.0, ..self.noise };
        mean(self.samples.iter().map(|sample| covariance(&sample.eye, &sample.line, &noise).trace())) / 2.0
    }

    /// The residuals of one of the parts of q̃ that bend nothing, mm.
    pub fn internal_mm<'r>(&'r self, residuals: &'r [Residual], part: usize) -> impl Iterator<Item = f64> + 'r {
        residuals.iter().zip(&self.samples).map(move |(r, sample)| r[2 + part] * self.sd_internal_mm / sample.weight)
    }

    /// The two components of the bend's residuals, whitened by another noise.
    pub fn bend_whitened_by(&self, noise: &Noise, residuals: &[Residual]) -> [Vec<f64>; 2] {
        let whitened = |k: usize| {
            let sample = &self.samples[k];
            whitening(&sample.eye, &sample.line, noise) * self.bend_residual(residuals, k)
        };
        let bend: Vec<_> = (0..residuals.len()).map(whitened).collect();
        [0, 1].map(|c| bend.iter().map(|bend| bend[c]).collect())
    }

    /// The residual of the bend at sample k before whitening, rad.
    fn bend_residual(&self, residuals: &[Residual], k: usize) -> Vector2<f64> {
        self.bend_unit(k) * Vector2::new(residuals[k][0], residuals[k][1])
    }

    /// What turns whitened residuals of the bend at sample k into rad.
    pub fn bend_unit(&self, k: usize) -> Matrix2<f64> {
        let SampleNoise { weight, whitening, .. } = &self.samples[k];
        whitening.try_inverse().unwrap_or_else(Matrix2::zeros) / *weight
    }

    /// What turns whitened residuals of the parts that bend nothing at sample k into mm.
    pub fn internal_unit_mm(&self, k: usize) -> f64 {
        self.sd_internal_mm / self.samples[k].weight
    }

    /// The covariance of the bend at sample k under a noise, rad².
    pub fn bend_covariance(&self, k: usize, noise: &Noise) -> Matrix2<f64> {
        covariance(&self.samples[k].eye, &self.samples[k].line, noise)
    }

    /// The residuals of sample k from its gap of the bend, rad, and the part of q̃ that the model does not explain, mm.
    fn residual(&self, k: usize, bend: Vector2<f64>, unexplained_mm: &PerBackbone) -> Residual {
        let SampleNoise { weight, whitening, .. } = &self.samples[k];
        let bend = whitening * bend * *weight;
        let internal = |part: usize| self.internal[part].dot(unexplained_mm) / self.sd_internal_mm * *weight;
        Residual::from_fn(unexplained_mm.len(), |c| if c < 2 { bend[c] } else { internal(c - 2) })
    }

    /// The whitened residuals of forward solutions.
    fn whitened<'f>(
        &self,
        mechanics: &Mechanics,
        forward: impl Iterator<Item = &'f ForwardSolution> + Clone,
    ) -> Vec<Residual> {
        let path: Vec<_> = forward.clone().map(|solution| solution.bend).collect();
        let log = &self.data.log;
        let unexplained_mm: Vec<_> = match self.data.is_driven {
            true => log.q_mm.iter().map(|q_mm| q_mm.add_scalar(-mechanics.common_mm())).collect(),
            false => forward.map(|solution| solution.residual_mm).collect(),
        };
        let exposed = mechanics.exposed_bends(&log.times_s, &path);
        let residuals = self.data.measured.iter().zip(&log.samples).enumerate().map(|(k, (measured, &at))| {
            let gap = measured.configuration.bend_vector() - mechanics.apparent_bend(exposed[at]);
            self.residual(k, gap, &unexplained_mm[at])
        });
        residuals.collect()
    }
}

/// Covariance of a sample's bend residual, rad².
fn covariance(eye: &Matrix2<f64>, line: &LineJacobian, noise: &Noise) -> Matrix2<f64> {
    let encoders = line.bend_by_line.cross_gram(&line.bend_by_line) * noise.sd_encoder_mm.powi(2);
    eye * noise.eye_factor.powi(2) + encoders + Matrix2::identity() * noise.discrepancy_rad.powi(2)
}

/// L⁻¹ of that covariance L Lᵗ, 1/rad.
fn whitening(eye: &Matrix2<f64>, line: &LineJacobian, noise: &Noise) -> Matrix2<f64> {
    let inverse = covariance(eye, line, noise).cholesky().and_then(|factor| factor.l().try_inverse());
    inverse.unwrap_or_else(Matrix2::zeros)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::discover::fixture::{experiment, truth};

    #[test]
    fn the_residuals_of_the_true_model_have_unit_variance() {
        let (mut squares, mut count) = (0.0, 0.0);
        for seed in 0..4 {
            let data = experiment(seed);
            let residuals =
                stacked(&Problem::new(&data, &Noise::stated(&data), &truth()).predict(&truth(), None).residuals);
            squares += residuals.norm_squared();
            count += residuals.len() as f64;
        }
        // χ²/n scatters by √(2/n).
        assert!((squares / count - 1.0).abs() < 4.0 * (2.0 / count).sqrt(), "{}", squares / count);
    }

    #[test]
    fn readings_between_the_samples_drive_a_play() {
        let play =
            crate::robot::effects::forms("motion_directed_backlash").find(|form| form.form == "crossed by travel");
        let mut model = truth();
        model.effects.push(crate::robot::Effect::of(play.unwrap(), vec![0.2]));
        let all = experiment(1);
        let seen: Vec<usize> =
            (0..all.len()).filter(|&k| k == 0 || all.measured[k].configuration.theta_deg() < 45.0).collect();
        let mut some = all.clone();
        some.measured = seen.iter().map(|&k| all.measured[k]).collect();
        some.log.samples = seen.clone();
        let residuals = |data: &Data| Problem::new(data, &Noise::stated(data), &model).predict(&model, None).residuals;
        let (of_all, of_some) = (residuals(&all), residuals(&some));
        assert!(seen.len() < all.len() - 30);
        assert!(seen.iter().zip(&of_some).all(|(&k, some)| (of_all[k] - *some).amax() < 1e-6));
    }

    #[test]
    fn a_shift_of_an_encoder_is_the_gap_of_its_backbones_eps() {
        let data = experiment(1);
        let mut shifted = data.clone();
        let shift = PerBackbone::from([0.0, 1e-4, 0.0]);
        shifted.log.q_mm.iter_mut().for_each(|q_mm| *q_mm += shift);
        // The noise of both is taken at the same bends.
        let problem = Problem::new(&data, &Noise::stated(&data), &truth());
        let with_shift = Problem { data: &shifted, ..problem.clone() };
        let before = problem.predict(&truth(), None).residuals;
        let after = with_shift.predict(&truth(), None).residuals;
        for k in 0..data.len() {
            let gap = with_shift.eps_gap_mm(&after, k) - problem.eps_gap_mm(&before, k);
            assert!((gap - shift).norm() < 0.02 * shift.norm(), "{k}: {gap:?}");
            // A summand of ε is a shift of the encoder with the opposite sign.
            let response = problem.response(k, &shift);
            assert!((before[k] - after[k] - response).norm() < 0.02 * response.norm(), "{k}: {response:?}");
        }
    }
}
