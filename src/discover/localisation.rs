//! Residual localisation: in which backbone, at which bends, in which direction of motion and when the gap is.

use super::data::Data;
use super::discovery::Discovery;
use super::verdict::Verdict;
use crate::robot::PerBackbone;
use crate::statistics::moments::mean;
use serde_json::{Value, json};

/// A range is named where it holds this share of the gap's excess over noise ...
///
/// Convention: a choice of words, as all constants of this file; no verdict depends on them.
const HELD_SHARE: f64 = 0.8;

/// ... in at most this share of the samples.
///
/// Convention: a choice of words.
const MOST_SAMPLES_SHARE: f64 = 0.55;

/// The number of intervals that a range is made of.
///
/// Convention: the resolution of what is said.
const INTERVALS: usize = 24;

/// The gap is called common where its mean over the backbones holds more than this share of its squares.
///
/// Convention: a choice of words.
const COMMON_SHARE: f64 = 0.75;

/// The gap is said to be in one backbone where that has more than this share of the excess.
///
/// Convention: a choice of words.
const ONE_BACKBONE_SHARE: f64 = 0.6;

/// A step is named where its two means explain more than this share of the gap's squares.
///
/// Convention: a choice of words.
const STEP_SHARE: f64 = 0.5;

/// A step has at least this share of the samples on either side.
///
/// Convention: a choice of words.
const LEAST_SIDE_SHARE: f64 = 0.1;

/// The direction of motion is named where its two means explain more than this share of the gap's squares.
///
/// Convention: a choice of words.
const DIRECTION_SHARE: f64 = 1.0 / 3.0;

/// Each direction must have this many samples.
///
/// Convention: a choice of words.
const LEAST_SAMPLES_OF_DIRECTION: f64 = 8.0;

/// A move of q̃ below this has no direction, mm.
///
/// Convention: several times the noise of usual encoders.
const DEAD_BAND_MM: f64 = 0.01;

/// Which part of ε a gap is in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// One backbone, counted from 1.
    Backbone(usize),
    /// The same in all.
    Common,
    /// Several, each its own.
    Several,
}

/// Where the gap is that a model leaves, on held-out sweeps.
#[derive(Debug, Clone, PartialEq)]
pub struct Localisation {
    /// The part of ε that has most of it.
    pub part: Part,
    /// The share of each backbone.
    pub shares: PerBackbone,
    /// The bends that hold most of it, degrees, where they are a small part of all.
    pub theta_deg: Option<[f64; 2]>,
    /// The azimuths, from the first up through the second, degrees.
    pub delta_deg: Option<[f64; 2]>,
    /// The time, s.
    pub time_s: Option<[f64; 2]>,
    /// When it steps, s, and the means of the part before and after, mm.
    pub step: Option<(f64, [f64; 2])>,
    /// The means of the part while its q̃ falls and rises, mm, where they differ by more than the rest.
    pub direction: Option<[f64; 2]>,
}

impl Localisation {
    /// Of the gap that the model as given leaves; none where it does not exceed noise.
    pub fn new(found: &Discovery, data: &Data) -> Option<Self> {
        if found.verdict == Verdict::None {
            return None;
        }
        let gaps: Vec<PerBackbone> = found.residuals_mm.iter().map(|[before, _]| *before).collect();
        Self::of_gaps(&gaps, found.noise_floor_mm, data)
    }

    /// Of a gap of ε at every sample, of which noise alone leaves an rms of `floor_mm`.
    fn of_gaps(gaps: &[PerBackbone], floor_mm: f64, data: &Data) -> Option<Self> {
        let (n, floor) = (data.backbones() as f64, floor_mm.powi(2));
        let excess: Vec<f64> = gaps.iter().map(|gap| gap.norm_squared() - n * floor).collect();
        if excess.iter().sum::<f64>() <= 0.0 {
            return None;
        }
        let (part, shares) = part_of(gaps, floor);
        let shown = |gap: &PerBackbone| match part {
            Part::Common => gap.mean(),
            Part::Backbone(i) => gap[i - 1],
            Part::Several => gap[largest(&shares)],
        };
        let gap_mm: Vec<f64> = gaps.iter().map(shown).collect();
        let theta: Vec<f64> = data.measured.iter().map(|m| m.configuration.theta_deg()).collect();
        let delta: Vec<f64> = data.measured.iter().map(|m| m.configuration.delta_deg()).collect();
        Some(Self {
            part,
            shares,
            theta_deg: range(&theta, &excess, false),
            delta_deg: range(&delta, &excess, true),
            time_s: range(&data.times_s, &excess, false),
            step: step(&data.times_s, &gap_mm),
            direction: match part {
                Part::Backbone(i) => direction(data.q_mm.iter().map(|q| q[i - 1]), &gap_mm),
                _ => None,
            },
        })
    }

