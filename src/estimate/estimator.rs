//! The recursive estimator: measurements in, one at a time, η and λ out.
//!
//! # How a measurement is judged
//!
//! 1. Not measured, without an encoder reading, not finite or outside the workspace: skipped.
//! 2. The first eight measurements are judged together, after each of them: the pair whose estimate the majority agrees
//!    with best (least trimmed squares over all pairs, then refined on its majority) decides who is an outlier. With two
//!    there is one pair: the paper's first estimate. So a bad first pair is found out by the next ones.
//! 3. From then on the recursion of Eq. 19 runs, and a measurement whose residual is farther from the prediction than
//!    [`Options::gate`] standard deviations is rejected: in the bending part (θ or δ are wrong) or in the common part (the
//!    encoders are). Sigmas may promise too much and the model may lack an effect, so distances are in units of the
//!    typical one: the median over the last 51 measurements, rejected or not, where that is above its nominal value.
//!    For the common part, which encoders tell to a micron, the model is not trusted to better than 0.02 mm: effects of
//!    that size are what a later search is to find, and it cannot find them in measurements thrown away here.
//! 4. Eight rejected in a row, of which six agree with each other, mean that the estimate and not the measurements went
//!    wrong (another tool, a re-homed actuator): the estimate starts afresh from these.
//!
//! # What the reported covariance holds
//!
//! The rows' own (Eq. 21 with V_v measured rather than assumed), inflated by what the residuals show
//! ([`Consistency`](super::Consistency)), plus what the friction constants' own uncertainty shifts: a wrong f_s moves λ,
//! a wrong μ scales η, and no number of measurements averages that away.

use super::consistency::Whitened;
use super::{Consistency, EstimateRow, EtaLambda, Filter, Row, Verdict, Weighting, pairs_without_effects};
use crate::error::{ArgumentError, Result};
use crate::observation::{EncoderReading, Measured, Measurement, Status};
use crate::robot::{Estimate, MAX_THETA, Model, PerBackbone};
use nalgebra::{Matrix2, Vector2};
use std::collections::VecDeque;
use std::fmt;

/// Measurements that are judged together, at the start and before a fresh start.
const JURY: usize = 8;
/// How many of them must agree for a fresh start.
const AGREEING: usize = 6;
/// Measurements over which the gate takes its typical distance.
const RECENT: usize = 51;
/// No snake's encoders read more, mm: a slip of units, or a broken file.
const MOST_Q_MM: f64 = 1e3;
/// How far the model is trusted in the part common to all backbones when outliers are sought, mm.
const COMMON_TRUST_MM: f64 = 0.02;
/// Rounds in which η and what effects do with it find each other.
const ROUNDS: usize = 3;
/// Medians of χ² with 2 and 1 degrees of freedom.
const NOMINAL_MEDIANS: [f64; 2] = [1.386_294, 0.454_936];

/// How the estimator works.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// How measurements are weighted.
    pub weighting: Weighting,
    /// Standard deviation of an encoder reading, mm.
    pub sd_encoder_mm: f64,
    /// Fading memory: the share of all earlier information kept at each measurement, in (0, 1]; 1 forgets nothing.
    pub keep: f64,
    /// Standard deviations beyond which a measurement is an outlier; infinity accepts all. At 4.5 one good measurement
    /// in 20,000 is rejected.
    pub gate: f64,
}

impl Default for Options {
    /// Each measurement's own sigmas, encoders good to 1.5 µm, nothing forgotten, a gate at 4.5 standard deviations.
    fn default() -> Self {
        Self { weighting: Weighting::Measured, sd_encoder_mm: 0.0015, keep: 1.0, gate: 4.5 }
    }
}

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

/// A verdict on an earlier measurement that a later one overturned.
#[derive(Debug, Clone, PartialEq)]
pub struct Revision {
    /// Which one, counted in calls of [`Estimator::update`] from 0.
    pub update: usize,
    /// `None` if it is used after all.
    pub reason: Option<Reason>,
}

