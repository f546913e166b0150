//! Tip poses of an electromagnetic or optical tracker to θ and δ, with their covariance, in place of pictures.
//!
//! 1. [`registration`]: where the snake's base is in the tracker's frame, and where the sensor is on the tip, by least squares over the
//!    straight pose and the sweep itself.
//! 2. [`azimuth`]: which way x_b points, which no tip pose tells: from the encoders, or stated.
//! 3. Here: every pose is fitted by itself, the registration's uncertainty is added, and poses that do not lie on the surface that a tip
//!    can reach are told apart.

mod azimuth;
mod error;
mod registration;

pub use error::TrackerError;

use super::measurement::{Bend, FrameMeasurement};
use crate::observation::{EncoderReading, Quality, Status, TrackerPose};
use crate::robot::Robot;
use crate::statistics::order::quantile;
use azimuth::Azimuth;
use nalgebra::{Matrix2, Matrix2x6, Rotation2, Vector2};
use rayon::prelude::*;
use registration::{Registration, is_improbable};

/// The fewest poses of a tip that are registered.
///
/// Convention: each position leaves one number for the eight of the registration; this is twice as many.
const LEAST_POSES: usize = 16;
/// A tip that moves by less than this share of the snake's length does not tell where its base is.
///
/// Derived: a bend of θ moves the tip by about L θ/2; 2 % is 2.3°.
const LEAST_SHARE: f64 = 0.02;
/// No tip is farther from where it is when straight than this many lengths of the snake.
///
/// Derived: the tip of an arc bent by 120° is 1.1 L away; twice that leaves room for a sensor on a tool.
const MOST_LENGTHS: f64 = 2.2;
/// The share of the poses whose distance tells the unit; the rest may be jumps.
///
/// Convention: one pose in ten may be wrong.
const TRUSTED_SHARE: f64 = 0.9;
/// A tilt of the base's axis that is known worse than this is no registration, degrees (1σ).
///
/// Convention: above it the angles mean little.
const MOST_TILT_SIGMA_DEG: f64 = 5.0;
/// Poses that scatter by more than this about the arcs are none of such a snake: positions, as a share of its length, and orientations, degrees.
///
/// Convention: several times what such trackers are good to, and what snakes that are no circles leave.
const MOST_SCATTER: (f64, f64) = (0.05, 10.0);

/// How a tracker's poses are to be read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackerOptions {
    /// Index of the pose in which the snake is unbent.
    pub straight: u64,
    /// Azimuth in {b} of the tracker's x axis, rad; where it is not stated the encoders tell.
    pub delta_offset: Option<f64>,
}

/// What a tracker's poses say.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackedPoses {
    /// For each pose its index, its time in s, and θ and δ or the reason why not: `tracker_lost` or `tracker_jump`.
    pub measurements: Vec<(u64, f64, FrameMeasurement)>,
    /// What the registration found, and what was passed over, in sentences.
    pub remarks: Vec<String>,
}

/// Registers the base from the straight pose and the sweep, and measures every pose.
///
/// # Errors
/// [`TrackerError`]: poses that look as if in another unit, too few of them, a tip that hardly moves, axes that are flipped, an
/// azimuth that nothing tells.
pub fn measure_poses(
    poses: &[TrackerPose],
    readings: &[EncoderReading],
    robot: &Robot,
    options: &TrackerOptions,
) -> Result<TrackedPoses, TrackerError> {
    let seen: Vec<&TrackerPose> = poses.iter().filter(|pose| pose.position_mm.is_some()).collect();
    if seen.len() < LEAST_POSES {
        return Err(TrackerError::TooFew { found: seen.len(), needed: LEAST_POSES });
    }
    let straight = seen.iter().find(|pose| pose.index == options.straight);
    let straight = straight.ok_or(TrackerError::NoStraight { index: options.straight })?;
    check_unit(&seen, straight, robot.length_mm)?;
    let mut mirrored = None;
    for registration in registered(&seen, straight, robot)? {
        let found: Vec<Option<PoseFit>> = poses.par_iter().map(|pose| fitted(&registration, pose)).collect();
        match Azimuth::new(&registration, poses, &found, readings, robot, options.delta_offset) {
            Ok(azimuth) => return Ok(tracked(poses, &registration, &found, &azimuth)),
            // Of registrations that are about as likely, the encoders decide.
            Err(TrackerError::Mirrored) => mirrored = Some(TrackerError::Mirrored),
            Err(error) => return Err(error),
        }
    }
    Err(mirrored.unwrap_or(TrackerError::Undetermined { sigma_deg: f64::INFINITY }))
}

fn tracked(
    poses: &[TrackerPose],
    registration: &Registration,
    found: &[Option<PoseFit>],
    azimuth: &Azimuth,
) -> TrackedPoses {
    let measure = |(pose, fit): (&TrackerPose, &Option<PoseFit>)| {
        let measurement = match fit {
            None => FrameMeasurement::failed(Status::TrackerLost, None),
            Some(fit) if fit.is_jump => FrameMeasurement::failed(Status::TrackerJump, None),
            Some(fit) => measurement(fit, azimuth),
        };
        (pose.index, pose.time_s, measurement)
    };
    let remarks = remarks(registration, azimuth, found);
    TrackedPoses { measurements: poses.iter().zip(found).map(measure).collect(), remarks }
}

