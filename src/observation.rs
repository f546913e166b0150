//! What is observed of the robot: what the camera measured in a frame, what the encoders read, and, where the data is
//! synthetic, what was true. These are plain values; [`record`](crate::record) reads and writes them as files.

mod status;

pub use status::{Status, commonest_status};

use crate::geometry::{Configuration, wrap_angle};
use crate::robot::{BendProfile, Model, Neighbours, PerBackbone};
use nalgebra::{Matrix2, Matrix2x6, Point3, Rotation2, UnitQuaternion, Vector2};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// The bend has moved where it changed by more than so many standard deviations.
///
/// Derived: two normal errors of the eye exceed it once in 25,000 measurements, exp(−4.5²/2).
pub(crate) const MOVED_SDS: f64 = 4.5;

/// How far the grid of [`Measured::of_bend`] reaches, σ.
///
/// Derived: outside ±3.5σ lies less than a thousandth of a Gaussian in two dimensions, which the weights' sum leaves out too.
const GRID_REACH: f64 = 3.5;
/// Grid points to either side.
///
/// Convention: steps of a quarter of σ, at which a Gaussian's moments are exact to rounding.
const GRID_HALF: i32 = 14;
/// The squared distance, in units of the covariance, within which a Gaussian in two dimensions has the probability that one in one
/// dimension has within 3σ.
///
/// Derived: −2 ln 0.0027.
const THREE_SIGMAS_SQUARED: f64 = 11.83;
/// The largest correlation that is reported.
///
/// Convention: keeps the covariance invertible.
const LARGEST_CORRELATION: f64 = 0.999;

/// What a frame's pixels say about ψ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// θ and δ.
    pub configuration: Configuration,
    /// Standard deviation of θ, rad; NaN where a file does not say.
    pub sigma_theta: f64,
    /// Standard deviation of δ, rad; large near straight, where δ means little; NaN where a file does not say.
    pub sigma_delta: f64,
    /// Correlation of the errors of θ and δ, in (−1, 1).
    pub correlation: f64,
    /// Covariance of the bend vector θ (cos δ, sin δ) as the fit gave it, rad²; `None` where only the errors of θ and δ are known.
    pub fitted_covariance: Option<Matrix2<f64>>,
    /// The part of the errors that all measurements before one rig share: what six independent unit errors of the rig do to the bend vector
    /// θ (cos δ, sin δ), rad. The sigmas hold it; zero where nobody knows it, so that all errors count as the measurement's own.
    pub by_rig: Matrix2x6<f64>,
}

impl Measured {
    /// A measurement whose errors are all its own.
    pub fn independent(configuration: Configuration, sigma_theta: f64, sigma_delta: f64, correlation: f64) -> Self {
        let by_rig = Matrix2x6::zeros();
        Self { configuration, sigma_theta, sigma_delta, correlation, fitted_covariance: None, by_rig }
    }

    /// What a fit of the bend vector θ (cos δ, sin δ), rad, with this covariance, rad², says of θ and δ; its errors are all its own.
    ///
    /// Far from straight this is the linear propagation. Near straight δ may be anything, so the errors are mean squares over the bend
    /// vector's distribution, computed on a grid of ±3.5σ. If straight lies within three sigmas, the σ of δ is at least π/3, so that three
    /// sigmas of it cover the whole circle.
    pub fn of_bend(bend: Vector2<f64>, covariance: &Matrix2<f64>) -> Self {
        let configuration = Configuration::from_bend_vector(bend);
        let eigen = covariance.symmetric_eigen();
        let axes = eigen.eigenvectors * Matrix2::from_diagonal(&eigen.eigenvalues.map(|v| v.max(0.0).sqrt()));
        let (mut weights, mut tt, mut dd, mut td) = (0.0, 0.0, 0.0, 0.0);
        for i in -GRID_HALF..=GRID_HALF {
            for j in -GRID_HALF..=GRID_HALF {
                let z = Vector2::new(f64::from(i), f64::from(j)) * (GRID_REACH / f64::from(GRID_HALF));
                let weight = (-0.5 * z.norm_squared()).exp();
                let other = Configuration::from_bend_vector(bend + axes * z);
                let theta = other.theta - configuration.theta;
                let delta = wrap_angle(other.delta - configuration.delta);
                weights += weight;
                tt += weight * theta * theta;
                dd += weight * delta * delta;
                td += weight * theta * delta;
            }
        }
        let from_straight = covariance.try_inverse().map_or(0.0, |information| bend.dot(&(information * bend)));
        let all_round = if from_straight < THREE_SIGMAS_SQUARED { PI / 3.0 } else { 0.0 };
        let correlation = if tt * dd > 0.0 { td / (tt * dd).sqrt() } else { 0.0 };
        Self {
            fitted_covariance: Some(*covariance),
            ..Self::independent(
                configuration,
                (tt / weights).sqrt(),
                (dd / weights).sqrt().max(all_round),
                correlation.clamp(-LARGEST_CORRELATION, LARGEST_CORRELATION),
            )
        }
    }

