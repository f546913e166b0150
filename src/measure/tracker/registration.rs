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

mod sweep;

use crate::geometry::{Configuration, Pose};
use crate::observation::TrackerPose;
use crate::robot::{MAX_THETA, Robot};
use crate::statistics::correlation::SerialScatter;
use crate::statistics::least_squares::{self, Options, Problem as _};
use crate::statistics::order::median;
use crate::statistics::robust::{HUBER_LIMIT, Loss};
use nalgebra::{
    DVector, Matrix2, Matrix3, Matrix6x2, Point3, SMatrix, SVector, Translation3, UnitQuaternion, Vector2, Vector3,
};
use std::f64::consts::{PI, TAU};
use sweep::Sweep;

/// Numbers of a registration: two tilts, three of the origin, three of the sensor's place, three of its turn, and the shortening.
pub const RIG: usize = 12;
/// Rows of what is known beforehand: the sensor's place and turn, the shortening, and the base where it is stated.
const PRIORS: usize = 10;
/// Residuals of a pose: its position, its orientation, and the bend of the straight one.
const ROWS: usize = 8;
/// How well a snake that is called straight is, rad.
///
/// Convention: half a degree, which an eye sees beside a ruler.
const STRAIGHT_RAD: f64 = 0.5 * PI / 180.0;
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
/// The noise that the first fit begins with, mm and rad.
///
/// Convention: what common trackers are good to; learned from then on.
const FIRST_SIGMAS: (f64, f64) = (0.5, 0.02);
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
/// Poses by which directions of the axis are compared, and how many directions.
///
/// Convention: directions 13° apart; a fit from the best of them converges.
const COMPARED: (usize, usize) = (100, 300);
/// From how many directions a fit is started, and how far they are apart at least, as a cosine.
///
/// Convention: 40°. The surface that a tip reaches is nearly a sphere, on which a base on the other side is a side minimum.
const STARTS: (usize, f64) = (4, 0.766);
/// What a compared pose costs at most, mm².
///
/// Convention: (3 mm)², so that jumps do not decide.
const MOST_COST_MM2: f64 = 9.0;
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

/// What a pose is fitted for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Role {
    /// Its own bend.
    Alone,
    /// The registration, with others that err alike.
    InSweep,
    /// The registration, as the pose in which the snake is unbent.
    Straight,
}

/// A pose with its best bend.
#[derive(Debug, Clone, Copy)]
pub struct Fitted {
    /// rad.
    pub bend: Vector2<f64>,
    /// Measured less predicted, in units of σ.
    residual: SVector<f64, ROWS>,
    by_bend: SMatrix<f64, ROWS, 2>,
    by_rig: SMatrix<f64, ROWS, RIG>,
}

impl Fitted {
    /// The squared residual in units of σ².
    pub fn chi_square(&self) -> f64 {
        self.residual.norm_squared()
    }

    /// (JᵗJ)⁻¹ Jᵗ by the bend.
    fn solver(&self) -> Option<SMatrix<f64, 2, ROWS>> {
        Some((self.by_bend.tr_mul(&self.by_bend)).try_inverse()? * self.by_bend.transpose())
    }

    /// The derivative by the registration with the bend at its best for each: (1 − J J⁺) J_rig.
    fn projected(&self) -> SMatrix<f64, ROWS, RIG> {
        self.solver().map_or(self.by_rig, |solver| self.by_rig - self.by_bend * (solver * self.by_rig))
    }
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

    /// The directions of the axis whose arcs the positions fit best, each with the base straight below the straight tip.
    fn starts(poses: &[&TrackerPose], straight: &TrackerPose, robot: &Robot) -> Option<Vec<Self>> {
        let tip = straight.position_mm?;
        let compared: Vec<_> = poses.iter().step_by(poses.len().div_ceil(COMPARED.0)).collect();
        let mut directions: Vec<(f64, Self)> = sphere(COMPARED.1)
            .map(|axis| {
                let start = Self::start(straight, robot, tip - axis * robot.length_mm, &axis);
                (compared.iter().map(|pose| start.cost_mm2(pose)).sum(), start)
            })
            .collect();
        directions.sort_by(|(one, _), (other, _)| one.total_cmp(other));
        let mut starts: Vec<Self> = Vec::new();
        for (_, start) in directions {
            let is_new = starts.iter().all(|other| other.axis().dot(&start.axis()) < STARTS.1);
            if is_new && starts.len() < STARTS.0 {
                starts.push(start);
            }
        }
        Some(starts)
    }