/// What one measurement did.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// What became of it.
    pub verdict: Verdict,
    /// Why it was not used.
    pub reason: Option<Reason>,
    /// The estimate after it; `None` while measurements do not pin both parameters.
    pub estimate: Option<Estimate>,
    /// Measured ε less what the estimate before it predicted, per backbone, mm; `None` before the first estimate.
    pub residual_mm: Option<PerBackbone>,
    /// The innovation: what the estimate before it did not predict, whitened by the predicted covariance; `None` while the first
    /// measurements are judged together.
    pub innovation: Option<Whitened>,
    /// Earlier verdicts that this measurement changed.
    pub revisions: Vec<Revision>,
    /// Whether the estimate started afresh, leaving all measurements before the last eight behind.
    pub restarted: bool,
}

/// A measurement that can be used.
#[derive(Debug, Clone, Copy)]
struct Sample {
    update: usize,
    measured: Measured,
    q_tilde: PerBackbone,
    reported_used: bool,
}

/// What a few measurements say together, and which of them do not belong.
struct Judgement {
    filter: Filter,
    x: Vector2<f64>,
    covariance: Matrix2<f64>,
    rows: Vec<Row>,
    outliers: Vec<Option<Reason>>,
}

impl Judgement {
    fn agreeing(&self) -> impl Iterator<Item = &Row> {
        self.rows.iter().zip(&self.outliers).filter(|(_, outlier)| outlier.is_none()).map(|(row, _)| row)
    }
}

/// The recursive estimator of η and λ.
#[derive(Debug, Clone)]
pub struct Estimator {
    /// The model, with the estimate as it stands.
    model: Model,
    options: Options,
    updates: usize,
    /// `None` until the first jury has decided.
    running: Option<(Filter, Consistency)>,
    /// The jury: the first measurements, or those rejected in a row since the last one used.
    jury: Vec<Sample>,
    /// Squared distances (bending, common) of the last measurements.
    recent: Vec<[f64; 2]>,
}

impl Estimator {
    /// Starts with nothing known of η and λ; an estimate that the model already has is not used, since it may come from
    /// the very measurements to follow.
    ///
    /// # Errors
    /// [`ArgumentError::OutOfRange`] for an option out of its range.
    pub fn new(model: &Model, options: Options) -> Result<Self> {
        let wrong = |quantity: &str, value, unit, expected: &str| {
            Err(ArgumentError::out_of_range(quantity, value, unit, expected).into())
        };
        if !(options.sd_encoder_mm > 0.0 && options.sd_encoder_mm <= 10.0) {
            return wrong("encoder noise", options.sd_encoder_mm, " mm", "above 0 and at most 10");
        }
        if !(options.keep > 0.0 && options.keep <= 1.0) {
            return wrong("the memory's share", options.keep, "", "above 0 and at most 1 (1 forgets nothing)");
        }
        if options.gate.is_nan() || options.gate < 1.0 {
            return wrong("the gate", options.gate, " standard deviations", "1 or more");
        }
        if let Weighting::Flat { sigma_deg } = options.weighting
            && !(sigma_deg > 0.0 && sigma_deg <= 90.0)
        {
            return wrong("the flat sigma", sigma_deg, "°", "above 0 and at most 90");
        }
        let model = Model { estimate: None, ..model.clone() };
        Ok(Self { model, options, updates: 0, running: None, jury: Vec::new(), recent: Vec::new() })
    }

    /// The model with the estimate as it stands.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// How residuals compare with their promised covariances; `None` while the first measurements are being judged.
    pub fn consistency(&self) -> Option<&Consistency> {
        self.running.as_ref().map(|(_, consistency)| consistency)
    }

    /// How many of the first measurements have a verdict that no later one can change.
    pub fn settled(&self) -> usize {
        self.jury.first().map_or(self.updates, |sample| sample.update)
    }

