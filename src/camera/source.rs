//! Where frames come from: picture files told by a glob or a numbered pattern, the pages of a TIFF stack, a video file, or a recording. What a
//! file is its content says, not its name.

use super::frame::Frame;
use super::lens::Lens;
use super::message::Picture;
use super::opencv::Video;
use super::picture::{picture_size, read_frame, rotation_mark};
use super::picture_files::{PictureFile, file_name, globbed, head_of, numbered, with_indices};
use super::{stack, video_mark};
use crate::bag::{Message, Topic};
use crate::content;
use crate::error::{Error, Result};
use image::metadata::Orientation;
use std::path::{Path, PathBuf};

/// File name extensions, in lower case, of videos that are a row of JPEGs and begin as one picture does.
const MOTION_JPEG: [&str; 2] = ["mjpeg", "mjpg"];

/// File name extensions, in lower case, of videos: of a file that is not there they tell what was meant.
const VIDEO_EXTENSIONS: [&str; 11] = ["avi", "m4v", "mjpeg", "mjpg", "mkv", "mov", "mp4", "mpeg", "mpg", "webm", "wmv"];

/// The frames of one view, in order of their index.
#[derive(Debug, Clone, PartialEq)]
pub enum FrameSource {
    /// Picture files; never empty.
    Pictures(Vec<PictureFile>),
    /// A TIFF file of several pages, and where they are; a frame's index is its position, from 0.
    Stack(PathBuf, Vec<u64>),
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
    /// A page of a stack, not read yet.
    Page(u64),
    /// A video's frame, and how the video asks to turn it; videos decode in order.
    Decoded(Frame, Orientation),
    /// A recording's message, not decoded yet.
    Message(Box<Message>),
    /// What a recording had here cannot be read, for this reason.
    Broken(String),
}

impl SourceFrame {
    /// Width and height, px, as far as they can be told without decoding.
    pub fn size(&self) -> Option<(u32, u32)> {
        match &self.content {
            Content::File => picture_size(&self.path),
            Content::Decoded(frame, _) => Some((frame.width, frame.height)),
            Content::Page(_) | Content::Message(_) | Content::Broken(_) => None,
        }
    }

    /// The picture as a camera file knows it: as it is stored, or turned by a quarter as its mark asks if only that gives it the camera's
    /// width and height; see [`read_frame`] for the errors.
    pub fn read_for(self, lens: &Lens) -> Result<Frame> {
        let (path, of_video) = (
            self.path.clone(),
            match &self.content {
                Content::Decoded(_, mark) => Some(*mark),
                _ => None,
            },
        );
        Ok(self.read()?.turned_for(lens, || of_video.unwrap_or_else(|| rotation_mark(&path))))
    }

    /// The picture as it is stored, read and decoded now if it is a file; see [`read_frame`] for the errors.
    pub fn read(self) -> Result<Frame> {
        match self.content {
            Content::File => read_frame(&self.path),
            Content::Page(page) => stack::read_page(&self.path, page),
            Content::Decoded(frame, _) => Ok(frame),
            Content::Message(message) => Ok(message.decoded::<Picture>()?.frame),
            Content::Broken(why) => Err(Error::content(&self.path, why)),
        }
    }
}

impl FrameSource {
    /// Finds the frames that a view names, relative to the experiment's folder: `frames/*.png` (a glob),
    /// `frames/%05d.png` (a numbered pattern), `run.mp4` (a video) or `run.tif` (a stack), told by their content. Hidden files, such as those
    /// that macOS keeps beside others, match no glob.
    ///
    /// A frame's index is the number that stands for `%d`, with a glob the last number in the file's name, in a video or stack its
    /// position. Of names that are times it is the position in their order.
    ///
    /// # Errors
    /// A pattern that is none of these or matches no file, a file name without a number, two files with the same
    /// number, several videos, a folder that cannot be read; a video that cannot be read, or any video without the `opencv` feature.
    pub fn open(folder: &Path, pattern: &str) -> Result<Self> {
        if let Some(numbered) = numbered(pattern) {
            return Self::of_files(folder, pattern, numbered.files(folder)?);
        }
        let paths = match folder.join(pattern) {
            // A name that is there is meant, whatever it holds that a glob would take for its own.
            literal if literal.is_file() => vec![literal],
            literal if has_extension(&literal, &VIDEO_EXTENSIONS) && !pattern.contains(['*', '?', '[']) => {
                return Self::of_video(literal);
            }
            _ => globbed(folder, pattern)?,
        };
        if let Some(video) = paths.iter().find(|path| is_video(path)) {
            if let [only] = &paths[..] {
                return Self::of_video(only.clone());
            }
            let message = format!(
                "a video among {} files that match `{pattern}`; name one video a view, or its pictures",
                paths.len()
            );
            return Err(Error::content(video, message));
        }
        if let [only] = &paths[..]
            && let Some(pages) = stack::pages_of(only).ok().flatten()
        {
            return Ok(Self::Stack(only.clone(), pages));
        }
        // A file with a video's ending and unknown content is opened as a video, so that the error says why it cannot be.
        match &paths[..] {
            [only] if has_extension(only, &VIDEO_EXTENSIONS) && is_unknown(only) => Self::of_video(only.clone()),
            _ => Self::of_files(folder, pattern, with_indices(paths)?),
        }
    }

    fn of_video(path: PathBuf) -> Result<Self> {
        match Video::open(&path)?.next() {
            Some(_) => Ok(Self::Video(path)),
            None => Err(Error::content(&path, "the video has no frame that can be decoded")),
        }
    }

