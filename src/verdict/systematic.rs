//! Gaps of a known form: what the bending part of the innovations has of mistakes that a laboratory makes.
//!
//! A scale of one encoder, a view that is turned, a straight picture that was bent, a wrong aspect of the picture all miss the bend b by an affine
//! part a + M b. Six numbers tell them where noise hides them from the mean square, and of a single encoder's scale one number tells more.
//!
//! Such a gap is largest at the largest bends. A tenth of the poses is left out here as elsewhere, but that which agrees least with any affine gap (least
//! trimmed squares): the largest innovations are those that show a gap of this form.

use super::health::{Innovation, TRIMMED_MEAN_SQUARE, without_a_tenth};
use super::reason::{Code, Level, Reason};
use super::rules::LEVEL_OF_TESTS;
use crate::statistics::binomial;
use crate::statistics::trimmed::least_trimmed_squares;
use nalgebra::{Matrix2, Matrix2x3, Matrix2x6, Matrix3, Matrix6, Vector2, Vector3, Vector6};
use std::ops::Range;

/// A direction that the poses leave open is left out below this share of the largest information. Convention: numerical.
const SINGULAR: f64 = 1e-9;
/// Concentration steps of the least trimmed squares. Convention: numerical; about ten reach the least from any start.
const STEPS: usize = 20;
/// Standard deviations beyond which an encoder's scale is not chance.
///
/// Derived: Φ⁻¹(1 − 0.001/8): one of four encoders, up or down, at the level of the tests.
const SCALE_SDS: f64 = 3.661_7;

/// All but the tenth that agrees least with an affine gap; in their order.
pub(super) fn agreeing(innovations: &[Innovation]) -> Vec<Innovation> {
    let count = innovations.len();
    let mut smallest: Vec<usize> = (0..count).collect();
    smallest.sort_by(|&a, &b| innovations[a].bending.norm().total_cmp(&innovations[b].bending.norm()));
    smallest.truncate(without_a_tenth(count));
    let fit = |members: &[usize]| Some(AffineFit::of(members.iter().map(|&k| &innovations[k]))?.x);
    let square = |x: &Vector6<f64>, k: usize| (innovations[k].bending - affine(&innovations[k]) * x).norm_squared();
    let found = least_trimmed_squares(count, smallest.len(), [smallest], STEPS, fit, square);
    let mut members = found.map(|found| found.members).unwrap_or_default();
    members.sort_unstable();
    members.into_iter().map(|k| innovations[k].clone()).collect()
}

/// The whitened columns of a_x, a_y and of M's columns.
fn affine(one: &Innovation) -> Matrix2x6<f64> {
    let w = one.whitener;
    let (along, across) = (w * one.bend.x, w * one.bend.y);
    Matrix2x6::from_fn(|row, column| [w, along, across][column / 2][(row, column % 2)])
}

/// The affine part of a gap.
pub(super) struct AffineFit {
    /// a, and M by columns, mm and mm per rad.
    x: Vector6<f64>,
    /// Its squared distance from none, in standard deviations.
    distance: f64,
    /// Sum of the squares that are left.
    left: f64,
    poses: usize,
    /// How far it moves a bend of the data at the most, as a bending part of q̃, mm.
    pub most_mm: f64,
}

impl AffineFit {
    /// By least squares; `None` without a pose.
    pub fn of<'a>(innovations: impl Iterator<Item = &'a Innovation> + Clone) -> Option<Self> {
        let (mut information, mut slope, mut by_rig, mut own) =
            (Matrix6::zeros(), Vector6::zeros(), Matrix6::zeros(), Matrix6::zeros());
        let (mut before, mut poses) = (0.0, 0);
        for one in innovations.clone() {
            let h = affine(one);
            information += h.transpose() * h;
            slope += h.transpose() * one.bending;
            let rig = h.transpose() * one.by_rig;
            by_rig += rig;
            own += rig * rig.transpose();
            before += one.bending.norm_squared();
            poses += 1;
        }
        let inverse = |matrix: Matrix6<f64>| matrix.pseudo_inverse(SINGULAR * matrix.norm()).ok();
        let covariance = inverse(information)?;
        let x = covariance * slope;
        // The rig's errors are shared by all poses, as where an estimate's covariance counts them (`covariance_by_rig`).
        let shared = covariance * (by_rig * by_rig.transpose() - own) * covariance;
        // Those that agree least are left out, which makes what is fitted to the others less certain.
        let distance = x.dot(&(inverse(covariance / TRIMMED_MEAN_SQUARE[0] + shared)? * x));
        let [at_rest, along, across] = [0, 2, 4].map(|row| x.fixed_rows::<2>(row).into_owned());
        let moved_mm = |one: &Innovation| (at_rest + along * one.bend.x + across * one.bend.y).norm();
        let most_mm = innovations.map(moved_mm).fold(0.0, f64::max);
        Some(Self { x, distance, left: before - slope.dot(&x), poses, most_mm })
    }

    /// Whether noise accounts for it less often than the level of the tests.
    pub fn is_beyond_chance(&self) -> bool {
        chance_of_six(self.distance, self.left, self.poses) < LEVEL_OF_TESTS
    }

    /// How many standard deviations it is from none.
    pub fn sds(&self) -> f64 {
        self.distance.sqrt()
    }
}

