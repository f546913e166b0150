//! What a verdict is passed on, collected in one pass over the measurements.

use super::health::Health;
use super::reason::{Reason, Verdict};
use super::rules;
use super::wiring::Pose;
use crate::estimate::{self, MOST_JUDGED, PlainSample, Replaced, pairs_without_effects, usable};
use crate::observation::{EncoderReading, Measurement, Status, Wiring};
use crate::robot::Model;
use crate::statistics::spread::Spread;
use std::collections::BTreeMap;

/// Bends that the wiring check looks at. Convention: a resource limit; every hypothesis is fitted to all of them.
const MOST_POSES: usize = 300;

/// What is to be judged, besides the data.
#[derive(Debug, Clone)]
pub struct Subject<'a> {
    /// The model.
    pub model: &'a Model,
    /// Standard deviation of an encoder reading, mm, as it is assumed; more is learned from the readings' common part.
    pub sd_encoder_mm: f64,
    /// How the log was read.
    pub wiring: Wiring,
    /// The views' azimuths, where they are known.
    pub views: Vec<ViewOffset>,
    /// How many measurements the estimator used and rejected, where there was one.
    pub used_and_rejected: Option<(usize, usize)>,
    /// Set if one gain replaces the recursive estimate, with the reason.
    pub replaced: Option<Replaced>,
}

impl<'a> Subject<'a> {
    /// A model, with readings as they stand in the log and nothing known of views and estimator.
    pub fn new(model: &'a Model, sd_encoder_mm: f64) -> Self {
        let wiring = Wiring::straight(model.robot.backbone_count());
        Self { model, sd_encoder_mm, wiring, views: Vec::new(), used_and_rejected: None, replaced: None }
    }

    /// Passes the verdict on measurements and the log's readings.
    pub fn verdict(&self, measurements: &[Measurement], log: &[EncoderReading]) -> Verdict {
        rules::verdict(self, &Evidence::collect(self.model, measurements, log), log)
    }

    /// Whether the model misses the bends of samples by more than noise, as the verdict judges it; red where it then is no better than none.
    pub fn missed_bends(&self, samples: &[PlainSample]) -> Option<Reason> {
        Health::of(self.model, self.sd_encoder_mm, samples).missed_bends()
    }

    /// What the model leaves of the measurements.
    pub(super) fn health(&self, measurements: &[Measurement], log: &[EncoderReading]) -> Health {
        let evidence = Evidence::collect(self.model, measurements, log);
        Health::of(self.model, self.sd_encoder_mm, &evidence.samples)
    }

    /// What keeps physics from being named of these data, where something does: encoders that stand still, or a log that is wired
    /// otherwise than it is read.
    pub fn wiring_mistake(&self, measurements: &[Measurement], log: &[EncoderReading]) -> Option<Reason> {
        rules::wiring_mistake(self, &Evidence::collect(self.model, measurements, log), log)
    }
}

/// A view and the azimuth that its experiment gives it.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewOffset {
    /// Its name.
    pub name: String,
    /// Its `delta_offset_deg`.
    pub delta_offset_deg: f64,
}

/// Measured frames whose reading is missing or leads nowhere.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Gap {
    pub frames: usize,
    /// The first one's index, and the last one's.
    pub from: u64,
    pub to: u64,
}

impl Gap {
    /// With another frame at its end.
    fn and(self, index: u64) -> Self {
        Self { frames: self.frames + 1, from: if self.frames == 0 { index } else { self.from }, to: index }
    }
}

/// What was collected.
#[derive(Debug, Clone)]
pub struct Evidence {
    /// All rows.
    pub(super) frames: usize,
    /// By status.
    pub(super) statuses: BTreeMap<String, usize>,
    /// Rows with angles.
    pub(super) measured: usize,
    /// Those of them that have a reading.
    pub(super) with_reading: usize,
    /// The frames whose reading leads to no bend of the robot, as many as there are, and the first one's index.
    pub(super) nowhere: Gap,
    /// The most measured frames in a row that have none.
    pub(super) gap: Gap,
    /// Bends as they were measured, spread over the run.
    pub(super) poses: Vec<Pose>,
    /// Measurements with readings, without the model's effects, spread over the run.
    pub(super) samples: Vec<PlainSample>,
}

impl Evidence {
    /// Goes once through the measurements.
    fn collect(model: &Model, measurements: &[Measurement], log: &[EncoderReading]) -> Self {
        let (mut measured, mut with_reading, mut statuses) = (0, 0, BTreeMap::new());
        let (mut gap, mut longest, mut nowhere) = (Gap::default(), Gap::default(), Gap::default());
        let (mut poses, mut samples) = (Spread::new(MOST_POSES), Spread::new(MOST_JUDGED));
        let backbones = model.robot.backbone_count();
        for (as_seen, (measurement, reading)) in
            measurements.iter().zip(pairs_without_effects(model, measurements, log))
        {
            let index = as_seen.index;
            *statuses.entry(as_seen.status.to_string()).or_insert(0usize) += 1;
            if let (Status::Ok, Some(angles)) = (&as_seen.status, as_seen.measured) {
                measured += 1;
                poses.add(Pose { index, view: as_seen.view.clone(), measured: angles });
                gap = if reading.is_none() { gap.and(index) } else { Gap::default() };
                longest = if gap.frames > longest.frames { gap } else { longest };
            }
            match usable(backbones, &measurement, reading.as_ref()) {
                Ok((measured, q_mm)) => {
                    with_reading += 1;
                    let time_s = reading.map_or(f64::NAN, |reading| reading.time_s);
                    samples.add(PlainSample { index, time_s, measured, q_mm });
                }
                Err(estimate::Reason::OutsideWorkspace) => nowhere = nowhere.and(index),
                Err(_) => {}
            }
        }
        let (frames, poses, samples) = (measurements.len(), poses.kept, samples.kept);
        Self { frames, statuses, measured, with_reading, nowhere, gap: longest, poses, samples }
    }
}