    /// Covariance of the bend vector, rad²: the fit's, else that of (θ, δ) by moments to second order at a bend `at`.
    ///
    /// The latter is σ_θ² + θ²σ_δ⁴/2 along the bend and (θ² + σ_θ²) σ_δ² across it: what first order leaves out matters where δ is hardly
    /// known, near straight and where the camera looks along the bend. δ is never worse than wholly unknown, π/√3.
    pub fn bend_covariance(&self, at: Configuration) -> Matrix2<f64> {
        if let Some(fitted) = self.fitted_covariance {
            return fitted;
        }
        let sigma_delta = self.sigma_delta.min(PI / 3f64.sqrt());
        let along = self.sigma_theta.powi(2) + at.theta.powi(2) * sigma_delta.powi(4) / 2.0;
        let across = (at.theta.powi(2) + self.sigma_theta.powi(2)) * sigma_delta.powi(2);
        let cross = self.correlation * self.sigma_theta * at.theta * sigma_delta;
        let turn = Rotation2::new(at.delta);
        turn * Matrix2::new(along, cross, cross, across) * turn.inverse()
    }

    /// How far the bend moved from this measurement to another, in standard deviations; `None` if their covariances do not tell.
    pub fn moved_sds(&self, to: &Self) -> Option<f64> {
        let step = to.configuration.bend_vector() - self.configuration.bend_vector();
        let covariance = self.bend_covariance(self.configuration) + to.bend_covariance(to.configuration);
        covariance.cholesky().map(|factor| step.dot(&factor.solve(&step)).sqrt())
    }

    /// Whether the bend moved from this measurement to another by more than noise.
    pub fn has_moved(&self, to: &Self) -> bool {
        self.moved_sds(to).is_some_and(|sds| sds > MOVED_SDS)
    }

    /// Covariance of (θ, δ), rad².
    pub fn covariance(&self) -> Matrix2<f64> {
        let cross = self.correlation * self.sigma_theta * self.sigma_delta;
        Matrix2::new(self.sigma_theta.powi(2), cross, cross, self.sigma_delta.powi(2))
    }
}

/// How good the fit behind a measurement was.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Quality {
    /// Places on the snake's outline where an edge was found and agreed with the model.
    pub edges: usize,
    /// The share of the outline's places in view that they are, 0 to 1.
    pub inlier_fraction: f64,
    /// Root mean square distance of these edges from the model, px.
    pub rms_px: f64,
    /// How far the snake's base was seen from where the rig says, px; `None` where it was not seen.
    pub base_moved_px: Option<f64>,
    /// How far the grid was seen from where the rig says, up to whole pitches, px; `None` where it was not seen.
    pub grid_moved_px: Option<f64>,
    /// How the snake departs from a circle.
    pub shape: Option<Shape>,
    /// The bend along the snake as it was fitted, for drawings. No file has it: `None` for a measurement that was read.
    pub profile: Option<BendProfile>,
}