/// The probability that six numbers fitted to so many pairs lie as far from zero, in squared standard deviations, while the pairs leave these
/// squares: by the F test, whose noise is that of the pairs, and no less than promised.
///
/// For even degrees of freedom the F distribution's tail is a binomial one: F(6, 2m) > f with the probability of at least m successes in m + 2
/// trials of p = m / (m + 3f).
///
/// Source: M. Abramowitz, I. A. Stegun, *Handbook of Mathematical Functions*, 1964, 26.5.24 and 26.6.
fn chance_of_six(distance: f64, left: f64, pairs: usize) -> f64 {
    let Some(half) = pairs.checked_sub(3).filter(|half| *half > 0) else { return 1.0 };
    let promised = 2.0 * half as f64;
    let left = (left / TRIMMED_MEAN_SQUARE[0]).max(promised);
    binomial::at_least(half, half + 2, left / (left + distance))
}

/// One encoder's relative error e, fitted beside η: of what is read a share of 1 − e is moved.
pub(super) struct ScaleFit {
    pub backbone: usize,
    /// How much η is changed.
    by_eta: f64,
    pub error: f64,
    pub sd: f64,
    /// Sum of the squares that it leaves of those to which it was fitted.
    pub squares_left: f64,
}

impl ScaleFit {
    /// By least squares; `None` if the poses do not tell it from η.
    pub fn of(innovations: &[Innovation], backbone: usize) -> Option<Self> {
        let (mut information, mut slope) = (Matrix2::zeros(), Vector2::zeros());
        for one in innovations {
            let h = Matrix2::from_columns(&[one.by_eta, one.by_scale(backbone)]);
            information += h.transpose() * h;
            slope += h.transpose() * one.bending;
        }
        let covariance = information.cholesky()?.inverse();
        let x = covariance * slope;
        let mut fit = Self { backbone, by_eta: x.x, error: x.y, sd: 0.0, squares_left: 0.0 };
        fit.squares_left = fit.left(innovations).iter().sum();
        let noise = TRIMMED_MEAN_SQUARE[0];
        let variance = (fit.squares_left / (2.0 * innovations.len() as f64 * noise)).max(1.0) / noise;
        fit.sd = (variance * covariance[(1, 1)]).sqrt();
        Some(fit)
    }

    /// Whether noise accounts for it less often than the level of the tests.
    pub fn is_beyond_chance(&self) -> bool {
        self.sds() > SCALE_SDS
    }

    /// How many standard deviations it is from none.
    pub fn sds(&self) -> f64 {
        self.error.abs() / self.sd
    }

    /// What of the reading is motion: the residual is e times the reading.
    fn scale(&self) -> f64 {
        1.0 - self.error
    }

    /// What it says of encoder or actuator.
    pub fn text(&self) -> String {
        let size = 100.0 * (1.0 / self.scale() - 1.0).abs();
        let side = if self.error > 0.0 { "more" } else { "less" };
        let (backbone, sd) = (self.backbone + 1, 100.0 * self.sd);
        format!("encoder or actuator of backbone {backbone} reads {size:.1} ± {sd:.1} % {side} than it moves")
    }

    pub fn reason(&self) -> Reason {
        let (backbone, scale) = (self.backbone + 1, self.scale());
        let text = format!("{}, which accounts for the gap", self.text());
        let remedy = format!(
            "check drum, screw pitch and counts of backbone {backbone}: its readings times {scale:.3} agree with the bends; if they are right, \
             `snakeloop discover` fits the effect actuator_scale"
        );
        let reason = Reason::new(Code::EncoderScale, Level::Look, text, remedy);
        Reason { backbone: Some(backbone), scale: Some((scale * 1e4).round() / 1e4), ..reason }
    }
}

impl Left for ScaleFit {
    fn left(&self, innovations: &[Innovation]) -> Vec<f64> {
        let part = |one: &Innovation| one.by_eta * self.by_eta + one.by_scale(self.backbone) * self.error;
        innovations.iter().map(|one| (one.bending - part(one)).norm_squared()).collect()
    }

    fn numbers(&self, poses: usize) -> usize {
        2 * poses
    }
}

