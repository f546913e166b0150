//! What the search works on: pairs of readings and measurements in the order of time, cut into sweeps.

use crate::error::{DataError, Result};
use crate::estimate::with_sigmas;
use crate::observation::{EncoderReading, Measured, Measurement, Status};
use crate::robot::{MAX_THETA, PerBackbone};
use std::collections::HashMap;

/// Fewer samples than this decide nothing.
pub const LEAST_SAMPLES: usize = 24;
/// Parts that cross-validation leaves out in turn.
pub const FOLDS: usize = 5;

/// Bends below this show little of what loads do.
const SMALL_BENDS_DEG: f64 = 12.0;
/// A time step of so many usual ones is a jump.
const JUMP: f64 = 30.0;

/// The usable samples of an experiment.
#[derive(Debug, Clone)]
pub struct Data {
    /// Index of each sample.
    pub indices: Vec<u64>,
    /// Time, s.
    pub times_s: Vec<f64>,
    /// q̃, mm.
    pub q_mm: Vec<PerBackbone>,
    /// What the eye measured.
    pub measured: Vec<Measured>,
    /// The sweep that each sample belongs to, counted from 0.
    pub sweeps: Vec<usize>,
    /// Standard deviation of a reading, mm.
    pub sd_encoder_mm: f64,
    /// Whether all bends lie in one plane.
    pub one_plane: bool,
    /// What was passed over or cannot be decided, in words.
    pub remarks: Vec<String>,
}

impl Data {
    /// Pairs measurements and readings of the same index.
    ///
    /// # Errors
    /// [`DataError`] for too few samples, or a snake that does not move.
    pub fn new(measurements: &[Measurement], readings: &[EncoderReading], sd_encoder_mm: f64) -> Result<Self> {
        let (measurements, no_sigmas) = with_sigmas(measurements, readings);
        let by_index: HashMap<u64, &EncoderReading> = readings.iter().map(|reading| (reading.index, reading)).collect();
        let pairs: Vec<(&EncoderReading, Measured)> = measurements
            .iter()
            .filter(|m| m.status == Status::Ok)
            .filter_map(|m| Some((*by_index.get(&m.index)?, m.measured?)))
            .filter(|(reading, measured)| usable(reading, measured))
            .collect();
        let mut remarks: Vec<String> = no_sigmas.into_iter().collect();
        if pairs.len() < measurements.len() {
            remarks.push(format!(
                "{} of {} measurements are used; the others have a status, no angles, or no reading of their index",
                pairs.len(),
                measurements.len()
            ));
        }
        if pairs.len() < LEAST_SAMPLES {
            return Err(DataError::TooFewSamples { found: pairs.len(), needed: LEAST_SAMPLES }.into());
        }
        let (times_s, about_times) = clock(&pairs.iter().map(|(reading, _)| reading.time_s).collect::<Vec<_>>());
        remarks.extend(about_times);
        let thetas: Vec<f64> = pairs.iter().map(|(_, m)| m.configuration.theta).collect();
        let range = |of: &dyn Fn(&PerBackbone) -> f64| {
            let values = || pairs.iter().map(|(reading, _)| of(&reading.q_mm));
            values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
        };
        let backbones = pairs[0].0.q_mm.len();
        if (0..backbones).all(|i| range(&|q| q[i]) < 0.02) {
            return Err(DataError::Still { least_mm: 0.02 }.into());
        }
        let one_plane = one_plane(&pairs);
        if one_plane {
            remarks.push(
                "all bends lie in one plane: effects that differ from one azimuth to another cannot be told apart"
                    .into(),
            );
        }
        for i in (0..backbones).filter(|&i| range(&|q| q[i]) == 0.0) {
            remarks.push(format!(
                "q{}_mm is the same in every reading: its encoder is stuck, or no bend moved its backbone",
                i + 1
            ));
        }
        let largest_deg = thetas.iter().copied().fold(0.0, f64::max).to_degrees();
        if largest_deg < SMALL_BENDS_DEG {
            remarks.push(format!(
                "no bend is above {largest_deg:.1}°: what grows with the bend or the load can hardly be seen; bend further"
            ));
        }
        Ok(Self {
            indices: pairs.iter().map(|(reading, _)| reading.index).collect(),
            times_s,
            q_mm: pairs.iter().map(|(reading, _)| reading.q_mm).collect(),
            measured: pairs.iter().map(|(_, measured)| *measured).collect(),
            sweeps: sweeps(&thetas),
            sd_encoder_mm,
            one_plane,
            remarks,
        })
    }

    /// How many samples there are.
    pub fn len(&self) -> usize {
        self.times_s.len()
    }

    /// Whether there are none; never, after [`new`](Self::new).
    pub fn is_empty(&self) -> bool {
        self.times_s.is_empty()
    }

    /// How many backbones the robot has.
    pub fn backbones(&self) -> usize {
        self.q_mm.first().map_or(0, |q| q.len())
    }

    /// How many numbers were measured that a model has to explain: two of the bend, the others of what bends nothing.
    pub fn numbers(&self) -> usize {
        self.backbones() * self.len()
    }

    /// The fold of each sample: whole sweeps, dealt in turn.
    pub fn fold(&self, k: usize) -> usize {
        self.sweeps[k] % FOLDS
    }
}

