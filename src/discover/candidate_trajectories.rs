//! Candidate trajectories for the next experiment, each of which shows something that the others hide.

use super::data::Data;
use crate::geometry::Configuration;
use crate::observation::Waypoint;
use crate::robot::MAX_THETA;
use crate::statistics::order::median;

/// The least bend of a trajectory, degrees.
///
/// Convention: below it a camera hardly sees δ.
const LEAST_THETA_DEG: f64 = 6.0;

/// The number of poses of a trajectory.
///
/// Convention: what a laboratory does in a few minutes.
const POSES: std::ops::RangeInclusive<f64> = 140.0..=360.0;

/// The largest bend of a trajectory, degrees, whatever the experiment at hand reached.
///
/// Convention: bends that show loads and that the paper's snake allows.
const LARGEST_THETA_DEG: std::ops::RangeInclusive<f64> = 60.0..=85.0;

/// By how much `larger_bends` goes beyond it, and the share of the model's range that it keeps to.
///
/// Convention: a choice among experiments.
const FURTHER: (f64, f64) = (1.3, 0.9);

/// Steps of the bend between samples above this move, degrees.
///
/// Convention: above the noise of θ.
const MOVING_DEG: f64 = 0.5;

/// The interval of a trajectory where the experiment at hand has none, s.
///
/// Convention: that of the project's own experiments.
const USUAL_INTERVAL_S: f64 = 0.35;

/// The least and the largest interval, s.
///
/// Convention: keeps a trajectory between seconds and hours.
const INTERVALS_S: (f64, f64) = (0.01, 60.0);

/// The step between poses where the experiment at hand does not move, degrees.
///
/// Convention: that of the project's own experiments.
const USUAL_STEP_DEG: f64 = 2.0;

/// The least and the largest step, degrees.
///
/// Convention: several times the noise of θ, and several steps to a sweep.
const STEPS_DEG: (f64, f64) = (1.0, 8.0);

/// A candidate.
#[derive(Debug, Clone)]
pub struct CandidateTrajectory {
    /// Its name, in snake_case.
    pub name: &'static str,
    /// What it is and what it shows, in words.
    pub words: &'static str,
    /// The poses.
    pub waypoints: Vec<Waypoint>,
}

/// One stretch of a trajectory.
#[derive(Debug, Clone, Copy)]
enum Leg {
    /// To (θ, δ) in degrees, at a pace in units of the experiment's.
    To(f64, f64, f64),
    /// Rest for so many poses.
    Rest(usize),
}

/// The candidates, at the pace and the rate of an experiment that was made: what a laboratory could do then it can do now.
pub fn candidate_trajectories(data: &Data) -> Vec<CandidateTrajectory> {
    let largest = data.measured.iter().map(|m| m.configuration.theta_deg()).fold(0.0, f64::max);
    let largest = largest.clamp(*LARGEST_THETA_DEG.start(), *LARGEST_THETA_DEG.end());
    let further = (FURTHER.0 * largest).min(FURTHER.1 * MAX_THETA.to_degrees());
    let (interval_s, step_deg) = rate(data);
    let all = candidates(largest, further).into_iter();
    all.map(|(name, words, legs)| CandidateTrajectory { name, words, waypoints: poses(&legs, interval_s, step_deg) })
        .collect()
}

