//! Where frames come from: picture files told by a glob or a numbered pattern, the pages of a TIFF stack, a video file, or a recording. What a
//! file is its content says, not its name.

use super::frame::Frame;
use super::lens::Lens;
use super::message::Picture;
use super::opencv::Video;
use super::picture::{picture_size, read_frame, rotation_mark};
use super::{stack, stamps, video_mark};
use crate::bag::{Message, Topic};
use crate::content;
use crate::error::{Error, Result};
use image::metadata::Orientation;
use std::fs::File;
use std::io::Read;
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

/// A picture file among frames.
#[derive(Debug, Clone, PartialEq)]
pub struct PictureFile {
    /// The number in its name; of names that are times the position in their order, from 0.
    pub index: u64,
    /// The time in its name, s, where all names have one.
    pub time_s: Option<f64>,
    /// The file.
    pub path: PathBuf,
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

/// The first bytes of a file; `None` where it cannot be read.
fn head_of(path: &Path) -> Option<Vec<u8>> {
    let mut head = Vec::new();
    // A pipe is not waited at.
    let file = if path.is_file() { File::open(path).ok() } else { None };
    file?.take(content::HEAD_BYTES as u64).read_to_end(&mut head).ok()?;
    Some(head)
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

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Whether a file is one that Windows keeps in folders of pictures, and hides there.
fn is_left_by_windows(path: &Path) -> bool {
    ["thumbs.db", "desktop.ini"].iter().any(|name| file_name(path).eq_ignore_ascii_case(name))
}

/// All that matches a glob below the folder, hidden files excepted. A link to nowhere, a pipe or a folder in a frame's place costs its row, and
/// is not passed over.
fn globbed(folder: &Path, pattern: &str) -> Result<Vec<PathBuf>> {
    let full = if Path::new(pattern).is_absolute() {
        pattern.to_owned()
    } else {
        let not_text = || {
            Error::content(
                folder,
                format!(
                    "the folder's name is not UTF-8, so that no pattern can be matched in it: rename it, or write frames/%05d.png for `{pattern}`"
                ),
            )
        };
        format!("{}/{pattern}", glob::Pattern::escape(folder.to_str().ok_or_else(not_text)?))
    };
    let wrong = |e: glob::PatternError| Error::content(folder, format!("frames = \"{pattern}\": {}", e.msg));
    let options = glob::MatchOptions { require_literal_leading_dot: true, ..glob::MatchOptions::new() };
    let mut paths = Vec::new();
    for entry in glob::glob_with(&full, options).map_err(wrong)? {
        let path = entry.map_err(|e| {
            let path = e.path().to_owned();
            Error::io(&path, "read")(e.into())
        })?;
        if is_left_by_windows(&path) {
            continue;
        }
        if path.is_file() || (path.extension().is_some() && last_number(&path).is_ok()) {
            paths.push(path);
        }
    }
    Ok(paths)
}

/// The files with their indices: the last numbers in their names, unless the names are times and these alone order them.
fn with_indices(paths: Vec<PathBuf>) -> Result<Vec<PictureFile>> {
    let names: Vec<&Path> = paths.iter().map(PathBuf::as_path).collect();
    let (stamps_s, is_decimal) = stamps::stamps_of(&names).unzip();
    let numbers: Result<Vec<u64>> = paths.iter().map(|path| last_number(path)).collect();
    let Some(stamps_s) = stamps_s else {
        let file = |(index, path)| PictureFile { index, time_s: None, path };
        return Ok(numbers?.into_iter().zip(paths).map(file).collect());
    };
    let mut order: Vec<usize> = (0..paths.len()).collect();
    order.sort_by(|&a, &b| stamps_s[a].total_cmp(&stamps_s[b]));
    let is_in_order = |values: &dyn Fn(usize, usize) -> bool| order.windows(2).all(|pair| values(pair[0], pair[1]));
    let are_times = is_in_order(&|a, b| stamps_s[a] < stamps_s[b]);
    let numbers =
        numbers.ok().filter(|numbers| is_decimal != Some(true) && is_in_order(&|a, b| numbers[a] < numbers[b]));
    let file = |(rank, k): (usize, &usize)| PictureFile {
        index: numbers.as_ref().map_or(rank as u64, |numbers| numbers[*k]),
        time_s: are_times.then_some(stamps_s[*k]),
        path: paths[*k].clone(),
    };
    Ok(order.iter().enumerate().map(file).collect())
}

/// The last run of digits in a file's name without its extension.
pub(crate) fn number_in_name(path: &Path) -> Option<u64> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let digits = stem.split(|c: char| !c.is_ascii_digit()).rfind(|run| !run.is_empty());
    digits.and_then(|digits| digits.parse().ok())
}

/// That number, or what is wrong with the name.
fn last_number(path: &Path) -> Result<u64> {
    number_in_name(path).ok_or_else(|| {
        const EXPECTED: &str = "no number in the file's name, expected one like 00012.png to tell the frame's index";
        let other = head_of(path).and_then(|head| content::name_of(&head)).filter(|_| read_frame(path).is_err());
        let message = other.map_or(EXPECTED.to_owned(), |found| {
            format!("{found}, expected pictures numbered in their names, a video or a TIFF stack")
        });
        Error::content(path, message)
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
    fn files(&self, folder: &Path) -> Result<Vec<PictureFile>> {
        let (subfolder, before) = self.before.rsplit_once('/').unwrap_or(("", self.before));
        let parent = match folder.join(subfolder) {
            here if here == Path::new("") => PathBuf::from("."),
            there => there,
        };
        let mut files = Vec::new();
        for entry in std::fs::read_dir(&parent).map_err(Error::io(&parent, "read"))? {
            let path = entry.map_err(Error::io(&parent, "read"))?.path();
            let name = file_name(&path);
            let Some(digits) = name.strip_prefix(before).and_then(|rest| rest.strip_suffix(self.after)) else {
                continue;
            };
            if let Some(index) = self.number(digits) {
                files.push(PictureFile { index, time_s: None, path });
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
