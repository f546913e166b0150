//! `--shard I/N`: one part of the frames.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// One part of several that the frames are shared out to: every `of`-th, from the `part`-th (counted from 1) on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Shard {
    /// Which, from 1.
    pub part: usize,
    /// Of how many.
    pub of: usize,
}

impl Shard {
    /// All frames.
    pub const WHOLE: Self = Self { part: 1, of: 1 };

    /// Whether the frame of this rank (from 0) is of this part.
    pub fn has(self, rank: usize) -> bool {
        rank % self.of == self.part - 1
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let numbers = text.split_once('/').map(|(part, of)| (part.parse(), of.parse()));
        match numbers {
            Some((Ok(part), Ok(of))) if 1 <= part && part <= of => Ok(Self { part, of }),
            _ => Err(format!("{text:?} is no part of the frames, expected I/N with I from 1 to N, such as 2/8")),
        }
    }
}

impl TryFrom<String> for Shard {
    type Error = String;

    fn try_from(text: String) -> std::result::Result<Self, String> {
        text.parse()
    }
}

impl From<Shard> for String {
    fn from(shard: Shard) -> Self {
        shard.to_string()
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.part, self.of)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_are_told_apart_and_have_every_frame_once() {
        let shards: Vec<Shard> = ["1/3", "2/3", "3/3"].map(|text| text.parse().unwrap()).to_vec();
        for rank in 0..20 {
            assert_eq!(shards.iter().filter(|shard| shard.has(rank)).count(), 1);
        }
        assert_eq!(shards[1].to_string(), "2/3");
        for wrong in ["", "3", "0/3", "4/3", "1/0", "-1/2", "1/2/3", "a/b"] {
            assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
        }
    }
}
