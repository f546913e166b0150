//! The times that a sender writes on its frames: which of them are new, and whether they are of a clock of the sender's own.
//!
//! Looks at no clock itself: the caller says what time it is.

use super::clock_offset::ONE_NETWORK_WITHIN_S;

/// A stamp earlier than the last by more than this comes from a clock that was set anew, s; by less, from a frame that came twice or late.
/// Convention: as for the encoders' readings.
const CLOCK_SET_BACK_S: f64 = 0.25;

/// The stamps so far.
#[derive(Debug, Default)]
pub struct FrameStamps {
    last_s: Option<f64>,
    /// Whether it was told that the sender has a clock of its own.
    told: bool,
}

impl FrameStamps {
    /// Takes the stamp of a frame that came at a Unix time, s; what the user is to know of it, if anything.
    ///
    /// # Errors
    /// A stamp that was never set, that came before, or that is older than the last: in words, without numbers that change.
    pub fn take(&mut self, stamp_s: f64, unix_s: f64) -> Result<Option<String>, String> {
        if stamp_s == 0.0 || !stamp_s.is_finite() {
            return Err(
                "pictures have no time (header.stamp is 0): see that their driver sets it; they are passed over".into(),
            );
        }
        if self.last_s.is_some_and(|last_s| stamp_s <= last_s && last_s - stamp_s < CLOCK_SET_BACK_S) {
            return Err(
                "pictures come whose time is not after that of the one before, as when one is sent twice; they are \
                        passed over"
                    .into(),
            );
        }
        self.last_s = Some(stamp_s);
        let behind_s = unix_s - stamp_s;
        if self.told || behind_s.abs() <= ONE_NETWORK_WITHIN_S {
            return Ok(None);
        }
        self.told = true;
        let side = if behind_s > 0.0 { "behind" } else { "ahead of" };
        Ok(Some(format!(
            "the pictures' times are {:.3} s {side} this machine's clock; readings are matched by the pictures' own times",
            behind_s.abs()
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_that_come_twice_or_without_a_time_are_refused_and_a_clock_set_back_is_followed() {
        let mut stamps = FrameStamps::default();
        assert_eq!(stamps.take(100.0, 100.05), Ok(None));
        for (stamp_s, expected) in
            [(100.0, "sent twice"), (99.9, "sent twice"), (0.0, "have no time"), (f64::NAN, "no time")]
        {
            let why = stamps.take(stamp_s, 100.1).unwrap_err();
            assert!(why.contains(expected), "{why}");
        }
        // A delay is none of a clock.
        assert_eq!(stamps.take(100.1, 102.0), Ok(None));
        // A recording that is played again.
        let told = stamps.take(50.0, 102.0).unwrap().unwrap();
        assert!(told.contains("52.000 s behind this machine's clock"), "{told}");
        assert_eq!(stamps.take(50.1, 102.1), Ok(None), "told once");
    }
}
