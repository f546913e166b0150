//! A file of lines that grows while a command runs, and is gone on with by the next.
//!
//! A line is one write, so that a process that is killed leaves all of them but the one in hand. What is torn is told from the whole lines before it,
//! and cut off before lines are added again.

use super::write::{PendingFile, is_at};
use crate::error::{Error, Result};
use crate::input::{LINE_BYTES, read_line};
use std::fs::{File, OpenOptions};
use std::io::{BufReader, Seek, SeekFrom, Write, copy};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// A file to which lines are added. A clone is the same file, for whoever brings it to the disk on another thread.
#[derive(Debug, Clone)]
pub struct LineFile {
    path: PathBuf,
    file: Arc<Mutex<Arc<File>>>,
}

impl LineFile {
    /// Opens a file to add to, which is created where it is missing.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn open(path: PathBuf) -> Result<Self> {
        let file = opened(&path)?;
        Ok(Self { path, file: Arc::new(Mutex::new(file)) })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The file as it is open now. It is not held while the disk works.
    fn file(&self) -> Arc<File> {
        Arc::clone(&self.file.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Cuts off what lies beyond so many bytes.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn cut(&self, length: u64) -> Result<()> {
        self.file().set_len(length).map_err(Error::io(&self.path, "write"))
    }

    /// Adds a line, which is given without its end.
    ///
    /// # Errors
    /// A disk that is full or gone.
    pub fn append(&self, line: impl Into<Vec<u8>>) -> Result<()> {
        let mut line = line.into();
        line.push(b'\n');
        self.file().write_all(&line).map_err(Error::io(&self.path, "write"))
    }

    /// Brings all to the disk that was written so far.
    ///
    /// # Errors
    /// Those of the disk.
    pub fn sync(&self) -> std::io::Result<()> {
        self.file().sync_data()
    }

    /// Writes all from a byte on as a file of its own.
    ///
    /// # Errors
    /// A disk that is full or gone.
    pub fn copy_from(&self, start: u64, path: &Path) -> Result<()> {
        let (mut file, mut copied) = (self.file(), PendingFile::create(path)?);
        // Adding goes on at the end wherever was read from.
        file.seek(SeekFrom::Start(start)).map_err(Error::io(&self.path, "read"))?;
        copy(&mut file, &mut copied).map_err(Error::io(path, "write"))?;
        copied.commit()
    }

    /// Writes the file anew where it was removed, or another stands in its place: all that was written so far can still be read. Says
    /// whether it was gone.
    ///
    /// # Errors
    /// A folder that cannot be written to.
    pub fn restore(&self) -> Result<bool> {
        let is_gone = !is_at(&self.file(), &self.path);
        if is_gone {
            self.copy_from(0, &self.path)?;
            *self.file.lock().unwrap_or_else(PoisonError::into_inner) = opened(&self.path)?;
        }
        Ok(is_gone)
    }
}

fn opened(path: &Path) -> Result<Arc<File>> {
    let file = OpenOptions::new().read(true).append(true).create(true).open(path);
    file.map(Arc::new).map_err(Error::io(path, "write"))
}

/// The whole lines of a file.
#[derive(Debug)]
pub struct Lines<'a> {
    reader: BufReader<File>,
    path: &'a Path,
    /// Where the last line that was read ends, bytes.
    pub end: u64,
    /// Whether a line without its end came after it.
    pub is_torn: bool,
}

impl<'a> Lines<'a> {
    /// From the beginning.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn open(path: &'a Path) -> Result<Self> {
        let file = File::open(path).map_err(Error::io(path, "read"))?;
        Ok(Self { reader: BufReader::new(file), path, end: 0, is_torn: false })
    }

    /// The next line without its end; nothing of one that is longer than `LINE_BYTES` or no text. `None` at the end, or where it is torn.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn next_line(&mut self) -> Result<Option<String>> {
        let mut line = Vec::new();
        let read = read_line(&mut self.reader, LINE_BYTES, &mut line).map_err(Error::io(self.path, "read"))?;
        if !read.ended {
            self.is_torn = read.length > 0;
            return Ok(None);
        }
        self.end += read.length;
        let is_whole = line.pop() == Some(b'\n');
        Ok(Some(String::from_utf8(line).ok().filter(|_| is_whole).unwrap_or_default()))
    }
}