/// An encoder that stands still in a part of the log: its error there is free, pose by pose, beside η.
pub(super) struct StuckFit {
    pub backbone: usize,
    part: Range<usize>,
    /// How much η is changed.
    by_eta: f64,
}

impl StuckFit {
    /// Of the longest part in which the readings of a backbone do not change at all, and others do; `None` if there is none of as many poses.
    pub fn of(innovations: &[Innovation], backbone: usize, least: usize) -> Option<Self> {
        let is_same = |a: &Innovation, b: &Innovation| a.q_mm[backbone] == b.q_mm[backbone];
        let parts = innovations.chunk_by(is_same).scan(0, |from, part| {
            let first = *from;
            *from += part.len();
            Some((first..*from, part.iter().any(|one| one.q_mm != part[0].q_mm)))
        });
        let parts = parts.filter(|(part, others_move)| *others_move && part.len() >= least);
        let (part, _) = parts.max_by_key(|(part, _)| part.len())?;
        Some(Self::within(innovations, backbone, part))
    }

    /// The same of another backbone in the same part.
    pub fn of_other(&self, innovations: &[Innovation], backbone: usize) -> Self {
        Self::within(innovations, backbone, self.part.clone())
    }

    fn within(innovations: &[Innovation], backbone: usize, part: Range<usize>) -> Self {
        let mut fit = Self { backbone, part, by_eta: 0.0 };
        let (mut information, mut slope) = (0.0, 0.0);
        for (k, one) in innovations.iter().enumerate() {
            let (by_eta, bending) = (fit.without_free(k, one, one.by_eta), fit.without_free(k, one, one.bending));
            information += by_eta.norm_squared();
            slope += by_eta.dot(&bending);
        }
        fit.by_eta = if information > 0.0 { slope / information } else { 0.0 };
        fit
    }

    /// What is left of a bending part once the encoder's error is free, where it is.
    fn without_free(&self, k: usize, one: &Innovation, bending: Vector2<f64>) -> Vector2<f64> {
        let along = one.by_reading[self.backbone];
        match self.part.contains(&k) && along.norm_squared() > 0.0 {
            true => bending - along * (along.dot(&bending) / along.norm_squared()),
            false => bending,
        }
    }

    pub fn reason(&self, innovations: &[Innovation]) -> Reason {
        let (backbone, part) = (self.backbone + 1, &innovations[self.part.clone()]);
        let [first, last] = [part.first(), part.last()].map(|one| one.map_or(0, |one| one.index));
        let text = format!(
            "between frames {first} and {last} q{backbone} stands still while the snake moves as the other readings say, which accounts for the gap"
        );
        let remedy =
            "repair or reconnect the encoder and log its readings anew, or use the rows before it stood still alone";
        Reason { backbone: Some(backbone), ..Reason::new(Code::EncoderStuck, Level::DoNotUse, text, remedy) }
    }
}

impl Left for StuckFit {
    fn left(&self, innovations: &[Innovation]) -> Vec<f64> {
        let left = |(k, one): (usize, &Innovation)| {
            self.without_free(k, one, one.bending - one.by_eta * self.by_eta).norm_squared()
        };
        innovations.iter().enumerate().map(left).collect()
    }

    fn numbers(&self, poses: usize) -> usize {
        2 * poses - self.part.len()
    }
}

/// A cause that is fitted to the bending parts of all poses.
pub(super) trait Left {
    /// The square that it leaves at each pose.
    fn left(&self, innovations: &[Innovation]) -> Vec<f64>;
    /// How many numbers of so many poses it leaves to noise, but for the few that are fitted to all of them.
    fn numbers(&self, poses: usize) -> usize;
}

/// A step of one encoder's readings from some pose on, fitted beside η and a constant of the same encoder.
pub(super) struct StepFit {
    backbone: usize,
    /// The number of the first pose after it.
    at: usize,
    /// How much η, all of the readings (mm) and those from the step on (mm) are changed.
    x: Vector3<f64>,
}

impl StepFit {
    /// By least squares, at the one of these places at which it accounts for most; `None` if the poses do not tell it.
    pub fn of(innovations: &[Innovation], backbone: usize, places: Range<usize>) -> Option<Self> {
        let by_reading = |one: &Innovation| one.by_reading[backbone];
        let sum = |of: &dyn Fn(&Innovation) -> f64| innovations.iter().map(of).sum::<f64>();
        let eta_eta = sum(&|one| one.by_eta.norm_squared());
        let eta_slope = sum(&|one| one.by_eta.dot(&one.bending));
        // Reading by reading, reading by η and the slope of the reading: of all poses, and of those from a place on.
        let part = |one: &Innovation| {
            let by = by_reading(one);
            Vector3::new(by.norm_squared(), by.dot(&one.by_eta), by.dot(&one.bending))
        };
        let all: Vector3<f64> = innovations.iter().map(part).sum();
        let mut after: Vector3<f64> = innovations.get(places.end..)?.iter().map(part).sum();
        let mut best: Option<(f64, Self)> = None;
        for at in places.rev() {
            after += part(&innovations[at]);
            let information = Matrix3::new(eta_eta, all.y, after.y, all.y, all.x, after.x, after.y, after.x, after.x);
            let slope = Vector3::new(eta_slope, all.z, after.z);
            let Some(x) = information.cholesky().map(|factor| factor.solve(&slope)) else { continue };
            let gained = slope.dot(&x);
            if best.as_ref().is_none_or(|(most, _)| gained > *most) {
                best = Some((gained, Self { backbone, at, x }));
            }
        }
        best.map(|(_, step)| step)
    }

