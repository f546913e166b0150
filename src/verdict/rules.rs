//! The rules of the verdict. Each is a test of a hypothesis: how probable is what was seen, were all in order?

use super::encoders::{camera_stuck, stuck};
use super::evidence::{Evidence, Subject};
use super::health::Health;
use super::inputs::nothing_to_judge;
use super::reason::{Code, Level, Reason, Verdict};
use super::scale::{PLAUSIBLE_ETA, angles_are_radians};
use super::wiring::{self, Mistake, WiringCheck};
use super::words;
use crate::estimate::{NewPoses, PlainSample, Replaced};
use crate::geometry::Configuration;
use crate::observation::{EncoderReading, commonest_status};
use crate::robot::Model;
use crate::robot::data_range::ASKED_FOR;
use crate::statistics::binomial;
use nalgebra::Matrix2;
use std::f64::consts::PI;

/// The probability with which each rule speaks although all is in order.
///
/// Convention: about ten rules make one false word in a hundred runs.
pub const LEVEL_OF_TESTS: f64 = 0.001;
/// The normal distribution's quantile of it.
///
/// Derived: Φ⁻¹(0.999).
pub(in crate::verdict) const NORMAL_QUANTILE: f64 = 3.090_232;
/// Share of frames that may fail, or be rejected, although all is in order.
///
/// Convention: reflections, tools and hands that pass the camera.
pub const REJECTED_IN_ORDER: f64 = 0.1;
/// Mean square of whitened residuals that is still called noise, where 1 is noise.
///
/// Convention: the smallest gap worth a search, 1.2 times the noise in rms (√(2.5 − 1)); sigmas that are too small by 1.6, and effects that
/// size, raise no alarm.
pub const MEAN_SQUARE_OF_NOISE: f64 = 2.5;
/// A snake that bends no further than so many standard deviations of θ does not bend.
///
/// Derived: as where the estimator takes a bend for straight (`TOLD_FROM_STRAIGHT_SD`): noise is 1 % of what H² grows to from there on.
const STRAIGHT_SDS: f64 = 10.0;
/// A bend at rest is along the camera's axis within an angle of this sine.
///
/// Convention: 10°; a bend at rest of any other cause points there by chance once in nine times.
const ALONG_THE_AXIS: f64 = 0.173_648;
/// So many frames in a row without a reading are not told. Convention: a logger that starts or stops within a frame of the camera.
const LEAST_LOST: usize = 1;
/// A shift of rows by less than this, in time, may be a late camera, s.
///
/// Convention: exposure, transfer and decoding of a picture take tenths of a second. Where a robot stops at each pose, the rows are further apart.
const LONGEST_LAG_S: f64 = 0.5;
/// The largest λ that robots have, mm. Convention: a play of a millimetre is a loose part.
pub const MOST_LAMBDA_MM: f64 = 1.0;

/// The verdict on what was collected.
pub(super) fn verdict(subject: &Subject, evidence: &Evidence, log: &[EncoderReading]) -> Verdict {
    // Nothing else can be said of angles in another unit.
    if let Some(radians) = radians(subject, evidence) {
        return Verdict::of(vec![radians]);
    }
    let no_bend = no_bend(evidence);
    let (stuck, check) = stuck_or_miswired(subject, evidence, log, no_bend.is_none());
    let health = Health::of(subject.model, subject.sd_encoder_mm, &evidence.samples);
    let is_wired = check.as_ref().is_none_or(|check| check.mistake.is_none());
    let of_gap = health.reasons(subject.model, stuck.is_none(), is_wired);
    let reasons = [
        stuck,
        check.as_ref().and_then(|check| words::wiring(subject, check)),
        nothing_to_judge(evidence, log),
        unmatched(evidence, log),
        without_readings(subject, evidence, log),
        backwards(log),
        not_measured(evidence),
        no_bend,
        out_of_range(subject.model),
        worse_than_naive(subject.model, evidence),
        rejected(subject),
        leading_nowhere(evidence),
        replaced(subject),
        not_covered(subject, evidence, check.as_ref()).or_else(|| uncertain_table(subject.model)),
        camera_lens(subject, evidence, check.as_ref().filter(|_| health.has_gap())),
    ];
    Verdict::of(reasons.into_iter().flatten().chain(of_gap).collect())
}

