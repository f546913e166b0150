//! The bends that were seen, each with the reading that a wiring gives it.

use super::hypotheses::Candidate;
use super::likelihood::{Fit, Freedom, Point};
use crate::observation::{EncoderReading, Measured};
use crate::robot::{PerBackbone, Robot};
use crate::statistics::moments::{mean, standard_deviation};
use crate::statistics::order::{mad_scale, median};
use crate::verdict::rules::NORMAL_QUANTILE;
use nalgebra::{Matrix2, Vector2};
use std::collections::{BTreeMap, BTreeSet};

/// One frame's bend.
#[derive(Debug, Clone)]
pub(in crate::verdict) struct Pose {
    /// The frame's index.
    pub index: u64,
    /// Its view, where it is named.
    pub view: Option<String>,
    /// θ and δ.
    pub measured: Measured,
}

/// A bend with what is known beside it.
#[derive(Debug, Clone)]
struct Sample {
    index: u64,
    view: Option<String>,
    seen: Vector2<f64>,
    whitener: Matrix2<f64>,
    /// The log's row at the frame's index, with the candidate's shift of 0.
    row: Option<PerBackbone>,
}

/// Bends and a log.
#[derive(Debug, Clone)]
pub(super) struct Samples<'a> {
    bend_by_displacement: PerBackbone<Vector2<f64>>,
    /// What bends nothing: the common part first, then what alternates along the circle; orthonormal.
    internal: Vec<PerBackbone>,
    log: BTreeMap<u64, &'a EncoderReading>,
    samples: Vec<Sample>,
}

impl<'a> Samples<'a> {
    /// Of the bends whose sigmas and angles are finite.
    pub fn new(robot: &Robot, sd_encoder_mm: f64, poses: &[Pose], log: &'a [EncoderReading]) -> Self {
        let bend_by_displacement = robot.bend_by_displacement();
        // Of Q⁺: its rows are orthogonal and equally long.
        let by_encoders = bend_by_displacement.cross_gram(&bend_by_displacement) * sd_encoder_mm.powi(2);
        let log: BTreeMap<u64, &EncoderReading> = log
            .iter()
            .filter(|row| row.q_mm.len() == robot.backbone_count() && row.q_mm.iter().all(|q| q.is_finite()))
            .map(|row| (row.index, row))
            .collect();
        let sample = |pose: &Pose| {
            let covariance = pose.measured.bend_covariance(pose.measured.configuration) + by_encoders;
            let whitener = covariance.cholesky()?.l().try_inverse()?;
            let seen = pose.measured.configuration.bend_vector();
            let row = log.get(&pose.index).map(|row| row.q_mm);
            let finite = seen.iter().chain(whitener.iter()).all(|value| value.is_finite());
            finite.then(|| Sample { index: pose.index, view: pose.view.clone(), seen, whitener, row })
        };
        let samples = poses.iter().filter_map(sample).collect();
        Self { bend_by_displacement, internal: robot.internal_parts().collect(), log, samples }
    }

    pub fn backbones(&self) -> usize {
        self.bend_by_displacement.len()
    }

    pub fn len(&self) -> usize {
        self.samples.iter().filter(|sample| sample.row.is_some()).count()
    }

    /// Whether the readings' common part is above zero, where play and static friction put it: one-sided t-test of its mean.
    pub fn common_part_is_positive(&self) -> bool {
        let common: Vec<f64> = self.samples.iter().filter_map(|sample| Some(sample.row?.mean())).collect();
        let sd_of_mean = standard_deviation(&common) / (common.len() as f64).sqrt();
        mean(common) > NORMAL_QUANTILE * sd_of_mean
    }

    /// The fit under a candidate, of the samples that have a reading then.
    pub fn fit(&self, candidate: &Candidate, freedom: Freedom) -> Option<Fit> {
        let point = |(sample, row): (&Sample, PerBackbone)| {
            let implied = self.bend_by_displacement.tr_mul(&row);
            Point { seen: sample.seen, whitener: sample.whitener, implied }
        };
        let points: Vec<Point> = self.rows(candidate).map(point).collect();
        Fit::of(&points, freedom)
    }