/// How the snake departs from a circular arc: its bend rate is (b + e (2s/L − 1))/L, b being the bend from base to tip. All
/// in rad; sigmas are 1σ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// The angle that the tip's tangent turned by, which need not be that of the circle that fits best.
    pub tip_theta: f64,
    /// Its standard deviation.
    pub sigma_tip_theta: f64,
    /// e along the bend: above zero the snake bends more towards its tip.
    pub along: f64,
    /// Its standard deviation.
    pub sigma_along: f64,
    /// e across the bend, towards growing δ: the snake leaves its plane.
    pub across: f64,
    /// Its standard deviation.
    pub sigma_across: f64,
    /// The squared departure in units of its covariance: 2 on the average for a circle, above 9.2 once in a hundred.
    pub chi2: f64,
}

/// One frame's row: measured, or the reason why not.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    /// Number in the frame's file name, or its position in a video.
    pub index: u64,
    /// Time of the frame, s, where it is known (from the encoder log or the video).
    pub time_s: Option<f64>,
    /// The verdict.
    pub status: Status,
    /// The angles, where there are any.
    pub measured: Option<Measured>,
    /// The fit's quality, where there was a fit.
    pub quality: Option<Quality>,
    /// Name of the view that the frame comes from, where the experiment names one; of several that were put together, with
    /// `+` between them.
    pub view: Option<String>,
}

impl Measurement {
    /// The bend along the snake: as fitted, or the arc of the measured angles.
    pub fn profile(&self) -> Option<BendProfile> {
        let fitted = self.quality.and_then(|quality| quality.profile).filter(|_| self.measured.is_some());
        fitted.or(self.measured.map(|measured| measured.configuration.into()))
    }
}

/// One row of encoders.csv: what the actuators' encoders read when a frame was taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EncoderReading {
    /// The frame's index.
    pub index: u64,
    /// Time, s.
    pub time_s: f64,
    /// q̃, mm.
    pub q_mm: PerBackbone,
    /// What the encoders of neighbouring sections read.
    pub neighbours: Neighbours,
}

impl EncoderReading {
    /// Of a robot of one section.
    pub fn new(index: u64, time_s: f64, q_mm: PerBackbone) -> Self {
        Self { index, time_s, q_mm, neighbours: Neighbours::default() }
    }

    /// The reading as it would be with the neighbours at rest: less what they add to it by a model.
    pub fn beside_resting_neighbours(&self, model: &Model) -> Self {
        match model.neighbours() {
            0 => *self,
            _ => Self { q_mm: self.q_mm - model.by_neighbours_mm(&self.neighbours), ..*self },
        }
    }
}

/// How the columns of an encoder log hold the backbones' readings: what `[wiring]` of an experiment.toml says.
///
/// The reading of backbone i + 1 at frame k is `scale · signs[i]` times column `columns[i]` of the log's row `k + index_shift`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Wiring {
    /// For each backbone the column that holds its reading, from 1.
    pub columns: Vec<usize>,
    /// For each backbone 1, or −1 where its encoder counts the other way.
    pub signs: Vec<i8>,
    /// What one unit of the log is, mm.
    pub scale: f64,
    /// How many rows after a frame's own index its reading stands.
    pub index_shift: i64,
}

impl Wiring {
    /// Every column as it stands.
    pub fn straight(backbones: usize) -> Self {
        Self { columns: (1..=backbones).collect(), signs: vec![1; backbones], scale: 1.0, index_shift: 0 }
    }

    /// Whether it leaves a log as it is.
    pub fn is_straight(&self) -> bool {
        *self == Self::straight(self.columns.len())
    }

    /// Whether it can be that of a robot of so many backbones: each column once, signs of 1 and −1, a positive scale.
    pub fn fits(&self, backbones: usize) -> bool {
        let mut columns = self.columns.clone();
        columns.sort_unstable();
        columns.iter().copied().eq(1..=backbones)
            && self.signs.len() == backbones
            && self.signs.iter().all(|sign| sign.abs() == 1)
            && self.scale.is_finite()
            && self.scale > 0.0
    }

