//! Whether a frame could be measured, and why not: the words of files, what they mean, and what to do.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::fmt;
use std::str::FromStr;

/// Whether a frame could be measured, and why not.
///
/// Written in snake_case; an unknown word in a file is kept as [`Other`](Self::Other).
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Status {
    /// Measured; the angles and their sigmas can be trusted.
    Ok,
    /// Nothing in the picture looks like the snake.
    NoSnake,
    /// Too much of the snake's outline is hidden or disturbed.
    Occluded,
    /// Two bends explain the picture equally well.
    Ambiguous,
    /// The outline contradicts what is known of the snake's shape, and no other shape explains all of it.
    UnknownShape,
    /// The outline is too soft for the edges to be placed, or they scatter too much for how thick the disks are.
    Blurred,
    /// The picture is almost entirely black or white.
    Saturated,
    /// Too much of the snake lies outside the picture.
    OutOfFrame,
    /// The camera is not where the rig says.
    CameraMoved,
    /// The snake's base is not where the rig says, though the grid is.
    BaseMoved,
    /// The camera was to be followed, but neither grid nor base tells where it is.
    GridLost,
    /// Views of the same moment contradict each other.
    ViewsDisagree,
    /// The picture could not be read.
    Unreadable,
    /// The picture has another size than the camera file says.
    WrongSize,
    /// The tracker has no position.
    TrackerLost,
    /// The tracker's position lies off what the tip can reach.
    TrackerJump,
    /// A reason that this version does not know.
    Other(String),
}

/// Each status that this version knows, its word in files, what it means, and what to do about it.
static KNOWN: [(Status, &str, &str, &str); 16] = [
    (Status::Ok, "ok", "the frame was measured", "nothing"),
    (
        Status::NoSnake,
        "no_snake",
        "nothing in the picture looks like the snake",
        "check that the frame is of this view, and that the light is that of the straight picture",
    ),
    (
        Status::Occluded,
        "occluded",
        "too much of the snake's outline is hidden or disturbed",
        "keep hands, tools and wires out of the view; a second view sees what this one does not",
    ),
    (
        Status::Ambiguous,
        "ambiguous",
        "two bends explain the picture equally well",
        "add a second view from the side; on a checkerboard, take one whose dark squares are lighter than the snake",
    ),
    (
        Status::UnknownShape,
        "unknown_shape",
        "the outline contradicts what is known of the snake's shape, and no other shape explains all of it, or more than one does",
        "measure a sequence of three frames or more, from which the shape is learned; if that does not help, look at the frame with `measure --explain` for contact along the body or something that touches the outline, and check robot.toml",
    ),
    (
        Status::Blurred,
        "blurred",
        "the outline is too blurred to place its edges",
        "let the snake rest while the frame is taken, expose for a shorter time, and focus on the snake",
    ),
    (Status::Saturated, "saturated", "the picture is almost entirely black or white", "correct exposure or light"),
    (
        Status::OutOfFrame,
        "out_of_frame",
        "too much of the snake lies outside the picture",
        "move the camera back or aside, so that the largest bend is within the picture",
    ),
    (
        Status::CameraMoved,
        "camera_moved",
        "the grid target is not where the straight picture shows it: the camera or the target moved",
        "take a new straight picture; if the camera is meant to move, use `--follow`",
    ),
    (
        Status::BaseMoved,
        "base_moved",
        "the base is not where the straight picture shows it, though the grid target is",
        "clamp the holder, and take a new straight picture",
    ),
    (
        Status::GridLost,
        "grid_lost",
        "the camera was to be followed, but neither grid target nor base shows where it is",
        "keep more of the grid target in the picture",
    ),
    (
        Status::ViewsDisagree,
        "views_disagree",
        "the views of one moment contradict each other",
        "trigger the cameras together; check `delta_offset_deg` of each view and its straight picture",
    ),
    (
        Status::Unreadable,
        "unreadable",
        "the picture could not be read",
        "check whether the file is complete, and write it again",
    ),
    (
        Status::WrongSize,
        "wrong_size",
        "the picture has another size than the camera file says",
        "calibrate the camera at the size of the frames; `snakeloop check` names the pictures",
    ),
    (
        Status::TrackerLost,
        "tracker_lost",
        "the tracker gave no position at that moment",
        "keep the sensor within the tracker's reach, and metal away from both",
    ),
    (
        Status::TrackerJump,
        "tracker_jump",
        "the tracker's position is farther from all points that the tip can reach than noise accounts for",
        "look for metal or another disturbance at that moment; if the sensor slipped, take a new straight pose",
    ),
];

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match (self, self.known()) {
            (Self::Other(reason), _) => reason,
            (_, Some((_, word, _, _))) => word,
            (_, None) => "",
        })
    }
}

impl Status {
    /// All that this version knows.
    pub const ALL: [Self; 16] = [
        Self::Ok,
        Self::NoSnake,
        Self::Occluded,
        Self::Ambiguous,
        Self::UnknownShape,
        Self::Blurred,
        Self::Saturated,
        Self::OutOfFrame,
        Self::CameraMoved,
        Self::BaseMoved,
        Self::GridLost,
        Self::ViewsDisagree,
        Self::Unreadable,
        Self::WrongSize,
        Self::TrackerLost,
        Self::TrackerJump,
    ];

    /// What it means, and what to do about it, in words.
    pub fn explained(&self) -> (&'static str, &'static str) {
        match self.known() {
            Some((_, _, meaning, remedy)) => (meaning, remedy),
            None => ("a reason that this version does not know", "see the program that wrote the file"),
        }
    }

    fn known(&self) -> Option<&'static (Self, &'static str, &'static str, &'static str)> {
        KNOWN.iter().find(|(status, ..)| status == self)
    }
}

/// What the commonest of some reasons means, and what to do about it, where it is a status without angles.
pub fn commonest_status(counts: &BTreeMap<String, usize>) -> Option<String> {
    let without_angles = counts.iter().filter(|(word, _)| *word != "ok");
    let (word, _) = without_angles.max_by_key(|(_, count)| **count)?;
    let status: Status = word.parse().unwrap_or_else(|never| match never {});
    let (meaning, remedy) = status.explained();
    (!matches!(status, Status::Other(_))).then(|| format!("{word}: {meaning}; {remedy}"))
}

impl FromStr for Status {
    type Err = Infallible;

    fn from_str(word: &str) -> Result<Self, Infallible> {
        let known = KNOWN.iter().find(|(_, known, _, _)| *known == word);
        Ok(known.map_or_else(|| Self::Other(word.to_owned()), |(status, ..)| status.clone()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_status_survives_its_own_word() {
        for status in Status::ALL.into_iter().chain([Status::Other("moonlight".into())]) {
            assert!(!status.to_string().is_empty() && !status.explained().0.is_empty());
            assert_eq!(status.to_string().parse(), Ok(status));
        }
    }
}