/// Encoders or a camera that stand still, and the wiring check, where something bends. Of few poses a wrong order of the columns may look
/// like a column that stands still: it is taken for that unless another wiring explains the bends to the noise.
fn stuck_or_miswired(
    subject: &Subject,
    evidence: &Evidence,
    log: &[EncoderReading],
    bends: bool,
) -> (Option<Reason>, Option<WiringCheck>) {
    let robot = &subject.model.robot;
    let stuck = stuck(robot, &evidence.samples).or_else(|| camera_stuck(robot, &evidence.samples));
    let check = bends.then(|| wiring::check(robot, subject.sd_encoder_mm, &evidence.poses, log)).flatten();
    let is_explained =
        |check: &WiringCheck| check.mistake.is_some() && check.misfit_corrected <= MEAN_SQUARE_OF_NOISE.sqrt();
    match stuck {
        Some(stuck) if !check.as_ref().is_some_and(is_explained) => (Some(stuck), None),
        _ => (None, check),
    }
}

/// What keeps physics from being named: encoders that stand still, or a log whose wiring differs from what it is read as. A lag, and a
/// shift of rows that does not explain the bends to the noise, may be physics as well, and are not reported. So may a shift that is no other than a lag,
/// if a camera or its driver may hold a picture for so long.
pub(super) fn wiring_mistake(subject: &Subject, evidence: &Evidence, log: &[EncoderReading]) -> Option<Reason> {
    let (stuck, check) = stuck_or_miswired(subject, evidence, log, no_bend(evidence).is_none());
    if stuck.is_some() {
        return stuck;
    }
    let check = check?;
    let may_be_physics = match &check.mistake {
        Some(Mistake::Clock { .. }) => true,
        Some(mistake) if mistake.shifts_rows_alone() => {
            let is_lag = check.as_a_lag_s.is_some_and(|age_s| age_s.abs() <= LONGEST_LAG_S);
            is_lag || check.misfit_corrected > MEAN_SQUARE_OF_NOISE.sqrt()
        }
        _ => false,
    };
    if may_be_physics { None } else { words::wiring(subject, &check) }
}

/// Whether something happened more often than with a probability `p`, at the level of the tests.
fn more_often(times: usize, of: usize, p: f64) -> bool {
    of > 0 && binomial::at_least(times, of, p) < LEVEL_OF_TESTS
}

/// Samples whose bend has moved on since the last one taken.
pub(super) fn new_poses(samples: &[PlainSample]) -> impl Iterator<Item = &PlainSample> {
    let mut poses = NewPoses::default();
    samples.iter().filter(move |sample| poses.is_new(sample.measured.configuration.bend_vector()))
}

/// Angles in radians in columns of degrees.
fn radians(subject: &Subject, evidence: &Evidence) -> Option<Reason> {
    angles_are_radians(subject.model, &evidence.samples).then(|| {
        let largest = evidence.samples.iter().map(|s| s.measured.configuration.theta_deg()).fold(0.0, f64::max);
        let text = format!(
            "the angles are radians in columns of degrees: no theta_deg is above {largest:.2}, and all follow the bends that the encoders \
             imply, in radians"
        );
        let remedy = "multiply theta_deg, delta_deg and their sigmas in measurements.csv by 180/π = 57.29578";
        Reason::new(Code::ParameterOutOfRange, Level::DoNotUse, text, remedy)
    })
}

