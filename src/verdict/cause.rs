//! Which single cause accounts for a gap: a step, a scale or a standstill of one encoder, all of them homed anew, or a bend that all poses share.
//!
//! Each cause is fitted beside η. It is named if it leaves noise or next to nothing of the gap, and if every other of its kind, and another η alone, leave
//! far more.

use super::health::{Health, Innovation, common_noise_mm, without_a_tenth, without_largest};
use super::reason::{Code, Level, Reason};
use super::rules::{LEVEL_OF_TESTS, MEAN_SQUARE_OF_NOISE, NORMAL_QUANTILE};
use super::scale::LEAST_UNNAMED;
use super::systematic::{ConstantFit, Left, ScaleFit, StepFit, StuckFit, changed_by, step_of_one};
use crate::robot::Model;
use crate::statistics::chi_square;
use crate::statistics::moments::rms;
use crate::statistics::order::median;
use nalgebra::Vector2;
use std::ops::Range;

/// A single encoder's scale accounts for a gap if it leaves no more than this share of the mean square.
///
/// Convention: half of the rms, as where a lag is taken for the clock's.
const LEFT_BY_A_SCALE: f64 = 0.25;
/// Poses on each side of a step that all readings share. Convention: as many as tell a mean from an outlier.
const BESIDE_A_STEP: usize = 3;
/// A step accounts for what readings have in common if it leaves no more than this share of its own size, in rms; one of a single encoder, or its
/// standing still, for the gap if it leaves no more of that.
///
/// Convention: a tenth; what drifts or follows the load leaves a third.
const LEFT_BY_A_STEP: f64 = 0.1;

impl Health {
    /// A step that all readings share, if it accounts for what they have in common beyond noise and the bends are explained: homed anew in the
    /// middle. A play as large as that moves the bends as well.
    pub fn rehomed(&self, model: &Model) -> Option<Reason> {
        if self.has_gap() {
            return None;
        }
        let (at, step_mm) = self.common_step()?;
        let frames = [self.innovations[at - 1].index, self.innovations[at].index];
        // A step of one encoder moves what all have in common by a share of its size, and the bends.
        let of_one_mm = step_mm * model.robot.backbone_count() as f64;
        if let Some(backbone) = self.encoders().find(|&i| self.shows_step(i, at, of_one_mm)) {
            return Some(step_of_one(backbone, frames, of_one_mm, ", and so do the bends that they imply"));
        }
        let [last, first] = frames;
        let text = format!(
            "between frames {last} and {first} all readings become {}, as where encoders or actuators are homed anew in the middle of a log",
            changed_by(step_mm)
        );
        let remedy = "home before the first frame; use the rows before it or those after it alone, or take the step off one part: the bends are \
                      right either way, and λ is that of one part only";
        let is_possible = model.estimate().is_none_or(|estimate| estimate.implausible().is_none());
        Some(Reason::new(Code::Rehomed, if is_possible { Level::Look } else { Level::DoNotUse }, text, remedy))
    }

    /// The step of all readings that accounts for what they have in common beyond noise: the number of the first pose after it, and its size, mm.
    fn common_step(&self) -> Option<(usize, f64)> {
        self.common_above_noise()?;
        let common: Vec<f64> = self.innovations.iter().map(|one| one.common_mm).collect();
        let centre = |part: &[f64]| median(&mut part.to_vec());
        let left = |at: usize| {
            let (before, after) = common.split_at(at);
            let of = |part: &[f64]| {
                let centre = centre(part);
                part.iter().map(|mm| (mm - centre).abs()).collect::<Vec<f64>>()
            };
            [of(before), of(after)].concat()
        };
        let places = BESIDE_A_STEP..(common.len() + 1).saturating_sub(BESIDE_A_STEP);
        let sums = places.map(|at| (at, left(at).iter().sum::<f64>()));
        let (at, _) = sums.min_by(|(_, a), (_, b)| a.total_cmp(b))?;
        let left = without_largest(left(at), |mm| *mm);
        let (before, after) = common.split_at(at);
        let step = centre(after) - centre(before);
        let root_n = (self.encoders().len() as f64).sqrt();
        (rms(left) <= LEFT_BY_A_STEP * step.abs()).then_some((at, step / root_n))
    }

