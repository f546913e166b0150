//! Tells of a camera or of encoders from which nothing comes, once each time, and of their return.

use super::status::{EncoderStatus, SourceState, SourceStatus};
use std::time::{Duration, Instant};

/// Nothing is told of a silence shorter than this. Convention: what it takes a network camera to answer.
pub(super) const PATIENCE: Duration = Duration::from_secs(3);

/// What was told so far.
#[derive(Debug)]
pub struct Silence {
    frames: Since,
    encoders: Since,
}

/// Since when one of them is silent, and whether that was told.
#[derive(Debug)]
struct Since {
    heard: Instant,
    told: bool,
}

impl Silence {
    /// At the start nothing was heard yet.
    pub fn new(now: Instant) -> Self {
        let since = || Since { heard: now, told: false };
        Self { frames: since(), encoders: since() }
    }

    /// What is to be told now.
    pub fn told(&mut self, now: Instant, source: &SourceStatus, encoders: &EncoderStatus) -> Vec<String> {
        let frames_come = matches!(source.state, SourceState::Running | SourceState::Ended);
        let of_frames = self.frames.told(now, frames_come).map(|told| match told {
            true => "frames come again".to_owned(),
            false => format!("no frames come: {}", source.trouble.as_deref().unwrap_or("nothing is known of why")),
        });
        let readings_come = !matches!(encoders.state, "waiting" | "lost");
        let of_encoders = self.encoders.told(now, readings_come).map(|told| match told {
            true => "encoder readings come again".to_owned(),
            false => {
                let why = encoders.trouble.as_ref().or(encoders.last_bad.as_ref()).cloned();
                let why = why.unwrap_or_else(|| match encoders.readings {
                    0 => "nothing is known of why".to_owned(),
                    count => format!("{count} came before; a file that is complete has no more"),
                });
                format!("no encoder readings come: {why}")
            }
        });
        of_frames.into_iter().chain(of_encoders).collect()
    }
}

impl Since {
    /// Whether a silence is to be told of (`false`), or its end (`true`).
    fn told(&mut self, now: Instant, comes: bool) -> Option<bool> {
        if comes {
            self.heard = now;
        }
        let is_silent = now - self.heard > PATIENCE;
        (is_silent != self.told).then(|| {
            self.told = is_silent;
            !is_silent
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_silence_is_told_once_with_its_reason_and_so_is_its_end() {
        let began = Instant::now();
        let mut silence = Silence::new(began);
        let source =
            |state, trouble: &str| SourceStatus { state, trouble: Some(trouble.into()), ..SourceStatus::default() };
        let (gone, here) = (source(SourceState::Waiting, "no such camera"), source(SourceState::Running, ""));
        let mut refused = EncoderStatus::at_rest("waiting", 0);
        refused.trouble = Some("connection refused".into());
        let mut at = |seconds, source: &SourceStatus, encoders: &EncoderStatus| {
            silence.told(began + Duration::from_secs(seconds), source, encoders)
        };
        assert!(at(2, &gone, &refused).is_empty());
        assert_eq!(
            at(4, &gone, &refused),
            ["no frames come: no such camera", "no encoder readings come: connection refused"]
        );
        assert!(at(5, &gone, &refused).is_empty());
        assert_eq!(at(6, &here, &refused), ["frames come again"]);
        assert_eq!(at(7, &here, &EncoderStatus::at_rest("none", 0)), ["encoder readings come again"]);
        let ended = "no encoder readings come: 17 came before; a file that is complete has no more";
        assert_eq!(at(11, &here, &EncoderStatus::at_rest("lost", 17)), [ended]);
    }
}