    pub fn reason(&self, innovations: &[Innovation]) -> Reason {
        step_of_one(
            self.backbone,
            [self.at - 1, self.at].map(|at| innovations[at].index),
            self.x.z,
            ", which accounts for the gap",
        )
    }
}
impl Left for StepFit {
    fn left(&self, innovations: &[Innovation]) -> Vec<f64> {
        let left = |(k, one): (usize, &Innovation)| {
            let reading_mm = self.x.y + if k >= self.at { self.x.z } else { 0.0 };
            (one.bending - one.by_eta * self.x.x - one.by_reading[self.backbone] * reading_mm).norm_squared()
        };
        innovations.iter().enumerate().map(left).collect()
    }

    fn numbers(&self, poses: usize) -> usize {
        2 * poses
    }
}

/// A bend by which all poses are missed alike, fitted beside η.
pub(super) struct ConstantFit {
    /// How much η is changed, and the bending part of all readings, mm.
    x: Vector3<f64>,
}

impl ConstantFit {
    /// By least squares; `None` if the poses do not tell it from η.
    pub fn of(innovations: &[Innovation]) -> Option<Self> {
        let (mut information, mut slope) = (Matrix3::zeros(), Vector3::zeros());
        for one in innovations {
            let h = Self::columns(one);
            information += h.transpose() * h;
            slope += h.transpose() * one.bending;
        }
        Some(Self { x: information.cholesky()?.solve(&slope) })
    }

    fn columns(one: &Innovation) -> Matrix2x3<f64> {
        Matrix2x3::from_columns(&[one.by_eta, one.whitener.column(0).into(), one.whitener.column(1).into()])
    }

    /// The bending part of the readings that is missed, mm.
    pub fn missed_mm(&self) -> Vector2<f64> {
        self.x.yz()
    }
}

impl Left for ConstantFit {
    fn left(&self, innovations: &[Innovation]) -> Vec<f64> {
        innovations.iter().map(|one| (one.bending - Self::columns(one) * self.x).norm_squared()).collect()
    }

    fn numbers(&self, poses: usize) -> usize {
        2 * poses
    }
}

/// Readings of one backbone that change by a step between two frames.
pub(super) fn step_of_one(backbone: usize, [last, first]: [u64; 2], step_mm: f64, accounts: &str) -> Reason {
    let backbone = backbone + 1;
    let text = format!(
        "between frames {last} and {first} the readings of backbone {backbone} become {}{accounts}",
        changed_by(step_mm)
    );
    let remedy = format!(
        "look for a counter that slipped, or for encoder or actuator of backbone {backbone} homed anew in the middle; use the rows before it \
         or those after it alone, or take the step off one part"
    );
    let reason = Reason::new(Code::Rehomed, Level::Look, text, remedy);
    Reason { backbone: Some(backbone), ..reason }
}

/// What readings become by a step, mm.
pub(super) fn changed_by(step_mm: f64) -> String {
    let side = if step_mm > 0.0 { "larger" } else { "smaller" };
    format!("{side} by {:.3} mm", step_mm.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_chance_of_six_numbers_is_that_of_published_tables_of_f() {
        // Upper quantiles of F(6, 2m): G. W. Snedecor, W. G. Cochran, Statistical Methods, tables A 14.
        for (m, f, level) in [(10, 2.60, 0.05), (30, 3.12, 0.01), (5, 9.93, 0.001)] {
            let squares = TRIMMED_MEAN_SQUARE[0] * 2.0 * f64::from(m);
            let chance = chance_of_six(6.0 * f, squares, m as usize + 3);
            assert!((chance / level - 1.0).abs() < 0.02, "F(6, {}): {chance} for {level}", 2 * m);
            // Noise that is twice as large as promised asks for twice the distance.
            let noisier = chance_of_six(12.0 * f, 2.0 * squares, m as usize + 3);
            assert!((noisier - chance).abs() < 1e-12);
        }
        assert_eq!(chance_of_six(1e3, 1.0, 3), 1.0, "three pairs are met by six numbers whatever they are");
    }
}
