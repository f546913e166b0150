//! The measurement of one frame: the bend vector with its covariance, and the same as θ and δ.

use crate::observation::{Measured, Measurement, Quality, Status};
use nalgebra::{Matrix2, Matrix2x6, Vector2};

/// What one frame says.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameMeasurement {
    /// The verdict; anything but [`Status::Ok`] comes without angles.
    pub status: Status,
    /// The angles.
    pub measured: Option<Measured>,
    /// The same as a bend vector, which stays Gaussian near straight, for [`fused`](super::fused).
    pub bend: Option<Bend>,
    /// How good the fit was, where there was one.
    pub quality: Option<Quality>,
}

/// A bend vector θ (cos δ, sin δ) and its covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bend {
    /// rad.
    pub vector: Vector2<f64>,
    /// rad².
    pub covariance: Matrix2<f64>,
    /// The part of the error that the rig's other frames share, see [`Measured::by_rig`].
    pub by_rig: Matrix2x6<f64>,
}

impl FrameMeasurement {
    /// The measurement of a snake with this bend.
    pub(super) fn of(bend: Bend, quality: Quality) -> Self {
        let measured = Measured { by_rig: bend.by_rig, ..Measured::of_bend(bend.vector, &bend.covariance) };
        Self { status: Status::Ok, measured: Some(measured), bend: Some(bend), quality: Some(quality) }
    }

    /// Its row of measurements.csv: the frame of this index and time, of a view where there are several.
    pub fn row(self, index: u64, time_s: Option<f64>, view: Option<String>) -> Measurement {
        Measurement { index, time_s, status: self.status, measured: self.measured, quality: self.quality, view }
    }

    /// A frame that could not be measured, and why.
    pub(super) fn failed(status: Status, quality: Option<Quality>) -> Self {
        Self { status, measured: None, bend: None, quality }
    }
}

impl From<Measured> for FrameMeasurement {
    /// A measurement that comes from elsewhere, such as a tracker, of which nothing but angles and errors is known.
    fn from(measured: Measured) -> Self {
        let Measured { configuration, by_rig, .. } = measured;
        let covariance = measured.bend_covariance(configuration);
        let bend = Bend { vector: configuration.bend_vector(), covariance, by_rig };
        Self { status: Status::Ok, measured: Some(measured), bend: Some(bend), quality: Some(Quality::default()) }
    }
}
