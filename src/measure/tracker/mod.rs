//! Tip poses of an electromagnetic or optical tracker to θ and δ, with their covariance, in place of pictures.
//!
//! 1. [`registration`]: where the snake's base is in the tracker's frame, and where the sensor is on the tip, by least squares over the
//!    straight pose and the sweep itself.
//! 2. [`azimuth`]: which way x_b points, which no tip pose tells: from the encoders, or stated.
//! 3. Here: every pose is fitted by itself, what the registration leaves open is added and kept apart, since all poses share it
//!    ([`shared`]), and poses that do not lie on the surface that a tip can reach are told apart.

mod azimuth;
mod error;
mod registration;
mod shared;

pub use error::TrackerError;

use super::measurement::{Bend, FrameMeasurement};
use crate::observation::{EncoderReading, Quality, Status, TrackerPose};
use crate::robot::Robot;
use crate::statistics::order::quantile;
use azimuth::Azimuth;
use nalgebra::{Matrix2, Point3, Rotation2, SMatrix, Vector2};
use rayon::prelude::*;
use registration::{RIG, Registration, Role, is_improbable};
use shared::SharedErrors;
use std::collections::HashMap;

/// The fewest poses of a tip that are registered.
///
/// Convention: each position leaves one number for the eight of the registration; this is twice as many.
const LEAST_POSES: usize = 16;
/// A tip that moves by less than this share of the snake's length does not tell where its base is.
///
/// Derived: a bend of θ moves the tip by about L θ/2; 2 % is 2.3°.
const LEAST_SHARE: f64 = 0.02;
/// No tip is farther from where it is when straight than this many lengths of the snake, or distances of the sensor from a stated base.
///
/// Derived: the tip of an arc bent by 120° is 1.1 L away; twice that leaves room for a sensor on a tool.
const MOST_LENGTHS: f64 = 2.2;
/// How far a straight tip may be from a base that is stated, in lengths of the snake.
///
/// Convention: a sensor a little below the tip, or on a tool three times as long as the snake.
const STATED_LENGTHS: std::ops::RangeInclusive<f64> = 0.8..=4.0;
/// From which share of θ on what all bends have in common is told with a remedy.
///
/// Convention: η errs by as much; 2 % of it is what the paper's twelve samples leave.
const MUCH_IN_COMMON: f64 = 0.02;
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

/// An axis is named as flipped where turning it round leaves less than this share of the scatter, of positions times orientations.
///
/// Convention: what is right scatters by noise, what is wrong by a good part of the snake's length.
const FLIPPED_SHARE: f64 = 0.2;

/// How a tracker's poses are to be read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackerOptions {
    /// Index of the pose in which the snake is unbent.
    pub straight: u64,
    /// Azimuth in {b} of the tracker's x axis, rad; where it is not stated the encoders tell.
    pub delta_offset: Option<f64>,
    /// Where the base is stated to be in the tracker's frame, mm.
    pub base_mm: Option<Point3<f64>>,
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
    let poses = &without_frozen(poses, readings, robot)[..];
    let seen: Vec<&TrackerPose> = poses.iter().filter(|pose| pose.position_mm.is_some()).collect();
    if seen.len() < LEAST_POSES {
        return Err(TrackerError::TooFew { found: seen.len(), needed: LEAST_POSES });
    }
    let straight = seen.iter().find(|pose| pose.index == options.straight);
    let straight = straight.ok_or(TrackerError::NoStraight { index: options.straight })?;
    let reach_mm = reach_mm(straight, robot, options.base_mm)?;
    check_unit(&seen, straight, reach_mm)?;
    // What no tip can reach has no say in where the base is: one such value among a hundred may turn it over.
    let seen: Vec<&TrackerPose> =
        seen.iter().copied().filter(|pose| distance_mm(pose, straight) <= Some(MOST_LENGTHS * reach_mm)).collect();
    let mut mirrored = None;
    for registration in registered(&seen, straight, robot, options.base_mm)? {
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
    let good: Vec<&PoseFit> = found.iter().flatten().filter(|fit| !fit.is_jump).collect();
    let shared = SharedErrors::of(&good, azimuth);
    let measure = |(pose, fit): (&TrackerPose, &Option<PoseFit>)| {
        let measurement = match fit {
            None => FrameMeasurement::failed(Status::TrackerLost, None),
            Some(fit) if fit.is_jump => FrameMeasurement::failed(Status::TrackerJump, None),
            Some(fit) => measurement(fit, azimuth, &shared),
        };
        (pose.index, pose.time_s, measurement)
    };
    let mut remarks = remarks(registration, azimuth, found);
    remarks.extend(in_common(registration, &good, shared.share_of_theta(&good)));
    TrackedPoses { measurements: poses.iter().zip(found).map(measure).collect(), remarks }
}

/// The bend of one pose, in the registration's own azimuth, rad, and what is to be said of it.
struct PoseFit {
    bend: Vector2<f64>,
    /// Of its own noise.
    covariance: Matrix2<f64>,
    /// What independent unit errors of the registration do to the bend.
    by_registration: SMatrix<f64, 2, RIG>,
    /// Whether the pose lies off what a tip can reach by more than noise.
    is_jump: bool,
}

fn fitted(registration: &Registration, pose: &TrackerPose) -> Option<PoseFit> {
    let fit = registration.fit(pose, Role::Alone, None)?;
    let (covariance, by_registration) = registration.errors(&fit)?;
    let is_jump = is_improbable(fit.chi_square(), registration.degrees_of_freedom(pose));
    Some(PoseFit { bend: fit.bend, covariance, by_registration, is_jump })
}