    /// Takes one measurement and the encoder reading of the same index.
    pub fn update(&mut self, measurement: &Measurement, reading: Option<&EncoderReading>) -> Step {
        let update = self.updates;
        self.updates += 1;
        match usable(self.model.robot.backbone_count(), measurement, reading) {
            Ok((measured, q_tilde)) => self.judge(Sample { update, measured, q_tilde, reported_used: true }),
            Err(reason) => Step {
                verdict: Verdict::Skipped,
                reason: Some(reason),
                estimate: self.model.estimate,
                residual_mm: None,
                innovation: None,
                revisions: Vec::new(),
                restarted: false,
            },
        }
    }

    fn judge(&mut self, sample: Sample) -> Step {
        let row = self.row(&self.model, &sample);
        let mut step = Step {
            verdict: Verdict::Used,
            reason: None,
            estimate: None,
            residual_mm: self.model.estimate.map(|_| self.residual_mm(&sample, &row)),
            innovation: None,
            revisions: Vec::new(),
            restarted: false,
        };
        step.reason = match self.running {
            None => self.first_measurement(sample, &mut step),
            Some((filter, consistency)) => self.next_measurement(filter, consistency, sample, &row, &mut step),
        };
        if step.reason.is_some() {
            step.verdict = Verdict::Rejected;
        }
        step.estimate = self.model.estimate;
        step
    }

    /// One of the first measurements: the jury sits anew, and decides for good once it is complete.
    fn first_measurement(&mut self, sample: Sample, step: &mut Step) -> Option<Reason> {
        self.summon(sample);
        let judgement = self.deliberate()?;
        step.revisions = self.announce(&judgement);
        let own = judgement.outliers.last().cloned().flatten();
        if self.jury.len() == JURY {
            self.run_from(judgement);
        } else {
            let consistency = Consistency::of_fit(&judgement.x, judgement.agreeing());
            self.publish(&judgement.filter, &consistency);
        }
        own
    }

    /// Eq. 19 for one more measurement, behind the gate; a fresh start where the measurements rejected in a row agree.
    fn next_measurement(
        &mut self,
        mut filter: Filter,
        mut consistency: Consistency,
        sample: Sample,
        row: &Row,
        step: &mut Step,
    ) -> Option<Reason> {
        let judged = filter.solution().and_then(|(x, covariance)| {
            Some((self.whitened(row, &x, &covariance)?, self.distances(row, &x, &covariance)?))
        });
        let Some((whitened, distances)) = judged else { return Some(Reason::NotFinite) };
        step.innovation = Some(whitened);
        let outlier = self.outlier(&distances, &self.recent);
        self.remember(distances);
        if outlier.is_some() {
            self.summon(Sample { reported_used: false, ..sample });
            let fresh = if self.jury.len() == JURY { self.deliberate() } else { None };
            let Some(judgement) = fresh.filter(|judgement| judgement.agreeing().count() >= AGREEING) else {
                return outlier;
            };
            step.revisions = self.announce(&judgement);
            step.restarted = true;
            let own = judgement.outliers.last().cloned().flatten();
            self.run_from(judgement);
            return own;
        }
        self.jury.clear();
        if self.options.keep < 1.0 {
            filter.fade(self.options.keep);
            consistency.fade(self.options.keep);
        }
        filter.absorb(row);
        consistency.add(&whitened);
        self.publish(&filter, &consistency);
        self.running = Some((filter, consistency));
        None
    }

    /// Seats a measurement in the jury; in a full one the earliest makes room.
    fn summon(&mut self, sample: Sample) {
        if self.jury.len() == JURY {
            self.jury.remove(0);
        }
        self.jury.push(sample);
    }

    /// The jury's verdicts on its earlier members that differ from those reported before. The latest gets its own now.
    fn announce(&mut self, judgement: &Judgement) -> Vec<Revision> {
        let mut revisions = Vec::new();
        for (sample, outlier) in self.jury.iter_mut().zip(&judgement.outliers) {
            if sample.reported_used != outlier.is_none() && sample.update + 1 != self.updates {
                revisions.push(Revision { update: sample.update, reason: outlier.clone() });
            }
            sample.reported_used = outlier.is_none();
        }
        revisions
    }

