//! Sweeps: the pieces of an experiment that cross-validation leaves out and the bootstrap draws, as a whole.
//!
//! Samples of one sweep share their history (creep, play), so that single samples left out would be predicted by their
//! neighbours. Whole sweeps are the blocks of a block bootstrap and a blocked cross-validation.

/// The number of folds of the cross-validation.
///
/// Convention: 5 to 10 folds are usual (Hastie, Tibshirani and Friedman, The Elements of Statistical Learning, 2nd ed., 7.10.1).
pub const FOLDS: usize = 5;

/// A turn of θ by this share of its range begins a new sweep.
///
/// Convention: any turn that is larger than the noise of θ and smaller than a sweep gives the same pieces.
const TURN_SHARE: f64 = 0.25;

/// The fewest samples of a piece that is cut at no turn.
///
/// Convention: keeps the pieces of the shortest experiments from being single samples.
const LEAST_PIECE: usize = 3;

/// The sweep of each sample, counted from 0, from its bend θ (rad).
///
/// A sweep ends where θ turns by more than a quarter of its range. What is longer than half a fold (a round at one θ has no turn)
/// is cut again, so that every fold receives some.
pub fn cut(thetas: &[f64]) -> Vec<usize> {
    let (least, most) = thetas.iter().fold((f64::INFINITY, 0.0f64), |(a, b), &t| (a.min(t), b.max(t)));
    let turn = TURN_SHARE * (most - least);
    let longest = thetas.len().div_ceil(2 * FOLDS).max(LEAST_PIECE);
    let mut sweep = 0;
    let (mut began, mut rising, mut extreme) = (0, None, thetas.first().copied().unwrap_or(0.0));
    let mut numbers = Vec::with_capacity(thetas.len());
    for (k, &theta) in thetas.iter().enumerate() {
        let turned = match rising {
            None => (theta - extreme).abs() > turn,
            Some(true) => theta < extreme - turn,
            Some(false) => theta > extreme + turn,
        };
        if turned {
            sweep += usize::from(rising.is_some());
            rising = Some(theta > extreme);
            extreme = theta;
            began = k;
        } else if k - began >= longest {
            sweep += 1;
            began = k;
        }
        match rising {
            Some(true) => extreme = extreme.max(theta),
            Some(false) => extreme = extreme.min(theta),
            None => {}
        }
        numbers.push(sweep);
    }
    numbers
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triangle_is_cut_a_quarter_of_its_range_after_each_turn() {
        // Up to 40 and down again, twice, in steps of 4: pieces of 11 samples are not longer than half a fold.
        let up = (0..10).map(|k| 4.0 * f64::from(k));
        let down = (1..=10).rev().map(|k| 4.0 * f64::from(k));
        let thetas: Vec<f64> = up.clone().chain(down.clone()).chain(up).chain(down).cycle().take(120).collect();
        let sweeps = cut(&thetas);
        let starts: Vec<usize> = (1..120).filter(|&k| sweeps[k] != sweeps[k - 1]).collect();
        // Each turn is noticed at the third sample after it, 12 of 40 away.
        assert_eq!(starts[..4], [13, 23, 33, 43]);
    }

    #[test]
    fn a_round_without_a_turn_is_cut_into_pieces_of_half_a_fold() {
        let sweeps = cut(&[0.5; 100]);
        assert_eq!(sweeps.last(), Some(&9));
        assert!((0..10).all(|sweep| sweeps.iter().filter(|&&s| s == sweep).count() == 10));
    }

    #[test]
    fn numbers_rise_one_by_one_from_zero() {
        let thetas: Vec<f64> = (0..500).map(|k| 0.6 + 0.5 * (0.37 * f64::from(k)).sin()).collect();
        let sweeps = cut(&thetas);
        assert_eq!(sweeps[0], 0);
        assert!(sweeps.windows(2).all(|pair| pair[1] == pair[0] || pair[1] == pair[0] + 1));
    }

    #[test]
    fn no_samples_have_no_sweeps() {
        assert!(cut(&[]).is_empty());
    }
}