    /// Spread of the readings' internal part under a candidate, mm: of the common part about its median, and of the others about zero, where
    /// they are unless the backbones press against each other.
    pub fn internal_spread_mm(&self, candidate: &Candidate) -> f64 {
        let rows: Vec<PerBackbone> = self.rows(candidate).map(|(_, row)| row).collect();
        let spread = |(k, part): (usize, &PerBackbone)| {
            let mut values: Vec<f64> = rows.iter().map(|row| part.dot(row)).collect();
            let centre = if k == 0 { median(&mut values) } else { 0.0 };
            mad_scale(values.iter().map(|value| value - centre)).powi(2)
        };
        self.internal.iter().enumerate().map(spread).sum::<f64>().sqrt()
    }

    /// The samples that have a reading under a candidate, with it.
    fn rows(&self, candidate: &Candidate) -> impl Iterator<Item = (&Sample, PerBackbone)> {
        self.samples.iter().filter_map(|sample| {
            let row = match candidate.shift {
                0 => sample.row?,
                shift => self.row_at(sample.index, shift)?,
            };
            let wired = |i: usize| f64::from(candidate.signs[i]) * row[candidate.columns[i] - 1];
            Some((sample, PerBackbone::from_fn(row.len(), wired)))
        })
    }

    fn row_at(&self, index: u64, shift: i64) -> Option<PerBackbone> {
        Some(self.log.get(&index.checked_add_signed(shift)?)?.q_mm)
    }

    fn retained(&self, keep: impl Fn(&Sample) -> bool) -> Self {
        let samples = self.samples.iter().filter(|sample| keep(sample)).cloned().collect();
        Self { samples, ..self.clone() }
    }

    /// Those that have a reading as the log stands and one so many rows on.
    pub fn with_readings_at_both(&self, shift: i64) -> Self {
        self.retained(|sample| sample.row.is_some() && self.row_at(sample.index, shift).is_some())
    }

    /// The names of the views.
    pub fn views(&self) -> Vec<Option<String>> {
        let names: BTreeSet<&Option<String>> = self.samples.iter().map(|sample| &sample.view).collect();
        names.into_iter().cloned().collect()
    }

    /// Those of one view.
    pub fn of_view(&self, view: &Option<String>) -> Self {
        self.retained(|sample| sample.view == *view)
    }

    /// With δ running the other way round.
    pub fn mirrored(&self) -> Self {
        let mirror = Matrix2::new(1.0, 0.0, 0.0, -1.0);
        let samples = self.samples.iter().cloned();
        let samples = samples.map(|s| Sample { seen: mirror * s.seen, whitener: s.whitener * mirror, ..s }).collect();
        Self { samples, ..self.clone() }
    }

    /// The median time between rows of the log, s; `None` where its times do not increase.
    pub fn interval_s(&self) -> Option<f64> {
        let times: Vec<f64> = self.log.values().map(|row| row.time_s).collect();
        let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let increasing = !steps.is_empty() && steps.iter().all(|step| step.is_finite() && *step > 0.0);
        increasing.then(|| median(&mut steps))
    }

    /// Those that the log covers at a time later by `age_s` than the frame's own row: as they are, and with the readings of then.
    pub fn at_times_later_by(&self, age_s: f64) -> Option<(Self, Self)> {
        let rows: Vec<&EncoderReading> = self.log.values().copied().collect();
        let at = |time_s: f64| {
            let after = rows.partition_point(|row| row.time_s < time_s);
            let (a, b) = (rows.get(after.checked_sub(1)?)?, rows.get(after)?);
            let share = (time_s - a.time_s) / (b.time_s - a.time_s);
            Some(a.q_mm + (b.q_mm - a.q_mm) * share)
        };
        let later = |sample: &Sample| {
            let own = self.log.get(&sample.index)?;
            at(own.time_s + age_s)
        };
        let common = self.retained(|sample| sample.row.is_some() && later(sample).is_some());
        let samples = common.samples.iter().cloned().map(|s| Sample { row: later(&s), ..s }).collect();
        let shifted = Self { samples, ..self.clone() };
        (common.len() > 0).then_some((common, shifted))
    }
}