    /// Begins the recursion with what a jury found.
    fn run_from(&mut self, judgement: Judgement) {
        let consistency = Consistency::of_fit(&judgement.x, judgement.agreeing());
        self.jury.clear();
        self.recent.clear();
        for row in &judgement.rows {
            if let Some(distances) = self.distances(row, &judgement.x, &judgement.covariance) {
                self.remember(distances);
            }
        }
        self.publish(&judgement.filter, &consistency);
        self.running = Some((judgement.filter, consistency));
    }

    /// Judges the jury's members by each other; `None` while they do not pin both parameters.
    fn deliberate(&self) -> Option<Judgement> {
        // Weights need an η; that of the naive model does for a first vote, that of the vote for the verdict.
        let naive = Model { estimate: None, ..self.model.clone() };
        let first = self.vote(&self.jury.iter().map(|sample| self.row(&naive, sample)).collect::<Vec<_>>())?;
        let voted = Estimate { eta: first.x.x, lambda_mm: first.x.y, covariance: first.covariance, samples: 0 };
        if voted.eta <= 0.0 {
            return Some(first);
        }
        let informed = Model { estimate: Some(voted), ..naive };
        let rows: Vec<Row> = self.jury.iter().map(|sample| self.row(&informed, sample)).collect();
        self.vote(&rows).or(Some(first))
    }

    /// Least trimmed squares: which rows agree, and on what.
    fn vote(&self, rows: &[Row]) -> Option<Judgement> {
        let majority = rows.len() / 2 + 1;
        let pairs = (0..rows.len()).flat_map(|j| (0..j).map(move |i| [i, j]));
        let candidates = pairs.filter_map(|pair| {
            let mut members = pair.to_vec();
            let mut best = None;
            // Two refinements on the majority; each can only lower the trimmed sum.
            for _ in 0..3 {
                let (x, _) = Filter::of(members.iter().map(|&i| &rows[i])).solution()?;
                let mut misfits: Vec<(f64, usize)> =
                    rows.iter().enumerate().map(|(i, row)| (misfit(row, &x), i)).collect();
                misfits.sort_by(|a, b| a.0.total_cmp(&b.0));
                misfits.truncate(majority);
                best = Some((misfits.iter().map(|(misfit, _)| misfit).sum::<f64>(), x));
                members = misfits.into_iter().map(|(_, i)| i).collect();
            }
            best.map(|(trimmed, _)| (trimmed, members))
        });
        let (_, mut members) = candidates.min_by(|a, b| a.0.total_cmp(&b.0))?;
        if rows.len() == 2 {
            members = vec![0, 1];
        }
        let mut outliers = vec![None; rows.len()];
        // Those within the gate of the majority's estimate join it, and the gate is asked once more.
        for _ in 0..2 {
            let (x, covariance) = Filter::of(members.iter().map(|&i| &rows[i])).solution()?;
            let distances: Vec<_> = rows.iter().map(|row| self.distances(row, &x, &covariance)).collect();
            let others: Vec<_> = distances.iter().flatten().copied().collect();
            for (outlier, distances) in outliers.iter_mut().zip(&distances) {
                *outlier = match distances {
                    Some(distances) if rows.len() > 2 => self.outlier(distances, &others),
                    Some(_) => None,
                    None => Some(Reason::NotFinite),
                };
            }
            members = (0..rows.len()).filter(|&i| outliers[i].is_none()).collect();
        }
        let filter = Filter::of(members.iter().map(|&i| &rows[i]));
        let (x, covariance) = filter.solution()?;
        Some(Judgement { filter, x, covariance, rows: rows.to_vec(), outliers })
    }

    /// The gate: whether a residual is too far off, in units of the typical distance where that is above nominal.
    fn outlier(&self, squared: &[f64; 2], others: &[[f64; 2]]) -> Option<Reason> {
        let gate = self.options.gate;
        let beyond = |part: usize| {
            // What is typical counts at least 1: within the gate without it is within the gate.
            if squared[part].sqrt() <= gate {
                return None;
            }
            let typical = (median(others.iter().map(|d| d[part])) / NOMINAL_MEDIANS[part]).max(1.0);
            Some((squared[part] / typical).sqrt()).filter(|distance| *distance > gate)
        };
        beyond(0).map(Reason::BendOutlier).or_else(|| beyond(1).map(Reason::CommonOutlier))
    }

