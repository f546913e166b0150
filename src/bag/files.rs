//! The files of a recording: one, or those that a split one has.

use crate::content;
use crate::error::{Error, Result};
use crate::input::read_text;
use saphyr::{LoadableYamlNode, Yaml};
use serde::Deserialize;
use std::fmt;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// A recording as experiment.toml names it: an MCAP file, the folder that `ros2 bag record` makes, or a list of files that follow each other.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(from = "Named")]
pub struct Bag {
    /// In their order; never empty.
    named: Vec<PathBuf>,
}

/// A recording as it is written.
#[derive(Deserialize)]
#[serde(untagged, expecting = "expected an MCAP file, a recording's folder, or a list of MCAP files")]
enum Named {
    One(PathBuf),
    Parts(Vec<PathBuf>),
}

impl From<Named> for Bag {
    fn from(named: Named) -> Self {
        match named {
            Named::One(path) => Self::from(path),
            Named::Parts(named) if named.is_empty() => Self::from(PathBuf::new()),
            Named::Parts(named) => Self { named },
        }
    }
}

impl From<PathBuf> for Bag {
    fn from(path: PathBuf) -> Self {
        Self { named: vec![path] }
    }
}

/// How an MCAP file begins and ends.
///
/// Source: <https://mcap.dev/spec>, "Magic bytes".
pub(super) const MAGIC: &[u8] = b"\x89MCAP0\r\n";

impl Bag {
    /// What is named, the first of several.
    pub fn path(&self) -> &Path {
        self.named.first().map_or(Path::new(""), PathBuf::as_path)
    }

    /// All that is named.
    pub fn paths(&self) -> &[PathBuf] {
        &self.named
    }

    /// The recording with its paths relative to a folder.
    pub fn within(self, folder: &Path) -> Self {
        Self { named: self.named.into_iter().map(|path| folder.join(path)).collect() }
    }

    /// The MCAP files in their order.
    ///
    /// # Errors
    /// What is not there, a folder without a recording, a file of another kind: with what to do.
    pub fn files(&self) -> Result<Vec<PathBuf>> {
        let mut files = Vec::new();
        for path in &self.named {
            match path.is_dir() {
                true => files.extend(files_of_folder(path)?),
                false => files.push(path.clone()),
            }
        }
        files.iter().try_for_each(|file| require_mcap(file))?;
        Ok(files)
    }

    /// What is missing of files that were never finished, in words.
    ///
    /// # Errors
    /// As [`files`](Self::files).
    pub fn unfinished(&self) -> Result<Vec<String>> {
        let cut = |file: &PathBuf| {
            (!ends_whole(file)).then(|| {
                format!(
                    "{}: the recording breaks off (its recorder was killed, or the copy is not whole); it is read as far as it goes",
                    file.display()
                )
            })
        };
        Ok(self.files()?.iter().filter_map(cut).collect())
    }
}

/// The files of a folder that `ros2 bag record` made: as its metadata.yaml lists them, else all by the numbers in their names.
fn files_of_folder(folder: &Path) -> Result<Vec<PathBuf>> {
    let metadata = folder.join("metadata.yaml");
    if metadata.is_file() {
        let text = read_text(&metadata)?;
        let files = listed(&text).ok_or_else(|| {
            Error::content(
                &metadata,
                "no relative_file_paths, expected rosbag2's metadata.yaml; list the files: bag = [\"run_0.mcap\", …]",
            )
        })?;
        return Ok(files.into_iter().map(|file| folder.join(file)).collect());
    }
    let entries = std::fs::read_dir(folder).map_err(Error::io(folder, "read"))?;
    let mut files: Vec<PathBuf> =
        entries.filter_map(|entry| Some(entry.ok()?.path())).filter(|path| is_mcap(path)).collect();
    if files.is_empty() {
        return Err(Error::content(
            folder,
            "a folder without metadata.yaml and *.mcap, expected a recording; name its files",
        ));
    }
    // Parts of one recording are numbered: run_2 comes before run_10.
    files.sort_by_cached_key(|file| numbers_of(&file.file_stem().unwrap_or_default().to_string_lossy()));
    Ok(files)
}

fn is_mcap(path: &Path) -> bool {
    let is_hidden = path.file_name().is_none_or(|name| name.to_string_lossy().starts_with('.'));
    !is_hidden && path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"))
}

/// The numbers in a name, and the name.
fn numbers_of(name: &str) -> (Vec<u64>, String) {
    let runs = name.split(|c: char| !c.is_ascii_digit()).filter_map(|run| run.parse().ok());
    (runs.collect(), name.to_owned())
}

/// The files that a metadata.yaml lists.
fn listed(text: &str) -> Option<Vec<String>> {
    let documents = Yaml::load_from_str(text).ok()?;
    let information = documents.first()?.as_mapping_get("rosbag2_bagfile_information")?;
    let files = information.as_mapping_get("relative_file_paths")?.as_vec()?;
    files.iter().map(|file| file.as_str().map(str::to_owned)).collect()
}

/// That a file is there and is no recording of another kind.
fn require_mcap(path: &Path) -> Result<()> {
    let mut head = Vec::new();
    let file = File::open(path).map_err(Error::io(path, "read"))?;
    file.take(content::HEAD_BYTES as u64).read_to_end(&mut head).map_err(Error::io(path, "read"))?;
    let convert = match &head[..] {
        [b'#', b'R', b'O', b'S', b'B', b'A', b'G', ..] => {
            "a recording of ROS 1, expected ROS 2's MCAP; convert it: pip install rosbags && rosbags-convert --src RUN.bag --dst RUN \
             --dst-storage mcap"
        }
        [b'S', b'Q', b'L', b'i', b't', b'e', ..] => {
            "a recording in SQLite, expected MCAP; convert it: mcap convert RUN.db3 RUN.mcap, or ros2 bag convert with storage_id: mcap"
        }
        [0x28, 0xb5, 0x2f, 0xfd, ..] => "a file packed by zstd, expected MCAP; unpack it (zstd -d)",
        head if head.starts_with(MAGIC) || MAGIC.starts_with(head) => return Ok(()),
        head => match content::name_of(head) {
            Some(found) => return Err(Error::content(path, format!("{found}, expected a ROS 2 recording (MCAP)"))),
            None => return Ok(()),
        },
    };
    Err(Error::content(path, convert))
}

/// Whether a file ends as a finished recording does.
pub(super) fn ends_whole(path: &Path) -> bool {
    let end = || -> std::io::Result<Vec<u8>> {
        let mut file = File::open(path)?;
        file.seek(SeekFrom::End(-(MAGIC.len() as i64)))?;
        let mut end = Vec::new();
        file.read_to_end(&mut end)?;
        Ok(end)
    };
    end().is_ok_and(|end| end == MAGIC)
}

impl fmt::Display for Bag {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.named[..] {
            [one] => one.display().fmt(f),
            several => write!(f, "{} and {} more files", self.path().display(), several.len() - 1),
        }
    }
}