/// Frames and log that have no index in common.
fn unmatched(evidence: &Evidence, log: &[EncoderReading]) -> Option<Reason> {
    let (first, last) = (log.first()?, log.last()?);
    let (from, to) = (evidence.poses.first()?, evidence.poses.last()?);
    (evidence.with_reading == 0).then(|| {
        let text = format!(
            "no frame has a reading: frames {} to {} were measured, and the log has the indices {} to {}",
            from.index, to.index, first.index, last.index
        );
        /// Indices from here on are times. Convention: Unix times have ten digits in seconds, and no camera counts so far.
        const LEAST_TIME: u64 = 1_000_000_000;
        let shift = first.index as i64 - from.index as i64;
        let remedy = match from.index {
            LEAST_TIME.. => "the frames are named by their times: match the log by time (under [log] of experiment.toml name the column of `time` \
                             and leave `index` out), or number its rows as the frames are"
                .to_owned(),
            _ => format!(
                "number the log as the frames are; if its first row belongs to the first frame, write index_shift = {shift} under \
                 [wiring] of experiment.toml"
            ),
        };
        Reason::new(Code::Wiring, Level::DoNotUse, text, remedy)
    })
}

/// Measured frames in a row without a reading: a log that was cut, or a logger that stopped. As many as it is shifted by are meant so.
fn without_readings(subject: &Subject, evidence: &Evidence, log: &[EncoderReading]) -> Option<Reason> {
    let Evidence { measured, with_reading, gap, .. } = *evidence;
    let shifted = subject.wiring.index_shift.unsigned_abs() as usize;
    let (first, last) = (log.first()?, log.last()?);
    let is_lost = gap.frames > LEAST_LOST.max(shifted) && gap.frames as f64 > REJECTED_IN_ORDER * measured as f64;
    (with_reading > 0 && is_lost).then(|| {
        let text = format!(
            "{} of {measured} measured frames have no reading, and nothing was learned from them: {} in a row, frames {} to {}; the log has {} \
             rows with the indices {} to {}",
            measured - with_reading,
            gap.frames,
            gap.from,
            gap.to,
            log.len(),
            first.index,
            last.index
        );
        let remedy = "look whether the log was cut or the logger stopped: copy it whole, or measure again; what was bent in these frames alone \
                      is not learned";
        Reason::new(Code::Files, Level::Look, text, remedy)
    })
}

/// Time stamps that do not increase.
fn backwards(log: &[EncoderReading]) -> Option<Reason> {
    let mut steps = log.windows(2).filter(|pair| pair[1].time_s <= pair[0].time_s);
    let first = steps.next()?;
    // A log without times has the same everywhere.
    if log.iter().all(|row| row.time_s == first[0].time_s) {
        return None;
    }
    let text = format!(
        "the log's time does not increase from index {} to {} ({} s to {} s){}",
        first[0].index,
        first[1].index,
        first[0].time_s,
        first[1].time_s,
        match steps.count() {
            0 => String::new(),
            more => format!(", nor in {more} other places"),
        }
    );
    let remedy = "find out which clock stamps the log and whether it was set back; sort out the rows, or log anew";
    Some(Reason::new(Code::Clock, Level::Look, text, remedy))
}

/// Frames that could not be measured.
fn not_measured(evidence: &Evidence) -> Option<Reason> {
    let Evidence { frames, measured, ref statuses, .. } = *evidence;
    let failed = frames - measured;
    if !more_often(failed, frames, REJECTED_IN_ORDER) && (measured > 0 || frames == 0) {
        return None;
    }
    let level = if measured == 0 { Level::DoNotUse } else { Level::Look };
    let of = |words: &[&str]| -> usize { words.iter().filter_map(|word| statuses.get(*word)).sum() };
    let why: Vec<String> =
        statuses.iter().filter(|(word, _)| *word != "ok").map(|(word, count)| format!("{word} {count}")).collect();
    let text = format!("{failed} of {frames} frames could not be measured ({})", why.join(", "));
    let moved = of(&["camera_moved", "base_moved", "grid_lost"]);
    if 2 * moved > failed {
        // What is so from the first frame to the last may have been so in the straight picture.
        let dimensions = if moved == frames {
            "; if neither moved, compare length, disks and tool in the robot's file with the snake"
        } else {
            ""
        };
        let remedy = format!(
            "camera or base moved: take a new picture of the straight snake, or let `--follow` find the camera anew in every frame{dimensions}"
        );
        return Some(Reason::new(Code::RigDrift, level, text, remedy));
    }
    let told = commonest_status(statuses).map(|told| format!("{told}. ")).unwrap_or_default();
    let remedy =
        format!("{told}`snakeloop measure EXPERIMENT --explain INDEX -o OUT` shows why a frame failed, stage by stage");
    Some(Reason::new(Code::ManyNotMeasured, level, text, remedy))
}