    /// Whether the bends show a step of one encoder's readings that is as large as this, mm, from some pose on: they are far likelier with it than without,
    /// beside a constant of that encoder.
    fn shows_step(&self, backbone: usize, at: usize, step_mm: f64) -> bool {
        let by_reading = |one: &Innovation| one.by_reading[backbone];
        let information: f64 = self.innovations.iter().map(|one| by_reading(one).norm_squared()).sum();
        let left = |step_mm: f64| {
            let without =
                |(k, one): (usize, &Innovation)| one.bending - by_reading(one) * if k >= at { step_mm } else { 0.0 };
            let without: Vec<Vector2<f64>> = self.innovations.iter().enumerate().map(without).collect();
            let poses = || self.innovations.iter().zip(&without);
            let constant = poses().map(|(one, bending)| by_reading(one).dot(bending)).sum::<f64>() / information;
            poses().map(|(one, bending)| (bending - by_reading(one) * constant).norm_squared()).sum::<f64>()
        };
        left(0.0) - left(step_mm) > -2.0 * LEVEL_OF_TESTS.ln()
    }

    /// A step of a single encoder that accounts for the gap, if no other's does so nearly as well: a counter that slipped, or an actuator that was
    /// homed anew alone.
    pub fn encoder_step(&self) -> Option<Reason> {
        self.bending_above_noise()?;
        let places = BESIDE_A_STEP..(self.all.len() + 1).saturating_sub(BESIDE_A_STEP);
        let mut fits = self.likeliest_first(self.encoders().filter_map(|i| StepFit::of(&self.all, i, places.clone())));
        let (step, second) = (fits.next()?, fits.next()?);
        // A bend that all poses are missed by is none of a step, and neither is what grows with a reading.
        let constant = ConstantFit::of(&self.all).map(|constant| self.left_by(&constant));
        let scale = self.scales().first().map(|scale| self.left_by(scale));
        let numbers = step.1.numbers(without_a_tenth(self.all.len()));
        let is_step = constant.into_iter().chain(scale).all(|other| is_alone(step.0, other, numbers));
        (is_step && self.accounts_for_gap(&step, &second)).then(|| step.1.reason(&self.all))
    }

    /// What all poses are missed by alike, if that accounts for the gap.
    pub fn at_rest(&self) -> Option<String> {
        let constant = ConstantFit::of(&self.all)?;
        if !self.explains_gap(self.left_by(&constant), constant.numbers(without_a_tenth(self.all.len()))) {
            return None;
        }
        let rest = constant.missed_mm() * self.bend_by_mm;
        Some(format!(
            "all poses are missed by the same {:.2}° towards δ = {:.0}°, as where the encoders were zeroed while the snake was bent, or something bends \
             it at rest",
            rest.norm().to_degrees(),
            rest.y.atan2(rest.x).to_degrees()
        ))
    }

    /// A single encoder that stands still in a part of the log, if that accounts for the gap, and an error of another there does not.
    pub fn encoder_stuck(&self) -> Option<Reason> {
        self.bending_above_noise()?;
        let fits = self.encoders().filter_map(|i| StuckFit::of(&self.all, i, 2 * BESIDE_A_STEP));
        let stuck = self.likeliest_first(fits).next()?;
        let others = self.encoders().filter(|i| *i != stuck.1.backbone).map(|i| stuck.1.of_other(&self.all, i));
        let second = self.likeliest_first(others).next()?;
        self.accounts_for_gap(&stuck, &second).then(|| stuck.1.reason(&self.all))
    }

    /// The numbers of the encoders.
    pub fn encoders(&self) -> Range<usize> {
        0..self.all.first().map_or(0, |one| one.q_mm.len())
    }

    /// Causes in the order of the squares that they leave but for the largest tenth, which are summed up beside each.
    fn likeliest_first<C: Left>(&self, causes: impl Iterator<Item = C>) -> impl Iterator<Item = (f64, C)> {
        let mut causes: Vec<(f64, C)> = causes.map(|cause| (self.left_by(&cause), cause)).collect();
        causes.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        causes.into_iter()
    }