/// A bend turned into {b}.
fn measurement(fit: &PoseFit, azimuth: &Azimuth, shared: &SharedErrors) -> FrameMeasurement {
    let turn = Rotation2::new(azimuth.angle);
    let errors = shared.errors(fit);
    let covariance = turn * (fit.covariance + errors * errors.transpose()) * turn.inverse();
    let by_rig = turn * shared.foremost(fit);
    // A pose has no edges.
    FrameMeasurement::of(Bend { vector: turn * fit.bend, covariance, by_rig }, Quality::default())
}

/// How far the sensor is from the base when the snake is straight, mm.
///
/// # Errors
/// A stated base that is not at the other end of the snake.
fn reach_mm(straight: &TrackerPose, robot: &Robot, base_mm: Option<Point3<f64>>) -> Result<f64, TrackerError> {
    let Some((base_mm, tip_mm)) = base_mm.zip(straight.position_mm) else { return Ok(robot.length_mm) };
    let (found_mm, length_mm) = ((tip_mm - base_mm).norm(), robot.length_mm);
    if STATED_LENGTHS.contains(&(found_mm / length_mm)) {
        Ok(found_mm)
    } else {
        Err(TrackerError::BaseElsewhere { found_mm, length_mm })
    }
}

/// How far apart two poses are, mm.
fn distance_mm(one: &TrackerPose, other: &TrackerPose) -> Option<f64> {
    Some((one.position_mm? - other.position_mm?).norm())
}

/// The poses, those without a position that repeat the one before to the last digit while the encoders move the tip by more than is told from a
/// tip at rest: a tracker that lost its sensor may go on sending the last pose.
fn without_frozen(poses: &[TrackerPose], readings: &[EncoderReading], robot: &Robot) -> Vec<TrackerPose> {
    let by_index: HashMap<u64, &EncoderReading> = readings.iter().map(|reading| (reading.index, reading)).collect();
    let meant = |pose: &TrackerPose| {
        let reading = by_index.get(&pose.index).filter(|reading| reading.q_mm.len() == robot.backbone_count())?;
        Some(robot.bend_by_displacement().tr_mul(&reading.q_mm))
    };
    let place = |pose: &TrackerPose| (pose.position_mm, pose.orientation);
    let mut poses = poses.to_vec();
    for alike in poses.chunk_by_mut(|one, other| one.position_mm.is_some() && place(one) == place(other)) {
        let Some(first) = meant(&alike[0]) else { continue };
        // A bend of θ moves the tip by about L θ/2.
        let moved = |pose: &TrackerPose| meant(pose).is_some_and(|bend| (bend - first).norm() > 2.0 * LEAST_SHARE);
        if alike.iter().any(moved) {
            alike[1..].iter_mut().for_each(|pose| (pose.position_mm, pose.orientation) = (None, None));
        }
    }
    poses
}

/// # Errors
/// Positions that look as if in metres, too far apart for the snake, or all in one place.
fn check_unit(seen: &[&TrackerPose], straight: &TrackerPose, length_mm: f64) -> Result<(), TrackerError> {
    let mut distances: Vec<f64> = seen.iter().filter_map(|pose| distance_mm(pose, straight)).collect();
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
fn registered(
    seen: &[&TrackerPose],
    straight: &TrackerPose,
    robot: &Robot,
    base_mm: Option<Point3<f64>>,
) -> Result<Vec<Registration>, TrackerError> {
    let found = Registration::all(seen, straight, robot, base_mm);
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
        let others = Registration::all(&flipped.iter().collect::<Vec<_>>(), &flip(straight), robot, None);
        // What positions gain, orientations must not lose: quaternions in another order leave positions of their own on a flipped axis.
        let scatter = |of: &Registration| of.sigma_mm * of.sigma_rad;
        let is_better = |other: &Registration| scatter(other) < FLIPPED_SHARE * scatter(found);
        if others.first().is_some_and(|other| are_arcs(other, robot) && is_better(other)) {
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
    for (count, what) in [
        (lost, "have no position, or repeat the last one while the encoders move (tracker_lost)"),
        (jumps, "lie off what the tip can reach (tracker_jump)"),
    ] {
        if count > 0 {
            remarks.push(format!("{count} of {} poses {what} and are not measured", found.len()));
        }
    }
    remarks
}

/// What the poses leave open of all bends together, and what would settle it.
fn in_common(registration: &Registration, good: &[&PoseFit], share: f64) -> Vec<String> {
    let most = good.iter().map(|fit| fit.bend.norm()).fold(0.0, f64::max);
    let (lost, sigma) = (registration.shortening, registration.sigma_of_shortening());
    let mut said = Vec::new();
    if lost.abs() > 3.0 * sigma {
        said.push(format!(
            "the snake loses {:.1} ± {:.1} % of its length at {:.0}°",
            100.0 * lost * most,
            100.0 * sigma * most,
            most.to_degrees()
        ));
    }
    if share > MUCH_IN_COMMON {
        let remedy = match (registration.has_orientations, registration.base_is_stated()) {
            (false, false) => {
                "; give orientations (qw,qx,qy,qz), or base_mm, where a pointer of the tracker touches the middle of the base"
            }
            (false, true) => "; give orientations (qw,qx,qy,qz)",
            (true, _) => "; bend the snake further and to several sides",
        };
        said.push(format!("all θ may be off by the same {:.1} % (1σ), and η with them{remedy}", 100.0 * share));
    }
    said
}

#[cfg(test)]
mod tests;
