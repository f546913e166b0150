//! What a line of the journal says.

use crate::geometry::Configuration;
use crate::observation::{EncoderReading, Measured, Measurement, Quality, Shape};
use crate::robot::{Neighbours, PerBackbone};
use nalgebra::{Matrix2, Matrix2x6};
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

/// An entry as its line shows it; angles in degrees.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct Line {
    #[serde(skip_serializing_if = "Option::is_none")]
    event: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    index: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    time_s: Option<f64>,
    #[serde(skip_serializing_if = "String::is_empty")]
    status: String,
    /// θ, δ, σ_θ, σ_δ in degrees, and the correlation.
    #[serde(skip_serializing_if = "Option::is_none")]
    angles: Option<[f64; 5]>,
    /// Edges, inlier fraction, rms in px.
    #[serde(skip_serializing_if = "Option::is_none")]
    quality: Option<(usize, f64, f64)>,
    /// By how much base and grid were seen to have moved, px.
    #[serde(skip_serializing_if = "Option::is_none")]
    moved_px: Option<(Option<f64>, Option<f64>)>,
    /// The tip's tangent, the departure from a circle along and across the bend, each with its σ, in degrees; and χ².
    #[serde(skip_serializing_if = "Option::is_none")]
    shape: Option<[f64; 7]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    q_mm: Option<PerBackbone>,
    /// What neighbouring sections' encoders read, mm, of each.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    neighbours_mm: Vec<PerBackbone>,
    /// [`Measured::by_rig`], degrees, column by column.
    #[serde(skip_serializing_if = "Option::is_none")]
    by_rig: Option<[[f64; 2]; 6]>,
    /// [`Measured::fitted_covariance`], rad², so that it comes back as it was: xx, xy, yy.
    #[serde(skip_serializing_if = "Option::is_none")]
    bend_covariance_rad2: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    encoder_time_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    view: Option<String>,
}

impl From<&Entry> for Line {
    fn from(entry: &Entry) -> Self {
        let Entry::Measured(measurement, reading) = entry else {
            return Self { event: Some("reset".into()), ..Self::default() };
        };
        let angles = measurement.measured.map(|m| {
            let degrees = [m.configuration.theta, m.configuration.delta, m.sigma_theta, m.sigma_delta];
            let [theta, delta, sigma_theta, sigma_delta] = degrees.map(f64::to_degrees);
            [theta, delta, sigma_theta, sigma_delta, m.correlation]
        });
        let shape = measurement.quality.and_then(|quality| quality.shape).map(|s| {
            let radians = [s.tip_theta, s.sigma_tip_theta, s.along, s.sigma_along, s.across, s.sigma_across];
            let [tip, sigma_tip, along, sigma_along, across, sigma_across] = radians.map(f64::to_degrees);
            [tip, sigma_tip, along, sigma_along, across, sigma_across, s.chi2]
        });
        let by_rig = measurement.measured.map(|m| m.by_rig.data.0.map(|column| column.map(f64::to_degrees)));
        let covariance = measurement.measured.and_then(|m| m.fitted_covariance);
        Self {
            event: None,
            bend_covariance_rad2: covariance.map(|c| [c.m11, c.m12, c.m22]),
            by_rig: by_rig.filter(|by_rig| by_rig.as_flattened().iter().any(|value| *value != 0.0)),
            index: Some(measurement.index),
            time_s: measurement.time_s,
            status: measurement.status.to_string(),
            angles,
            quality: measurement.quality.map(|q| (q.edges, q.inlier_fraction, q.rms_px)),
            moved_px: measurement.quality.map(|q| (q.base_moved_px, q.grid_moved_px)),
            // JSON has no NaN; a line with one could not be read again.
            shape: shape.filter(|shape| shape.iter().all(|value| value.is_finite())),
            q_mm: reading.map(|reading| reading.q_mm),
            neighbours_mm: reading
                .map_or_else(Vec::new, |reading| reading.neighbours.q_mm[..reading.neighbours.count()].to_vec()),
            encoder_time_s: reading.map(|reading| reading.time_s),
            view: measurement.view.clone(),
        }
    }
}

impl Line {
    /// `None` for a line that is no entry of ours.
    pub fn entry(self) -> Option<Entry> {
        if let Some(event) = self.event {
            return (event == "reset").then_some(Entry::Reset);
        }
        let index = self.index?;
        let measured = self.angles.map(|[theta, delta, sigma_theta, sigma_delta, correlation]| {
            let configuration = Configuration::from_degrees(theta, delta);
            let (sigma_theta, sigma_delta) = (sigma_theta.to_radians(), sigma_delta.to_radians());
            let by_rig = Matrix2x6::from_fn(|row, k| self.by_rig.unwrap_or_default()[k][row].to_radians());
            let fitted_covariance = self.bend_covariance_rad2.map(|[xx, xy, yy]| Matrix2::new(xx, xy, xy, yy));
            Measured { configuration, sigma_theta, sigma_delta, correlation, fitted_covariance, by_rig }
        });
        let (base_moved_px, grid_moved_px) = self.moved_px.unwrap_or_default();
        let shape = self.shape.map(|[tip, sigma_tip, along, sigma_along, across, sigma_across, chi2]| Shape {
            tip_theta: tip.to_radians(),
            sigma_tip_theta: sigma_tip.to_radians(),
            along: along.to_radians(),
            sigma_along: sigma_along.to_radians(),
            across: across.to_radians(),
            sigma_across: sigma_across.to_radians(),
            chi2,
        });
        let measurement = Measurement {
            index,
            time_s: self.time_s,
            status: self.status.parse().unwrap_or_else(|never| match never {}),
            measured,
            quality: self.quality.map(|(edges, inlier_fraction, rms_px)| Quality {
                edges,
                inlier_fraction,
                rms_px,
                base_moved_px,
                grid_moved_px,
                shape,
                profile: None,
            }),
            view: self.view,
        };
        let mut neighbours = Neighbours::default();
        neighbours.q_mm.iter_mut().zip(&self.neighbours_mm).for_each(|(own, read)| *own = *read);
        let reading = self
            .q_mm
            .zip(self.encoder_time_s.or(self.time_s))
            .map(|(q_mm, time_s)| EncoderReading { neighbours, ..EncoderReading::new(index, time_s, q_mm) });
        Some(Entry::Measured(measurement, reading))
    }
}
