//! What a line of the journal says.

use crate::observation::{EncoderReading, Measurement};
use crate::record::MeasurementRow;
use crate::robot::{Neighbours, PerBackbone};
use nalgebra::Matrix2;
use serde::{Deserialize, Serialize};

/// One line of the journal.
// Entries are written and read one at a time, so that their size costs nothing.
#[allow(clippy::large_enum_variant)]
#[derive(Debug, Clone, PartialEq)]
pub enum Entry {
    /// A frame's measurement, with the encoders' reading of that moment where there is one.
    Measured(Measurement, Option<EncoderReading>),
    /// The estimator was told to begin anew.
    Reset,
}

/// An entry as its line shows it.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct Line {
    #[serde(skip_serializing_if = "Option::is_none")]
    event: Option<String>,
    /// The columns of measurements.csv, to the last digit.
    #[serde(flatten)]
    row: Option<MeasurementRow>,
    /// [`Measured::fitted_covariance`](crate::observation::Measured::fitted_covariance), rad², so that it comes back as it was: xx, xy, yy.
    #[serde(skip_serializing_if = "Option::is_none")]
    bend_covariance_rad2: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    q_mm: Option<PerBackbone>,
    /// What neighbouring sections' encoders read, mm, of each.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    neighbours_mm: Vec<PerBackbone>,
    #[serde(skip_serializing_if = "Option::is_none")]
    encoder_time_s: Option<f64>,
}

impl From<&Entry> for Line {
    fn from(entry: &Entry) -> Self {
        let Entry::Measured(measurement, reading) = entry else {
            return Self { event: Some("reset".into()), ..Self::default() };
        };
        let covariance = measurement.measured.and_then(|measured| measured.fitted_covariance);
        let neighbours = reading.map(|reading| reading.neighbours).unwrap_or_default();
        Self {
            event: None,
            row: Some(measurement.into()),
            bend_covariance_rad2: covariance.map(|c| [c.m11, c.m12, c.m22]),
            q_mm: reading.map(|reading| reading.q_mm),
            neighbours_mm: neighbours.q_mm[..neighbours.count()].to_vec(),
            encoder_time_s: reading.map(|reading| reading.time_s),
        }
    }
}

impl Line {
    /// `None` for a line that is no entry of ours.
    pub fn entry(self) -> Option<Entry> {
        if let Some(event) = self.event {
            return (event == "reset").then_some(Entry::Reset);
        }
        let mut measurement = Measurement::try_from(self.row?).ok()?;
        if let (Some(measured), Some([xx, xy, yy])) = (&mut measurement.measured, self.bend_covariance_rad2) {
            measured.fitted_covariance = Some(Matrix2::new(xx, xy, xy, yy));
        }
        let mut neighbours = Neighbours::default();
        neighbours.q_mm.iter_mut().zip(&self.neighbours_mm).for_each(|(own, read)| *own = *read);
        let (index, time_s) = (measurement.index, self.encoder_time_s.or(measurement.time_s));
        let reading = self.q_mm.zip(time_s);
        let reading =
            reading.map(|(q_mm, time_s)| EncoderReading { neighbours, ..EncoderReading::new(index, time_s, q_mm) });
        Some(Entry::Measured(measurement, reading))
    }
}