    /// "in backbone 2 (81 % of it), at θ from 40° to 76°, …".
    pub fn words(&self) -> String {
        let range = |name: &str, range: Option<[f64; 2]>, unit: &str| {
            range.map(|[from, to]| format!("{name} from {from:.0}{unit} to {to:.0}{unit}"))
        };
        let step = self.step.map(|(time_s, [before, after])| {
            format!("with a step at about {time_s:.0} s, from {before:+.3} to {after:+.3} mm")
        });
        let direction = self.direction.map(|[falling, rising]| {
            format!("with the direction of motion: {falling:+.3} mm as q̃ falls, {rising:+.3} mm as it rises")
        });
        let mut places = vec![self.part_in_words()];
        places.extend(range("at θ", self.theta_deg, "°"));
        places.extend(range("at δ", self.delta_deg, "°"));
        places.extend(range("at times", self.time_s, " s"));
        places.extend(step);
        places.extend(direction);
        if places.len() == 1 {
            places.push("spread over all bends, directions and times".to_owned());
        }
        places.join(", ").replace('-', "−")
    }

    fn part_in_words(&self) -> String {
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        match self.part {
            Part::Backbone(i) => format!("in backbone {i} ({} of it)", percent(self.shares[i - 1])),
            Part::Common => "in what all backbones have in common".to_owned(),
            Part::Several => {
                let shares: Vec<_> = self
                    .shares
                    .iter()
                    .enumerate()
                    .map(|(i, &share)| format!("{} in {}", percent(share), i + 1))
                    .collect();
                format!("in several backbones ({})", shares.join(", "))
            }
        }
    }

    /// The entry `where` of discrepancy.json.
    pub fn json(&self) -> Value {
        let part = match self.part {
            Part::Backbone(i) => json!(i),
            Part::Common => json!("common"),
            Part::Several => json!("several"),
        };
        json!({
            "words": self.words(),
            "backbone": part,
            "backbone_shares": self.shares,
            "theta_deg": self.theta_deg,
            "delta_deg": self.delta_deg,
            "time_s": self.time_s,
            "step": self.step.map(|(time_s, [before, after])| json!({"time_s": time_s, "before_mm": before, "after_mm": after})),
            "direction": self.direction.map(|[falling, rising]| json!({"falling_mm": falling, "rising_mm": rising})),
        })
    }
}

/// The part that has most of the gap, and each backbone's share of what exceeds noise.
fn part_of(gaps: &[PerBackbone], floor: f64) -> (Part, PerBackbone) {
    let n = gaps.first().map_or(0, |gap| gap.len());
    let excess = PerBackbone::from_fn(n, |i| gaps.iter().map(|gap| gap[i].powi(2) - floor).sum::<f64>().max(0.0));
    let total = excess.sum().max(f64::MIN_POSITIVE);
    let shares = excess.map(|excess| excess / total);
    let common: f64 = gaps.iter().map(|gap| n as f64 * gap.mean().powi(2)).sum();
    let all: f64 = gaps.iter().map(|gap| gap.norm_squared()).sum();
    let most = largest(&shares);
    let part = if common > COMMON_SHARE * all {
        Part::Common
    } else if shares[most] > ONE_BACKBONE_SHARE {
        Part::Backbone(most + 1)
    } else {
        Part::Several
    };
    (part, shares)
}

fn largest(shares: &PerBackbone) -> usize {
    (0..shares.len()).max_by(|&a, &b| shares[a].total_cmp(&shares[b])).unwrap_or(0)
}