    fn remember(&mut self, squared: [f64; 2]) {
        if self.recent.len() == RECENT {
            self.recent.remove(0);
        }
        self.recent.push(squared);
    }

    /// The residual of a row that had no part in x, whitened by its predicted covariance.
    fn whitened(&self, row: &Row, x: &Vector2<f64>, covariance: &Matrix2<f64>) -> Option<Whitened> {
        let predicted = row.h * covariance * row.h.transpose() + row.covariance;
        Whitened::new(&row.residual(x), &predicted)
    }

    /// Squared distances (bending, common) of a row from its prediction, as the gate sees them.
    fn distances(&self, row: &Row, x: &Vector2<f64>, covariance: &Matrix2<f64>) -> Option<[f64; 2]> {
        let whitened = self.whitened(&trusted(row), x, covariance)?;
        Some([whitened.bending.norm_squared(), whitened.common.powi(2)])
    }

    /// Measured ε less what the estimate predicts, per backbone, mm.
    fn residual_mm(&self, sample: &Sample, row: &Row) -> PerBackbone {
        let robot = &self.model.robot;
        let told = row.residual(&self.model.parameters());
        // What a row leaves out of the readings, and what it says of them.
        robot.from_bend_and_common(&(told - robot.bend_and_common(&sample.q_tilde))) + sample.q_tilde
    }

    fn row(&self, model: &Model, sample: &Sample) -> Row {
        let Options { weighting, sd_encoder_mm, .. } = self.options;
        Row::new(model, weighting, sd_encoder_mm, &sample.measured, &sample.q_tilde)
    }

    /// Makes a filter's estimate the model's, with its honest covariance.
    fn publish(&mut self, filter: &Filter, consistency: &Consistency) {
        let Some((x, covariance)) = filter.solution() else { return };
        let covariance = consistency.inflate(&covariance) + friction_covariance(&self.model, x.x);
        self.model.estimate = Some(Estimate {
            eta: x.x,
            lambda_mm: x.y,
            // Rounding leaves the last digits of the two halves apart.
            covariance: (covariance + covariance.transpose()) / 2.0,
            samples: filter.rows(),
        });
    }
}

/// Covariance of (η, λ) that comes from the friction constants' own.
///
/// The measurements pin ηκ(μ) and λ + K_c⁻¹e^{2μφ}f_s; an error of μ or f_s moves η and λ so that these stay.
fn friction_covariance(model: &Model, eta: f64) -> Matrix2<f64> {
    let by_friction = parameters_by_friction(model, eta);
    by_friction * model.friction.covariance() * by_friction.transpose()
}

/// ∂(η, λ)/∂(μ, f_s) along which the measurements stay as they are.
pub(super) fn parameters_by_friction(model: &Model, eta: f64) -> Matrix2<f64> {
    let phi = model.robot.line.cone_bend_angle();
    let capstan = model.friction.capstan_factor(phi) * model.robot.cone_compliance_mm_per_n();
    let static_mm = model.static_friction_mm();
    Matrix2::new(-eta * 2.0 * phi * capstan / model.line_compliance_mm_per_n(), 0.0, -2.0 * phi * static_mm, -capstan)
}

