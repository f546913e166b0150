//! Where the fit of a screw's periodic error begins: the peaks of a least-squares periodogram of the residuals over q̃.
//!
//! The error a sin(2π q̃/p + φ) is linear in its sine and cosine once the pitch p is given, and has many local minima in p. So
//! frequencies 1/p are tried one by one, each with η, λ and the other parameters free (the generalised Lomb–Scargle periodogram,
//! Zechmeister and Kürster 2009).

use super::data::Data;
use super::fit::Fit;
use super::residuals::{Problem, stacked};
use crate::robot::PerBackbone;
use crate::robot::effects::Phases;
use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;

/// The lowest and the highest frequency, 1/mm: pitches from 5 mm down to 0.25 mm.
///
/// Convention: screws of small actuators have pitches in this range.
const FREQUENCIES_PER_MM: (f64, f64) = (0.2, 4.0);

/// The step of the frequency times the range of q̃: a peak has a width of about 1.
///
/// Convention: about three trials to a peak's width (VanderPlas 2018, Understanding the Lomb–Scargle periodogram, 7.1).
const STEP_TIMES_RANGE: f64 = 0.35;

/// The least range of q̃ that sets the step, mm.
///
/// Convention: bounds the number of frequencies.
const LEAST_RANGE_MM: f64 = 0.5;

/// Peaks from which fits begin, of each of the two periodograms.
///
/// Convention: a bound on computing time.
const PEAKS: usize = 2;

/// The largest amplitude that a fit begins with, mm.
///
/// Convention: a start inside the parameter's range.
const LARGEST_START_MM: f64 = 0.4;

/// The relative ridge that keeps the normal equations solvable.
///
/// Convention: a numerical guard.
const RELATIVE_RIDGE: f64 = 1e-9;

/// The frequencies that are tried, 1/mm.
pub fn frequencies(data: &Data) -> Vec<f64> {
    let (least, most) =
        data.q_mm.iter().flat_map(|q| q.iter()).fold((f64::MAX, f64::MIN), |(a, b), &q| (a.min(q), b.max(q)));
    let step = STEP_TIMES_RANGE / (most - least).max(LEAST_RANGE_MM);
    let (lowest, highest) = FREQUENCIES_PER_MM;
    std::iter::successors(Some(lowest), |frequency| Some(frequency + step)).take_while(|f| *f < highest).collect()
}

/// What sine and cosine of one frequency do to the residuals.
pub struct Waves {
    /// The same wave in all backbones: two columns.
    pub common: DMatrix<f64>,
    /// A wave for each backbone: sine and cosine of the first, of the second, …
    pub separate: DMatrix<f64>,
}

impl Waves {
    /// Of a frequency, 1/mm.
    pub fn new(problem: &Problem, frequency: f64) -> Self {
        let n = problem.data.backbones();
        let mut separate = DMatrix::zeros(problem.data.residual_count(), 2 * n);
        for (k, q) in problem.data.q_mm.iter().enumerate() {
            for i in 0..n {
                let (sin, cos) = (TAU * frequency * q[i]).sin_cos();
                for (c, unit) in problem.response(k, &PerBackbone::ith(n, i)).iter().enumerate() {
                    separate[(n * k + c, 2 * i)] = unit * sin;
                    separate[(n * k + c, 2 * i + 1)] = unit * cos;
                }
            }
        }
        let sum = |row: usize, c: usize| separate.row(row).iter().skip(c).step_by(2).sum();
        Self { common: DMatrix::from_fn(separate.nrows(), 2, sum), separate }
    }
}

/// The parameters at the highest peaks: amplitude (mm), pitch (mm) and phases (degrees), one phase for all backbones or one for
/// each.
pub fn starts(problem: &Problem, fit: &Fit) -> Vec<(Phases, Vec<f64>)> {
    let residual = stacked(&fit.residuals);
    let nuisance = Nuisance::new(&fit.jacobian, &residual);
    let mut peaks: [Vec<(f64, Vec<f64>)>; 2] = Default::default();
    for frequency in frequencies(problem.data) {
        let waves = Waves::new(problem, frequency);
        for (peaks, columns) in peaks.iter_mut().zip([&waves.common, &waves.separate]) {
            if let Some((power, coefficients)) = nuisance.power(columns) {
                peaks.push((power, start(frequency, &coefficients)));
            }
        }
    }
    let highest = [Phases::Common, Phases::PerBackbone].into_iter().zip(peaks).flat_map(|(phases, mut peaks)| {
        peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
        peaks.into_iter().take(PEAKS).map(move |(_, start)| (phases, start))
    });
    highest.collect()
}