    /// The wiring of the log, where `next` is that of the readings which this one gives.
    pub fn then(&self, next: &Self) -> Self {
        let through = |i: usize| next.columns[i] - 1;
        Self {
            columns: (0..next.columns.len()).map(|i| self.columns[through(i)]).collect(),
            signs: (0..next.signs.len()).map(|i| next.signs[i] * self.signs[through(i)]).collect(),
            scale: self.scale * next.scale,
            index_shift: self.index_shift + next.index_shift,
        }
    }

    /// Readings of the backbones, mm, from a row of the log; of a wiring that [`fits`](Self::fits).
    pub fn q_mm(&self, row: &PerBackbone) -> PerBackbone {
        PerBackbone::from_fn(row.len(), |i| self.scale * f64::from(self.signs[i]) * row[self.columns[i] - 1])
    }

    /// The readings that a log means. A row whose frame would come before frame 0 is left out.
    pub fn readings(&self, log: &[EncoderReading]) -> Vec<EncoderReading> {
        let reading = |row: &EncoderReading| {
            let index = row.index.checked_add_signed(self.index_shift.checked_neg()?)?;
            let neighbours = Neighbours { q_mm: row.neighbours.q_mm.map(|q| q * self.scale) };
            Some(EncoderReading { index, time_s: row.time_s, q_mm: self.q_mm(&row.q_mm), neighbours })
        };
        log.iter().filter_map(reading).collect()
    }
}

/// One pose of a sensor on the snake's tip, in the frame of a tracker.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackerPose {
    /// Its index, which goes with that of the encoder reading.
    pub index: u64,
    /// Time, s.
    pub time_s: f64,
    /// Where the sensor is, mm; `None` where the tracker lost it.
    pub position_mm: Option<Point3<f64>>,
    /// How it is turned: from the sensor's axes to the tracker's.
    pub orientation: Option<UnitQuaternion<f64>>,
    /// Standard deviation of each coordinate of the position, mm; where it is not given it is learned.
    pub sigma_mm: Option<f64>,
}

/// One row of truth.csv: what a synthetic frame shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// The frame's index.
    pub index: u64,
    /// The true θ and δ.
    pub configuration: Configuration,
}

/// One pose of a trajectory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Waypoint {
    /// Time, s.
    pub time_s: f64,
    /// θ and δ.
    pub configuration: Configuration,
    /// What the encoders of neighbouring sections read meanwhile.
    pub neighbours: Neighbours,
}