    /// With the base where it is stated, and its axis towards the straight tip.
    fn stated(straight: &TrackerPose, robot: &Robot, base_mm: Point3<f64>) -> Option<Self> {
        let snake_mm = straight.position_mm? - base_mm;
        let mut start = Self::start(straight, robot, base_mm, &snake_mm.try_normalize(0.0)?);
        start.stated_base_mm = Some(base_mm);
        start.sensor_mm.z = snake_mm.norm() - robot.length_mm;
        Some(start)
    }

    /// A base in this place with this axis, and a sensor in the middle of the tip.
    fn start(straight: &TrackerPose, robot: &Robot, base_mm: Point3<f64>, axis: &Vector3<f64>) -> Self {
        let rotation = UnitQuaternion::rotation_between(&Vector3::z(), axis)
            .unwrap_or(UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI));
        Self {
            robot: robot.clone(),
            tracker_from_base: Pose::from_parts(Translation3::from(base_mm), rotation),
            sensor_mm: Vector3::zeros(),
            turn: straight.orientation.map_or(UnitQuaternion::identity(), |seen| rotation.inverse() * seen),
            shortening: 0.0,
            sigma_mm: FIRST_SIGMAS.0,
            sigma_rad: FIRST_SIGMAS.1,
            design_effects: (1.0, 1.0),
            has_orientations: straight.orientation.is_some(),
            stated_base_mm: None,
            covariance: SMatrix::zeros(),
        }
    }

    /// The direction of the base's axis in the tracker's frame.
    fn axis(&self) -> Vector3<f64> {
        self.tracker_from_base.rotation * Vector3::z()
    }

    /// How far a position lies from the arc that leads nearest to it, squared; no more than an outlier's.
    fn cost_mm2(&self, pose: &TrackerPose) -> f64 {
        let Some(position) = pose.position_mm else { return 0.0 };
        let bend = self.first_bend(pose);
        let tip = self.robot.frame_at(Configuration::from_bend_vector(bend), self.robot.length_mm);
        let off = self.tracker_from_base.inverse_transform_point(&position).coords - tip.translation.vector;
        off.norm_squared().min(MOST_COST_MM2)
    }

    /// The bend of the arc from the base, along its axis, through the position: its chord leans by θ/2.
    fn first_bend(&self, pose: &TrackerPose) -> Vector2<f64> {
        let Some(position) = pose.position_mm else { return Vector2::zeros() };
        let point = self.tracker_from_base.inverse_transform_point(&position).coords;
        let theta = (2.0 * point.xy().norm().atan2(point.z)).min(MAX_THETA);
        point.xy().try_normalize(0.0).unwrap_or_default() * theta
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

    /// The tip's frame, and its twist per rad of each component of the bend, of a snake that shortens.
    fn tip(&self, bend: Vector2<f64>) -> (Pose, Matrix6x2<f64>) {
        let mut tip = self.robot.frame_at(Configuration::from_bend_vector(bend), self.robot.length_mm);
        let mut twist = self.robot.tip_jacobian_bend(bend);
        let share = 1.0 - self.shortening * bend.norm();
        let slope = bend.try_normalize(0.0).unwrap_or_default() * -self.shortening;
        let velocity = twist.fixed_rows::<3>(0) * share + tip.translation.vector * slope.transpose();
        twist.fixed_rows_mut::<3>(0).copy_from(&velocity);
        tip.translation.vector *= share;
        (tip, twist)
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

    /// The best bend of a pose by the method of Gauss and Newton, from `start` or the arc's chord; `None` where the pose has no position.
    pub fn fit(&self, pose: &TrackerPose, role: Role, start: Option<Vector2<f64>>) -> Option<Fitted> {
        /// Convention: an iteration cap.
        const STEPS: usize = 20;
        /// rad. Convention: a step within which the arcs' curvature is harmless.
        const LONGEST_STEP: f64 = 0.3;
        /// rad. Convention: far below any noise.
        const CONVERGED: f64 = 1e-9;
        pose.position_mm?;
        let mut fitted = self.linearised(pose, role, start.unwrap_or_else(|| self.first_bend(pose)))?;
        for _ in 0..STEPS {
            let step = fitted.solver()? * fitted.residual;
            let bend = fitted.bend + step.cap_magnitude(LONGEST_STEP);
            fitted = self.linearised(pose, role, bend.cap_magnitude(MAX_THETA))?;
            if step.norm() < CONVERGED {
                break;
            }
        }
        Some(fitted)
    }

    /// Residuals of a pose at a bend, in the base's axes and in units of σ, with the derivatives of what is predicted.
    fn linearised(&self, pose: &TrackerPose, role: Role, bend: Vector2<f64>) -> Option<Fitted> {
        let (tip, twist) = self.tip(bend);
        let (arm, turned) = (tip.rotation * self.sensor_mm, tip.rotation.to_rotation_matrix());
        let place = tip.translation.vector + arm;
        let seen = self.tracker_from_base.inverse_transform_point(&pose.position_mm?).coords;
        let mut fitted =
            Fitted { bend, residual: SVector::zeros(), by_bend: SMatrix::zeros(), by_rig: SMatrix::zeros() };

        let alike = if role == Role::InSweep { self.design_effects } else { (1.0, 1.0) };
        let sigma_mm = self.sigma_mm * alike.0.sqrt() * pose.sigma_mm.unwrap_or(1.0);
        let sigma_rad = self.sigma_rad * alike.1.sqrt();
        fitted.residual.fixed_rows_mut::<3>(0).copy_from(&((seen - place) / sigma_mm));
        for axis in 0..2 {
            let (velocity, turning) = (twist.fixed_view::<3, 1>(0, axis), twist.fixed_view::<3, 1>(3, axis));
            let by_bend = velocity + turning.cross(&arm);
            fitted.by_bend.fixed_view_mut::<3, 1>(0, axis).copy_from(&(by_bend / sigma_mm));
            fitted
                .by_rig
                .fixed_view_mut::<3, 1>(0, axis)
                .copy_from(&(Vector3::ith(axis, 1.0).cross(&place) / sigma_mm));
        }
        fitted.by_rig.fixed_view_mut::<3, 3>(0, 2).copy_from(&(Matrix3::identity() / sigma_mm));
        fitted.by_rig.fixed_view_mut::<3, 3>(0, 5).copy_from(&(turned.matrix() / sigma_mm));
        let unshortened = self.robot.frame_at(Configuration::from_bend_vector(bend), self.robot.length_mm).translation;
        fitted.by_rig.fixed_view_mut::<3, 1>(0, 11).copy_from(&(unshortened.vector * (-bend.norm() / sigma_mm)));

        if let Some(orientation) = pose.orientation.filter(|_| self.has_orientations) {
            let predicted = tip.rotation * self.turn;
            let left = self.tracker_from_base.rotation.inverse() * orientation * predicted.inverse();
            fitted.residual.fixed_rows_mut::<3>(3).copy_from(&(left.scaled_axis() / sigma_rad));
            fitted.by_bend.fixed_view_mut::<3, 2>(3, 0).copy_from(&(twist.fixed_view::<3, 2>(3, 0) / sigma_rad));
            let tilts = SMatrix::<f64, 3, 2>::identity() / sigma_rad;
            fitted.by_rig.fixed_view_mut::<3, 2>(3, 0).copy_from(&tilts);
            fitted.by_rig.fixed_view_mut::<3, 3>(3, 8).copy_from(&(turned.matrix() / sigma_rad));
        }
        if role == Role::Straight {
            fitted.residual.fixed_rows_mut::<2>(6).copy_from(&(-bend / STRAIGHT_RAD));
            fitted.by_bend.fixed_view_mut::<2, 2>(6, 0).copy_from(&(Matrix2::identity() / STRAIGHT_RAD));
        }
        Some(fitted)
    }

    /// Covariance of a pose's bend by its own noise, rad², and what independent unit errors of the registration do to it, rad.
    pub fn errors(&self, fit: &Fitted) -> Option<(Matrix2<f64>, SMatrix<f64, 2, RIG>)> {
        let solver = fit.solver()?;
        Some((solver * solver.transpose(), solver * fit.by_rig * self.covariance.cholesky()?.l()))
    }

    /// Rows of a pose less what its bend takes.
    pub fn degrees_of_freedom(&self, pose: &TrackerPose) -> f64 {
        if self.has_orientations && pose.orientation.is_some() { 4.0 } else { 1.0 }
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

/// Directions spread evenly over the sphere.
///
/// Source: the Fibonacci lattice; Á. González, Mathematical Geosciences 42, 2010.
fn sphere(count: usize) -> impl Iterator<Item = Vector3<f64>> {
    let golden = (1.0 + 5f64.sqrt()) / 2.0;
    (0..count).map(move |k| {
        let z = 1.0 - (2.0 * k as f64 + 1.0) / count as f64;
        let (sin, cos) = (TAU * k as f64 / golden).sin_cos();
        let side = (1.0 - z * z).sqrt();
        Vector3::new(side * cos, side * sin, z)
    })
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