/// Amplitude, pitch and phases of waves with these coefficients of sine and cosine.
fn start(frequency: f64, coefficients: &DVector<f64>) -> Vec<f64> {
    let waves = || coefficients.as_slice().chunks(2).map(|pair| (pair[0], pair[1]));
    let amplitude = waves().map(|(sin, cos)| sin.hypot(cos)).sum::<f64>() / (coefficients.len() / 2) as f64;
    let phases = waves().map(|(sin, cos)| cos.atan2(sin).to_degrees());
    [amplitude.min(LARGEST_START_MM), 1.0 / frequency].into_iter().chain(phases).collect()
}

/// The parameters that are fitted beside every wave, and what they explain alone.
struct Nuisance<'a> {
    jacobian: &'a DMatrix<f64>,
    residual: &'a DVector<f64>,
    information: DMatrix<f64>,
    gradient: DVector<f64>,
}

impl<'a> Nuisance<'a> {
    fn new(jacobian: &'a DMatrix<f64>, residual: &'a DVector<f64>) -> Self {
        let transposed = jacobian.transpose();
        Self { jacobian, residual, information: &transposed * jacobian, gradient: transposed * residual }
    }

    /// The squares that columns and nuisance parameters explain together, and the columns' coefficients.
    fn power(&self, columns: &DMatrix<f64>) -> Option<(f64, DVector<f64>)> {
        let (p, m) = (self.jacobian.ncols(), columns.ncols());
        let transposed = columns.transpose();
        let cross = &transposed * self.jacobian;
        let mut information = DMatrix::zeros(p + m, p + m);
        information.view_mut((0, 0), (p, p)).copy_from(&self.information);
        information.view_mut((p, 0), (m, p)).copy_from(&cross);
        information.view_mut((0, p), (p, m)).copy_from(&cross.transpose());
        information.view_mut((p, p), (m, m)).copy_from(&(&transposed * columns));
        let mut right = DVector::zeros(p + m);
        right.rows_mut(0, p).copy_from(&self.gradient);
        right.rows_mut(p, m).copy_from(&(transposed * self.residual));
        for j in 0..p + m {
            information[(j, j)] *= 1.0 + RELATIVE_RIDGE;
        }
        let solution = information.cholesky()?.solve(&right);
        // Residuals are measured less predicted: what explains them enters the prediction with the opposite sign.
        Some((right.dot(&solution), -solution.rows(p, m).into_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coefficients_become_amplitude_pitch_and_phase() {
        // 0.05 sin(x + 30°) = 0.05 cos 30° sin x + 0.05 sin 30° cos x, the same with −60°.
        let waves = [30f64, -60.0].map(|phase| phase.to_radians().sin_cos());
        let coefficients = DVector::from_iterator(4, waves.iter().flat_map(|(s, c)| [0.05 * c, 0.05 * s]));
        let start = start(0.8, &coefficients);
        let expected = [0.05, 1.25, 30.0, -60.0];
        assert!(start.iter().zip(expected).all(|(value, expected)| (value - expected).abs() < 1e-12), "{start:?}");
    }

    #[test]
    fn the_power_is_the_sum_of_squares_that_a_joint_fit_explains() {
        let jacobian = DMatrix::from_fn(40, 2, |row, c| (row as f64 / 40.0).powi(c as i32));
        let columns = DMatrix::from_fn(40, 2, |row, c| if c == 0 { (row as f64).sin() } else { (row as f64).cos() });
        let residual = DVector::from_fn(40, |row, _| 0.3 - 0.2 * (row as f64).sin() + 0.01 * (row as f64 * 7.7).cos());
        let (power, coefficients) = Nuisance::new(&jacobian, &residual).power(&columns).unwrap();
        // The same by a singular value decomposition of both together.
        let both = DMatrix::from_fn(40, 4, |row, c| if c < 2 { jacobian[(row, c)] } else { columns[(row, c - 2)] });
        let solution = both.clone().svd(true, true).solve(&residual, 1e-12).unwrap();
        assert!((power - (&both * &solution).norm_squared()).abs() < 1e-6 * power);
        assert!((coefficients + solution.rows(2, 2)).norm() < 1e-6);
    }
}
