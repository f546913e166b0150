//! Where a gap lives: in which backbone, at which bends, in which direction, when.

use super::data::Data;
use super::verdict::{Discovery, Verdict};
use crate::robot::PerBackbone;
use serde_json::{Value, json};

/// The share of the gap that a range must hold to be named,
const HOLDS: f64 = 0.8;
/// in at most this share of the samples.
const WITHIN: f64 = 0.55;
/// Stretches that a range is made of.
const BINS: usize = 24;
/// A move of q̃ below this has no direction, mm.
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

/// Where the gap is that a model leaves, on sweeps that the fit did not see.
#[derive(Debug, Clone, PartialEq)]
pub struct Whereabouts {
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
    /// The gap of the part at every sample, mm; of the backbone with the largest share, where there are several.
    pub gap_mm: Vec<f64>,
}

impl Whereabouts {
    /// Of the gap that the model as given leaves; none where it does not exceed noise.
    pub fn of(found: &Discovery, data: &Data) -> Option<Self> {
        if found.verdict == Verdict::None {
            return None;
        }
        let gaps: Vec<PerBackbone> = found.residuals_mm.iter().map(|[before, _]| *before).collect();
        let floor = found.noise_floor_mm.powi(2);
        let total: f64 = gaps.iter().map(|gap| gap.norm_squared()).sum();
        let n = data.backbones() as f64;
        if total <= 1.2 * n * floor * gaps.len() as f64 {
            return None;
        }
        let (part, shares) = part_of(&gaps, floor);
        let shown = |gap: &PerBackbone| match part {
            Part::Common => gap.mean(),
            Part::Backbone(i) => gap[i - 1],
            Part::Several => gap[largest(&shares)],
        };
        let gap_mm: Vec<f64> = gaps.iter().map(shown).collect();
        let excess: Vec<f64> = gaps.iter().map(|gap| gap.norm_squared() - n * floor).collect();
        let theta: Vec<f64> = data.measured.iter().map(|m| m.configuration.theta_deg()).collect();
        let delta: Vec<f64> = data.measured.iter().map(|m| m.configuration.delta_deg()).collect();
        Some(Self {
            part,
            shares,
            theta_deg: range(&theta, &excess, None),
            delta_deg: range(&delta, &excess, Some(360.0)),
            time_s: range(&data.times_s, &excess, None),
            step: step(&data.times_s, &gap_mm),
            direction: direction(data, part, &gap_mm),
            gap_mm,
        })
    }

    /// "in backbone 2 (81 % of it), at θ from 40° to 76°, …".
    pub fn words(&self) -> String {
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        let mut places = vec![match self.part {
            Part::Backbone(i) => format!("in backbone {i} ({} of it)", percent(self.shares[i - 1])),
            Part::Common => "in what all backbones have in common".to_owned(),
            Part::Several => {
                let numbers: Vec<_> = (1..self.shares.len()).map(|i| i.to_string()).collect();
                let shares: Vec<_> = self.shares.iter().map(|&share| percent(share)).collect();
                format!("in backbones {} and {} ({})", numbers.join(", "), self.shares.len(), shares.join(", "))
            }
        }];
        let range = |name: &str, range: Option<[f64; 2]>, unit: &str| {
            range.map(|[from, to]| format!("{name} from {from:.0}{unit} to {to:.0}{unit}"))
        };
        places.extend(range("at θ", self.theta_deg, "°"));
        places.extend(range("at δ", self.delta_deg, "°"));
        places.extend(range("at times", self.time_s, " s"));
        if let Some((time_s, [before, after])) = self.step {
            places.push(format!("with a step at about {time_s:.0} s, from {before:+.3} to {after:+.3} mm"));
        }
        if let Some([falling, rising]) = self.direction {
            places.push(format!(
                "with the direction of motion: {falling:+.3} mm as q̃ falls, {rising:+.3} mm as it rises"
            ));
        }
        if places.len() == 1 {
            places.push("spread over all bends, directions and times".to_owned());
        }
        places.join(", ")
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
    let total = excess.sum().max(1e-12);
    let shares = excess.map(|excess| excess / total);
    let common: f64 = gaps.iter().map(|gap| n as f64 * gap.mean().powi(2)).sum();
    let all: f64 = gaps.iter().map(|gap| gap.norm_squared()).sum();
    let most = largest(&shares);
    let part = if common > 0.75 * all {
        Part::Common
    } else if shares[most] > 0.6 {
        Part::Backbone(most + 1)
    } else {
        Part::Several
    };
    (part, shares)
}

fn largest(shares: &PerBackbone) -> usize {
    (0..shares.len()).max_by(|&a, &b| shares[a].total_cmp(&shares[b])).unwrap_or(0)
}

/// The shortest range of values that holds most of the excess, where that is a small part of the samples. Values with a
/// period may wrap.
fn range(values: &[f64], excess: &[f64], period: Option<f64>) -> Option<[f64; 2]> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let size = values.len().div_ceil(BINS);
    let bins: Vec<(&[usize], f64)> =
        order.chunks(size).map(|bin| (bin, bin.iter().map(|&k| excess[k]).sum::<f64>().max(0.0))).collect();
    let total: f64 = bins.iter().map(|(_, sum)| sum).sum();
    let starts = 0..bins.len();
    let window = |from: usize| {
        let most = if period.is_some() { bins.len() } else { bins.len() - from };
        let (mut held, mut samples) = (0.0, 0);
        (0..most).find_map(|more| {
            let (bin, sum) = bins[(from + more) % bins.len()];
            (held, samples) = (held + sum, samples + bin.len());
            (held >= HOLDS * total).then_some((samples, from, (from + more) % bins.len()))
        })
    };
    let (samples, from, to) = starts.filter_map(window).min()?;
    if samples as f64 > WITHIN * values.len() as f64 {
        return None;
    }
    Some([values[*bins[from].0.first()?], values[*bins[to].0.last()?]])
}