/// Name, words and stretches of each candidate, with sweeps to these bends, degrees.
///
/// Convention: the candidates are choices; which of them is proposed follows from the data.
fn candidates(largest: f64, further: f64) -> [(&'static str, &'static str, Vec<Leg>); 8] {
    let three = [0.0, 120.0, -120.0];
    let six = [0.0, 60.0, 120.0, 180.0, -120.0, -60.0];
    [
        (
            "many_planes",
            "up and down in six planes: what differs from backbone to backbone, or has a direction in space, shows only there",
            six.iter().flat_map(|&delta| sweep(delta, largest, |_| 1.0)).collect(),
        ),
        (
            "uneven_pace",
            "the same bends at a third of the pace and at nearly twice: what goes with speed or lags behind changes, and nothing else",
            three.iter().flat_map(|&delta| sweep(delta, largest, |k| if k % 2 == 0 { 0.35 } else { 1.7 })).collect(),
        ),
        (
            "stops",
            "sweeps with sudden stops: what goes with speed is gone at once, what lags behind or creeps is not",
            three.iter().flat_map(|&delta| stops(delta, largest, 5)).collect(),
        ),
        (
            "reversals",
            "two steps forward, one back: what follows the direction of motion shows at every bend",
            three.iter().flat_map(|&delta| reversals(delta, largest)).collect(),
        ),
        (
            "larger_bends",
            "sweeps to larger bends than before: what grows faster than the bend shows there",
            three.iter().flat_map(|&delta| sweep(delta, further, |_| 1.0)).collect(),
        ),
        (
            "rounds",
            "rounds at three bends, both ways: every direction at the same bend",
            [25.0, 0.5 * (25.0 + largest), largest].into_iter().flat_map(rounds).collect(),
        ),
        (
            "long_holds",
            "quick moves and long holds: what goes on while nothing moves shows",
            three.iter().flat_map(|&delta| stops(delta, largest, 14)).collect(),
        ),
        (
            "a_bit_of_everything",
            "six planes, two paces, stops, reversals and a round",
            [
                sweep(0.0, largest, |k| if k % 2 == 0 { 0.5 } else { 1.6 }),
                reversals(120.0, largest),
                stops(-120.0, largest, 5),
                sweep(60.0, further, |_| 1.4),
                stops(180.0, largest, 5),
                reversals(-60.0, largest),
                rounds(40.0),
            ]
            .concat(),
        ),
    ]
}

/// The same trajectory so many times over.
pub fn repeated(waypoints: &[Waypoint], times: usize) -> Vec<Waypoint> {
    let Some(last) = waypoints.last() else { return Vec::new() };
    let pause_s = last.time_s / waypoints.len().max(2) as f64;
    let round = |k: usize| {
        let later = (last.time_s + pause_s) * k as f64;
        waypoints.iter().map(move |w| Waypoint { time_s: w.time_s + later, ..*w })
    };
    (0..times).flat_map(round).collect()
}

/// So many of its poses at most, evenly chosen with the first and the last.
pub fn thinned(waypoints: &[Waypoint], most: usize) -> Vec<Waypoint> {
    if waypoints.len() <= most {
        return waypoints.to_vec();
    }
    (0..most).map(|k| waypoints[k * (waypoints.len() - 1) / (most - 1).max(1)]).collect()
}

/// Up and down in one plane, in four stretches each way with a pace of their own.
fn sweep(delta_deg: f64, largest_deg: f64, pace: impl Fn(usize) -> f64) -> Vec<Leg> {
    let at = |share: f64| LEAST_THETA_DEG + share * (largest_deg - LEAST_THETA_DEG);
    let shares = [0.0, 0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0];
    shares.iter().enumerate().map(|(k, &share)| Leg::To(at(share), delta_deg, pace(k))).collect()
}

/// Up and down in one plane with stops on the way.
fn stops(delta_deg: f64, largest_deg: f64, poses: usize) -> Vec<Leg> {
    sweep(delta_deg, largest_deg, |_| 1.6).into_iter().flat_map(|leg| [leg, Leg::Rest(poses)]).collect()
}

/// Up and down in one plane, two steps forward and one back.
fn reversals(delta_deg: f64, largest_deg: f64) -> Vec<Leg> {
    let at = |step: f64| LEAST_THETA_DEG + step / 6.0 * (largest_deg - LEAST_THETA_DEG);
    let steps = [0.0, 2.0, 1.0, 3.0, 2.0, 4.0, 3.0, 5.0, 4.0, 6.0, 4.0, 5.0, 3.0, 4.0, 2.0, 3.0, 1.0, 2.0, 0.0];
    steps.iter().map(|&step| Leg::To(at(step), delta_deg, 1.0)).collect()
}

/// Once round at one bend, and back.
fn rounds(theta_deg: f64) -> Vec<Leg> {
    let there = (0..=12).map(f64::from);
    let back = (0..12).rev().map(f64::from);
    there.chain(back).map(|k| Leg::To(theta_deg, 30.0 * k, 1.0)).collect()
}

/// The interval of an experiment, s, and how far it goes in one, degrees: medians over the samples that move.
fn rate(data: &Data) -> (f64, f64) {
    let intervals = data.times_s.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0);
    let bends: Vec<_> = data.measured.iter().map(|m| m.configuration.bend_vector()).collect();
    let steps = bends.windows(2).map(|pair| (pair[1] - pair[0]).norm().to_degrees()).filter(|step| *step > MOVING_DEG);
    let median_or = |mut values: Vec<f64>, usual: f64| if values.is_empty() { usual } else { median(&mut values) };
    let interval_s = median_or(intervals.collect(), USUAL_INTERVAL_S);
    let step_deg = median_or(steps.collect(), USUAL_STEP_DEG);
    (interval_s.clamp(INTERVALS_S.0, INTERVALS_S.1), step_deg.clamp(STEPS_DEG.0, STEPS_DEG.1))
}