/// The shortest range of values that holds most of the excess, where that is a small part of the samples. The range of a
/// periodic quantity may wrap.
fn range(values: &[f64], excess: &[f64], periodic: bool) -> Option<[f64; 2]> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let size = values.len().div_ceil(INTERVALS);
    let intervals: Vec<(&[usize], f64)> =
        order.chunks(size).map(|part| (part, part.iter().map(|&k| excess[k]).sum::<f64>().max(0.0))).collect();
    let total: f64 = intervals.iter().map(|(_, sum)| sum).sum();
    let window = |from: usize| {
        let most = if periodic { intervals.len() } else { intervals.len() - from };
        let (mut held, mut samples) = (0.0, 0);
        (0..most).find_map(|more| {
            let (interval, sum) = intervals[(from + more) % intervals.len()];
            (held, samples) = (held + sum, samples + interval.len());
            (held >= HELD_SHARE * total).then_some((samples, from, (from + more) % intervals.len()))
        })
    };
    let (samples, from, to) = (0..intervals.len()).filter_map(window).min()?;
    if samples as f64 > MOST_SAMPLES_SHARE * values.len() as f64 {
        return None;
    }
    Some([values[*intervals[from].0.first()?], values[*intervals[to].0.last()?]])
}

/// Where a split into two means, before and after, explains most of a gap's squares, if that is more than half.
fn step(times_s: &[f64], gap: &[f64]) -> Option<(f64, [f64; 2])> {
    let n = gap.len() as f64;
    let all: f64 = gap.iter().sum();
    let squares: f64 = gap.iter().map(|gap| gap * gap).sum();
    let mut sum = 0.0;
    let mut best = (0.0, 0);
    for (k, gap) in gap.iter().enumerate().take(gap.len().saturating_sub(1)) {
        sum += gap;
        let (before, after) = ((k + 1) as f64, n - (k + 1) as f64);
        let taken = sum * sum / before + (all - sum).powi(2) / after - all * all / n;
        if taken > best.0 && before.min(after) > LEAST_SIDE_SHARE * n {
            best = (taken, k + 1);
        }
    }
    let (taken, at) = best;
    if taken <= STEP_SHARE * squares {
        return None;
    }
    let mean_of = |part: &[f64]| mean(part.iter().copied());
    Some((times_s[at], [mean_of(&gap[..at]), mean_of(&gap[at..])]))
}