/// What a measurement and its reading hold, on a robot of so many backbones, if all of it can be used.
pub(super) fn usable(
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
    let Measured { configuration, sigma_theta, sigma_delta, correlation } = measured;
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

/// A row with no more trust in the model's common part than it deserves.
fn trusted(row: &Row) -> Row {
    // λ's column of H: a mm in every backbone.
    let common = row.h.column(1) * COMMON_TRUST_MM;
    Row { covariance: row.covariance + common * common.transpose(), ..*row }
}

/// rᵗR⁻¹r of a row at x; infinite where R is not positive definite.
fn misfit(row: &Row, x: &Vector2<f64>) -> f64 {
    let residual = row.residual(x);
    trusted(row).covariance.cholesky().map_or(f64::INFINITY, |factor| residual.dot(&factor.solve(&residual)))
}

/// The median; 0 of nothing.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// Estimates η and λ from all measurements, in order, each with the encoder reading of its index.
///
/// Gives the rows of estimate.csv, with verdicts as they stood at the end, and the model with its estimate (the model
/// as it was given, less an estimate it had, where the measurements do not pin one). What the model's effects do is
/// taken off first and stays in the model.
///
/// # Errors
/// [`ArgumentError::OutOfRange`] for an option out of its range.
pub fn estimate(
    model: &Model,
    options: Options,
    measurements: &[Measurement],
    readings: &[EncoderReading],
) -> Result<(Vec<EstimateRow>, Model)> {
    let mut rows = Vec::with_capacity(measurements.len());
    let all = || Ok(measurements.iter().cloned().map(Ok));
    let model = estimate_each(model, options, all, readings, |row| {
        rows.push(row);
        Ok(())
    })?;
    Ok((rows, model))
}

/// [`estimate`] of measurements that need not be in memory: `measurements` goes through them, more than once where the model has
/// effects, and `each` is given the rows of estimate.csv, in order, as soon as no later measurement can change their verdict.
///
/// # Errors
/// [`ArgumentError::OutOfRange`] for an option out of its range; what `measurements` and `each` give.
pub fn estimate_each<I: Iterator<Item = Result<Measurement>>>(
    model: &Model,
    options: Options,
    measurements: impl Fn() -> Result<I>,
    readings: &[EncoderReading],
    each: impl FnMut(EstimateRow) -> Result<()>,
) -> Result<Model> {
    let mut start = model.clone();
    if start.estimate.is_none() && !start.effects.is_empty() {
        // What effects do hangs on η, which is known only once they are taken off.
        for _ in 0..ROUNDS {
            start.estimate = one_round(&start, options, measurements()?, readings, |_| Ok(()))?.estimate;
        }
    }
    one_round(&start, options, measurements()?, readings, each)
}

/// [`estimate_each`], with the effects as they act under the model's own η and λ.
fn one_round(
    model: &Model,
    options: Options,
    measurements: impl Iterator<Item = Result<Measurement>>,
    readings: &[EncoderReading],
    mut each: impl FnMut(EstimateRow) -> Result<()>,
) -> Result<Model> {
    let mut estimator = Estimator::new(&model.plain(), options)?;
    // The rows whose verdict may still change, and how many came before them.
    let (mut open, mut settled) = (VecDeque::new(), 0);
    for pair in pairs_without_effects(model, measurements, readings)? {
        let (measurement, reading) = pair?;
        let step = estimator.update(&measurement, reading.as_ref());
        for Revision { update, reason } in step.revisions {
            let row: &mut EstimateRow = &mut open[update - settled];
            row.verdict = if reason.is_none() { Verdict::Used } else { Verdict::Rejected };
            row.reason = reason.map(|reason| reason.to_string()).unwrap_or_default();
        }
        open.push_back(EstimateRow {
            index: measurement.index,
            time_s: measurement.time_s,
            estimate: step.estimate.map(|estimate| EtaLambda {
                eta: estimate.eta,
                lambda_mm: estimate.lambda_mm,
                sd_eta: estimate.sd_eta(),
                sd_lambda_mm: estimate.sd_lambda_mm(),
            }),
            verdict: step.verdict,
            reason: step.reason.map(|reason| reason.to_string()).unwrap_or_default(),
            residual_mm: step.residual_mm,
            view: measurement.view,
        });
        for row in open.drain(..estimator.settled() - settled) {
            each(row)?;
        }
        settled = estimator.settled();
    }
    open.into_iter().try_for_each(each)?;
    Ok(model.with_estimate(estimator.model.estimate))
}
