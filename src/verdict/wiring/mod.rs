//! The wiring check: whether the encoder log, as it is read, is what the eye saw the snake do.
//!
//! A laboratory's mistakes form a small group: columns in another order, encoders that count the other way, rows that stand one or
//! more places off, azimuths that run the other way round or are turned in a view, mirrored pictures, a clock that is late. Each
//! mistake is a hypothesis, fitted to the bends by maximum likelihood (`likelihood`), and what tells for it is
//!
//! ```text
//! evidence = (ln L_mistake − ln L_as_it_is) / D − ln(number of mistakes of its kind)
//! ```
//!
//! with D the design effect of the residuals' serial correlation; two mistakes are compared under one D. Were the log right, the likelihood ratio would exceed 1/α with a
//! probability of α at most (Markov's inequality, since its mean is 1 then), so a mistake is named where the evidence exceeds ln 1/α.
//! The unit needs no hypothesis of its own: the fit leaves the gain open, and `verdict::scale` asks afterwards what gain the line
//! can have.

mod hypotheses;
mod likelihood;
mod samples;

use super::LEVEL_OF_TESTS;
use crate::observation::{EncoderReading, Wiring};
use crate::robot::{LIBRARY, Robot};
use hypotheses::{Candidate, lags, shifts, signed_permutations};
use likelihood::{Fit, Freedom};
use nalgebra::Vector2;
pub(super) use samples::Pose;
use samples::Samples;
use std::f64::consts::TAU;

/// A lag of the encoders is a mistake of the clock where it leaves no more than this share of the misfit's scale.
///
/// Convention: three quarters of the variance; play, creep and drag look like a small lag too, and are left to `discover`.
const LEFT_BY_A_LAG: f64 = 0.5;

/// A wiring is left out if it makes the readings' internal part so many times as loud as the quietest does.
///
/// Convention: the wirings that the bends cannot tell apart (with four backbones, two that face each other exchanged and both signs turned)
/// turn a play of tenths of a millimetre about, against microns of noise.
const LOUDER: f64 = 2.0;

/// What is wrong with the log or with a view.
#[derive(Debug, Clone, PartialEq)]
pub enum Mistake {
    /// The columns, their signs, or the rows' numbers; its scale is not told.
    Log(Wiring),
    /// The readings are as old as this, s; negative where they are newer than the frames.
    Clock {
        /// Age of the readings, s.
        age_s: f64,
    },
    /// The azimuth of a view.
    View {
        /// Its name, where measurements name one.
        view: Option<String>,
        /// What is to be added to its δ, rad; after the mirror where it is mirrored.
        turn: f64,
        /// Whether δ runs the other way round.
        mirrored: bool,
    },
}

impl Mistake {
    /// Whether it says of the log that its rows stand elsewhere, and nothing else.
    pub fn shifts_rows_alone(&self) -> bool {
        matches!(self, Self::Log(wiring) if Wiring { index_shift: 0, ..wiring.clone() }.is_straight())
    }

    /// Whether it is a turn of a view that the robot may have as well.
    fn may_be_misalignment(&self) -> bool {
        matches!(self, Self::View { turn, mirrored: false, .. } if turn.abs() <= largest_misalignment())
    }
}

/// The largest turn of a view that the effect `plane_misalignment` accounts for, rad.
pub(super) fn largest_misalignment() -> f64 {
    let physics = LIBRARY.iter().find(|physics| physics.name == "plane_misalignment");
    physics.map_or(0.0, |physics| physics.parameters_on(3)[0].range.1.to_radians())
}

/// What the check found.
#[derive(Debug, Clone, PartialEq)]
pub struct WiringCheck {
    /// The mistake that explains the bends far better, where there is one.
    pub mistake: Option<Mistake>,
    /// Typical misfit as the log stands, in units of the predicted noise.
    pub misfit: f64,
    /// The same under the mistake.
    pub misfit_corrected: f64,
    /// The gain from implied to seen bend, under the mistake where there is one.
    pub gain: f64,
    /// Its standard deviation.
    pub sd_gain: f64,
    /// The bend seen where the readings imply none, as the log stands, rad.
    pub at_rest: Vector2<f64>,
    /// Standard deviation of its numbers, rad.
    pub sd_at_rest: f64,
    /// Another wiring of columns and signs that explains the bends about as well, so that the data cannot confirm the log's own.
    pub undecided: Option<Wiring>,
    /// Where the mistake is a shift of rows alone: the age of the readings that explains the bends about as well, s. Rows at even times show
    /// no difference.
    pub as_a_lag_s: Option<f64>,
}

