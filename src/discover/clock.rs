//! The times of the samples: checked, and replaced where the clock failed.

use crate::statistics::order::median;

/// A time step of this many median steps is reported as a jump.
///
/// Convention: decides about a remark only.
const JUMP_IN_STEPS: f64 = 30.0;

/// The times to work with, s, and what is to be said of them.
///
/// A clock that stands still or goes back cannot order the samples. They are then taken in the order of their indices, at even
/// steps of the median of the rising ones (1 s where none rises).
pub fn checked(read_s: &[f64]) -> (Vec<f64>, Option<String>) {
    let steps = || read_s.windows(2).map(|pair| pair[1] - pair[0]);
    let mut rising: Vec<f64> = steps().filter(|step| *step > 0.0).collect();
    let usual_s = if rising.is_empty() { 1.0 } else { median(&mut rising) };
    if let Some(k) = steps().position(|step| step <= 0.0) {
        let even = (0..read_s.len()).map(|k| usual_s * k as f64).collect();
        let remark = format!(
            "times do not rise ({} s after {} s): the order of the indices and even steps of {usual_s:.3} s were taken instead, and \
             effects of time and speed are less sure",
            read_s[k + 1],
            read_s[k]
        );
        return (even, Some(remark));
    }
    let longest_s = rising.iter().copied().fold(0.0, f64::max);
    let jump = (longest_s > JUMP_IN_STEPS * usual_s).then(|| {
        format!(
            "time jumps by {longest_s:.1} s where {usual_s:.3} s is usual: how the snake moved in between is not known"
        )
    });
    (read_s.to_vec(), jump)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_goes_back_is_replaced_by_even_steps() {
        let (times, remark) = checked(&[0.0, 0.5, 1.0, 0.2, 0.7]);
        assert_eq!(times, [0.0, 0.5, 1.0, 1.5, 2.0]);
        assert!(remark.unwrap().contains("0.2 s after 1 s"));
    }

    #[test]
    fn a_clock_that_stands_still_counts_seconds() {
        let (times, remark) = checked(&[7.0, 7.0, 7.0]);
        assert_eq!(times, [0.0, 1.0, 2.0]);
        assert!(remark.unwrap().contains("times do not rise"));
    }

    #[test]
    fn a_jump_is_reported_and_the_times_are_kept() {
        let (times, remark) = checked(&[0.0, 0.5, 1.0, 100.0, 100.5]);
        assert_eq!(times, [0.0, 0.5, 1.0, 100.0, 100.5]);
        assert!(remark.unwrap().contains("jumps by 99.0 s"));
    }

    #[test]
    fn an_even_clock_gives_no_remark() {
        assert_eq!(checked(&[0.0, 0.5, 1.1]), (vec![0.0, 0.5, 1.1], None));
    }
}
