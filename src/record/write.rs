//! Files that appear whole or not at all.
//!
//! A file is written under a temporary name in the folder where it will stand, flushed to the disk and renamed. A run
//! that is killed half-way leaves the former file, or none, never a part of one.

use crate::error::{Error, Result};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// How temporary names begin and end.
const PREFIX: &str = ".snakeloop-";
const SUFFIX: &str = ".tmp";

/// A file being written. It appears under its name with [`commit`](Self::commit); dropped before that, it leaves no trace.
#[derive(Debug)]
pub struct PendingFile {
    path: PathBuf,
    temporary: NamedTempFile,
}

impl PendingFile {
    /// Starts the file that will stand at `path`; its folder is created if it is missing.
    ///
    /// # Errors
    /// [`Error::Io`] where the folder or the temporary file cannot be created.
    pub fn create(path: &Path) -> Result<Self> {
        let folder = match path.parent() {
            Some(parent) if parent != Path::new("") => parent,
            _ => Path::new("."),
        };
        std::fs::create_dir_all(folder).map_err(Error::io(folder, "create the folder"))?;
        let temporary = temporary_in(folder).map_err(Error::io(path, "write"))?;
        Ok(Self { path: path.to_owned(), temporary })
    }

    /// Flushes the content to the disk, so that a full disk is noticed before the file has its name.
    ///
    /// # Errors
    /// [`Error::Io`] where the disk is full.
    pub fn sync(&self) -> Result<()> {
        self.temporary.as_file().sync_all().map_err(Error::io(&self.path, "write"))
    }

    /// Flushes the content to the disk and gives the file its name, replacing what stood there. Where somebody removed the folder or the
    /// temporary file meanwhile, both are made anew first.
    ///
    /// # Errors
    /// [`Error::Io`] where the disk is full or the name cannot be taken (a folder stands there, say).
    pub fn commit(self) -> Result<()> {
        let restored = self.restored()?;
        restored.sync()?;
        let Self { path, temporary } = restored;
        temporary.persist(&path).map_err(|refused| Error::io(&path, "write")(refused.error))?;
        Ok(())
    }
}

impl PendingFile {
    /// Itself, or where its temporary name is gone a copy of what the open file still holds.
    fn restored(self) -> Result<Self> {
        let mut former = self.temporary.as_file();
        if is_at(former, self.temporary.path()) {
            return Ok(self);
        }
        let mut anew = Self::create(&self.path)?;
        former.seek(SeekFrom::Start(0)).map_err(Error::io(&self.path, "read"))?;
        std::io::copy(&mut former, &mut anew).map_err(Error::io(&self.path, "write"))?;
        Ok(anew)
    }
}

impl Write for PendingFile {
    fn write(&mut self, buffer: &[u8]) -> std::io::Result<usize> {
        self.temporary.write(buffer)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.temporary.flush()
    }
}

/// Writes a whole file at once: it holds `contents` afterwards, or what it held before.
///
/// # Errors
/// [`Error::Io`] where the folder cannot be created or the file not be written.
pub fn write_atomically(path: &Path, contents: &[u8]) -> Result<()> {
    let mut file = PendingFile::create(path)?;
    file.write_all(contents).map_err(Error::io(path, "write"))?;
    file.commit()
}

/// Texts of files that belong together, by their paths.
pub type Files = Vec<(PathBuf, String)>;

/// Writes files that belong together: all are on the disk before the first has its name, so that a full disk leaves all of the former ones.
///
/// # Errors
/// [`Error::Io`] where a folder cannot be created or a file not be written.
pub fn write_together(files: &Files) -> Result<()> {
    let pending = |(path, text): &(PathBuf, String)| {
        let mut file = PendingFile::create(path)?;
        file.write_all(text.as_bytes()).map_err(Error::io(path, "write"))?;
        file.sync()?;
        Ok(file)
    };
    let pending: Vec<PendingFile> = files.iter().map(pending).collect::<Result<_>>()?;
    pending.into_iter().try_for_each(PendingFile::commit)
}

/// A temporary file with the permissions that any new file gets; `tempfile`'s own default would hide it from others.
fn temporary_in(folder: &Path) -> std::io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(PREFIX).suffix(SUFFIX);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder)
}