/// The times to work with, and what is to be said of them: a clock that stands still or goes back is no clock, and the samples
/// are then taken in the order of their index, at even steps.
fn clock(read_s: &[f64]) -> (Vec<f64>, Option<String>) {
    let steps = || read_s.windows(2).map(|pair| pair[1] - pair[0]);
    let mut rising: Vec<f64> = steps().filter(|step| *step > 0.0).collect();
    rising.sort_by(f64::total_cmp);
    let usual = rising.get(rising.len() / 2).copied().unwrap_or(1.0);
    if let Some(k) = steps().position(|step| step <= 0.0) {
        let even = (0..read_s.len()).map(|k| usual * k as f64).collect();
        let remark = format!(
            "times do not rise ({} s after {} s): the order of the indices and even steps of {usual:.3} s were taken instead, and \
             effects of time and speed are less sure",
            read_s[k + 1],
            read_s[k]
        );
        return (even, Some(remark));
    }
    let longest = rising.last().copied().unwrap_or(0.0);
    let jump = (longest > JUMP * usual).then(|| {
        format!("time jumps by {longest:.1} s where {usual:.3} s is usual: what the snake did in between is not known")
    });
    (read_s.to_vec(), jump)
}

fn usable(reading: &EncoderReading, measured: &Measured) -> bool {
    let Measured { configuration, sigma_theta, sigma_delta, correlation } = *measured;
    let numbers = [configuration.delta, sigma_theta, sigma_delta, reading.time_s];
    numbers.iter().chain(&reading.q_mm).all(|value| value.is_finite())
        && (0.0..=MAX_THETA).contains(&configuration.theta)
        && sigma_theta > 0.0
        && sigma_delta > 0.0
        && correlation.abs() < 1.0
}

/// Whether all bends lie within a few degrees of one plane through the straight snake.
fn one_plane(pairs: &[(&EncoderReading, Measured)]) -> bool {
    let scatter: nalgebra::Matrix2<f64> =
        pairs.iter().map(|(_, m)| m.configuration.bend_vector()).map(|bend| bend * bend.transpose()).sum();
    let spread = scatter.symmetric_eigenvalues();
    spread.min() < 0.01 * spread.max()
}

/// Cuts where θ turns by more than a quarter of its range, and long pieces (a round at one θ) again, so that there are
/// enough to leave some out in turn.
fn sweeps(thetas: &[f64]) -> Vec<usize> {
    let (least, most) = thetas.iter().fold((f64::INFINITY, 0.0f64), |(a, b), &t| (a.min(t), b.max(t)));
    let turn = 0.25 * (most - least);
    let longest = thetas.len().div_ceil(2 * FOLDS).max(3);
    let mut sweep = 0;
    let (mut began, mut rising, mut extreme) = (0, None, thetas[0]);
    let mut numbers = Vec::with_capacity(thetas.len());
    for (k, &theta) in thetas.iter().enumerate() {
        let turned = match rising {
            None => (theta - extreme).abs() > turn,
            Some(true) => theta < extreme - turn,
            Some(false) => theta > extreme + turn,
        };
        if turned {
            sweep += usize::from(rising.is_some());
            rising = Some(theta > extreme);
            extreme = theta;
            began = k;
        } else if k - began >= longest {
            sweep += 1;
            began = k;
        }
        match rising {
            Some(true) => extreme = extreme.max(theta),
            Some(false) => extreme = extreme.min(theta),
            None => {}
        }
        numbers.push(sweep);
    }
    numbers
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Model;
    use crate::simulate::{BendingExperiment, Plant, SimulatedEye};

    #[test]
    fn folds_hold_whole_stretches_and_all_of_them_something() {
        let trajectory = BendingExperiment { sweep_poses: 20, ..Default::default() }.waypoints().unwrap();
        let samples = Plant { model: Model::default(), sd_encoder_mm: 0.0015 }.run(&trajectory, 1);
        let readings: Vec<_> = samples.iter().map(|s| s.reading).collect();
        let data = Data::new(&SimulatedEye::default().observe(&samples, 2), &readings, 0.0015).unwrap();
        assert!(data.sweeps.windows(2).all(|pair| pair[1] == pair[0] || pair[1] == pair[0] + 1));
        for fold in 0..FOLDS {
            let size = (0..data.len()).filter(|&k| data.fold(k) == fold).count();
            assert!(size >= data.len() / (3 * FOLDS), "fold {fold}: {size} of {}", data.len());
        }
        assert!(data.remarks.is_empty(), "{:?}", data.remarks);
    }

    #[test]
    fn a_clock_that_goes_back_is_not_used_and_a_jump_is_told() {
        let (times, remark) = clock(&[0.0, 0.5, 1.0, 0.2, 0.7]);
        assert_eq!(times, [0.0, 0.5, 1.0, 1.5, 2.0]);
        assert!(remark.unwrap().contains("0.2 s after 1 s"));
        let (times, remark) = clock(&[0.0, 0.5, 1.0, 100.0, 100.5]);
        assert_eq!(times[3], 100.0);
        assert!(remark.unwrap().contains("jumps by 99.0 s"));
        assert_eq!(clock(&[0.0, 0.5, 1.1]).1, None);
    }

    #[test]
    fn too_little_is_said_plainly() {
        let readings: Vec<_> = (0..30)
            .map(|index| EncoderReading { index, time_s: index as f64, q_mm: PerBackbone::repeat(3, 0.0) })
            .collect();
        let error = Data::new(&[], &readings, 0.0015).unwrap_err().to_string();
        assert!(error.contains("0 usable samples"), "{error}");
    }
}
