//! The folder that a call writes to: one call's at a time, never over its own inputs, and with a record of what made its files.
//!
//! The record, `.snakeloop.toml`, holds for each file of the folder the call that made it. A call that is at work holds the operating
//! system's lock on it, which ends with the process however that ends. Where a file system knows no locks, calls go without.

use super::write::{is_at, remove_abandoned};
use crate::error::{Error, Result};
use crate::input::SETTINGS_BYTES;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Component, Path, PathBuf};
use std::thread::sleep;
use std::time::Duration;

/// The record's name in the folder.
pub const RECORD: &str = ".snakeloop.toml";

/// Times that the lock is asked for. Convention: with [`RETRY`] what a process that was just killed takes to let go.
const TRIES: u32 = 20;
/// Time between two of them.
///
/// Convention: a timeout.
const RETRY: Duration = Duration::from_millis(20);

/// A folder that this process alone writes to, until it is dropped.
#[derive(Debug)]
pub struct OutputFolder {
    path: PathBuf,
    record: File,
    /// The call that made the files of these names.
    made: Option<(String, Vec<String>)>,
}

/// What the record holds.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Record {
    /// The call that made each file, by the file's name.
    #[serde(default)]
    files: BTreeMap<String, String>,
}

impl OutputFolder {
    /// Takes a folder, which is created if it is missing, to write files (or folders) of these names into it. `inputs` are the
    /// files that the call reads; a pattern of file names stands for all that lie where it does. Temporary files of calls that were killed
    /// are removed.
    ///
    /// # Errors
    /// An output that would replace an input; a folder in which another call is at work, or that cannot be written to.
    pub fn claim(folder: &Path, outputs: &[&str], inputs: &[PathBuf]) -> Result<Self> {
        std::fs::create_dir_all(folder).map_err(Error::io(folder, "create the folder"))?;
        refuse_inputs(folder, outputs, inputs)?;
        let claimed = Self::lock(folder)?;
        remove_abandoned(folder)?;
        Ok(claimed)
    }

    /// Takes the lock on a folder, which is created if it is missing.
    fn lock(folder: &Path) -> Result<Self> {
        std::fs::create_dir_all(folder).map_err(Error::io(folder, "create the folder"))?;
        let path = folder.join(RECORD);
        for _ in 0..TRIES {
            let record = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path);
            let record = record.map_err(Error::io(&path, "write"))?;
            match record.try_lock() {
                Err(TryLockError::WouldBlock) => sleep(RETRY),
                // The folder may have been deleted and made anew in between.
                _ if !is_at(&record, &path) => {}
                _ => return Ok(Self { path: folder.to_owned(), record, made: None }),
            }
        }
        Err(Error::content(
            folder,
            "another call of snakeloop is working in this folder; wait for it, or choose another folder",
        ))
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// An error where one of these files is there and another call than `maker` made it.
    ///
    /// # Errors
    /// That, and a record that cannot be read.
    pub fn refuse_mixing(&self, maker: &str, outputs: &[&str]) -> Result<()> {
        self.unmixed(maker, outputs).map(|_| ())
    }

    /// Notes that `maker` makes the files of these names.
    ///
    /// # Errors
    /// A file that is there and that another call made; a record that cannot be read or written.
    pub fn made_by(&mut self, maker: &str, outputs: &[&str]) -> Result<()> {
        let path = self.path.join(RECORD);
        let mut record = self.unmixed(maker, outputs)?;
        record.files.extend(outputs.iter().map(|name| ((*name).to_owned(), maker.to_owned())));
        let text = toml::to_string(&record).map_err(Error::encode("the folder's record"))?;
        let mut file = &self.record;
        file.seek(SeekFrom::Start(0)).map_err(Error::io(&path, "write"))?;
        file.write_all(text.as_bytes()).map_err(Error::io(&path, "write"))?;
        file.set_len(text.len() as u64).map_err(Error::io(&path, "write"))?;
        self.made = Some((maker.to_owned(), outputs.iter().map(|name| (*name).to_owned()).collect()));
        Ok(())
    }

    /// Takes the folder anew where it was removed while the call is at work.
    ///
    /// # Errors
    /// A folder in which another call is at work, or that cannot be written to, and those of [`made_by`](Self::made_by).
    pub fn restore(&mut self) -> Result<()> {
        if is_at(&self.record, &self.path.join(RECORD)) {
            return Ok(());
        }
        let locked = Self::lock(&self.path)?;
        let made = std::mem::replace(self, locked).made.take();
        made.map_or(Ok(()), |(maker, outputs)| {
            self.made_by(&maker, &outputs.iter().map(String::as_str).collect::<Vec<_>>())
        })
    }

    /// The record, where none of these files that are there is another call's.
    fn unmixed(&self, maker: &str, outputs: &[&str]) -> Result<Record> {
        let path = self.path.join(RECORD);
        let mut file = &self.record;
        let mut text = String::new();
        file.seek(SeekFrom::Start(0)).map_err(Error::io(&path, "read"))?;
        file.take(SETTINGS_BYTES).read_to_string(&mut text).map_err(Error::io(&path, "read"))?;
        let record: Record = toml::from_str(&text)
            .map_err(|e| Error::content(&path, format!("{}; remove it, or choose another folder", e.message())))?;
        for name in outputs {
            let former = record.files.get(*name).filter(|former| *former != maker);
            if let Some(former) = former.filter(|_| self.path.join(name).exists()) {
                let message = format!(
                    "`{former}` made this, and `{maker}` would mix with it; choose another folder, or remove what is in this one"
                );
                return Err(Error::content(&self.path.join(name), message));
            }
        }
        Ok(record)
    }
}

