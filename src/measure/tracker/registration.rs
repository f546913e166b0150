//! Where the snake's base is in a tracker's frame, and where the sensor is on its tip.
//!
//! With the base's pose (R, o) in the tracker's frame, the tip's frame (x(b), T(b)) in the base's, the sensor's place m on the tip and
//! its turn M, a pose of the tracker is
//!
//! ```text
//! p = o + R (k x(b) + T(b) m),        S = R T(b) M,        k = 1 − s |b|.
//! ```
//!
//! Each pose has a bend b of its own. Least squares over all of them: the bends are eliminated (variable projection), so that what is
//! searched is the registration alone: two tilts of R, o, m, the turn of M, and s, by which the snake shortens as it bends. The turn of R
//! about its own z is left as it is: tip poses do not tell it (see [`azimuth`](super::azimuth)). The noise of positions and of orientations
//! is learned from the residuals, and so is how alike the errors of poses are that follow each other: a snake that is no arc errs
//! alike over a whole sweep, and many such poses must not outweigh what is known beforehand.
//!
//! Source: G. H. Golub, V. Pereyra, "Separable nonlinear least squares: the variable projection method and its applications", Inverse
//! Problems 19, 2003; the Jacobian in Kaufman's form.

mod pose;
mod starts;
mod sweep;

pub use pose::{Fitted, Role};

use crate::geometry::Pose;
use crate::observation::TrackerPose;
use crate::robot::Robot;
use crate::statistics::correlation::SerialScatter;
use crate::statistics::least_squares::{self, Options, Problem as _};
use crate::statistics::order::median;
use crate::statistics::robust::{HUBER_LIMIT, Loss};
use nalgebra::{DVector, Point3, SMatrix, Translation3, UnitQuaternion, Vector3};
use sweep::Sweep;

/// Numbers of a registration. Derived: two tilts, three of the origin, three of the sensor's place, three of its turn, and the shortening.
pub const RIG: usize = 12;
/// Rows of what is known beforehand. Derived: three each of the sensor's place and turn, one of the shortening, and three of the base, if it is stated.
const PRIORS: usize = 10;
/// How far from the middle of the end disk a sensor may be, across the snake and along it, mm (1σ), where orientations tell it.
///
/// Convention: about the snake's width; a sweep tells far better.
const SENSOR_MM: (f64, f64) = (5.0, 5.0);
/// The same where there are no orientations. Positions alone can hardly tell a sensor beside the axis from a base that is tilted: the
/// surface that a tip reaches is nearly a sphere.
///
/// Convention: such a sensor is put into the middle of the tip.
const SENSOR_WITHOUT_ORIENTATION_MM: (f64, f64) = (0.5, 2.0);
/// How well a base that is stated is known, mm (1σ).
///
/// Convention: the tip of a pointer on the middle of a disk.
const STATED_BASE_MM: f64 = 0.5;
/// Registrations are told apart by the encoders where one is less likely than the best by no more than this, −2 ln of the odds.
///
/// Derived: 2 ln 1000.
const ALTERNATIVE: f64 = 13.8;
/// Keeps the sensor's turn determined where there are no orientations, rad.
///
/// Convention: more than any turn.
const TURN_RAD: f64 = 10.0;
/// The least noise that is believed, mm and rad.
///
/// Convention: the resolution of such files.
const LEAST_SIGMAS: (f64, f64) = (1e-3, 1e-4);
/// How often noise and registration are learned in turn.
///
/// Convention: an iteration cap.
const ROUNDS: usize = 5;
/// The most poses that a registration is made from, spread over all.
///
/// Convention: a limit on the time; a thousand leave an axis far better than one pose.
const MOST_POSES: usize = 1000;
/// A pose whose residual is beyond this many standard deviations of a normal deviate is a jump.
///
/// Derived: noise alone makes three of ten million poses one.
const JUMP_SIGMAS: f64 = 5.0;