impl Waypoint {
    /// Of a robot of one section.
    pub fn new(time_s: f64, configuration: Configuration) -> Self {
        Self { time_s, configuration, neighbours: Neighbours::default() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use rand::SeedableRng;
    use rand::rngs::StdRng;
    use rand_distr::{Distribution, Normal, StandardNormal};

    #[test]
    fn the_bend_vectors_covariance_is_that_of_drawn_measurements() {
        let mut random = StdRng::seed_from_u64(3);
        for (theta_deg, sigma_delta_deg, rho) in [(40.0, 0.4, 0.5), (2.0, 8.0, -0.3), (30.0, 12.0, 0.0)] {
            let psi = Configuration::from_degrees(theta_deg, 50.0);
            let mean = Measured::independent(psi, 0.3f64.to_radians(), f64::to_radians(sigma_delta_deg), rho);
            let draws: Vec<Vector2<f64>> = (0..20_000)
                .map(|_| {
                    let (a, b): (f64, f64) = (StandardNormal.sample(&mut random), StandardNormal.sample(&mut random));
                    let theta = mean.configuration.theta + mean.sigma_theta * a;
                    let delta = mean.configuration.delta + mean.sigma_delta * (rho * a + (1.0 - rho * rho).sqrt() * b);
                    theta * Vector2::new(delta.cos(), delta.sin()) - mean.configuration.bend_vector()
                })
                .collect();
            let count = draws.len() as f64;
            let centre = draws.iter().sum::<Vector2<f64>>() / count;
            let scatter = draws.iter().map(|d| (d - centre) * (d - centre).transpose()).sum::<Matrix2<f64>>() / count;
            let predicted = mean.bend_covariance(psi);
            assert!((scatter - predicted).norm() < 0.06 * predicted.norm(), "{scatter} {predicted}");
        }
    }

    #[test]
    fn far_from_straight_the_polar_errors_are_those_of_linear_propagation() {
        let (theta, delta) = (0.8_f64, 0.6_f64);
        let bend = Configuration::new(theta, delta).bend_vector();
        let covariance = Matrix2::new(4e-6, 1e-6, 1e-6, 2e-6);
        let polar = Measured::of_bend(bend, &covariance);
        let jacobian = Matrix2::new(delta.cos(), delta.sin(), -delta.sin() / theta, delta.cos() / theta);
        let linear = jacobian * covariance * jacobian.transpose();
        assert_relative_eq!(polar.sigma_theta, linear[(0, 0)].sqrt(), max_relative = 0.01);
        assert_relative_eq!(polar.sigma_delta, linear[(1, 1)].sqrt(), max_relative = 0.01);
        assert_relative_eq!(polar.covariance()[(0, 1)], linear[(0, 1)], epsilon = 2e-8);
    }

    #[test]
    fn at_straight_delta_is_anything() {
        let polar = Measured::of_bend(Vector2::new(1e-9, 0.0), &(Matrix2::identity() * 1e-6));
        // A direction uniform over the circle has σ = π/√3.
        assert_relative_eq!(polar.sigma_delta, PI / 3.0_f64.sqrt(), max_relative = 0.05);
        assert!(polar.sigma_theta > 1e-3);
    }

    #[test]
    fn the_direction_is_within_three_sigmas_however_near_to_straight() {
        /// Of either component, rad. Convention: any size does, since the bends are multiples of it.
        const SIGMA: f64 = 1e-3;
        const DRAWS: u32 = 20_000;
        let mut random = StdRng::seed_from_u64(7);
        let noise = Normal::new(0.0, SIGMA).unwrap();
        for theta in [0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 10.0] {
            let truth = Vector2::new(theta * SIGMA, 0.0);
            let is_outside = |_: &u32| {
                let seen = truth + Vector2::from_fn(|_, _| noise.sample(&mut random));
                let polar = Measured::of_bend(seen, &(Matrix2::identity() * SIGMA * SIGMA));
                wrap_angle(polar.configuration.delta).abs() > 3.0 * polar.sigma_delta
            };
            let outside = (0..DRAWS).filter(is_outside).count();
            assert!(outside as f64 / f64::from(DRAWS) < 0.01, "θ {theta} σ: {outside} of {DRAWS}");
        }
    }

    #[test]
    fn a_wiring_puts_columns_signs_unit_and_rows_right() {
        let row = |index, q: [f64; 3]| EncoderReading::new(index, 0.5, PerBackbone::from(q));
        let wiring = Wiring { columns: vec![2, 3, 1], signs: vec![1, -1, 1], scale: 10.0, index_shift: 1 };
        assert!(wiring.fits(3) && !wiring.fits(4) && !wiring.is_straight() && Wiring::straight(4).is_straight());
        let log = [row(0, [1.0, 2.0, 3.0]), row(1, [4.0, 5.0, 6.0])];
        assert_eq!(wiring.readings(&log), [row(0, [50.0, -60.0, 40.0])], "the row before the first frame is left out");
        let swapped = Wiring { columns: vec![1, 3, 2], signs: vec![-1, 1, 1], scale: 0.5, index_shift: 0 };
        let composed = wiring.then(&swapped);
        assert_eq!(composed.readings(&log), swapped.readings(&wiring.readings(&log)), "one after the other");
        for wrong in [
            Wiring { columns: vec![1, 1, 2], ..wiring.clone() },
            Wiring { columns: vec![0, 1, 2], ..wiring.clone() },
            Wiring { signs: vec![1, 0, 1], ..wiring.clone() },
            Wiring { signs: vec![1, 1], ..wiring.clone() },
            Wiring { scale: f64::NAN, ..wiring.clone() },
            Wiring { scale: -1.0, ..wiring },
        ] {
            assert!(!wrong.fits(3), "{wrong:?}");
        }
    }
}
