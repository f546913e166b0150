//! The times that a sender writes on its frames: which of them are new, and by how much the sender's clock is behind this machine's.
//!
//! Looks at no clock itself: the caller says what time it is.

use super::clock_offset::ClockOffset;
use super::status::ClockState;

/// A stamp earlier than the last by more than this comes from a clock that was set anew, s; by less, from a frame that came twice or late.
/// Convention: as for the encoders' readings.
const CLOCK_SET_BACK_S: f64 = 0.25;

/// The stamps so far.
#[derive(Debug)]
pub struct FrameStamps {
    last_s: Option<f64>,
    offset: ClockOffset,
    /// Whether it was told that the sender has a clock of its own.
    told: bool,
}

/// A stamp that is new.
#[derive(Debug, Clone, PartialEq)]
pub struct NewStamp {
    /// What to add to a stamp to get Unix time, s.
    pub offset_s: f64,
    /// What the user is to know.
    pub remark: Option<String>,
}

impl FrameStamps {
    /// No stamps yet.
    pub fn new() -> Self {
        Self { last_s: None, offset: ClockOffset::of_messages(None), told: false }
    }

    /// Takes the stamp of a frame that came at a Unix time, s.
    ///
    /// # Errors
    /// A stamp that was never set, that came before, or that is older than the last: in words, without numbers that change.
    pub fn take(&mut self, stamp_s: f64, unix_s: f64) -> Result<NewStamp, String> {
        if stamp_s == 0.0 || !stamp_s.is_finite() {
            return Err(
                "pictures have no time (header.stamp is 0): see that their driver sets it; they are passed over".into(),
            );
        }
        if let Some(last_s) = self.last_s
            && stamp_s <= last_s
        {
            if last_s - stamp_s < CLOCK_SET_BACK_S {
                return Err("pictures come whose time is not after that of the one before, as when one is sent twice; they are \
                            passed over"
                    .into());
            }
            self.offset.restart();
        }
        self.last_s = Some(stamp_s);
        self.offset.observe(stamp_s, unix_s);
        let (clock, offset_s) = self.offset.estimate();
        let is_foreign = clock == ClockState::Foreign;
        let remark = (is_foreign && !self.told).then(|| {
            format!(
                "the pictures' times are {:.3} s {} this machine's clock; readings are matched by the pictures' own times",
                offset_s.abs(),
                if offset_s > 0.0 { "behind" } else { "ahead of" }
            )
        });
        self.told |= is_foreign;
        Ok(NewStamp { offset_s, remark })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_that_come_twice_or_without_a_time_are_refused_and_a_clock_set_back_is_followed() {
        let mut stamps = FrameStamps::new();
        assert_eq!(stamps.take(100.0, 100.05), Ok(NewStamp { offset_s: 0.0, remark: None }));
        for (stamp_s, expected) in
            [(100.0, "sent twice"), (99.9, "sent twice"), (0.0, "have no time"), (f64::NAN, "no time")]
        {
            let why = stamps.take(stamp_s, 100.1).unwrap_err();
            assert!(why.contains(expected), "{why}");
        }
        // A delay is none of a clock.
        assert_eq!(stamps.take(100.1, 102.0).unwrap(), NewStamp { offset_s: 0.0, remark: None });
        // A recording that is played again.
        let again = stamps.take(50.0, 102.0).unwrap();
        assert!((again.offset_s - 52.0).abs() < 1e-9, "{again:?}");
        assert!(again.remark.unwrap().contains("52.000 s behind this machine's clock"));
        assert_eq!(stamps.take(50.1, 102.1).unwrap().remark, None, "told once");
    }
}