/// A registration, its covariance, and the noise of the poses it was made from.
#[derive(Debug, Clone)]
pub struct Registration {
    robot: Robot,
    /// R and o.
    pub tracker_from_base: Pose,
    /// m, mm.
    sensor_mm: Vector3<f64>,
    /// M.
    turn: UnitQuaternion<f64>,
    /// s: the share of its length that the snake loses, per rad.
    pub shortening: f64,
    /// Standard deviation of a coordinate of a position, mm, in units of the pose's own where the file has them.
    pub sigma_mm: f64,
    /// Standard deviation of a component of an orientation, rad.
    pub sigma_rad: f64,
    /// How many poses that follow each other err alike and so count as one: of positions, and of orientations.
    design_effects: (f64, f64),
    /// Whether orientations are used.
    pub has_orientations: bool,
    /// Where o is stated to be, mm.
    stated_base_mm: Option<Point3<f64>>,
    covariance: SMatrix<f64, RIG, RIG>,
}

impl Registration {
    /// From poses, one of them straight: the most likely registration, then those that are hardly less likely; empty where there is no fit.
    pub fn all(
        seen: &[&TrackerPose],
        straight: &TrackerPose,
        robot: &Robot,
        stated_base_mm: Option<Point3<f64>>,
    ) -> Vec<Self> {
        let every = seen.len().div_ceil(MOST_POSES);
        let mut poses: Vec<&TrackerPose> = seen.iter().step_by(every).copied().collect();
        poses.retain(|pose| pose.index != straight.index);
        poses.insert(0, straight);
        let starts = match stated_base_mm {
            Some(base_mm) => Self::stated(straight, robot, base_mm).into_iter().collect(),
            None => Self::starts(&poses, straight, robot).unwrap_or_default(),
        };
        let mut fits: Vec<(f64, Self)> = starts.into_iter().filter_map(|start| start.refined(&poses)).collect();
        fits.sort_by(|(one, _), (other, _)| one.total_cmp(other));
        let most = fits.first().map_or(0.0, |(best, _)| best + ALTERNATIVE);
        fits.into_iter().take_while(|(unlikely, _)| *unlikely <= most).map(|(_, registration)| registration).collect()
    }

    /// Registration and noise, learned in turn; with −2 ln of the posterior probability, up to a constant.
    fn refined(mut self, poses: &[&TrackerPose]) -> Option<(f64, Self)> {
        let options = Options {
            loss: Loss::Huber(HUBER_LIMIT),
            most_iterations: 40,
            least_relative_decrease: 1e-9,
            ..Options::default()
        };
        for _ in 0..ROUNDS {
            let sweep = Sweep { poses, around: &self };
            let solution = least_squares::solve(&sweep, DVector::zeros(RIG), &options).ok()?;
            let (mut found, fits) = solution.evaluation;
            let jacobian = sweep.jacobian(&solution.parameters, &(found.clone(), fits.clone()));
            let covariance = least_squares::covariance(&jacobian)?;
            found.covariance = SMatrix::from_fn(|i, j| covariance[(i, j)]);
            found.learn_noise(&fits[1..]);
            self = found;
        }
        Some((self.unlikeliness(poses.len()), self))
    }

    /// What the noise says, at so many poses, the sensor's place and the shortening. Of a pose's six numbers its bend takes two; with orientations each kind of
    /// number is left with about half of the rest.
    fn unlikeliness(&self, poses: usize) -> f64 {
        let place: f64 =
            self.sensor_mm.iter().zip(self.sensor_sigmas_mm()).map(|(mm, sigma)| (mm / sigma).powi(2)).sum();
        let shortening = (self.shortening / self.shortening_sigma()).powi(2);
        let (positions, orientations) =
            (self.sigma_mm.ln() / self.design_effects.0, self.sigma_rad.ln() / self.design_effects.1);
        let noise = if self.has_orientations { 4.0 * (positions + orientations) } else { 2.0 * positions };
        place + shortening + poses as f64 * noise
    }

