//! Whether the readings show the force that backbones share within force limits, where somebody says that they were commanded so.
//!
//! A shared force bends nothing: it adds κf(ψ) to the part of q̃ that bends nothing, which grows and falls from pose to pose. What the readings
//! have there beyond the model is therefore a share g of it, besides λ and noise: g is 1 where the force acted as told, and 0 where none did. Of the
//! steps from pose to pose, in which λ is not, g is the median of their ratios, weighted by the squares of what they should be.

use super::reason::{Code, Level, Reason};
use super::rules::NORMAL_QUANTILE;
use crate::estimate::{NewPoses, Pair, pairs_without_effects, usable};
use crate::observation::{EncoderReading, Measurement};
use crate::robot::{ForceLimits, Model, PerBackbone};
use crate::statistics::order::mad_scale;
use std::convert::Infallible;

/// A share within this of 1 is 1, and of 0 none. Convention: ten tubes of a batch differ by less in the compliance of their lines.
const SHARE: f64 = 0.2;
/// Poses that are looked at. Convention: a resource limit, far beyond what the test needs.
const MOST_POSES: usize = 2000;
/// σ of a normal variable's median over that of its mean. Derived: √(π/2).
const MEDIAN_OVER_MEAN: f64 = 1.253_314;

/// A reason where the readings do not show the force that the limits tell. The model has the η by which the bends are explained.
pub fn doubt_of_force_limits(
    model: &Model,
    limits: &ForceLimits,
    measurements: &[Measurement],
    readings: &[EncoderReading],
) -> Option<Reason> {
    model.estimate?;
    let told = Told::of(model, limits, measurements, readings)?;
    let margin = SHARE.max(NORMAL_QUANTILE * told.sd);
    if (told.share - 1.0).abs() <= margin {
        return None;
    }
    let (text, remedy) = if told.share.abs() <= margin {
        (
            "the log reads as if no force limits had acted".to_owned(),
            "leave --force-limits out, or give those of the table that commanded the robot: η and the bends are right either way, and λ is not",
        )
    } else {
        (
            "the log reads as if other force limits had acted".to_owned(),
            "give the limits of the table that commanded the robot: η and the bends are right either way, and λ is not",
        )
    };
    let text = format!(
        "{text}: of the force that --force-limits tells, up to {:.3} mm of q̃, the readings show a share of {} ± {:.2} ({} poses)",
        told.largest_mm,
        format!("{:.2}", told.share).replace('-', "−"),
        told.sd,
        told.poses
    );
    Some(Reason::new(Code::ForceLimits, Level::Look, text, remedy))
}

/// What the readings show of the force that was told.
#[derive(Debug)]
struct Told {
    share: f64,
    sd: f64,
    /// The largest part of q̃ that it should be, mm.
    largest_mm: f64,
    poses: usize,
}

impl Told {
    /// `None` where the poses need no shared force, or tell nothing of it.
    fn of(
        model: &Model,
        limits: &ForceLimits,
        measurements: &[Measurement],
        readings: &[EncoderReading],
    ) -> Option<Self> {
        let plain = model.plain();
        let rows = measurements.iter().cloned().map(Ok::<_, Infallible>);
        let mut new_poses = NewPoses::default();
        let pose = |pair: Result<Pair, Infallible>| {
            let Ok((measurement, reading)) = pair;
            let (measured, q_mm) = usable(plain.robot.backbone_count(), &measurement, reading.as_ref()).ok()?;
            let psi = measured.configuration;
            new_poses.is_new(psi.bend_vector()).then(|| {
                let left_mm = plain.robot.internal_part(&(q_mm - plain.command(psi)));
                (plain.sharing(psi, limits).shift_mm, left_mm)
            })
        };
        let poses: Vec<(PerBackbone, PerBackbone)> =
            pairs_without_effects(model, rows, readings).filter_map(pose).take(MOST_POSES).collect();
        let steps: Vec<(PerBackbone, PerBackbone)> =
            poses.windows(2).map(|pair| (pair[1].0 - pair[0].0, pair[1].1 - pair[0].1)).collect();
        let share = weighted_median(steps.iter().map(|(told, seen)| (told.dot(seen), told.norm_squared())))?;
        let information: f64 = steps.iter().map(|(told, _)| told.norm_squared()).sum();
        let left = steps.iter().flat_map(|(told, seen)| (*seen - *told * share).iter().copied().collect::<Vec<_>>());
        let sd = MEDIAN_OVER_MEAN * mad_scale(left) / information.sqrt();
        let largest_mm = poses.iter().map(|(told, _)| told.amax()).fold(0.0, f64::max);
        (sd < SHARE).then_some(Self { share, sd, largest_mm, poses: poses.len() })
    }
}

/// The median of ratios y/w, each with the weight w; `None` without any.
fn weighted_median(ratios: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    let mut ratios: Vec<(f64, f64)> =
        ratios.filter(|(_, weight)| *weight > 0.0).map(|(y, weight)| (y / weight, weight)).collect();
    ratios.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * ratios.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut below = 0.0;
    ratios.into_iter().find_map(|(ratio, weight)| {
        below += weight;
        (below >= half).then_some(ratio)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Estimate;
    use crate::simulate::{BendingExperiment, Plant, SimulatedEye};
    use nalgebra::Matrix2;

    /// What is said of a simulated robot that was commanded within some limits, where others are told.
    fn said(acted: Option<(f64, f64)>, told: (f64, f64)) -> Option<String> {
        let estimate = Estimate { eta: 1.221, lambda_mm: 0.1765, covariance: Matrix2::zeros(), samples: 9 };
        let model = Model { estimate: Some(estimate), ..Model::default() };
        let plant = Plant { model: model.clone(), sd_encoder_mm: 0.0015 };
        let samples = plant.run(&BendingExperiment::default().waypoints().unwrap(), 3);
        let limits = |(least, most)| ForceLimits::new(least, most).unwrap();
        let reading = |row: &EncoderReading| {
            let shift = |acted| model.sharing(model.forward(&row.q_mm).unwrap().configuration, &limits(acted)).shift_mm;
            EncoderReading { q_mm: acted.map_or(row.q_mm, |acted| row.q_mm + shift(acted)), ..*row }
        };
        let readings: Vec<_> = samples.iter().map(|sample| reading(&sample.reading)).collect();
        let measurements = SimulatedEye::default().observe(&samples, 4);
        doubt_of_force_limits(&model, &limits(told), &measurements, &readings).map(|reason| reason.text)
    }

    #[test]
    fn limits_that_did_not_act_are_told_and_those_that_did_are_not() {
        for limits in [(-60.0, 15.0), (-20.0, 5.0)] {
            assert_eq!(said(Some(limits), limits), None, "{limits:?}");
            let words = said(None, limits).unwrap();
            assert!(words.starts_with("the log reads as if no force limits had acted"), "{limits:?}: {words}");
        }
        // Limits that no pose meets make no difference.
        assert_eq!(said(None, (-1000.0, 1000.0)), None);
        let words = said(Some((-60.0, 15.0)), (-20.0, 5.0));
        assert!(words.as_ref().is_some_and(|words| words.contains("other force limits")), "{words:?}");
    }
}
