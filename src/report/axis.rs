//! The axes of a plot, and what their ticks say.

use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint, Ranged};
use std::ops::Range;

/// Ticks of an axis at most. Convention: a display choice.
const MOST_TICKS: f64 = 7.0;

/// An axis with ticks of its own.
pub(super) struct Axis {
    /// Its ends.
    pub range: Range<f64>,
    /// Where its ticks are.
    pub ticks: Vec<f64>,
}

impl Ranged for Axis {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let share = (value - self.range.start) / (self.range.end - self.range.start);
        limit.0 + (share * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, _hint: Hint) -> Vec<f64> {
        self.ticks.clone()
    }

    fn range(&self) -> Range<f64> {
        self.range.clone()
    }
}

/// Round numbers within a range: 1, 2 or 5 times a power of ten apart; angles, whose axis' name ends in (°), 15°, 30°, 45° or 90° apart where
/// that is so far.
pub(super) fn ticks([least, most]: [f64; 2], label: &str) -> Vec<f64> {
    let width = most - least;
    let apart = width / MOST_TICKS;
    if !(apart > 0.0 && apart.is_finite()) {
        return vec![least];
    }
    let decade = 10f64.powf(apart.log10().floor());
    let round = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * decade);
    let angles = [15.0, 30.0, 45.0, 90.0];
    let is_angle = label.ends_with("(°)") && apart > 5.0;
    let steps = if is_angle { &angles[..] } else { &round[..] };
    let step = steps.iter().copied().find(|step| *step >= apart).unwrap_or(steps[steps.len() - 1]);
    let first = (least / step).ceil() as i64;
    (0..=MOST_TICKS as i64 + 1).map(|k| (first + k) as f64 * step).take_while(|tick| *tick <= most).collect()
}

/// The distance between neighbouring ticks; 1 where there are no two.
pub(super) fn smallest_step(ticks: &[f64]) -> f64 {
    ticks.windows(2).map(|pair| pair[1] - pair[0]).reduce(f64::min).unwrap_or(1.0)
}

/// A tick's number with as many places as tell it from its neighbours; `written` is what writes numbers that are no plain ones.
pub(super) fn tick_text(value: f64, step: f64, written: &dyn Fn(f64) -> String) -> String {
    if written(1.0) != "1" {
        return written(value);
    }
    let places = (-(step.abs().max(1e-12)).log10()).ceil().clamp(0.0, 9.0) as usize;
    let text = if value.abs() >= 1e6 { format!("{value:.0e}") } else { format!("{value:.places$}") };
    let zero = text.trim_start_matches('-').chars().all(|c| c == '0' || c == '.');
    if zero { text.trim_start_matches('-').to_owned() } else { text.replace('-', "−") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_angles_are_told_in_their_own_steps() {
        assert_eq!(ticks([-180.0, 180.0], "δ (°)"), [-180.0, -90.0, 0.0, 90.0, 180.0]);
        assert_eq!(ticks([-3.0, 76.0], "θ (°)"), [0.0, 15.0, 30.0, 45.0, 60.0, 75.0]);
        assert_eq!(ticks([0.13, 0.52], "x (mm)"), [0.2, 0.3, 0.4, 0.5].map(|x: f64| (x * 10.0).round() * 0.1));
        let plain = |value: f64, step: f64| tick_text(value, step, &|x| format!("{x}"));
        assert_eq!(
            (plain(0.30000000000000004, 0.1), plain(-45.0, 45.0), plain(-0.0, 0.5)),
            ("0.3".into(), "−45".into(), "0.0".into())
        );
    }
}
