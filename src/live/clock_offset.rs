//! The offset between the encoders' clock and the frames'.
//!
//! A reading carries the encoders' time and arrives at a time of the frames' clock. The difference of the two is the offset between
//! the clocks plus the delay of the line, so that the least difference over some seconds is the offset plus the shortest delay. Where
//! it is small the clocks are taken for one; else the encoders have a clock of their own and the difference is taken off. Lines that
//! arrive in a burst, such as a file that was complete beforehand, tell nothing of the clock.

use super::status::ClockState;

/// A clock difference below this is taken for the delay of the line, s. Convention: longer than any line delays a reading, shorter
/// than two clocks that nobody has set to each other differ.
const SHARED_WITHIN_S: f64 = 0.25;
/// The same of messages with a header, whose times a network takes for those of one clock, s. Convention: longer than pictures are delayed, even
/// the first one on a busy machine; what such clocks differ by shows in the motion. A clock of its own, as one that counts from its
/// start, differs by more.
pub const ONE_NETWORK_WITHIN_S: f64 = 5.0;
/// The least difference is taken over this time, s. Convention: long enough to meet a line that was not delayed, short enough that
/// clocks which drift apart by 100 ppm differ by a millisecond.
const WINDOW_S: f64 = 10.0;
/// Lines whose stamps advance faster than this many times their arrivals come from a store, not from the robot.
///
/// Convention: two clocks differ by far less, and a stored log is sent many times faster.
const MAX_REPLAY_SPEED: f64 = 1.5;
/// What the stamps may gain at once without being taken for a replay, s: lines that a network held back.
///
/// Convention: a stall of a wireless network; a longer one is taken for a replay until the stamps advance at the usual rate.
const MAX_CATCH_UP_S: f64 = 0.5;

/// Estimates by how much the encoders' clock is behind the frames'.
#[derive(Debug)]
pub struct ClockOffset {
    given: Option<f64>,
    /// A difference below this is a delay, s.
    shared_within_s: f64,
    current: Option<Window>,
    last: Option<Window>,
}

/// The lines of one window of time.
#[derive(Debug, Clone, Copy)]
struct Window {
    first_arrival_s: f64,
    first_stamp_s: f64,
    arrival_s: f64,
    stamp_s: f64,
    least_s: f64,
}

impl Window {
    /// Whether lines arrived about as fast as their stamps advance.
    fn is_live(&self) -> bool {
        let arrivals_s = self.arrival_s - self.first_arrival_s;
        self.stamp_s - self.first_stamp_s < MAX_REPLAY_SPEED * arrivals_s + MAX_CATCH_UP_S
    }
}

impl ClockOffset {
    /// An offset that the user gave, s; without one it is estimated.
    pub fn new(given: Option<f64>) -> Self {
        Self { given, shared_within_s: SHARED_WITHIN_S, current: None, last: None }
    }

    /// The same of the times of a network's messages.
    pub fn of_messages(given: Option<f64>) -> Self {
        Self { shared_within_s: ONE_NETWORK_WITHIN_S, ..Self::new(given) }
    }

    /// The encoders' clock was set anew: what was seen of it before means nothing.
    pub fn restart(&mut self) {
        (self.current, self.last) = (None, None);
    }

    /// A line with this stamp was read at this time of the frames' clock. One that may have waited before, since as much was there as can be read
    /// at once, tells how fast lines come, and nothing of the offset.
    pub fn observe(&mut self, stamp_s: f64, arrival_s: f64, may_have_waited: bool) {
        let difference_s = if may_have_waited { f64::INFINITY } else { arrival_s - stamp_s };
        if let Some(window) = &mut self.current
            && arrival_s - window.first_arrival_s < WINDOW_S
        {
            window.arrival_s = arrival_s;
            window.stamp_s = stamp_s;
            window.least_s = window.least_s.min(difference_s);
            return;
        }
        self.last = self.current.filter(Window::is_live);
        self.current = Some(Window {
            first_arrival_s: arrival_s,
            first_stamp_s: stamp_s,
            arrival_s,
            stamp_s,
            least_s: difference_s,
        });
    }

    /// What is known of the clock, and what to add to a stamp to get the frames' time, s.
    pub fn estimate(&self) -> (ClockState, f64) {
        if let Some(given) = self.given {
            return (ClockState::Given, given);
        }
        let live = [self.current.filter(Window::is_live), self.last];
        let least =
            live.iter().flatten().map(|window| window.least_s).filter(|least| least.is_finite()).reduce(f64::min);
        match (least, self.current) {
            (Some(least), _) if least.abs() > self.shared_within_s => (ClockState::Foreign, least),
            (_, Some(_)) => (ClockState::Shared, 0.0),
            (_, None) => (ClockState::Unknown, 0.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// Lines at 200 Hz whose clock is behind by `offset` and that take 1 to 30 ms.
    fn observed(offset: f64, drift: f64) -> ClockOffset {
        let mut random = rand::rngs::StdRng::seed_from_u64(1);
        let mut clock = ClockOffset::new(None);
        for k in 0..6000 {
            let true_s = 1000.0 + f64::from(k) / 200.0;
            clock.observe(true_s * (1.0 + drift) - offset, true_s + random.random_range(0.001..0.03), false);
        }
        clock
    }

    #[test]
    fn a_shared_clock_is_left_alone_and_a_foreign_one_found() {
        assert_eq!(observed(0.0, 0.0).estimate(), (ClockState::Shared, 0.0));
        for offset in [-0.5, 3.25, 1_760_000_000.0] {
            let (state, found) = observed(offset, 0.0).estimate();
            assert_eq!(state, ClockState::Foreign);
            assert!((found - offset - 0.001).abs() < 2e-3, "{found} for {offset}");
        }
    }

    #[test]
    fn a_backlog_is_not_taken_for_a_clock_and_neither_is_the_end_of_a_file() {
        let mut clock = ClockOffset::new(None);
        // Lines that wait longer and longer, and now and then one that was read as it came.
        for k in 0..2000 {
            let stamp_s = f64::from(k) / 100.0;
            let waited_s = if k % 500 == 0 { 0.01 } else { 0.1 * stamp_s };
            clock.observe(stamp_s, stamp_s + waited_s, waited_s > 0.1);
        }
        assert_eq!(clock.estimate(), (ClockState::Shared, 0.0));
        let mut clock = ClockOffset::new(None);
        (0..5000).for_each(|k| clock.observe(f64::from(k) / 100.0, 1.0, k < 4990));
        assert_eq!(clock.estimate(), (ClockState::Shared, 0.0));
    }

    #[test]
    fn a_burst_of_old_lines_says_nothing_about_the_clock() {
        let mut clock = ClockOffset::new(None);
        for k in 0..10_000 {
            clock.observe(f64::from(k) / 100.0, 5.0 + f64::from(k) * 1e-6, false);
        }
        assert_eq!(clock.estimate().0, ClockState::Shared);
        // What then comes as it happens does.
        for k in 10_000..14_000 {
            let stamp = f64::from(k) / 100.0;
            clock.observe(stamp, stamp + 50.0, false);
        }
        let (state, found) = clock.estimate();
        assert_eq!(state, ClockState::Foreign);
        assert!((found - 50.0).abs() < 1e-6);
    }
}