    fn of_files(folder: &Path, pattern: &str, mut files: Vec<PictureFile>) -> Result<Self> {
        if files.is_empty() {
            return Err(Error::content(folder, format!("no frames: no file here matches `{pattern}`")));
        }
        files.sort_by(|a, b| (a.index, &a.path).cmp(&(b.index, &b.path)));
        if let Some([a, b]) = files.array_windows().find(|[a, b]| a.index == b.index) {
            let message =
                format!("frame {} is there twice: {} and {}", a.index, file_name(&a.path), file_name(&b.path));
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
            Self::Stack(_, pages) => Ok(Some(pages.len())),
            Self::Video(path) => Ok(Video::open(path)?.frame_count()),
            Self::Topic(topic) => Ok(Some(topic.count()?)),
        }
    }

    /// What a person should know of how the frames are taken, in a sentence: a mark that asks to turn them.
    ///
    /// # Errors
    /// A video that cannot be opened any more.
    pub fn remark(&self, lens: &Lens) -> Result<Option<String>> {
        let mark = match self {
            Self::Pictures(files) => files.first().map_or(Orientation::NoTransforms, |file| rotation_mark(&file.path)),
            Self::Video(path) => video_mark::of(path),
            Self::Stack(..) | Self::Topic(_) => Orientation::NoTransforms,
        };
        if mark == Orientation::NoTransforms {
            return Ok(None);
        }
        let first = self.frames()?.next().and_then(|frame| frame.size());
        let is_turned = first == Some((lens.height, lens.width)) && lens.width != lens.height;
        let text = if is_turned {
            "the frames carry a mark that asks to turn them; they are turned so, since only that gives them the size of the camera file"
        } else {
            "the frames carry a mark that asks to turn them; they are taken as they are stored, as the camera file and the straight picture \
             must be"
        };
        Ok(Some(text.to_owned()))
    }

    /// The frames in order of their index. Picture files can be read in parallel; a video is decoded by the iterator.
    ///
    /// # Errors
    /// A video that cannot be opened any more.
    pub fn frames(&self) -> Result<Box<dyn Iterator<Item = SourceFrame> + Send + '_>> {
        Ok(match self {
            Self::Pictures(files) => Box::new(files.iter().map(|PictureFile { index, time_s, path }| SourceFrame {
                index: *index,
                time_s: *time_s,
                path: path.clone(),
                content: Content::File,
            })),
            Self::Stack(path, pages) => Box::new((0..).zip(pages).map(|(index, &page)| SourceFrame {
                index,
                time_s: None,
                path: path.clone(),
                content: Content::Page(page),
            })),
            Self::Video(path) => {
                let mark = video_mark::of(path);
                Box::new((0..).zip(Video::open(path)?).map(move |(index, (time_s, frame))| SourceFrame {
                    index,
                    time_s,
                    path: path.clone(),
                    content: Content::Decoded(frame, mark),
                }))
            }
            Self::Topic(topic) => Box::new((0..).zip(topic.messages()?).map(|(index, message)| {
                let path = topic.bag.path().to_owned();
                match message {
                    Ok(message) => {
                        let time_s = message.stamp_s();
                        SourceFrame { index, time_s, path, content: Content::Message(Box::new(message)) }
                    }
                    // The frame that stands for what is lost says so.
                    Err(why) => {
                        SourceFrame { index, time_s: None, path, content: Content::Broken(topic.in_words(&why)) }
                    }
                }
            })),
        })
    }
}

/// Whether a file is a video by its content.
fn is_video(path: &Path) -> bool {
    head_of(path).is_some_and(|head| content::is_video(&head) || has_extension(path, &MOTION_JPEG))
}

/// Whether nothing that is known has a file's content.
fn is_unknown(path: &Path) -> bool {
    head_of(path).is_some_and(|head| content::name_of(&head).is_none())
}

fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    extensions.contains(&extension.as_str())
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

    #[test]
    fn hidden_files_match_no_glob_and_names_that_are_times_are_ordered_by_them() {
        let (_root, folder) = folder(&["._1.png", ".2.png", "3.png"]);
        assert_eq!(indices(&folder, "frames/*.png"), [(3, "3.png".to_owned())]);
        let (_root, folder) = super::tests::folder(&["f_1738133058.45788000.png", "f_1738133057.945788000.png"]);
        let found = indices(&folder, "frames/*.png");
        assert_eq!(
            found.iter().map(|f| (f.0, &f.1[..12])).collect::<Vec<_>>(),
            [(0, "f_1738133057"), (1, "f_1738133058")]
        );
        let source = FrameSource::open(&folder, "frames/*.png").unwrap();
        let times: Vec<f64> = source.frames().unwrap().filter_map(|frame| frame.time_s).collect();
        assert!((times[1] - times[0] - 0.1).abs() < 1e-6, "{times:?}");
        // A counter behind the time is the index, as ever.
        let (_root, folder) = super::tests::folder(&["20261126_023528_001.png", "20261126_023528_002.png"]);
        assert_eq!(indices(&folder, "frames/*.png").iter().map(|f| f.0).collect::<Vec<_>>(), [1, 2]);
    }

    #[test]
    fn several_videos_are_refused_by_name() {
        let (_root, folder) = folder(&["1.ts", "2.ts"]);
        let packets: Vec<u8> = (0..600).map(|at| if at % 188 == 0 { 0x47 } else { 0 }).collect();
        for name in ["1.ts", "2.ts"] {
            std::fs::write(folder.join("frames").join(name), &packets).unwrap();
        }
        let said = FrameSource::open(&folder, "frames/*.ts").unwrap_err().to_string();
        assert!(said.contains("a video among 2 files that match `frames/*.ts`"), "{said}");
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
}