/// A snake that stays straight tells nothing of η.
fn no_bend(evidence: &Evidence) -> Option<Reason> {
    let bent = |sample: &&PlainSample| {
        sample.measured.configuration.theta > STRAIGHT_SDS * sample.measured.sigma_theta.max(f64::MIN_POSITIVE)
    };
    if evidence.samples.is_empty() || evidence.samples.iter().any(|sample| bent(&sample)) {
        return None;
    }
    let most = evidence.samples.iter().map(|sample| sample.measured.configuration.theta_deg()).fold(0.0, f64::max);
    let text = format!("nothing bends: the largest bend is {most:.2}°, which is noise");
    let remedy = "bend the snake, as far as it is to be used and in at least two planes; check that the frames and the log are of \
                  the same run";
    Some(Reason::new(Code::WorkspaceNotCovered, Level::DoNotUse, text, remedy))
}

/// η and λ where no robot has them: red if they are no robot's at all, amber if their σ leaves no usual value.
fn out_of_range(model: &Model) -> Option<Reason> {
    let estimate = model.estimate()?;
    let remedy = "check units and radii in the robot's file and the unit of the log; if both are right, the line yields in another way \
                  than the model says: `snakeloop discover`";
    if let Some(text) = estimate.implausible() {
        return Some(Reason::new(Code::ParameterOutOfRange, Level::DoNotUse, text, remedy));
    }
    let (eta, lambda) = (estimate.eta, estimate.lambda_mm);
    let (reach_eta, reach_lambda) = (NORMAL_QUANTILE * estimate.sd_eta(), NORMAL_QUANTILE * estimate.sd_lambda_mm());
    let text = if eta + reach_eta < *PLAUSIBLE_ETA.start() || eta - reach_eta > *PLAUSIBLE_ETA.end() {
        format!("η = {eta:.3} ± {:.3}, and such robots have one third to three", estimate.sd_eta())
    } else if lambda + reach_lambda < 0.0 || lambda - reach_lambda > MOST_LAMBDA_MM {
        let sd = estimate.sd_lambda_mm();
        format!("λ = {lambda:.3} ± {sd:.3} mm, and a play is neither negative nor larger than {MOST_LAMBDA_MM} mm")
    } else {
        return None;
    };
    Some(Reason::new(Code::ParameterOutOfRange, Level::Look, text.replace('-', "−"), remedy))
}

/// What speaks against a model whatever was measured: η or λ that no such robot has, or an η of which nothing is known.
#[cfg(feature = "commands")]
pub fn doubt_of_parameters(model: &Model) -> Option<Reason> {
    let remedy = "learn the model anew, from poses that bend further";
    let unknown = || unknown_eta(model).map(|text| Reason::new(Code::WorkspaceNotCovered, Level::Look, text, remedy));
    out_of_range(model).or_else(unknown)
}

/// Sign test: whether the naive model predicts more bends better than this one.
fn worse_than_naive(model: &Model, evidence: &Evidence) -> Option<Reason> {
    model.estimate()?;
    let (own, naive) = (model.plain(), model.plain().without_estimate());
    let miss = |model: &Model, sample: &PlainSample| {
        let predicted = model.forward_bend(&sample.q_mm).ok()?;
        Some((predicted - sample.measured.configuration.bend_vector()).norm())
    };
    let poses: Vec<&PlainSample> = new_poses(&evidence.samples).collect();
    let is_worse = |sample: &&&PlainSample| match (miss(&own, sample), miss(&naive, sample)) {
        (Some(own), Some(naive)) => naive < own,
        (None, Some(_)) => true,
        _ => false,
    };
    let worse = poses.iter().filter(is_worse).count();
    more_often(worse, poses.len(), 0.5).then(|| {
        let text = format!("the naive model (η = 1, λ = 0) predicts {worse} of {} bends better", poses.len());
        let remedy =
            "do not command from this table; see the other reasons, and `snakeloop discover` for what the model lacks";
        Reason::new(Code::WorseThanNaive, Level::DoNotUse, text, remedy)
    })
}

