//! Where frames come from: picture files told by a glob or a numbered pattern, or a video file.

use super::frame::{Frame, picture_size, read_frame};
use super::message::Picture;
use super::opencv::Video;
use crate::bag::{Message, Topic};
use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

/// File name extensions, in lower case, that make a source a video.
const VIDEO_EXTENSIONS: [&str; 11] = ["avi", "m4v", "mjpeg", "mjpg", "mkv", "mov", "mp4", "mpeg", "mpg", "webm", "wmv"];

/// The frames of one view, in order of their index.
#[derive(Debug, Clone, PartialEq)]
pub enum FrameSource {
    /// Picture files with their indices; never empty.
    Pictures(Vec<(u64, PathBuf)>),
    /// A video file that has at least one frame; a frame's index is its position, from 0.
    Video(PathBuf),
    /// A topic of pictures in a ROS 2 recording, at least one; a frame's index is its position, from 0.
    Topic(Topic),
}

/// One frame of a source, not decoded yet where that can wait.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceFrame {
    /// The number in the file's name, or the position in the video.
    pub index: u64,
    /// When the frame was taken: s from the video's start, or what the clock of a recording showed; picture files do not say.
    pub time_s: Option<f64>,
    /// The picture file, the video or the recording.
    pub path: PathBuf,
    content: Content,
}

/// How far a frame is read already.
#[derive(Debug, Clone, PartialEq)]
enum Content {
    /// A picture file that is not read yet.
    File,
    /// A video's frame; videos decode in order.
    Decoded(Frame),
    /// A recording's message, not decoded yet.
    Message(Box<Message>),
}

impl SourceFrame {
    /// Width and height, px, as far as they can be told without decoding.
    pub fn size(&self) -> Option<(u32, u32)> {
        match &self.content {
            Content::File => picture_size(&self.path),
            Content::Decoded(frame) => Some((frame.width, frame.height)),
            Content::Message(_) => None,
        }
    }

    /// The picture, read and decoded now if it is a file; see [`read_frame`] for the errors.
    pub fn read(self) -> Result<Frame> {
        match self.content {
            Content::File => read_frame(&self.path),
            Content::Decoded(frame) => Ok(frame),
            Content::Message(message) => Ok(message.decoded::<Picture>()?.frame),
        }
    }
}

impl FrameSource {
    /// Finds the frames that a view names, relative to the experiment's folder: `frames/*.png` (a glob),
    /// `frames/%05d.png` (a numbered pattern) or `run.mp4` (a video, told by its extension).
    ///
    /// A frame's index is the number that stands for `%d`, with a glob the last number in the file's name, in a video its
    /// position.
    ///
    /// # Errors
    /// A pattern that is none of these or matches no file, a file name without a number, two files with the same
    /// number, a folder that cannot be read; a video that cannot be read, or any video without the `opencv` feature.
    pub fn open(folder: &Path, pattern: &str) -> Result<Self> {
        let numbered = numbered(pattern);
        if numbered.is_none() && is_video(pattern) {
            let path = folder.join(pattern);
            return match Video::open(&path)?.next() {
                Some(_) => Ok(Self::Video(path)),
                None => Err(Error::content(&path, "the video has no frame that can be decoded")),
            };
        }
        let mut files = match numbered {
            Some(numbered) => numbered.files(folder)?,
            None => globbed(folder, pattern)?,
        };
        if files.is_empty() {
            return Err(Error::content(folder, format!("no frames: no file here matches `{pattern}`")));
        }
        files.sort();
        if let Some([(index, a), (_, b)]) = files.array_windows().find(|[a, b]| a.0 == b.0) {
            let message = format!("frame {index} is there twice: {} and {}", file_name(a), file_name(b));
            return Err(Error::content(folder, message));
        }
        Ok(Self::Pictures(files))
    }

    /// A topic of pictures in a ROS 2 recording: `sensor_msgs/CompressedImage` or `Image`.
    ///
    /// # Errors
    /// A recording that cannot be read, has no such topic, or something else in it.
    pub fn of_topic(topic: Topic) -> Result<Self> {
        topic.first::<Picture>()?;
        Ok(Self::Topic(topic))
    }