/// Where a split into before and after takes most of a gap's squares, if that is more than half.
fn step(times_s: &[f64], gap: &[f64]) -> Option<(f64, [f64; 2])> {
    let n = gap.len() as f64;
    let all: f64 = gap.iter().sum();
    let squares: f64 = gap.iter().map(|gap| gap * gap).sum();
    let mut sum = 0.0;
    let mut best = (0.0, 0);
    for (k, gap) in gap.iter().enumerate().take(gap.len() - 1) {
        sum += gap;
        let (before, after) = ((k + 1) as f64, n - (k + 1) as f64);
        let taken = sum * sum / before + (all - sum).powi(2) / after - all * all / n;
        if taken > best.0 && before.min(after) > 0.1 * n {
            best = (taken, k + 1);
        }
    }
    let (taken, at) = best;
    if taken < 0.5 * squares {
        return None;
    }
    let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
    Some((times_s[at], [mean(&gap[..at]), mean(&gap[at..])]))
}

/// The means of a gap while its q̃ falls and rises, where their difference takes more than a third of its squares.
fn direction(data: &Data, part: Part, gap: &[f64]) -> Option<[f64; 2]> {
    let Part::Backbone(i) = part else { return None };
    let mut last = 0.0f64;
    let mut sums = [(0.0f64, 0.0f64); 2];
    for (pair, gap) in data.q_mm.windows(2).zip(&gap[1..]) {
        let move_mm = pair[1][i - 1] - pair[0][i - 1];
        if move_mm.abs() > DEAD_BAND_MM {
            last = move_mm;
        }
        if last != 0.0 {
            let side = &mut sums[usize::from(last > 0.0)];
            *side = (side.0 + gap, side.1 + 1.0);
        }
    }
    let [(down, falling), (up, rising)] = sums;
    if falling.min(rising) < 8.0 {
        return None;
    }
    let means = [down / falling, up / rising];
    let taken = (means[1] - means[0]).powi(2) * falling * rising / (falling + rising);
    let squares: f64 = gap.iter().map(|gap| gap * gap).sum();
    (taken > squares / 3.0).then_some(means)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_is_the_shortest_that_holds_the_gap_and_may_wrap() {
        let values: Vec<f64> = (0..360).map(|k| f64::from(k) - 180.0).collect();
        let at = |inside: &dyn Fn(f64) -> bool| values.iter().map(|&v| f64::from(inside(v))).collect::<Vec<f64>>();
        let [from, to] = range(&values, &at(&|v| (30.0..90.0).contains(&v)), Some(360.0)).unwrap();
        assert!((15.0..45.0).contains(&from) && (75.0..105.0).contains(&to), "{from} {to}");
        let [from, to] = range(&values, &at(&|v| v.abs() > 150.0), Some(360.0)).unwrap();
        assert!((135.0..165.0).contains(&from) && (-165.0..-135.0).contains(&to), "{from} {to}");
        assert_eq!(range(&values, &at(&|_| true), None), None);
    }

    #[test]
    fn a_step_is_found_where_it_is() {
        let times: Vec<f64> = (0..100).map(|k| 0.5 * f64::from(k)).collect();
        let gap: Vec<f64> = (0..100).map(|k| if k < 60 { -0.02 } else { 0.03 }).collect();
        let (time, [before, after]) = step(&times, &gap).unwrap();
        assert!((time - 30.0).abs() < 1e-9 && (before + 0.02).abs() < 1e-9 && (after - 0.03).abs() < 1e-9);
        assert_eq!(step(&times, &times.iter().map(|t| (t * 3.0).sin()).collect::<Vec<_>>()), None);
    }

    #[test]
    fn the_part_is_that_which_moves() {
        let of = |gap: PerBackbone| part_of(&[gap; 30], 1e-8).0;
        assert_eq!(of(PerBackbone::from([0.001, 0.05, -0.002])), Part::Backbone(2));
        assert_eq!(of(PerBackbone::repeat(3, 0.03)), Part::Common);
        assert_eq!(of(PerBackbone::from([0.05, -0.05, 0.04])), Part::Several);
    }
}