    /// The squares that a cause leaves but for the largest tenth.
    fn left_by<C: Left>(&self, cause: &C) -> f64 {
        without_largest(cause.left(&self.all), |square| *square).iter().sum()
    }

    /// Whether a cause leaves noise or next to nothing of the gap, and the second likeliest far more.
    fn accounts_for_gap<C: Left>(&self, (left, cause): &(f64, C), (second, _): &(f64, C)) -> bool {
        let numbers = cause.numbers(without_a_tenth(self.all.len()));
        self.explains_gap(*left, numbers) && is_alone(*left, *second, numbers)
    }

    /// Whether squares that are left of so many numbers, beside another η, are noise or next to nothing of the gap, and another η alone leaves far more.
    fn explains_gap(&self, left: f64, numbers: usize) -> bool {
        let sum = |of: &dyn Fn(&Innovation) -> f64| self.all.iter().map(of).sum::<f64>();
        let eta = sum(&|one| one.by_eta.dot(&one.bending)) / sum(&|one| one.by_eta.norm_squared());
        let squares = self.all.iter().map(|one| (one.bending - one.by_eta * eta).norm_squared()).collect();
        let left_by_eta: f64 = without_largest(squares, |square| *square).iter().sum();
        let explains = is_noise(left, numbers) || left <= LEFT_BY_A_STEP.powi(2) * left_by_eta;
        explains && is_alone(left, left_by_eta, numbers)
    }

    /// A single encoder or actuator whose scale accounts for the gap, if no other does so nearly as well.
    pub fn encoder_scale(&self) -> Option<Reason> {
        let fits = self.scales();
        let (best, second) = (fits.first()?, fits.get(1)?);
        let before: f64 = self.agreeing().iter().map(|one| one.bending.norm_squared()).sum();
        let is_certain = best.sds() > NORMAL_QUANTILE * MEAN_SQUARE_OF_NOISE.sqrt();
        // An encoder's error moves the common part as well, which the correction must make quieter; an error of the eye does not.
        let quieter = {
            let i = best.backbone;
            let root_n = (self.agreeing()[0].q_mm.len() as f64).sqrt();
            let corrected = |one: &Innovation| one.common_mm - best.error * one.q_mm[i] / root_n;
            common_noise_mm(self.agreeing(), corrected) < common_noise_mm(self.agreeing(), |one| one.common_mm)
        };
        // A larger factor is another unit or a wrong sign, and the wiring check's business.
        let is_scale = (1.0 / LEAST_UNNAMED..LEAST_UNNAMED).contains(&(1.0 - best.error));
        let numbers = 2 * self.agreeing().len();
        let explains = is_noise(best.squares_left, numbers) || best.squares_left <= LEFT_BY_A_SCALE * before;
        let is_alone = is_alone(best.squares_left, second.squares_left, numbers);
        (self.has_gap() && explains && is_alone && is_certain && quieter && is_scale).then(|| best.reason())
    }

    /// Each encoder's scale as the gap tells it, the likeliest first.
    pub fn scales(&self) -> Vec<ScaleFit> {
        let mut fits: Vec<ScaleFit> = self.encoders().filter_map(|i| ScaleFit::of(self.agreeing(), i)).collect();
        fits.sort_by(|a, b| a.squares_left.total_cmp(&b.squares_left));
        fits
    }
}

/// Whether the sum of so many squares is no larger than what counts as noise allows.
fn is_noise(left: f64, numbers: usize) -> bool {
    left < MEAN_SQUARE_OF_NOISE * chi_square::quantile(numbers as f64, NORMAL_QUANTILE)
}

/// Whether the second likeliest cause leaves far more of so many squares: twice the logarithm of the likelihood ratio where the noise's size is not
/// known.
fn is_alone(left: f64, second: f64, numbers: usize) -> bool {
    let numbers = numbers as f64;
    numbers * (second / left.max(numbers)).ln() > -2.0 * LEVEL_OF_TESTS.ln()
}