/// The poses of a trajectory. The pace is changed as a whole where there would be too few poses or too many.
fn poses(legs: &[Leg], interval_s: f64, step_deg: f64) -> Vec<Waypoint> {
    let at_pace = walk(legs, step_deg).len() as f64;
    let wanted = at_pace.clamp(*POSES.start(), *POSES.end());
    let places = walk(legs, step_deg * at_pace / wanted);
    let at = |(k, &(theta, delta)): (usize, &(f64, f64))| {
        Waypoint::new(interval_s * k as f64, Configuration::from_degrees(theta, delta))
    };
    places.iter().enumerate().map(at).collect()
}

/// (θ, δ) in degrees at equal intervals.
fn walk(legs: &[Leg], step_deg: f64) -> Vec<(f64, f64)> {
    let mut places: Vec<(f64, f64)> = Vec::new();
    for leg in legs {
        let from = places.last().copied();
        match (*leg, from) {
            (Leg::To(theta, delta, _), None) => places.push((theta, delta)),
            (Leg::To(theta, delta, pace), Some(from)) => {
                let across = 0.5 * (theta + from.0) * (delta - from.1).to_radians();
                let length = (theta - from.0).hypot(across);
                let steps = (length / (step_deg * pace)).round().max(1.0) as usize;
                if length > 0.0 {
                    let share = |k: usize| k as f64 / steps as f64;
                    let on = |k: usize| (from.0 + share(k) * (theta - from.0), from.1 + share(k) * (delta - from.1));
                    places.extend((1..=steps).map(on));
                }
            }
            (Leg::Rest(poses), Some(from)) => places.extend(std::iter::repeat_n(from, poses)),
            (Leg::Rest(_), None) => {}
        }
    }
    places
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_are_a_step_apart_on_the_way_and_stay_where_they_rest() {
        let places =
            walk(&[Leg::To(10.0, 0.0, 1.0), Leg::To(20.0, 0.0, 1.0), Leg::Rest(3), Leg::To(20.0, 90.0, 2.0)], 2.0);
        assert_eq!(places[..6], [10.0, 12.0, 14.0, 16.0, 18.0, 20.0].map(|theta| (theta, 0.0)));
        assert_eq!(places[6..9], [(20.0, 0.0); 3]);
        // A quarter of a round at θ = 20° is 31.4° long: eight steps of twice 2°.
        assert_eq!(places.len(), 9 + 8);
        assert_eq!(places.last(), Some(&(20.0, 90.0)));
    }

    #[test]
    fn the_pace_changes_where_there_would_be_too_many_poses() {
        let legs: Vec<Leg> = (0..40).map(|k| Leg::To(if k % 2 == 0 { 5.0 } else { 80.0 }, 0.0, 1.0)).collect();
        let slow = poses(&legs, 0.5, 1.0);
        assert!((POSES.start() / 1.1..POSES.end() * 1.1).contains(&(slow.len() as f64)), "{}", slow.len());
        assert!(slow.windows(2).all(|pair| (pair[1].time_s - pair[0].time_s - 0.5).abs() < 1e-9));
    }

    #[test]
    fn fewer_poses_keep_both_ends_and_their_order() {
        let all = poses(&[Leg::To(5.0, 0.0, 1.0), Leg::To(80.0, 0.0, 1.0)], 0.5, 1.0);
        let few = thinned(&all, 24);
        assert!(few.len() == 24 && few.windows(2).all(|pair| pair[1].time_s > pair[0].time_s));
        assert_eq!([few[0].time_s, few[23].time_s], [all[0].time_s, all[all.len() - 1].time_s]);
        assert_eq!(thinned(&few, 30).len(), 24);
    }

    #[test]
    fn a_repetition_begins_one_interval_after_the_end() {
        let once = poses(&[Leg::To(5.0, 0.0, 1.0), Leg::To(80.0, 0.0, 1.0)], 0.5, 1.0);
        let twice = repeated(&once, 2);
        assert_eq!(twice.len(), 2 * once.len());
        assert!(twice.windows(2).all(|pair| pair[1].time_s > pair[0].time_s));
        assert_eq!(twice[once.len()].configuration, once[0].configuration);
    }
}