/// The means of a backbone's gap while its q̃ falls and rises, where the two explain more than a third of its squares.
fn direction(q_mm: impl Iterator<Item = f64> + Clone, gap: &[f64]) -> Option<[f64; 2]> {
    let mut last = 0.0f64;
    let mut sides = [const { Vec::new() }; 2];
    for ((before, now), &gap) in q_mm.clone().zip(q_mm.skip(1)).zip(&gap[1..]) {
        if (now - before).abs() > DEAD_BAND_MM {
            last = now - before;
        }
        if last != 0.0 {
            sides[usize::from(last > 0.0)].push(gap);
        }
    }
    let [falling, rising] = [&sides[0], &sides[1]].map(|side| side.len() as f64);
    if falling.min(rising) < LEAST_SAMPLES_OF_DIRECTION {
        return None;
    }
    let means = sides.map(mean);
    let taken = (means[1] - means[0]).powi(2) * falling * rising / (falling + rising);
    let squares: f64 = gap.iter().map(|gap| gap * gap).sum();
    (taken > DIRECTION_SHARE * squares).then_some(means)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::discover::data::Log;
    use crate::geometry::Configuration;
    use crate::observation::Measured;

    /// 240 samples: θ goes up to 79° and down again three times, while δ goes round once.
    fn data() -> Data {
        let theta_deg =
            |k: usize| if k % 80 < 40 { 1.0 + 2.0 * (k % 80) as f64 } else { 159.0 - 2.0 * (k % 80) as f64 };
        let q_mm: Vec<_> = (0..240).map(|k| PerBackbone::repeat(3, 0.02 * theta_deg(k))).collect();
        let measured = (0..240).map(|k| {
            Measured::independent(Configuration::from_degrees(theta_deg(k), 1.5 * k as f64), 0.002, 0.01, 0.0)
        });
        Data {
            indices: (0..240).collect(),
            times_s: (0..240).map(f64::from).collect(),
            q_mm: q_mm.clone(),
            measured: measured.collect(),
            sweeps: (0..240).map(|k| k / 40).collect(),
            log: Log {
                times_s: (0..240).map(f64::from).collect(),
                q_mm,
                neighbours: Vec::new(),
                samples: (0..240).collect(),
            },
            sd_encoder_mm: 0.0015,
            library: Vec::new(),
            one_plane: false,
            is_driven: false,
            remarks: Vec::new(),
        }
    }

    #[test]
    fn a_planted_gap_is_found_in_its_backbone_and_at_its_bends() {
        let data = data();
        let at_40_to_60 = |k: usize| (40.0..60.0).contains(&data.measured[k].configuration.theta_deg());
        let gap = |k: usize| PerBackbone::from([0.0, if at_40_to_60(k) { 0.05 } else { 0.0 }, 0.0]);
        let gaps: Vec<PerBackbone> = (0..240).map(gap).collect();
        let found = Localisation::of_gaps(&gaps, 0.001, &data).unwrap();
        assert_eq!(found.part, Part::Backbone(2));
        assert!(found.shares[1] > 0.999);
        // To the width of an interval, 79° / 24.
        let [from, to] = found.theta_deg.unwrap();
        assert!((from - 41.0).abs() < 3.3 && (to - 59.0).abs() < 3.3, "{from} {to}");
        assert_eq!((found.time_s, found.step, found.direction), (None, None, None));
        assert!(found.words().starts_with("in backbone 2 (100 % of it), at θ from"), "{}", found.words());
    }

    #[test]
    fn a_gap_that_follows_the_motion_is_found_and_noise_is_not() {
        let data = data();
        let rising = |k: usize| k > 0 && data.q_mm[k][0] > data.q_mm[k - 1][0];
        let gap = |k: usize| PerBackbone::from([if rising(k) { 0.03 } else { -0.01 }, 0.0, 0.0]);
        let gaps: Vec<PerBackbone> = (0..240).map(gap).collect();
        let [falling, rising] = Localisation::of_gaps(&gaps, 0.001, &data).unwrap().direction.unwrap();
        // A turn of one sample between equal bends keeps the direction before it.
        assert!((falling + 0.01).abs() < 0.002 && (rising - 0.03).abs() < 0.002, "{falling} {rising}");
        assert_eq!(Localisation::of_gaps(&gaps, 0.1, &data), None);
    }

    #[test]
    fn a_range_is_the_shortest_that_holds_the_gap_and_may_wrap() {
        let values: Vec<f64> = (0..360).map(|k| f64::from(k) - 180.0).collect();
        let at = |inside: &dyn Fn(f64) -> bool| values.iter().map(|&v| f64::from(inside(v))).collect::<Vec<f64>>();
        // Intervals of 15°.
        assert_eq!(range(&values, &at(&|v| (30.0..90.0).contains(&v)), true), Some([30.0, 89.0]));
        assert_eq!(range(&values, &at(&|v| v.abs() > 150.0), true), Some([150.0, -151.0]));
        assert_eq!(range(&values, &at(&|v| v.abs() > 150.0), false), None);
        assert_eq!(range(&values, &at(&|_| true), false), None);
    }

    #[test]
    fn a_step_is_found_where_it_is() {
        let times: Vec<f64> = (0..100).map(|k| 0.5 * f64::from(k)).collect();
        let gap: Vec<f64> = (0..100).map(|k| if k < 60 { -0.02 } else { 0.03 }).collect();
        let (time, [before, after]) = step(&times, &gap).unwrap();
        assert!((time - 30.0).abs() < 1e-9 && (before + 0.02).abs() < 1e-9 && (after - 0.03).abs() < 1e-9);
        assert_eq!(step(&times, &times.iter().map(|t| (t * 3.0).sin()).collect::<Vec<_>>()), None);
        assert_eq!(step(&times, &[0.0; 100]), None);
    }

    #[test]
    fn the_part_is_that_which_moves() {
        let of = |gap: PerBackbone| part_of(&[gap; 30], 1e-8).0;
        assert_eq!(of(PerBackbone::from([0.001, 0.05, -0.002])), Part::Backbone(2));
        assert_eq!(of(PerBackbone::repeat(3, 0.03)), Part::Common);
        assert_eq!(of(PerBackbone::from([0.05, -0.05, 0.04])), Part::Several);
    }
}