/// Removes what calls that were killed left in a folder under temporary names. Nobody else may be writing there.
///
/// # Errors
/// A folder that does not let it go.
pub fn remove_abandoned(folder: &Path) -> Result<()> {
    // A folder that is not there has nothing in it.
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if name.starts_with(PREFIX) && name.ends_with(SUFFIX) {
            std::fs::remove_file(entry.path()).map_err(Error::io(&entry.path(), "remove"))?;
        }
    }
    Ok(())
}

/// Removes a file. One that is not there is no error.
///
/// # Errors
/// A folder that does not let it go.
pub fn remove_if_there(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::io(path, "remove")(e)),
        _ => Ok(()),
    }
}

/// Whether an open file still is what its path leads to.
#[cfg(unix)]
pub fn is_at(file: &std::fs::File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let identity = |about: std::io::Result<std::fs::Metadata>| about.ok().map(|about| (about.dev(), about.ino()));
    identity(file.metadata()) == identity(std::fs::metadata(path))
}

/// The same on systems that do not let go of the name of an open file.
#[cfg(not(unix))]
pub fn is_at(_: &std::fs::File, path: &Path) -> bool {
    path.exists()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn names_in(folder: &Path) -> Vec<String> {
        fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect()
    }

    #[test]
    fn replaces_a_file_and_creates_its_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/deep/a.csv");
        write_atomically(&path, b"first, and longer").unwrap();
        write_atomically(&path, b"second").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"second");
        assert_eq!(names_in(path.parent().unwrap()), ["a.csv"], "no temporary file stays behind");
    }

    #[test]
    fn files_that_belong_together_are_all_written_or_none() {
        let folder = tempfile::tempdir().unwrap();
        let [model, table] = ["model.toml", "table.csv"].map(|name| folder.path().join(name));
        let files = |text: &str| vec![(model.clone(), text.to_owned()), (table.clone(), text.to_owned())];
        write_together(&files("first")).unwrap();
        // The second has no place.
        let mut second = files("second");
        second[1].0 = table.join("below a file");
        assert!(write_together(&second).is_err());
        assert_eq!(
            (fs::read_to_string(&model).unwrap(), fs::read_to_string(&table).unwrap()),
            ("first".into(), "first".into())
        );
        write_together(&files("second")).unwrap();
        assert_eq!(fs::read_to_string(&model).unwrap(), "second");
        assert_eq!(names_in(folder.path()).len(), 2);
    }

    #[test]
    fn leaves_the_former_file_until_committed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        write_atomically(&path, b"former").unwrap();
        let mut pending = PendingFile::create(&path).unwrap();
        pending.write_all(b"half of the ne").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"former");
        drop(pending);
        assert_eq!(fs::read(&path).unwrap(), b"former");
        assert_eq!(names_in(folder.path()), ["a.csv"]);
        // A process that is killed drops nothing.
        fs::write(folder.path().join(".snakeloop-abc.tmp"), b"half").unwrap();
        remove_abandoned(folder.path()).unwrap();
        assert_eq!(names_in(folder.path()), ["a.csv"]);
    }

    #[test]
    fn a_folder_that_is_removed_before_the_end_costs_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out/a.csv");
        let mut pending = PendingFile::create(&path).unwrap();
        pending.write_all(b"first, ").unwrap();
        fs::remove_dir_all(path.parent().unwrap()).unwrap();
        pending.write_all(b"second").unwrap();
        pending.commit().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"first, second");
        assert_eq!(names_in(path.parent().unwrap()), ["a.csv"]);
    }

    #[test]
    fn a_folder_in_the_way_is_an_error_that_names_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("taken");
        fs::create_dir_all(path.join("inside")).unwrap();
        let message = write_atomically(&path, b"x").unwrap_err().to_string();
        assert!(message.contains("taken") && message.contains("cannot write"), "{message}");
    }

    #[cfg(unix)]
    #[test]
    fn has_the_permissions_of_an_ordinary_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        write_atomically(&folder.path().join("ours"), b"").unwrap();
        fs::write(folder.path().join("plain"), b"").unwrap();
        let mode = |name| fs::metadata(folder.path().join(name)).unwrap().permissions().mode();
        assert_eq!(mode("ours"), mode("plain"));
    }
}