/// The bend of one pose, in the registration's own azimuth, rad, and what is to be said of it.
struct PoseFit {
    bend: Vector2<f64>,
    covariance: Matrix2<f64>,
    /// Whether the pose lies off what a tip can reach by more than noise.
    is_jump: bool,
}

fn fitted(registration: &Registration, pose: &TrackerPose) -> Option<PoseFit> {
    let fit = registration.fit(pose, false, None)?;
    let covariance = registration.bend_covariance(&fit)?;
    let is_jump = is_improbable(fit.chi_square(), registration.degrees_of_freedom(pose));
    Some(PoseFit { bend: fit.bend, covariance, is_jump })
}

/// A bend turned into {b}; the azimuth's uncertainty turns all bends together.
fn measurement(fit: &PoseFit, azimuth: &Azimuth) -> FrameMeasurement {
    let turn = Rotation2::new(azimuth.angle);
    let vector = turn * fit.bend;
    let across = Vector2::new(-vector.y, vector.x) * azimuth.sigma;
    let covariance = turn * fit.covariance * turn.inverse() + across * across.transpose();
    // A pose has no edges. What all poses share of the registration's error is counted as their own.
    FrameMeasurement::of(Bend { vector, covariance, by_rig: Matrix2x6::zeros() }, Quality::default())
}

/// # Errors
/// Positions that look as if in metres, too far apart for the snake, or all in one place.
fn check_unit(seen: &[&TrackerPose], straight: &TrackerPose, length_mm: f64) -> Result<(), TrackerError> {
    let from_straight = |pose: &&TrackerPose| Some((pose.position_mm? - straight.position_mm?).norm());
    let mut distances: Vec<f64> = seen.iter().filter_map(from_straight).collect();
    let spread_mm = quantile(&mut distances, TRUSTED_SHARE);
    let plausible = LEAST_SHARE * length_mm..=MOST_LENGTHS * length_mm;
    match spread_mm {
        spread if plausible.contains(&spread) => Ok(()),
        spread if plausible.contains(&(1e3 * spread)) => Err(TrackerError::Metres { spread_mm, length_mm }),
        spread if spread > *plausible.end() => Err(TrackerError::TooFar { spread_mm, length_mm }),
        _ => Err(TrackerError::Still { spread_mm, length_mm }),
    }
}

/// The registrations that the poses leave, the most likely first.
///
/// # Errors
/// Poses that do not determine the base, or are none of such a snake.
fn registered(seen: &[&TrackerPose], straight: &TrackerPose, robot: &Robot) -> Result<Vec<Registration>, TrackerError> {
    let found = Registration::all(seen, straight, robot);
    let Some(best) = found.first() else { return Err(TrackerError::Undetermined { sigma_deg: f64::INFINITY }) };
    if !are_arcs(best, robot) {
        return Err(why_no_arcs(seen, straight, robot, best));
    }
    let sigma_deg = best.tilt_sigma().to_degrees();
    if sigma_deg > MOST_TILT_SIGMA_DEG { Err(TrackerError::Undetermined { sigma_deg }) } else { Ok(found) }
}

fn are_arcs(found: &Registration, robot: &Robot) -> bool {
    let (share, degrees) = MOST_SCATTER;
    found.sigma_mm < share * robot.length_mm && found.sigma_rad.to_degrees() < degrees
}

/// Whether it is a flipped axis by which orientations contradict positions.
fn why_no_arcs(seen: &[&TrackerPose], straight: &TrackerPose, robot: &Robot, found: &Registration) -> TrackerError {
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate().filter(|_| found.has_orientations) {
        let flip = |pose: &TrackerPose| {
            let mut pose = *pose;
            if let Some(position) = &mut pose.position_mm {
                position[axis] = -position[axis];
            }
            pose
        };
        let flipped: Vec<TrackerPose> = seen.iter().map(|pose| flip(pose)).collect();
        let others = Registration::all(&flipped.iter().collect::<Vec<_>>(), &flip(straight), robot);
        if others.first().is_some_and(|other| are_arcs(other, robot)) {
            return TrackerError::Flipped { axis: name };
        }
    }
    let scatter_deg = if found.has_orientations { found.sigma_rad.to_degrees() } else { 0.0 };
    TrackerError::NoArcs { scatter_mm: found.sigma_mm, scatter_deg, length_mm: robot.length_mm }
}

fn remarks(registration: &Registration, azimuth: &Azimuth, found: &[Option<PoseFit>]) -> Vec<String> {
    let orientation = match registration.has_orientations {
        true => format!(" and {:.2}°", registration.sigma_rad.to_degrees()),
        false => String::new(),
    };
    let mut remarks = vec![format!(
        "registered from {} poses: positions scatter by {:.3} mm{orientation} about the arcs, the base's axis is known to {:.2}°, its \
         azimuth ({}) to {:.2}°",
        found.iter().flatten().count(),
        registration.sigma_mm,
        registration.tilt_sigma().to_degrees(),
        azimuth.source,
        azimuth.sigma.to_degrees()
    )];
    let lost = found.iter().filter(|fit| fit.is_none()).count();
    let jumps = found.iter().flatten().filter(|fit| fit.is_jump).count();
    for (count, what) in
        [(lost, "have no position (tracker_lost)"), (jumps, "lie off what the tip can reach (tracker_jump)")]
    {
        if count > 0 {
            remarks.push(format!("{count} of {} poses {what} and are not measured", found.len()));
        }
    }
    remarks
}

#[cfg(test)]
mod tests;
