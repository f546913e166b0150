//! Which way the base's x axis points in a registration. Tip poses leave it open, since the snake bends alike to all sides. The
//! encoders tell: the bends that they mean, q̃ taken for q, are those of the tip up to a gain, turned by the azimuth. A rotation is
//! the least-squares fit over all poses; a reflection that fits better shows a frame that is not right-handed.
//!
//! Source: P. H. Schönemann, "A generalized solution of the orthogonal Procrustes problem", Psychometrika 31, 1966; in the plane the
//! two sums over complex numbers below.

use super::PoseFit;
use super::error::TrackerError;
use super::registration::Registration;
use crate::observation::{EncoderReading, TrackerPose};
use crate::robot::Robot;
use nalgebra::{Complex, Rotation2, Vector2, Vector3};
use std::collections::HashMap;

/// A reflection must fit this many times better than a rotation to be told.
///
/// Convention: the two sums differ by the ratio of noise to bends where the encoders are right; bends in one plane fit both alike.
const MIRRORED_RATIO: f64 = 2.0;
/// The azimuth that the encoders tell must be known better than this, rad.
///
/// Convention: 10°; worse than that they do not move.
const MOST_SIGMA: f64 = 0.17;
/// The tracker's x axis must be at least this far from the snake's, as a sine.
///
/// Convention: 17°.
const LEAST_SINE: f64 = 0.3;

/// By how much bends of a registration are to be turned into {b}.
#[derive(Debug, Clone, Copy)]
pub struct Azimuth {
    /// rad.
    pub angle: f64,
    /// Standard deviation, rad; 0 where it was stated.
    pub sigma: f64,
    /// Where it comes from, in words.
    pub source: &'static str,
}

impl Azimuth {
    /// # Errors
    /// [`TrackerError`] where nothing tells, or the encoders say that an axis is flipped.
    pub fn new(
        registration: &Registration,
        poses: &[TrackerPose],
        found: &[Option<PoseFit>],
        readings: &[EncoderReading],
        robot: &Robot,
        stated: Option<f64>,
    ) -> Result<Self, TrackerError> {
        if let Some(delta_offset) = stated {
            let axis = registration.tracker_from_base.rotation.inverse() * Vector3::x();
            if axis.xy().norm() < LEAST_SINE {
                return Err(TrackerError::AxisAlongSnake);
            }
            return Ok(Self { angle: delta_offset - axis.y.atan2(axis.x), sigma: 0.0, source: "as stated" });
        }
        let by_index: HashMap<u64, &EncoderReading> = readings.iter().map(|reading| (reading.index, reading)).collect();
        let pairs: Vec<(Vector2<f64>, Vector2<f64>)> = poses
            .iter()
            .zip(found)
            .filter_map(|(pose, fit)| {
                let fit = fit.as_ref().filter(|fit| !fit.is_jump)?;
                let reading = by_index.get(&pose.index).filter(|r| r.q_mm.len() == robot.backbone_count())?;
                Some((fit.bend, robot.bend_by_displacement().tr_mul(&reading.q_mm)))
            })
            .filter(|(_, meant)| meant.iter().all(|value| value.is_finite()))
            .collect();
        Self::from_encoders(&pairs)
    }

    /// From bends of the tip and those that the encoders mean.
    fn from_encoders(pairs: &[(Vector2<f64>, Vector2<f64>)]) -> Result<Self, TrackerError> {
        let complex = |bend: &Vector2<f64>| Complex::new(bend.x, bend.y);
        let rotation: Complex<f64> = pairs.iter().map(|(seen, meant)| complex(meant) * complex(seen).conj()).sum();
        let reflection: Complex<f64> = pairs.iter().map(|(seen, meant)| complex(meant) * complex(seen)).sum();
        if reflection.norm() > MIRRORED_RATIO * rotation.norm() {
            return Err(TrackerError::Mirrored);
        }
        let angle = rotation.arg();
        let square: f64 = pairs.iter().map(|(seen, _)| seen.norm_squared()).sum();
        let gain = rotation.norm() / square;
        // What is left across the bend, as an angle's share of it.
        let across = |(seen, meant): &(Vector2<f64>, Vector2<f64>)| {
            (meant / gain).perp(&(Rotation2::new(angle) * seen)).powi(2) / seen.norm_squared().max(f64::MIN_POSITIVE)
        };
        let variance = pairs.iter().map(across).sum::<f64>() / (pairs.len() as f64 - 1.0) / square;
        let sigma = variance.sqrt();
        // Also where it is not a number.
        if sigma < MOST_SIGMA {
            Ok(Self { angle, sigma, source: "from the encoders" })
        } else {
            Err(TrackerError::NoAzimuth)
        }
    }
}
