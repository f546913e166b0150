//! What of a measurement can be used, and the reasons why one is not.

use crate::observation::{EncoderReading, Measured, Measurement, Status};
use crate::robot::{MAX_THETA, PerBackbone};
use std::fmt;

/// No snake's encoders read more, mm.
///
/// Convention: a metre; a reading beyond it is a slip of units or a broken file.
const MOST_Q_MM: f64 = 1e3;

/// Why a measurement was not used. Displays as a snake_case word.
#[derive(Debug, Clone, PartialEq)]
pub enum Reason {
    /// The frame could not be measured.
    NotMeasured(Status),
    /// There is no encoder reading of this index.
    NoEncoderReading,
    /// The reading is that of a robot with more or fewer backbones.
    OtherBackbones,
    /// An angle, a sigma or an encoder value is not a finite number, or a sigma is negative.
    NotFinite,
    /// θ lies below 0 or beyond [`MAX_THETA`], or a q̃ beyond a metre.
    OutsideWorkspace,
    /// θ or δ do not fit the encoders; by so many (scaled) standard deviations.
    BendOutlier(f64),
    /// The encoders' common part, which no bend changes, does not fit; by so many (scaled) standard deviations.
    CommonOutlier(f64),
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotMeasured(status) => write!(f, "{status}"),
            Self::NoEncoderReading => f.write_str("no_encoder_reading"),
            Self::OtherBackbones => f.write_str("other_backbones"),
            Self::NotFinite => f.write_str("not_finite"),
            Self::OutsideWorkspace => f.write_str("outside_workspace"),
            Self::BendOutlier(_) => f.write_str("bend_outlier"),
            Self::CommonOutlier(_) => f.write_str("common_outlier"),
        }
    }
}

/// What a measurement and its reading hold, on a robot of so many backbones, if all of it can be used.
pub(crate) fn usable(
    backbones: usize,
    measurement: &Measurement,
    reading: Option<&EncoderReading>,
) -> std::result::Result<(Measured, PerBackbone), Reason> {
    let measured = match (&measurement.status, &measurement.measured) {
        (Status::Ok, Some(measured)) => *measured,
        (status, _) => return Err(Reason::NotMeasured(status.clone())),
    };
    let reading = reading.filter(|reading| reading.index == measurement.index).ok_or(Reason::NoEncoderReading)?;
    if reading.q_mm.len() != backbones {
        return Err(Reason::OtherBackbones);
    }
    let Measured { configuration, sigma_theta, sigma_delta, correlation, .. } = measured;
    let finite = [configuration.theta, configuration.delta, correlation]
        .iter()
        .chain(reading.q_mm.iter())
        .all(|value| value.is_finite());
    // A wholly unknown δ may have an infinite sigma; θ may not.
    if !(finite && sigma_theta.is_finite() && sigma_theta >= 0.0 && sigma_delta >= 0.0 && correlation.abs() <= 1.0) {
        return Err(Reason::NotFinite);
    }
    if !(0.0..=MAX_THETA).contains(&configuration.theta) || reading.q_mm.amax() > MOST_Q_MM {
        return Err(Reason::OutsideWorkspace);
    }
    Ok((measured, reading.q_mm))
}
