//! One publisher of what there must be only one of.
//!
//! Pictures of two cameras, or two values of one joint, must not be mixed. The publisher that came first is taken; another is passed over
//! until the first was silent for a while, as when it died and was started anew.

use std::time::{Duration, Instant};

/// A publisher that is silent for this time has made room for another. Convention: as for encoders that are lost.
const HANDOVER: Duration = Duration::from_secs(2);

/// Who is taken, and who else was heard.
#[derive(Debug)]
pub struct SolePublisher<Id> {
    taken: Option<(Id, Instant)>,
    other: Option<Instant>,
}

/// What to do with a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Heard {
    /// Take it.
    Taken,
    /// Take it, and tell that another sends the same.
    TakenOfTwo,
    /// Pass it over.
    PassedOver,
}

impl<Id: PartialEq> SolePublisher<Id> {
    /// Nobody was heard yet.
    pub fn new() -> Self {
        Self { taken: None, other: None }
    }

    /// A message of this publisher came.
    pub fn hear(&mut self, publisher: Id, now: Instant) -> Heard {
        let recently = |at: Instant| now.saturating_duration_since(at) < HANDOVER;
        if let Some((taken, at)) = &self.taken
            && *taken != publisher
            && recently(*at)
        {
            self.other = Some(now);
            return Heard::PassedOver;
        }
        if self.taken.as_ref().is_some_and(|(taken, _)| *taken != publisher) {
            self.other = None;
        }
        let of_two = self.other.is_some_and(recently);
        self.taken = Some((publisher, now));
        if of_two { Heard::TakenOfTwo } else { Heard::Taken }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_of_two_is_taken_and_the_second_once_the_first_is_gone() {
        let (mut sole, began) = (SolePublisher::new(), Instant::now());
        let mut hear = |publisher: u8, ms: u64| sole.hear(publisher, began + Duration::from_millis(ms));
        assert_eq!([hear(1, 0), hear(1, 100)], [Heard::Taken; 2]);
        assert_eq!([hear(2, 110), hear(1, 200)], [Heard::PassedOver, Heard::TakenOfTwo]);
        // The first dies, and the second stays.
        assert_eq!([hear(2, 2100), hear(2, 2300), hear(2, 2400)], [Heard::PassedOver, Heard::Taken, Heard::Taken]);
        // One that was started anew within a moment is no second one.
        assert_eq!([hear(3, 2500), hear(3, 4390)], [Heard::PassedOver; 2]);
        assert_eq!([hear(3, 4410), hear(3, 4500)], [Heard::Taken; 2]);
    }
}
