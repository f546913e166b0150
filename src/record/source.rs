//! Where the parts of an experiment come from: files, or topics of a ROS 2 recording.

use crate::bag::{Bag, Topic};
use crate::camera::CameraNumbers;
use serde::Deserialize;
use std::fmt;
use std::path::{Path, PathBuf};

/// Files, or a topic of a ROS 2 recording.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(
    untagged,
    expecting = "expected a file, or a table such as { bag = \"run.mcap\", topic = \"/camera/image_raw\" }"
)]
pub enum Source<F> {
    /// Files.
    Files(F),
    /// A topic.
    Topic(Topic),
}

/// Where encoder readings come from.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(
    untagged,
    expecting = "expected a file, or a table such as { bag = \"run.mcap\", topic = \"/joint_states\", joints = [\"b1\", \"b2\", \"b3\"], mm_per_unit = 1000.0 }"
)]
pub enum EncoderLog {
    /// An encoders.csv.
    File(PathBuf),
    /// A topic of `JointState`.
    Joints(JointTopic),
}

/// A topic of `JointState`, read at the times of frames or poses.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointTopic {
    bag: Bag,
    topic: String,
    /// The joint of each backbone.
    pub joints: Vec<String>,
    /// What one unit of a joint's position is, mm.
    pub mm_per_unit: f64,
}

/// Where a view's lens comes from.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(
    untagged,
    expecting = "expected a camera file, a table such as { bag = \"run.mcap\", topic = \"/camera/camera_info\" }, or numbers: { K = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dist = [k1, k2, p1, p2, k3], size = [width, height] }"
)]
pub enum CameraSource {
    /// A camera file.
    File(PathBuf),
    /// A topic of `CameraInfo`.
    Topic(Topic),
    /// The numbers themselves.
    Numbers(CameraNumbers),
    /// Nothing is named: only a camera that tells its lens itself can be used, as those of ROS 2 do.
    #[serde(skip)]
    Untold,
}

impl CameraSource {
    /// The file that is read, where there is one.
    pub fn path(&self) -> Option<&Path> {
        match self {
            Self::File(path) => Some(path),
            Self::Topic(topic) => Some(topic.bag.path()),
            Self::Numbers(_) | Self::Untold => None,
        }
    }

    pub(super) fn within(self, folder: &Path) -> Self {
        match self {
            Self::File(path) => Self::File(folder.join(path)),
            Self::Topic(topic) => Self::Topic(topic.within(folder)),
            Self::Numbers(_) | Self::Untold => self,
        }
    }
}

impl fmt::Display for CameraSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => path.display().fmt(f),
            Self::Topic(topic) => topic.fmt(f),
            Self::Numbers(_) => f.write_str("the numbers in experiment.toml"),
            Self::Untold => f.write_str("no camera file"),
        }
    }
}

impl JointTopic {
    /// The topic.
    pub fn topic(&self) -> Topic {
        Topic { bag: self.bag.clone(), topic: self.topic.clone() }
    }
}

impl<F> Source<F> {
    /// The topic, where it is one.
    pub fn topic(&self) -> Option<&Topic> {
        match self {
            Self::Files(_) => None,
            Self::Topic(topic) => Some(topic),
        }
    }
}

impl Source<PathBuf> {
    /// The file that is read.
    pub fn path(&self) -> &Path {
        match self {
            Self::Files(path) => path,
            Self::Topic(topic) => topic.bag.path(),
        }
    }

    pub(super) fn within(self, folder: &Path) -> Self {
        match self {
            Self::Files(path) => Self::Files(folder.join(path)),
            Self::Topic(topic) => Self::Topic(topic.within(folder)),
        }
    }
}

impl fmt::Display for Source<PathBuf> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Files(path) => path.display().fmt(f),
            Self::Topic(topic) => topic.fmt(f),
        }
    }
}

impl fmt::Display for Source<String> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Files(pattern) => pattern.fmt(f),
            Self::Topic(topic) => topic.fmt(f),
        }
    }
}

impl EncoderLog {
    /// The file that is read.
    pub fn path(&self) -> &Path {
        match self {
            Self::File(path) => path,
            Self::Joints(joints) => joints.bag.path(),
        }
    }

    pub(super) fn within(self, folder: &Path) -> Self {
        match self {
            Self::File(path) => Self::File(folder.join(path)),
            Self::Joints(joints) => Self::Joints(JointTopic { bag: joints.bag.clone().within(folder), ..joints }),
        }
    }
}