/// Measurements that the estimator's gate rejected.
fn rejected(subject: &Subject) -> Option<Reason> {
    let (used, rejected) = subject.used_and_rejected?;
    if !more_often(rejected, used + rejected, REJECTED_IN_ORDER) {
        return None;
    }
    // Beyond half, nothing tells which part the outliers are: the breakdown point of any robust estimate.
    let level = if rejected > used { Level::DoNotUse } else { Level::Look };
    let text = format!("{rejected} of {} measurements contradict the others and were rejected", used + rejected);
    let remedy = "look at the frames under \"Measurements not used\" in report.html (estimate.csv has all): if the overlay follows the \
                  snake there, the log or the model is wrong (`snakeloop discover`), otherwise the frame is";
    Some(Reason::new(Code::ManyRejected, level, text, remedy))
}

/// Readings that no bend of the robot agrees with: from some row on another unit, or a counter that jumped.
fn leading_nowhere(evidence: &Evidence) -> Option<Reason> {
    let Evidence { with_reading, nowhere, .. } = *evidence;
    let of = with_reading + nowhere.frames;
    more_often(nowhere.frames, of, REJECTED_IN_ORDER).then(|| {
        let level = if nowhere.frames > with_reading { Level::DoNotUse } else { Level::Look };
        let text = format!("{} of {of} readings lead to no bend of this robot, the first at frame {}", nowhere.frames, nowhere.from);
        let remedy = "look at the log from there on: another unit, a counter that jumped, another actuator's columns; use the rows before alone";
        Reason::new(Code::ManyRejected, level, text, remedy)
    })
}

/// An estimate of one gain for all bends.
fn replaced(subject: &Subject) -> Option<Reason> {
    let Replaced { better, of } = subject.replaced?;
    let text = format!(
        "the recursive estimate does not determine η: one gain for all bends predicts {better} of {of} bends better, and is used instead"
    );
    let remedy =
        "`snakeloop discover` names what the model lacks; until then the table is only as good as one gain can be";
    Some(Reason::new(Code::GapAboveNoise, Level::Look, text, remedy))
}

/// A bend at rest along the axis of the camera, where there is a gap: a wrong focal length makes a tilt of the straight picture out of
/// perspective, the same in all frames. A bend at rest of the snake itself may point anywhere.
fn camera_lens(subject: &Subject, evidence: &Evidence, check: Option<&WiringCheck>) -> Option<Reason> {
    let check = check.filter(|check| check.mistake.is_none())?;
    // Poses of trackers and of simulated eyes name no view.
    let view = evidence.poses.first()?.view.as_ref()?;
    if evidence.poses.iter().any(|pose| pose.view.as_ref() != Some(view)) {
        return None;
    }
    let known = subject.views.iter().find(|known| known.name == *view);
    let right = known.map_or(0.0, |known| known.delta_offset_deg.to_radians());
    let from_axis = (check.at_rest.y.atan2(check.at_rest.x) - right - PI / 2.0).sin().abs();
    let is_significant = check.at_rest.norm() > NORMAL_QUANTILE * check.sd_at_rest;
    (is_significant && from_axis < ALONG_THE_AXIS).then(|| {
        let text = format!(
            "all bends are {:.2}° off in the direction of the camera's axis, and not across it, as a wrong focal length makes them (or a \
             straight picture in which the snake leaned towards the camera)",
            check.at_rest.norm().to_degrees()
        );
        let remedy = "calibrate the camera (`snakeloop calibrate camera`) and compare the focal length with camera.yaml; then take the straight \
                      picture anew";
        Reason::new(Code::CameraLens, Level::Look, text, remedy)
    })
}