/// An error where one of the outputs is one of the inputs, or holds one.
fn refuse_inputs(folder: &Path, outputs: &[&str], inputs: &[PathBuf]) -> Result<()> {
    let folder = folder.canonicalize().map_err(Error::io(folder, "read"))?;
    for input in inputs {
        let Some(found) = place(input) else { continue };
        if let Some(output) = outputs.iter().find(|output| found.starts_with(folder.join(output))) {
            let message =
                format!("this is an input, and the output {output} would replace it; write to another folder (-o)");
            return Err(Error::content(input, message));
        }
        if let Some(output) = outputs.iter().find(|output| is_matched(&found, &folder, output)) {
            let message = format!(
                "the output {output} in {} would be read as one of these; write to another folder (-o)",
                folder.display()
            );
            return Err(Error::content(input, message));
        }
    }
    Ok(())
}

/// Whether a pattern of inputs takes in a file of this name in a folder.
fn is_matched(pattern: &Path, folder: &Path, name: &str) -> bool {
    let own = pattern.file_name().and_then(|own| own.to_str()).and_then(|own| glob::Pattern::new(own).ok());
    pattern.parent() == Some(folder) && own.is_some_and(|own| own.matches(name))
}

/// The name by which a file is replaced: its folder without links, and its own name, which may be that of a link or a pattern.
fn place(file: &Path) -> Option<PathBuf> {
    let Some(Component::Normal(name)) = file.components().next_back() else { return None };
    let parent = file.parent().filter(|parent| *parent != Path::new("")).unwrap_or(Path::new("."));
    Some(parent.canonicalize().ok()?.join(name))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Barrier;

    const OUTPUTS: [&str; 2] = ["model.toml", "overlays"];

    #[test]
    fn of_many_calls_at_once_one_gets_in_and_the_next_once_it_is_done() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        for _ in 0..5 {
            let start = Barrier::new(4);
            let claims: Vec<Result<OutputFolder>> = std::thread::scope(|scope| {
                let claim = || {
                    start.wait();
                    OutputFolder::claim(&out, &OUTPUTS, &[])
                };
                let claims: Vec<_> = (0..4).map(|_| scope.spawn(claim)).collect();
                claims.into_iter().map(|claim| claim.join().unwrap()).collect()
            });
            assert_eq!(claims.iter().filter(|claim| claim.is_ok()).count(), 1);
            let refused = claims.into_iter().find_map(Result::err).unwrap().to_string();
            assert!(refused.contains("another call of snakeloop is working"), "{refused}");
        }
        // What a call that was killed left goes with the next one, and not while one is at work.
        let left = out.join(".snakeloop-abc.tmp");
        std::fs::write(&left, "half").unwrap();
        let first = OutputFolder::claim(&out, &OUTPUTS, &[]).unwrap();
        assert!(!left.exists());
        std::fs::write(&left, "half").unwrap();
        assert!(OutputFolder::claim(&out, &OUTPUTS, &[]).is_err() && left.exists());
        // A folder that was removed under one call's feet is another's.
        std::fs::remove_dir_all(&out).unwrap();
        OutputFolder::claim(&out, &OUTPUTS, &[]).unwrap();
        drop(first);
    }

    #[cfg(unix)]
    #[test]
    fn an_output_that_would_replace_an_input_is_refused_whatever_it_is_called() {
        let root = tempfile::tempdir().unwrap();
        let out = root.path().join("out");
        std::fs::create_dir_all(out.join("overlays")).unwrap();
        std::os::unix::fs::symlink(&out, root.path().join("link")).unwrap();
        for input in ["out/model.toml", "link/model.toml", "out/../out/model.toml", "out/overlays/*.jpg"] {
            let inputs = [root.path().join("out/camera.yaml"), root.path().join(input)];
            let refused = OutputFolder::claim(&out, &OUTPUTS, &inputs).unwrap_err().to_string();
            assert!(refused.contains(input) && refused.contains("would replace it"), "{refused}");
        }
        let others = ["out/camera.yaml", "model.toml", "out/frames/*.png", "nowhere/model.toml"];
        OutputFolder::claim(&out, &OUTPUTS, &others.map(|name| root.path().join(name))).unwrap();
    }

    #[test]
    fn what_another_call_made_is_not_mixed_with() {
        let folder = tempfile::tempdir().unwrap();
        let claim = |maker: &str, outputs: &[&str]| {
            OutputFolder::claim(folder.path(), outputs, &[]).and_then(|mut folder| folder.made_by(maker, outputs))
        };
        claim("run a", &OUTPUTS).unwrap();
        claim("run b", &OUTPUTS).unwrap();
        std::fs::write(folder.path().join("model.toml"), "").unwrap();
        claim("run b", &OUTPUTS).unwrap();
        claim("table", &["compensation.csv"]).unwrap();
        let refused = claim("live a", &["journal.jsonl", "model.toml"]).unwrap_err().to_string();
        assert!(refused.contains("model.toml: `run b` made this, and `live a` would mix"), "{refused}");
        std::fs::write(folder.path().join(RECORD), "no record").unwrap();
        assert!(claim("run b", &OUTPUTS).unwrap_err().to_string().contains("remove it"));
    }
}
