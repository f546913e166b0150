//! The mistakes that are tried: orders and signs of the columns, shifts of the rows, lags of the clock.

use super::samples::{Pose, Samples};
use crate::observation::EncoderReading;

/// All orders and signs are tried up to so many backbones: 24 · 16 of four. Convention: a resource limit; with more, those that
/// keep the circle's order, and single mistakes.
const MOST_FOR_ALL_ORDERS: usize = 4;
/// Rows by which a log may be off, either way. Convention: an index that starts at 1, a header counted, a frame or two lost at the start.
const MOST_SHIFT: i64 = 3;
/// Lags are tried up to so many sampling intervals, either way, in steps of a share of one.
///
/// Convention: as far as [`MOST_SHIFT`]; a quarter is half the distance at which whole shifts become indistinguishable.
const LAG_STEPS_PER_SAMPLE: i32 = 4;

/// One way in which the log may be meant.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Candidate {
    /// For each backbone its column, from 1.
    pub columns: Vec<usize>,
    /// For each backbone its sign.
    pub signs: Vec<i8>,
    /// Rows after the frame's own.
    pub shift: i64,
}

impl Candidate {
    /// As it stands.
    pub fn straight(backbones: usize) -> Self {
        Self { columns: (1..=backbones).collect(), signs: vec![1; backbones], shift: 0 }
    }
}

/// Orders of the columns with signs, the log's own first.
pub(super) fn signed_permutations(backbones: usize) -> Vec<(Vec<usize>, Vec<i8>)> {
    let straight: Vec<usize> = (1..=backbones).collect();
    let mut found: Vec<(Vec<usize>, Vec<i8>)> = Vec::new();
    let mut add = |columns: Vec<usize>, signs: Vec<i8>| {
        if !found.contains(&(columns.clone(), signs.clone())) {
            found.push((columns, signs));
        }
    };
    let orders = if backbones <= MOST_FOR_ALL_ORDERS { permutations(backbones) } else { round_the_circle(backbones) };
    for columns in &orders {
        let signs = if backbones <= MOST_FOR_ALL_ORDERS { 1u32 << backbones } else { 1 };
        for flipped in 0..signs {
            let sign = |i: usize| if flipped >> i & 1 == 1 { -1 } else { 1 };
            add(columns.clone(), (0..backbones).map(sign).collect());
        }
        add(columns.clone(), vec![-1; backbones]);
    }
    if backbones > MOST_FOR_ALL_ORDERS {
        for i in 0..backbones {
            let mut signs = vec![1; backbones];
            signs[i] = -1;
            add(straight.clone(), signs);
            for j in 0..i {
                let mut columns = straight.clone();
                columns.swap(i, j);
                add(columns, vec![1; backbones]);
            }
        }
    }
    found
}

fn permutations(count: usize) -> Vec<Vec<usize>> {
    if count == 0 {
        return vec![Vec::new()];
    }
    let mut all = Vec::new();
    for shorter in permutations(count - 1) {
        for place in (0..count).rev() {
            let mut longer = shorter.clone();
            longer.insert(place, count);
            all.push(longer);
        }
    }
    all
}

/// The orders that number the backbones from another one on, or the other way round.
fn round_the_circle(backbones: usize) -> Vec<Vec<usize>> {
    let from = |first: usize, backwards: bool| {
        let place = move |i: usize| if backwards { first + backbones - i } else { first + i };
        (0..backbones).map(move |i| 1 + place(i) % backbones).collect()
    };
    (0..backbones).flat_map(|first| [from(first, false), from(first, true)]).collect()
}

/// Shifts of the rows, none among them; and the one that lays the log's first row on the first frame.
pub(super) fn shifts(poses: &[Pose], log: &[EncoderReading]) -> Vec<i64> {
    let mut shifts: Vec<i64> = (-MOST_SHIFT..=MOST_SHIFT).collect();
    if let (Some(pose), Some(row)) = (poses.first(), log.first()) {
        let lay = row.index as i64 - pose.index as i64;
        if !shifts.contains(&lay) {
            shifts.push(lay);
        }
    }
    shifts
}

/// Ages of the readings that are tried, s; none where the log has no sampling interval.
pub(super) fn lags(samples: &Samples) -> Vec<f64> {
    let Some(interval_s) = samples.interval_s() else { return Vec::new() };
    let most = MOST_SHIFT as i32 * LAG_STEPS_PER_SAMPLE;
    let steps = (-most..=most).filter(|&step| step != 0);
    steps.map(|step| f64::from(step) / f64::from(LAG_STEPS_PER_SAMPLE) * interval_s).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_backbones_have_48_signed_orders_and_many_have_their_single_mistakes() {
        let all = signed_permutations(3);
        assert_eq!(all.len(), 48);
        assert_eq!(all[0], (vec![1, 2, 3], vec![1, 1, 1]));
        assert_eq!(signed_permutations(4).len(), 24 * 16);
        let six = signed_permutations(6);
        // 12 of the circle with both signs, 6 single signs, 15 swaps.
        assert_eq!(six.len(), 12 * 2 + 6 + 15);
        assert!(six.contains(&(vec![1, 6, 5, 4, 3, 2], vec![1; 6])), "the other way round");
        assert!(six.contains(&(vec![3, 4, 5, 6, 1, 2], vec![-1; 6])));
    }
}