/// Tries the log against the bends. `None` where there are too few bends with readings to say anything.
pub(super) fn check(robot: &Robot, sd_encoder_mm: f64, poses: &[Pose], log: &[EncoderReading]) -> Option<WiringCheck> {
    let samples = Samples::new(robot, sd_encoder_mm, poses, log);
    let straight = Candidate::straight(robot.backbone_count());
    let as_it_is = samples.fit(&straight, Freedom::Gain)?;
    let mut logs = of_the_log(&samples, poses, log);
    if samples.common_part_is_positive() {
        // No view and no order changes the common part, and play and friction put it above zero: the signs are not all turned.
        logs.retain(|rival| !rival.turns_all_signs());
    }
    let quietest_mm = logs.iter().map(|rival| rival.internal_mm).fold(samples.internal_spread_mm(&straight), f64::min);
    logs.retain(|rival| rival.internal_mm <= LOUDER * quietest_mm.max(sd_encoder_mm));
    let (misaligned, mut turned): (Vec<_>, Vec<_>) =
        of_views(&samples).into_iter().partition(|rival| rival.mistake.may_be_misalignment());
    let mut wirings = logs.clone();
    if misaligned.iter().filter(|rival| rival.fit.leaves_noise).count() == samples.views().len() {
        // Nothing is wrong with columns or azimuths. Of poses in one plane an order or a mirror that reflects it leaves as little, and which of them leaves
        // least is the noise of the readings across the plane.
        wirings.retain(|rival| rival.mistake.shifts_rows_alone());
        turned.clear();
    }
    let columns_best = plainest_of_the_best(&wirings);
    let lags = of_the_clock(&samples);
    let is_of_the_clock = |lag: &&Rival| lag.fit.scale <= LEFT_BY_A_LAG * as_it_is.scale;
    let clock_best = best(&lags.iter().filter(is_of_the_clock).cloned().collect::<Vec<_>>());

    // A small turn of a view, which may be the robot's own, comes first. An order of the columns shows the same as some larger turns and mirrors, and has
    // no angle to fit.
    let decisive = -LEVEL_OF_TESTS.ln();
    let mut chosen = best(&misaligned);
    for rival in [columns_best, best(&turned), clock_best].into_iter().flatten() {
        let is_better = |chosen: &Rival| rival.evidence() > decisive && rival.ahead_of(chosen) > decisive;
        if chosen.as_ref().is_none_or(is_better) {
            chosen = Some(rival);
        }
    }
    let chosen = chosen?;
    let found = chosen.evidence() > decisive;
    let undecided = if !found {
        undecided(&logs, Rival::evidence)
    } else if chosen.mistake.may_be_misalignment() {
        undecided(&logs, |rival| rival.ahead_of(&chosen))
    } else {
        None
    };
    let as_a_lag_s = best(&lags).filter(|lag| chosen.mistake.shifts_rows_alone() && chosen.ahead_of(lag) <= decisive);
    let as_a_lag_s = as_a_lag_s.and_then(|lag| lag.age_s());
    Some(WiringCheck {
        as_a_lag_s,
        misfit: as_it_is.scale,
        misfit_corrected: chosen.fit.scale,
        gain: if found { chosen.fit.gain.norm() } else { as_it_is.gain.x },
        sd_gain: if found { chosen.fit.sd_gain } else { as_it_is.sd_gain },
        at_rest: as_it_is.at_rest,
        sd_at_rest: as_it_is.sd_at_rest,
        mistake: found.then_some(chosen.mistake),
        undecided,
    })
}

/// A mistake with its fit and what tells for it.
#[derive(Debug, Clone)]
struct Rival {
    mistake: Mistake,
    /// Spread of the readings' internal part, mm, where the log is read otherwise.
    internal_mm: f64,
    fit: Fit,
    /// ln L_mistake − ln L_as_it_is.
    gained: f64,
    /// What the number of mistakes of its kind and its further parameters cost.
    cost: f64,
}

impl Rival {
    /// What tells for it against the log as it is.
    fn evidence(&self) -> f64 {
        self.evidence_under(self.fit.design_effect)
    }

    fn evidence_under(&self, design_effect: f64) -> f64 {
        self.gained / design_effect.max(1.0) - self.cost
    }

    /// What tells for it against another: both under one design effect, the larger, or two fits that are alike would differ by how their residuals
    /// happen to hang together.
    fn ahead_of(&self, other: &Self) -> f64 {
        let design_effect = self.fit.design_effect.max(other.fit.design_effect);
        self.evidence_under(design_effect) - other.evidence_under(design_effect)
    }

    /// The age of the readings, s, of a mistake of the clock.
    fn age_s(&self) -> Option<f64> {
        match self.mistake {
            Mistake::Clock { age_s } => Some(age_s),
            _ => None,
        }
    }

    /// Whether it says that all encoders count the other way.
    fn turns_all_signs(&self) -> bool {
        matches!(&self.mistake, Mistake::Log(wiring) if wiring.signs.iter().all(|sign| *sign < 0))
    }
}

fn best(rivals: &[Rival]) -> Option<Rival> {
    rivals.iter().max_by(|a, b| a.evidence().total_cmp(&b.evidence())).cloned()
}