    /// How many frames there are; `None` where only reading the video to its end would tell.
    pub fn count(&self) -> Result<Option<usize>> {
        match self {
            Self::Pictures(files) => Ok(Some(files.len())),
            Self::Video(path) => Ok(Video::open(path)?.frame_count()),
            Self::Topic(topic) => Ok(Some(topic.count()?)),
        }
    }

    /// The frames in order of their index. Picture files can be read in parallel; a video is decoded by the iterator.
    ///
    /// # Errors
    /// A video that cannot be opened any more.
    pub fn frames(&self) -> Result<Box<dyn Iterator<Item = SourceFrame> + Send + '_>> {
        Ok(match self {
            Self::Pictures(files) => Box::new(files.iter().map(|(index, path)| SourceFrame {
                index: *index,
                time_s: None,
                path: path.clone(),
                content: Content::File,
            })),
            Self::Video(path) => Box::new((0..).zip(Video::open(path)?).map(|(index, (time_s, frame))| SourceFrame {
                index,
                time_s,
                path: path.clone(),
                content: Content::Decoded(frame),
            })),
            Self::Topic(topic) => {
                Box::new((0..).zip(topic.messages()?.map_while(Result::ok)).map(|(index, message)| {
                    let (time_s, path) = (message.stamp_s(), topic.bag.clone());
                    SourceFrame { index, time_s, path, content: Content::Message(Box::new(message)) }
                }))
            }
        })
    }
}

fn is_video(pattern: &str) -> bool {
    let extension = Path::new(pattern).extension().unwrap_or_default().to_string_lossy().to_lowercase();
    VIDEO_EXTENSIONS.contains(&extension.as_str())
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// All files that match a glob below the folder, each with the last number in its name.
fn globbed(folder: &Path, pattern: &str) -> Result<Vec<(u64, PathBuf)>> {
    let full = if Path::new(pattern).is_absolute() {
        pattern.to_owned()
    } else {
        format!("{}/{pattern}", glob::Pattern::escape(&folder.to_string_lossy()))
    };
    let wrong = |e: glob::PatternError| Error::content(folder, format!("frames = \"{pattern}\": {}", e.msg));
    let mut files = Vec::new();
    for entry in glob::glob(&full).map_err(wrong)? {
        let path = entry.map_err(|e| {
            let path = e.path().to_owned();
            Error::io(&path, "read")(e.into())
        })?;
        if path.is_file() {
            files.push((last_number(&path)?, path));
        } else if let (Some(_), Ok(index)) = (path.extension(), last_number(&path)) {
            // A link to nowhere, a pipe or a folder in a frame's place costs its row, and is not passed over.
            files.push((index, path));
        }
    }
    Ok(files)
}

/// The last run of digits in a file's name without its extension.
fn last_number(path: &Path) -> Result<u64> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let digits = stem.split(|c: char| !c.is_ascii_digit()).rfind(|run| !run.is_empty());
    digits.and_then(|digits| digits.parse().ok()).ok_or_else(|| {
        Error::content(path, "no number in the file's name, expected one like 00012.png to tell the frame's index")
    })
}

/// `before%05dafter`, the pattern that C's printf would fill in.
struct Numbered<'a> {
    before: &'a str,
    width: usize,
    after: &'a str,
}

/// Takes a numbered pattern apart; `None` if it is not one.
fn numbered(pattern: &str) -> Option<Numbered<'_>> {
    let (before, rest) = pattern.split_once('%')?;
    let (width, after) = rest.split_once('d')?;
    let padded = width.strip_prefix('0').unwrap_or_default();
    let width = if width.is_empty() { 1 } else { padded.parse().ok()? };
    (!after.contains(['/', '%'])).then_some(Numbered { before, width, after })
}