/// What the poses leave open: the wiring, a direction of the bend, or η.
fn not_covered(subject: &Subject, evidence: &Evidence, check: Option<&WiringCheck>) -> Option<Reason> {
    let undecided = check.and_then(|check| check.undecided.as_ref()).map(|other| {
        format!(
            "the poses do not decide whether the log's columns are in order: columns {:?} with signs {:?} explain the bends equally well",
            other.columns, other.signs
        )
    });
    let text = undecided.or_else(|| unseen_direction(&evidence.samples)).or_else(|| unknown_eta(subject.model))?;
    let remedy = "bend further, and in at least two planes that are not opposite, as `simulate` does; `snakeloop discover --next` \
                  proposes a trajectory";
    Some(Reason::new(Code::WorkspaceNotCovered, Level::Look, text, remedy))
}

/// A direction in which the measured bends give less information than one measurement at full bend. For a gain that depends on the direction, the
/// leverage of a full bend θ is θ²/Σ b_u², with b_u the bends' components in that direction. If it is above 1, the prediction is less certain
/// than a measurement.
fn unseen_direction(samples: &[PlainSample]) -> Option<String> {
    let bends = || samples.iter().map(|sample| sample.measured.configuration.bend_vector());
    let information: Matrix2<f64> = bends().map(|bend| bend * bend.transpose()).sum();
    let least = information.symmetric_eigen();
    let place = least.eigenvalues.imin();
    let largest = bends().map(|bend| bend.norm()).fold(0.0, f64::max);
    if samples.is_empty() || least.eigenvalues[place] >= largest * largest {
        return None;
    }
    let direction = least.eigenvectors.column(place);
    let delta_deg = direction.y.atan2(direction.x).to_degrees().rem_euclid(180.0);
    let text = format!(
        "the snake hardly bent towards δ = {delta_deg:.0}° or {:.0}°: the measurements there say less than a single one at {:.0}°",
        delta_deg - 180.0,
        largest.to_degrees()
    );
    Some(text.replace('-', "−"))
}

/// η so uncertain that it may lie anywhere where robots have it.
fn unknown_eta(model: &Model) -> Option<String> {
    let estimate = model.estimate()?;
    let half_range = (PLAUSIBLE_ETA.end() - PLAUSIBLE_ETA.start()) / 2.0;
    (NORMAL_QUANTILE * estimate.sd_eta() > half_range).then(|| {
        let (eta, sd) = (estimate.eta, estimate.sd_eta());
        format!("η = {eta:.2} ± {sd:.2} may have any value that robots have: the measurements do not determine the line's losses")
    })
}

/// A table that the measurements leave less certain than it is asked to be right, where the bends of the data end.
fn uncertain_table(model: &Model) -> Option<Reason> {
    model.estimate()?;
    let learned = model.learned?;
    let sd = |delta_deg: f64| {
        let psi = Configuration { theta: learned.theta_max(), delta: delta_deg.to_radians() };
        let covariance = model.response_covariance_bend(psi.bend_vector()).ok()?;
        Some(covariance.symmetric_eigenvalues().max().max(0.0).sqrt())
    };
    let most = learned.directions_deg().into_iter().filter_map(sd).fold(0.0, f64::max);
    (most > ASKED_FOR).then(|| {
        let text = format!(
            "the table is known to ±{:.1}° only at a bend of {:.0}° (one standard deviation): the noise of the measurements leaves more open than \
             the {}° that a table is asked to be right to",
            most.to_degrees(),
            learned.theta_max().to_degrees(),
            ASKED_FOR.to_degrees()
        );
        let remedy = "measure more poses, or the same with a larger snake in the picture, more light and less blur; if the sigmas of the \
                      measurements are not the eye's own, check their unit";
        Reason::new(Code::WorkspaceNotCovered, Level::Look, text, remedy)
    })
}