/// Of the wirings that explain the bends about as well as the best, the plainest: with the fewest turned signs, then the fewest moved columns,
/// then the smallest shift.
fn plainest_of_the_best(rivals: &[Rival]) -> Option<Rival> {
    let best = best(rivals)?;
    let odd = |rival: &Rival| match &rival.mistake {
        Mistake::Log(wiring) => (
            wiring.signs.iter().filter(|sign| **sign < 0).count(),
            wiring.columns.iter().enumerate().filter(|(i, column)| **column != i + 1).count(),
            wiring.index_shift.unsigned_abs(),
        ),
        _ => Default::default(),
    };
    let as_good = rivals.iter().filter(|rival| best.ahead_of(rival) <= -LEVEL_OF_TESTS.ln());
    as_good.min_by(|a, b| odd(a).cmp(&odd(b)).then(b.evidence().total_cmp(&a.evidence()))).cloned()
}

/// All orders and signs of the columns, each with all shifts of the rows; but for the log as it is.
fn of_the_log(samples: &Samples, poses: &[Pose], log: &[EncoderReading]) -> Vec<Rival> {
    let backbones = samples.backbones();
    let (orders, shifts) = (signed_permutations(backbones), shifts(poses, log));
    let mut rivals = Vec::new();
    for &shift in &shifts {
        let common = samples.with_readings_at_both(shift);
        let straight = Candidate::straight(backbones);
        let Some(as_it_is) = common.fit(&straight, Freedom::Gain) else { continue };
        for (columns, signs) in &orders {
            let wiring = Wiring { columns: columns.clone(), signs: signs.clone(), scale: 1.0, index_shift: shift };
            let kinds = if shift == 0 { 1 } else { shifts.len() };
            let is_order = *columns != straight.columns || signs.iter().any(|sign| *sign < 0);
            let of_kind = kinds * if is_order { orders.len() } else { 1 };
            let candidate = Candidate { columns: columns.clone(), signs: signs.clone(), shift };
            if let Some(fit) = common.fit(&candidate, Freedom::Gain).filter(|_| !wiring.is_straight()) {
                let (gained, cost) = (fit.log_likelihood - as_it_is.log_likelihood, (of_kind as f64).ln());
                let internal_mm = common.internal_spread_mm(&candidate);
                rivals.push(Rival { mistake: Mistake::Log(wiring), internal_mm, fit, gained, cost });
            }
        }
    }
    rivals
}

/// A wiring of columns and signs that the bends do not rule out, by what tells for it, where there is one: the one that explains them best.
fn undecided(rivals: &[Rival], evidence: impl Fn(&Rival) -> f64) -> Option<Wiring> {
    let of_columns = rivals.iter().filter_map(|rival| match &rival.mistake {
        Mistake::Log(wiring) if wiring.index_shift == 0 => Some((evidence(rival), wiring)),
        _ => None,
    });
    let (evidence, wiring) = of_columns.max_by(|a, b| a.0.total_cmp(&b.0))?;
    (evidence > LEVEL_OF_TESTS.ln()).then(|| wiring.clone())
}

/// Every view's azimuth turned by any angle, and running the other way round.
fn of_views(samples: &Samples) -> Vec<Rival> {
    let straight = Candidate::straight(samples.backbones());
    let mut rivals = Vec::new();
    let views = samples.views();
    for view in &views {
        let own = samples.of_view(view);
        let Some(as_it_is) = own.fit(&straight, Freedom::Gain) else { continue };
        for mirrored in [false, true] {
            let own = if mirrored { own.mirrored() } else { own.clone() };
            let Some(fit) = own.fit(&straight, Freedom::GainAndTurn) else { continue };
            let gained = fit.log_likelihood - as_it_is.log_likelihood;
            // b = (turn of u), so that δ as seen is the true one and the turn; it is to be taken off.
            let turn = -fit.gain.y.atan2(fit.gain.x);
            let mistake = Mistake::View { view: view.clone(), turn, mirrored };
            let cost = (2.0 * views.len() as f64).ln() + cost_of_turn(fit.sd_gain / fit.gain.norm());
            rivals.push(Rival { mistake, internal_mm: 0.0, fit, gained, cost });
        }
    }
    rivals
}

/// What a turn costs that the bends tell to within a standard deviation, rad: any azimuth is as likely as any other beforehand, so that this is the
/// logarithm of how much narrower the bends leave it, by Laplace's method.
fn cost_of_turn(sd: f64) -> f64 {
    (TAU.sqrt() / sd).ln().max(0.0)
}

/// Lags between readings and frames, by interpolation in time.
fn of_the_clock(samples: &Samples) -> Vec<Rival> {
    let straight = Candidate::straight(samples.backbones());
    let lags = lags(samples);
    let mut rivals = Vec::new();
    for &age_s in &lags {
        let Some((common, shifted)) = samples.at_times_later_by(age_s) else { continue };
        let fits = common.fit(&straight, Freedom::Gain).zip(shifted.fit(&straight, Freedom::Gain));
        let Some((unshifted, fit)) = fits else { continue };
        let (gained, cost) = (fit.log_likelihood - unshifted.log_likelihood, (lags.len() as f64).ln());
        rivals.push(Rival { mistake: Mistake::Clock { age_s }, internal_mm: 0.0, fit, gained, cost });
    }
    rivals
}

#[cfg(test)]
mod tests;
