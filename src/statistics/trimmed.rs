//! Least trimmed squares (LTS): the fit whose h best-fitted observations have the least sum of squares.
//!
//! Up to n − h observations may be anything. From subsets just large enough for a fit, *concentration steps* go down: fit, keep the h
//! observations that fit best, fit these. Each can only lower the trimmed sum.
//!
//! Source: P. J. Rousseeuw, K. Van Driessen, "Computing LTS Regression for Large Data Sets", Data Mining and Knowledge Discovery 12,
//! 2006.

use rand::rngs::StdRng;
use rand::{SeedableRng, seq::index};

/// The outcome of a search for the least trimmed squares.
#[derive(Debug, Clone, PartialEq)]
pub struct Trimmed {
    /// The observations that are kept, the best first.
    pub members: Vec<usize>,
    /// Their sum of squares.
    pub sum: f64,
}

/// How many observations LTS keeps of `count` so that the most outliers can be borne: a bare majority.
///
/// Derived: with p parameters the highest breakdown point is at (n + p + 1)/2; a majority is that to within p/2.
pub fn majority(count: usize) -> usize {
    count / 2 + 1
}

/// Subsets of `size` out of `count` observations to start from: all of them where there are at most `most`, else so many drawn at
/// random with a seed.
pub fn subsets(count: usize, size: usize, most: usize, seed: u64) -> Vec<Vec<usize>> {
    let all = (0..size).fold(1.0, |ways, k| ways * (count as f64 - k as f64) / (k as f64 + 1.0));
    if all <= most as f64 {
        return combinations(count, size);
    }
    let mut random = StdRng::seed_from_u64(seed);
    (0..most).map(|_| index::sample(&mut random, count, size).into_vec()).collect()
}

/// All subsets of `size` out of `count`, in order of their largest members.
fn combinations(count: usize, size: usize) -> Vec<Vec<usize>> {
    if size == 0 {
        return vec![Vec::new()];
    }
    let extended = |last: usize| {
        let rests = combinations(last, size - 1);
        rests.into_iter().map(move |mut rest| {
            rest.push(last);
            rest
        })
    };
    (0..count).flat_map(extended).collect()
}

/// The `kept` observations of `count` with the least sum of squares about a fit to themselves, as found from these starts.
///
/// `fit` gives the parameters of a fit to some observations, `square` the squared misfit of one observation at parameters. After a
/// start `steps` concentration steps are made. `None` where no start can be fitted.
pub fn least_trimmed_squares<X>(
    count: usize,
    kept: usize,
    starts: impl IntoIterator<Item = Vec<usize>>,
    steps: usize,
    fit: impl Fn(&[usize]) -> Option<X>,
    square: impl Fn(&X, usize) -> f64,
) -> Option<Trimmed> {
    let concentrated = |start: Vec<usize>| {
        let mut best = Trimmed { members: start, sum: f64::INFINITY };
        for _ in 0..=steps {
            let x = fit(&best.members)?;
            let mut squares: Vec<(f64, usize)> = (0..count).map(|k| (square(&x, k), k)).collect();
            squares.sort_by(|a, b| a.0.total_cmp(&b.0));
            squares.truncate(kept);
            let sum = squares.iter().map(|(square, _)| square).sum();
            best = Trimmed { members: squares.into_iter().map(|(_, k)| k).collect(), sum };
        }
        Some(best)
    };
    starts.into_iter().filter_map(concentrated).min_by(|a, b| a.sum.total_cmp(&b.sum))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::moments::mean;
    use proptest::prelude::*;

    /// LTS of location: values, kept; the mean of the members.
    fn location(values: &[f64], kept: usize, starts: Vec<Vec<usize>>) -> (Trimmed, f64) {
        let fit = |members: &[usize]| Some(mean(members.iter().map(|&k| values[k])));
        let square = |x: &f64, k: usize| (values[k] - x).powi(2);
        let found = least_trimmed_squares(values.len(), kept, starts, 20, fit, square).unwrap();
        let x = fit(&found.members).unwrap();
        (found, x)
    }

    proptest! {
        #[test]
        fn of_location_it_is_the_closest_run_of_sorted_values(mut values in proptest::collection::vec(-10.0..10.0f64, 4..12)) {
            // Rousseeuw, Leroy, Robust Regression and Outlier Detection, 1987, ch. 4: the exact LTS of location is the mean of the h
            // neighbours in order with the least variance.
            let kept = majority(values.len());
            let (found, _) = location(&values, kept, subsets(values.len(), 2, 1000, 1));
            values.sort_by(f64::total_cmp);
            let about_the_mean = |run: &[f64]| {
                let centre = mean(run.iter().copied());
                run.iter().map(|value| (value - centre).powi(2)).sum::<f64>()
            };
            let exact = values.windows(kept).map(about_the_mean).fold(f64::INFINITY, f64::min);
            prop_assert!((found.sum - exact).abs() <= 1e-9 * (1.0 + exact), "{} {exact}", found.sum);
        }
    }

    #[test]
    fn outliers_up_to_a_minority_have_no_say() {
        let mut values: Vec<f64> = (0..30).map(|k| 5.0 + 0.01 * f64::from(k % 7)).collect();
        values.extend([1e6; 14]);
        values.extend([-4e5; 14]);
        // Drawn, not enumerated: 58 · 57/2 pairs are more than 100.
        let (found, x) = location(&values, majority(58), subsets(58, 2, 100, 3));
        assert_eq!(found.members.len(), 30);
        assert!((x - 5.03).abs() < 0.01, "{x}");
    }

    #[test]
    fn subsets_are_all_or_as_many_as_asked_for_and_the_same_for_a_seed() {
        assert_eq!(subsets(4, 2, 6, 0), [[0, 1], [0, 2], [1, 2], [0, 3], [1, 3], [2, 3]]);
        assert_eq!(subsets(1, 2, 6, 0), Vec::<Vec<usize>>::new());
        let drawn = subsets(100, 3, 50, 9);
        assert_eq!(drawn.len(), 50);
        assert_eq!(drawn, subsets(100, 3, 50, 9));
        assert!(drawn.iter().all(|set| set[0] != set[1] && set[1] != set[2] && set[0] != set[2]));
    }
}