impl Numbered<'_> {
    fn files(&self, folder: &Path) -> Result<Vec<(u64, PathBuf)>> {
        let (subfolder, before) = self.before.rsplit_once('/').unwrap_or(("", self.before));
        let parent = folder.join(subfolder);
        let mut files = Vec::new();
        for entry in std::fs::read_dir(&parent).map_err(Error::io(&parent, "read"))? {
            let path = entry.map_err(Error::io(&parent, "read"))?.path();
            let name = file_name(&path);
            let Some(digits) = name.strip_prefix(before).and_then(|rest| rest.strip_suffix(self.after)) else {
                continue;
            };
            if let Some(index) = self.number(digits) {
                files.push((index, path));
            }
        }
        Ok(files)
    }

    /// The number that printf would have written as these digits.
    fn number(&self, digits: &str) -> Option<u64> {
        let exact = digits.len() == self.width || (digits.len() > self.width && !digits.starts_with('0'));
        (exact && digits.bytes().all(|b| b.is_ascii_digit())).then(|| digits.parse().ok()).flatten()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder whose name holds glob's special characters, with empty files of these names in `frames/`.
    fn folder(names: &[&str]) -> (tempfile::TempDir, PathBuf) {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("run [3]*");
        std::fs::create_dir_all(folder.join("frames")).unwrap();
        for name in names {
            std::fs::write(folder.join("frames").join(name), "").unwrap();
        }
        (root, folder)
    }

    fn indices(folder: &Path, pattern: &str) -> Vec<(u64, String)> {
        let source = FrameSource::open(folder, pattern).unwrap();
        assert_eq!(source.count().unwrap(), Some(source.frames().unwrap().count()));
        source.frames().unwrap().map(|f| (f.index, file_name(&f.path))).collect()
    }

    #[test]
    fn a_glob_sorts_by_number_not_by_name() {
        let (_root, folder) = folder(&["cam2_10.png", "cam2_9.png", "cam2_007.png", "cam2_8.jpg"]);
        let expected = [(7, "cam2_007.png"), (9, "cam2_9.png"), (10, "cam2_10.png")];
        assert_eq!(indices(&folder, "frames/*.png"), expected.map(|(i, n)| (i, n.to_owned())));
    }

    #[test]
    fn a_numbered_pattern_takes_what_printf_writes() {
        let names = ["f00003_2.png", "f00001_2.png", "f0004_2.png", "f123456_2.png", "f000005_2.png", "fx_2.png"];
        let (_root, folder) = folder(&names);
        let found = indices(&folder, "frames/f%05d_2.png");
        assert_eq!(found.iter().map(|f| f.0).collect::<Vec<_>>(), [1, 3, 123_456]);
        assert_eq!(indices(&folder, "frames/f%d_2.png").iter().map(|f| f.0).collect::<Vec<_>>(), [123_456]);
    }

    #[cfg(unix)]
    #[test]
    fn what_stands_in_a_frames_place_and_is_none_keeps_its_index_and_is_not_waited_for() {
        let (_root, folder) = folder(&["1.png"]);
        let frames = folder.join("frames");
        std::os::unix::fs::symlink("nowhere", frames.join("2.png")).unwrap();
        std::fs::create_dir(frames.join("3.png")).unwrap();
        std::fs::create_dir(frames.join("thumbnails4")).unwrap();
        let pipe = std::process::Command::new("mkfifo").arg(frames.join("5.png")).status().unwrap();
        assert!(pipe.success());
        for pattern in ["frames/*", "frames/%d.png"] {
            let source = FrameSource::open(&folder, pattern).unwrap();
            let read: Vec<_> =
                source.frames().unwrap().map(|frame| (frame.index, frame.size(), frame.read().is_ok())).collect();
            assert_eq!(read, [1, 2, 3, 5].map(|index| (index, None, false)), "{pattern}");
        }
    }

    #[test]
    fn complaints_name_what_was_looked_for() {
        let (_root, folder) = folder(&["1.png", "01.png", "side.jpg", "99999999999999999999999.tif"]);
        let cases = [
            ("frames/*.bmp", "no file here matches `frames/*.bmp`"),
            ("frames/%04d.png", "no file here matches `frames/%04d.png`"),
            ("frames/*.png", "frame 1 is there twice: "),
            ("frames/*.jpg", "side.jpg: no number in the file's name"),
            ("frames/*.tif", "no number in the file's name"),
            ("frames/[.png", "frames = \"frames/[.png\""),
            ("elsewhere/%d.png", "elsewhere: cannot read"),
        ];
        for (pattern, expected) in cases {
            let message = FrameSource::open(&folder, pattern).unwrap_err().to_string();
            assert!(message.contains(expected), "{pattern}: expected {expected:?}, got {message:?}");
        }
    }

    #[cfg(not(feature = "opencv"))]
    #[test]
    fn a_build_without_opencv_says_so() {
        let (_root, folder) = folder(&["run.MP4"]);
        let error = FrameSource::open(&folder, "frames/run.MP4").unwrap_err();
        assert!(matches!(error, Error::NoOpenCv { .. }), "{error}");
    }
}