    /// The noise that the residuals show, robustly: the median over the poses of r²/dof, which is that of χ²/dof where σ is right. The
    /// degrees of freedom are the rows less what the bend takes.
    fn learn_noise(&mut self, fits: &[Fitted]) {
        let scale = |first: usize| {
            let mut ratios: Vec<f64> = fits
                .iter()
                .filter_map(|fit| {
                    let hat = fit.by_bend * fit.solver()?;
                    let dof = 3.0 - (first..first + 3).map(|row| hat[(row, row)]).sum::<f64>();
                    Some(fit.residual.fixed_rows::<3>(first).norm_squared() / (dof * median_of_chi_square(dof)))
                })
                .collect();
            median(&mut ratios).sqrt()
        };
        let (position, orientation) = (scale(0), if self.has_orientations { scale(3) } else { 1.0 });
        let (of_positions, of_orientations) = self.design_effects;
        self.sigma_mm = (self.sigma_mm * of_positions.sqrt() * position).max(LEAST_SIGMAS.0);
        self.sigma_rad = (self.sigma_rad * of_orientations.sqrt() * orientation).max(LEAST_SIGMAS.1);
        let alike = |first: usize| {
            let mut scatter = SerialScatter::<3>::new(0);
            fits.iter().for_each(|fit| {
                scatter.add(fit.residual.fixed_rows::<3>(first).into_owned().cap_magnitude(JUMP_SIGMAS))
            });
            scatter.design_effect()
        };
        self.design_effects = (alike(0), alike(3));
    }

    /// How far from the middle of the end disk the sensor may be along each of its axes, mm.
    fn sensor_sigmas_mm(&self) -> [f64; 3] {
        let (across_mm, along_mm) = if self.has_orientations { SENSOR_MM } else { SENSOR_WITHOUT_ORIENTATION_MM };
        // Beside a base that is stated the straight pose tells it, on a tool as well.
        [across_mm, across_mm, if self.stated_base_mm.is_some() { self.robot.length_mm } else { along_mm }]
    }

    /// How much of its length such a snake may lose, per rad (1σ).
    ///
    /// Derived: tendons that only pull, on a backbone that gives way lengthwise, shorten it by their mean pull: r θ/2 where one of three
    /// pulls, r θ where two do. Backbones that push as well leave its length.
    fn shortening_sigma(&self) -> f64 {
        self.robot.backbone_circle_radius_mm / self.robot.length_mm
    }

    /// The registration after a small change of its numbers.
    fn moved(&self, by: &DVector<f64>) -> Self {
        let Pose { rotation, translation } = self.tracker_from_base;
        let tilt = UnitQuaternion::from_scaled_axis(Vector3::new(by[0], by[1], 0.0));
        let shift = rotation * Vector3::new(by[2], by[3], by[4]);
        Self {
            tracker_from_base: Pose::from_parts(Translation3::from(translation.vector + shift), rotation * tilt),
            sensor_mm: self.sensor_mm + Vector3::new(by[5], by[6], by[7]),
            turn: UnitQuaternion::from_scaled_axis(Vector3::new(by[8], by[9], by[10])) * self.turn,
            shortening: self.shortening + by[11],
            ..self.clone()
        }
    }

    /// Standard deviation of the direction of the base's axis, rad: the larger of its two tilts'.
    pub fn tilt_sigma(&self) -> f64 {
        self.covariance[(0, 0)].max(self.covariance[(1, 1)]).sqrt()
    }

    /// Whether the base was stated.
    pub fn base_is_stated(&self) -> bool {
        self.stated_base_mm.is_some()
    }

    /// Standard deviation of the shortening, per rad.
    pub fn sigma_of_shortening(&self) -> f64 {
        self.covariance[(11, 11)].sqrt()
    }
}

/// The median of χ² over its degrees of freedom.
///
/// Source: E. B. Wilson, M. M. Hilferty, PNAS 17, 1931: the cube root of χ²/k is nearly normal, about 1 − 2/(9k).
fn median_of_chi_square(dof: f64) -> f64 {
    (1.0 - 2.0 / (9.0 * dof)).max(0.0).powi(3)
}

/// Whether χ² is larger than noise makes it, by the same approximation: beyond [`JUMP_SIGMAS`] of a variance of 2/(9k).
pub fn is_improbable(chi_square: f64, dof: f64) -> bool {
    let spread = 2.0 / (9.0 * dof);
    (chi_square / dof).cbrt() > 1.0 - spread + JUMP_SIGMAS * spread.sqrt()
}
