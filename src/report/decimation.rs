//! Decimation: which of many things are kept so that a bounded number of them, spread evenly, remains.

/// Whether the i-th (from 0) of `count` things is kept when they are decimated to `wanted`; all are where there are no more.
pub fn keeps(i: usize, wanted: usize, count: usize) -> bool {
    count <= wanted || (i + 1) * wanted / count > i * wanted / count
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn as_many_as_wanted_remain_and_their_gaps_differ_by_one_at_most(wanted in 1usize..50, count in 0usize..500) {
            let kept: Vec<usize> = (0..count).filter(|&i| keeps(i, wanted, count)).collect();
            prop_assert_eq!(kept.len(), wanted.min(count));
            let gaps = || kept.windows(2).map(|pair| pair[1] - pair[0]);
            prop_assert!(gaps().max().unwrap_or(1) <= gaps().min().unwrap_or(1) + 1);
        }
    }
}
